"""The limits a panel must keep at opening, how likely each is broken, and from when all of them hold.

Each limit has its chance of being broken, and the chance that any is counts as no more than their sum (Boole's
inequality): what is wanted with a probability holds with at least that, however the errors hang together. What is
not known counts as broken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from daq.press.resin_file import LimitsTable
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


@dataclass(frozen=True)
class Normal:
    """A quantity as it is known: mean and standard deviation (any shape); or those of its logarithm."""

    mean: Array
    sd: Array

    @property
    def low(self) -> Array:
        """Lower bound of 95 %."""
        return np.asarray(self.mean - BAND * self.sd)

    @property
    def high(self) -> Array:
        """Upper bound of 95 %."""
        return np.asarray(self.mean + BAND * self.sd)

    def below(self, limit: float) -> Array:
        """Return the chance that it lies below a limit, 1 where it is not known."""
        with np.errstate(divide="ignore", invalid="ignore"):
            chance = ndtr((limit - self.mean) / self.sd)
        sure = np.where(np.asarray(self.mean) < limit, 1.0, 0.0)
        known = np.isfinite(self.mean) & np.isfinite(self.sd)
        return np.asarray(np.where(known, np.where(np.asarray(self.sd) > 0.0, chance, sure), 1.0))

    def above(self, limit: float) -> Array:
        """Return the chance that it lies above a limit, 1 where it is not known."""
        return Normal(-np.asarray(self.mean), self.sd).below(-limit)


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


def broken(limits: LimitsTable, kinetics: Kinetics | None, panel: PanelState) -> dict[str, Array]:
    """Return for every limit there is the chance that it is broken, by its name (shape of the panel's numbers).

    Examples
    --------
    >>> from daq.press.resin_file import OrderLaw
    >>> from softsensor.opening.kinetics import kinetics_of
    >>> law = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0))
    >>> at_limit = Normal(np.log(law.equivalent_s(0.9)), np.array(0.1))
    >>> unknown = Normal(np.array(np.nan), np.array(np.nan))
    >>> panel = PanelState(at_limit, at_limit, unknown, unknown)
    >>> {k: round(float(v), 6) for k, v in broken(LimitsTable(cure_least=0.9), law, panel).items()}
    {'cure_bottom': 0.5, 'cure_top': 0.5}
    """
    found: dict[str, Array] = {}
    if limits.cure_least is not None and kinetics is not None:
        least = math.log(kinetics.equivalent_s(limits.cure_least))
        found[CURE_BOTTOM], found[CURE_TOP] = panel.cure_bottom.below(least), panel.cure_top.below(least)
    if limits.core_least_C is not None:
        found[CORE_COLD] = panel.core.below(limits.core_least_C)
    if limits.core_most_C is not None:
        found[CORE_HOT] = panel.core.above(limits.core_most_C)
    if limits.steam_most_kPa is not None:
        found[STEAM] = panel.steam.above(math.log(limits.steam_most_kPa))
    return found


def risk(chances: Mapping[str, Array] | Mapping[str, float]) -> Array:
    """Return the chance that any limit is broken, at most: the sum of theirs; 1 where there is no limit at all."""
    if not chances:
        return np.asarray(1.0)
    return np.asarray(np.minimum(sum(np.asarray(one) for one in chances.values()), 1.0))


@dataclass(frozen=True)
class Opening:
    """From when on a panel may be let out, looking ahead."""

    in_s: float
    """From when on every limit holds with the wanted probability, 0: now; NaN: not as far as was looked. [s]"""
    likely_in_s: float
    """From when on it is likelier than not that every limit holds; NaN: never. [s]"""
    until_s: float
    """Until when it goes on holding from `in_s` on: the last moment looked at, or one before. NaN with `in_s`."""
    blocking: str
    """Where `in_s` is NaN: the limit most likely broken at the moment that comes nearest. Else empty."""
    risk: float
    """Chance that a limit is broken at `in_s`; where that is NaN, at the moment that comes nearest."""


def _falls_to(ahead_s: Array, total: Array, level: float) -> float:
    """Return when a chance first falls to a level, straight in normal deviates in between; NaN: never. [s]"""
    below = np.flatnonzero(total <= level + 1e-12)
    if not len(below):
        return math.nan
    k = int(below[0])
    if k == 0:
        return float(ahead_s[0])
    before, after, wanted = ndtri(np.clip([total[k - 1], total[k], level], 1e-9, 1.0 - 1e-9))
    share = (before - wanted) / (before - after) if before > after else 1.0
    return float(ahead_s[k - 1] + share * (ahead_s[k] - ahead_s[k - 1]))


def opening(ahead_s: Array, chances: Mapping[str, Array], wanted: float) -> Opening:
    """Return from when on every limit holds.

    Parameters
    ----------
    ahead_s
        Moments looked at, rising, from 0 for now (t). [s]
    chances
        By name, that a limit is broken at these moments (t), as `broken` returns them.
    wanted
        Probability with which all limits are to hold together.

    Examples
    --------
    >>> ahead = np.array([0.0, 4.0, 8.0])
    >>> round(opening(ahead, {"cure_top": np.array([0.9, 0.2, 0.01])}, 0.975).in_s, 1)
    7.0
    >>> opening(ahead, {"steam_most": np.array([0.9, 0.9, 0.8])}, 0.975).blocking
    'steam_most'
    """
    total = np.broadcast_to(risk(chances), ahead_s.shape)
    holds = total <= 1.0 - wanted + 1e-12
    likely_in = _falls_to(ahead_s, total, 0.5)
    if not holds.any():
        nearest = int(np.argmin(total))
        worst = max(
            chances, key=lambda name: float(np.broadcast_to(chances[name], total.shape)[nearest]), default=""
        )
        return Opening(math.nan, likely_in, math.nan, worst, float(total[nearest]))
    first = int(np.argmax(holds))
    after = np.flatnonzero(~holds[first:])
    last = first + int(after[0]) - 1 if len(after) else len(holds) - 1
    return Opening(
        _falls_to(ahead_s, total, 1.0 - wanted), likely_in, float(ahead_s[last]), "", float(total[first])
    )
