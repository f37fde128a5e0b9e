"""The live sensor beside what else one could do, and what an update costs. Prints tables, asserts no times.

The alternatives: the paper's open-loop simulation, a plain Kalman filter on a lumped model (three nodes,
faces measured), and a table of times (mean core curve of earlier pressings of that thickness).
"""

import time
from dataclasses import replace

import numpy as np
import pytest

from daq.press_events import find_moments
from daq.pressfile import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics import BASE_COEFFICIENTS
from softsensor.model import ThermalModel
from softsensor.modelfile import Estimate, ModelFile
from softsensor.observer import LiveSensor

PRESS = parse_press(press_toml())
MODEL = ModelFile("bench", "lab", {n: Estimate(v, 0.2 * v) for n, v in BASE_COEFFICIENTS.items()})
PLAN = Plan(rate_hz=2.0, thickness_mm=16.0, closed_column=False)
CAUSES = (
    None,
    "vapour_convection",
    "moisture_evaporation",
    "conductivity_temperature",
    "edge_loss",
    "contact_lapse",
)
pytestmark = pytest.mark.benchmark


def replay(run, model=MODEL):
    sensor = LiveSensor(PRESS, run.header, model)
    names = [n for n in run.columns if not n.startswith("core")]
    table = np.stack([run.columns[n] for n in names], axis=1).tolist()
    said, spent = [], []
    for t, row in zip(run.time_s.tolist(), table, strict=True):
        begun = time.perf_counter()
        said.append(sensor.update(t, dict(zip(names, row, strict=True))))
        spent.append(time.perf_counter() - begun)
    return said, np.array(spent)


def live(run, _earlier):
    said, _ = replay(run)
    return np.array([(e.core_C, e.core_low_C, e.core_high_C) for e in said])


def open_loop(run, _earlier):
    model = ThermalModel(PRESS)
    core = model.solve(model.prepare(run, find_moments(run, PRESS)), BASE_COEFFICIENTS).core
    return np.stack([core, core * np.nan, core * np.nan], axis=1)


def face(run, name):
    return np.nanmedian(np.stack([v for n, v in run.columns.items() if n.startswith(f"{name}_")]), axis=0)


def lumped(run, _earlier):
    """Two half panels about a core node; the faces drive them; conductances of the header's board."""
    k, c, half = 0.12, 740.0 * 1550.0, run.header["panel.thickness_mm"] / 2000.0
    x = np.full(3, run.header["panel.initial_temperature_C"])
    p, rate = np.eye(3) * 0.1, k / (half / 2) / (c * half * 2 / 3)
    a = rate * np.array([[-2.0, 1, 0], [1, -2, 1], [0, 1, -2]])
    top, bottom = face(run, "top"), face(run, "bottom")
    rows, before = [], run.time_s[0]
    for t, u, v in zip(run.time_s, bottom, top, strict=True):
        f = np.eye(3) + a * (t - before)
        x, p, before = f @ x + rate * (t - before) * np.array([u, 0, v]), f @ p @ f.T + np.eye(3) * 1e-4, t
        rows.append((x[1], x[1] - 1.96 * np.sqrt(p[1, 1]), x[1] + 1.96 * np.sqrt(p[1, 1])))
    return np.array(rows)


def table_of_times(run, earlier):
    grid = np.arange(-20.0, 300.0)
    curves = [np.interp(grid, r.time_s - t.moments.closed_s, t.core_C - t.core_C[0]) for r, t in earlier]
    rise = np.mean(curves, axis=0)
    core = run.header["panel.initial_temperature_C"] + np.interp(
        run.time_s - find_moments(run, PRESS).closed_s, grid, rise
    )
    return np.stack([core, core * np.nan, core * np.nan], axis=1)


METHODS = {"live sensor": live, "open loop": open_loop, "lumped filter": lumped, "table of times": table_of_times}


def test_core_error_beside_the_alternatives():
    print(f"\n{'hidden':26s}" + "".join(f"{name:>28s}" for name in METHODS))
    print(f"{'':26s}" + "".join(f"{'rmse  in band  half-width':>28s}" for _ in METHODS))
    earlier = make_campaign(90, 4, None, PLAN)
    for cause in CAUSES:
        found = {name: [] for name in METHODS}
        for run, truth in make_campaign(91, 4, cause, PLAN):
            for name, method in METHODS.items():
                core, low, high = method(run, earlier).T
                inside = np.where(np.isnan(low), np.nan, (low <= truth.core_C) & (truth.core_C <= high))
                found[name].append(np.stack([core - truth.core_C, inside, (high - low) / 2]))
        line = f"{cause or 'nothing':26s}"
        for rows in found.values():
            error, inside, width = np.concatenate(rows, axis=1)
            good = np.isfinite(error)
            line += f"{np.sqrt(np.mean(error[good] ** 2)):14.2f} K"
            line += (
                "           -"
                if np.isnan(inside).all()
                else f" {np.nanmean(inside):5.2f} {np.nanmean(width):4.1f} K"
            )
        print(line)


@pytest.mark.parametrize("rate", [10.0, 2.0])
def test_what_an_update_costs(rate):
    ((run, _),) = make_campaign(92, 1, None, replace(PLAN, rate_hz=rate))
    replay(run)
    _, spent = replay(run)
    us = 1e6 * spent
    print(
        f"\n{rate:g} Hz: update median {np.median(us):.0f} us, mean {us.mean():.0f}, "
        f"99 % {np.quantile(us, 0.99):.0f}, worst {us.max() / 1000:.0f} ms (a replay); {len(us)} scans"
    )


def test_a_long_run_does_not_grow_slower():
    ((run, _),) = make_campaign(
        93, 1, None, replace(PLAN, press_time_s=(600.0, 601.0), open_after_s=(600.0, 601.0))
    )
    _, spent = replay(run)
    parts = np.array_split(spent, 6)
    print(
        "\nmedian update over a long run, by sixths: " + ", ".join(f"{1e6 * np.median(p):.0f} us" for p in parts)
    )
