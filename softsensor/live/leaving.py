"""Whether the panel may leave the press: cure, steam and core as the filters know them, against the limits.

Cure and steam are read off the same state estimates as the core, hypothesis by hypothesis (`live.mixture`), in
logarithms: that of the equivalent time (`opening.kinetics`) and that of the pressure. To the filters' covariance
and the parameters they only consider come what the model itself adds, the kinetics' own errors, and for steam
those of moisture and isotherm. The chance that something has changed at once counts as a limit broken: after a
change nobody knows what the faces were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.live import mixture_steps as mixtures
from softsensor.live.curing import ResinSetup
from softsensor.live.kalman import KalmanFilter
from softsensor.live.mixture import MARGIN_K, MARGIN_SHARE, Mixture
from softsensor.live.mixture_steps import Change, Components
from softsensor.opening.limits import Broken, Normal, PanelState, broken
from softsensor.opening.steam import isotherm_sd, steam_with_slopes
from softsensor.signals.unknown import BAND

UNKNOWN = Normal(np.array(math.nan), np.array(math.nan))
NOTHING_KNOWN = Broken({})
CHANGED = "sudden_change"
"""Stands among the limits for what cannot be known."""


@dataclass(frozen=True)
class Leave:
    r"""Cure and steam at one moment, and how likely each limit is broken if the press opens then.

    Cure is that after an equivalent time x at the resin file's reference temperature T₀, on its law's isotherm:

    $$\alpha = \alpha_0(x), \quad
    \frac{dx}{dt} = \sum_j w_j(x) e^{-\frac{E_j(x)}{R} \left(\frac{1}{T} - \frac{1}{T_0}\right)}$$

    Steam is the pressure p at which all layers' wood, s its shares of the dry mass, holds the panel's water:

    $$\sum_i s_i m\left(\frac{p}{p_s(T_i)}, T_i\right) = \frac{\mathrm{moisture}}{\mathrm{factor}}$$

    with m the moisture of wood at a humidity (Hailwood and Horrobin; Simpson's coefficients) and p_s the
    saturation pressure (IAPWS-IF97). The guide's page of symbols has the whole of it.
    """

    cure_top: float = math.nan
    """Degree of cure of the upper face, from 0 to 1."""
    cure_bottom: float = math.nan
    """Degree of cure of the lower face, from 0 to 1."""
    cure_low: float = math.nan
    """Lower bound of 95 % of the face that may have cured less."""
    grade: str = ""
    """What a face is that has cured so far (`GradesTable`); empty where the resin file has no thresholds."""
    steam_kPa: float = math.nan  # noqa: N815
    """Partial pressure of steam in the panel. [kPa]"""
    steam_high_kPa: float = math.nan  # noqa: N815
    """Upper bound of 95 %."""
    panel: PanelState | None = None
    """All that, as means and standard deviations."""
    broken: Broken = NOTHING_KNOWN
    """How likely each limit is broken; no limit where nothing is known."""

    __repr__ = on_screen

    def holds(self, wanted: float) -> bool:
        """Return whether every limit holds with a probability; without a limit none does."""
        return float(self.broken.risk) <= 1.0 - wanted


@dataclass(frozen=True)
class KnownPanel:
    """A panel at the moment the filters have come to, and how it goes on."""

    panel: PanelState
    pace: Array
    """By which the logarithms of the lower and the upper face's equivalent time grow (2). [1/s]"""
    changed: float
    """Chance that something has changed at once."""

    def after(self, seconds: float, warmer_K: float) -> PanelState:
        """Return the panel some moments on, its faces as warm as they are; the core has warmed by so much."""
        bottom, top = (
            Normal(now.mean + math.log1p(pace * seconds), now.sd)
            for now, pace in zip((self.panel.cure_bottom, self.panel.cure_top), self.pace.tolist(), strict=True)
        )
        core = replace(self.panel.core, mean=self.panel.core.mean + warmer_K)
        return replace(self.panel, cure_bottom=bottom, cure_top=top, core=core)

    def leave(self, resin: ResinSetup, seconds: float = 0.0, warmer_K: float = 0.0) -> Leave:
        """Return what that means for the limits, `seconds` on."""
        panel, cure = self.after(seconds, warmer_K), resin.kinetics.cure
        low = min(float(panel.cure_bottom.low), float(panel.cure_top.low))
        sure = float(cure(math.exp(low)))
        found = broken(resin.limits, resin.kinetics, panel)
        if found.chances and self.changed > 0.0:
            found = replace(found, chances={**found.chances, CHANGED: np.asarray(self.changed)})
        return Leave(
            cure_top=float(cure(np.exp(panel.cure_top.mean))),
            cure_bottom=float(cure(np.exp(panel.cure_bottom.mean))),
            cure_low=sure,
            grade=resin.grades.grade(sure) if sure == sure else "",
            steam_kPa=float(np.exp(panel.steam.mean)),
            steam_high_kPa=float(np.exp(panel.steam.high)),
            panel=panel,
            broken=found,
        )


def known_panel(filters: Sequence[KalmanFilter], mixture: Mixture, resin: ResinSetup) -> KnownPanel:
    """Return what is known of a panel at the moment the filters have come to."""
    first = filters[0].curing
    pace = np.zeros(2)
    if first is not None:
        x = np.maximum(first.progress.equivalent_s, 1e-12)
        pace = resin.kinetics.pace(x, first.face_C) / x
    return KnownPanel(_state(filters, mixture, resin), pace, mixture.changed)


def _first_of_each(filters: Sequence[KalmanFilter]) -> list[KalmanFilter]:
    """Return of each panel that may lie in the press the filter whose cause is none."""
    return [
        f
        for before, f in zip((None, *filters), filters, strict=False)
        if before is None or before.panel != f.panel
    ]


def _state(filters: Sequence[KalmanFilter], mixture: Mixture, resin: ResinSetup) -> PanelState:
    """Return cure at both faces, core and steam as mean and standard deviation."""
    reach = max(mixture.high_C - mixture.core_C, mixture.core_C - mixture.low_C)
    core = Normal(np.array(mixture.core_C), np.array(reach / BAND))
    bottom, top, apart = _cure(filters)
    both = bottom.sd**2 + top.sd**2 - apart.sd**2
    with np.errstate(invalid="ignore"):
        together = np.clip(both / (2.0 * bottom.sd * top.sd), -1.0, 1.0)
    return PanelState(bottom, top, core, _steam(_first_of_each(filters), resin), np.nan_to_num(together))


def _cure(filters: Sequence[KalmanFilter]) -> tuple[Normal, Normal, Normal]:
    """Return the logarithms of the lower and the upper face's equivalent time, and how far they are apart."""
    read: list[list[tuple[float, Array, float]]] = [[], [], []]
    for f in filters:
        if f.curing is None:
            return UNKNOWN, UNKNOWN, UNKNOWN
        progress = f.curing.progress
        x = np.maximum(progress.equivalent_s, 1e-12)
        log, by_parameter, by_error = np.log(x), progress.by_parameter / x[:, None], progress.by_error / x[:, None]
        margin = (MARGIN_K * by_parameter[:, -2]) ** 2 + (MARGIN_SHARE * by_parameter[:, -1]) ** 2
        readout = by_parameter[:, : len(f.linearised.names)]
        apart = by_error[1] - by_error[0]  # the paper is the same, the model's own errors are not
        for face in (0, 1):
            own = float(margin[face] + by_error[face] @ by_error[face])
            read[face].append((float(log[face]), readout[face], own))
        read[2].append((float(log[1] - log[0]), readout[1] - readout[0], float(margin.sum() + apart @ apart)))
    bottom, top, between = (_pooled(filters, one) for one in read)
    return bottom, top, between


def _steam(filters: Sequence[KalmanFilter], resin: ResinSetup) -> Normal:
    """Return the logarithm of the pressure of steam, as the model in force and its hypotheses see it. [ln kPa]"""
    if not math.isfinite(resin.moisture[0]):
        return UNKNOWN
    return _pooled(filters, [_steam_of(one, resin) for one in filters])


def _steam_of(one: KalmanFilter, resin: ResinSetup) -> tuple[float, Array, float]:
    """Return the same of one filter as `_pooled` takes it."""
    moisture, sd = resin.moisture
    model = one.linearised.model
    inside = np.flatnonzero(model.stack.wet)
    share = model.stack.dx[inside] / model.stack.dx[inside].sum()
    steam = steam_with_slopes(model.state.t[inside], share, moisture, resin.sorption.factor)
    readout = model.state.s[: len(one.linearised.names), inside] @ steam.by_temperature
    of_water = float(steam.by_moisture) * sd
    of_board = float(steam.by_factor) * isotherm_sd(resin.sorption, moisture)
    whole = float(steam.by_temperature.sum())
    variance = of_water**2 + of_board**2 + (MARGIN_K * whole) ** 2
    return float(np.log(steam.pressure_kPa)), readout, variance


def _pooled(filters: Sequence[KalmanFilter], read: Sequence[tuple[float, Array, float]]) -> Normal:
    """Pool what all hypotheses of filters say of one quantity, as `live.mixture.mix` does for the core.

    Parameters
    ----------
    read
        For each filter the quantity where it is linearised, its derivative by the parameters (P), and variance
        from elsewhere.
    """
    log, means, variances = np.empty((3, sum(len(f.names) for f in filters)))
    plain, first, panel = math.nan, 0, 0
    for f, (value, readout, variance) in zip(filters, read, strict=True):
        own = slice(first, first + len(f.names))
        out = Components(log[own], means[own], variances[own])
        level, slopes = np.array([value, 0.0]), np.ascontiguousarray(readout)
        chain = f.linearised.model.chain._replace(level=level, d_level=slopes)
        plain = plain if f.panel == panel else math.nan
        plain, held = mixtures.weigh(f.estimate, chain, f.hypotheses, f.fit, plain, out)
        panel = f.panel
        variances[own] = np.maximum(variances[own] * f.excess + held @ held + variance, 1e-12)
        first += len(f.names)
    sure = Change(0.0, math.nan, math.nan, 0.0, 0.0)
    mean, _, low, high = mixtures.pool(Components(log, means, variances), sure)
    return Normal(np.array(mean), np.array(max(high - mean, mean - low) / BAND))
