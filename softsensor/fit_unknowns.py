"""What a fit adjusts: coefficients, effect parameters, and a real measuring chain's nuisances with priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.press_wires import WIRES
from daq.pressfile import Press
from daq.records import Array, InputError, Moments
from softsensor.case import Case
from softsensor.effects import find_effect
from softsensor.fit_problem import EVERYWHERE, Unknown
from softsensor.model import NUISANCES, ThermalModel
from softsensor.parameters import Parameter
from softsensor.residuals import Signals

RAMP_S = (0.55, 0.25, 1.2)
"""Closing ramp: a press takes 0.2 to 1 s to close. Mean, standard deviation and limit. [s]"""
START_K = 0.3
"""Of the panel's initial temperature. [K]"""
PLATEN_K, PLATEN_GAIN = 0.1, 0.0005
"""Of a platen channel: offset and gain. [K, -]"""
CHANNEL_K, CHANNEL_GAIN = 0.3, 0.0015
"""Of a panel channel: offset and gain. [K, -]"""
LATE_S, LATE_ROWS, APART_ROWS = 0.02, 0.07, 0.12
"""How late panel channels are read: at least, and per row all of them, and one face after the other. [s, rows]

A scan takes up to half the time to the next, so its middle comes 0 to a quarter of a row late: 0.07 is that
range's standard deviation. A delay common to all channels shows only against the platens.
"""

GAP_ROWS = 4.0
"""Rows further apart than this many usual ones are a gap."""
GAP_NEAR_S = 1.5
"""A moment found this close to a gap's end may have been anywhere in the gap. [s]"""
MOMENT_WORDS = {"inserted_s": "the insertion", "closed_s": "the closing", "opened_s": "the opening"}


@dataclass(frozen=True)
class Gap:
    """Rows missing where the press moved."""

    moment: str
    start: float
    end: float

    @property
    def sentence(self) -> str:
        """What is missing, and what that means for the run."""
        return (
            f"no rows from {self.start:.1f} s to {self.end:.1f} s, where {MOMENT_WORDS[self.moment]} falls: "
            "its moment is searched in the gap, and the coefficients are known the less for it"
        )


def gaps_at_moments(time_s: Array, moments: Moments, period: float) -> list[Gap]:
    """Return the gaps in which insertion, closing or opening may have fallen."""
    steps = np.diff(time_s)
    found = []
    for name in MOMENT_WORDS:
        at = getattr(moments, name)
        if not time_s[0] < at < time_s[-1]:
            continue
        wide = steps > max(GAP_ROWS * period, 1.0)
        near = wide & (time_s[:-1] - 0.5 * period <= at) & (at <= time_s[1:] + GAP_NEAR_S + period)
        if near.any():
            i = int(np.flatnonzero(near)[-1])
            found.append(Gap(name, float(time_s[i]), float(time_s[i + 1])))
    return found


def neutral_values(model: ThermalModel, press: Press) -> dict[str, float]:
    """Return every parameter's value where nothing is known: guesses, and effects at their typical size."""
    effects = {e.key(p.name): p.typical for e in model.effects for p in e.parameters}
    return {n: press.coefficient(n).guess for n in press.coefficient_names} | effects


def free_names(press: Press) -> tuple[str, ...]:
    """Coefficients a fit adjusts: all the press file does not fix."""
    return tuple(n for n in press.coefficient_names if not press.coefficient(n).fixed)


def known_before(press: Press) -> dict[str, tuple[float, float]]:
    """Return the press file's priors: median, and standard deviation of the logarithm."""
    return {name: (p.median, float(np.log(p.factor))) for name, p in press.priors.items()}


def parameter_unknown(press: Press, name: str, start: float, prior: tuple[float, float] | None) -> Unknown:
    """Return a coefficient or effect parameter as an unknown; see `fit.fit_run` for the prior."""
    if "." not in name:
        table = press.coefficient(name)
        mean, sd = (0.0, float("inf")) if prior is None else (float(np.log(prior[0])), prior[1])
        begin = float(np.clip(start, table.lower, table.upper))
        return Unknown(name, begin, table.lower, table.upper, "log", mean=mean, sd=sd)
    parameter = effect_parameter(name)
    size = abs(parameter.typical - parameter.neutral) or abs(parameter.typical) or 1.0
    mean, sd = (0.0, float("inf")) if prior is None else (prior[0] / size, prior[1] / size)
    begin = float(np.clip(start, parameter.lower, parameter.upper))
    return Unknown(name, begin, parameter.lower, parameter.upper, "linear", size, mean, sd)


def effect_parameter(name: str) -> Parameter:
    """Return the parameter of a full name such as ``edge_loss.W_m3K``. Raises InputError."""
    effect, _, key = name.partition(".")
    for parameter in find_effect(effect).parameters:
        if parameter.name == key:
            return parameter
    raise InputError(f"parameter {name!r}: effect {effect} has no {key!r}")


def chain_priors(case: Case, signals: Signals) -> list[Unknown]:
    """Return the nuisances of a run with the priors a real measuring chain deserves."""
    unknowns: list[Unknown] = []
    period = signals.period_s
    press = case.press
    if press.has_states:
        unknowns += _moment_priors(case, period)
    if press.panel_layers or press.initial.kind != "steady":
        unknowns.append(nuisance("initial_K", START_K, 10 * START_K))
    for end, boundary in (("bottom", press.boundary.bottom), ("top", press.boundary.top)):
        if boundary.kind == "measured":
            level = float(np.nanmedian(case.run.columns[boundary.column or ""]))
            sd = float(np.hypot(PLATEN_K, PLATEN_GAIN * (level - case.ambient)))
            unknowns.append(nuisance(f"boundary_{end}_K", sd, 10 * sd))
    for place in signals.places:
        n = len(place.columns)
        unknowns.append(nuisance(f"offset:{place.label}", CHANNEL_K / np.sqrt(n), 10 * CHANNEL_K))
        unknowns.append(nuisance(f"gain:{place.label}", CHANNEL_GAIN / np.sqrt(n), 10 * CHANNEL_GAIN))
    if press.has_states:
        unknowns.append(nuisance(f"skew:{EVERYWHERE}", LATE_S + LATE_ROWS * period, 1.0))
        for place in signals.places[1:]:
            unknowns.append(nuisance(f"skew:{place.label}", LATE_S + APART_ROWS * period, 1.0))
    return unknowns


def _moment_priors(case: Case, period: float) -> list[Unknown]:
    """Return when the press moved: about the moments found, or anywhere in a gap they fall into."""
    moments = case.moments
    unknowns: list[Unknown] = []
    first, last = float(case.run.time_s[0]), float(case.run.time_s[-1])
    sd = min(0.1 + 0.4 * period, 1.0)
    late = -0.5 * period if moments.source in WIRES else 0.0
    gaps = {g.moment: g for g in gaps_at_moments(case.run.time_s, moments, period)}

    def moment(name: str, mean: float = 0.0) -> Unknown:
        at = getattr(moments, name)
        if name in gaps:
            return _moment_in_gap(gaps[name], at, sd)
        lower = max(-4 * sd, first - at) if name == "inserted_s" else None
        return nuisance(name, sd, 4 * sd, mean, lower)

    if first < moments.inserted_s < last:
        unknowns.append(moment("inserted_s"))
    if first < moments.closed_s < last:
        unknowns.append(moment("closed_s", late))
        ramp = moments.ramp_s
        unknowns.append(nuisance("ramp_s", RAMP_S[1], RAMP_S[2] - RAMP_S[0], RAMP_S[0] - ramp, 0.1 - ramp))
    if first < moments.opened_s < last:
        unknowns.append(moment("opened_s", late))
    return unknowns


def _moment_in_gap(gap: Gap, at: float, sd: float) -> Unknown:
    """Return a moment that may lie anywhere in a gap: a flat prior's mean and standard deviation."""
    width = gap.end - gap.start
    spread = float(np.hypot(width / np.sqrt(12.0), sd))
    return nuisance(gap.moment, spread, 0.5 * width + 2 * sd, 0.5 * (gap.start + gap.end) - at)


def nuisance(name: str, sd: float, reach: float, mean: float = 0.0, lower: float | None = None) -> Unknown:
    """Return a nuisance with a normal prior; its internal variable counts in standard deviations."""
    return Unknown(
        name, mean, mean - reach if lower is None else lower, mean + reach, "linear", sd, mean / sd, 1.0
    )


def is_parameter(name: str) -> bool:
    """Whether an unknown is a coefficient or an effect parameter, no nuisance."""
    return ":" not in name and name not in NUISANCES
