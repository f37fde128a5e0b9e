"""A law's curve with its band, and the known cause that it is like."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from daq.records import Array
from softsensor.diagnosis.laws.fitting import FittedLaw
from softsensor.diagnosis.numbers import MODEL_ERROR
from softsensor.effects import catalogue
from softsensor.effects.effect import LawOf
from softsensor.effects.free_law import KNOTS
from softsensor.signals.student import student

INSIDE = 0.9
"""Share of the points at which a known cause's curve must lie in the band to be recognised: issue 24's measure."""


def curve_of(law: FittedLaw) -> Array:
    """Return the curve with its 95 % band in the law's unit (points, 4)."""
    return np.stack([law.kind.x, *map(law.kind.quantity, band(law))], axis=1)


def band(law: FittedLaw) -> tuple[Array, Array, Array]:
    """Return the function with its 95 % band: the wider of curvature and scatter from run to run, by point.

    What a smooth law leaves over of a sharp one counts as noise in the curvature. To it comes what every law of
    the diagnosis is off: `MODEL_ERROR`, here as a share of the curve's range.
    """
    fit, kind, at = law.fit, law.kind, law.places
    runs, covariance = len(fit.runs), fit.covariance
    left = sum(r.cost for r in fit.runs) / max(law.readings, 1)
    centred = [g - np.mean(fit.gradients, axis=0) for g in fit.gradients]
    meat = sum((np.outer(g, g) for g in centred), np.zeros_like(covariance)) * runs / max(runs - 1, 1)
    robust = covariance @ meat @ covariance
    middle = kind.weights @ fit.theta[at]
    spreads = [
        np.einsum("ij,jk,ik->i", kind.weights, c[np.ix_(at, at)], kind.weights)
        for c in (max(left, 1.0) * covariance, robust)
    ]
    simple = (MODEL_ERROR * float(np.ptp(middle))) ** 2
    half = two_sided(law) * np.sqrt(np.maximum(*spreads) + simple)
    return middle, middle - half, middle + half


def two_sided(law: FittedLaw) -> float:
    """Return how many standard deviations 95 % lie within, with as many runs."""
    return student(max(len(law.fit.runs) - 1, 1))


def resembles(kind: LawOf, curve: Array) -> str | None:
    """Return the cause of the catalogue whose own curve lies within the band, nearest to the law; None without."""
    x, value, low, high = curve.T
    sd = np.maximum(0.5 * (high - low), 1e-9 * (1.0 + np.abs(value)))
    apart = float(x[-1] - x[0]) / (KNOTS.get(kind, KNOTS[LawOf.CONTACT]) - 1)  # no sharper can the knots show it
    sized = kind in (LawOf.HEAT, LawOf.EXCHANGE, LawOf.SOURCE_BY_DEPTH, LawOf.SOURCE_BY_TIME)

    def holds(shape: Any) -> bool:
        return bool(np.mean((shape >= low) & (shape <= high)) >= INSIDE)

    if not sized and holds(1.0):
        return None  # nearly everywhere no law at all
    nearest, least = None, math.inf
    for effect in catalogue().values():
        for shape in effect.as_law(kind, x, apart) if effect.as_law is not None else ():
            if sized:
                shape = shape * np.sum(shape * value / sd**2) / np.sum(shape * shape / sd**2)
            off = float(np.mean(((shape - value) / sd) ** 2))
            if off < least and holds(shape):
                nearest, least = effect.name, off
    return nearest
