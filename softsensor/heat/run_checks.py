"""What a run must offer to be solved: rising times, possible temperatures and properties, whole boundaries.

Every refusal is an error of its own name (`daq.records`), a line that says file, place, value, limit and remedy.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.press.moments import CLOSING_RAMPS_S
from daq.press.press_file import Boundary, BoundaryKind, Load, Press
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
from daq.words import Argument, Message, say
from softsensor.effects.contact_load import LEAST_LOAD
from softsensor.effects.effect import Effect

LARGEST = float(np.finfo(float).max)
"""The largest number that a model can hold."""
MAX_BRIDGE_S = 10.0
"""Missing cells of a boundary column are bridged by a straight line up to this long (`bridged_s`: a slow
logger); the live sensor, which cannot know the next, holds the last reading as long. Set by hand, 2026-11. [s]"""

# Numbers without another source were set by hand, 2026-11.

MAX_GAP_S = 60.0
"""Missing rows are bridged up to this long; rows that lie further apart as a rule are not in seconds. [s]"""


def check_times(press: Press, run: Run, moments: Moments) -> None:
    """Refuse times that do not rise or are in another unit, long gaps, and moments out of order."""
    where, t = run.source or run.name, run.time_s
    if len(t) < 2:
        raise BrokenTime(say("run-too-short", run=where, rows=len(t)))
    steps = np.diff(t)
    wrong = np.flatnonzero(~(np.isfinite(steps) & (steps > 0)))
    if len(wrong):
        i = int(wrong[0])
        time, before = f"{t[i + 1]:g}", f"{t[i]:g}"
        raise BrokenTime(say("run-times-fall", run=where, time=time, before=before, row=i + 2))
    usual = float(np.median(steps))
    if usual > MAX_GAP_S:
        raise BrokenTime(say("run-rows-far-apart", run=where, seconds=usual, most=MAX_GAP_S))
    measured = BoundaryKind.MEASURED in (press.boundary.bottom.kind, press.boundary.top.kind)
    i = int(np.argmax(steps))
    if measured and steps[i] > MAX_GAP_S:
        seconds = float(steps[i])
        raise BrokenTime(say("run-rows-missing", run=where, seconds=seconds, time=f"{t[i]:g}", most=MAX_GAP_S))
    order = ("inserted_s", "closed_s", "opened_s", "removed_s")
    known = [(name, value) for name in order if np.isfinite(value := getattr(moments, name))]
    for (before, early), (after, late) in itertools.pairwise(known):
        if late < early:
            times = {"late": f"{late:g}", "early": f"{early:g}"}
            raise InputError(say("run-moments-out-of-order", run=where, later=after, earlier=before, **times))
    if not 0.0 <= moments.ramp_s < np.inf:
        raise InputError(say("run-ramp-impossible", run=where, value=f"{moments.ramp_s:g}"))


def check_ambient(run: Run) -> None:
    """Refuse an ambient that cannot be."""
    if not COLDEST_C < run.ambient_temperature < HOTTEST_C:
        where, value = run.source or run.name, f"{run.ambient_temperature:g}"
        raise Nonphysical(
            say("header-ambient-impossible", run=where, value=value, lower=COLDEST_C, upper=HOTTEST_C)
        )


def value_limits(
    effects: Iterable[Effect], coefficients: Iterable[str], nuisances: Iterable[str]
) -> dict[str, tuple[float, float]]:
    """Return what each parameter of a model can be at all."""
    own = {e.key(p.name): (max(p.least, -LARGEST), min(p.most, LARGEST)) for e in effects for p in e.parameters}
    return dict.fromkeys(coefficients, (0.0, LARGEST)) | own | dict.fromkeys(nuisances, (-LARGEST, LARGEST))


def check_values(limits: Mapping[str, tuple[float, float]], values: Mapping[str, float]) -> None:
    """Refuse a value that is no number or that no matter has, and one that belongs to nothing, by name."""
    for name, value in values.items():
        if name not in limits:
            raise InputError(say("parameter-unknown", name=name, known=tuple(limits)))
        least, most = limits[name]
        try:
            possible = least <= value <= most
        except TypeError:
            possible = False
        if not possible:
            raise Nonphysical(_limited(name, repr(value), least, most))


def _limited(name: str, value: str, least: float, most: float) -> Message:
    """Say what a value must be; limits as large as numbers can be are none."""
    given = {"name": name, "value": value}
    if least <= -LARGEST:
        return say("value-not-finite", **given) if most >= LARGEST else say("value-at-most", most=most, **given)
    if most >= LARGEST:
        return say("value-at-least", least=least, **given)
    return say("value-between", least=least, most=most, **given)


def check_first_readings(
    run: Run, layers: Sequence[str], place_of: Mapping[str, int], labels: Sequence[str]
) -> None:
    """Refuse a start from first readings where a layer from the run has none."""
    for layer in layers:
        inside = [c for c, place in place_of.items() if labels[place].startswith((f"{layer}.", f"{layer}@"))]
        if not any(np.isfinite(run.columns[column]).any() for column in inside):
            where = {"run": run.source or run.name, "layer": layer}
            empty = say("start-layer-without-reading", **where, columns=tuple(inside))
            raise InputError(empty if inside else say("start-layer-without-channel", **where))


def load_series(run: Run, load: Load) -> Array | None:
    """Return a contact's load at every row, in the column's unit, None where the run holds none above 0.

    Short gaps are bridged. Loads below a hundredth of the largest are taken as that: a contact never vanishes.

    Raises
    ------
    BoundaryGap
        Where the column is empty for longer than `bridged_s`.
    Nonphysical
        For a load that is not finite, or below 0 by more than a hundredth of the largest.
    """
    column = load.column
    values = run.columns.get(column, np.zeros(0))
    if not (values > 0.0).any():
        return None
    where = run.source or run.name
    good = np.isfinite(values)
    smallest = max(float(values[good].max(initial=0.0)) * LEAST_LOAD, 1e-6)
    wrong = np.flatnonzero(np.isinf(values) | (values < -smallest))
    if len(wrong):
        i = int(wrong[0])
        value, time = f"{values[i]:g}", f"{run.time_s[i]:g}"
        raise Nonphysical(say("load-impossible", run=where, column=column, value=value, time=time))
    if gap := _too_long_a_gap(run.time_s, good):
        raise BoundaryGap(say("load-gap", run=where, column=column, **gap))
    return np.maximum(np.interp(run.time_s, run.time_s[good], values[good]), smallest)


def check_load(run: Run, load: Load, moments: Moments) -> None:
    """Refuse a load that is not above 0 while the press is closed; an open press rests on nothing.

    A limit switch trips anywhere in a ramp: within the longest one of a moment the load may have come, or gone.
    """
    values, t, ramp_s = run.columns[load.column], run.time_s, float(CLOSING_RAMPS_S[-1])
    shut = (t > moments.closed_s + ramp_s) & ~(t > moments.opened_s - ramp_s)
    wrong = np.flatnonzero(shut & (values <= 0.0))
    if len(wrong):
        i = int(wrong[0])
        at = {"column": load.column, "value": f"{values[i]:g}", "time": f"{t[i]:g}"}
        raise Nonphysical(say("load-zero-while-closed", run=run.source or run.name, **at))


def setting_load(run: Run) -> float | None:
    """Return the pressing's pressure of the run's settings [N/cm²]; refuse one that is not above 0."""
    pressure = run.setting("pressure_N_cm2")
    if pressure is not None and not 0.0 < pressure < np.inf:
        where = run.source or run.name
        raise Nonphysical(say("header-pressure-impossible", run=where, value=f"{pressure:g}"))
    return pressure


def load_remarks(press: Press, run: Run) -> list[Message]:
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
    remarks: list[Message] = []
    for column, contacts in lacking.items():
        which: dict[str, Argument] = {"run": run.source or run.name, "column": column, "contacts": tuple(contacts)}
        if column in run.columns:
            remarks.append(say("load-column-empty", **which))
        else:
            remarks.append(say("load-column-missing", columns=tuple(run.columns), **which))
    return remarks


def boundary_series(run: Run, name: str, boundary: Boundary) -> Array:
    """Return a measured boundary's temperature at every row, short gaps bridged (rows). [°C]"""
    if boundary.kind is not BoundaryKind.MEASURED:
        return np.zeros(len(run.time_s))
    column = boundary.column or ""
    where = run.source or run.name
    if column not in run.columns:
        columns = tuple(run.columns)[:20]
        raise InputError(say("boundary-column-missing", run=where, column=column, end=name, columns=columns))
    values = run.columns[column]
    impossible = np.flatnonzero(~np.isnan(values) & ~((values > COLDEST_C) & (values < HOTTEST_C)))
    if len(impossible):
        i = int(impossible[0])
        at: dict[str, Argument] = {
            "value": f"{values[i]:g}",
            "time": f"{run.time_s[i]:g}",
            "lower": COLDEST_C,
            "upper": HOTTEST_C,
        }
        raise Nonphysical(say("boundary-impossible", run=where, column=column, end=name, **at))
    good = np.isfinite(values)
    if not good.any():
        raise BoundaryGap(say("boundary-empty", run=where, column=column, end=name))
    if gap := _too_long_a_gap(run.time_s, good):
        raise BoundaryGap(say("boundary-gap", run=where, column=column, end=name, **gap))
    return np.interp(run.time_s, run.time_s[good], values[good])


def bridged_s(time_s: Array) -> float:
    """Return for how long a column may be empty: `MAX_BRIDGE_S`, and of a slow logger a single cell. [s]

    One cell makes a gap of two periods, two make one of three: the limit lies between.
    """
    return max(MAX_BRIDGE_S, min(0.5 * (2 + 3) * float(np.median(np.diff(time_s))), MAX_GAP_S))


def _too_long_a_gap(time_s: Array, good: NDArray[np.bool_]) -> dict[str, Argument]:
    """Return where the longest gap between good rows is, how long, and what is bridged; nothing if it is. [s]"""
    holes, times = np.flatnonzero(~good), time_s[good]
    if not len(holes):
        return {}
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
    worst, most = int(np.argmax(gap)), bridged_s(time_s)
    if gap[worst] <= most:
        return {}
    return {"time": f"{time_s[holes[worst]]:g}", "seconds": float(gap[worst]), "most": most}
