"""The live sensor's Gaussian mixture for the core: what all hypotheses of all filters say, pooled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.records import Array
from softsensor.live.kalman import BetweenFaces, KalmanFilter, log_sum
from softsensor.live.mixture_steps import Change, Components, pool, weigh
from softsensor.signals.doubt import DOUBT_SIZES

MARGIN_K, MARGIN_SHARE = 0.1, 0.003
"""What the model itself adds to the core: absolute (what header and logger round to), and of its rise (mesh,
steps). Start temperature and panel constants are not in it: they are parameters of the filter. [K, -]"""
MISFIT_USUAL, MISFIT_WEIGHT = 2.0, 5.0
"""A misfit beyond the first (78 sound runs at 1 to 10 Hz had less) speaks for a change, so many nats a unit."""
OTHER_PANEL, OTHER_SHARE, OTHER_K = 0.3, 0.15, 1.0
"""After a change: chance that the panel itself changed, and how far the core may then be off, of its rise since
(a core cannot move at once), or where the faces are silent. [-, -, K]"""
LEAST_ODDS = -6.0
"""Logarithm of the odds below which a change is no hypothesis."""
SURE = 0.9
"""Chance beyond which a change counts as one."""
CHANGED = "sudden change"


@dataclass(frozen=True)
class Mixture:
    """Core temperature by hypothesis: the first is "nothing is missing"."""

    names: tuple[str, ...]
    components: Components
    core_C: float  # noqa: N815
    """What all hypotheses expect together, or the faces alone where something has changed at once. [°C]"""
    sd_K: float  # noqa: N815
    """Root mean square distance of the core from what is reported. [K]"""
    low_C: float  # noqa: N815
    high_C: float  # noqa: N815
    """Bounds of 95 %. [°C]"""
    shares: tuple[Array, ...]
    """By filter the shares of its hypotheses, should nothing have changed at once."""
    by_faces: bool = False
    """Whether something has changed at once and the faces as measured tell the core, whatever the contacts do."""

    @cached_property
    def leading(self) -> str:
        """The cause of the most likely hypothesis, whatever the size of what is in doubt; empty for none."""
        chances: dict[str, float] = {}
        for name, weight in zip(self.names, self.components.weight.tolist(), strict=True):
            chances[name] = chances.get(name, 0.0) + weight
        return max(chances, key=chances.__getitem__)

    @property
    def changed(self) -> float:
        """Chance that something changed at once."""
        weights = self.components.weight
        return float(sum(w for name, w in zip(self.names, weights, strict=True) if name == CHANGED))


def model_variance(rise_K: float, start_K: float) -> float:
    """Return what the model itself adds to the core's variance. [K²]

    Parameters
    ----------
    rise_K
        How far the core has come from its start, in which the model's own error is counted.
    start_K
        How far the core's start may be from the faces', where only they tell it.
    """
    return float(MARGIN_K**2 + start_K**2 + (MARGIN_SHARE * rise_K) ** 2)


def mix(filters: Sequence[KalmanFilter], margin: float, between: BetweenFaces | None = None) -> Mixture:
    """Pool what all hypotheses of all filters say about the core; `margin` is the `model_variance`. [K²]"""
    names: list[str] = []
    log, means, variances, doubts = np.empty((4, sum(len(f.names) for f in filters)))
    plain = math.nan
    for f in filters:
        own = slice(len(names), len(names) + len(f.names))
        out = Components(log[own], means[own], variances[own])
        plain = weigh(f.estimate, f.linearised.model.chain, f.hypotheses, f.fit, plain, out)
        squares, loose = f.held_K**2, f.linearised.loose
        variances[own] = (variances[own] + margin) * max(1.0, f.misfit) + squares @ (1.0 - loose)
        doubts[own] = squares @ loose
        names += f.names
    change, by_faces = _change(filters, margin, between)
    components = by_size(Components(log, means, variances), doubts, 2 if change.chance > 0.0 else 0)
    every = tuple([*names * len(DOUBT_SIZES), *[CHANGED] * (2 if change.chance > 0.0 else 0)])
    chances = np.exp(log - log.max())
    shares = np.split(chances / chances.sum(), np.cumsum([len(f.names) for f in filters])[:-1])
    core, sd, low, high = pool(components, change)
    return Mixture(every, components, core, sd, low, high, tuple(shares), by_faces)


def by_size(components: Components, doubts: Array, room: int = 0) -> Components:
    """Return each component once for every size that a doubt may have (`DOUBT_SIZES`).

    Parameters
    ----------
    doubts
        Variance by doubts whose size is known only within a range, at its usual size.
    room
        Components left empty behind them.
    """
    log = [components.weight + math.log(share) for _, share in DOUBT_SIZES]
    variances = [components.variance + size**2 * doubts for size, _ in DOUBT_SIZES]
    empty = np.zeros(room)
    return Components(
        np.concatenate([*log, empty]),
        np.concatenate([*[components.mean] * len(log), empty]),
        np.concatenate([*variances, empty]),
    )


def _change(filters: Sequence[KalmanFilter], margin: float, between: BetweenFaces | None) -> tuple[Change, bool]:
    """Return that something may have changed at once, and whether the faces alone then tell the core."""
    worst = min(f.worst for f in filters)
    odds = log_sum(filters[0].changed, MISFIT_WEIGHT * (worst - MISFIT_USUAL))
    if odds <= LEAST_ODDS:
        return Change(0.0, math.nan, math.nan, OTHER_PANEL, OTHER_K), False
    chance = 1.0 / (1.0 + math.exp(-odds))
    if between is None or not between.knows:
        return Change(chance, math.nan, math.nan, OTHER_PANEL, OTHER_K), False
    core, variance = between.core
    off = OTHER_SHARE * abs(core - between.before_C)
    return Change(chance, core, variance + margin, OTHER_PANEL, off), chance > SURE
