"""Steam in the panel: partial pressure of water vapour from temperatures, moisture and a sorption isotherm.

The wood of every layer is in equilibrium with the vapour in its pores, the vapour has one pressure throughout,
and no water leaves (`steam_pressure`): hot faces dry, the cool core takes up what they give, as steam does in a
hot press. What a model of one dimension without gas flow cannot know:

- how fast vapour moves inwards. Before it has, the faces hold more than this and the core less.
- what escapes at the rim and, at the faces, before the paper seals them: it lowers the pressure.
- air that is shut in with it, and how the board's own isotherm differs from solid wood's (`[sorption] factor`).

So for a sealed panel it is the pressure that its water can sustain, an estimate and no measurement; a panel that
leaks has less.

Sources: saturation, IAPWS-IF97 region 4 (0.01 to 374 °C; W. Wagner et al., J. Eng. Gas Turbines Power 122 (2000)
150, eq. 30). Sorption: A. J. Hailwood, S. Horrobin (1946) with W. T. Simpson's coefficients, Wood Handbook
FPL-GTR-282, ch. 4, eqs. 4-4 and 4-5, fitted to its table 4-2 (-1 to 130 °C, 5 to 95 % humidity) within 0.9 %
of moisture, 0.13 % on average (W. T. Simpson, Forest Prod. J. 21(5) (1971) 48, abstract).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from daq.press.resin_file import SorptionTable
from daq.records import COLDEST_C, Array
from softsensor.signals.doubt import Doubt, Origin

MOISTURE = "panel.moisture_percent"
"""The header's key that steam follows."""

HOTTEST_SORPTION_C = 120.0
"""Above, the isotherm is that of 120 °C at the same humidity: K₁ of the fit reaches zero at 129 °C, near the end
of the table it was fitted to. [°C]"""
FIT_PERCENT = 0.5
"""Of moisture: what the fit differs from its table, and species from one another, one standard deviation between
Simpson's mean (0.13) and worst (0.9) deviation. [%]"""
_TRIPLE_C, _CRITICAL_C = 0.01, 373.9
"""From water's triple point to just below its critical one the saturation pressure holds. (IAPWS-IF97) [°C]"""
# Of the sorption isotherm, by powers of the temperature in °C. (W. T. Simpson, Wood Handbook)
_WEIGHT, _K = (349.0, 1.29, 0.0135), (0.805, 0.000736, -0.00000273)
_K1, _K2 = (6.27, -0.00938, -0.000303), (1.91, 0.0407, -0.000293)
"""The same of its two constants of equilibrium. (W. T. Simpson, Wood Handbook)"""
_STEPS = 40
"""Halvings of the search in ln p, over some 25: to 2e-11."""
_NUDGE_K, _NUDGE = 0.05, 1e-4
"""For slopes of the isotherm. [K, -]"""
_N = (
    0.11670521452767e4, -0.72421316703206e6, -0.17073846940092e2, 0.12020824702470e5, -0.32325550322333e7,
    0.14915108613530e2, -0.48232657361591e4, 0.40511340542057e6, -0.23855557567849e0, 0.65017534844798e3,
)  # fmt: skip
"""Coefficients of the saturation equation. (IAPWS-IF97, region 4, table 34)"""


def saturation_kPa(temperature_C: Array | float) -> Array:  # noqa: N802
    """Return the saturation pressure of water, held at the triple point and just below the critical one. [kPa]

    Examples
    --------
    >>> float(saturation_kPa(500.0 - 273.15).round(5))  # the standard's own check: 2.63889776 MPa
    2638.89776
    """
    T = np.clip(np.asarray(temperature_C, dtype=float), _TRIPLE_C, _CRITICAL_C) - COLDEST_C
    v = T + _N[8] / (T - _N[9])
    a = v**2 + _N[0] * v + _N[1]
    b = _N[2] * v**2 + _N[3] * v + _N[4]
    c = _N[5] * v**2 + _N[6] * v + _N[7]
    return np.asarray(1e3 * (2.0 * c / (-b + np.sqrt(b**2 - 4.0 * a * c))) ** 4)  # IAPWS-IF97


def equilibrium_moisture(humidity: Array | float, temperature_C: Array | float) -> Array:
    """Return the moisture wood holds in air of a relative humidity from 0 to 1. [% of dry mass]

    Examples
    --------
    >>> float(equilibrium_moisture(0.65, 20.0).round(1))  # Wood Handbook, table 4-2, 21 °C: 12.0
    12.0
    """
    t = np.clip(np.asarray(temperature_C, dtype=float), 0.0, HOTTEST_SORPTION_C)
    weight, K, K1, K2 = (a + b * t + c * t**2 for a, b, c in (_WEIGHT, _K, _K1, _K2))
    Kh = K * np.clip(humidity, 0.0, 1.0)
    hydrates = (K1 * Kh + 2.0 * K1 * K2 * Kh**2) / (1.0 + K1 * Kh + K1 * K2 * Kh**2)
    return np.asarray(1800.0 / weight * (Kh / (1.0 - Kh) + hydrates))  # Wood Handbook


def stated_moisture(doubts: Mapping[str, Doubt]) -> Doubt | None:
    """Return the panel's moisture out of a run's constants; None where nobody stated it, or that there is none."""
    doubt = doubts.get(MOISTURE)
    known = doubt is not None and doubt.source in (Origin.STATED, Origin.MEASURED) and doubt.value > 0.0
    return doubt if known else None


def isotherm_sd(sorption: SorptionTable, moisture_percent: float) -> float:
    """Return the deviation of what a board holds at a humidity: how boards differ, and the fit. [ln %]

    Examples
    --------
    Of 8 % the fit's half a percent is a sixteenth, beside 15 % of boards:

    >>> round(isotherm_sd(SorptionTable(factor=1.0, factor_sd=0.15), 8.0), 4)
    0.1625
    """
    fit = FIT_PERCENT * sorption.factor / moisture_percent
    return math.hypot(sorption.factor_sd / sorption.factor, fit)


class Steam(NamedTuple):
    """Steam in panels (...), and how the logarithm of its pressure depends on what is uncertain."""

    pressure_kPa: Array  # noqa: N815
    """(...)"""
    by_temperature: Array
    """d ln p / dT of each layer (..., n). [1/K]"""
    by_moisture: Array
    """d ln p / d moisture (...). [1/%]"""
    by_factor: Array
    """d ln p / d ln factor (...)."""


def steam_pressure(
    temperature_C: Array,
    share: Array,
    moisture_percent: Array | float,
    factor: Array | float = 1.0,
) -> Array:
    """Return the partial pressure of steam in sealed panels (...). [kPa]

    Parameters
    ----------
    temperature_C
        Of the layers (..., n). [°C]
    share
        Share of each layer in the panel's dry mass (n).
    moisture_percent
        Of the whole panel, of its dry mass (...). [%]
    factor
        The board's equilibrium moisture over solid wood's (...). [-]

    Returns
    -------
    At least that of a trace of water; at most the saturation pressure of the hottest layer, where the panel holds
    more water than its wood takes up. Not a number where moisture or a temperature is.

    Examples
    --------
    A panel of one temperature has that temperature's isotherm: at 20 °C and 12 % humidity is 65 %.

    >>> layers = np.full(4, 0.25)
    >>> float((steam_pressure(np.full(4, 20.0), layers, 12.0) / saturation_kPa(20.0)).round(2))
    0.65
    """
    full = saturation_kPa(temperature_C)
    wanted = np.asarray(moisture_percent, dtype=float) / np.asarray(factor, dtype=float)
    wanted = np.broadcast_to(wanted, full.shape[:-1])
    low, high = np.log(1e-9 * full.min(axis=-1)), np.log(full.max(axis=-1))
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        held = _held(middle, temperature_C, full, share)
        low, high = np.where(held < wanted, middle, low), np.where(held < wanted, high, middle)
    known = np.isfinite(wanted) & np.isfinite(temperature_C).all(axis=-1)
    return np.asarray(np.where(known, np.exp(0.5 * (low + high)), np.nan))


def steam_with_slopes(
    temperature_C: Array,
    share: Array,
    moisture_percent: float,
    factor: float = 1.0,
) -> Steam:
    """Return steam as `steam_pressure`, with its derivatives by what is uncertain (implicit differentiation).

    All in the units of `Steam`.
    """
    pressure = steam_pressure(temperature_C, share, moisture_percent, factor)
    log_p, full = np.log(pressure), saturation_kPa(temperature_C)
    by_log_p = (
        _held(log_p + _NUDGE, temperature_C, full, share) - _held(log_p - _NUDGE, temperature_C, full, share)
    ) / (2.0 * _NUDGE)
    by_log_p = np.maximum(by_log_p, 1e-9)
    above, below = (
        equilibrium_moisture(pressure[..., None] / saturation_kPa(t), t)
        for t in (temperature_C + _NUDGE_K, temperature_C - _NUDGE_K)
    )
    by_T = share * (above - below) / (2.0 * _NUDGE_K)
    held = moisture_percent / factor
    by_moisture = 1.0 / (factor * by_log_p)
    return Steam(pressure, -by_T / by_log_p[..., None], by_moisture, -held / by_log_p)


def _held(log_p: Array, temperature_C: Array, full: Array, share: Array) -> Array:
    """Return the moisture wood holds at a pressure, over all layers (...). [%]"""
    humidity = np.exp(log_p)[..., None] / full
    return np.asarray((share * equilibrium_moisture(humidity, temperature_C)).sum(axis=-1))
