"""What is missing as a smooth function of one variable: an effect without a name, whose curve is data.

A diagnosis learns the curve (`softsensor.diagnosis.laws`); here it acts on the stack, while it is fitted and
later, in a model file. There it is an effect like others: how strong it is (1 as found), where its knots lie, and
its values at them. These effects stand in no catalogue, since nobody looks for one by its name.

=======================  =========================================================================================
effect                   values at the knots
=======================  =========================================================================================
``law_contact``          logarithm of the factor on the closed panel's contacts, up to a constant that makes the
                         factor 1 at the longest time seen, over log(1 + t / 2 s) of the time
                         t since closing; ``law_contact_lower`` and ``law_contact_upper`` on one of them alone,
                         with a level of its own, since the coefficient is also the other one's
``law_contact_by_load``  logarithm of the factor on the closed panel's contacts, over that of the pressure as a
                         share of its reference, where the factor is 1; beyond the pressures seen it stays
``law_conductivity``     logarithm of the factor on the panel's conductivity, over its temperature
``law_contact_by_temperature``
                         logarithm of the factor on the closed panel's contacts, over the temperature of the face
                         that each touches, 0 at the hottest seen
``law_heat``             heat that goes for good as the panel warms up, over its temperature [kJ/m³K]
``law_heat_exchange``    heat lost to the room, over the height in the panel [W/m³K]
``law_source_by_depth``  heat released in the closed press, over the height in the panel [kW/m³]
``law_source_by_time``   the same everywhere in the panel, over log(1 + t / 2 s); beyond the longest time it stays
=======================  =========================================================================================

References
----------
Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), sec. 8.3.1 (subset of regressors).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import inf
from typing import Any

import numpy as np

from daq import records
from daq.press.header import LIMITS
from daq.press.press_file import HEAT_TRANSFER
from daq.records import Array
from daq.words import Message, say
from softsensor.effects import contact_load
from softsensor.effects.effect import (
    BENDS_C,
    Conversion,
    Effect,
    LawOf,
    Live,
    Need,
    Numbers,
    Role,
    Scene,
    Source,
    Terms,
    on_panel,
)
from softsensor.effects.moisture_evaporation import RATE, SOFTNESS
from softsensor.effects.parameters import Parameter

_CONDUCTIVITY = LIMITS["panel.conductivity_W_mK"]
SIDES = {"": slice(None), "lower": slice(0, 1), "upper": slice(-1, None)}
"""Which of the panel's contacts, from bottom to top, a law of contact is about."""
BY_TIME, BY_DEPTH = 12, 5
"""Knots of every law by time, and by depth."""
KNOTS = {
    **{LawOf.CONTACT: BY_TIME, LawOf.CONTACT_BY_LOAD: 6, LawOf.HEAT: 9, LawOf.CONDUCTIVITY: 9},
    **{LawOf.EXCHANGE: BY_DEPTH, LawOf.SOURCE_BY_DEPTH: BY_DEPTH, LawOf.SOURCE_BY_TIME: BY_TIME},
}
"""Of each kind: as many as a solve bears, and finer than what twelve runs show. By hand, 2026-11."""
LENGTH = 1.3
"""Of the kernel, in distances of knots: then no function between knots is lost (by hand, 2026-11)."""
EARLY_S = 2.0
"""Time counts as its logarithm from here on: a contact changes most at first (by hand, 2026-11). [s]"""
HEAT_UNIT = 1e3
"""From the unit in which a law of heat is shown. [J/m³K per kJ/m³K]"""
SOURCE_UNIT = 1e3
"""From the unit in which a law of a source is shown. [W/m³ per kW/m³]"""
STRONGEST = 10.0
"""A further run shows at most so many times what the runs before it did. By hand, 2026-11."""
STRENGTH, LAST_S, COLDEST_C, HOTTEST_C = "strength", "last_s", "coldest_C", "hottest_C"
LEAST_LOAD, MOST_LOAD = "least_load", "most_load"
REFERENCE = 0.0
"""Logarithm of the pressure as a share of its reference, there; a law by pressure is 0 at it, or nearest to it."""
LEVEL = "level"
"""Logarithm of the factor on one contact at the longest time seen; 0 in files of versions that had none."""
VALUE = "value"
"""Of each knot, with its number."""
READABLE_C = (records.COLDEST_C, records.HOTTEST_C)
"""What a thermocouple reads at all. [°C]"""
CONTACT_MOST = float(np.log(HEAT_TRANSFER[1] / HEAT_TRANSFER[0]))
"""Logarithm of a factor that leads from the one limit of heat transfer coefficients to the other."""
CONDUCTIVITY_MOST = float(np.log(_CONDUCTIVITY.upper / _CONDUCTIVITY.lower))
"""The same of matter's conductivity."""
HEAT_MOST = LIMITS["panel.density_kg_m3"].upper * LIMITS["panel.heat_capacity_J_kgK"].upper / HEAT_UNIT
"""What matter stores at most. [kJ/m³K]"""

Function = Callable[[Any], Any]
"""A smooth function of places (places), in the kind's own unit; plain algebra, complex numbers go through."""


@dataclass(frozen=True)
class Smooth:
    """A Gaussian process on evenly spaced knots, with a squared-exponential kernel."""

    knots: Array
    length: float
    inverse: Array
    """Of the kernel at the knots (knots, knots)."""
    factor: Array
    """Values at the knots are it times independent standard normal numbers (knots, knots)."""

    @staticmethod
    def over(low: float, high: float, count: int) -> Smooth:
        """Return the process with so many knots from `low` to `high`."""
        knots = np.linspace(low, high, count)
        length = LENGTH * (high - low) / (count - 1)
        kernel = np.exp(-0.5 * ((knots[:, None] - knots[None, :]) / length) ** 2) + 1e-6 * np.eye(count)
        factor = np.asarray(np.linalg.cholesky(kernel), dtype=float)
        return Smooth(knots, length, np.asarray(np.linalg.inv(kernel), dtype=float), factor)

    def weights(self, x: Any) -> Any:
        """Return the weights of the independent normal numbers at some places (places, knots)."""
        return self._near(x) @ (self.inverse @ self.factor)

    def through(self, values: Any) -> Function:
        """Return the likeliest function through values at the knots (knots)."""
        steep = self.inverse @ values
        return lambda x: self._near(x) @ steep

    @property
    def last(self) -> Array:
        """The last knot, as a place: the longest time seen, the hottest temperature."""
        return self.knots[-1:]

    def nearest(self, x: float) -> Array:
        """Return the place between the knots that is nearest to `x`."""
        return np.asarray(np.clip(np.array([x]), self.knots[0], self.knots[-1]))

    def _near(self, x: Any) -> Any:
        return np.exp(-0.5 * ((x[:, None] - self.knots[None, :]) / self.length) ** 2)


def levelled(law: Function, at: Array, level: Any = 0.0) -> Function:
    """Return a law whose value at one place is `level`, by adding a constant."""
    shift = level - law(at)
    return lambda x: law(x) + shift


def contact_knots(last_s: float) -> Smooth:
    """Return the process of a law of contact, over log(1 + t / 2 s) of the time since closing. [s]"""
    return Smooth.over(0.0, float(np.log1p(last_s / EARLY_S)), BY_TIME)


def load_knots(least: float, most: float) -> Smooth:
    """Return the process of a law of contact over the logarithm of the pressure as a share of its reference."""
    return Smooth.over(float(np.log(least)), float(np.log(most)), KNOTS[LawOf.CONTACT_BY_LOAD])


def heat_knots(coldest_C: float, hottest_C: float) -> Smooth:
    """Return the process of a law of heat, over temperature. [°C]"""
    return Smooth.over(coldest_C, hottest_C, KNOTS[LawOf.HEAT])


def conductivity_terms(law: Function, smooth: Smooth) -> Terms:
    """Return the panel's conductivity with its free function; beyond the temperatures seen it stays."""
    return Terms(conductivity_bend=law(_within(smooth)))


def face_terms(law: Function, smooth: Smooth) -> Terms:
    """Return closed contacts with the free function of the panel's face; beyond what was seen they stay."""
    return Terms(contact_bend=law(_within(smooth)))


def _within(smooth: Smooth) -> Array:
    return np.clip(BENDS_C, smooth.knots[0], smooth.knots[-1])


def depth_knots() -> Smooth:
    """Return the process of a law by depth, over the height from -1 (lower face) to 1."""
    return Smooth.over(-1.0, 1.0, BY_DEPTH)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
"""A contact changes by shares within a long step: its mean is taken over these."""


def contact_terms(scene: Scene, law: Function, last_s: float, side: str = "") -> Terms:
    """Return the contacts' factors, whose logarithm is `law`; after the longest time seen they stay. [s]"""
    if np.isnan(scene.closed_s):
        return Terms()
    factor = _means(scene, lambda x: np.exp(law(x)), last_s)
    return Terms(closed_contact=dict.fromkeys(scene.panel_contacts[SIDES[side]], factor))


def _means(scene: Scene, law: Function, last_s: float) -> Numbers:
    """Return the means of a function of the time since closing over each step; after the longest it stays. [s]"""
    begun, over = np.searchsorted(scene.step_end, np.real(scene.closed_s) + np.array([0.0, last_s]), side="right")
    changing = slice(begun, over + 1)
    start, end = scene.step_start[changing], scene.step_end[changing]
    since = 0.5 * (start + end) + 0.5 * (end - start) * _NODES[:, None] - scene.closed_s
    since = np.where(np.real(since) > 0.0, since, 0.0)
    since = np.where(np.real(since) < last_s, since, last_s)
    nodes = law(np.log(1.0 + since.ravel() / EARLY_S)).reshape(since.shape)
    before, after = law(np.log(1.0 + np.array([0.0, last_s]) / EARLY_S))
    mean = np.full(len(scene.step_end), before, dtype=nodes.dtype)
    mean[changing] = 0.5 * _WEIGHTS @ nodes
    mean[changing.stop :] = after
    return mean


def load_terms(scene: Scene, law: Function, smooth: Smooth) -> Terms:
    """Return the factors of the panel's contacts whose pressure is known; beyond the pressures seen they stay."""
    low, high = np.exp(smooth.knots[[0, -1]])
    return Terms(
        closed_contact={
            m: np.exp(law(np.log(np.clip(scene.load[m], low, high))))
            for m in scene.panel_contacts
            if m in scene.load
        }
    )


def heat_terms(scene: Scene, law: Function, smooth: Smooth) -> Terms:
    """Return heat that goes once, by each knot as the water of `moisture_evaporation` does above its boiling."""
    apart = float(smooth.knots[1] - smooth.knots[0])
    return Terms(
        conversions=tuple(
            Conversion(on_panel(scene, -heat, 0.0), 1, RATE, knot, SOFTNESS)
            for heat, knot in zip(law(smooth.knots) * (HEAT_UNIT * apart), smooth.knots, strict=True)
        )
    )


def exchange_terms(scene: Scene, law: Function) -> Terms:
    """Return heat lost to the room by height in the panel."""
    return Terms(exchange=np.where(scene.panel_cells, law(scene.z), 0.0))


def depth_source_terms(scene: Scene, law: Function) -> Terms:
    """Return heat released in the closed press by height in the panel."""
    return Terms(sources=(Source(on_panel(scene, SOURCE_UNIT * law(scene.z), 0.0)),))


def time_source_terms(scene: Scene, law: Function, last_s: float) -> Terms:
    """Return heat released everywhere in the panel by the time since closing. [s]"""
    if np.isnan(scene.closed_s):
        return Terms()
    return Terms(sources=(Source(on_panel(scene, SOURCE_UNIT, 0.0), _means(scene, law, last_s)),))


@dataclass(frozen=True)
class LawEffect(Effect):
    """A law as a model file holds it: all of its numbers together, or it is another law."""

    def wrong_together(self, values: Mapping[str, float]) -> Message | None:
        """Return which number is missing, or which ends between which the knots lie do not rise."""
        for p in self.parameters:
            if p.name not in values and p.name != LEVEL:
                return say("law-lacks", name=p.name)
        for low, high in ((COLDEST_C, HOTTEST_C), (LEAST_LOAD, MOST_LOAD)):
            if low in values and not values[low] < values[high]:
                return say("law-ends", low=low, high=high, least=values[low], most=values[high])
        return None

    @property
    def called(self) -> Message:
        """What it is called in the middle of a sentence."""
        return say(f"law-kind-{self.name.removeprefix('law_')}")

    def parameter_called(self, parameter: str) -> Message:
        """Return what a parameter is, in words an operator knows."""
        name, _, knot = parameter.partition("_") if parameter.startswith(VALUE) else (parameter, "", "")
        return say(f"parameter-law-{name}", knot=knot) if knot else say(f"parameter-law-{name}")


def _parameters(knots: int, unit: str, ends: Sequence[Parameter], most: float = inf) -> Iterator[Parameter]:
    """Yield a law's parameters: how strong it is, then numbers that say what it is and that nobody searches.

    `most`: a value at a knot lies between this and its negative.
    """
    yield Parameter(
        STRENGTH, "-", 0.0, 1.0, -STRONGEST, STRONGEST, "1 where a further run shows what the runs before it did"
    )
    yield from ends
    for knot in range(knots):
        yield _found(f"{VALUE}_{knot}", unit, 0.0, -most, most)


def _found(name: str, unit: str, usual: float, lower: float = -inf, upper: float = inf) -> Parameter:
    found = "as the runs behind the model have it"
    return Parameter(name, unit, usual, usual, lower, upper, found, fixed=True)


def _given(smooth: Smooth, values: Mapping[str, Any]) -> Function:
    """Return the function that a model file's numbers mean."""
    law = smooth.through(np.array([np.real(values[f"{VALUE}_{knot}"]) for knot in range(len(smooth.knots))]))
    return lambda x: values[STRENGTH] * law(x)


_LAST = (_found(LAST_S, "s", 60.0, 1e-3, LIMITS["setting.press_time_s"].upper),)


def _contact(side: str) -> LawEffect:
    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        last_s = float(np.real(values[LAST_S]))
        level, smooth = values[STRENGTH] * values[LEVEL] if side else 0.0, contact_knots(last_s)
        law = levelled(_given(smooth, values), smooth.last, level)
        return contact_terms(scene, law, last_s, side)

    level = (_found(LEVEL, "-", 0.0, -CONTACT_MOST, CONTACT_MOST),) if side else ()
    parameters = tuple(_parameters(KNOTS[LawOf.CONTACT], "-", (*_LAST, *level), CONTACT_MOST))
    live = Live(Role.SCATTER, with_states=True)
    name = f"law_contact_{side}" if side else "law_contact"
    return LawEffect(name, parameters, terms, SOURCE, live=live, needs=Need.PANEL)


def _by_load() -> LawEffect:
    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        smooth = load_knots(float(np.real(values[LEAST_LOAD])), float(np.real(values[MOST_LOAD])))
        return load_terms(scene, levelled(_given(smooth, values), smooth.nearest(REFERENCE)), smooth)

    ends = (_found(LEAST_LOAD, "-", 0.5, contact_load.LEAST_LOAD), _found(MOST_LOAD, "-", 1.0))
    parameters = tuple(_parameters(KNOTS[LawOf.CONTACT_BY_LOAD], "-", ends, CONTACT_MOST))
    live = Live(Role.SCATTER, with_states=True)
    return LawEffect("law_contact_by_load", parameters, terms, SOURCE, live=live, needs=Need.LOAD)


_ENDS = (_found(COLDEST_C, "°C", 40.0, *READABLE_C), _found(HOTTEST_C, "°C", 200.0, *READABLE_C))


def _heat() -> LawEffect:
    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        smooth = heat_knots(float(np.real(values[COLDEST_C])), float(np.real(values[HOTTEST_C])))
        return heat_terms(scene, _given(smooth, values), smooth)

    parameters = tuple(_parameters(KNOTS[LawOf.HEAT], "kJ/m³K", _ENDS, HEAT_MOST))
    live = Live(Role.OWN_FILTER)
    return LawEffect("law_heat", parameters, terms, SOURCE, live=live, nonlinear=True, needs=Need.PANEL)


def _by_temperature(kind: LawOf) -> LawEffect:
    def terms(_: Scene, values: Mapping[str, Any]) -> Terms:
        smooth = heat_knots(float(np.real(values[COLDEST_C])), float(np.real(values[HOTTEST_C])))
        law = _given(smooth, values)
        if kind is LawOf.CONDUCTIVITY:
            return conductivity_terms(law, smooth)
        return face_terms(levelled(law, smooth.last), smooth)

    most = CONDUCTIVITY_MOST if kind is LawOf.CONDUCTIVITY else CONTACT_MOST
    parameters = tuple(_parameters(KNOTS[LawOf.HEAT], "-", _ENDS, most))
    live = Live(Role.OWN_FILTER)
    return LawEffect(f"law_{kind}", parameters, terms, SOURCE, live=live, nonlinear=True, needs=Need.PANEL)


def _by_depth(kind: LawOf, unit: str, terms_of: Callable[[Scene, Function], Terms], *, steps: bool) -> LawEffect:
    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        return terms_of(scene, _given(depth_knots(), values))

    parameters = tuple(_parameters(BY_DEPTH, unit, ()))
    live = Live(Role.HYPOTHESIS)
    return LawEffect(f"law_{kind}", parameters, terms, SOURCE, live=live, nonlinear=steps, needs=Need.PANEL)


def _time_source() -> LawEffect:
    def terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
        last_s = float(np.real(values[LAST_S]))
        return time_source_terms(scene, _given(contact_knots(last_s), values), last_s)

    parameters = tuple(_parameters(BY_TIME, "kW/m³", _LAST))
    live = Live(Role.HYPOTHESIS, with_states=True)
    return LawEffect("law_source_by_time", parameters, terms, SOURCE, live=live, nonlinear=True, needs=Need.PANEL)


SOURCE = "free function, learned from the runs"


@cache
def laws() -> dict[str, Effect]:
    """Return the effects that carry a law, by name."""
    bends = map(_by_temperature, (LawOf.CONTACT_BY_TEMPERATURE, LawOf.CONDUCTIVITY))
    exchange = _by_depth(LawOf.EXCHANGE, "W/m³K", exchange_terms, steps=False)
    source = _by_depth(LawOf.SOURCE_BY_DEPTH, "kW/m³", depth_source_terms, steps=True)
    found = (*map(_contact, SIDES), _by_load(), *bends, _heat(), exchange, source, _time_source())
    return {effect.name: effect for effect in found}
