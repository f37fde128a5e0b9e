"""Another state of the store under a running writer: emptied, restored, another one. Told, and nothing is lost."""

import math
import os
import shutil
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
from sqlalchemy import create_engine, text

from daq.records import Channel, EventSource, PressEvent, PressEventKind
from daq.store import NewRun, RunEnd, RunStatus, open_store
from daq.store import outbox as outbox_module
from daq.store.buffer_file import opened, sealed
from daq.store.outbox import Outbox
from daq.store.write_batch import WriteBatch
from tests.daq.test_store_outbox import BEGAN, CHANNELS, Notes, batch, numbers
from tests.patience import wait_until

PRESS_FILE = "[press]\nname = 'lab'\n"


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    monkeypatch.setattr(outbox_module, "_FIRST_RETRY_S", 0.05)
    monkeypatch.setattr(outbox_module, "_LONGEST_RETRY_S", 0.05)


def server(url, *statements):
    """Run statements as the server's administrator would, each at once."""
    engine = create_engine(url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        for statement in statements:
            connection.execute(text(statement))
    engine.dispose()


def empty(url):
    server(url, "DROP SCHEMA public CASCADE", "CREATE SCHEMA public")


@contextmanager
def restoring(url):
    """Fill a store beside the one that is empty, then put it in its place at once, as a restore does."""
    server(url, "CREATE SCHEMA backup")
    with open_store(f"{url}?options=-csearch_path%3Dbackup") as beside:
        yield beside
    server(url, "DROP SCHEMA public CASCADE; ALTER SCHEMA backup RENAME TO public")


def started(store, folder, buffered=True):
    notes = Notes()
    outbox = Outbox(
        store,
        buffer=folder / "b.sqlite" if buffered else None,
        acknowledged=notes.note,
        journal=notes.journal,
    )
    outbox.expect(CHANNELS, "lab", PRESS_FILE)
    outbox.start()
    return outbox, notes


def recorded(store, folder, scans):
    """Have a recorder write so many scans of a press, and end; return the press's key."""
    key = store.register_press("lab", CHANNELS)
    outbox, _ = started(store, folder)
    for n in range(scans):
        outbox.put(batch(key, n))
    outbox.close()
    return key


def pressing(key, first, last):
    """Return the batches of a run over scans."""
    made = [batch(key, n) for n in range(first, last + 1)]
    begin, end = NewRun(f"lab-{first}", first, BEGAN, 1e2 + first / 10), RunEnd(f"lab-{first}", last, BEGAN)
    made[0] = WriteBatch(key, made[0].scans, begin=begin)
    return [*made, WriteBatch(key, end=end)]


def told(notes):
    return [words for level, words in notes.journalled if level == "alarm"]


def test_while_a_server_s_database_is_restored_scans_and_runs_wait_and_none_is_set_aside(postgresql_url, tmp_path):
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path)
        for n in range(10):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.written == 10 and outbox.waiting == 0)
        empty(postgresql_url)
        for one in pressing(key, 10, 19):
            outbox.put(one)
        wait_until(lambda: notes.acknowledged == list(range(20)))
        assert outbox.behind
        (away,) = told(notes)
        assert "its tables are missing" in away
        with restoring(postgresql_url) as restored:
            again = restored.register_press("lab", CHANNELS)
            assert (again.press_id, again.layout_id) == (key.press_id, key.layout_id)
            begun = NewRun("lab-3", 3, BEGAN, 100.3)  # the backup is older: it does not have the end of this one
            restored.append_scans(again, [batch(key, n).scans[0] for n in range(8)], begin=begun)
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert numbers(store) == [*range(8), *range(10, 20)]
        assert store.load_run("lab-10").columns["top_1"].tolist() == [30.0 + n for n in range(10)]
        left = store.run_record("lab-3")
        assert (left.status, left.last_scan) == (RunStatus.INTERRUPTED, 7)
        assert store.run_record("lab-10").status is RunStatus.CLOSED
        assert any("scans 8 to 9 of press lab" in alarm for alarm in told(notes))
    assert not list(tmp_path.glob("*set-aside*"))


@pytest.mark.parametrize("buffered", [False, True], ids=["in memory", "in the buffer file"])
def test_a_store_without_the_press_takes_it_again_and_recording_goes_on_there(postgresql_url, tmp_path, buffered):
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path, buffered)
        for n in range(10):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.written == 10 and outbox.waiting == 0)
        empty(postgresql_url)
        with open_store(postgresql_url) as other:
            hall = other.register_press("hall", CHANNELS)  # it has the number that lab had
            assert hall.press_id == key.press_id
        for one in pressing(key, 10, 19):
            outbox.put(one)
        wait_until(lambda: store.runs().items and outbox.waiting == 0)
        outbox.close()
        assert numbers(store) == list(range(10, 20))
        assert store.newest_scan_number("hall") == -1
        assert store.load_run("lab-10").columns["top_1"].tolist() == [30.0 + n for n in range(10)]
        assert store.presses()["lab"] == PRESS_FILE
        assert any("press lab is not in it any more" in alarm for alarm in told(notes))
    assert not list(tmp_path.glob("*set-aside*"))


@pytest.mark.parametrize("order", [("hall", "lab"), ("lab", "hall")], ids=["hall first", "lab first"])
@pytest.mark.parametrize("away", [False, True], ids=["at once", "after an outage"])
def test_presses_whose_numbers_another_store_has_exchanged_get_their_own_scans(
    postgresql_url, tmp_path, order, away
):
    first = {"lab": 0, "hall": 1000}
    with open_store(postgresql_url) as store:
        keys = {press: store.register_press(press, CHANNELS) for press in ("lab", "hall")}
        outbox, notes = started(store, tmp_path)
        for press in order:
            outbox.put(batch(keys[press], first[press]))
        wait_until(lambda: outbox.written == 2 and outbox.waiting == 0)
        with restoring(postgresql_url) as other:
            for press in ("hall", "lab"):
                other.register_press(press, CHANNELS)
            if away:
                server(postgresql_url, "ALTER TABLE press RENAME TO elsewhere")
                outbox.beat("record", {"x": 1})
            outbox.put(batch(keys[order[0]], first[order[0]] + 1))
            if away:
                wait_until(lambda: outbox.trouble)
        more = [*order, order[0]]
        for n, press in enumerate(more, 2):
            outbox.put(batch(keys[press], first[press] + n))
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        own = {press: [scan.number for scan in store.scans_after(press, -1, 9).scans] for press in order}
    assert own[order[0]][-2:] == [first[order[0]] + 2, first[order[0]] + 4]
    assert own[order[1]] == [first[order[1]] + 3]
    for press in order:
        assert any(f"press {press} is not in it any more" in alarm for alarm in told(notes))
    assert not any("has gone back" in alarm for alarm in told(notes))


@pytest.mark.parametrize(
    ("refusing", "taking", "words"),
    [
        ("ALTER DATABASE {name} SET default_transaction_read_only = on", "RESET", "as a standby does"),
        (
            "ALTER TABLE press_event RENAME TO elsewhere",
            "ALTER TABLE elsewhere RENAME TO press_event",
            "is missing",
        ),
    ],
    ids=["read-only", "without a table"],
)
def test_a_server_that_refuses_whatever_it_is_given_has_all_of_it_wait(
    postgresql_url, tmp_path, refusing, taking, words
):
    name = postgresql_url.rpartition("/")[2]
    others = f"datname = '{name}' AND pid <> pg_backend_pid()"
    anew = f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE {others}"
    if taking == "RESET":
        taking = (
            f"SET default_transaction_read_only = off; ALTER DATABASE {name} RESET default_transaction_read_only"
        )
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path)
        outbox.put(batch(key, 0))
        wait_until(lambda: outbox.written == 1 and outbox.waiting == 0)
        server(postgresql_url, refusing.format(name=name), anew)
        outbox.beat("record", {"x": 1})
        moved = PressEvent(PressEventKind.CLOSED, 101.0, 101.5, EventSource.TEMPERATURES)
        for one in pressing(key, 1, 9):
            outbox.put(replace(one, events=(moved,)) if one.begin else one)
        wait_until(lambda: any(words in alarm for alarm in told(notes)))
        wait_until(lambda: notes.acknowledged == list(range(10)))
        server(postgresql_url, *taking.split("; "), anew)
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert numbers(store) == list(range(10))
        assert store.load_run("lab-1").columns["top_1"].tolist() == [21.0 + n for n in range(9)]
        assert len(store.press_events("lab")) == 1
    assert not list(tmp_path.glob("*set-aside*"))
    assert not any("report it" in alarm for alarm in told(notes))


def test_a_server_that_took_over_without_the_newest_scans_is_told_with_their_numbers(store_url, tmp_path):
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path, buffered=False)
        for n in range(30):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.written == 30 and outbox.waiting == 0)
        server(store_url if "://" in store_url else f"sqlite:///{store_url}", "DELETE FROM scan WHERE number > 19")
        for n in range(30, 40):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.written == 40)
        outbox.close()
        assert numbers(store) == [*range(20), *range(30, 40)]
    (alarm,) = told(notes)
    assert "scans 20 to 29 of press lab" in alarm


def test_what_waits_behind_another_recorder_s_scans_follows_once_that_one_has_ended(
    postgresql_url, tmp_path, monkeypatch
):
    monkeypatch.setattr(outbox_module, "STALLED_S", 0.5)
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path)
        for n in range(10):
            store.append_scans(key, [batch(key, n).scans[0]])
        for one in pressing(key, 0, 9):
            others = tuple(replace(scan, monotonic_s=scan.monotonic_s + 5e3) for scan in one.scans)
            outbox.put(replace(one, scans=others))
        wait_until(lambda: told(notes))
        for n in range(10, 20):
            store.append_scans(key, [batch(key, n).scans[0]])
            time.sleep(0.1)
        assert outbox.behind  # while the other one records, this one waits
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert [scan.monotonic_s > 5e3 for scan in store.scans_after("lab", -1, 99).scans] == [False] * 20 + [
            True
        ] * 10
        run = store.run_record("lab-0")
        assert (run.status, run.first_scan, run.last_scan) == (RunStatus.CLOSED, 20, 29)
        assert any("stop one of them" in alarm for alarm in told(notes))
        assert any(level == "warning" and "after its scans" in text for level, text in notes.journalled)
    assert not list(tmp_path.glob("*set-aside*"))


def moved(key, kind, number):
    return WriteBatch(
        key, events=(PressEvent(kind, 1e2 + number / 10, 1e2 + number / 10, EventSource.TEMPERATURES),)
    )


@pytest.mark.parametrize("under_way", [False, True], ids=["its end is lost", "it is under way"])
def test_a_run_that_an_older_state_shows_open_gets_no_moment_of_a_later_panel(store_url, tmp_path, under_way):
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path, buffered=False)
        made = pressing(key, 0, 19)
        later = () if under_way else (made[-1], *pressing(key, 20, 39)[:-1])
        for one in [*made[:-1], moved(key, PressEventKind.CLOSED, 5), *later]:
            outbox.put(one)
        wait_until(lambda: outbox.waiting == 0 and outbox.written == (20 if under_way else 40))
        address = store_url if "://" in store_url else f"sqlite:///{store_url}"
        again = "UPDATE run SET status = 'open', last_scan = NULL, ended_unix_s = NULL"
        server(address, "DELETE FROM scan WHERE number > 9", "DELETE FROM run WHERE first_scan > 9", again)
        for n in range(40, 50):
            outbox.put(batch(key, n))
        outbox.put(moved(key, PressEventKind.OPENED, 45))
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        run = store.run_record("lab-0")
        assert any("scans 10 to" in alarm for alarm in told(notes))
        if under_way:
            assert (run.status, run.moments.opened_s) == (RunStatus.OPEN, pytest.approx(4.5))
        else:
            assert (run.status, run.last_scan) == (RunStatus.INTERRUPTED, 9)
            assert math.isnan(run.moments.opened_s)


def test_what_an_older_state_lacks_is_told_also_by_a_later_process_with_the_buffer(postgresql_url, tmp_path):
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        first, _ = started(store, tmp_path)
        for n in range(20):
            first.put(batch(key, n))
        wait_until(lambda: first.written == 20 and first.waiting == 0)
        server(postgresql_url, "ALTER TABLE scan RENAME TO elsewhere")
        for n in range(20, 30):
            first.put(batch(key, n))
        wait_until(lambda: first.written == 30)
        first.close()
        server(postgresql_url, "ALTER TABLE elsewhere RENAME TO scan", "DELETE FROM scan WHERE number > 9")
        second, notes = started(store, tmp_path)
        wait_until(lambda: second.waiting == 0)
        second.close()
        assert numbers(store) == [*range(10), *range(20, 30)]
        assert any("scans 10 to 19 of press lab" in alarm for alarm in told(notes))


@pytest.mark.parametrize("state", ["older", "empty"])
def test_what_a_server_put_back_to_an_older_state_lacks_is_told_by_a_recorder_started_there(
    postgresql_url, tmp_path, state
):
    with open_store(postgresql_url) as store:
        recorded(store, tmp_path, 20)
        if state == "older":
            server(postgresql_url, "DELETE FROM scan WHERE number > 9")
        else:
            empty(postgresql_url)
    alarms = []
    for n in (10, 11):
        with open_store(postgresql_url) as store:
            key = store.register_press("lab", CHANNELS)
            later, notes = started(store, tmp_path)
            later.put(batch(key, n))
            later.close()
            alarms.append(told(notes))
    lost = "scans 10 to 19 of press lab" if state == "older" else "scans 0 to 19 of press lab"
    assert [[lost in alarm for alarm in one] for one in alarms] == [[True], []]


def test_a_disk_that_hangs_under_what_is_kept_for_a_later_process_holds_up_no_healthy_server(
    postgresql_url, tmp_path, monkeypatch
):
    hangs, free = threading.Event(), threading.Event()
    monkeypatch.setattr(os, "fsync", lambda file: (hangs.set(), free.wait()))
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path)
        put = iter(range(10000))

        def hanging():
            outbox.put(batch(key, next(put)))
            return hangs.is_set()

        try:
            wait_until(hanging)
            last = next(put)
            outbox.put(batch(key, last))
            wait_until(lambda: outbox.written == last + 1)
        finally:
            free.set()
        outbox.close()
        (kept,) = tmp_path.glob("*.written.json")
        assert f'"lab": [{last}, null]' in kept.read_text()
    assert notes.journalled == []


def test_of_another_store_or_by_a_damaged_file_nothing_is_said_to_have_gone_back(postgresql_url, tmp_path):
    with open_store(postgresql_url) as store:
        key = recorded(store, tmp_path, 20)
        server(postgresql_url, "DELETE FROM scan WHERE number > 9")
        (kept,) = tmp_path.glob("*.written.json")
        known = kept.read_text()
        others = sealed(opened(known).replace("postgresql", "elsewhere"))
        for content in (known.replace("19", "99"), known[:-9], "", others, sealed("[]")):
            kept.write_text(content)
            later, notes = started(store, tmp_path)
            later.put(batch(key, 10))
            later.close()
            assert told(notes) == []


def test_scans_that_were_given_up_are_not_said_to_have_gone_back_by_a_later_process(
    postgresql_url, tmp_path, monkeypatch
):
    monkeypatch.setattr(outbox_module, "_MOST_WAITING", 30)
    full = True
    append = outbox_module.Buffer.append

    def no_room(buffer, items):
        if full:
            raise OSError(28, "No space left on device")
        append(buffer, items)

    monkeypatch.setattr(outbox_module.Buffer, "append", no_room)
    with open_store(postgresql_url) as store:
        key = store.register_press("lab", CHANNELS)
        first, notes = started(store, tmp_path)
        made = pressing(key, 5, 99)
        for one in [*(batch(key, n) for n in range(5)), *made[:5]]:
            first.put(one)
        wait_until(lambda: first.written == 10 and first.waiting == 0)
        server(postgresql_url, "ALTER TABLE scan RENAME TO elsewhere")
        for one in [*made[5:-1], moved(key, PressEventKind.OPENED, 95)]:
            first.put(one)
        wait_until(lambda: first.lost > 50)
        full = False
        wait_until(lambda: first.behind)
        first.close()
        assert any("dropped" in alarm for alarm in told(notes))
        server(postgresql_url, "ALTER TABLE elsewhere RENAME TO scan")
        second, notes = started(store, tmp_path)
        second.put(made[-1])
        wait_until(lambda: second.waiting == 0)
        second.close()
        run = store.run_record("lab-5")
        assert (run.status, run.moments.opened_s) == (RunStatus.CLOSED, pytest.approx(9.0))
    assert told(notes) == []


@pytest.mark.parametrize("given_away", [False, True], ids=["gone", "given to another press"])
def test_scans_stand_under_their_own_channels_in_a_state_without_their_layout(store_url, tmp_path, given_away):
    more = (*CHANNELS, Channel("core_1", "C"))
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        hall = store.register_press("hall", CHANNELS)
        outbox, notes = started(store, tmp_path, buffered=False)
        wider = replace(key, channels=more)
        outbox.put(wide(wider, 0))
        wait_until(lambda: outbox.written == 1 and outbox.waiting == 0)
        newest = f"SELECT max(layout_id) FROM channel_layout WHERE press_id = {key.press_id}"
        gone = f"layout_id = ({newest})"
        given = (
            f'UPDATE channel_layout SET press_id = {hall.press_id}, columns_json = \'[["x", "C"]]\' WHERE {gone}'
        )
        drop = f"DELETE FROM channel_layout WHERE {gone}"
        address = store_url if "://" in store_url else f"sqlite:///{store_url}"
        server(address, "DROP VIEW scan_of_lab", "DELETE FROM scan", given if given_away else drop)
        for n in range(1, 10):
            outbox.put(wide(wider, n))
        wait_until(lambda: outbox.written == 10 and outbox.waiting == 0)
        outbox.close()
        read = store.scans_after("lab", -1, 100)
        assert [scan.number for scan in read.scans] == list(range(1, 10))
        assert [channel.name for channel in read.channels] == [channel.name for channel in more]
    assert not any("report it" in alarm for alarm in told(notes))


def wide(key, number):
    """Return a scan of as many values as a key has channels."""
    made = batch(key, number).scans[0]
    each = (made.values[0],) * len(key.channels), (made.qualities[0],) * len(key.channels)
    return WriteBatch(key, (replace(made, values=each[0], qualities=each[1]),))


def test_a_backup_put_in_the_place_of_an_emptied_file_is_gone_on_with(tmp_path):
    path = tmp_path / "s.sqlite"
    with open_store(str(path)) as store:
        key = store.register_press("lab", CHANNELS)
        outbox, notes = started(store, tmp_path, buffered=False)
        for n in range(10):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.written == 10 and outbox.waiting == 0)
        with open_store(str(tmp_path / "backup.sqlite")) as backup:
            again = backup.register_press("lab", CHANNELS)
            backup.append_scans(again, [batch(again, n).scans[0] for n in range(8)])
        os.truncate(path, 0)
        for n in range(10, 20):
            outbox.put(batch(key, n))
        wait_until(lambda: told(notes))
        assert outbox.written == 10
        path.rename(tmp_path / "emptied")
        shutil.copyfile(tmp_path / "backup.sqlite", path)
        wait_until(lambda: outbox.written == 20)
        outbox.close()
        assert numbers(store) == [*range(8), *range(10, 20)]
    assert any("recording goes on in what lies in its place now" in alarm for alarm in told(notes))
    assert any("scans 8 to 9 of press lab" in alarm for alarm in told(notes))
    assert not list(tmp_path.glob("*set-aside*"))
    assert not list(tmp_path.glob("*found*"))
