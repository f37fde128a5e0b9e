"""Damage beside a healthy store, and items no store takes: recording goes on, and all of it is told."""

import json
import logging
import random
import re
import shutil
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from daq.store import NewRun, StoreUnavailable, open_store
from daq.store.buffer import Buffer
from daq.store.buffer_file import open_file
from daq.store.outbox import Outbox
from daq.store.session_placement import session_key
from daq.store.waiting import open_when_ready
from daq.store.write_batch import Entry
from daq.words import say
from tests.daq.test_store_outbox import BEGAN, CHANNELS, Notes, batch, numbers, small_disk  # noqa: F401
from tests.patience import wait_until


def spoil(path, offset, count, with_):
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(with_ * count)


def filled(path, count, key):
    buffer = Buffer(path)
    buffer.append([batch(key, n) for n in range(count)])
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return buffer


def test_scans_half_as_often_take_twice_as_long_to_fill_the_disk(tmp_path):
    buffer = Buffer(tmp_path / "b.sqlite")
    buffer.expect(100_000)
    free_MB = shutil.disk_usage(tmp_path).free / 1e6
    # 1 MB a second, of which the file takes 1.3 times as much
    assert buffer.hours_left(10.0) == pytest.approx(free_MB / 1.3 / 3600.0, rel=0.01)
    assert buffer.hours_left(5.0) == pytest.approx(2.0 * buffer.hours_left(10.0), rel=0.01)


DAMAGE = {
    "garbage": lambda path: path.write_bytes(random.Random(1).randbytes(60_000)),
    "a torn page": lambda path: spoil(path, 4096 * 9, 4096, b"\xa5"),
    "a flipped bit in a value": lambda path: spoil(path, path.read_bytes().rfind(b"200.0"), 1, b"3"),
    "cut short": lambda path: path.write_bytes(path.read_bytes()[:40_000]),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("running", [False, True], ids=["at start", "while running"])
def test_a_damaged_buffer_is_set_aside_and_recording_goes_on_into_the_store(tmp_path, damage, running):
    path, notes = tmp_path / "b.sqlite", Notes()
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", CHANNELS)
        filled(path, 300, key)
        if not running:
            DAMAGE[damage](path)
        outbox = Outbox(store, buffer=path, acknowledged=notes.note, journal=notes.journal)
        if running:
            DAMAGE[damage](path)
        outbox.start()
        for n in range(300, 330):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.waiting == 0 and notes.acknowledged[-1:] == [329])
        outbox.close()
        kept = numbers(store)
        assert set(range(300, 330)) <= set(kept)
        assert len(kept) >= (30 if damage == "garbage" else 100)
        assert all(s.values[0] == 200.0 for s in store.scans_after("lab", -1, 1000).scans)
    alarms = [text for level, text in notes.journalled if level == "alarm"]
    assert alarms
    assert all(str(path) in text for text in alarms)
    named = [one for one in tmp_path.iterdir() if ".damaged-" in one.name or one.name.endswith(".jsonl")]
    assert any(str(one) in text for one in named for text in alarms)
    found = re.search(r"(\d+) entries could be read and go on[,;] .*?(\d+)( at least| are lost)", alarms[0])
    if found is None:
        assert damage == "a flipped bit in a value"
        assert len(kept) == 329
    else:
        unreadable = sum("checksum" in text for text in alarms)
        assert int(found[1]) == len(kept) - 30 + unreadable
        gone = 300 - int(found[1])
        assert found[3] == (" are lost" if running else " at least")
        assert int(found[2]) == gone if running or damage == "a torn page" else int(found[2]) <= gone


def fill(ballast):
    with ballast.open("ab", buffering=0) as file, suppress(OSError):
        while file.write(b"x" * 512) == 512:
            pass


def entries(texts):
    return [Entry("info", "record", say("plain-text", text=text), "lab") for text in texts]


def drained(buffer):
    found = []
    while rows := buffer.oldest(50):
        found += [str(item.message) for _, item in rows]
        buffer.remove(rows[-1][0])
    return found


@pytest.mark.parametrize("room_again", [True, False], ids=["room again", "still full"])
def test_a_full_disk_costs_a_buffer_nothing_of_what_waits_in_it(small_disk, room_again):  # noqa: F811
    alarms, texts = [], [f"{n} {'x' * 500}" for n in range(40)]
    buffer, ballast = Buffer(small_disk / "b.sqlite", alarms.append), small_disk / "ballast"
    buffer.append(entries(texts))
    fill(ballast)
    for _ in range(3):
        with pytest.raises(sqlite3.OperationalError, match="full"):
            buffer.append(entries("x" * 10_000))
    if room_again:
        ballast.unlink()
        buffer.append(entries(["more"]))
        texts.append("more")
    assert drained(buffer) == texts
    assert not alarms


def test_a_buffer_that_is_damaged_on_a_full_disk_is_salvaged_when_there_is_room(small_disk):  # noqa: F811
    alarms, texts = [], [f"{n} {'x' * 500}" for n in range(400)]
    path, ballast = small_disk / "b.sqlite", small_disk / "ballast"
    buffer = Buffer(path, alarms.append)
    buffer.append(entries(texts))
    spoil(path, 4096 * 9, 4096, b"\xa5")
    fill(ballast)
    for _ in range(3):
        with suppress(sqlite3.Error):
            buffer.append(entries(["too much"] * 100))
    ballast.unlink()
    buffer.append(entries(["more"]))
    found = drained(buffer)
    assert len(found) > 390
    assert found[-1] == "more"
    assert [one.code for one in alarms] == ["buffer-damaged"]
    assert alarms[0].arguments["lost"] == 401 - len(found)


def full_disk_with(what, disk, key):
    """Fill a disk on which there is no buffer yet, an empty one, or one that waits to be written."""
    if what != "no file":
        buffer = Buffer(disk / "b.sqlite")
        buffer.sessions[-5] = {"channels": [], "press_file": ""}
        if what == "entries waiting":
            buffer.append([batch(key, n) for n in range(300)] + entries(["from before"]))
    fill(disk / "ballast")


@pytest.mark.parametrize("before", ["no file", "a file with nothing in it", "entries waiting"])
def test_a_recorder_that_starts_while_its_buffers_disk_is_full_records_to_a_store_that_is_well(
    store_url,
    small_disk,  # noqa: F811
    monkeypatch,
    before,
):
    notes, first = Notes(), 300 if before == "entries waiting" else 0
    with open_store(store_url) as store:
        full_disk_with(before, small_disk, store.register_press("lab", CHANNELS))
        for start in range(2):  # the second finds what the first could not remove
            outbox = Outbox(store, buffer=small_disk / "b.sqlite", acknowledged=notes.note, journal=notes.journal)
            key = outbox.later_key("lab", CHANNELS, "press file")
            outbox.start()
            for n in range(100):
                outbox.put(batch(key, n))
            wait_until(lambda: store.newest_scan_number("lab") + 1 == first + 100 * (start + 1))  # noqa: B023
            if start == 0:
                outbox.close()
        kept = store.scans_after("lab", -1, 1000).scans
        assert [scan.number for scan in kept] == list(range(first + 200))
        assert [scan.values[1] - 20.0 for scan in kept] == [*range(first), *range(100), *range(100)]
        lines = [str(e.message) for e in store.journal(limit=100).items if e.message.code == "plain-text"]
        assert lines == (["from before"] if first else [])
        alarms = [text for level, text in notes.journalled if level == "alarm"]
        assert all(str(small_disk / "b.sqlite") in text for text in alarms)
        assert alarms or before != "no file"
        write = store.write_batches
        monkeypatch.setattr(store, "write_batches", refuse)
        (small_disk / "ballast").unlink()
        for n in range(100, 150):
            outbox.put(batch(key, n))
        wait_until(lambda: notes.acknowledged[-1:] == [149])
        assert outbox.capacity.code == "waits-in-buffer"
        monkeypatch.setattr(store, "write_batches", write)
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert numbers(store) == list(range(first + 250))


def refuse(*items):
    raise StoreUnavailable(say("plain-text", text="away"))


def test_a_store_whose_first_page_is_destroyed_does_not_keep_a_recorder_from_recording(tmp_path):
    path, notes = tmp_path / "s.sqlite", Notes()
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        store.write_batches([batch(key, n) for n in range(10)])
    sound = path.read_bytes()
    spoil(path, 0, 4096, b"\xa5")
    with open_store(str(path), later=True) as store:
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        key = outbox.later_key("lab", CHANNELS, "press file")
        outbox.start()
        for n in range(20):
            outbox.put(batch(key, n))
        wait_until(lambda: notes.journalled)
        (level, text) = notes.journalled[0]
        assert level == "alarm"
        assert str(path) in text
        assert "kerntemp backup --restore" in text
        assert "scans wait in memory" in text
        path.write_bytes(sound)
        wait_until(lambda: outbox.waiting == 0 and len(notes.acknowledged) == 20)
        outbox.close()
        assert numbers(store) == list(range(30))


def test_a_service_waits_for_a_store_whose_first_page_is_destroyed_and_begins_once_it_is_restored(
    tmp_path, caplog
):
    path, stop = tmp_path / "s.sqlite", threading.Event()
    with open_store(str(path)) as store:
        store.register_press("lab", CHANNELS)
    sound = path.read_bytes()
    spoil(path, 0, 4096, b"\xa5")
    with ThreadPoolExecutor(1) as waiting:
        opened = waiting.submit(open_when_ready, str(path), stop, logging.getLogger("waiting"))
        wait_until(lambda: "kerntemp backup --restore" in caplog.text)
        path.write_bytes(sound)
        with opened.result(60) as store:
            assert [channel.name for channel in store.channels("lab")] == [channel.name for channel in CHANNELS]


def test_a_sign_of_life_that_the_store_alone_refuses_is_told_once_and_scans_go_on(tmp_path):
    path, notes = tmp_path / "s.sqlite", Notes()
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        store.beat("record", {"x": 0})
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        found = "SELECT rootpage FROM sqlite_master WHERE name = 'sqlite_autoindex_status_1'"
        (root,) = connection.execute(found).fetchone()
    spoil(path, 4096 * (root - 1), 4096, b"\xa5")
    with open_store(str(path)) as store:
        outbox = Outbox(store, acknowledged=notes.note, journal=notes.journal)
        outbox.start()
        for n in range(5):
            outbox.beat("record", {"x": n})
            outbox.put(batch(key, n))
            wait_until(lambda: len(notes.acknowledged) == n + 1 and outbox._beat is None)  # noqa: B023
        outbox.close()
        assert numbers(store) == list(range(5))
    ((level, text),) = notes.journalled
    assert level == "alarm"
    assert str(path) in text
    assert "sign of life" in text
    assert "kerntemp backup --restore" in text
    assert "scans wait" not in text


def test_the_salvage_of_a_buffer_that_is_cut_short_ends_wherever_it_is_cut(tmp_path):
    alarms, path = [], tmp_path / "b.sqlite"
    texts = [f"{n} {'x' * 300}" for n in range(400)]
    Buffer(path).append(entries(texts))
    whole = path.read_bytes()
    for length in range(3 * 4096, len(whole), 5555):
        path.write_bytes(whole[:length])
        found = drained(Buffer(path, alarms.append))
        assert set(found) <= set(texts)
        assert len(found) == len(set(found))
    assert alarms


def full_of(folder, texts):
    """Return a buffer with entries: its file, itself, and the alarms it gives."""
    path, alarms = folder / "b.sqlite", []
    buffer = Buffer(path, alarms.append)
    buffer.append(entries(texts))
    return path, buffer, alarms


@pytest.fixture
def keeps_what_was_deleted(monkeypatch):
    """An SQLite that was built to leave in free pages what stood there, whatever this machine's does."""
    connect = sqlite3.connect

    def connected(*words, **options):
        connection = connect(*words, **options)
        connection.execute("PRAGMA secure_delete=OFF")
        return connection

    monkeypatch.setattr(sqlite3, "connect", connected)


@pytest.mark.usefixtures("keeps_what_was_deleted")
@pytest.mark.parametrize("running", [False, True], ids=["at start", "while running"])
@pytest.mark.parametrize("pages", [(0,), (1,), (0, 1)], ids=["first", "root", "both"])
def test_of_a_buffer_whose_first_or_root_page_is_destroyed_all_that_was_not_delivered_goes_on(
    tmp_path, pages, running
):
    texts = [f"{n} {'x' * 250}" for n in range(400)]
    path, buffer, alarms = full_of(tmp_path, texts)
    buffer.sessions[-7] = {"channels": [["top_1", "C"]], "press_file": "press file"}
    buffer.remove(buffer.oldest(150)[-1][0])
    for page in pages:
        spoil(path, 4096 * page, 4096, b"\xa5")
    signs = []
    if not running:
        buffer = Buffer(path, alarms.append, lambda: signs.append(None))
    assert drained(buffer) == texts[150:]
    assert running or len(signs) > 250  # a large one takes minutes, and who is at work must not count as standing
    assert dict(buffer.sessions) == {-7: {"channels": [["top_1", "C"]], "press_file": "press file"}}
    code = "buffer-damaged" if running else "buffer-damaged-uncounted"
    assert [(one.code, one.arguments["kept"], one.arguments["lost"]) for one in alarms] == [(code, 250, 0)]
    assert not list(tmp_path.glob("*.pages*"))


def test_rows_in_the_log_that_a_kill_left_are_salvaged_too(tmp_path):
    texts = [f"{n} {'x' * 900}" for n in range(59)]
    path, _, alarms = full_of(tmp_path, texts[:58])  # whose last page has room for one more, outside of the log
    killed = tmp_path / "killed.sqlite"
    Buffer(tmp_path / "late.sqlite").append(entries(texts[58:]))
    with closing(sqlite3.connect(tmp_path / "late.sqlite")) as connection:
        late = connection.execute("SELECT content FROM parcel").fetchone()
    with closing(open_file(path)) as connection:
        connection.execute("INSERT INTO parcel VALUES (59, ?)", late)
        for ending in ("", "-wal"):
            shutil.copy(f"{path}{ending}", f"{killed}{ending}")
    spoil(killed, 0, 8192, b"\xa5")
    assert drained(Buffer(killed, alarms.append)) == texts
    assert [(one.code, one.arguments["kept"]) for one in alarms] == [("buffer-damaged-uncounted", 59)]


def put_note(path, session, content):
    """Have a buffer's file hold anything as the one note of a session, outside of its log."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.executescript("DROP TABLE session; CREATE TABLE session (session INTEGER PRIMARY KEY, content)")
        connection.execute("INSERT INTO session VALUES (?, ?)", (session, content))
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


@pytest.mark.parametrize("content", [None, "", "12", "[", b"\xff", '{"channels": 3'], ids=repr)
def test_a_note_of_a_session_that_cannot_be_read_keeps_no_recorder_from_recording(tmp_path, content):
    path, notes = tmp_path / "b.sqlite", Notes()
    with open_store(str(tmp_path / "s.sqlite")) as store:
        buffer = Buffer(path)
        key = session_key(buffer.sessions, "lab", CHANNELS, "press file")
        buffer.append([batch(key, n) for n in range(50)])
        put_note(path, key.press_id, content)
        outbox = Outbox(store, buffer=path, acknowledged=notes.note, journal=notes.journal)
        later = outbox.later_key("lab", CHANNELS, "press file")
        outbox.start()
        for n in range(30):
            outbox.put(batch(later, n))
        wait_until(lambda: numbers(store) == list(range(80)))
        outbox.close()
    assert not notes.journalled


def test_a_damaged_buffer_is_salvaged_though_a_note_in_it_cannot_be_read(tmp_path):
    texts = [f"{n} {'x' * 500}" for n in range(100)]
    path, buffer, alarms = full_of(tmp_path, texts)
    put_note(path, -5, None)
    spoil(path, 4096 * 7, 4096, b"\xa5")
    found = drained(buffer)
    assert 80 < len(found) < 100
    assert [(one.code, one.arguments["lost"]) for one in alarms] == [("buffer-damaged", 100 - len(found))]


def test_what_is_being_written_when_a_buffer_is_damaged_is_neither_lost_nor_counted_as_lost(tmp_path):
    texts = [f"{n} {'x' * 500}" for n in range(100)]
    path, buffer, alarms = full_of(tmp_path, texts)
    rows = buffer.oldest(40)
    path.write_bytes(random.Random(1).randbytes(9000))
    buffer.remove(rows[-1][0])
    assert drained(buffer) == []
    assert [(one.code, one.arguments["lost"]) for one in alarms] == [("buffer-damaged", 60)]
    buffer.append(entries(texts))
    buffer.oldest(40)
    path.write_bytes(random.Random(1).randbytes(9000))
    buffer.sessions[-7] = {"channels": [], "press_file": ""}  # found out while these are on their way
    assert drained(buffer) == texts[:40]
    assert [one.arguments["lost"] for one in alarms] == [60, 60]


def test_entries_that_cannot_be_read_are_reported_together_and_once_however_often_they_are_read(tmp_path):
    texts = [f"{n}" for n in range(100)]
    path, buffer, alarms = full_of(tmp_path, texts)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE parcel SET content = 'x' WHERE number % 10 = 1")
    for _ in range(3):  # the store takes nothing yet
        assert len(buffer.oldest(100)) == 90
    assert drained(buffer) == [text for n, text in enumerate(texts) if n % 10]
    ((code, count, aside),) = [(a.code, a.arguments["count"], a.arguments["aside"]) for a in alarms]
    assert (code, count) == ("buffer-rows-unreadable", 10)
    assert len(Path(aside).read_text().splitlines()) == 10


def test_a_buffer_whose_folder_is_removed_is_made_anew_and_told(tmp_path):
    folder, notes = tmp_path / "buffer", Notes()
    folder.mkdir()
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", CHANNELS)
        filled(folder / "b.sqlite", 50, key)
        outbox = Outbox(store, buffer=folder / "b.sqlite", acknowledged=notes.note, journal=notes.journal)
        for file in folder.iterdir():
            file.unlink()
        folder.rmdir()
        outbox.start()
        for n in range(50, 80):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.waiting == 0 and len(notes.acknowledged) == 30)
        outbox.close()
        assert numbers(store) == list(range(50, 80))
    (alarm,) = [text for level, text in notes.journalled if level == "alarm"]
    assert str(folder / "b.sqlite") in alarm
    assert "50 entries are lost" in alarm


def test_a_header_and_a_journal_line_no_store_takes_are_set_aside_and_all_else_is_written(store_url, tmp_path):
    notes = Notes()
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, buffer=tmp_path / "b.sqlite", acknowledged=notes.note, journal=notes.journal)
        begin = NewRun("lab-1", 0, BEGAN, 100.0, {"panel.material": "M\0DF", "panel.thickness_mm": 16.0})
        outbox.put(replace(batch(key, 0), begin=begin))
        outbox.put(Entry("info", "record", say("plain-text", text="half \ud800 of a character")))
        for n in range(1, 20):
            outbox.put(batch(key, n))
        outbox.start()
        wait_until(lambda: outbox.waiting == 0 and len(notes.acknowledged) == 20)
        outbox.close()
        assert numbers(store) == list(range(20))
        (run,) = store.runs().items
        assert (run.run, run.header["panel.thickness_mm"]) == ("lab-1", 16.0)
        lines = [e.message.code for e in store.journal().items]
    alarms = [text for level, text in notes.journalled if level == "alarm"]
    aside = tmp_path / "b.sqlite.set-aside.jsonl"
    kept = [json.loads(line)["content"] for line in aside.read_text().splitlines()] if aside.exists() else []
    if "postgresql" in store_url:
        assert any("M\\\\u0000DF" in text for text in kept)
        assert any("lab-1" in text and str(aside) in text for text in alarms)
    assert any("half" in text for text in kept)
    assert "line-set-aside" in lines


@pytest.mark.parametrize("away", [False, True])
def test_a_header_that_cannot_be_written_is_set_aside_and_all_else_goes_on(away, tmp_path, monkeypatch):
    notes = Notes()
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", CHANNELS)
        outbox = Outbox(store, buffer=tmp_path / "b.sqlite", acknowledged=notes.note, journal=notes.journal)
        header = {"panel.thickness_mm": 16.0, "setting.x": [10**5000, 2], "setting.y": 1.0}
        outbox.put(replace(batch(key, 0), begin=NewRun("lab-1", 0, BEGAN, 100.0, header)))
        outbox.put(Entry("info", "record", say("plain-text", text="beside"), detail={"number": 10**5000}))
        for n in range(1, 20):
            outbox.put(batch(key, n))
        if away:
            write, tried = store.write_batches, []

            def refuse(*items):
                tried.append(items)
                if len(tried) < 2:
                    raise StoreUnavailable(say("plain-text", text="away"))
                return write(*items)

            monkeypatch.setattr(store, "write_batches", refuse)
        outbox.start()
        wait_until(lambda: outbox.waiting == 0 and len(notes.acknowledged) == 20)
        assert outbox.stalled() is None
        outbox.close()
        assert numbers(store) == list(range(20))
        (run,) = store.runs().items
        assert (run.run, run.header["panel.thickness_mm"], run.header["setting.y"]) == ("lab-1", 16.0, 1.0)
        assert "setting.x" not in run.header
        assert "line-set-aside" in [e.message.code for e in store.journal().items]
    aside = tmp_path / "b.sqlite.set-aside.jsonl"
    kept = [json.loads(line)["content"] for line in aside.read_text().splitlines()]
    assert len([text for text in kept if "lab-1" in text and f"[{hex(10**5000)}, 2]" in text]) == 1
    assert any("beside" in text for text in kept)
    alarms = [text for level, text in notes.journalled if level == "alarm"]
    assert any("lab-1" in text and str(aside) in text for text in alarms)
    assert away == any("away" in text for text in alarms)
