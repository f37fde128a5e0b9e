"""What a user can set of a pressing, within which ranges, and the run that such settings would give.

The run is made from a measured one: its platens' course follows the press's movements, so a longer pressing holds
their last temperature and another set point shifts them. Sensors' readings are left to the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from daq.given import pair_of
from daq.press.header import panel_of
from daq.press.press_file import Press, press_for_run
from daq.press.wires import CLOSED
from daq.records import Array, InputError, Moments, Run
from daq.words import say
from softsensor.planning.wishes import WAITING_S

# Numbers without another source were set by hand, 2026-11.

SETTLED_S = 1.0
"""What a longer pressing holds is what was read half of so long before the opening. [s]"""


@dataclass(frozen=True)
class Factor:
    """One thing a user sets."""

    name: str
    """As in JSON and on the command line, the unit at its end."""
    share: float
    """By default the runs' own range is widened at either end by this share of its end, ..."""
    margin: float
    """... and by so much in its unit."""
    lower: float
    upper: float
    """No range goes beyond."""


FACTORS = {
    f.name: f
    for f in (
        Factor("platen_temperature_C", 0.0, 10.0, 60.0, 260.0),
        Factor("press_time_s", 0.5, 0.0, 5.0, 3600.0),
        Factor("thickness_mm", 0.25, 0.0, 2.0, 80.0),
        Factor("start_temperature_C", 0.0, 10.0, 0.0, 60.0),
        Factor("waiting_s", 0.5, 10.0, *WAITING_S),
        Factor("pressure_N_cm2", 0.2, 0.0, 10.0, 1000.0),
    )
}
"""Widened so far as a press that runs can be set from one panel to the next, by hand, 2026-11: the window of
laminating is some 40 K wide (145 to 200 °C) and 2 to 3 MPa (facts, physics.md, section 5), and panels come in
steps of about a quarter of their thickness. The limits are those of laminating presses at large."""
HEADER = {
    "thickness_mm": "panel.thickness_mm",
    "start_temperature_C": "panel.initial_temperature_C",
    "platen_temperature_C": "setting.platen_temperature_C",
    "press_time_s": "setting.press_time_s",
    "pressure_N_cm2": "setting.pressure_N_cm2",
}
Settings = Mapping[str, float]
"""By factor's name."""
Ranges = Mapping[str, tuple[float, float]]


def settings_of(run: Run, press: Press, moments: Moments) -> dict[str, float]:
    """Return what of a run a user can set; a factor that this press does not have is left out."""
    found: dict[str, float] = {}
    described = press_for_run(press, run)
    platens = [run.columns[column] for column in described.platens if column in run.columns]
    if platens:
        set_point = run.setting("platen_temperature_C")
        found["platen_temperature_C"] = float(np.nanmean(platens)) if set_point is None else set_point
    if described.has_states and np.isfinite(moments.closed_s):
        found["waiting_s"] = moments.closed_s - max(moments.inserted_s, float(run.time_s[0]))
        found["press_time_s"] = _opened(run, moments) - moments.closed_s
    if described.panel_layers:
        panel = panel_of(run)
        found["thickness_mm"] = 1000.0 * panel.thickness
        found["start_temperature_C"] = panel.initial_temperature
    if (pressure := run.setting("pressure_N_cm2")) is not None:
        found["pressure_N_cm2"] = pressure
    return found


def _opened(run: Run, moments: Moments) -> float:
    return moments.opened_s if np.isfinite(moments.opened_s) else float(run.time_s[-1])


def default_ranges(
    settings: Iterable[Settings], given: Ranges = MappingProxyType({})
) -> dict[str, tuple[float, float]]:
    """Return the ranges to plan within: as given, else the runs' own modestly widened (`FACTORS`).

    Raises InputError as `given_ranges`, for something these runs do not set too.
    """
    known = list(settings)
    found = {}
    for name, f in FACTORS.items():
        values = [s[name] for s in known if name in s]
        if values:
            low, high = min(values) * (1.0 - f.share) - f.margin, max(values) * (1.0 + f.share) + f.margin
            found[name] = (_readable(max(low, f.lower)), _readable(min(high, f.upper)))
    return given_ranges(given, found)


def given_ranges(given: Ranges, usual: Ranges) -> dict[str, tuple[float, float]]:
    """Return the usual ranges with the given ones in their places.

    Raises InputError for one that is not among the usual, is empty, or lies beyond the limits of `FACTORS`.
    """
    for name, ends in given.items():
        low, high = pair_of(ends, "given-no-ranges")
        if name not in usual:
            raise InputError(say("plan-range-unknown", name=name, known=tuple(usual)))
        f = FACTORS[name]
        if not f.lower <= low <= high <= f.upper:
            raise InputError(say("plan-range-wrong", name=name, low=low, high=high, lower=f.lower, upper=f.upper))
    return {**usual, **given}


def _readable(value: float) -> float:
    return float(f"{value:.3g}")


def designed_run(run: Run, press: Press, moments: Moments, settings: Settings) -> tuple[Run, Moments]:
    """Return the run that these settings would give, as the platens of a measured one behave, and its moments.

    Panel channels hold no readings of any meaning; `settings` that are left out stay as they were.
    """
    before = settings_of(run, press, moments)
    change = {name: settings[name] - value for name, value in before.items() if name in settings}
    wait, longer = change.get("waiting_s", 0.0), change.get("press_time_s", 0.0)
    period = float(np.median(np.diff(run.time_s)))
    time_s = np.arange(float(run.time_s[0]), float(run.time_s[-1]) + wait + longer + period / 2, period)
    rows = _measured_times(time_s, run, moments, wait, longer)
    described = press_for_run(press, run)
    wires = set(run.columns) & {CLOSED, described.press.limit_switch}
    columns = {
        name: np.round(_at(run.time_s, values, rows)) if name in wires else _at(run.time_s, values, rows)
        for name, values in run.columns.items()
    }
    for platen in set(described.platens) & set(columns):
        columns[platen] = columns[platen] + change.get("platen_temperature_C", 0.0)
    if "pressure_N_cm2" in change:
        ratio = settings["pressure_N_cm2"] / before["pressure_N_cm2"]
        for load in {c.load.column for c in described.contact if c.load is not None} & set(columns):
            columns[load] = columns[load] * ratio
    header = {**run.header, **{HEADER[name]: settings[name] for name in change if name in HEADER}}
    shifted = replace(
        moments,
        closed_s=moments.closed_s + wait,
        opened_s=moments.opened_s + wait + longer,
        removed_s=moments.removed_s + wait + longer,
    )
    return replace(run, header=header, time_s=time_s, columns=columns, texts={}), shifted


def _measured_times(time_s: Array, run: Run, moments: Moments, wait: float, longer: float) -> Array:
    """Return the times of the measured run at which the press was where the designed one is (rows). [s]

    Times run with the closing and the opening; a longer wait or pressing holds what was there before it.
    """
    if not np.isfinite(moments.closed_s):
        return time_s
    first, opened = float(run.time_s[0]), _opened(run, moments)
    laid = max(moments.inserted_s, first)
    closed_new, opened_new = moments.closed_s + wait, opened + wait + longer
    waiting = np.clip(time_s - wait, laid, None)
    pressing = np.minimum(time_s - wait, opened - SETTLED_S / 2)
    after = time_s - wait - longer
    ramp = moments.ramp_s
    times = np.where(time_s < closed_new - ramp, waiting, np.where(time_s < opened_new - ramp, pressing, after))
    return np.asarray(np.where(time_s < laid, time_s, times))


def _at(time_s: Array, values: Array, rows: Array) -> Array:
    """Read a column off at other times, over its gaps (rows)."""
    known = np.isfinite(values)
    return np.interp(rows, time_s[known], values[known]) if known.any() else np.full(len(rows), np.nan)
