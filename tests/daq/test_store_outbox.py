"""The way from recorder to store: in order and complete, whatever the store does meanwhile."""

import sqlite3
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import count, islice
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import text

from daq.records import Channel, PressEvent, PressEventKind, Quality, Scan
from daq.store import NewRun, RunEnd, RunStatus, StoreUnavailable, open_store
from daq.store import outbox as outbox_module
from daq.store.buffer import Buffer
from daq.store.outbox import Outbox
from daq.store.write_batch import Entry, WriteBatch, decode_item, encode_item
from daq.words import say
from tests.patience import wait_until

BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
CHANNELS = (Channel("platen_top"), Channel("top_1"))
G = Quality.GOOD


def batch(key, number):
    scan = Scan(number, BEGAN + timedelta(seconds=number / 10), 100 + number / 10, (200.0, 20.0 + number), (G, G))
    return WriteBatch(key, (scan,))


class Notes:
    def __init__(self):
        self.acknowledged, self.journalled = [], []

    def note(self, item):
        self.acknowledged += [s.number for s in item.scans]

    def journal(self, level, message):
        self.journalled.append((level, str(message)))


def numbers(store):
    return [s.number for s in store.scans_after("lab", -1, 100000).scans]


def test_everything_put_is_written_in_order_and_acknowledged_after(store_url):
    notes = Notes()
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note)
        outbox.start()
        for n in range(200):
            outbox.put(batch(key, n))
        outbox.put(Entry("info", "record", say("plain-text", text="hello")))
        outbox.beat("record", {"x": 1})
        outbox.close()
        assert numbers(store) == notes.acknowledged == list(range(200))
        assert str(store.journal().items[0].message) == "hello"
        assert store.statuses()["record"].status == {"x": 1}
        assert (outbox.waiting, outbox.written, outbox.lost) == (0, 200, 0)


@pytest.mark.parametrize("buffered", [False, True], ids=["in memory", "in the buffer file"])
def test_while_much_waits_to_be_written_the_recorder_gives_signs_of_life(tmp_path, monkeypatch, buffered):
    alive = []
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", CHANNELS)
        much = [batch(key, n) for n in range(1200)]
        if buffered:
            Buffer(tmp_path / "b.sqlite").append(much)
        outbox = Outbox(store, buffer=tmp_path / "b.sqlite" if buffered else None)
        write = store.write_batches

        def watched(*given):
            alive.append("record" in store.statuses())
            return write(*given)

        monkeypatch.setattr(store, "write_batches", watched)
        for item in () if buffered else much:
            outbox.put(item)
        outbox.beat("record", {"x": 1})
        outbox.start()
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert numbers(store) == list(range(1200))
    assert alive[:3] == [False, True, True]


def test_a_run_recorded_before_the_store_said_where_it_belongs_holds_its_own_scans(store_url):
    with open_store(store_url) as store:
        store.append_scans(store.register_press("lab", CHANNELS), [batch(None, n).scans[0] for n in range(7)])
        outbox = Outbox(store)
        key = outbox.later_key("lab", CHANNELS, "")
        for n in range(10):
            begin = NewRun("pressing", 3, BEGAN, 100.3) if n == 4 else None
            end = RunEnd("pressing", 5, BEGAN, first_scan=3) if n == 7 else None
            outbox.put(WriteBatch(key, batch(key, n).scans, (), begin, end))
        outbox.start()
        outbox.close()
        assert numbers(store) == list(range(17))
        assert store.load_run("pressing").columns["top_1"].tolist() == [23.0, 24.0, 25.0]


def test_a_writer_that_the_store_holds_up_for_longer_than_any_wait_does_not_count_as_alive(tmp_path, monkeypatch):
    held, going_on = threading.Event(), threading.Event()
    monkeypatch.setattr("daq.store.outbox.STALLED_S", 0.3)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        outbox = Outbox(store)
        write = store.write_batches

        def stuck(*batches_and_lines):
            held.set()
            going_on.wait()
            return write(*batches_and_lines)

        monkeypatch.setattr(store, "write_batches", stuck)
        outbox.put(Entry("info", "record", say("plain-text", text="hello")))
        began = time.monotonic()
        outbox.start()
        try:
            assert held.wait(240)
            wait_until(outbox.stalled)
            seconds = outbox.stalled().arguments["seconds"]
            assert 0.3 < seconds < time.monotonic() - began
        finally:
            going_on.set()
        wait_until(lambda: outbox.stalled() is None)
        outbox.close()
        assert [str(e.message) for e in store.journal().items] == ["hello"]


def test_in_memory_there_is_room_for_as_long_as_the_presses_take_to_fill_it(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, slower = Outbox(store, per_second=10.0), Outbox(store, per_second=2.5)
        empty = outbox.hours_left
        assert slower.hours_left == pytest.approx(4 * empty)
        for n in range(3600):
            outbox.put(batch(key, n))
        assert empty - outbox.hours_left == pytest.approx(0.1)  # 6 minutes at ten a second
        assert outbox.capacity == say("waits-in-memory", hours=outbox.hours_left)


def test_a_locked_store_makes_scans_wait_says_so_once_and_loses_none(tmp_path):
    notes, path = Notes(), tmp_path / "s.sqlite"
    with open_store(str(path), busy_s=0.05) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        outbox.start()
        outbox.put(batch(key, 0))
        wait_until(lambda: notes.acknowledged == [0])
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        for n in range(1, 50):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.trouble)
        assert notes.acknowledged == [0]
        other.execute("ROLLBACK")
        other.close()
        wait_until(lambda: len(notes.acknowledged) == 50)
        outbox.close()
        assert numbers(store) == list(range(50))
        assert [level for level, _ in notes.journalled] == ["alarm", "info"]
        assert "another process holds it" in notes.journalled[0][1]
        assert "takes data again" in notes.journalled[1][1]


class Server:
    """A PostgreSQL database that can be made unreachable: connections refused and cut, as in a restart."""

    def __init__(self, url):
        self.url, self.name = url, url.rpartition("/")[2]

    def _say(self, *statements):
        import psycopg

        admin = self.url.replace("postgresql+psycopg", "postgresql").rpartition("/")[0] + "/postgres"
        with psycopg.connect(admin, autocommit=True) as connection:
            for statement in statements:
                connection.execute(statement)

    def stop(self):
        cut = f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{self.name}'"
        self._say(cut, f"ALTER DATABASE {self.name} RENAME TO {self.name}_away")

    def start(self):
        self._say(f"ALTER DATABASE {self.name}_away RENAME TO {self.name}")


def test_a_server_that_goes_away_is_replaced_by_a_local_buffer_and_filled_in_order(postgresql_url, tmp_path):
    notes, server = Notes(), Server(postgresql_url)
    buffer = tmp_path / "buffer.sqlite"
    with open_store(postgresql_url, busy_s=2) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, buffer=buffer, acknowledged=notes.note, journal=notes.journal)
        outbox.start()
        outbox.put(batch(key, 0))
        wait_until(lambda: notes.acknowledged == [0])
        server.stop()
        try:
            for n in range(1, 60):
                outbox.put(batch(key, n))
                time.sleep(0.002)
            wait_until(lambda: len(notes.acknowledged) == 60)
            with sqlite3.connect(buffer) as kept:
                assert kept.execute("SELECT count(*) FROM parcel").fetchone()[0] == 59
            kept.close()
            assert "enough for" in notes.journalled[0][1]
        finally:
            server.start()
        outbox.put(batch(key, 60))
        wait_until(lambda: outbox.waiting == 0 and len(notes.acknowledged) == 61)
        outbox.close()
        assert numbers(store) == list(range(61))
        assert notes.acknowledged == list(range(61))


def test_what_a_killed_recorder_left_in_the_buffer_is_written_by_the_next(postgresql_url, tmp_path):
    server = Server(postgresql_url)
    with open_store(postgresql_url, busy_s=2) as store:
        key = store.register_press("lab", CHANNELS)
        notes = Notes()
        first = Outbox(store, buffer=tmp_path / "b.sqlite", acknowledged=notes.note)
        server.stop()
        try:
            first.start()
            for n in range(30):
                first.put(batch(key, n))
            wait_until(lambda: len(notes.acknowledged) == 30)
            first.close()
        finally:
            server.start()
        second = Outbox(store, buffer=tmp_path / "b.sqlite")
        assert second.waiting == 30
        second.start()
        second.put(batch(key, 30))
        wait_until(lambda: second.waiting == 0)
        second.close()
        assert numbers(store) == list(range(31))


@pytest.fixture
def small_disk():
    """A file system of 3 MB; skipped where mounting is not allowed.

    Not in a folder that pytest clears later: of a run that was killed it stays mounted.
    """
    place = Path(tempfile.mkdtemp(prefix="small-disk-"))
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode:
        place.rmdir()
        pytest.skip(f"no small file system can be mounted here: {mounted.stderr.decode().strip()}")
    yield place
    subprocess.run(["umount", str(place)], check=True)
    place.rmdir()


def test_a_full_disk_makes_scans_wait_and_recording_goes_on_when_there_is_room(small_disk):
    notes = Notes()
    with open_store(str(small_disk / "s.sqlite"), busy_s=0.2) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        outbox.start()
        outbox.put(batch(key, 0))
        wait_until(lambda: notes.acknowledged)
        with (small_disk / "ballast").open("wb", buffering=0) as ballast, suppress(OSError):
            while ballast.write(b"x" * 4096) == 4096:
                pass
        put = count(1)  # until the room that the file and its log still hold is used up

        def is_full():
            for n in islice(put, 100):
                outbox.put(batch(key, n))
            return outbox.trouble

        wait_until(is_full)
        last = next(put)
        assert "free space on the disk" in notes.journalled[0][1]
        assert store.newest_scan_number("lab") == max(notes.acknowledged)
        (small_disk / "ballast").unlink()
        wait_until(lambda: len(notes.acknowledged) == last)
        outbox.close()
        assert numbers(store) == notes.acknowledged == list(range(last))


def test_a_disk_that_turns_read_only_makes_scans_wait_until_it_is_mended(small_disk):
    notes = Notes()

    def remount(mode):
        subprocess.run(["mount", "-o", f"remount,{mode}", str(small_disk)], check=True)

    with open_store(str(small_disk / "s.sqlite"), busy_s=0.2) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        outbox.start()
        outbox.put(batch(key, 0))
        wait_until(lambda: notes.acknowledged)
        store.database.close()  # the kernel refuses to remount while a file is open for writing
        remount("ro")
        try:
            for n in range(1, 30):
                outbox.put(batch(key, n))
            wait_until(lambda: outbox.trouble)
            assert notes.journalled[0][0] == "alarm"
            assert "its disk is not mounted read-only" in notes.journalled[0][1]
            assert notes.acknowledged == [0]
        finally:
            remount("rw")
        wait_until(lambda: len(notes.acknowledged) == 30)
        outbox.close()
        assert numbers(store) == list(range(30))


def test_a_store_that_may_not_be_written_says_so(tmp_path):
    path = tmp_path / "s.sqlite"
    open_store(str(path)).close()
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA journal_mode=DELETE")
    connection.close()
    with open_store(str(path)) as store:
        with store.database.engine.connect() as raw:
            raw.exec_driver_sql("PRAGMA query_only=ON")
        with pytest.raises(StoreUnavailable, match="no permission to write; check owner and mount"):
            store.beat("record", {})


values = st.floats(allow_nan=False, allow_infinity=False)


@given(
    reading=st.lists(st.tuples(values, st.sampled_from(list(Quality))), min_size=2, max_size=2),
    moment=values,
    note=st.text(max_size=10),
)
@settings(max_examples=60, deadline=None)
def test_a_buffered_write_batch_comes_back_as_it_was(reading, moment, note):
    channels = (Channel("top_1"), Channel("closed", ""))
    from daq.store import PressKey

    item = WriteBatch(
        PressKey(3, "lab", 4, channels, 17),
        (Scan(17, BEGAN, moment, tuple(v for v, _ in reading), tuple(q for _, q in reading)),),
        (PressEvent(PressEventKind.CLOSED, moment, 1.0, "limit switch"),),
        NewRun("r", 12, BEGAN, moment, {"panel.material": note, "x": 1.5}, "text"),
        RunEnd("q", 11, BEGAN),
    )
    assert decode_item(encode_item(item)) == item
    entry = Entry("warning", "record", say("plain-text", text=note), "lab", {"step_s": 1.0})
    assert decode_item(encode_item(entry)) == entry


def test_a_store_that_is_back_as_the_writer_ends_takes_the_last_line_too(tmp_path, monkeypatch):
    monkeypatch.setattr(outbox_module, "_FIRST_RETRY_S", 600.0)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        notes = Notes()

        def journal(level, message):
            notes.journal(level, message)
            outbox.put(Entry(level, "record", message))

        outbox = Outbox(store, journal=journal)
        key = store.register_press("lab", CHANNELS)
        with store.database.writing() as connection:
            connection.execute(text("ALTER TABLE press RENAME TO elsewhere"))
        outbox.put(batch(key, 0))
        outbox.start()
        wait_until(lambda: outbox.trouble)
        with store.database.writing() as connection:
            connection.execute(text("ALTER TABLE elsewhere RENAME TO press"))
        outbox.close()
        assert numbers(store) == [0]
        assert "takes data again" in str(store.journal().items[0].message)
    assert len([level for level, _ in notes.journalled if level == "alarm"]) == 1


def test_a_run_whose_first_scans_found_no_room_keeps_the_rest_and_is_backed_up(tmp_path, monkeypatch):
    monkeypatch.setattr(outbox_module, "_MOST_WAITING", 30)
    notes = Notes()
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, journal=notes.journal)
        begins = {3: NewRun("lost", 1, BEGAN, 100.1), 30: NewRun("a", 25, BEGAN, 102.5)}
        ends = {20: RunEnd("lost", 20, BEGAN, first_scan=1), 95: RunEnd("a", 95, BEGAN, first_scan=25)}
        for n in range(100):
            outbox.put(replace(batch(key, n), begin=begins.get(n), end=ends.get(n)))
        outbox.start()
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        run = store.run_record("a")
        assert (run.status, run.first_scan, run.last_scan) == (RunStatus.INTERRUPTED, 70, 95)
        assert len(store.load_run("a").time_s) == 26
        assert store.run_record("lost").status is RunStatus.INTERRUPTED
        assert store.back_up(tmp_path / "backup.sqlite").runs == 2
    assert [level for level, text in notes.journalled if "dropped" in text] == ["alarm"]
