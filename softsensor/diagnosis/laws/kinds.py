"""Of what a law is and by which variable: each kind laid over what the runs visited."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.records import Array
from softsensor.diagnosis.held import closed_loads, varies
from softsensor.diagnosis.settling import SettledModel
from softsensor.effects import Effect, Scene, Terms, find_effect
from softsensor.effects.effect import LawOf
from softsensor.effects.free_law import (
    COLDEST_C,
    EARLY_S,
    HOTTEST_C,
    LAST_S,
    LEAST_LOAD,
    LEVEL,
    MOST_LOAD,
    REFERENCE,
    SIDES,
    SOURCE,
    VALUE,
    Function,
    Smooth,
    conductivity_terms,
    contact_knots,
    contact_terms,
    depth_knots,
    depth_source_terms,
    exchange_terms,
    face_terms,
    heat_knots,
    heat_terms,
    levelled,
    load_knots,
    load_terms,
    time_source_terms,
)
from softsensor.effects.parameters import Parameter
from softsensor.signals.digest import Digest

# Numbers without another source were set by hand, 2026-11.

COLDEST_K = 15.0
"""So far above the panel's start a law of temperature begins: below, it is one with the start. [K]"""
HEAT_SIZE = 1e3
"""Of a law of heat, about the heat capacity of wood per volume. [kJ/m³K]"""
EXCHANGE_SIZE = 1e3
"""Of a law of exchange, about a loss at the rim of its typical size. [W/m³K]"""
SOURCE_SIZE = HEAT_SIZE / 10.0
"""Of a law of a source: what heats such wood by 1 K in 10 s. [kW/m³]"""
POINTS = 33
"""Of a curve that is handed out."""
HEAVIEST = 40.0
"""No weight of a law, of which one standard deviation is 1, is larger."""


@dataclass(frozen=True)
class LawKind:
    """A kind of law, laid over what the runs visited."""

    name: LawOf
    variable: str
    unit: str
    effect: Effect
    x: Array
    """Where the curve is given (points)."""
    weights: Array
    """Of the fitted numbers at these points (points, knots)."""
    quantity: Callable[[Array], Array]
    """From the smooth function to the law's quantity, in `unit`."""
    kept: Callable[[Array], dict[str, float]]
    """From the fitted numbers to those a model file keeps (`effects.free_law`), its strength aside."""


def kinds(stage: SettledModel) -> Iterator[LawKind]:
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
        yield source_by_time(float(np.max(lasts)))
    loads = _closed_loads(digests)
    if varies([{0: loads}]):
        yield contact_by_load(float(loads.min()), float(loads.max()))
    hottest = float(np.max([np.nanmax(d.y) for d in digests]))
    coldest = float(np.min([np.nanmin(d.y[:3]) for d in digests])) + COLDEST_K
    if hottest > coldest + COLDEST_K:
        yield heat_by_temperature(coldest, hottest)
        yield conductivity_by_temperature(coldest, hottest)
        if press.has_states and lasts:
            yield contact_by_temperature(_coldest_closed(digests), hottest)
    yield exchange_by_depth()
    yield source_by_depth()


def contact_by_time(last_s: float, side: str = "") -> LawKind:
    """Return the contact, or that of one `side`, as a free function of the time since closing. [s]"""
    smooth = contact_knots(last_s)

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        law = _function(smooth, values)
        return contact_terms(scene, law if side else levelled(law, smooth.last), last_s, side)

    end = smooth.weights(smooth.last)
    along = np.linspace(0.0, smooth.knots[-1], POINTS)
    weights = smooth.weights(along) - (0.0 if side else end)
    kind = LawOf(f"{LawOf.CONTACT}_{side}") if side else LawOf.CONTACT

    def kept(numbers: Array) -> dict[str, float]:
        level = {LEVEL: float(end[0] @ numbers)} if side else {}
        return {LAST_S: last_s, **level, **_at_knots(smooth, numbers)}

    effect = _effect(kind, smooth, terms)
    x = EARLY_S * np.expm1(along)
    return LawKind(kind, "time_since_closing_s", "-", effect, x, weights, np.exp, kept)


def _coldest_closed(digests: Sequence[Digest]) -> float:
    """Return the coldest face once a press has closed: what it passes while that closes shows no contact. [°C]"""
    shut = [(d.time > d.moments.closed_s + d.moments.ramp_s) & ~(d.time > d.moments.opened_s) for d in digests]
    found = (np.nanmin(d.y[rows], initial=np.inf) for d, rows in zip(digests, shut, strict=True))
    return float(min(found))


def _closed_loads(digests: Sequence[Digest]) -> Array:
    """Return the pressures on the panel's contacts while closed, over their reference."""
    found = [np.zeros(0)]
    for digest in digests:
        if np.isfinite(digest.moments.closed_s):
            shut = closed_loads(digest)
            found += [shut[m] for m in digest.cases[False].scene.panel_contacts if m in shut]
    return np.concatenate(found)


def contact_by_load(least: float, most: float) -> LawKind:
    """Return the contacts as a free function of the pressure over its reference."""
    smooth = load_knots(least, most)

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        return load_terms(scene, levelled(_function(smooth, values), smooth.nearest(REFERENCE)), smooth)

    def kept(numbers: Array) -> dict[str, float]:
        return {LEAST_LOAD: least, MOST_LOAD: most, **_at_knots(smooth, numbers)}

    along = np.linspace(smooth.knots[0], smooth.knots[-1], POINTS)
    weights = levelled(smooth.weights, smooth.nearest(REFERENCE))(along)
    effect = _effect(LawOf.CONTACT_BY_LOAD, smooth, terms)
    return LawKind(LawOf.CONTACT_BY_LOAD, "load_share", "-", effect, np.exp(along), weights, np.exp, kept)


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


def conductivity_by_temperature(coldest_C: float, hottest_C: float) -> LawKind:
    """Return the panel's conductivity as a free function of its temperature. [°C]"""
    smooth = heat_knots(coldest_C, hottest_C)

    def terms(_: Scene, values: Mapping[str, Any]) -> Terms:
        return conductivity_terms(_function(smooth, values), smooth)

    return _factor_by_temperature(LawOf.CONDUCTIVITY, smooth, terms, smooth.weights)


def contact_by_temperature(coldest_C: float, hottest_C: float) -> LawKind:
    """Return the closed contacts as a free function of the temperature of the panel's face. [°C]"""
    smooth = heat_knots(coldest_C, hottest_C)

    def terms(_: Scene, values: Mapping[str, Any]) -> Terms:
        return face_terms(levelled(_function(smooth, values), smooth.last), smooth)

    weights = levelled(smooth.weights, smooth.last)
    return _factor_by_temperature(LawOf.CONTACT_BY_TEMPERATURE, smooth, terms, weights)


def _factor_by_temperature(
    kind: LawOf, smooth: Smooth, terms: Callable[[Scene, Mapping[str, Any]], Terms], weights: Function
) -> LawKind:
    ends = {COLDEST_C: float(smooth.knots[0]), HOTTEST_C: float(smooth.knots[-1])}

    def kept(numbers: Array) -> dict[str, float]:
        return ends | _at_knots(smooth, numbers)

    x = np.linspace(smooth.knots[0], smooth.knots[-1], POINTS)
    effect = _effect(kind, smooth, terms, nonlinear=True)
    return LawKind(kind, "temperature_C", "-", effect, x, weights(x), np.exp, kept)


def exchange_by_depth() -> LawKind:
    """Return heat lost to the room as a free function of the height in the panel."""
    return _by_depth(LawOf.EXCHANGE, "W/m3K", EXCHANGE_SIZE, exchange_terms)


def source_by_depth() -> LawKind:
    """Return heat released in the closed press as a free function of the height in the panel."""
    return _by_depth(LawOf.SOURCE_BY_DEPTH, "kW/m3", SOURCE_SIZE, depth_source_terms)


def _by_depth(kind: LawOf, unit: str, size: float, terms_of: Callable[[Scene, Function], Terms]) -> LawKind:
    smooth = depth_knots()

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        return terms_of(scene, _function(smooth, values, size))

    def kept(numbers: Array) -> dict[str, float]:
        return _at_knots(smooth, size * numbers)

    z = np.linspace(-1.0, 1.0, POINTS)
    effect = _effect(kind, smooth, terms, nonlinear=find_effect(f"law_{kind}").nonlinear)
    return LawKind(kind, "depth_share", unit, effect, 0.5 * (z + 1.0), size * smooth.weights(z), np.asarray, kept)


def source_by_time(last_s: float) -> LawKind:
    """Return heat released everywhere in the panel as a free function of the time since closing. [s]"""
    smooth = contact_knots(last_s)

    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        return time_source_terms(scene, _function(smooth, values, SOURCE_SIZE), last_s)

    def kept(numbers: Array) -> dict[str, float]:
        return {LAST_S: last_s, **_at_knots(smooth, SOURCE_SIZE * numbers)}

    along = np.linspace(0.0, smooth.knots[-1], POINTS)
    effect = _effect(LawOf.SOURCE_BY_TIME, smooth, terms, nonlinear=True)
    x, weights = EARLY_S * np.expm1(along), SOURCE_SIZE * smooth.weights(along)
    return LawKind(LawOf.SOURCE_BY_TIME, "time_since_closing_s", "kW/m3", effect, x, weights, np.asarray, kept)


def _function(smooth: Smooth, values: Mapping[str, Any], size: float = 1.0) -> Function:
    return smooth.through(smooth.factor @ (size * np.array(list(values.values()))))


def _at_knots(smooth: Smooth, numbers: Array) -> dict[str, float]:
    return {f"{VALUE}_{knot}": float(value) for knot, value in enumerate(smooth.factor @ numbers)}


def _effect(
    kind: LawOf, smooth: Smooth, terms: Callable[[Scene, Mapping[str, Any]], Terms], *, nonlinear: bool = False
) -> Effect:
    parameters = tuple(
        Parameter(f"w{i}", "-", 0.0, 1.0, -HEAVIEST, HEAVIEST, "weight of a free law, no physical number")
        for i in range(smooth.factor.shape[1])
    )
    return Effect(f"law_{kind}", parameters, terms, SOURCE, nonlinear=nonlinear)
