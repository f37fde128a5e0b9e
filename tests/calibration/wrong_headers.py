"""What a wrong header, clock or wiring does to the live core: ``python -m tests.calibration.wrong_headers``.

Short and long pressings of the virtual press, by a model that eight runs were held against. Printed for each lie:
the share of scans that are valid, that of valid ones whose band misses the truth, and by how much at worst.
"""

import sys
from dataclasses import replace

import numpy as np

from daq.simulated.campaign import make_campaign
from tests.softsensor.test_live_trust import HELD, PLAN, held_from, replay, with_columns

PANEL = ("top_", "bottom_")
FACES = ("top", "bottom")
PRESS_TIMES_S = {"40 to 60 s": (40.0, 60.0), "90 to 110 s": (90.0, 110.0)}


def with_header(run, key, factor):
    """Return a run whose header has a number times `factor`."""
    return replace(run, header={**run.header, key: factor * run.header[key]})


def late(run, rows):
    """Return a run whose panel channels come so many rows late."""
    return with_columns(run, PANEL, lambda values: np.r_[np.full(rows, values[0]), values[:-rows]])


def swapped(run):
    """Return a run whose faces are exchanged."""
    other = {f"{a}_{i}": run.columns[f"{b}_{i}"] for a, b in (FACES, FACES[::-1]) for i in range(1, 8)}
    return replace(run, columns={**run.columns, **other})


def lies(run, closed_s):
    """Yield what a run may say that is not so."""
    yield "nothing", run
    for factor in (0.5, 0.75, 1.25, 1.5):
        yield f"thickness x {factor}", with_header(run, "panel.thickness_mm", factor)
    for factor in (0.5, 1.5):
        yield f"density x {factor}", with_header(run, "panel.density_kg_m3", factor)
    yield "time x 0.8", replace(run, time_s=0.8 * run.time_s)
    jumped = np.where(run.time_s > closed_s + 10.0, run.time_s + 25.0, run.time_s)
    yield "25 s jump after closing", replace(run, time_s=jumped)
    yield "panel channels 20 scans late", late(run, 20)
    yield "faces swapped", swapped(run)
    yield "faces frozen after closing", with_columns(run, PANEL, held_from(run, closed_s + 10.0))


def main(seeds):
    for told, press_time_s in PRESS_TIMES_S.items():
        print(f"\npressed for {told:32s} valid  missed  at worst")
        found = {}
        for seed in seeds:
            ((run, truth),) = make_campaign(seed, 1, None, replace(PLAN, press_time_s=press_time_s))
            for lie, changed in lies(run, truth.moments.closed_s):
                rows = zip(replay(changed, HELD), truth.core_C, strict=True)
                beyond = [max(e.core_low_C - c, c - e.core_high_C) for e, c in rows if e.valid]
                found.setdefault(lie, []).append((len(beyond) / len(run.time_s), beyond))
        for lie, runs in found.items():
            beyond = np.array([kelvin for _, each in runs for kelvin in each])
            valid = np.mean([share for share, _ in runs])
            missed = f"{np.mean(beyond > 0.0):6.0%} {max(beyond.max(), 0.0):7.1f} K" if len(beyond) else ""
            print(f"  {lie:42s} {valid:5.0%} {missed}")


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or [501, 502, 503])
