"""How long a fit takes: one run, twenty runs together, and with the profiles a report draws."""

import os
import time

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.jobs.campaign import fit_campaign

PRESS = parse_press(press_toml())
RUNS = 20


@pytest.mark.benchmark
@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 10.0])
def test_time_of_a_campaign(rate_hz):
    plan = Plan(rate_hz=rate_hz, nuisances=Nuisances.real_chain())
    runs = [run for run, _ in make_campaign(31, RUNS, plan=plan)]
    fit_campaign(PRESS, runs[:1], profiles=True)
    alone = fit_campaign(PRESS, runs, workers=1)
    single = [f.seconds for f in alone.runs]
    spent = {}
    for profiles in (False, True):
        begun = time.perf_counter()
        found = fit_campaign(PRESS, runs, profiles=profiles)
        spent[profiles] = time.perf_counter() - begun
    rows = np.median([len(run.time_s) for run in runs])
    print(
        f"\n{rate_hz:g} Hz, {rows:.0f} rows a run, {os.cpu_count()} cores: "
        f"one run {np.median(single):.2f} s (median), {max(single):.2f} s (longest); "
        f"{RUNS} runs together {spent[False]:.1f} s, with profiles {spent[True]:.1f} s"
    )
    assert all(f.converged for f in found.runs)
