"""What a campaign's fit varies: numbers all runs share, numbers of each run, and their priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor.effects.parameters import Parameter
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import Digest
from softsensor.signals.instrument import (
    FREE_SPREAD_LOG,
    GUESS_LOG,
    PLATEN_K,
    RAMP_SD_S,
    START_K,
    SWITCH_S,
    moment_sd,
)

AMPLITUDE_SD = 4.0
"""Prior of an effect's amplitude about zero, in typical sizes: hardly any. By hand, 2026-11."""


@dataclass(frozen=True)
class RunUnknown:
    """A number of one run: where its prior lies and how wide it is."""

    name: str
    centre: float
    sd: float
    log: bool = False
    shared: str = ""
    """Name of the campaign level it scatters about."""
    lower: float = -np.inf
    upper: float = np.inf
    share_of: str = ""
    """The effect parameter of which this run has so much more or less, empty for any other number."""


@dataclass(frozen=True)
class Shared:
    """A number of the campaign, with its prior and limits."""

    name: str
    centre: float
    sd: float
    lower: float = -np.inf
    upper: float = np.inf
    start: float = 0.0
    step: float = np.inf
    """Largest change in one step."""
    coefficient: str = ""
    """The coefficient whose logarithm it is, empty for any other number."""


@dataclass(frozen=True)
class RunSpread:
    """How coefficients scatter over the campaign: standard deviation of the logarithm, by name."""

    log_sd: Mapping[str, float]


@dataclass(frozen=True)
class Unknowns:
    """What is fitted: the model, the campaign's numbers, the runs' numbers."""

    model: ThermalModel
    shared: tuple[Shared, ...]
    unknowns: tuple[tuple[RunUnknown, ...], ...]
    """By run."""
    spreads: Mapping[str, float]
    """Relative scatter between runs of effect parameters, by full name."""

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Full names of the effects' parameters, which lead `shared`."""
        return tuple(e.key(p.name) for e in self.model.effects for p in e.parameters)


def logarithm_of(coefficient: str) -> str:
    """Return what the campaign calls the logarithm of a coefficient."""
    return f"log {coefficient}"


def is_shape(parameter: Parameter) -> bool:
    """Whether a parameter says how an effect goes, not how large it is."""
    return parameter.neutral == parameter.typical


def lay_out(
    model: ThermalModel, digests: Sequence[Digest], population: RunSpread, start: Mapping[str, float]
) -> Unknowns:
    """Decide what is fitted. `start` gives effect parameters and campaign levels (log) to begin from."""
    shared: list[Shared] = []
    spreads: dict[str, float] = {}
    for effect in model.effects:
        for p in effect.parameters:
            key = effect.key(p.name)
            unit = (p.upper - p.lower) / 6.0 if is_shape(p) else abs(p.typical - p.neutral)
            sd = unit if is_shape(p) else AMPLITUDE_SD * unit
            begin = start.get(key, p.typical)
            shared.append(Shared(key, p.neutral, sd, p.lower, p.upper, begin, unit))
            if p.spread > 0:
                spreads[key] = p.spread
    levels: list[Shared] = []
    for name in free_coefficients(model):
        guess = float(np.log(model.press.coefficient(name).guess))
        low, high = np.log(model.press.coefficient(name).lower), np.log(model.press.coefficient(name).upper)
        levels.append(
            Shared(
                logarithm_of(name),
                guess,
                GUESS_LOG,
                float(low),
                float(high),
                start.get(logarithm_of(name), guess),
                step=1.0,
                coefficient=name,
            )
        )
    unknowns = tuple(_unknowns(model, d, population, spreads) for d in digests)
    return Unknowns(model, (*shared, *levels), unknowns, spreads)


def free_coefficients(model: ThermalModel) -> tuple[str, ...]:
    """Return the coefficients that are not fixed."""
    press = model.press
    return tuple(n for n in press.coefficient_names if not press.coefficient(n).fixed)


def _unknowns(
    model: ThermalModel, digest: Digest, population: RunSpread, spreads: Mapping[str, float]
) -> tuple[RunUnknown, ...]:
    press = model.press
    found = [
        RunUnknown(
            name,
            0.0,
            population.log_sd.get(name, FREE_SPREAD_LOG),
            log=True,
            shared=logarithm_of(name),
            lower=float(np.log(press.coefficient(name).lower)),
            upper=float(np.log(press.coefficient(name).upper)),
        )
        for name in free_coefficients(model)
    ]
    moments = digest.moments
    if press.has_states:
        seen = digest.switch or ((np.nan, 0.0), (np.nan, 0.0))
        for name, at, (switched, gap) in zip(
            ("closed_s", "opened_s"), (moments.closed_s, moments.opened_s), seen, strict=True
        ):
            if not np.isfinite(at):
                continue
            if np.isfinite(switched):
                sd = float(np.hypot(gap / np.sqrt(12.0), SWITCH_S))
                found.append(RunUnknown(name, switched - gap / 2 - at, sd))
            else:
                found.append(RunUnknown(name, 0.0, moment_sd(digest.period_s)))
        if np.isfinite(moments.closed_s):
            found.append(RunUnknown("ramp_s", 0.0, RAMP_SD_S))
    if press.panel_layers:
        found.append(RunUnknown("initial_K", 0.0, START_K))
    for end, boundary in (("bottom", press.boundary.bottom), ("top", press.boundary.top)):
        if boundary.kind == "measured":
            found.append(RunUnknown(f"boundary_{end}_K", 0.0, PLATEN_K))
    found += [RunUnknown(f"share {key}", 0.0, sd, share_of=key) for key, sd in spreads.items()]
    return tuple(found)


def run_values(layout: Unknowns, run: int, theta: Array, eta: Array) -> dict[str, float]:
    """Return every parameter the model needs for one run."""
    press = layout.model.press
    values = {n: press.coefficient(n).guess for n in press.coefficient_names}
    shared = {s.name: float(v) for s, v in zip(layout.shared, theta, strict=True)}
    values |= {n: shared[n] for n in layout.effect_names}
    for unknown, value in zip(layout.unknowns[run], eta, strict=True):
        if key := unknown.share_of:
            neutral = next(s.centre for s in layout.shared if s.name == key)
            values[key] = neutral + (shared[key] - neutral) * max(1.0 + value, 0.0)
        else:
            values[unknown.name] = float(np.exp(value)) if unknown.log else float(value)
    limits = {s.name: s for s in layout.shared}
    for n in layout.effect_names:
        values[n] = float(np.clip(values[n], limits[n].lower, limits[n].upper))
    return values


def shared_cost(layout: Unknowns, theta: Array) -> float:
    """Return the sum of squares of the shared priors."""
    centre = np.array([s.centre for s in layout.shared])
    sd = np.array([s.sd for s in layout.shared])
    return float(np.sum(((theta - centre) / sd) ** 2))


def start_eta(layout: Unknowns, run: int, theta: Array) -> Array:
    """Return a run's numbers at the middle of their priors."""
    shared = {s.name: float(v) for s, v in zip(layout.shared, theta, strict=True)}
    return np.array([u.centre + shared.get(u.shared, 0.0) for u in layout.unknowns[run]])
