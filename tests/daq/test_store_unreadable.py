"""Stored scans that cannot be read any more: an error with run, scan, store and remedy, and all else goes on."""

import sqlite3
from contextlib import closing
from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import text, update

from api.cli import main
from daq.records import Channel, InputError, Quality, Scan
from daq.store import NewRun, RunEnd, StoreUnavailable, open_store
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
                with pytest.raises(ScansUnreadable) as told:
                    read(run)
                said = str(told.value)
                assert run in said
                assert f"scan {number} " in said
                assert store.label.rpartition("/")[2] in said  # an error hides who is let in
                assert "kerntemp backup --restore" in said
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


def test_a_torn_page_costs_the_runs_on_it_alone_and_the_terminal_names_run_and_remedy(tmp_path, capsys):
    path = tmp_path / "kerntemp.sqlite"
    with filled(str(path), {"one": 300, "two": 300, "three": 300}) as store:
        pass
    tear(path, b"[200.0,420.0,")  # of the second run
    with open_store(str(path)) as store:
        assert len(store.load_run("one").time_s) == len(store.load_run("three").time_s) == 300
        with pytest.raises(ScansUnreadable, match=r"run two: .* kerntemp backup --restore"):
            store.load_run("two")
        with pytest.raises(StoreUnavailable, match="damaged"):
            store.scans_after("lab", 310, 200)
    assert main(["export", "two", "--out", str(tmp_path / "two.csv"), "--store", str(path)]) == 2
    said = capsys.readouterr().err
    assert "run two" in said
    assert str(path) in said
    assert "kerntemp backup --restore" in said
    assert not (tmp_path / "two.csv").exists()
    assert main(["export", "three", "--out", str(tmp_path / "three.csv"), "--store", str(path)]) == 0


def tear(path, holds):
    """Overwrite most of the page that holds these bytes."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    content = bytearray(path.read_bytes())
    at = content.index(holds) // size * size
    content[at : at + size] = b"\xa5" * size
    path.write_bytes(content)


def test_a_header_that_cannot_be_read_is_told_of_its_run(store_url):
    with filled(store_url, COUNT) as store:
        with store.database.writing() as connection:
            connection.execute(update(RUN).where(RUN.c.run == "many").values(header_toml="x = = 1"))
        with pytest.raises(ScansUnreadable, match="run many: its header is damaged"):
            store.load_run("many")
        assert len(store.load_run("a-few").time_s) == 40


def test_a_column_that_does_not_exist_is_no_damage(store_url):
    with filled(store_url, COUNT) as store:
        with pytest.raises(InputError) as told:
            store.load_run("many", ["top_9"])
        assert not isinstance(told.value, ScansUnreadable)
        with store.database.reading() as connection:
            assert connection.execute(text("SELECT count(*) FROM scan")).scalar_one() == 340
