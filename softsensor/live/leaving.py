"""Whether the panel may leave the press: cure, steam and core as the filters know them, against the limits.

Cure and steam are read off the same state estimates as the core, hypothesis by hypothesis (`live.mixture`), in
logarithms: that of the equivalent time (`opening.kinetics`) and that of the pressure. To the filters' covariance
and the parameters they only consider come what the model itself adds, the kinetics' own errors, and for steam
those of moisture and isotherm. The chance that something has changed at once counts as a limit broken: after a
change nobody knows what the faces were.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.records import Array
from softsensor.live import mixture_steps as mixtures
from softsensor.live.curing import ResinSetup
from softsensor.live.kalman import KalmanFilter
from softsensor.live.mixture import MARGIN_K, MARGIN_SHARE, Mixture
from softsensor.live.mixture_steps import Change, Components
from softsensor.opening.limits import Normal, PanelState, broken, risk
from softsensor.opening.steam import FIT_PERCENT, steam_with_slopes
from softsensor.signals.unknown import BAND

UNKNOWN = Normal(np.array(math.nan), np.array(math.nan))
CHANGED = "sudden_change"
"""Stands among the limits for what cannot be known."""


@dataclass(frozen=True)
class Leave:
    """Cure and steam at one moment, and how likely each limit is broken if the press opens then."""

    cure_top: float = math.nan
    cure_bottom: float = math.nan
    cure_low: float = math.nan
    """Lower bound of 95 % of the face that may have cured less."""
    steam_kPa: float = math.nan  # noqa: N815
    steam_high_kPa: float = math.nan  # noqa: N815
    """Upper bound of 95 %."""
    panel: PanelState | None = None
    """All that, as means and standard deviations."""
    broken: Mapping[str, float] = field(default_factory=dict)
    """Chance by limit that it is broken; empty where there is none, or nothing is known."""

    def holds(self, wanted: float) -> bool:
        """Return whether every limit holds with a probability; without a limit none does."""
        return float(risk(self.broken)) <= 1.0 - wanted


def leave_of(filters: Sequence[KalmanFilter], mixture: Mixture, resin: ResinSetup) -> Leave:
    """Return what is known of a panel at the moment the filters have come to."""
    panel = known_panel(filters, mixture, resin)
    cure = resin.kinetics.cure
    low = min(float(panel.cure_bottom.low), float(panel.cure_top.low))
    chances = {name: float(chance) for name, chance in broken(resin.limits, resin.kinetics, panel).items()}
    if chances and mixture.changed > 0.0:
        chances[CHANGED] = mixture.changed
    return Leave(
        cure_top=float(cure(np.exp(panel.cure_top.mean))),
        cure_bottom=float(cure(np.exp(panel.cure_bottom.mean))),
        cure_low=float(cure(math.exp(low))),
        steam_kPa=float(np.exp(panel.steam.mean)),
        steam_high_kPa=float(np.exp(panel.steam.high)),
        panel=panel,
        broken=chances,
    )


def known_panel(filters: Sequence[KalmanFilter], mixture: Mixture, resin: ResinSetup) -> PanelState:
    """Return cure at both faces, core and steam as mean and standard deviation."""
    reach = max(mixture.high_C - mixture.core_C, mixture.core_C - mixture.low_C)
    core = Normal(np.array(mixture.core_C), np.array(reach / BAND))
    return PanelState(_cure(filters, 0), _cure(filters, 1), core, _steam(filters[0], resin))


def _cure(filters: Sequence[KalmanFilter], face: int) -> Normal:
    """Return the logarithm of a face's equivalent time; face 0 is the lower. [ln s]"""
    read: list[tuple[float, Array, float]] = []
    for f in filters:
        if f.curing is None:
            return UNKNOWN
        progress = f.curing.progress
        x = max(float(progress.equivalent_s[face]), 1e-12)
        by_parameter, by_error = progress.by_parameter[face] / x, progress.by_error[face] / x
        margin = (MARGIN_K * by_parameter[-2]) ** 2 + (MARGIN_SHARE * by_parameter[-1]) ** 2
        read.append((math.log(x), by_parameter[: len(f.linearised.names)], margin + float(by_error @ by_error)))
    return _pooled(filters, read)


def _steam(one: KalmanFilter, resin: ResinSetup) -> Normal:
    """Return the logarithm of the pressure of steam, as the model in force and its hypotheses see it. [ln kPa]"""
    moisture, sd = resin.moisture
    if not math.isfinite(moisture) or moisture <= 0.0:
        return UNKNOWN
    model = one.linearised.model
    inside = np.flatnonzero(model.stack.wet)
    share = model.stack.dx[inside] / model.stack.dx[inside].sum()
    steam = steam_with_slopes(model.state.t[inside], share, moisture, resin.sorption.factor)
    readout = model.state.s[: len(one.linearised.names), inside] @ steam.by_temperature
    of_water = float(steam.by_moisture) * math.hypot(sd, FIT_PERCENT * resin.sorption.factor)
    of_board = float(steam.by_factor) * resin.sorption.factor_sd / resin.sorption.factor
    whole = float(steam.by_temperature.sum())
    variance = of_water**2 + of_board**2 + (MARGIN_K * whole) ** 2
    return _pooled([one], [(float(np.log(steam.pressure_kPa)), readout, variance)])


def _pooled(filters: Sequence[KalmanFilter], read: Sequence[tuple[float, Array, float]]) -> Normal:
    """Pool what all hypotheses of filters say of one quantity, as `live.mixture.mix` does for the core.

    Parameters
    ----------
    read
        For each filter the quantity where it is linearised, its derivative by the parameters (P), and variance
        from elsewhere.
    """
    log, means, variances = np.empty((3, sum(len(f.names) for f in filters)))
    plain, first = math.nan, 0
    for f, (value, readout, variance) in zip(filters, read, strict=True):
        own = slice(first, first + len(f.names))
        out = Components(log[own], means[own], variances[own])
        level, slopes = np.array([value, 0.0]), np.ascontiguousarray(readout)
        chain = f.linearised.model.chain._replace(level=level, d_level=slopes)
        plain = mixtures.weigh(f.estimate, chain, f.hypotheses, f.fit, plain, out)
        held = mixtures.held(f.estimate, chain, f.hypotheses)
        variances[own] = np.maximum(variances[own] * max(1.0, f.misfit) + held @ held + variance, 1e-12)
        first += len(f.names)
    sure = Change(0.0, math.nan, math.nan, 0.0, 0.0)
    mean, _, low, high = mixtures.pool(Components(log, means, variances), sure)
    return Normal(np.array(mean), np.array(max(high - mean, mean - low) / BAND))
