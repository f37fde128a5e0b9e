"""What a wrong header, clock or wiring does to the live core: ``python -m tests.calibration.wrong_headers``.

Short and long pressings of the virtual press, by a model that eight runs of 16 mm were held against. Printed for
each lie: the share of scans that are valid, their band's mean half-width, the share of them whose band misses
the truth and by how much at worst, and how far ahead the filter with the true thickness is of the header's after
30 and 60 s in the closed press (nats, mean over the runs). Before it what a right header gives, of a known and
of a new product.
"""

import sys
from dataclasses import replace

import numpy as np

from daq.simulated.campaign import make_campaign
from softsensor.heat.model_file import PressedPanel
from softsensor.live.sensor import ScanSensor
from tests.softsensor.test_live_trust import HELD, PLAN, PRESS, held_from, with_columns

MODEL = replace(HELD, panels=(PressedPanel(PLAN.thickness_mm, 8),))
AFTER_S = (30.0, 60.0)
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
    for factor in (0.5, 0.75, 1.25, 1.5):
        yield f"thickness x {factor}", with_header(run, "panel.thickness_mm", factor)
    for factor in (0.5, 0.65, 1.25, 1.5):
        yield f"density x {factor}", with_header(run, "panel.density_kg_m3", factor)
    yield "time x 0.8", replace(run, time_s=0.8 * run.time_s)
    jumped = np.where(run.time_s > closed_s + 10.0, run.time_s + 25.0, run.time_s)
    yield "25 s jump after closing", replace(run, time_s=jumped)
    yield "panel channels 20 scans late", late(run, 20)
    yield "faces swapped", swapped(run)
    yield "faces frozen after closing", with_columns(run, PANEL, held_from(run, closed_s + 10.0))


def pressings(seed, press_time_s):
    """Yield runs with their truth: right ones of three thicknesses, then the first with each lie."""
    plan = replace(PLAN, press_time_s=press_time_s)
    for thickness in (PLAN.thickness_mm, 12.0, 20.0):
        ((run, truth),) = make_campaign(seed, 1, None, replace(plan, thickness_mm=thickness))
        yield f"nothing, {thickness:g} mm", run, truth
    ((run, truth),) = make_campaign(seed, 1, None, plan)
    for lie, changed in lies(run, truth.moments.closed_s):
        yield lie, changed, truth


def followed(run, truth):
    """Return of valid scans half-width and distance beyond the band [K], their share, and nats by `AFTER_S`."""
    sensor, rows, ahead = ScanSensor(PRESS, run.header, MODEL), [], {}
    for i, time_s in enumerate(run.time_s.tolist()):
        estimate = sensor.update(time_s, {name: float(values[i]) for name, values in run.columns.items()})
        core = truth.core_C[i]
        if estimate.valid:
            reach = (estimate.core_high_C - estimate.core_low_C) / 2
            rows.append((reach, max(estimate.core_low_C - core, core - estimate.core_high_C)))
        for after_s in AFTER_S:
            if time_s < truth.moments.closed_s + after_s and (current := sensor._run.passes.current) is not None:
                ahead[after_s] = _ahead(current.filters)
    return (
        np.array(rows).reshape(-1, 2),
        len(rows) / len(run.time_s),
        [ahead.get(after_s, 0.0) for after_s in AFTER_S],
    )


def _ahead(filters):
    """Return by how much the best filter of another panel is likelier than the header's best. [nats]"""
    best = [max([f.fit for f in filters if (f.panel > 0) is other], default=np.nan) for other in (False, True)]
    return best[1] - best[0]


def main(seeds):
    for label, press_time_s in PRESS_TIMES_S.items():
        print(f"\npressed for {label:32s} valid  half K  missed  at worst    nats 30, 60 s")
        found = {}
        for seed in seeds:
            for lie, run, truth in pressings(seed, press_time_s):
                found.setdefault(lie, []).append(followed(run, truth))
        for lie, runs in found.items():
            half, beyond = np.concatenate([rows for rows, _, _ in runs]).T
            valid, nats = (
                np.mean([share for _, share, _ in runs]),
                np.mean([ahead for _, _, ahead in runs], axis=0),
            )
            missed = (
                f"{half.mean():6.1f} {np.mean(beyond > 0.0):7.0%} {max(beyond.max(), 0.0):7.1f} K"
                if len(beyond)
                else ""
            )
            shown = "" if np.isnan(nats).any() else f"{nats[0]:10.1f} {nats[1]:6.1f}"
            print(f"  {lie:42s} {valid:5.0%} {missed:24s} {shown}")


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or [501, 502, 503])
