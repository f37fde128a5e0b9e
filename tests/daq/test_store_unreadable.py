"""Stored scans that cannot be read any more: an error with run, scan, store and remedy, and all else goes on."""

import sqlite3
from contextlib import closing
from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import NullPool, create_engine, delete, text, update

from api.cli import main
from daq.records import Channel, InputError, Quality, Scan
from daq.store import NewRun, RunEnd, StoreUnavailable, open_store
from daq.store.database import store_url
from daq.store.records import ScansUnreadable
from daq.store.schema import RUN, SCAN

CHANNELS = tuple(Channel(name) for name in ("platen_top", "top_1", "bottom_1"))
BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
COUNT = {"a-few": 40, "many": 300}


def scan(number):
    values = (200.0, 20.0 + number, 20.5 + number)
    at = datetime.fromtimestamp(BEGAN.timestamp() + number, UTC)
    return Scan(number, at, 100.0 + number, values, (Quality.GOOD,) * 2 + (Quality.STALE,))


def filled(url, runs):
    """Return a store with runs of so many scans, by name."""
    store = open_store(url)
    key, first = store.register_press("lab", CHANNELS), 0
    for run, count in runs.items():
        scans = [scan(first + i) for i in range(count)]
        store.append_scans(key, scans, begin=NewRun(run, first, scans[0].utc, scans[0].monotonic_s, {"x": 1.0}))
        store.append_scans(key, (), end=RunEnd(run, scans[-1].number, scans[-1].utc))
        first += count
    return store


DAMAGE = {
    "garbage": {"readings": "\x7fq9,;"},
    "cut short": {"readings": "[200.0,2"},
    "a value too few": {"readings": "[200.0,21.0]"},
    "a value too many": {"readings": "[200.0,21.0,1.0,2.0]"},
    "a word": {"readings": '[200.0,21.0,"warm"]'},
    "empty": {"readings": ""},
    "qualities": {"faults": '{"top_1":'},
    "a list of qualities": {"faults": "[1]"},
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_row_is_an_error_with_run_scan_and_remedy_and_the_other_runs_are_read(
    store_url, damage, tmp_path
):
    with filled(store_url, COUNT) as store:
        before = store.load_run("many")
        for number in (17, 40 + 250):
            with store.database.writing() as connection:
                connection.execute(update(SCAN).where(SCAN.c.number == number).values(**DAMAGE[damage]))
            run = "a-few" if number == 17 else "many"
            for read in (store.load_run, store.run_for_file):
                with pytest.raises(ScansUnreadable) as refused:
                    read(run)
                text = str(refused.value)
                assert run in text
                assert f"scan {number} " in text
                assert store.label.rpartition("/")[2] in text  # an error hides who is let in
                assert "kerntemp backup --restore" in text
            if run == "a-few":
                assert np.array_equal(store.load_run("many").columns["top_1"], before.columns["top_1"])
                assert len(store.load_run("a-few", to_s=10.0).time_s) == 11
        store.use_archive(tmp_path / "archive")
        with pytest.raises(ScansUnreadable):
            store.archive_run("many")
        followed = store.scans_after("lab", -1, 1000).scans
        assert [s.number for s in followed] == list(range(340))
        poor = {s.number for s in followed if not any(quality.usable for quality in s.qualities)}
        assert poor == {17, 290}
        day = store.envelope("lab", BEGAN, datetime.fromtimestamp(BEGAN.timestamp() + 340, UTC), 34)
        assert day.high["top_1"][-1] == 20.0 + 339


@pytest.mark.parametrize("gone", [[40], [339], range(40, 340)], ids=["first", "last", "all"])
def test_a_run_whose_first_or_last_scan_is_gone_is_no_shorter_run(store_url, gone):
    with filled(store_url, COUNT) as store:
        with store.database.writing() as connection:
            connection.execute(delete(SCAN).where(SCAN.c.number.in_(list(gone))))
        for read in (store.load_run, store.run_for_file):
            with pytest.raises(ScansUnreadable, match=r"many.*scans of it are missing.*kerntemp backup --restore"):
                read("many")
        assert len(store.load_run("a-few").time_s) == 40


def test_a_torn_page_costs_the_runs_on_it_alone_and_the_terminal_names_run_and_remedy(tmp_path, capsys):
    path = tmp_path / "kerntemp.sqlite"
    with filled(str(path), {"one": 300, "two": 300, "three": 300}) as store:
        pass
    tear(path, b"[200.0,420.0,")  # of the second run
    with open_store(str(path)) as store:
        assert len(store.load_run("one").time_s) == len(store.load_run("three").time_s) == 300
        with pytest.raises(ScansUnreadable, match=r"run two: .* kerntemp backup --restore"):
            store.load_run("two")
        followed, lost, last = [], [], -1
        while (batch := store.scans_after("lab", last, 100)).scans:
            followed += [one.number for one in batch.scans]
            lost += batch.damaged
            last = followed[-1]
        gone = sorted(set(range(900)) - set(followed))
        assert gone == list(range(gone[0], gone[-1] + 1)), "one page of the second run"
        assert 300 <= gone[0] <= gone[-1] < 600
        assert followed == sorted(followed)
        assert lost == [gone[0]]
    assert main(["export", "two", "--out", str(tmp_path / "two.csv"), "--store", str(path)]) == 2
    output = capsys.readouterr().err
    assert "run two" in output
    assert str(path) in output
    assert "kerntemp backup --restore" in output
    assert not (tmp_path / "two.csv").exists()
    assert main(["export", "three", "--out", str(tmp_path / "three.csv"), "--store", str(path)]) == 0
    tear(path, b"[200.0,919.0,")
    with open_store(str(path)) as store, pytest.raises(StoreUnavailable) as refused:
        store.scans_after("lab", 898, 100)
    for part in ("press lab", "scan ", str(path), "kerntemp backup --restore"):
        assert part in str(refused.value)
    with open_store(str(path)) as store:
        assert store.scans_after("lab", 250, 10).scans[-1].number == 260


def tear(path, holds):
    """Overwrite most of the page that holds these bytes."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    content = bytearray(path.read_bytes())
    at = content.index(holds) // size * size
    content[at : at + size] = b"\xa5" * size
    path.write_bytes(content)


def tear_on_server(url, relation):
    """Let a table or an index of a server's be a file of garbage, as its disk may."""
    engine = create_engine(store_url(url), poolclass=NullPool)
    with closing(engine.raw_connection()) as connection:
        cursor = connection.cursor()
        cursor.execute("SELECT setting FROM pg_settings WHERE name = 'data_directory'")
        (folder,) = cursor.fetchone()
        cursor.execute("SELECT pg_relation_filepath(%s)", (relation,))
        torn = 987_654_321  # a number no file of the server's has: nothing of it is in its memory
        file = f"{folder}/{cursor.fetchone()[0].rpartition('/')[0]}/{torn}"
        cursor.execute("SELECT lo_from_bytea(0, %s)", (b"\xa5" * 16384,))
        cursor.execute("SELECT lo_export(%s, %s)", (cursor.fetchone()[0], file))
        cursor.execute("UPDATE pg_class SET relfilenode = %s WHERE oid = to_regclass(%s)", (torn, relation))
        connection.commit()


@pytest.mark.parametrize("relation", ["run_by_press", "scan_pkey", "event", "status_pkey"])
def test_a_torn_page_of_a_server_is_an_answer_of_the_store_with_what_to_do(relation, postgresql_url):
    with filled(postgresql_url, {"one": 30}) as store:
        store.beat("record", {"x": 1})
    tear_on_server(postgresql_url, relation)
    with open_store(postgresql_url) as store:
        asked = {
            "run_by_press": store.runs,
            "scan_pkey": lambda: store.scans_after("lab", -1, 100),
            "event": store.journal,
            "status_pkey": lambda: store.beat("record", {"x": 2}),
        }
        with pytest.raises(StoreUnavailable, match="kerntemp backup --restore") as refused:
            asked[relation]()
        assert "invalid page" in str(refused.value)
        assert "REINDEX" in str(refused.value)


def test_a_header_that_cannot_be_read_is_told_of_its_run(store_url):
    with filled(store_url, COUNT) as store:
        with store.database.writing() as connection:
            connection.execute(update(RUN).where(RUN.c.run == "many").values(header_toml="x = = 1"))
        with pytest.raises(ScansUnreadable, match="run many: its header is damaged in store"):
            store.load_run("many")
        assert len(store.load_run("a-few").time_s) == 40


def test_a_column_that_does_not_exist_is_no_damage(store_url):
    with filled(store_url, COUNT) as store:
        with pytest.raises(InputError) as refused:
            store.load_run("many", ["top_9"])
        assert not isinstance(refused.value, ScansUnreadable)
        with store.database.reading() as connection:
            assert connection.execute(text("SELECT count(*) FROM scan")).scalar_one() == 340


HEADERS = {
    "broken": "x = = 1",
    "no text at all": "\x01\x02",
    "nested too deeply": "x = " + "[" * 5000,
}


def spoil_header(store, run, damage):
    """Damage a run's header as the disk does; a server refuses bytes that are no UTF-8 and gets others."""
    if damage == "flipped bytes" and store.database.dialect != "sqlite":
        damage = "no text at all"
    with store.database.writing() as connection:
        if damage != "flipped bytes":
            connection.execute(update(RUN).where(RUN.c.run == run).values(header_toml=HEADERS[damage]))
            return
        flipped = "UPDATE run SET header_toml = CAST(x'78203d2022ff22' AS TEXT) WHERE run = :run"
        connection.execute(text(flipped), {"run": run})


@pytest.mark.parametrize("damage", [*HEADERS, "flipped bytes"])
def test_lists_hold_the_sound_runs_and_name_the_damaged_one_which_alone_is_refused(store_url, damage):
    with filled(store_url, {**COUNT, "last": 20}) as store:
        spoil_header(store, "many", damage)
        found = {record.run: record for record in store.runs().items}
        assert list(found) == ["last", "many", "a-few"]
        assert [run for run, record in found.items() if record.damage] == ["many"]
        text = str(found["many"].damage)
        assert text.startswith("run many: its header is damaged in store ")
        assert store.label.rpartition("/")[2] in text
        assert "kerntemp backup --restore" in text
        assert found["many"].header == {}
        assert (found["many"].first_scan, found["many"].last_scan) == (40, 339)
        assert [record.run for record in store.damaged_runs()] == ["many"]
        assert [r.run for r in store.ended_runs_after("lab", -1)] == ["a-few", "many", "last"]
        assert store.run_records(["many", "last"])["last"].damage is None
        for read in (store.load_run, store.run_for_file, store.run_record):
            with pytest.raises(ScansUnreadable, match="run many: its header is damaged in store"):
                read("many")
        with pytest.raises(ScansUnreadable, match="run many: its header is damaged in store"):
            store.annotate_run("many", {"panel.density_kg_m3": 700.0}, "eva")
        assert len(store.load_run("last").time_s) == 20
        assert store.has_run("many")


@pytest.mark.parametrize("damage", [*HEADERS, "flipped bytes"])
def test_the_pressing_after_a_damaged_run_begins_and_ends_as_any_other(store_url, damage):
    with filled(store_url, {"lab-01": 20}) as store:
        spoil_header(store, "lab-01", damage)
        key = store.register_press("lab", CHANNELS)
        scans = [scan(n) for n in range(20, 30)]
        store.append_scans(key, scans, begin=NewRun("lab-01", 20, scans[0].utc, scans[0].monotonic_s, {"x": 1.0}))
        assert store.open_run("lab").run == "lab-02"
        store.append_scans(key, (), end=RunEnd("lab-01", 29, scans[-1].utc, first_scan=20))
        assert len(store.load_run("lab-02").time_s) == 10


@pytest.mark.parametrize("flipped", [False, True])
def test_a_run_begins_without_what_is_damaged_of_the_next_panel_and_an_alarm_says_so(store_url, flipped):
    with filled(store_url, {"one": 20}) as store:
        store.put_next_panel("lab", {"panel.thickness_mm": 16.0}, "standard", "eva")
        with store.database.writing() as connection:
            bad = "CAST(x'ff' AS TEXT)" if flipped and store.database.dialect == "sqlite" else "'x = = 1'"
            connection.execute(text(f"UPDATE next_panel SET header_toml = {bad}"))
            connection.execute(text(f"UPDATE recipe SET header_toml = {bad}"))
        key = store.register_press("lab", CHANNELS)
        store.append_scans(key, [scan(20)], begin=NewRun("two", 20, scan(20).utc, 120.0, {"x": 1.0}))
        assert store.open_run("lab").header == {"x": 1.0, "run": "two"}
        (alarm,) = store.journal(level="alarm").items
        assert "press lab: the data of the next panels are damaged in store" in str(alarm.message)
        for read in (lambda: store.next_panel("lab"), store.recipes):
            with pytest.raises(ScansUnreadable, match="damaged in store"):
                read()
        store.put_next_panel("lab", {"panel.thickness_mm": 18.0}, "standard", "eva")
        assert store.next_panel("lab").header == store.recipes()["standard"] == {"panel.thickness_mm": 18.0}
