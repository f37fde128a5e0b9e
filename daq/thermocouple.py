"""Type K thermocouples by ITS-90: voltage of a temperature, temperature of a voltage.

Coefficients: NIST Monograph 175 (1993), reference junction at 0 °C, -270 to 1372 °C. The inverse
is a bracketed root of the forward function, not NIST's inverse polynomials, which err by up to
0.05 K.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from daq.records import COLDEST_C, Array

Number = TypeVar("Number", float, Array)

LOWEST_C, HIGHEST_C = -270.0, 1372.0
"""Where NIST's functions hold. [°C]"""

_F_PER_K, _ICE_F = 1.8, 32.0
"""Degrees Fahrenheit in a kelvin and at the ice point, by definition."""

# Of powers of the temperature, from the zeroth on. (NIST Monograph 175) [mV/K^i]
_BELOW_ZERO = (
    0.0,
    0.394501280250e-1,
    0.236223735980e-4,
    -0.328589067840e-6,
    -0.499048287770e-8,
    -0.675090591730e-10,
    -0.574103274280e-12,
    -0.310888728940e-14,
    -0.104516093650e-16,
    -0.198892668780e-19,
    -0.163226974860e-22,
)
# The same above. (NIST Monograph 175)
_ABOVE_ZERO = (
    -0.176004136860e-1,
    0.389212049750e-1,
    0.185587700320e-4,
    -0.994575928740e-7,
    0.318409457190e-9,
    -0.560728448890e-12,
    0.560750590590e-15,
    -0.320207200030e-18,
    0.971511471520e-22,
    -0.121047212750e-25,
)
_BUMP = (0.1185976, -0.1183432e-3, 126.9686)
"""NIST's exponential above 0 °C: height, slope, centre. [mV, 1/K², °C]"""
_TOLERANCE_K = 1e-5
"""Of the inverse: far below any logger's step. [K]"""


def voltage(temperature: ArrayLike) -> Array:
    """Return the type K voltage against a junction at 0 °C; NaN outside -270 to 1372 °C. [mV]

    Parameters
    ----------
    temperature
        Of the measuring junction, any shape. [°C]

    Examples
    --------
    >>> voltage([25.0, 100.0, 500.0]).round(3).tolist()
    [1.0, 4.096, 20.644]
    """
    t = np.asarray(temperature, dtype=float)
    height, slope, centre = _BUMP
    inside = (t >= LOWEST_C) & (t <= HIGHEST_C)
    safe = np.where(inside, t, 0.0)
    above = polyval(safe, _ABOVE_ZERO) + height * np.exp(slope * (safe - centre) ** 2)
    return np.where(inside, np.where(safe < 0, polyval(safe, _BELOW_ZERO), above), np.nan)


_GRID_C = np.linspace(LOWEST_C, HIGHEST_C, 1643)
_GRID_MV = voltage(_GRID_C)


def temperature(voltage_mV: ArrayLike) -> Array:  # noqa: N803
    """Return the type K temperature of a voltage against 0 °C; NaN outside the range. [°C]

    Bisects inside a one-kelvin bracket, so it cannot leave it; exact to 0.01 mK.

    Parameters
    ----------
    voltage_mV
        Any shape. [mV]

    Examples
    --------
    >>> temperature([4.0962, 8.1385]).round(2).tolist()
    [100.0, 200.0]
    """
    emf = np.asarray(voltage_mV, dtype=float)
    inside = (emf >= _GRID_MV[0]) & (emf <= _GRID_MV[-1])
    safe = np.where(inside, emf, 0.0)
    right = np.clip(np.searchsorted(_GRID_MV, safe), 1, len(_GRID_C) - 1)
    low, high = _GRID_C[right - 1], _GRID_C[right]
    for _ in range(int(np.ceil(np.log2(1.0 / _TOLERANCE_K)))):
        middle = 0.5 * (low + high)
        too_low = voltage(middle) < safe
        low, high = np.where(too_low, middle, low), np.where(too_low, high, middle)
    return np.where(inside, 0.5 * (low + high), np.nan)


def compensated(voltage_mV: ArrayLike, cold_junction: ArrayLike) -> Array:  # noqa: N803
    """Return the temperature of a junction measured against terminals that are not at 0 °C. [°C]

    Adds the voltage of the terminals; adding temperatures instead errs by some tenths of a kelvin at 200 °C.

    Parameters
    ----------
    voltage_mV
        Measured at the terminals. [mV]
    cold_junction
        Temperature of the terminals. [°C]

    Examples
    --------
    >>> float(compensated(4.0962 - 1.0000, 25.0).round(1))
    100.0
    """
    return temperature(np.asarray(voltage_mV, dtype=float) + voltage(cold_junction))


def implied_cold_junction(voltage_mV: ArrayLike, temperature_C: ArrayLike) -> Array:  # noqa: N803
    """Return the terminal temperature that turns a bare voltage into a reported temperature. [°C]

    Parameters
    ----------
    voltage_mV
        Measured at the terminals. [mV]
    temperature_C
        What the device made of it. [°C]

    Examples
    --------
    >>> float(implied_cold_junction(3.0962, 100.0).round(1))
    25.0
    """
    return temperature(voltage(temperature_C) - np.asarray(voltage_mV, dtype=float))


def celsius_of(value: Number, unit: str) -> Number:
    """Return a temperature in ``K`` or ``F`` as degrees Celsius; a number in any other unit as it is.

    Examples
    --------
    >>> celsius_of(0.0, "K"), celsius_of(32.0, "F"), celsius_of(21.5, "C")
    (-273.15, 0.0, 21.5)
    """
    if unit == "K":
        return value + COLDEST_C
    return (value - _ICE_F) / _F_PER_K if unit == "F" else value
