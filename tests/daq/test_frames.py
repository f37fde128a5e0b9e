"""Runs as pandas tables: times, zones, qualities and header come back as they went in; events of a long table."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import daq
from daq.files.qualities import quality_text
from daq.files.run_file import read_run
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
    for row, said in enumerate(faults):
        for name in ("top_1", "bottom_1"):
            quality = said.get(name, said.get("*", Quality.GOOD))
            assert table[name].iloc[row] == str(quality)
            assert np.isnan(run.columns[name][row]) == (not quality.usable)


def test_a_table_of_floats_is_not_copied_and_the_run_does_not_change_it():
    frame = pd.DataFrame({"top_1": [1.0, 2.0], "n": [1, 2]}, index=pd.Index([0.0, 1.0], name="time_s"))
    run = daq.run_of(frame)
    assert np.shares_memory(run.columns["top_1"], frame["top_1"].to_numpy())
    assert run.columns["n"].dtype == np.float64


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
    closed = found[found["event"] == "closed"]
    assert len(closed) == 3
    assert np.abs(closed.index - closings).max() < 1.0
    assert (found["noticed_s"] >= found.index).all()
    assert (
        closed["utc"] - pd.Timestamp("2026-03-04 08:00", tz="UTC")
    ).dt.total_seconds().tolist() == pytest.approx(closed.index.tolist(), abs=1e-6)


def test_a_table_without_any_pressing_has_no_events():
    quiet = Run("quiet", {}, np.arange(60.0), {"platen_top": np.full(60, 190.0), "top_1": np.full(60, 21.0)})
    assert daq.find_events(quiet, LAB).empty
