"""The store keeps what it acknowledged, on SQLite and on PostgreSQL alike."""

import itertools
import math
import sqlite3
import string
import tempfile
import threading
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import create_engine, inspect, text

from daq.files.run_file import read_run, write_run
from daq.records import Channel, InputError, PressEvent, PressEventKind, PressState, Quality, Run, Scan
from daq.store import (
    NewRun,
    RunEnd,
    RunStatus,
    StoredEstimate,
    StoredNight,
    StoreUnavailable,
    every,
    open_store,
)
from daq.store.convert import MANY, readings_json, readings_table
from daq.store.database import migrations, statements, store_url
from daq.store.results import promote_model
from daq.store.schema import METADATA
from daq.words import say

CHANNELS = tuple(Channel(name) for name in ("platen_top", "platen_bottom", "top_1", "bottom_1"))
BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
G, O = Quality.GOOD, Quality.OPEN  # noqa: E741


@pytest.fixture
def store(store_url):
    with open_store(store_url) as opened:
        yield opened


def scans(first, count, value=20.0):
    return [
        Scan(
            n,
            BEGAN + timedelta(seconds=n / 10),
            1000.0 + n / 10,
            (200.0, 199.5, value + n, math.nan if n % 3 == 0 else 21.0),
            (G, G, G, O if n % 3 == 0 else G),
        )
        for n in range(first, first + count)
    ]


def record_one_run(store, press="lab"):
    key = store.register_press(press, CHANNELS, "name")
    n = key.next_number
    store.append_scans(key, scans(n, 20))
    name = store.unused_run_name(press, BEGAN)
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0}
    begin = NewRun(name, n + 15, BEGAN, 1000.0 + (n + 15) / 10, header, "[store]")
    inserted = PressEvent(PressEventKind.INSERTED, 1000.0 + (n + 18) / 10, 1000.0 + (n + 19) / 10)
    store.append_scans(key, scans(n + 20, 1), [inserted], begin)
    store.append_scans(key, scans(n + 21, 30), [PressEvent(PressEventKind.CLOSED, 1000.0 + (n + 30) / 10, 1002.1)])
    store.append_scans(key, scans(n + 51, 1), end=RunEnd(name, n + 51, BEGAN + timedelta(seconds=6)))
    return name


def test_a_run_follows_its_life_and_comes_back_with_its_data(store):
    name = record_one_run(store)
    assert name == "lab-2026-03-04-01"
    record = store.run_record(name)
    assert record.status is RunStatus.CLOSED
    assert (record.first_scan, record.last_scan) == (15, 51)
    assert record.moments.inserted_s == pytest.approx(0.3)
    assert record.moments.closed_s == pytest.approx(1.5)
    assert math.isnan(record.moments.opened_s)
    run = store.load_run(name)
    assert run.name == name
    assert run.header == {"panel.material": "MDF", "panel.thickness_mm": 16.0, "run": name}
    assert list(run.columns) == ["platen_top", "platen_bottom", "top_1", "bottom_1"]
    np.testing.assert_array_equal(run.time_s, np.round(np.arange(37) / 10, 6))
    np.testing.assert_array_equal(run.columns["top_1"], 20.0 + np.arange(15, 52))
    np.testing.assert_array_equal(np.isnan(run.columns["bottom_1"]), np.arange(15, 52) % 3 == 0)
    assert store.configuration_of(name) == "[store]"
    assert store.presses() == {"lab": "name"}


def test_every_quality_comes_back_with_the_run_and_only_usable_values_do(store):
    key = store.register_press("lab", CHANNELS, "name")
    rows = [
        Scan(n, BEGAN, n / 10, (200.0, 199.0, 21.0, 22.0), (G, quality, G, G)) for n, quality in enumerate(Quality)
    ]
    store.append_scans(key, rows, begin=NewRun("r", 0, BEGAN, 0.0))
    run = store.load_run("r")
    qualities = run.texts["quality"]
    for i, quality in enumerate(Quality):
        assert np.isfinite(run.columns["platen_bottom"][i]) == (quality in (Quality.GOOD, Quality.SIMULATED))
        assert np.isfinite(run.columns["top_1"][i])
        if quality not in (Quality.GOOD, Quality.SIMULATED):
            assert qualities[i] == f"platen_bottom={quality}"
    assert qualities[0] == ""
    assert qualities[-1] == "*=simulated platen_top=good top_1=good bottom_1=good"
    assert store.load_run("r", columns=["top_1"]).texts["quality"][1:3] == ("", "")


def test_part_of_a_run_is_given_by_time_and_column(store):
    name = record_one_run(store)
    part = store.load_run(name, columns=["top_1"], from_s=1.0, to_s=2.0)
    assert list(part.columns) == ["top_1"]
    assert (part.time_s[0], part.time_s[-1]) == (1.0, 2.0)
    with pytest.raises(InputError, match="has no column 'top_9'; it has platen_top"):
        store.load_run(name, columns=["top_9"])
    with pytest.raises(InputError, match="run 'x' is not in the store"):
        store.load_run("x")


def test_an_open_run_shows_what_it_has_so_far(store):
    key = store.register_press("lab", CHANNELS)
    assert store.open_run("lab") is None
    store.append_scans(key, scans(0, 5), begin=NewRun("r", 2, BEGAN, 1000.2))
    assert store.open_run("lab").run == "r"
    assert len(store.load_run("r").time_s) == 3
    store.append_scans(key, scans(5, 1))
    assert len(store.load_run("r").time_s) == 4


def test_a_crash_leaves_an_interrupted_run_with_its_data(store):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, scans(0, 8), begin=NewRun("r", 2, BEGAN, 1000.2))
    assert store.interrupt_open_runs("other") == []
    assert store.interrupt_open_runs("lab") == ["r"]
    assert store.run_record("r").status is RunStatus.INTERRUPTED
    again = store.register_press("lab", CHANNELS)
    assert again.next_number == 8
    store.append_scans(again, scans(8, 5))
    assert len(store.load_run("r").time_s) == 6


def test_numbers_of_runs_go_on_within_a_day_and_start_anew_on_the_next(store):
    assert record_one_run(store) == "lab-2026-03-04-01"
    assert record_one_run(store) == "lab-2026-03-04-02"
    assert store.unused_run_name("lab", BEGAN + timedelta(days=1)) == "lab-2026-03-05-01"


def test_writing_the_same_scans_again_does_no_harm(store):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, scans(0, 5))
    store.append_scans(key, scans(3, 5))
    assert [s.number for s in store.scans_after("lab", -1).scans] == list(range(8))


def test_a_second_recorder_on_the_same_press_is_refused(store):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, scans(0, 5))
    with pytest.raises(StoreUnavailable, match="another recorder writes to this press"):
        store.append_scans(key, scans(4, 5, value=99.0))
    assert store.newest_scan_number("lab") == 4


def test_a_follower_gets_every_scan_once_with_values_and_qualities(store):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, scans(0, 25))
    seen, last = [], -1
    while batch := store.scans_after("lab", last, limit=10).scans:
        seen += batch
        last = batch[-1].number
    expected = scans(0, 25)
    assert [s.number for s in seen] == [s.number for s in expected]
    assert [s.utc for s in seen] == [s.utc for s in expected]
    assert [s.qualities for s in seen] == [s.qualities for s in expected]
    np.testing.assert_array_equal([s.values for s in seen], [s.values for s in expected])
    assert store.scans_after("nowhere", -1).scans == ()


def test_a_batch_ends_where_the_channels_change(store):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, scans(0, 3))
    wider = store.register_press("lab", (*CHANNELS, Channel("closed", "")))
    assert wider.next_number == 3
    store.append_scans(wider, [Scan(3, BEGAN, 1001.0, (1.0, 2.0, 3.0, 4.0, 1.0), (G,) * 5)])
    assert len(store.scans_after("lab", -1).scans) == 3
    batch = store.scans_after("lab", 2)
    assert [c.name for c in batch.channels][-1] == "closed"
    assert batch.scans[0].values[-1] == 1.0
    assert store.channels("lab") == batch.channels


def test_simulated_values_are_usable_and_faulty_ones_are_not(store):
    key = store.register_press("lab", CHANNELS)
    s = Quality.SIMULATED
    scan = Scan(0, BEGAN, 1000.0, (1.0, 2.0, 3.0, 1370.0), (s, s, s, Quality.OVER))
    store.append_scans(key, [scan], begin=NewRun("r", 0, BEGAN, 1000.0))
    assert store.scans_after("lab", -1).scans[0].qualities == scan.qualities
    assert store.scans_after("lab", -1).scans[0].values[3] == 1370.0
    run = store.load_run("r")
    assert run.columns["top_1"][0] == 3.0
    assert math.isnan(run.columns["bottom_1"][0])


@pytest.mark.parametrize("few", [1, 3, 2000])
def test_runs_of_a_time_are_all_found_wherever_the_index_sends_the_search(store, few, monkeypatch):
    monkeypatch.setattr("daq.store.reading._FEW", few)
    days = (5, 1, 3, 2, 6, None, 4)  # files are imported in any order
    instants = [day and datetime(2026, 11, day, tzinfo=UTC) for day in days]
    headers = [{} if at is None else {"recorded.started_utc": at} for at in instants]
    time_s = np.arange(0.0, 3.0)
    runs = [Run(f"r{i}", h, time_s, {"top_1": time_s}, "", {}) for i, h in enumerate(headers)]
    store.import_runs(runs, "lab")
    ends = [None, *(datetime(2026, 11, day, tzinfo=UTC) for day in range(1, 8))]
    for since, until in itertools.product(ends, ends):
        if since is None and until is None:
            continue
        wanted = [
            r.name
            for r, at in zip(runs, instants, strict=True)
            if at is not None and (since is None or since <= at) and (until is None or at < until)
        ]
        found = every(lambda cursor: store.runs(since=since, until=until, cursor=cursor, limit=2))  # noqa: B023
        assert [r.run for r in found] == wanted[::-1]


def test_the_newest_runs_of_a_press_take_no_longer_however_many_are_stored(tmp_path):
    steps, taken, run = [], [], Run("file-0", {}, np.arange(2.0), {"top_1": np.ones(2)})
    with open_store(str(tmp_path / "s.sqlite")) as store:
        connection = store.database.engine.connect()
        connection.connection.dbapi_connection.set_progress_handler(lambda: steps.append(1), 10)
        connection.close()  # the pool hands it out again
        for first, last in ((0, 20), (20, 1000)):
            store.import_runs([replace(run, name=f"file-{i}") for i in range(first, last)], "lab")
            recorded = record_one_run(store)
            steps.clear()
            assert [r.run for r in store.runs(press="lab", limit=3).items][:2] == [recorded, f"file-{last - 1}"]
            taken.append(len(steps))
    assert 0 < taken[1] <= 2 * taken[0]


def test_pages_of_runs_hold_every_run_once_newest_first(store):
    names = [record_one_run(store) for _ in range(7)]
    found, cursor = [], None
    while True:
        page = store.runs(cursor=cursor, limit=3)
        found += [r.run for r in page.items]
        cursor = page.next_cursor
        if cursor is None:
            break
    assert found == names[::-1]
    assert store.runs(material="OSB").items == ()
    assert len(store.runs(press="lab", status=RunStatus.CLOSED, material="MDF", since=BEGAN).items) == 7
    assert store.runs(until=BEGAN).items == ()
    with pytest.raises(InputError, match="cursor 'x'"):
        store.runs(cursor="x")


def test_metadata_change_with_history_and_raw_data_do_not(store):
    name = record_one_run(store)
    before = store.load_run(name)
    store.annotate_run(name, {"panel.density_kg_m3": 741.5, "remark": "knots", "panel.thickness_mm": 19}, "eva")
    store.annotate_run(name, {"panel.density_kg_m3": None}, "udo")
    record = store.run_record(name)
    assert record.remark == "knots"
    assert record.header["panel.thickness_mm"] == 19
    assert "panel.density_kg_m3" not in record.header
    changes = store.run_changes(name)
    assert [(c.who, c.field, c.before, c.after) for c in changes] == [
        ("eva", "panel.density_kg_m3", None, 741.5),
        ("eva", "remark", "", "knots"),
        ("eva", "panel.thickness_mm", 16.0, 19),
        ("udo", "panel.density_kg_m3", 741.5, None),
    ]
    assert store.load_run(name).columns["top_1"].tobytes() == before.columns["top_1"].tobytes()
    with pytest.raises(InputError, match="name of a run cannot change"):
        store.annotate_run(name, {"run": "other"}, "eva")


def test_press_events_are_followed_in_order(store):
    name = record_one_run(store)
    events = store.press_events("lab")
    assert [e.kind for e in events] == ["inserted", "closed"]
    assert events[0].utc == BEGAN + timedelta(seconds=1.8)
    assert store.press_events("lab", after=events[0].number)[0].kind == "closed"
    assert store.run_record(name).started_utc == BEGAN


def test_estimates_come_back_by_run_and_for_followers(store):
    name = record_one_run(store)
    estimates = [
        StoredEstimate(
            n, 1000 + n / 10, PressState.CLOSED, 60.0 + n, 0.5, 59.0, 61.0, True, "", "v1", {"x": [1.0]}
        )
        for n in range(14, 30)
    ]
    store.append_estimates("lab", estimates)
    store.append_estimates("lab", [StoredEstimate(20, 1002.0, "unknown", *[math.nan] * 4, False, "why")])
    found = store.estimates(name)
    assert [t for t, _ in found] == [round((n - 15) / 10, 6) for n in range(15, 30)]
    assert found[0][1] == estimates[1]
    assert found[5][1].reason == "why"
    assert math.isnan(found[5][1].core_celsius)
    assert [e.number for e in store.estimates_after("lab", 27)] == [28, 29]
    assert store.newest_estimate_number("lab") == 29
    assert store.newest_estimate_number("nowhere") == -1


def test_how_a_press_stands_is_read_at_one_moment_whatever_is_written_meanwhile(store):
    assert store.standing("lab") == (None, (), (), None, None, None)
    key = store.register_press("lab", CHANNELS)
    pressed = [
        PressEvent(PressEventKind.INSERTED, 1000.2, 1000.2),
        PressEvent(PressEventKind.CLOSED, 1000.4, 1000.4),
    ]
    store.append_scans(key, scans(0, 8), pressed, NewRun("r", 2, BEGAN, 1000.2))
    behind = StoredEstimate(6, 1000.6, PressState.CLOSED, 60.0, 0.5, 59.0, 61.0, True)
    store.append_estimates("lab", [behind])
    ends = [PressEvent(PressEventKind.REMOVED, 1000.8, 1000.8)]
    asked = store.database.reading

    @contextmanager
    def while_the_run_ends():
        with asked() as connection:
            yield connection
        store.database.reading = asked
        store.append_scans(key, scans(8, 1), ends, end=RunEnd("r", 8, BEGAN))

    store.database.reading = while_the_run_ends
    stood = store.standing("lab")
    assert (stood.run.run, stood.run.status) == ("r", RunStatus.OPEN)
    assert [e.kind for e in stood.events] == ["inserted", "closed"]
    assert stood.channels == tuple(CHANNELS)
    assert (stood.scan.number, stood.estimate, stood.estimated.number) == (7, behind, 6)
    assert stood.estimated.utc == scans(6, 1)[0].utc
    stands = store.standing("lab")
    assert (stands.run.run, stands.run.status, stands.events) == ("r", RunStatus.CLOSED, ())
    assert (stands.scan.number, stands.estimated.number) == (8, 6)


def fit_json(run, value):
    coefficient = {"value": value, "sd": 1.0, "ci95": [value - 2, value + 2], "identifiable": True}
    return {
        "run": run,
        "converged": True,
        "rmse_K": 0.3,
        "coefficients": {"h_pp_c": coefficient, "h_wa": coefficient},
    }


def test_the_newest_fit_of_a_run_counts_in_the_history(store):
    names = [record_one_run(store) for _ in range(3)]
    for name in names:
        store.put_fit(name, fit_json(name, 700.0), "v1")
    store.put_fit(names[0], fit_json(names[0], 650.0), "v2")
    assert store.fit(names[0])["coefficients"]["h_pp_c"]["value"] == 650.0
    assert store.fit(names[0])["model_version"] == "v2"
    assert store.run_record(names[0])
    page = store.coefficient_history(limit=2, press="lab")
    assert [(c.run, c.name, c.value) for c in page.items] == [
        (names[2], "h_pp_c", 700.0),
        (names[2], "h_wa", 700.0),
        (names[1], "h_pp_c", 700.0),
        (names[1], "h_wa", 700.0),
    ]
    rest = store.coefficient_history(limit=2, cursor=page.next_cursor)
    assert [(c.run, c.value) for c in rest.items] == [(names[0], 650.0)] * 2
    assert store.newest_fit_number("lab") == store.newest_fit_number() == rest.items[0].fit_number
    newest = store.newest_fit_number()
    assert store.newest_fit_number("lab", after=newest - 1) == newest
    assert store.newest_fit_number("lab", after=newest) == store.newest_fit_number("other") == 0
    assert [run for _, run in store.fits_after(0, limit=2)] == [names[2], names[0]]
    assert rest.next_cursor is None
    assert store.coefficient_history(press="other").items == ()
    store.put_fit(names[2], {**fit_json(names[2], 1.0), "rmse_K": float("nan")})
    assert store.fit_errors([names[0], names[2], "no such run"]) == {names[0]: 0.3, names[2]: None}


def test_the_history_goes_by_when_runs_were_pressed_in_whatever_order_they_came_and_were_fitted(store):
    for i, minute in enumerate((3, 1, 4, 1, 5, 2)):  # two in one minute: as they came
        name, header = f"run-{i}", {"recorded.started_utc": datetime(2026, 3, 4, 7, minute, tzinfo=UTC)}
        store.import_run(Run(name, header, np.array([0.0, 60.0]), {"top_1": np.ones(2)}), "lab")
    for i in (4, 0, 5, 2, 1, 3, 0):
        store.put_fit(f"run-{i}", fit_json(f"run-{i}", 700.0))
    runs, cursor = [], None
    while cursor is not None or not runs:
        page = store.coefficient_history(press="lab", limit=2, cursor=cursor)
        runs += [c.run for c in page.items if c.name == "h_wa"]
        cursor = page.next_cursor
    assert runs == ["run-4", "run-2", "run-0", "run-5", "run-3", "run-1"]


def test_a_date_that_a_file_does_not_give_is_unknown_and_comes_last(store):
    dated = {"recorded.started_utc": datetime(1971, 1, 1, tzinfo=UTC)}
    files = [
        Run(n, header, np.array([0.0, 60.0]), {"top_1": np.ones(2)})
        for n, header in (("a", {}), ("b", dated), ("c", {}))
    ]
    store.import_runs(files, "lab")
    for name in "abc":
        store.put_fit(name, fit_json(name, 700.0))
    rows, cursor = [], None
    while cursor is not None or not rows:
        page = store.coefficient_history(press="lab", limit=1, cursor=cursor)
        rows += [(c.run, c.started_utc) for c in page.items if c.name == "h_wa"]
        cursor = page.next_cursor
    assert rows == [("b", dated["recorded.started_utc"]), ("c", None), ("a", None)]
    assert store.run_record("a").ended_utc is None
    assert "recorded.started_utc" not in store.run_for_file("a").header
    for until in (None, datetime.now(UTC)):
        assert [r.run for r in store.runs(since=datetime(1970, 1, 1, tzinfo=UTC), until=until).items] == ["b"]
    with store.database.reading() as connection:
        rows = connection.execute(text("SELECT run, started_utc FROM run_overview ORDER BY run")).all()
    assert [row[1] is None for row in rows] == [True, False, True]


def test_one_model_of_a_press_is_active_and_its_history_stays(store):
    store.put_model("lab", "v1", {"coefficients": {}}, status="promoted", reason="first")
    store.put_model("lab", "v2", {"coefficients": {"h": {"value": 1.0}}}, reason="residual 1.0 -> 0.4 K")
    assert store.active_model("lab").version == "v1"
    store.promote_model("v2", "eva", "better by 0.4 K")
    assert store.active_model("lab").version == "v2"
    assert store.model("v1").status == "retired"
    assert [m.version for m in store.models(press="lab").items] == ["v2", "v1"]
    assert store.model("v2").reason == "residual 1.0 -> 0.4 K"
    assert store.journal().items[0].message == say("model-promoted", version="v2")
    assert store.journal().items[0].detail == {"reason": "better by 0.4 K"}
    with pytest.raises(InputError, match="'v3' is not in the store"):
        store.promote_model("v3", "eva")
    with pytest.raises(InputError, match="versions never change"):
        store.put_model("lab", "v1", {})
    assert store.active_model("other") is None


def test_models_diagnoses_and_journal_of_before_a_time_are_asked_for_without_what_came_after(store):
    written = []
    for n in ("1", "2", "3"):
        store.put_model("lab", n, {})
        store.put_diagnosis("lab", {"verdict": n})
        store.log("warning", "sense", n, "lab")
        written.append(datetime.now(UTC))
    asked = {"press": "lab", "until": written[1]}
    assert [model.version for model in store.models(**asked).items] == ["2", "1"]
    assert [found.verdict for found in store.diagnoses(**asked).items] == ["2", "1"]
    page = store.journal(**asked, level="warning", limit=1)
    assert [str(line.message) for line in page.items] == ["2"]
    following = store.journal(**asked, level="warning", cursor=page.next_cursor)
    assert [str(line.message) for line in following.items] == ["1"]


def test_diagnoses_journal_and_status_are_kept(store):
    store.put_diagnosis("lab", {"verdict": "named", "seconds": math.nan})
    assert store.diagnoses(press="lab").items[0].diagnosis == {"verdict": "named", "seconds": None}
    store.log("warning", "record", "press-left silent", "lab", {"since": "07:00"})
    store.log("info", "serve", "started")
    assert [str(e.message) for e in store.journal(level="warning").items] == ["press-left silent"]
    assert [str(e.message) for e in store.journal_after(0)] == ["press-left silent", "started"]
    store.beat("record", {"scans": 1})
    store.beat("record", {"scans": 2})
    assert store.statuses()["record"].status == {"scans": 2}


def test_what_the_next_panel_of_a_press_is_leaves_the_other_presses_alone(store):
    for press, thickness in (("left", 16.0), ("right", 19.0), ("middle", 22.0)):
        store.put_next_panel(press, {"panel.thickness_mm": thickness}, "", "operator")
    store.put_next_panel("middle", {}, "", "operator")
    assert store.next_panel("middle") is None
    assert store.next_panel("left").header == {"panel.thickness_mm": 16.0}
    assert store.next_panel("right").header == {"panel.thickness_mm": 19.0}


def test_an_imported_run_is_refused_twice_and_listed_with_its_press(store):
    run = Run("r", {"panel.material": "OSB"}, np.arange(3.0), {"top_1": np.array([1.0, np.nan, 3.0])})
    assert store.import_run(run, "lab") == "r"
    with pytest.raises(InputError, match="run 'r' is in the store already; nothing was imported"):
        store.import_run(run, "lab")
    assert [r.kind for r in store.runs(press="lab").items] == ["imported"]
    assert store.scans_after("lab", -1).scans == ()


floats = st.floats(allow_infinity=False, allow_nan=True)


@given(
    rows=st.lists(st.tuples(floats, floats, st.sampled_from([None, *Quality])), min_size=1, max_size=8),
    step=st.floats(1e-3, 1e3),
    note=st.text(string.printable, max_size=20),
    when=st.datetimes(timezones=st.just(UTC)),
)
@settings(max_examples=25, deadline=None)
def test_a_run_file_passes_through_the_store_to_the_last_bit(rows, step, note, when):
    columns = {name: np.array([row[i] for row in rows]) for i, name in enumerate(("top_1", "load"))}
    columns["top_1"][[q is not None and not q.usable for *_, q in rows]] = np.nan
    remarks = tuple("" if q is None else f"top_1={q}" for *_, q in rows)
    texts = {"quality": remarks} if any(remarks) else {}
    run = Run("x", {"run": "x", "note": note, "when": when}, np.arange(len(rows)) * step, columns, texts=texts)
    with tempfile.TemporaryDirectory() as folder, open_store(f"{folder}/s.sqlite") as store:
        write_run(run, Path(folder) / "in.csv")
        store.import_run(read_run(Path(folder) / "in.csv"), "lab")
        write_run(store.load_run("x"), Path(folder) / "out.csv")
        assert (Path(folder) / "out.csv").read_bytes() == (Path(folder) / "in.csv").read_bytes()


@given(rows=st.lists(st.lists(st.floats(width=64), min_size=3, max_size=3), min_size=1, max_size=6))
def test_many_scans_are_parsed_to_the_last_bit_as_few_are(rows):
    texts = [readings_json(row) for row in rows]
    known = np.where(np.isnan(rows), np.nan, rows)
    assert readings_table(texts, 3).tobytes() == known.tobytes()
    assert readings_table(texts * MANY, 3).tobytes() == np.tile(known, (MANY, 1)).tobytes()


def test_people_find_runs_and_scans_by_plain_sql(store):
    name = record_one_run(store)
    with store.database.reading() as connection:
        row = connection.execute(text("SELECT * FROM scan_of_lab WHERE number = 16")).mappings().one()
        assert row["top_1_celsius"] == 36.0
        assert row["bottom_1_celsius"] == 21.0
        count = connection.execute(text("SELECT count(*) FROM run_scan WHERE run = :run"), {"run": name}).scalar()
        assert count == 37
        overview = connection.execute(text("SELECT * FROM run_overview")).mappings().one()
        assert overview["press"] == "lab"
        assert str(overview["started_utc"]).startswith("2026-03-04")


def test_channels_and_presses_that_an_engine_takes_for_the_same_are_told_apart(store):
    long = "t" * 70
    channels = (*map(Channel, (long + "1", long + "2", "T1", "t1")), Channel("number", ""))
    for press in ("hall-1", "hall_1", "Hall-1"):
        key = store.register_press(press, channels)
        values = (1.0, 2.0, 3.0, 4.0, float(key.press_id))
        store.append_scans(key, [Scan(0, BEGAN, 1.0, values, (Quality.GOOD,) * 5)])
    with store.database.reading() as connection:
        views = [name for name in inspect(store.database.engine).get_view_names() if name.startswith("scan_of_")]
        assert len(views) == 3
        rows = [connection.execute(text(f'SELECT * FROM "{view}"')).one() for view in sorted(views)]
    for row in rows:
        assert sorted(row[3:7]) == [1.0, 2.0, 3.0, 4.0]
        assert len(set(row._fields)) == len(row._fields)
    assert len({row[7] for row in rows}) == 3


@pytest.mark.parametrize(
    "names", [("number_1", "number"), ("A" * 61 + "_2", "A" * 63, "A" * 64), ("faults", "faults_0")]
)
def test_a_name_made_to_tell_channels_apart_is_not_another_channels_own(store, names):
    key = store.register_press("lab", [Channel(name, "") for name in names])
    values = tuple(map(float, range(len(names))))
    store.append_scans(key, [Scan(0, BEGAN, 1.0, values, (Quality.GOOD,) * len(names))])
    with store.database.reading() as connection:
        row = connection.execute(text("SELECT * FROM scan_of_lab")).one()
    assert len({name.casefold() for name in row._fields}) == len(row._fields) == 4 + len(names)
    assert row[3 : 3 + len(names)] == values


def test_a_name_made_to_tell_presses_apart_is_not_another_press_s_own(store):
    presses = ("hall-1", "hall_1", "hall-1-2", "hall_1_2", "HALL-1")
    keys = [store.register_press(name, [Channel("top_1")]) for name in presses]
    for key in keys:
        store.append_scans(key, [Scan(0, BEGAN, float(key.press_id), (1.0,), (Quality.GOOD,))])
    views = [name for name in inspect(store.database.engine).get_view_names() if name.startswith("scan_of_")]
    with store.database.reading() as connection:
        held = [connection.execute(text(f'SELECT monotonic_s FROM "{view}"')).scalar() for view in views]
    assert sorted(held) == [key.press_id for key in keys]


def test_people_find_events_estimates_coefficients_and_models_of_a_run_with_units_and_times(store):
    name = record_one_run(store)
    store.append_estimates("lab", [StoredEstimate(20, 1002.0, PressState.CLOSED, 61.0, 0.5, 60.0, 62.0, True)])
    fitted = {"value": 700.0, "sd": 9.0, "ci95": [680.0, 720.0], "identifiable": True}
    store.put_fit(name, {"converged": True, "coefficients": {"h_pp_c": fitted}}, "v1")
    store.put_model("lab", "v1", {"effects": []}, status="promoted", reason="first")
    store.log("alarm", "record", "disk is full", "lab")

    def rows_of(view):
        with store.database.reading() as connection:
            return [dict(row) for row in connection.execute(text(f"SELECT * FROM {view}")).mappings()]

    [row] = rows_of("run_estimate")
    assert (row["run"], row["core_celsius"]) == (name, 61.0)
    assert row["time_s"] == pytest.approx(0.5)
    assert [(e["run"], e["kind"]) for e in rows_of("run_event")] == [(name, "inserted"), (name, "closed")]
    assert [e["time_s"] for e in rows_of("run_event")] == pytest.approx([0.3, 1.5])
    [row] = rows_of("coefficient_history")
    assert (row["run"], row["name"], row["value_w_m2k"], row["high_w_m2k"]) == (name, "h_pp_c", 700.0, 720.0)
    assert str(row["started_utc"]).startswith("2026-03-04")
    [model] = rows_of("model_overview")
    assert (model["version"], model["status"]) == ("v1", "promoted")
    assert abs(datetime.fromisoformat(str(model["created_utc"]).rstrip("Z")).year - datetime.now(UTC).year) <= 1
    assert [line["message"] for line in rows_of("journal")] == ["disk is full"]


def test_a_server_keeps_what_the_migrations_say_of_tables_and_columns(postgresql_url):
    with open_store(postgresql_url) as store:
        found = inspect(store.database.engine)
        assert found.get_table_comment("scan")["text"].startswith("Raw data. Never changed")
        comments = {c["name"]: c["comment"] for c in found.get_columns("scan")}
        assert comments["unix_s"] == "UTC, seconds since 1970; empty for imported files"
        assert comments["number"] is None
        with store.database.reading() as connection:
            comment = connection.execute(text("SELECT obj_description('coefficient_history'::regclass)")).scalar()
        assert "95 % interval" in comment


def test_of_two_models_promoted_at_once_one_is_in_force(postgresql_url):
    with open_store(postgresql_url) as store:
        for version in ("a", "b"):
            store.put_model("lab", version, {})
        with store.database.writing() as connection:
            promote_model(connection, "a", "one")
            other = threading.Thread(target=store.promote_model, args=("b", "another"))
            other.start()
            other.join(0.5)
        other.join(60)
        assert [m.version for m in store.models().items if m.status == "promoted"] == ["b"]


def test_a_store_of_the_first_schema_is_brought_up_to_date_with_its_data(store_url, monkeypatch):
    steps = migrations()
    monkeypatch.setattr("daq.store.database.migrations", lambda: {1: steps[1]})
    monkeypatch.setattr("daq.store.recording.take_next_panel", lambda *_: {})  # its writers asked for none
    with open_store(store_url) as store:
        name = record_one_run(store)
        with store.database.writing() as connection:
            for row in (
                f"INSERT INTO fit VALUES (1, '{name}', 0.0, 'v1', 1, 0.3, '{{}}')",
                "INSERT INTO coefficient VALUES (1, 'h_pp_c', 700.0, 9.0, 680.0, 720.0, 1)",
            ):
                connection.exec_driver_sql(row)
    monkeypatch.undo()
    with open_store(store_url) as store:
        [kept] = store.coefficient_history().items
        assert (kept.value, kept.sd, kept.low, kept.high) == (700.0, 9.0, 680.0, 720.0)
        assert (store.newest_fit_number("lab"), store.newest_fit_number("other")) == (1, 0)
        assert len(store.load_run(name).time_s) == 37
        assert store.run_record(name).started_utc == BEGAN
        assert store.contents().schema == max(steps)


def test_journal_lines_of_older_versions_are_kept_as_texts_and_promotions_get_their_code(store_url, monkeypatch):
    steps = migrations()
    monkeypatch.setattr("daq.store.database.migrations", lambda: {n: sql for n, sql in steps.items() if n < 4})
    odd = 'v"2\\'
    with open_store(store_url) as store, store.database.writing() as connection:
        for message in (f"model {odd} promoted", "press-left silent"):
            row = text("INSERT INTO event (unix_s, level, process, message) VALUES (0.0, 'info', 'x', :message)")
            connection.execute(row, {"message": message})
    monkeypatch.undo()
    with open_store(store_url) as store:
        store.log("info", "x", say("run-interrupted", run="r"))
        messages = [e.message for e in store.journal_after(0)]
    assert messages == [
        say("model-promoted", version=odd),
        say("plain-text", text="press-left silent"),
        say("run-interrupted", run="r"),
    ]


def test_the_password_of_a_store_is_not_kept_with_each_run(store):
    key = store.register_press("lab", CHANNELS)
    settings_ = '[store]\nurl = "postgresql://kerntemp:ge:h@im@db.plant/kerntemp"\n[[press]]\nname = "lab"\n'
    store.append_scans(key, scans(0, 3), begin=NewRun("r", 0, BEGAN, 1000.0, {}, settings_))
    assert store.configuration_of("r") == settings_.replace("ge:h@im", "***")


def test_the_tables_are_as_the_code_sees_them(store):
    found = inspect(store.database.engine)
    for table in METADATA.tables.values():
        assert [c["name"] for c in found.get_columns(table.name)] == [c.name for c in table.columns]
        keys = {c.name for c in table.primary_key}
        assert set(found.get_pk_constraint(table.name)["constrained_columns"]) == keys


def test_opening_a_store_again_keeps_it(store_url):
    with open_store(store_url) as store:
        name = record_one_run(store)
    with open_store(store_url) as store:
        assert len(store.load_run(name).time_s) == 37


def test_a_store_from_a_newer_version_is_refused_and_left_alone(store_url):
    with open_store(store_url) as store, store.database.writing() as connection:
        connection.execute(text("UPDATE schema_version SET version = 99"))
    with pytest.raises(InputError, match=r"made by a newer version \(schema 99, this version knows \d+\); update"):
        open_store(store_url)


def test_a_migration_that_fails_half_way_leaves_the_store_as_it_was(store_url, monkeypatch):
    with open_store(store_url) as store:
        name = record_one_run(store)
    good = migrations()
    newer = max(good) + 1
    broken = {**good, newer: "ALTER TABLE run ADD COLUMN shift TEXT;\nCREATE TABLE x (y TEXT);\nTHIS IS NO SQL;\n"}
    monkeypatch.setattr("daq.store.database.migrations", lambda: broken)
    with pytest.raises(Exception, match="THIS"):
        open_store(store_url)
    monkeypatch.setattr("daq.store.database.migrations", lambda: good)
    with open_store(store_url) as store:
        assert len(store.load_run(name).time_s) == 37
        assert "x" not in inspect(store.database.engine).get_table_names()
    mended = {**good, newer: "ALTER TABLE run ADD COLUMN shift TEXT;\n"}
    monkeypatch.setattr("daq.store.database.migrations", lambda: mended)
    with open_store(store_url) as store:
        columns = [c["name"] for c in inspect(store.database.engine).get_columns("run")]
        assert columns[-1] == "shift"


def test_a_view_of_somebody_elses_that_stops_a_migration_is_named(store_url, monkeypatch):
    good = migrations()
    monkeypatch.setattr("daq.store.database.migrations", lambda: {1: good[1]})
    with open_store(store_url) as store, store.database.writing() as connection:
        connection.execute(text("CREATE VIEW mine AS SELECT run, value FROM coefficient_history"))
    monkeypatch.setattr("daq.store.database.migrations", lambda: good)
    with pytest.raises(InputError, match=r"view mine is not Kerntemp's .* drop it, start again") as caught:
        open_store(store_url)
    assert "\n" not in str(caught.value)
    monkeypatch.setattr("daq.store.database.migrations", lambda: {1: good[1]})
    with open_store(store_url) as store, store.database.writing() as connection:
        connection.execute(text("DROP VIEW mine"))
    monkeypatch.setattr("daq.store.database.migrations", lambda: good)
    with open_store(store_url) as store:
        assert "value_w_m2k" in {c["name"] for c in inspect(store.database.engine).get_columns("coefficient")}


def test_sqlite_writes_ahead_and_syncs_fully(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store, store.database.reading() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar() == 2


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("mysql://x/y", "mysql is not supported"),
        ("sqlite://", "needs a file path"),
        ("nonsense://", "nonsense is not supported"),
        ("://x", "not a URL"),
        ("no/such/folder/s.sqlite", "folder no/such/folder does not exist; create it"),
        (".", "is a folder"),
    ],
)
def test_a_wrong_address_is_refused_in_one_line(url, message):
    with pytest.raises(InputError, match=message) as caught:
        open_store(url)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_store_is_refused(tmp_path):
    path = tmp_path / "s.sqlite"
    path.write_text("time_s,top_1\n" * 500)
    with pytest.raises(InputError, match=r"not an SQLite file.* kerntemp backup --restore.* another path"):
        open_store(str(path))
    with open_store(str(path), later=True) as store, pytest.raises(StoreUnavailable, match="not an SQLite file"):
        store.runs()


def test_reading_a_store_that_is_not_there_does_not_make_one(tmp_path):
    with pytest.raises(InputError, match="does not exist; start kerntemp record"):
        open_store(str(tmp_path / "s.sqlite"), create=False)
    assert list(tmp_path.iterdir()) == []


def test_an_unreachable_server_is_named_without_its_password():
    with pytest.raises(StoreUnavailable, match="check that the database server runs") as caught:
        open_store("postgresql://eva:secret@127.0.0.1:1/x", busy_s=1)
    assert "secret" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_locked_store_says_so_and_goes_on_when_it_is_free(tmp_path):
    path = tmp_path / "s.sqlite"
    with open_store(str(path), busy_s=0.1) as store:
        key = store.register_press("lab", CHANNELS)
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreUnavailable, match="database is locked; another process holds it"):
            store.append_scans(key, scans(0, 1))
        assert store.newest_scan_number("lab") == -1
        other.execute("ROLLBACK")
        other.close()
        store.append_scans(key, scans(0, 1))
        assert store.newest_scan_number("lab") == 0


def test_a_semicolon_ends_a_statement_only_at_a_line_end():
    assert statements("A 'x; y' B;\nC;\n-- only words\n", "sqlite") == ["A 'x; y' B", "C"]


def test_what_a_server_s_address_asks_of_the_session_holds_beside_what_we_ask(postgresql_url):
    server = create_engine(postgresql_url)
    with server.begin() as connection:
        connection.execute(text("CREATE SCHEMA plant"))
    with open_store(f"{postgresql_url}?options=-csearch_path%3Dplant&keepalives_idle=7", busy_s=4.0) as store:
        record_one_run(store)
        with store.database.reading() as connection:
            assert connection.execute(text("SHOW lock_timeout")).scalar_one() == "4s"
    with server.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM plant.run")).scalar_one() == 1
    server.dispose()


def test_a_postgresql_url_gets_its_driver():
    assert store_url("postgresql://u@h/d").drivername == "postgresql+psycopg"


def test_a_recorded_run_keeps_start_moments_life_and_remark_on_its_way_into_another_store(store, tmp_path):
    name = record_one_run(store)
    store.annotate_run(name, {"remark": 'edge chipped;\nsee photo 7, "left"'}, "anna")
    before = store.run_record(name)
    for suffix in ("csv", "parquet"):
        write_run(store.run_for_file(name), tmp_path / f"a.{suffix}")
        with open_store(str(tmp_path / f"{suffix}.sqlite")) as other:
            other.import_run(read_run(tmp_path / f"a.{suffix}"), "lab")
            after = other.run_record(name)
            write_run(other.run_for_file(name), tmp_path / f"b.{suffix}")
        for field in ("started_utc", "ended_utc", "status", "remark", "software_version"):
            assert getattr(after, field) == getattr(before, field)
        assert (after.moments.inserted_s, after.moments.closed_s) == pytest.approx((0.3, 1.5))
        assert str(after.moments) == str(before.moments)
        assert (tmp_path / f"b.{suffix}").read_bytes() == (tmp_path / f"a.{suffix}").read_bytes()


def test_an_interrupted_run_stays_interrupted_and_a_file_of_an_open_one_becomes_so(store, tmp_path):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, scans(0, 9), begin=NewRun("r", 2, BEGAN, 1000.2))
    write_run(store.run_for_file("r"), tmp_path / "open.csv")
    store.interrupt_open_runs("lab")
    write_run(store.run_for_file("r"), tmp_path / "cut.csv")
    for file in ("open.csv", "cut.csv"):
        with open_store(str(tmp_path / f"{file}.sqlite")) as other:
            other.import_run(read_run(tmp_path / file), "lab")
            assert other.run_record("r").status is RunStatus.INTERRUPTED


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("recorded.started_utc", datetime(2026, 3, 4), "must be a time with its zone"),  # noqa: DTZ001
        ("recorded.started_utc", 5, "must be a time with its zone"),
        ("recorded.ended_utc", datetime(1, 1, 1, tzinfo=UTC), "between the years 1970 and 9999"),
        ("recorded.closed_s", "soon", "must be a number of seconds"),
        ("recorded.status", "lost", "one of closed, interrupted, open"),
        ("remark", 7, "must be text"),
        ("run", "", "must be a name"),
        ("run", "../../etc/run", "without slashes"),
        ("run", "a\\b", "without slashes"),
        ("run", "..", "must be a name"),
        ("run", "a\nb", "line breaks"),
        ("run", "a\0b", "must be a name"),
        ("run", "a\u202eb", "characters that nobody sees"),
        ("run", " a", "blanks at its ends"),
        ("run", "a" * 201, "1 to 200 bytes"),
        ("run", "é" * 101, "1 to 200 bytes"),
        ("run", ["a"], "must be a name"),
    ],
)
def test_a_header_that_cannot_be_is_refused_by_key_and_nothing_is_stored(store, key, value, message):
    run = Run(str(value) if key == "run" else "r", {key: value}, np.arange(3.0), {"top_1": np.ones(3)}, "r.csv")
    with pytest.raises(InputError, match=f"r.csv: header key {key} = .*{message}"):
        store.import_run(run, "lab")
    assert store.contents().scans == 0
    assert not store.presses()


def test_a_file_of_endless_times_does_not_spoil_the_list_of_runs(store):
    began = datetime(2026, 3, 4, tzinfo=UTC)
    for name, header in (("a", {}), ("b", {"recorded.started_utc": began})):
        store.import_run(Run(name, header, np.array([0.0, 1e300]), {"top_1": np.ones(2)}), "lab")
    listed = {run.run: run for run in store.runs().items}
    assert (listed["a"].started_utc, listed["a"].ended_utc) == (None, None)
    assert (listed["b"].started_utc, listed["b"].ended_utc.year) == (began, 9999)


def test_what_a_file_says_in_words_beside_its_rows_goes_through_the_store(tmp_path):
    file = tmp_path / "r.csv"
    file.write_text(
        '# run = "r"\n# panel.material = "MDF"\n# panel.thickness_mm = 16.0\n'
        "time_s,platen_top,note,quality,top_1\n"
        '0,200,,,20\n1,200,door open,top_1=open,\n2,200,,,21\n3,200,"leans, slightly",,22\n'
    )
    run = read_run(file)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        store.import_run(run, "lab")
        back = store.run_for_file("r")
        later = store.run_for_file("r", from_s=2.0)
    assert back.texts == run.texts
    assert back.texts["note"] == ("", "door open", "", "leans, slightly")
    assert later.texts["note"] == ("", "leans, slightly")
    write_run(back, tmp_path / "back.csv")
    assert read_run(tmp_path / "back.csv").texts == run.texts


def test_a_column_called_quality_that_holds_other_words_is_kept_as_words(tmp_path):
    run = Run("r", {"run": "r"}, np.arange(2.0), {"top_1": np.ones(2)}, texts={"quality": ("fine", "")})
    with open_store(str(tmp_path / "s.sqlite")) as store:
        store.import_run(run, "lab")
        assert store.run_for_file("r").texts == run.texts


def test_nights_come_newest_first_and_say_where_the_next_begins(store):
    for i in range(3):
        began = BEGAN + timedelta(days=i)
        store.put_night(
            StoredNight(f"press-{i % 2}", began, began + timedelta(seconds=9), {"new": i}, {"seen": i})
        )
    page = store.nights(limit=2)
    assert [night.night["new"] for night in page.items] == [2, 1]
    assert [night.night["new"] for night in store.nights(cursor=page.next_cursor).items] == [0]
    assert {press: night.progress["seen"] for press, night in store.newest_nights().items()} == {
        "press-0": 2,
        "press-1": 1,
    }
    assert store.nights(press="press-1").items[0].started_utc == BEGAN + timedelta(days=1)


def test_a_run_without_a_fit_is_remembered_until_it_has_one(store):
    name = record_one_run(store)
    store.put_unfitted(name, "lab", "killed", "")
    assert store.killed_runs("lab") == [name]
    store.put_unfitted(name, "lab", "blind", "a1")
    assert (store.killed_runs("lab"), store.unfitted_marks([name, "x"])) == ([], {name: "a1"})
    assert store.count_unfitted("lab") == {"blind": 1}
    store.put_fit(name, {"run": name})
    assert (store.unfitted_marks([name]), store.count_unfitted("lab")) == ({}, {})


def test_pressings_are_runs_that_are_over_and_were_closed(store):
    first, second = record_one_run(store), record_one_run(store)
    key = store.register_press("lab", CHANNELS)
    n = key.next_number
    store.append_scans(key, scans(n, 5), begin=NewRun("still-open", n, BEGAN, 1000.0 + n / 10, {}, ""))
    assert [r.run for r in store.pressings("lab")] == [second, first]
    number = store.run_record(first).number
    assert [r.run for r in store.pressings("lab", after=number)] == [second]
    assert [r.run for r in store.pressings("lab", below=number + 1)] == [first]
    assert [store.count_pressings("lab", below=number + n) for n in (0, 1, 10)] == [0, 1, 2]
    assert store.count_pressings("lab") == 2
    store.append_scans(key, [], end=RunEnd("still-open", n + 4, BEGAN))
    assert store.count_pressings("lab") == 2  # never closed: nothing was pressed
    newest, edited = store.edited_after("lab", 0)
    assert edited == []
    store.annotate_run(first, {"panel.thickness_mm": 15.0}, "tester")
    assert store.edited_after("lab", newest)[1] == [first]
    assert store.edited_after("elsewhere", newest)[1] == []
