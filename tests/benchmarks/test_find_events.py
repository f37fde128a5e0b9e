"""Press events of a long table: rows a second, beside what handing the rows over takes and a million a second."""

import time

import numpy as np
import pytest

import daq
from daq.press.press_file import parse_press
from daq.records import Run
from daq.simulated.campaign import Plan, make_campaign, press_toml
from daq.simulated.campaign_sensors import CHANNELS

PRESS = parse_press(press_toml())
PRESSINGS, REPEATED = 10, 5
ASKED = 1_000_000
"""Rows a second that are wished for."""


def a_day(rate_hz):
    """Pressings one after another, noise and rough sensors as the virtual press has them."""
    made = [run for run, _ in make_campaign(7, PRESSINGS, None, Plan(rate_hz=rate_hz, closed_column=False))]
    names = [name for name in CHANNELS if all(name in run.columns for run in made)]
    times, end = [], 0.0
    for _ in range(REPEATED):
        for run in made:
            times.append(run.time_s - run.time_s[0] + end)
            end = float(times[-1][-1]) + 1.0
    columns = {name: np.concatenate([run.columns[name] for run in made] * REPEATED) for name in names}
    return Run("day", {}, np.concatenate(times), columns)


@pytest.mark.benchmark
@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
def test_rows_a_second_of_finding_events(rate_hz):
    day = a_day(rate_hz)
    rows = len(day.time_s)
    daq.find_events(day, PRESS)  # loads what is compiled, fills the tables that place a moment
    begun = time.thread_time()
    found = daq.find_events(day, PRESS)
    whole = time.thread_time() - begun
    begun = time.thread_time()
    for _ in zip(*(values.tolist() for values in day.columns.values()), strict=True):
        pass
    handed = time.thread_time() - begun
    assert (found["event"] == "closed").sum() == PRESSINGS * REPEATED
    print(
        f"\n{rate_hz:g} Hz: {rows} rows of {len(day.columns)} channels, {len(found)} events in {whole:.2f} s: "
        f"{1e6 * whole / rows:.1f} us a row, {ASKED * whole / rows:.1f} times what a million rows a second "
        f"allows; {whole / handed:.0f} times what handing the rows over takes"
    )
