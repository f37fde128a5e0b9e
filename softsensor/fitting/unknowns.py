"""What a fit adjusts: coefficients, and a real measuring chain's nuisances with priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.press.press_file import BoundaryKind, InitialKind, Press
from daq.records import Array, Moments
from daq.words import Message, say
from softsensor.effects.parameters import uniform_sd
from softsensor.fitting.problem import EVERYWHERE, PlaceUnknown
from softsensor.heat.case import Case
from softsensor.heat.model import NUISANCES
from softsensor.signals.instrument import (
    CHANNEL_GAIN,
    CHANNEL_K,
    PLATEN_K,
    RAMP_LIMITS_S,
    RAMP_S,
    RAMP_SD_S,
    SCAN_APART_ROWS,
    SCAN_LATE_ROWS,
    SCAN_LATE_S,
    START_K,
    moment_sd,
)
from softsensor.signals.places import Signals
from softsensor.signals.unknown import Unknown

# Numbers without another source were set by hand, 2026-11.

GAP_ROWS = 4.0
"""Rows further apart than this many usual ones are a gap."""
GAP_NEAR_S = 1.5
"""A moment found this close to a gap's end may have been anywhere in the gap. [s]"""
MOMENTS = ("inserted_s", "closed_s", "opened_s")


@dataclass(frozen=True)
class Gap:
    """Rows missing where the press moved."""

    moment: str
    start: float
    end: float

    @property
    def message(self) -> Message:
        """What is missing, and what that means for the run."""
        return say("fit-gap-at-moment", begin=self.start, end=self.end, moment=self.moment)


def gaps_at_moments(time_s: Array, moments: Moments, period: float) -> dict[str, Gap]:
    """Return the gaps in which insertion, closing or opening may have fallen, by the moment."""
    steps = np.diff(time_s)
    found = {}
    for name in MOMENTS:
        at = getattr(moments, name)
        if not time_s[0] < at < time_s[-1]:
            continue
        wide = steps > max(GAP_ROWS * period, 1.0)
        near = wide & (time_s[:-1] <= at) & (at <= time_s[1:] + GAP_NEAR_S + period)
        if near.any():
            i = int(np.flatnonzero(near)[-1])
            found[name] = Gap(name, float(time_s[i]), float(time_s[i + 1]))
    return found


def known_before(press: Press) -> dict[str, tuple[float, float]]:
    """Return the press file's priors: median, and standard deviation of the logarithm."""
    return {name: (p.median, float(np.log(p.factor))) for name, p in press.priors.items()}


def coefficient_unknown(press: Press, name: str, start: float, prior: tuple[float, float] | None) -> Unknown:
    """Return a coefficient as an unknown; the prior: median, and standard deviation of the logarithm."""
    table = press.coefficient(name)
    centre, sd = (0.0, float("inf")) if prior is None else (float(np.log(prior[0])), prior[1])
    lower, upper, begin = (
        float(np.log(v)) for v in (table.lower, table.upper, np.clip(start, table.lower, table.upper))
    )
    return Unknown(name, centre, sd, lower, upper, log=True, start=begin)


def chain_priors(case: Case, signals: Signals) -> list[Unknown]:
    """Return the nuisances of a run with the priors a real measuring chain deserves."""
    unknowns: list[Unknown] = []
    period = signals.period_s
    press = case.press
    if press.has_states:
        unknowns += _moment_priors(case, period)
    if press.panel_layers or press.initial.kind is not InitialKind.STEADY:
        unknowns.append(nuisance("initial_K", START_K, 10 * START_K))
    for end, boundary in press.boundary.ends:
        if boundary.kind is BoundaryKind.MEASURED:
            unknowns.append(nuisance(f"boundary_{end}_K", PLATEN_K, 10 * PLATEN_K))
    for place in signals.places:
        n = len(place.columns)
        unknowns.append(nuisance(PlaceUnknown.OFFSET.at(place.label), CHANNEL_K / np.sqrt(n), 10 * CHANNEL_K))
        unknowns.append(nuisance(PlaceUnknown.GAIN.at(place.label), CHANNEL_GAIN / np.sqrt(n), 10 * CHANNEL_GAIN))
    if press.has_states:
        unknowns.append(nuisance(PlaceUnknown.SKEW.at(EVERYWHERE), SCAN_LATE_S + SCAN_LATE_ROWS * period, 1.0))
        for place in signals.places[1:]:
            unknowns.append(
                nuisance(PlaceUnknown.SKEW.at(place.label), SCAN_LATE_S + SCAN_APART_ROWS * period, 1.0)
            )
    return unknowns


def _moment_priors(case: Case, period: float) -> list[Unknown]:
    """Return when the press moved: about the moments found, or anywhere in a gap they fall into."""
    moments = case.moments
    unknowns: list[Unknown] = []
    first, last = float(case.run.time_s[0]), float(case.run.time_s[-1])
    sd = moment_sd(period)
    late = -0.5 * period if moments.source.is_wire else 0.0
    gaps = gaps_at_moments(case.run.time_s, moments, period)

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
        ramp, (shortest, longest) = moments.ramp_s, RAMP_LIMITS_S
        unknowns.append(nuisance("ramp_s", RAMP_SD_S, longest - RAMP_S, RAMP_S - ramp, shortest - ramp))
    if first < moments.opened_s < last:
        unknowns.append(moment("opened_s", late))
    return unknowns


def _moment_in_gap(gap: Gap, at: float, sd: float) -> Unknown:
    """Return a moment that may lie anywhere in a gap: a flat prior's mean and standard deviation."""
    width = gap.end - gap.start
    spread = float(np.hypot(uniform_sd(width), sd))
    return nuisance(gap.moment, spread, 0.5 * width + 2 * sd, 0.5 * (gap.start + gap.end) - at)


def nuisance(name: str, sd: float, reach: float, mean: float = 0.0, lower: float | None = None) -> Unknown:
    """Return a nuisance with a normal prior that stays within `reach` of its mean."""
    return Unknown(name, mean, sd, mean - reach if lower is None else lower, mean + reach)


def is_coefficient(name: str) -> bool:
    """Whether an unknown is a coefficient, no nuisance."""
    return ":" not in name and name not in NUISANCES
