"""Press events of a long table: those found scan by scan, the detector asked at few rows."""

import numpy as np
import pandas as pd
import pytest

import daq
from daq import face
from daq.press.detector import PressEventDetector
from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from daq.simulated.campaign_sensors import CHANNELS

PRESS = parse_press(press_toml())
TOP, BOTTOM, PLATENS = ([name for name in CHANNELS if name.startswith(kind)] for kind in ("top", "bottom", "plat"))


def a_table(rate_hz, *, pause_s=5.0, seed=3):
    """Two pressings one after another, without a wire."""
    made = [run for run, _ in make_campaign(seed, 2, None, Plan(rate_hz=rate_hz, closed_column=False))]
    times = [made[0].time_s, made[1].time_s + made[0].time_s[-1] + pause_s - made[1].time_s[0]]
    columns = {name: np.concatenate([run.columns[name] for run in made]) for name in (*TOP, *BOTTOM, *PLATENS)}
    return daq.Run("table", {}, np.concatenate(times), columns)


def holes(run, rng):
    for name in run.columns:
        run.columns[name][rng.random(len(run.time_s)) < rng.choice([0.0, 0.02, 0.4])] = np.nan


def silence(run, rng):
    for name in run.columns:
        first = rng.integers(len(run.time_s))
        run.columns[name][first : first + rng.integers(1, 60)] = np.nan


def rough_and_broken_sensors(run, rng):
    run.columns["top_1"][:] += 20.0 * rng.normal(size=len(run.time_s))
    run.columns["top_2"][rng.random(len(run.time_s)) < 0.05] = 1300.0
    run.columns["bottom_1"][:] = np.nan
    run.columns["bottom_2"][:] = 21.0


def one_face(run, rng):
    for name in (TOP, BOTTOM)[rng.integers(2)]:
        del run.columns[name]


def no_platens(run, rng):
    for name in PLATENS:
        del run.columns[name]


def nothing_wrong(run, rng):
    """Leave it."""


@pytest.fixture
def rows_asked(monkeypatch):
    """How many rows of a table the detector was asked about."""
    asked, take = [], PressEventDetector.take
    monkeypatch.setattr(PressEventDetector, "take", lambda self, row: asked.append(row.time) or take(self, row))
    return asked


def in_both_ways(run, monkeypatch):
    monkeypatch.setattr(face, "LONG_ROWS", len(run.time_s) + 1)
    by_scan = daq.find_events(run, PRESS)
    monkeypatch.setattr(face, "LONG_ROWS", len(run.time_s))
    return by_scan, daq.find_events(run, PRESS)


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("damage", [nothing_wrong, holes, silence, rough_and_broken_sensors, one_face, no_platens])
def test_a_long_table_has_the_events_that_are_found_scan_by_scan(rate_hz, damage, monkeypatch, rows_asked):
    run = a_table(rate_hz)
    rng = np.random.default_rng([int(10 * rate_hz), len(damage.__name__)])
    damage(run, rng)
    kept = rng.random(len(run.time_s)) > 0.05
    run = daq.Run("table", {}, run.time_s[kept], {name: values[kept] for name, values in run.columns.items()})
    by_scan, at_once = in_both_ways(run, monkeypatch)
    pd.testing.assert_frame_equal(at_once, by_scan, check_exact=True)
    assert rows_asked
    if damage is nothing_wrong:
        assert by_scan["event"].tolist().count("closed") == 2


def test_the_detector_is_asked_about_nearly_no_row_while_nothing_moves(monkeypatch, rows_asked):
    run = a_table(1.0)
    idle = 20_000
    room = np.random.default_rng(1)
    columns = {
        name: np.concatenate([values, (values[-1] if name in PLATENS else 22.0) + 0.2 * room.normal(size=idle)])
        for name, values in run.columns.items()
    }
    times = np.concatenate([run.time_s, run.time_s[-1] + 1.0 + np.arange(idle)])
    by_scan, at_once = in_both_ways(daq.Run("table", {}, times, columns), monkeypatch)
    pd.testing.assert_frame_equal(at_once, by_scan, check_exact=True)
    assert by_scan["event"].iloc[-1] == "removed"
    assert len(rows_asked) < len(run.time_s) + 100


def test_a_table_that_logs_a_wire_is_looked_at_scan_by_scan(monkeypatch, rows_asked):
    run = a_table(1.0)
    run.columns["closed"] = np.zeros(len(run.time_s))
    by_scan, at_once = in_both_ways(run, monkeypatch)
    pd.testing.assert_frame_equal(at_once, by_scan, check_exact=True)
    assert not rows_asked


def test_a_table_whose_clock_was_set_back_has_the_events_that_are_found_scan_by_scan(monkeypatch, rows_asked):
    run = a_table(2.0)
    back = np.where(np.arange(len(run.time_s)) < 50, run.time_s, run.time_s - 10.0)
    by_scan, at_once = in_both_ways(daq.Run("table", {}, back, run.columns), monkeypatch)
    pd.testing.assert_frame_equal(at_once, by_scan, check_exact=True)
    assert not rows_asked
