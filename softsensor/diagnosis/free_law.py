"""What is missing as a free function: where no cause of the catalogue explains the runs, they tell its law.

A law is a smooth function of one variable, a Gaussian process on a few knots with a squared-exponential kernel:
its weights are one more effect of the model, with independent normal priors, so coefficients, moments and offsets
are fitted beside it and derivatives are exact. How strong it is, the prior's standard deviation, is learned from
the campaign: the marginal likelihood (Laplace's, from the fit's curvature) over a grid.

=================  ===========================  =================================================================
kind               variable                     curve
=================  ===========================  =================================================================
``contact``        ``time_since_closing_s``     factor on the closed panel's contacts, 1 at the latest time seen;
                                                ``contact_lower`` and ``contact_upper`` on one of them alone, 1
                                                where it is the press's closed coefficient as the other is
``heat``           ``temperature_C``            heat that goes for good as the panel warms up, negative where it
                                                comes [kJ/m³K]
``heat_exchange``  ``depth_share``              heat lost to the room by height in the panel, 0 at its lower face;
                                                negative where it comes [W/m³K]
=================  ===========================  =================================================================

Runs left out decide: each, with the law from the others and its own contacts fitted, must be met better than
without a law, with an interval above nothing; for each the kind is chosen by the other runs. Kinds that these do
not tell from the best form a set. Laws that the effects' terms cannot carry (conductivity as a free function of
temperature, contact by pressure or temperature) are not tried: what follows them stays unknown, or is told by the
nearest kind.

References
----------
Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), sec. 8.3.1 (subset of regressors) and 3.4
(Laplace's approximation of the marginal likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.records import Array, Nonphysical
from softsensor.diagnosis.decision import FEW_RUNS
from softsensor.diagnosis.extension import SharedFit, fit_campaign_model, from_the_others, held_out
from softsensor.diagnosis.extension_unknowns import Unknowns, lay_out
from softsensor.diagnosis.gains import HARDLY, Gain, paired_gain
from softsensor.diagnosis.numbers import MODEL_ERROR
from softsensor.diagnosis.search import SettledModel, run_errors
from softsensor.effects import Effect, Scene, Terms, catalogue
from softsensor.effects.effect import LawOf
from softsensor.effects.free_law import (
    COLDEST_C,
    EARLY_S,
    HOTTEST_C,
    KNOTS,
    LAST_S,
    LEVEL,
    SIDES,
    SOURCE,
    STRENGTH,
    VALUE,
    Function,
    Smooth,
    contact_knots,
    contact_terms,
    exchange_knots,
    exchange_terms,
    heat_knots,
    heat_terms,
    levelled,
)
from softsensor.effects.parameters import Parameter
from softsensor.heat.model_file import FittedValue
from softsensor.signals.student import student

# Numbers without another source were set by hand, 2026-11.

COLDEST_K = 15.0
"""So far above the panel's start a law of temperature begins: below, it is not told from the start. [K]"""
STRENGTHS = np.geomspace(0.02, 10.0, 19)
"""Tried standard deviations of the weights, in units of the kind."""
HEAT_SIZE = 1e3
"""Of a law of heat, about the heat capacity of wood per volume. [kJ/m³K]"""
EXCHANGE_SIZE = 1e3
"""Of a law of exchange, about a loss at the rim of its typical size. [W/m³K]"""
INSIDE = 0.9
"""Share of the points at which a known cause's curve must lie in the band to be recognised: issue 24's measure."""
POINTS = 33
"""Of a curve that is handed out."""


@dataclass(frozen=True)
class LawKind:
    """A kind of law, laid over what the runs visited."""

    name: LawOf
    variable: str
    unit: str
    effect: Effect
    x: Array
    """Where the curve is told (points)."""
    weights: Array
    """Of the fitted numbers at these points (points, knots)."""
    told: Callable[[Array], Array]
    """From the smooth function to what is told."""
    kept: Callable[[Array], dict[str, float]]
    """From the fitted numbers to those a model file keeps (`effects.free_law`), its strength aside."""


@dataclass(frozen=True)
class Law:
    """What is missing as a free function."""

    kind: LawOf
    variable: str
    unit: str
    curve: Array
    """x, value, low and high with 95 % (points, 4)."""
    gain: Gain
    """On runs left out."""
    set: tuple[str, ...]
    """Kinds that runs left out do not tell apart, the best first."""
    resembles: str | None
    """The cause of the catalogue whose curve lies in the band."""
    stage: SettledModel
    """The fit with it."""
    kept: Mapping[str, FittedValue]
    """What a model file keeps of it, by the parameters of `effects.free_law`."""

    def as_json(self) -> dict[str, Any]:
        """Return the contract's table."""
        return {
            "kind": self.kind,
            "variable": self.variable,
            "curve": [[float(f"{v:.5g}") for v in row] for row in self.curve],
            "unit": self.unit,
            "heldout_gain_K": self.gain.value_K,
            "heldout_gain_ci95": None if self.gain.ci95 is None else list(self.gain.ci95),
            "set": list(self.set),
            "resembles": self.resembles,
        }


@dataclass(frozen=True)
class _Tried:
    """A kind fitted to all runs."""

    kind: LawKind
    fit: SharedFit
    errors: Array
    """Of each run by the others' law (runs). [K]"""
    readings: int


def free_law(stage: SettledModel) -> Law | None:
    """Return the law that a settled model lacks, None where runs left out do not gain surely by any.

    Needs at least as many runs as a p-value does (`decision.FEW_RUNS`).
    """
    if len(stage.data) < FEW_RUNS:
        return None
    before = run_errors(stage.data, held_out(stage.fit, stage.data))
    tried = [law for kind in _kinds(stage) if (law := _tried(stage, kind)) is not None]
    if not tried:
        return None
    fell = np.stack([np.log(before / t.errors) for t in tried])
    best = int(np.argmax(fell.mean(axis=1)))
    unseen = [_chosen_without(fell, r) for r in range(len(before))]
    after = np.array([tried[k].errors[r] for r, k in enumerate(unseen)])
    gain = paired_gain(before, after)
    if not gain.sure or gain.value_K < HARDLY * float(np.sqrt(np.mean(before**2))):
        return None
    law = tried[best]
    alike = [t for t in tried if t is not law and not paired_gain(t.errors, law.errors).sure]
    alike = [t for t in alike if paired_gain(before, t.errors).sure]
    curve = _curve(law)
    names = tuple(t.kind.name for t in (law, *alike))
    return Law(
        kind=law.kind.name,
        variable=law.kind.variable,
        unit=law.kind.unit,
        curve=curve,
        gain=gain,
        set=names,
        resembles=_resembles(law.kind.name, curve),
        stage=replace(stage, fit=law.fit),
        kept=_kept(law),
    )


def _kept(law: _Tried) -> dict[str, FittedValue]:
    """Return a law's numbers for a model file; its strength is as unsure as the curve is, root mean square."""
    value, low, high = _band(law)
    doubt = float(np.sqrt(np.mean(((high - low) / 2.0) ** 2) / np.mean(value**2))) / _two_sided(law)
    numbers = law.kind.kept(law.fit.theta[_places(law)])
    return {STRENGTH: FittedValue(1.0, doubt)} | {name: FittedValue(v, 0.0) for name, v in numbers.items()}


def _chosen_without(fell: Array, run: int) -> int:
    """Return the kind that the other runs choose."""
    others = np.delete(fell, run, axis=1)
    return int(np.argmax(others.mean(axis=1)))


def _kinds(stage: SettledModel) -> Iterator[LawKind]:
    """Yield the kinds of law that these runs could follow."""
    press = stage.fit.layout.model.press
    if not press.panel_layers:
        return
    digests = [d.digest for d in stage.data]
    lasts = [
        (d.moments.opened_s if np.isfinite(d.moments.opened_s) else d.time[-1]) - d.moments.closed_s
        for d in digests
        if np.isfinite(d.moments.closed_s)
    ]
    if press.has_states and lasts:
        yield from (contact_by_time(float(np.max(lasts)), side) for side in SIDES)
    hottest = float(np.max([np.nanmax(d.y) for d in digests]))
    coldest = float(np.min([np.nanmin(d.y[:3]) for d in digests])) + COLDEST_K
    if hottest > coldest + COLDEST_K:
        yield heat_by_temperature(coldest, hottest)
    yield exchange_by_depth()


def contact_by_time(last_s: float, side: str = "") -> LawKind:
    """Return the contact, or that of one `side`, as a free function of the time since closing. [s]"""
    smooth = contact_knots(last_s)

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        law = _function(smooth, values)
        return contact_terms(scene, law if side else levelled(law, last_s), last_s, side)

    end = smooth.weights(smooth.knots[-1:])
    along = np.linspace(0.0, smooth.knots[-1], POINTS)
    weights = smooth.weights(along) - (0.0 if side else end)
    kind = LawOf(f"{LawOf.CONTACT}_{side}") if side else LawOf.CONTACT

    def kept(numbers: Array) -> dict[str, float]:
        level = {LEVEL: float(end[0] @ numbers)} if side else {}
        return {LAST_S: last_s, **level, **_at_knots(smooth, numbers)}

    effect = _effect(kind, smooth, terms)
    x = EARLY_S * np.expm1(along)
    return LawKind(kind, "time_since_closing_s", "-", effect, x, weights, np.exp, kept)


def heat_by_temperature(coldest_C: float, hottest_C: float) -> LawKind:
    """Return heat that goes for good as the panel warms up, as a free function of temperature. [°C]"""
    smooth = heat_knots(coldest_C, hottest_C)

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        return heat_terms(scene, _function(smooth, values, HEAT_SIZE), smooth)

    def kept(numbers: Array) -> dict[str, float]:
        return {COLDEST_C: coldest_C, HOTTEST_C: hottest_C, **_at_knots(smooth, HEAT_SIZE * numbers)}

    x = np.linspace(coldest_C, hottest_C, POINTS)
    effect = _effect(LawOf.HEAT, smooth, terms, nonlinear=True)
    weights = HEAT_SIZE * smooth.weights(x)
    return LawKind(LawOf.HEAT, "temperature_C", "kJ/m3K", effect, x, weights, np.asarray, kept)


def exchange_by_depth() -> LawKind:
    """Return heat lost to the room as a free function of the height in the panel."""
    smooth = exchange_knots()

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        return exchange_terms(scene, _function(smooth, values, EXCHANGE_SIZE))

    def kept(numbers: Array) -> dict[str, float]:
        return _at_knots(smooth, EXCHANGE_SIZE * numbers)

    z = np.linspace(-1.0, 1.0, POINTS)
    effect = _effect(LawOf.EXCHANGE, smooth, terms)
    weights = EXCHANGE_SIZE * smooth.weights(z)
    return LawKind(LawOf.EXCHANGE, "depth_share", "W/m3K", effect, 0.5 * (z + 1.0), weights, np.asarray, kept)


def _function(smooth: Smooth, values: Mapping[str, Any], size: float = 1.0) -> Function:
    numbers = size * np.array([values[name] for name in values])
    return lambda x: smooth.weights(x) @ numbers


def _at_knots(smooth: Smooth, numbers: Array) -> dict[str, float]:
    return {f"{VALUE}_{knot}": float(value) for knot, value in enumerate(smooth.factor @ numbers)}


def _effect(
    kind: LawOf, smooth: Smooth, terms: Callable[[Scene, Mapping[str, Any]], Terms], *, nonlinear: bool = False
) -> Effect:
    parameters = tuple(
        Parameter(f"w{i}", "-", 0.0, 1.0, -40.0, 40.0, "weight of a free law, no physical number")
        for i in range(smooth.factor.shape[1])
    )
    return Effect(f"law_{kind}", parameters, terms, SOURCE, nonlinear=nonlinear)


def _tried(stage: SettledModel, kind: LawKind) -> _Tried | None:
    """Fit a kind beside everything else; None where the runs drive it to what no matter has."""
    try:
        return _fitted(stage, kind)
    except Nonphysical:
        return None


def _fitted(stage: SettledModel, kind: LawKind) -> _Tried:
    """Fit a kind beside everything else, its strength learned twice on the way."""
    model = stage.fit.layout.model.extended(kind.effect)
    names = [kind.effect.key(p.name) for p in kind.effect.parameters]
    start = dict(stage.fit.values) | dict.fromkeys(names, 0.0)
    layout = lay_out(model, [d.digest for d in stage.data], stage.population, start)
    etas, strength = [r.eta for r in stage.fit.runs], 1.0
    for rounds in (4, 4, 6):
        layout = _strong(layout, names, strength)
        fit = fit_campaign_model(layout, stage.data, etas, rounds=rounds, tolerance=0.5)
        strength, etas = learned_strength(fit, names), [r.eta for r in fit.runs]
        layout = layout.begun(fit.theta)
    others = held_out(fit, stage.data, thetas=from_the_others(fit, stage.data))
    readings = sum(int(d.digest.valid.sum()) for d in stage.data)
    return _Tried(kind, fit, run_errors(stage.data, others), readings)


def _strong(layout: Unknowns, names: Sequence[str], strength: float) -> Unknowns:
    """Return the layout with a prior of this width on the law's numbers."""
    shared = tuple(
        replace(s, sd=strength, step=2.0 * max(strength, 0.5)) if s.name in names else s for s in layout.shared
    )
    return replace(layout, shared=shared)


def learned_strength(fit: SharedFit, names: Sequence[str]) -> float:
    """Return the prior's standard deviation of the law's numbers under which the runs are likeliest.

    Laplace's marginal likelihood from the curvature H and slope g of the data's half cost, all other numbers of
    the campaign integrated with their own priors: with P the priors' precision,
    -1/2 min(...) - 1/2 log|H + P| + 1/2 log|P|, over a grid.
    """
    own = np.isin(fit.layout.names, names)
    hessian, slope = sum(fit.hessians), sum(fit.gradients)
    centre, fixed = fit.layout.priors
    found = []
    for strength in STRENGTHS:
        precision = np.where(own, strength**-2.0, fixed**-2.0)
        away = fit.theta - centre
        curved = hessian + np.diag(precision)
        pull = slope + precision * away
        least = 0.5 * float(away @ (precision * away)) - 0.5 * float(pull @ np.linalg.solve(curved, pull))
        found.append(-least - 0.5 * float(np.linalg.slogdet(curved)[1]) + 0.5 * float(np.log(precision).sum()))
    return float(STRENGTHS[int(np.argmax(found))])


def _curve(law: _Tried) -> Array:
    """Return the curve with its 95 % band as it is told (points, 4)."""
    return np.stack([law.kind.x, *map(law.kind.told, _band(law))], axis=1)


def _band(law: _Tried) -> tuple[Array, Array, Array]:
    """Return the function with its 95 % band: the wider of curvature and scatter from run to run, by point.

    What a smooth law leaves over of a sharp one counts as noise in the curvature. To it comes what every law of
    the diagnosis is off: `MODEL_ERROR`, here as a share of the curve's range.
    """
    fit, kind, at = law.fit, law.kind, _places(law)
    runs, covariance = len(fit.runs), fit.covariance
    left = sum(r.cost for r in fit.runs) / max(law.readings, 1)
    centred = [g - np.mean(fit.gradients, axis=0) for g in fit.gradients]
    meat = sum((np.outer(g, g) for g in centred), np.zeros_like(covariance)) * runs / max(runs - 1, 1)
    robust = covariance @ meat @ covariance
    middle = kind.weights @ fit.theta[at]
    spreads = [
        np.einsum("ij,jk,ik->i", kind.weights, c[np.ix_(at, at)], kind.weights)
        for c in (max(left, 1.0) * covariance, robust)
    ]
    simple = (MODEL_ERROR * float(np.ptp(middle))) ** 2
    half = _two_sided(law) * np.sqrt(np.maximum(*spreads) + simple)
    return middle, middle - half, middle + half


def _two_sided(law: _Tried) -> float:
    return student(max(len(law.fit.runs) - 1, 1))


def _places(law: _Tried) -> list[int]:
    effect = law.kind.effect
    return [law.fit.layout.names.index(effect.key(p.name)) for p in effect.parameters]


def _resembles(kind: LawOf, curve: Array) -> str | None:
    """Return the cause of the catalogue whose own curve lies within the band, nearest to the law; None without."""
    x, value, low, high = curve.T
    sd = np.maximum(0.5 * (high - low), 1e-9 * (1.0 + np.abs(value)))
    apart = float(x[-1] - x[0]) / (KNOTS.get(kind, KNOTS[LawOf.CONTACT]) - 1)  # no sharper can the knots tell it
    sized = kind in (LawOf.HEAT, LawOf.EXCHANGE)

    def holds(shape: Any) -> bool:
        return bool(np.mean((shape >= low) & (shape <= high)) >= INSIDE)

    if not sized and holds(1.0):
        return None  # nearly everywhere no law at all
    nearest, least = None, math.inf
    for effect in catalogue().values():
        for shape in effect.as_law(kind, x, apart) if effect.as_law is not None else ():
            if sized:
                shape = shape * np.sum(shape * value / sd**2) / np.sum(shape * shape / sd**2)
            off = float(np.mean(((shape - value) / sd) ** 2))
            if off < least and holds(shape):
                nearest, least = effect.name, off
    return nearest
