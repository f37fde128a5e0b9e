"""The live sensor's Gaussian mixture for the core: what all hypotheses of all filters say, pooled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, groupby

import numpy as np

from daq.records import Array
from softsensor.live.kalman import BetweenFaces, KalmanFilter, log_sum
from softsensor.live.mixture_steps import Change, Components, pool, quantile, weigh
from softsensor.signals.doubt import DOUBT_SIZES
from softsensor.signals.instrument import LOGGER_STEP_K
from softsensor.signals.unknown import CENTRAL

MARGIN_K, MARGIN_SHARE = LOGGER_STEP_K, 0.003
"""What the model itself adds to the core: absolute (what header and logger round to), and of its rise (mesh,
steps). Start temperature and panel constants are not in it: they are parameters of the filter. [K, -] By hand."""
MISFIT_USUAL, MISFIT_WEIGHT = 2.0, 5.0
"""A misfit beyond the first (78 sound runs at 1 to 10 Hz had less) speaks for a change, so many nats a unit.

By hand; half as large again or a third smaller they move the live core of sample run 7 by 0.04 and 0.02 of its
standard deviations, its band by 19 and 8 % (`tests.calibration.set_by_hand live`, seed 2026, 2026-11-29)."""
OTHER_PANEL, OTHER_SHARE, OTHER_K = 0.3, 0.15, 1.0
"""After a change: chance that the panel itself changed, and how far the core may then be off, of its rise since
(a core cannot move at once), or where the faces are silent. [-, -, K] By hand."""
LEAST_ODDS = -6.0
"""Logarithm of the odds below which a change is no hypothesis. By hand; by the same measure: 0.004, and
a band of 2 %."""
SURE = 0.9
"""Chance beyond which a change counts as one. By hand."""
CHANGED, ANOTHER_PANEL = "sudden change", "another panel"


@dataclass(frozen=True)
class PanelCore:
    """What the hypotheses about one likely panel say of the core."""

    chance: float
    """That it is this panel, by all that was read."""
    names: tuple[str, ...]
    components: Components
    core_C: float  # noqa: N815
    sd_K: float  # noqa: N815
    low_C: float  # noqa: N815
    high_C: float  # noqa: N815
    by_faces: bool
    """As in `Mixture`, of this panel."""


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
    """Whether something has changed at once and the faces as measured give the core, whatever the contacts do."""
    panels: tuple[PanelCore, ...] = ()
    """By panel that may lie in the press, the header's first (`live.panels`)."""

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
        How far the core's start may be from the faces', where only they show it.
    """
    return float(MARGIN_K**2 + start_K**2 + (MARGIN_SHARE * rise_K) ** 2)


def mix(filters: Sequence[KalmanFilter], margin: float, between: Sequence[BetweenFaces | None] = ()) -> Mixture:
    """Pool what all hypotheses of all filters say about the core.

    Parameters
    ----------
    filters
        Of one likely panel after the other, the header's first.
    margin
        The `model_variance`. [K²]
    between
        Of each panel what it is alone between its faces; none: changes at once are left out.
    """
    ends = list(accumulate(len(f.names) for f in filters))
    parts = [slice(end - len(f.names), end) for f, end in zip(filters, ends, strict=True)]
    log, means, variances, doubts = np.empty((4, ends[-1]))
    plain, panel = math.nan, 0
    for f, own in zip(filters, parts, strict=True):
        out = Components(log[own], means[own], variances[own])
        plain = plain if f.panel == panel else math.nan  # another panel is no doubt about a cause's law
        plain, held_K = weigh(f.estimate, f.linearised.model.chain, f.hypotheses, f.fit, plain, out)
        squares, loose, panel = held_K**2, f.linearised.loose, f.panel
        variances[own] = (variances[own] + margin) * f.excess + squares @ (1.0 - loose)
        doubts[own] = squares @ loose
    chances = np.exp(log - log.max())
    chances /= chances.sum()
    shares = [chances[own] for own in parts]
    cores, begin = [], 0
    for panel, group in groupby(zip(filters, shares, strict=True), key=lambda pair: pair[0].panel):
        ours, likely = zip(*group, strict=True)
        own = slice(begin, begin + sum(len(f.names) for f in ours))
        change = _change(ours, margin, between[panel] if between else None)
        weighed = Components(log[own], means[own], variances[own]), doubts[own]
        cores.append(_core(ours, float(sum(share.sum() for share in likely)), weighed, change))
        begin = own.stop
    return _together(cores, tuple(shares))


def _core(
    filters: Sequence[KalmanFilter], chance: float, weighed: tuple[Components, Array], change: tuple[Change, bool]
) -> PanelCore:
    """Pool the hypotheses about one panel; `weighed` is theirs, with the variance by doubts of any size."""
    changed, by_faces = change
    room = 2 if changed.chance > 0.0 else 0
    components = by_size(*weighed, room)
    names = [name if f.panel == 0 else ANOTHER_PANEL for f in filters for name in f.names]
    core, sd, low, high = pool(components, changed)
    every = (*names * len(DOUBT_SIZES), *[CHANGED] * room)
    return PanelCore(chance, every, components, core, sd, low, high, by_faces)


def _together(panels: Sequence[PanelCore], shares: tuple[Array, ...]) -> Mixture:
    """Return what all likely panels say together."""
    names = tuple(name for panel in panels for name in panel.names)
    if len(panels) == 1:
        (only,) = panels
        estimate = only.core_C, only.sd_K, only.low_C, only.high_C
        return Mixture(names, only.components, *estimate, shares, only.by_faces, (only,))
    weight = np.concatenate([panel.chance * panel.components.weight for panel in panels])
    mean = np.concatenate([panel.components.mean for panel in panels])
    variance = np.concatenate([panel.components.variance for panel in panels])
    core = float(weight @ mean)
    sd = math.sqrt(float(weight @ (variance + (mean - core) ** 2)))
    low, high = (float(quantile(weight, mean, np.sqrt(variance), share)) for share in CENTRAL)
    by_faces = all(panel.by_faces for panel in panels)
    every = Components(weight, mean, variance)
    return Mixture(names, every, core, sd, min(low, core), max(high, core), shares, by_faces, tuple(panels))


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
    """Return that something may have changed at once, and whether the faces alone then give the core."""
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
