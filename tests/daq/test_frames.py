"""Runs as pandas tables: times, zones, qualities and header come back as they went in; events of a long table."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from datetime import UTC, date, datetime, time
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import daq
from daq.face import EVENT
from daq.files.qualities import quality_text
from daq.files.run_file import read_run
from daq.press.detector import PressEventDetector
from daq.press.press_file import read_press
from daq.records import Quality, Run

LAB = daq.shared_files() / "presses/lab.toml"
SAMPLES = sorted((daq.shared_files() / "samples").glob("2026-*.csv"))
NUMBERS = st.one_of(st.none(), st.floats(-200.0, 1300.0))


@settings(deadline=None)
@given(
    values=st.lists(NUMBERS, min_size=1, max_size=20),
    start=st.datetimes(min_value=pd.Timestamp(1990, 1, 1), max_value=pd.Timestamp(2090, 1, 1)),
    nanosecond=st.integers(0, 999),
    steps=st.lists(st.integers(1, 10**12), min_size=20, max_size=20),
    zone=st.sampled_from(["UTC", "Europe/Berlin", "Asia/Kathmandu"]),
    unit=st.sampled_from(["us", "ns"]),
)
def test_instants_of_any_zone_come_back_to_the_nanosecond(values, start, nanosecond, steps, zone, unit):
    first = pd.Timestamp(start, tz="UTC").as_unit("ns") + pd.Timedelta(nanosecond, "ns")
    index = (first + pd.to_timedelta(np.cumsum([0, *steps[: len(values) - 1]]), unit=unit)).tz_convert(zone)
    column = np.array([np.nan if v is None else v for v in values])
    frame = pd.DataFrame({"top_1": column}, index=index)
    frame.attrs["panel.material"] = "MDF"
    back = daq.frame_of(daq.run_of(frame), utc=True)
    assert (back.index == index).all()
    assert back["top_1"].to_numpy().tobytes() == column.tobytes()
    assert back.attrs["panel.material"] == "MDF"
    once_more = daq.frame_of(daq.run_of(back), utc=True)
    pd.testing.assert_frame_equal(once_more, back)
    assert once_more.attrs == back.attrs


@settings(deadline=None)
@given(
    faults=st.lists(
        st.dictionaries(st.sampled_from(["top_1", "bottom_1", "*"]), st.sampled_from(list(Quality)), max_size=3),
        min_size=1,
        max_size=12,
    )
)
def test_qualities_stand_beside_the_values_they_are_of(faults):
    rows = len(faults)
    texts = tuple(quality_text({name: str(q) for name, q in row.items()}) for row in faults)
    frame = pd.DataFrame(
        {"top_1": np.full(rows, 20.0), "bottom_1": np.full(rows, 30.0), "quality": texts},
        index=pd.Index(np.arange(rows, dtype=float), name="time_s"),
    )
    run = daq.run_of(frame)
    table = daq.qualities_of(run)
    back = daq.frame_of(daq.run_of(daq.frame_of(run)))
    assert back["quality"].tolist() == list(texts)
    for row, fault in enumerate(faults):
        for name in ("top_1", "bottom_1"):
            quality = fault.get(name, fault.get("*", Quality.GOOD))
            assert table[name].iloc[row] == str(quality)
            assert np.isnan(run.columns[name][row]) == (not quality.usable)


@pytest.mark.parametrize("place", ["column", "index"])
def test_a_run_and_its_table_do_not_change_one_another(place):
    frame = pd.DataFrame({"time_s": [0.0, 1.0], "top_1": [1.0, 2.0]})
    frame.attrs["setting.steps"] = [1, 2]
    frame = frame if place == "column" else frame.set_index("time_s")
    run = daq.run_of(frame)
    frame.loc[frame.index[0], "top_1"] = 9.0
    frame.attrs["setting.steps"].append(3)
    if place == "column":
        frame.loc[0, "time_s"] = -1.0
    assert run.columns["top_1"].tolist() == [1.0, 2.0]
    assert run.time_s.tolist() == [0.0, 1.0]
    assert run.header["setting.steps"] == [1, 2]
    back = daq.frame_of(run)
    back.iloc[0, 0] = 9.0
    assert run.columns["top_1"].tolist() == [1.0, 2.0]


def test_a_run_cannot_be_changed_and_goes_to_another_process_as_it_is():
    run = daq.run_of(pd.DataFrame({"time_s": [0.0, 1.0], "top_1": [1.0, 2.0]}), {"setting.a": 1.0})
    for one in (run, pickle.loads(pickle.dumps(run)), copy.deepcopy(run)):
        with pytest.raises(TypeError, match="change a copy"):
            one.header["setting.a"] = 2.0
        with pytest.raises(TypeError, match="change a copy"):
            one.columns.update(top_1=run.time_s)
        assert one.header == {"setting.a": 1.0}
        assert one.columns["top_1"].tolist() == [1.0, 2.0]
    for array in (run.time_s, run.columns["top_1"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
    assert {**run.header, "setting.b": 1} == run.header | {"setting.b": 1}


@pytest.mark.parametrize(
    ("given", "numbers"),
    [
        ([21.5, None], [21.5, np.nan]),
        ([None, 22], [np.nan, 22.0]),
        ([True, Decimal("1.5")], [1.0, 1.5]),
        ([np.float32(1.5), pd.NA], [1.5, np.nan]),
        ([None, np.nan], [np.nan, np.nan]),
    ],
)
def test_objects_that_are_all_numbers_or_missing_are_a_channel(given, numbers):
    frame = pd.DataFrame({"time_s": [0.0, 1.0], "top_1": pd.Series(given, dtype=object)})
    run = daq.run_of(frame)
    assert not run.texts
    np.testing.assert_array_equal(run.columns["top_1"], numbers)


@pytest.mark.parametrize("column", ["time_s", "closed"])
def test_words_where_only_numbers_can_stand_are_named_by_their_row(column):
    frame = pd.DataFrame({"time_s": [0.0, 1.0], "closed": [0.0, 1.0]}).astype({column: object})
    frame.loc[1, column] = "abc"
    with pytest.raises(daq.InputError, match=f"row 2: column {column}: 'abc' is not a number; leave a missing"):
        daq.run_of(frame)
    with pytest.raises(daq.InputError, match=f"row 1: column {column}: '.*' is a number kept as text"):
        daq.run_of(frame.replace("abc", 1.0).astype({column: str}))


@pytest.mark.parametrize("kind", ["timedelta64[ns]", "timedelta64[ms]", object])
@pytest.mark.parametrize("place", ["column", "index"])
def test_durations_are_taken_in_seconds(kind, place):
    frame = pd.DataFrame({"time_s": pd.to_timedelta([0.0, 0.5, 2.0], unit="s").astype(kind), "top_1": 20.0})
    run = daq.run_of(frame if place == "column" else frame.set_index("time_s").rename_axis(None))
    assert run.time_s.tolist() == [0.0, 0.5, 2.0]


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_a_column_of_instants_is_read_as_an_index_of_them(zone):
    instants = pd.date_range("2026-10-25 01:59:58", periods=4, freq="500ms", tz=zone)
    frame = pd.DataFrame({"top_1": [1.0, 2.0, 3.0, 4.0]}, index=instants)
    read = daq.run_of(frame)
    for column in (instants, instants.astype(object)):
        run = daq.run_of(frame.reset_index(drop=True).assign(time_s=column))
        assert run.time_s.tolist() == read.time_s.tolist() == [0.0, 0.5, 1.0, 1.5]
        assert run.header == read.header


@pytest.mark.parametrize("utc", [True, False])
@pytest.mark.parametrize("layout", ["attrs", "nothing"])
@pytest.mark.filterwarnings("ignore:header key own.day is not known")
def test_a_table_of_instants_goes_through_parquet_and_back(tmp_path, utc, layout):
    index = pd.date_range("2026-10-25 01:59:58.000000123", periods=4, freq="500ms", tz="Europe/Berlin")
    run = daq.run_of(pd.DataFrame({"top_1": [20.0, np.nan, 22.0, 23.0], "remark": list("abcd")}, index=index))
    ended = datetime(2026, 10, 25, 1, 0, tzinfo=UTC)
    run = replace(run, header={**run.header, "recorded.ended_utc": ended, "own.day": ended.date()})
    frame = daq.frame_of(run, utc=utc)
    assert frame.attrs["own.day"] == "2026-10-25"
    if layout == "nothing":
        frame.attrs.clear()
    frame.to_parquet(tmp_path / "run.parquet")
    for back in (daq.run_of(pd.read_parquet(tmp_path / "run.parquet")), read_run(tmp_path / "run.parquet")):
        assert back.time_s.tobytes() == run.time_s.tobytes()
        assert back.columns["top_1"].tobytes() == run.columns["top_1"].tobytes()
        assert back.texts == run.texts
        if utc or layout == "attrs":
            assert back.header["recorded.started_utc"] == run.header["recorded.started_utc"]
        if layout == "attrs":
            assert back.header == {**run.header, "run": run.name, "own.day": "2026-10-25"}


NO_CHANNELS = {
    "remark": ["a", None, "c"],
    "shift": pd.Categorical(["early", None, "late"]),
    "cycle": [7, 7, 8],
    "day": [date(2026, 3, 4), None, date(2026, 3, 5)],
    "at_clock": [time(8, 0), time(8, 0, 1), None],
    "seen": pd.DatetimeIndex(["2026-03-04 08:00:00.5", None, "2026-03-04 08:00:02"], tz="Europe/Berlin"),
    "took": pd.to_timedelta([1.0, 2.5, None], unit="s"),
    "weight": [Decimal("12.50"), None, Decimal("7")],
    "count": pd.array([1, None, 2**60 + 1], dtype="Int64"),
    "empty": [None, None, None],
    "flag": [True, False, True],
    "raw": [b"1", b"", None],
}


CSV_HAS_NO_KINDS = ("flag", "seen", "took", "raw")
"""pandas writes instants, durations and bytes there in ways of its own, and nothing shows what True was."""


@pytest.mark.parametrize("name", NO_CHANNELS)
def test_a_column_that_no_channel_names_is_read_alike_from_table_parquet_and_csv(name, tmp_path):
    """CONTRACT: columns that the press file does not name are kept and ignored."""
    table = pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "top_1": [20.0, 21.0, 22.0], name: NO_CHANNELS[name]})
    given = daq.run_of(table)
    table.to_parquet(tmp_path / "run.parquet")
    table.to_csv(tmp_path / "run.csv", index=False)
    as_numbers = {column: repr(values.tolist()) for column, values in given.columns.items()}
    from_parquet, from_csv = read_run(tmp_path / "run.parquet"), read_run(tmp_path / "run.csv")
    assert from_parquet.texts == given.texts
    assert {column: repr(values.tolist()) for column, values in from_parquet.columns.items()} == as_numbers
    assert {*from_csv.columns, *from_csv.texts} == {*given.columns, *given.texts}
    if name not in CSV_HAS_NO_KINDS:
        assert from_csv.texts == given.texts
        assert {column: repr(values.tolist()) for column, values in from_csv.columns.items()} == as_numbers


@pytest.mark.parametrize(("name", "values"), [("closed", [date(2026, 3, 4)]), ("time_s", [date(2026, 3, 4)])])
def test_times_and_a_limit_switch_of_another_kind_are_refused_from_parquet(name, values, tmp_path):
    pd.DataFrame({"time_s": [0.0], "top_1": [20.0], name: values}).to_parquet(tmp_path / "run.parquet")
    with pytest.raises(daq.InputError, match=name):
        read_run(tmp_path / "run.parquet")


def test_parquet_of_durations_is_read_and_a_missing_instant_named(tmp_path):
    path = tmp_path / "run.parquet"
    pd.DataFrame({"time_s": pd.to_timedelta([0.0, 0.5], unit="s"), "top_1": [1.0, 2.0]}).to_parquet(path)
    assert read_run(path).time_s.tolist() == [0.0, 0.5]
    pd.DataFrame({"top_1": [1.0, 2.0]}, index=pd.DatetimeIndex(["2026-01-01", None], tz="UTC")).to_parquet(path)
    with pytest.raises(daq.InputError, match="row 2: the time is missing"):
        read_run(path)


AT = pd.date_range("2026-10-25 01:59:58", periods=3, freq="500ms")


@pytest.mark.parametrize(
    "index",
    [
        AT.tz_localize("Europe/Berlin").rename("at"),
        AT.tz_localize("UTC").as_unit("us"),
        AT,
        pd.to_timedelta([0.25, 0.5, 2.0], unit="s").as_unit("ms"),
        pd.Index([0.25, 0.5, 2.0], name="time_s"),
        pd.Index([1, 2, 4], name="time_s"),
    ],
    ids=lambda index: str(index.dtype),
)
@pytest.mark.parametrize("place", ["index", "column"])
def test_what_a_run_has_no_room_for_comes_back_with_its_table(index, place):
    frame = pd.DataFrame(
        {
            "phase": pd.Categorical(["hot", None, "cold"], categories=["cold", "hot", "off"], ordered=True),
            "cycle": np.array([1, 2, 2**31 - 1], np.int32),
            "top_1": np.array([20.5, np.nan, 22.25], np.float32),
            "batch": pd.Categorical([7, 8, 7]),
            "laid_in": pd.to_datetime(["2026-10-25 00:30", None, "2026-10-25 02:30"], utc=True).tz_convert(
                "Europe/Berlin"
            ),
            "since": pd.to_timedelta([1.5, 2.5, None], unit="s"),
            "day": pd.to_datetime(["2026-10-25", "2026-10-26", None]),
            "flag": pd.array([True, None, False], dtype="boolean"),
            "remark": ["a", "", "b"],
        },
        index=index,
    )
    if place == "column":
        frame.insert(3, "time_s", index)
        frame = frame.reset_index(drop=True)
    run = daq.run_of(frame)
    for one in (run, pickle.loads(pickle.dumps(run)), copy.deepcopy(run)):
        pd.testing.assert_frame_equal(daq.frame_of(one, as_given=True), frame, check_freq=False)
    assert daq.frame_of(run).index.dtype == np.float64
    assert daq.run_of(daq.frame_of(run, as_given=True)).header == {**run.header, "run": run.name}


def test_a_kind_that_cannot_hold_what_is_in_a_column_now_is_not_forced_on_it():
    frame = pd.DataFrame({"time_s": [0.0, 1.0], "cycle": [1, 2], "phase": pd.Categorical(["a", "b"])})
    run = daq.run_of(frame.assign(quality=["", "cycle=open"]))
    assert daq.frame_of(run)["cycle"].tolist()[0] == 1.0
    assert np.isnan(daq.frame_of(run)["cycle"].iloc[1])
    other = replace(run, columns={"cycle": np.array([1.5, 2.0])}, texts={"phase": ("a", "c")})
    back = daq.frame_of(other)
    assert (back["cycle"].tolist(), back["phase"].tolist()) == ([1.5, 2.0], ["a", "c"])
    assert list(back.columns) == ["cycle", "phase"]


def test_a_runs_rows_keep_the_kinds_of_its_table():
    frame = pd.DataFrame({"cycle": [1, 2, 3]}, index=AT.tz_localize("Europe/Berlin"))
    back = daq.frame_of(daq.run_of(frame).at_rows(slice(1, 3)), as_given=True)
    pd.testing.assert_frame_equal(back, frame.iloc[1:], check_freq=False)


def test_instants_need_a_start_and_say_so():
    with pytest.raises(daq.InputError, match=r"recorded\.started_utc"):
        daq.frame_of(read_run(SAMPLES[0]), utc=True)


def test_an_instant_that_is_missing_is_named_by_its_row():
    index = pd.DatetimeIndex(["2026-01-01", None], tz="UTC")
    with pytest.raises(daq.InputError, match="row 2"):
        daq.run_of(pd.DataFrame({"top_1": [1.0, 2.0]}, index=index))


def test_every_pressing_of_a_days_table_is_found_and_none_more():
    parts, begin, closings = [], 0.0, []
    for path in SAMPLES[4:7]:
        run = read_run(path)
        closings.append(begin + daq.find_moments(run, LAB).closed_s)
        frame = daq.frame_of(run)[["platen_top", "platen_bottom", "top_1", "top_2", "bottom_1", "bottom_2"]]
        parts.append(frame.set_index(pd.Index(frame.index + begin, name="time_s")))
        begin = float(parts[-1].index[-1]) + 1.0
    day = pd.concat(parts)
    day.attrs["recorded.started_utc"] = pd.Timestamp("2026-03-04 08:00", tz="UTC").to_pydatetime()
    found = daq.find_events(day, read_press(LAB))
    assert list(found.columns) == [*EVENT, "utc"]
    closed = found[found["event"] == "closed"]
    assert len(closed) == 3
    assert np.abs(closed.index - closings).max() < 1.0
    assert (found["noticed_s"] >= found.index).all()
    assert (
        closed["utc"] - pd.Timestamp("2026-03-04 08:00", tz="UTC")
    ).dt.total_seconds().tolist() == pytest.approx(closed.index.tolist(), abs=1e-6)


def test_what_else_a_table_holds_is_not_looked_at_and_changes_no_event():
    run = read_run(SAMPLES[4])
    press = read_press(LAB)
    flows = {f"flow_{i}": np.full(len(run.time_s), np.nan if i else 7.0) for i in range(3)}
    wide = Run(
        run.name, run.header, run.time_s, {**flows, **run.columns, "closed": np.full(len(run.time_s), np.nan)}
    )
    looked = PressEventDetector(press).looks_at(tuple(wide.columns))
    assert {"platen_top", "platen_bottom", "top_1", "bottom_1", "closed"} <= set(looked)
    assert not set(flows) & set(looked)
    pd.testing.assert_frame_equal(daq.find_events(wide, press), daq.find_events(run, press))


def test_a_table_without_any_pressing_has_no_events():
    quiet = Run("quiet", {}, np.arange(60.0), {"platen_top": np.full(60, 190.0), "top_1": np.full(60, 21.0)})
    assert daq.find_events(quiet, LAB).empty
