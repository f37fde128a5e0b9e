"""An SQLite file or its log deleted, moved or exchanged under a writer is noticed, told, and costs no scan."""

import os
import random
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing

import pytest

from daq.recording import recorder
from daq.recording.recorder import PageWatch
from daq.store import file_rescue, open_store
from daq.store import outbox as outbox_module
from daq.store.file_rescue import HeldFile, damage_of
from daq.store.outbox import Outbox
from daq.store.write_batch import WriteBatch
from daq.words import say
from tests.daq.test_store_outbox import CHANNELS, Notes, batch
from tests.patience import wait_until


def delete(path, folder):
    path.unlink()


def move(path, folder):
    path.rename(folder / "elsewhere.sqlite")


def exchange(path, folder):
    with open_store(str(folder / "other.sqlite")) as other:
        other.register_press("hall", CHANNELS)
    (folder / "other.sqlite").replace(path)


def delete_log(path, folder):
    path.with_name(path.name + "-wal").unlink()


def delete_index_of_log(path, folder):
    path.with_name(path.name + "-shm").unlink()


def move_and_link(path, folder):
    move(path, folder)
    path.symlink_to(folder / "elsewhere.sqlite")


def empty_log(path, folder):
    os.truncate(path.with_name(path.name + "-wal"), 0)


def cut_log_short(path, folder):
    os.truncate(path.with_name(path.name + "-wal"), 200)  # a part of its first page


def empty_log_before_somebody_writes_on(path, folder):
    log = path.with_name(path.name + "-wal")
    size = log.stat().st_size
    os.truncate(log, 0)
    os.truncate(log, size)


CUTS = [empty_log, cut_log_short, empty_log_before_somebody_writes_on]
FATES = [delete, move, exchange, delete_log, delete_index_of_log, *CUTS]
if os.name != "nt":
    FATES.append(move_and_link)


@pytest.mark.parametrize("fate", FATES)
def test_a_store_file_that_goes_under_a_running_writer_is_put_back_whole_before_anything_is_written(
    tmp_path, fate, monkeypatch
):
    monkeypatch.setattr(outbox_module, "BEAT_S", 3600.0)  # all is in the log: the worst case
    path, notes = tmp_path / "s.sqlite", Notes()
    with open_store(str(path)) as store, open_store(str(path)) as reader:
        key = store.register_press("lab", CHANNELS)
        written_by_then = []

        def journal(level, message):
            written_by_then.append(len(notes.acknowledged))
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
        assert written_by_then == [50]
        assert reader.newest_scan_number("lab") == 199
        outbox.close()
        with closing(sqlite3.connect(path)) as connection:
            kept = [row[0] for row in connection.execute("SELECT number FROM scan ORDER BY number")]
            assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        assert kept == list(range(200)) == notes.acknowledged
        assert [level for level, _ in notes.journalled] == ["alarm"]
        assert str(path) in notes.journalled[0][1]
    if fate in (delete_log, delete_index_of_log):
        assert "its log (-wal, -shm)" in notes.journalled[0][1]
        (aside,) = tmp_path.glob("s.sqlite.found-*")
        assert str(aside) in notes.journalled[0][1]
    if fate in CUTS:
        assert "its log (-wal) was emptied or cut short" in notes.journalled[0][1]
    if fate is move:
        with open_store(str(tmp_path / "elsewhere.sqlite")) as moved:
            assert moved.newest_scan_number("lab") >= 49
    if fate is exchange:
        (aside,) = tmp_path.glob("s.sqlite.found-*")
        with open_store(str(aside)) as found:
            assert list(found.presses()) == ["hall"]


@pytest.mark.parametrize(("seed", "company"), [(0, True), (1, True), (2, False)], ids=["beside", "busy", "alone"])
def test_an_older_copy_written_over_the_file_in_its_place_is_told_with_the_scans_that_are_gone(
    tmp_path, seed, company
):
    path, copy, notes, chance = tmp_path / "s.sqlite", tmp_path / "copy.sqlite", Notes(), random.Random(seed)
    with open_store(str(path)) as store, open_store(str(path)) as other:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        outbox.start()

        def record(first, behind):
            for n in range(first, behind):
                outbox.put(batch(key, n))
                if n % 20 == 0:
                    wait_until(lambda: len(notes.acknowledged) > n)  # noqa: B023
                if company and chance.random() < 0.02:
                    other.log("info", "sense", say("plain-text", text="x" * 500))
            wait_until(lambda: settled(behind))
            wait_until(lambda: outbox._beat is None)
            if company:
                other.log(
                    "info", "sense", say("plain-text", text="after the writer")
                )  # who copies now meets no one

        def settled(behind):
            outbox.beat("record", {"x": behind})  # with a sign of life what the log holds comes into the file
            return len(notes.acknowledged) == behind and not outbox._unsettled

        record(0, 300)
        shutil.copyfile(path, copy)
        record(300, 900)
        shutil.copyfile(copy, path)
        record(900, 1200)
        outbox.close()
        with closing(sqlite3.connect(path)) as connection:
            kept = [row[0] for row in connection.execute("SELECT number FROM scan ORDER BY number")]
            assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        assert other.newest_scan_number("lab") == 1199
    alarms = [text for level, text in notes.journalled if level == "alarm" and "scans wait" not in text]
    gone = sorted(set(range(1200)) - set(kept))
    assert kept[:250] == list(range(250))
    assert kept[-300:] == list(range(900, 1200))
    assert gone == list(range(gone[0], gone[-1] + 1))
    assert [f"scans {gone[0]} to {gone[-1]} of press lab" in text for text in alarms[-1:]] == [True]
    assert all(str(path) in text for text in alarms)


def test_what_the_log_holds_comes_into_the_file_every_second(tmp_path, monkeypatch):
    monkeypatch.setattr(outbox_module, "BEAT_S", 0.0)
    path, notes = tmp_path / "s.sqlite", Notes()
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note)
        outbox.start()
        outbox.put(batch(key, 0))
        wait_until(lambda: notes.acknowledged == [0] and not outbox._unsettled)
        with closing(sqlite3.connect(f"{path.as_uri()}?immutable=1", uri=True)) as without_log:
            assert without_log.execute("SELECT number FROM scan").fetchall() == [(0,)]
        outbox.close()


def test_flipped_bytes_in_the_file_are_noticed_while_it_is_recorded_into(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "_PAGES_S", 0.02)
    path, alarms, stop, read = tmp_path / "s.sqlite", [], threading.Event(), []
    damage_of = recorder.damage_of
    monkeypatch.setattr(recorder, "damage_of", lambda file: read.append(damage_of(file)) or read[-1])
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        store.write_batches([batch(key, n) for n in range(500)])
        with store.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        watch = PageWatch(path, lambda level, message, *_: alarms.append((level, message.code)))
        watcher = threading.Thread(target=watch.work, args=(stop,))
        watcher.start()
        wait_until(lambda: len(read) > 2)
        assert (alarms, set(read), watch.stalled()) == ([], {""}, None)
        with path.open("r+b") as file:
            file.seek(path.stat().st_size - 8192)
            file.write(bytes(b ^ 0xFF for b in range(64)))
        try:
            wait_until(lambda: alarms)
        finally:
            stop.set()
            watcher.join()
    assert alarms == [("alarm", "store-damaged")]


def test_a_file_of_which_too_little_is_left_is_told_and_nothing_takes_its_place(tmp_path):
    path, notes = tmp_path / "s.sqlite", Notes()
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        outbox.start()
        outbox.put(WriteBatch(key, tuple(s for n in range(2000) for s in batch(key, n).scans)))
        wait_until(lambda: len(notes.acknowledged) == 2000)
        with store.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        os.truncate(path, 0)
        outbox.put(batch(key, 2000))
        wait_until(lambda: outbox.trouble)
        outbox.close(0.1)
    assert len(notes.acknowledged) == 2000
    assert {level for level, _ in notes.journalled} == {"alarm"}
    assert "not an SQLite file, or its first page is destroyed" in notes.journalled[0][1]
    assert path.stat().st_size == 0


def test_a_rescue_that_takes_long_gives_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(file_rescue, "_PAGES_AT_ONCE", 2)
    path, alive = tmp_path / "s.sqlite", []
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        store.write_batches([batch(key, n) for n in range(500)])
        store.database.hold_on()
        path.unlink()
        store.database.rescue(lambda: alive.append(store.database.path.exists()))
        assert store.newest_scan_number("lab") == 499
    assert len(alive) > 10
    assert not any(alive)  # while it lasts


def test_a_file_whose_pages_the_disk_does_not_give_is_damaged_and_one_that_is_locked_is_not(tmp_path):
    path = tmp_path / "s.sqlite"
    with open_store(str(path)) as store:
        store.register_press("lab", CHANNELS)
        with store.database.writing():
            assert damage_of(path) == ""
        path.with_name("s.sqlite-wal").unlink()  # the index says that it holds the newest pages
        assert damage_of(path) == "disk I/O error"
    assert damage_of(tmp_path / "gone.sqlite") == ""


def test_a_damaged_file_is_told_whatever_words_its_error_has(tmp_path):
    path = tmp_path / "s.sqlite"
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("CREATE TABLE locked (number)")
        connection.execute("PRAGMA writable_schema=ON")
        connection.execute("UPDATE sqlite_master SET sql = 'CREATE TABLE unable to open'")
    assert damage_of(path).startswith("malformed database schema (locked)")


_ANOTHER = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute("SELECT count(*) FROM press").fetchall()
connection.close()
"""


def assert_keeps_its_log(store, key, path):
    """Another process that leaves the file does not take the log from under a store that writes."""
    log = path.with_name(path.name + "-wal")
    before = log.stat().st_ino
    subprocess.run([sys.executable, "-c", _ANOTHER, str(path)], check=True)
    store.append_scans(key, batch(key, 0).scans)
    assert log.stat().st_ino == before


def test_another_process_that_leaves_the_file_does_not_take_the_log_from_under_the_writer(tmp_path):
    path = tmp_path / "s.sqlite"
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        store.database.hold_on()
        assert not store.database.moved
        assert_keeps_its_log(store, key, path)


def test_a_store_closed_beside_another_on_the_same_file_leaves_that_its_log(tmp_path):
    path = tmp_path / "s.sqlite"
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        with open_store(str(path)) as other:
            other.database.hold_on()
            assert not other.database.moved
        assert_keeps_its_log(store, key, path)
        with closing(sqlite3.connect(path)) as connection:
            assert connection.execute("SELECT count(*) FROM scan").fetchone() == (1,)


def test_to_ask_whether_an_older_state_lies_in_a_files_place_makes_none_where_none_is(tmp_path):
    path = tmp_path / "s.sqlite"
    with open_store(str(path)) as store:
        store.register_press("lab", CHANNELS)
    held = HeldFile(path)
    path.rename(tmp_path / "moved.sqlite")
    assert not held.went_back()
    assert not path.exists()
    held.close()
