"""What a campaign's fit varies: numbers all runs share, numbers of each run, and their priors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq.press.press_file import BoundaryKind, Press
from daq.printed import on_screen
from daq.records import Array
from softsensor.effects import conductivity_offset
from softsensor.effects.parameters import Parameter, uniform_sd
from softsensor.fitting.constants import CAPACITY, fit_doubts
from softsensor.heat.model import PANEL_SHARES, ThermalModel
from softsensor.heat.timing import OPENING_RAMP
from softsensor.signals.digest import Digest
from softsensor.signals.doubt import PANEL_TO_PANEL
from softsensor.signals.instrument import (
    FREE_SPREAD_LOG,
    GUESS_LOG,
    OPENING_RAMP_SD_S,
    PLATEN_K,
    RAMP_SD_S,
    START_K,
    SWITCH_S,
    moment_sd,
)
from softsensor.signals.unknown import Unknown

AMPLITUDE_SD = 4.0
"""Prior of an effect's amplitude about zero, in typical sizes: hardly any. By hand, 2026-11."""


@dataclass(frozen=True)
class Unknowns:
    """What is fitted: the model, the campaign's numbers, the runs' numbers."""

    model: ThermalModel
    shared: tuple[Unknown, ...]
    unknowns: tuple[tuple[Unknown, ...], ...]
    """By run."""
    spreads: Mapping[str, float]
    """Relative scatter between runs of effect parameters, by full name."""

    __repr__ = on_screen

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Full names of the effects' parameters, which lead `shared`."""
        return tuple(e.key(p.name) for e in self.model.effects for p in e.parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the shared numbers."""
        return tuple(s.name for s in self.shared)

    @cached_property
    def coefficients(self) -> dict[str, str]:
        """The coefficient behind each shared number that is a logarithm."""
        return {logarithm_of(name): name for name in self.model.press.free_coefficients}

    @cached_property
    def priors(self) -> tuple[Array, Array]:
        """Centres and standard deviations of the shared numbers."""
        return np.array([s.centre for s in self.shared]), np.array([s.sd for s in self.shared])

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Limits of the shared numbers."""
        return np.array([s.lower for s in self.shared]), np.array([s.upper for s in self.shared])

    def named(self, theta: Array) -> dict[str, float]:
        """Return the shared numbers by name."""
        return dict(zip(self.names, theta.tolist(), strict=True))

    def begun(self, theta: Array) -> Unknowns:
        """Return the same with these shared numbers to begin from."""
        shared = (replace(s, start=v) for s, v in zip(self.shared, theta.tolist(), strict=True))
        return replace(self, shared=tuple(shared))


def logarithm_of(coefficient: str) -> str:
    """Return what the campaign calls the logarithm of a coefficient."""
    return f"log {coefficient}"


def is_shape(parameter: Parameter) -> bool:
    """Whether a parameter says how an effect goes, not how large it is."""
    return parameter.neutral == parameter.typical


def lay_out(
    model: ThermalModel, digests: Sequence[Digest], population: Mapping[str, float], start: Mapping[str, float]
) -> Unknowns:
    """Decide what is fitted.

    Parameters
    ----------
    population
        How coefficients scatter over the campaign: standard deviation of the logarithm, by name.
    start
        Effect parameters and campaign levels (logarithms) to begin from.
    """
    shared: list[Unknown] = []
    spreads: dict[str, float] = {}
    for effect in model.effects:
        for p in effect.parameters:
            key = effect.key(p.name)
            unit = (p.upper - p.lower) / 6.0 if is_shape(p) else abs(p.typical - p.neutral)
            sd = unit if is_shape(p) else AMPLITUDE_SD * unit
            begin = start.get(key, p.typical)
            shared.append(Unknown(key, p.neutral, sd, p.lower, p.upper, start=begin, step=unit))
            if p.spread > 0:
                spreads[key] = p.spread
    own = tuple(_run_coefficients(model.press, population))
    for u in own:
        guess = float(np.log(model.press.coefficient(u.name).guess))
        level = Unknown(u.shared, guess, GUESS_LOG, u.lower, u.upper, step=1.0)
        shared.append(replace(level, start=start.get(u.shared, guess)))
    unknowns = tuple((*own, *_nuisances(model.press, d, spreads)) for d in digests)
    return Unknowns(model, tuple(shared), unknowns, spreads)


def _run_coefficients(press: Press, population: Mapping[str, float]) -> Iterator[Unknown]:
    for name in press.free_coefficients:
        table, sd = press.coefficient(name), population.get(name, FREE_SPREAD_LOG)
        lower, upper = float(np.log(table.lower)), float(np.log(table.upper))
        yield Unknown(name, 0.0, sd, lower, upper, log=True, shared=logarithm_of(name))


def _nuisances(press: Press, digest: Digest, spreads: Mapping[str, float]) -> Iterator[Unknown]:
    if press.has_states:
        yield from _timing(digest)
    if press.panel_layers:
        yield Unknown("initial_K", 0.0, START_K)
    for end, boundary in press.boundary.ends:
        if boundary.kind is BoundaryKind.MEASURED:
            yield Unknown(f"boundary_{end}_K", 0.0, PLATEN_K)
    for key, sd in spreads.items():
        yield Unknown(f"share {key}", 0.0, sd, share_of=key)


def _timing(digest: Digest) -> Iterator[Unknown]:
    closed, opened = digest.moments.closed_s, digest.moments.opened_s
    switches = digest.switch or ((np.nan, 0.0), (np.nan, 0.0))
    for name, at, (switched, gap) in zip(("closed_s", "opened_s"), (closed, opened), switches, strict=True):
        if np.isfinite(at) and np.isfinite(switched):
            yield Unknown(name, switched - gap / 2 - at, float(np.hypot(uniform_sd(gap), SWITCH_S)))
        elif np.isfinite(at):
            yield Unknown(name, 0.0, moment_sd(digest.period_s))
    if np.isfinite(closed):
        yield Unknown("ramp_s", 0.0, RAMP_SD_S)
    if np.isfinite(opened):
        yield Unknown(OPENING_RAMP, 0.0, OPENING_RAMP_SD_S)


def panel_shares(digest: Digest) -> Iterator[Unknown]:
    """Yield by what a panel's constants may differ from those given, as panels of one product do."""
    doubts = fit_doubts(digest.run, digest.cases[False].press, PANEL_TO_PANEL)
    ratio = conductivity_offset.EFFECT.parameters[0]
    conductivity, capacity, thick = (
        doubts[key].relative if (key := f"panel.{name}") in doubts else 0.0
        for name in ("conductivity_W_mK", CAPACITY, "thickness_mm")
    )
    for name, own in zip(PANEL_SHARES, (conductivity, capacity), strict=True):
        sd = float(np.hypot(own, thick))  # thicker: a longer way, and more to heat
        if 0.0 < sd < np.inf:
            yield Unknown(name, 0.0, sd, ratio.lower - ratio.neutral, ratio.upper - ratio.neutral)


def run_values(layout: Unknowns, run: int, theta: Array, eta: Array) -> dict[str, float]:
    """Return every parameter the model needs for one run."""
    press = layout.model.press
    values = {n: press.coefficient(n).guess for n in press.coefficient_names}
    shared, limits = layout.named(theta), {s.name: s for s in layout.shared}
    values |= {n: shared[n] for n in layout.effect_names}
    for unknown, value in zip(layout.unknowns[run], eta, strict=True):
        if key := unknown.share_of:
            neutral = limits[key].centre
            values[key] = neutral + (shared[key] - neutral) * max(1.0 + value, 0.0)
        else:
            values[unknown.name] = unknown.value(float(value))
    for n in layout.effect_names:
        values[n] = float(np.clip(values[n], limits[n].lower, limits[n].upper))
    return values


def shared_cost(layout: Unknowns, theta: Array) -> float:
    """Return the sum of squares of the shared priors."""
    centre, sd = layout.priors
    return float(np.sum(((theta - centre) / sd) ** 2))


def start_eta(layout: Unknowns, run: int, theta: Array) -> Array:
    """Return a run's numbers at the middle of their priors."""
    shared = layout.named(theta)
    return np.array([u.centre + shared.get(u.shared, 0.0) for u in layout.unknowns[run]])


def eta_of(layout: Unknowns, run: int, values: Mapping[str, float]) -> Array:
    """Return a run's numbers of these values, by name; where there is none, at the middle of the prior."""
    own = layout.unknowns[run]
    there = [u.estimate(values[u.name]) if u.name in values else u.centre for u in own]
    return np.clip(there, [u.lower for u in own], [u.upper for u in own])
