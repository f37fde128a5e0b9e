"""The limits a panel must keep at opening, how likely each is broken, and from when all of them hold.

Each limit has its chance of being broken. Both faces carry the same paper and much the same contact, so that one
of them is undercured with the chance of two normals that hang together (`either_below`); beside that the chance
that any limit is broken counts as no more than the sum (Boole's inequality): what is wanted with a probability
holds with at least that. What is not known counts as broken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from daq.press.resin_file import LimitsTable
from daq.printed import on_screen
from daq.records import Array
from softsensor.opening.kinetics import Kinetics
from softsensor.signals.unknown import BAND

CURE_BOTTOM, CURE_TOP, CORE_COLD, CORE_HOT, STEAM = (
    "cure_bottom",
    "cure_top",
    "core_least",
    "core_most",
    "steam_most",
)
"""The limits by name."""
STEAM_MOST, STEAM_BELIEVED = "steam_most_kPa", "steam_believed_kPa"
"""Key of the resin file."""
_TINY = 1e-12
"""Owen's formula divides by both deviates and by the root of 1 - r²: nearer to 0 is not looked."""


@dataclass(frozen=True)
class Normal:
    """A quantity as it is known: mean and standard deviation (any shape); or those of its logarithm."""

    mean: Array
    sd: Array

    __repr__ = on_screen

    @property
    def low(self) -> Array:
        """Lower bound of 95 %, in the unit of the mean."""
        return np.asarray(self.mean - BAND * self.sd)

    @property
    def high(self) -> Array:
        """Upper bound of 95 %, in the unit of the mean."""
        return np.asarray(self.mean + BAND * self.sd)

    def deviates(self, limit: float) -> Array:
        """Return by how many standard deviations it lies below a limit, infinity where it is not known."""
        with np.errstate(divide="ignore", invalid="ignore"):
            away = (limit - self.mean) / self.sd
        sure = np.where(np.asarray(self.mean) < limit, np.inf, -np.inf)
        known = np.isfinite(self.mean) & np.isfinite(self.sd)
        return np.asarray(np.where(known, np.where(np.asarray(self.sd) > 0.0, away, sure), np.inf))

    def below(self, limit: float) -> Array:
        """Return the chance that it lies below a limit, 1 where it is not known."""
        return _chance(self.deviates(limit))

    @property
    def turned(self) -> Normal:
        """It with its sign turned: what lies above a limit lies below that of the other sign."""
        return Normal(-np.asarray(self.mean), self.sd)


def _chance(deviates: Array) -> Array:
    from scipy.special import ndtr  # loads slowly, and only a press with limits asks

    return np.asarray(ndtr(deviates))


@dataclass(frozen=True)
class PanelState:
    """What is known of a panel at one moment or at many (any shape, one for all)."""

    cure_bottom: Normal
    """Logarithm of the lower face's equivalent time (`Kinetics`). [ln s]"""
    cure_top: Normal
    """Of the upper face's. [ln s]"""
    core: Normal
    """[°C]"""
    steam: Normal
    """Logarithm of the partial pressure. [ln kPa]"""
    together: Array | float = 0.0
    """Correlation of both faces' cure."""

    __repr__ = on_screen


@dataclass(frozen=True)
class Broken:
    """How likely limits are broken at one moment, or at many (any shape)."""

    chances: Mapping[str, Array]
    """Of each limit there is, by its name."""
    cure: Array | float = 0.0
    """That one face or the other has cured too little."""
    beyond: Mapping[str, Array] = field(default_factory=dict)
    """By how many standard deviations limits are broken, by name: separates what is broken for certain."""

    __repr__ = on_screen

    @property
    def risk(self) -> Array:
        """Chance that any limit is broken, at most; 1 where there is no limit at all."""
        if not self.chances:
            return np.asarray(1.0)
        others = [chance for name, chance in self.chances.items() if name not in (CURE_BOTTOM, CURE_TOP)]
        return np.asarray(np.minimum(self.cure + sum(others), 1.0))

    def at(self, moments: np.ndarray) -> Broken:
        """Return it at some of its moments."""
        cure = self.cure[moments] if isinstance(self.cure, np.ndarray) else self.cure
        chances, beyond = (
            {name: of[moments] for name, of in each.items()} for each in (self.chances, self.beyond)
        )
        return Broken(chances, cure, beyond)

    @staticmethod
    def along(looks: Sequence[Broken]) -> Broken:
        """Return moments looked at one by one as one (t); a limit that one of them lacks is kept there."""
        names = dict.fromkeys(name for one in looks for name in one.chances)
        zero = np.asarray(0.0)
        chances = {n: np.array([float(one.chances.get(n, zero)) for one in looks]) for n in names}
        return Broken(chances, np.array([float(one.cure) for one in looks]))


def either_below(limit: float, one: Normal, other: Normal, together: Array | float) -> Array:
    """Return the chance that one or the other of two normals lies below a limit, 1 where one is not known.

    Parameters
    ----------
    together
        Their correlation.

    References
    ----------
    D. B. Owen, Ann. Math. Statist. 27 (1956) 1075, eq. 2.1: the bivariate normal by his function T.

    Examples
    --------
    >>> unit = Normal(np.array(0.0), np.array(1.0))
    >>> [round(float(either_below(-1.959964, unit, unit, r)), 4) for r in (0.0, 0.9, 1.0)]
    [0.0494, 0.0352, 0.025]
    """
    from scipy.special import owens_t

    below = one.below(limit), other.below(limit)
    sure = np.maximum(*below)
    with np.errstate(divide="ignore", invalid="ignore"):
        h, k = ((limit - n.mean) / n.sd for n in (one, other))
        h, k = (np.where(np.abs(x) < _TINY, _TINY, x) for x in (h, k))
        r = np.clip(together, -1.0 + _TINY, 1.0 - _TINY)
        root = np.sqrt(1.0 - r * r)
        both = 0.5 * (below[0] + below[1]) - owens_t(h, (k / h - r) / root) - owens_t(k, (h / k - r) / root)
        both = both - np.where(h * k < 0.0, 0.5, 0.0)
    spread = np.isfinite(h) & np.isfinite(k)
    return np.asarray(np.where(spread, np.clip(below[0] + below[1] - both, sure, 1.0), sure))


def broken(limits: LimitsTable, kinetics: Kinetics | None, panel: PanelState) -> Broken:
    """Return for every limit there is the chance that it is broken (shape of the panel's numbers).

    Without kinetics nobody knows how far a face has cured: a limit of cure counts as broken.

    Examples
    --------
    >>> from softsensor.opening.kinetics import kinetics_of
    >>> from daq.press.resin_file import OrderLaw
    >>> law = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0))
    >>> at_limit = Normal(np.log(law.equivalent_s(0.9)), np.array(0.1))
    >>> unknown = Normal(np.array(np.nan), np.array(np.nan))
    >>> found = broken(LimitsTable(cure_least=0.9), law, PanelState(at_limit, at_limit, unknown, unknown))
    >>> {k: round(float(v), 6) for k, v in found.chances.items()}, round(float(found.risk), 6)
    ({'cure_bottom': 0.5, 'cure_top': 0.5}, 0.75)
    """
    beyond: dict[str, Array] = {}
    undercured: Array | float = 0.0
    if limits.cure_least is not None:
        least = math.inf if kinetics is None else math.log(kinetics.equivalent_s(limits.cure_least))
        beyond[CURE_BOTTOM], beyond[CURE_TOP] = panel.cure_bottom.deviates(least), panel.cure_top.deviates(least)
        undercured = either_below(least, panel.cure_bottom, panel.cure_top, panel.together)
    if limits.core_least_C is not None:
        beyond[CORE_COLD] = panel.core.deviates(limits.core_least_C)
    if limits.core_most_C is not None:
        beyond[CORE_HOT] = panel.core.turned.deviates(-limits.core_most_C)
    if limits.steam_most_kPa is not None:
        own = limits.spreads.get(STEAM_MOST, 0.0) / limits.steam_most_kPa
        steam = Normal(panel.steam.mean, np.hypot(panel.steam.sd, own))
        beyond[STEAM] = steam.turned.deviates(-math.log(limits.steam_most_kPa))
    return Broken({name: _chance(away) for name, away in beyond.items()}, undercured, beyond)


@dataclass(frozen=True)
class Opening:
    """From when on a panel may be let out, looking ahead."""

    in_s: float
    """From when on every limit holds with the wanted probability, 0: now; NaN: not as far as was looked. [s]"""
    likely_in_s: float
    """From when on it is likelier than not that every limit holds; NaN: never. [s]"""
    earliest_s: float
    """Lower bound of 95 % of when it will be known that they hold (`surely_known`). NaN with `in_s`. [s]"""
    latest_s: float
    """Upper bound of 95 % of it; NaN where that is later than was looked. [s]"""
    until_s: float
    """Until when it goes on holding from `in_s` on: the last moment looked at, or one before. NaN with `in_s`."""
    blocking: str
    """Where `in_s` is NaN: the limit most likely broken at the moment that comes nearest. Else empty."""
    risk: float
    """Chance that a limit is broken at `in_s`; where that is NaN, at the moment that comes nearest."""
    beyond: float = -math.inf
    """Where `in_s` is NaN: by how many standard deviations the limit broken most is, where that is known."""

    __repr__ = on_screen


NOTHING_FORESEEN = Opening(math.nan, math.nan, math.nan, math.nan, math.nan, "", math.nan)


def surely_known(wanted: float) -> float:
    """Return the chance of a broken limit from which on, with 97.5 %, it will be known that limits hold.

    The filters go on learning. What is known now of the moment at which limits begin to hold is, near it, a normal
    of deviation s; of that some c will be left when the press may open, and it may from m + z c on, z the wanted
    probability's deviate and m what is expected then. Now m has the deviation of s² - c², so that the press may
    open before z c + 1.96 √(s² - c²) with 97.5 %, which is at most √(z² + 1.96²) s whatever c is. Before -1.96 s
    it may with 2.5 % at most: c = 0, everything is learned.

    Examples
    --------
    >>> round(surely_known(0.975), 4)  # 1.96 √2 = 2.77 deviations
    0.0028
    """
    from scipy.special import ndtri

    return float(_chance(-np.hypot(ndtri(wanted), BAND)))


def _falls_to(ahead_s: Array, total: Array, level: float) -> float:
    """Return when a chance first falls to a level, straight in normal deviates in between; NaN: never. [s]"""
    below = np.flatnonzero(total <= level + 1e-12)
    if not len(below):
        return math.nan
    k = int(below[0])
    if k == 0:
        return float(ahead_s[0])
    from scipy.special import ndtri

    before, after, wanted = ndtri(np.clip([total[k - 1], total[k], level], 1e-9, 1.0 - 1e-9))
    share = (before - wanted) / (before - after) if before > after else 1.0
    return float(ahead_s[k - 1] + share * (ahead_s[k] - ahead_s[k - 1]))


def opening(ahead_s: Array, found: Broken, wanted: float) -> Opening:
    """Return from when on every limit holds.

    Parameters
    ----------
    ahead_s
        Moments looked at, rising, from 0 for now (t). [s]
    found
        How likely limits are broken at these moments (t).
    wanted
        Probability with which all limits are to hold together.

    Examples
    --------
    >>> ahead = np.array([0.0, 4.0, 8.0])
    >>> round(opening(ahead, Broken({"core_least": np.array([0.9, 0.2, 0.01])}), 0.975).in_s, 1)
    7.0
    >>> opening(ahead, Broken({"steam_most": np.array([0.9, 0.9, 0.8])}), 0.975).blocking
    'steam_most'
    """
    total, chances = np.broadcast_to(found.risk, ahead_s.shape), found.chances
    holds = total <= 1.0 - wanted + 1e-12
    likely_in = _falls_to(ahead_s, total, 0.5)
    if not holds.any():
        beyond = {name: np.broadcast_to(found.beyond.get(name, -math.inf), total.shape) for name in chances}
        most = np.max([*beyond.values(), np.full(total.shape, -math.inf)], axis=0)
        nearest = int(np.lexsort((most, total))[0])

        def broken_most(name: str) -> tuple[float, float]:
            return float(np.broadcast_to(chances[name], total.shape)[nearest]), float(beyond[name][nearest])

        worst, risk = max(chances, key=broken_most, default=""), float(total[nearest])
        return replace(
            NOTHING_FORESEEN, likely_in_s=likely_in, blocking=worst, risk=risk, beyond=float(most[nearest])
        )
    first = int(np.argmax(holds))
    after = np.flatnonzero(~holds[first:])
    last = first + int(after[0]) - 1 if len(after) else len(holds) - 1
    risk = float(total[0]) if first == 0 else 1.0 - wanted
    return Opening(
        in_s=_falls_to(ahead_s, total, 1.0 - wanted),
        likely_in_s=likely_in,
        earliest_s=_falls_to(ahead_s, total, float(_chance(np.asarray(BAND)))),
        latest_s=_falls_to(ahead_s, total, surely_known(wanted)),
        until_s=float(ahead_s[last]),
        blocking="",
        risk=risk,
    )
