"""What a run must offer to be solved: rising times, possible temperatures and properties, whole boundaries.

Every refusal is an error of its own name (`daq.records`), a line that says file, place, value, limit and remedy.
"""

from __future__ import annotations

import itertools

import numpy as np

from daq.pressfile import Boundary, Load, Press
from daq.records import Array, BoundaryGap, BrokenTime, InputError, Moments, Nonphysical, Run

MAX_BRIDGE_S = 10.0
"""Missing cells of a boundary column are bridged by a straight line up to this long. [s]"""
MAX_GAP_S = 60.0
"""Missing rows are bridged up to this long. [s]"""
LIMITS = {
    "thickness_mm": (0.001, 10000.0),
    "conductivity_W_mK": (0.005, 5000.0),
    "density_kg_m3": (0.5, 25000.0),
    "heat_capacity_J_kgK": (50.0, 15000.0),
}
"""What a layer of the press file can be, from gases to diamond, lead and water; panels have narrower ones."""
COLDEST_C, HOTTEST_C = -273.15, 2000.0


def check_times(press: Press, run: Run, moments: Moments) -> None:
    """Refuse times that do not rise, long gaps, and moments out of order."""
    where, t = run.source or run.name, run.time_s
    if len(t) < 2:
        raise BrokenTime(f"{where}: column time_s has {len(t)} row; a run needs at least two")
    steps = np.diff(t)
    wrong = np.flatnonzero(~(np.isfinite(steps) & (steps > 0)))
    if len(wrong):
        i = int(wrong[0])
        raise BrokenTime(
            f"{where}: time_s = {t[i + 1]:g} follows {t[i]:g} (row {i + 2}): times must rise; mend the row"
        )
    measured = "measured" in (press.boundary.bottom.kind, press.boundary.top.kind)
    i = int(np.argmax(steps))
    if measured and steps[i] > MAX_GAP_S:
        raise BrokenTime(
            f"{where}: no row for {steps[i]:.1f} s after time_s = {t[i]:g}; at most {MAX_GAP_S:g} s of a measured "
            f"boundary are bridged: cut the run there"
        )
    order = ("inserted_s", "closed_s", "opened_s", "removed_s")
    known = [(name, value) for name in order if np.isfinite(value := getattr(moments, name))]
    for (before, early), (after, late) in itertools.pairwise(known):
        if late < early:
            raise InputError(f"{where}: {after} = {late:g} lies before {before} = {early:g}; check column closed")
    if not 0.0 <= moments.ramp_s < np.inf:
        raise InputError(f"{where}: ramp_s = {moments.ramp_s:g}: closing takes a finite time, at least 0 s")


def check_layers(press: Press, run: Run) -> None:
    """Refuse properties of layers, and an ambient, that no matter has."""
    where = run.source or run.name
    for i, layer in enumerate(press.layer):
        for key, (lower, upper) in LIMITS.items():
            given = getattr(layer, key)
            for value in [y for _, y in given] if isinstance(given, tuple) else [given]:
                if value is not None and not lower <= value <= upper:
                    raise Nonphysical(
                        f"{where}: layer.{i}.{key} = {value:g} ({layer.name!r}): must be a number from "
                        f"{lower:g} to {upper:g}; mend the press file"
                    )
    if not COLDEST_C < run.ambient_temperature < HOTTEST_C:
        raise Nonphysical(
            f"{where}: header key ambient.temperature_C = {run.ambient_temperature:g}: must be a number from "
            f"{COLDEST_C:g} to {HOTTEST_C:g}"
        )


def load_series(run: Run, load: Load) -> Array | None:
    """Return a contact's load at every row, in the column's unit, None where the run holds none above 0.

    Loads below a hundredth of the largest are taken as that: a contact never vanishes.
    """
    values = run.columns.get(load.column, np.zeros(0))
    good = np.isfinite(values)
    if not (values[good] > 0.0).any():
        return None
    smallest = max(float(np.nanmax(values)) * 0.01, 1e-6)
    return np.maximum(np.interp(run.time_s, run.time_s[good], values[good]), smallest)


def load_remarks(press: Press, run: Run) -> list[str]:
    """Say of each load column that the run does not hold what is done instead.

    Parameters
    ----------
    press
        With the run's overrides applied.
    """
    lacking: dict[str, list[str]] = {}
    for contact in press.contact:
        if contact.load is not None and load_series(run, contact.load) is None:
            lacking.setdefault(contact.load.column, []).append("-".join(contact.between))
    told = []
    for column, contacts in lacking.items():
        lacks = (
            "holds no value above 0" if column in run.columns else f"is missing (it has {', '.join(run.columns)})"
        )
        told.append(
            f"{run.source or run.name}: load column {column!r} {lacks}: {' and '.join(contacts)} taken as "
            f"independent of load; give the column, or take load out of the press file"
        )
    return told


def boundary_series(run: Run, name: str, boundary: Boundary) -> Array:
    """Return a measured boundary's temperature at every row, short gaps bridged."""
    if boundary.kind != "measured":
        return np.zeros(len(run.time_s))
    column = boundary.column or ""
    where = run.source or run.name
    if column not in run.columns:
        raise InputError(
            f"{where}: column {column!r} is missing; boundary.{name} needs it "
            f"(the run has {', '.join(list(run.columns)[:20])})"
        )
    values = run.columns[column]
    good = np.isfinite(values)
    if not good.any():
        raise BoundaryGap(f"{where}: column {column!r} holds no value; boundary.{name} needs it")
    impossible = np.flatnonzero(good & ~((values > COLDEST_C) & (values < HOTTEST_C)))
    if len(impossible):
        i = int(impossible[0])
        raise Nonphysical(
            f"{where}: column {column!r} = {values[i]:g} °C at time_s = {run.time_s[i]:g}: boundary.{name} must "
            f"lie between {COLDEST_C:g} and {HOTTEST_C:g} °C; empty the cell"
        )
    times = run.time_s[good]
    holes = np.flatnonzero(~good)
    if len(holes):
        before = np.searchsorted(times, run.time_s[holes]) - 1
        gap = np.where(
            before < 0,
            times[0] - run.time_s[0],
            np.where(
                before + 1 < len(times),
                times[np.minimum(before + 1, len(times) - 1)] - times[np.maximum(before, 0)],
                run.time_s[-1] - times[-1],
            ),
        )
        worst = int(np.argmax(gap))
        if gap[worst] > MAX_BRIDGE_S:
            raise BoundaryGap(
                f"{where}: column {column!r} is empty for {gap[worst]:.1f} s around time_s = "
                f"{run.time_s[holes[worst]]:g}; at most {MAX_BRIDGE_S:g} s of boundary.{name} are bridged: "
                f"cut the run there"
            )
    return np.interp(run.time_s, times, values[good])
