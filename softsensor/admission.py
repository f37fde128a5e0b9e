"""What a run must offer to be solved: rising times, possible temperatures and properties, whole boundaries.

Every refusal is an error of its own name (`daq.records`), a line that says file, place, value, limit and remedy.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.pressfile import Boundary, Load, Press
from daq.records import (
    COLDEST_C,
    HOTTEST_C,
    Array,
    BoundaryGap,
    BrokenTime,
    InputError,
    Moments,
    Nonphysical,
    Run,
)
from softsensor.effects.effect import Effect
from softsensor.timing import OPENING_RAMP_S

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


def value_limits(
    effects: Iterable[Effect], coefficients: Iterable[str], nuisances: Iterable[str]
) -> dict[str, tuple[float, float]]:
    """Return what each parameter of a model can be at all."""
    largest = sys.float_info.max
    own = {e.key(p.name): (max(p.least, -largest), min(p.most, largest)) for e in effects for p in e.parameters}
    return dict.fromkeys(coefficients, (0.0, largest)) | own | dict.fromkeys(nuisances, (-largest, largest))


def check_values(limits: Mapping[str, tuple[float, float]], values: Mapping[str, float]) -> None:
    """Refuse a value that is no number or that no matter has, and one that belongs to nothing, by name."""
    for name, value in values.items():
        if name not in limits:
            raise InputError(f"{name!r} is no parameter of this model; it has {list(limits)}")
        least, most = limits[name]
        try:
            possible = least <= value <= most
        except TypeError:
            possible = False
        if not possible:
            words = [f"at least {least:g}"] * (least > -1e300) + [f"at most {most:g}"] * (most < 1e300)
            raise Nonphysical(f"{name} = {value!r}: must be {', '.join(['a finite number', *words])}")


def check_first_readings(
    run: Run, layers: Sequence[str], place_of: Mapping[str, int], labels: Sequence[str]
) -> None:
    """Refuse a start from first readings where a layer from the run has none."""
    for layer in layers:
        inside = [c for c, place in place_of.items() if labels[place].startswith((f"{layer}.", f"{layer}@"))]
        if not any(np.isfinite(run.columns[column]).any() for column in inside):
            raise InputError(
                f'{run.source or run.name}: [initial] kind = "sensors" needs a reading in layer {layer!r}; empty '
                f'are {", ".join(inside) or "all columns"}: fill one, or give kind = "steady" or "uniform"'
            )


def load_series(run: Run, load: Load) -> Array | None:
    """Return a contact's load at every row, in the column's unit, None where the run holds none above 0.

    Short gaps are bridged. Loads below a hundredth of the largest are taken as that: a contact never vanishes.

    Raises
    ------
    BoundaryGap
        Where the column is empty for more than `MAX_BRIDGE_S`.
    Nonphysical
        For a load that is not finite, or below 0 by more than a hundredth of the largest.
    """
    column = load.column
    values = run.columns.get(column, np.zeros(0))
    if not (values > 0.0).any():
        return None
    where = run.source or run.name
    good = np.isfinite(values)
    smallest = max(float(values[good].max(initial=0.0)) * 0.01, 1e-6)
    wrong = np.flatnonzero(np.isinf(values) | (values < -smallest))
    if len(wrong):
        i = int(wrong[0])
        raise Nonphysical(
            f"{where}: load column {column!r} = {values[i]:g} at time_s = {run.time_s[i]:g}: must be a finite "
            f"number, not below 0; empty the cell, or mend the column's sign or zero"
        )
    hole = _worst_gap(run.time_s, good)
    if hole is not None:
        raise BoundaryGap(
            f"{where}: load column {column!r} is empty for {hole[1]:.1f} s around time_s = {hole[0]:g}; at most "
            f"{MAX_BRIDGE_S:g} s of a load are bridged: cut the run there, or leave the column out"
        )
    return np.maximum(np.interp(run.time_s, run.time_s[good], values[good]), smallest)


def check_load(run: Run, load: Load, moments: Moments) -> None:
    """Refuse a load that is not above 0 while the press is closed; an open press rests on nothing."""
    values, t = run.columns[load.column], run.time_s
    shut = (t > moments.closed_s + moments.ramp_s / 2) & ~(t > moments.opened_s - OPENING_RAMP_S / 2)
    wrong = np.flatnonzero(shut & (values <= 0.0))
    if len(wrong):
        i = int(wrong[0])
        raise Nonphysical(
            f"{run.source or run.name}: load column {load.column!r} = {values[i]:g} at time_s = {t[i]:g}, where "
            f"the press is closed: must be above 0; empty the cell, or mend the column's sign or zero"
        )


def setting_load(run: Run) -> float | None:
    """Return the pressing's pressure of the run's settings [N/cm²]; refuse one that is not above 0."""
    pressure = run.setting("pressure_N_cm2")
    if pressure is not None and not 0.0 < pressure < np.inf:
        raise Nonphysical(
            f"{run.source or run.name}: header key setting.pressure_N_cm2 = {pressure:g}: must be a number above "
            f"0 N/cm²; mend it, or leave it out where it is not known"
        )
    return pressure


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
    impossible = np.flatnonzero(~np.isnan(values) & ~((values > COLDEST_C) & (values < HOTTEST_C)))
    if len(impossible):
        i = int(impossible[0])
        raise Nonphysical(
            f"{where}: column {column!r} = {values[i]:g} °C at time_s = {run.time_s[i]:g}: boundary.{name} must "
            f"lie between {COLDEST_C:g} and {HOTTEST_C:g} °C; empty the cell"
        )
    good = np.isfinite(values)
    if not good.any():
        raise BoundaryGap(f"{where}: column {column!r} holds no value; boundary.{name} needs it")
    hole = _worst_gap(run.time_s, good)
    if hole is not None:
        raise BoundaryGap(
            f"{where}: column {column!r} is empty for {hole[1]:.1f} s around time_s = {hole[0]:g}; at most "
            f"{MAX_BRIDGE_S:g} s of boundary.{name} are bridged: cut the run there"
        )
    return np.interp(run.time_s, run.time_s[good], values[good])


def _worst_gap(time_s: Array, good: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Return where the longest gap between good rows is and its length, None if it can be bridged. [s]"""
    holes, times = np.flatnonzero(~good), time_s[good]
    if not len(holes):
        return None
    before = np.searchsorted(times, time_s[holes]) - 1
    gap = np.where(
        before < 0,
        times[0] - time_s[0],
        np.where(
            before + 1 < len(times),
            times[np.minimum(before + 1, len(times) - 1)] - times[np.maximum(before, 0)],
            time_s[-1] - times[-1],
        ),
    )
    worst = int(np.argmax(gap))
    return (float(time_s[holes[worst]]), float(gap[worst])) if gap[worst] > MAX_BRIDGE_S else None
