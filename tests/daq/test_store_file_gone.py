"""An SQLite file deleted, moved or exchanged under a writer is noticed, told, and costs no acknowledged scan."""

import sqlite3
import threading
from contextlib import closing

import pytest

from daq.recording import recorder
from daq.recording.recorder import PageWatch
from daq.store import open_store
from daq.store.outbox import Outbox
from tests.daq.test_store_outbox import CHANNELS, Notes, batch, wait_until


def delete(path, folder):
    path.unlink()


def move(path, folder):
    path.rename(folder / "elsewhere.sqlite")


def exchange(path, folder):
    with open_store(str(folder / "other.sqlite")) as other:
        other.register_press("hall", CHANNELS)
    (folder / "other.sqlite").replace(path)


@pytest.mark.parametrize("fate", [delete, move, exchange])
def test_a_store_file_that_goes_under_a_running_writer_is_put_back_whole_before_anything_is_written(
    tmp_path, fate
):
    path, notes = tmp_path / "s.sqlite", Notes()
    with open_store(str(path)) as store, open_store(str(path)) as reader:
        key = store.register_press("lab", CHANNELS)
        written_when_told = []

        def journal(level, message):
            written_when_told.append(len(notes.acknowledged))
            notes.journal(level, message)

        outbox = Outbox(store, acknowledged=notes.note, journal=journal)
        outbox.start()
        for n in range(50):
            outbox.put(batch(key, n))
        wait_until(lambda: len(notes.acknowledged) == 50)
        assert reader.newest_scan_number("lab") == 49
        fate(path, tmp_path)
        for n in range(50, 200):
            outbox.put(batch(key, n))
        wait_until(lambda: len(notes.acknowledged) == 200)
        assert written_when_told == [50]
        assert reader.newest_scan_number("lab") == 199
        outbox.close()
        with closing(sqlite3.connect(path)) as connection:
            kept = [row[0] for row in connection.execute("SELECT number FROM scan ORDER BY number")]
            assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        assert kept == list(range(200)) == notes.acknowledged
        assert [level for level, _ in notes.said] == ["alarm"]
        assert str(path) in notes.said[0][1]
    if fate is move:
        with open_store(str(tmp_path / "elsewhere.sqlite")) as moved:
            assert moved.newest_scan_number("lab") >= 49
    if fate is exchange:
        (aside,) = tmp_path.glob("s.sqlite.found-*")
        with open_store(str(aside)) as found:
            assert list(found.presses()) == ["hall"]


def test_flipped_bytes_in_the_file_are_noticed_while_it_is_recorded_into(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "_PAGES_S", 0.02)
    path, said, stop, read = tmp_path / "s.sqlite", [], threading.Event(), []
    damage_of = recorder.damage_of
    monkeypatch.setattr(recorder, "damage_of", lambda file: read.append(damage_of(file)) or read[-1])
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        store.write_batches([batch(key, n) for n in range(500)])
        with store.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        watch = PageWatch(path, lambda level, message, *_: said.append((level, message.code)))
        watcher = threading.Thread(target=watch.work, args=(stop,))
        watcher.start()
        wait_until(lambda: len(read) > 2)
        assert (said, set(read), watch.stalled()) == ([], {""}, None)
        with path.open("r+b") as file:
            file.seek(path.stat().st_size - 8192)
            file.write(bytes(b ^ 0xFF for b in range(64)))
        try:
            wait_until(lambda: said)
        finally:
            stop.set()
            watcher.join()
    assert said == [("alarm", "store-damaged")]
