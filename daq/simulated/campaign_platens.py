"""Platens as a real controller holds them: set point missed, slow drift, ripple, a dip when the press loads."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from daq.records import Array
from daq.simulated.physics_pressing import Platen

KNOT_S = 0.5
"""Between the points of a platen's course, joined by straight lines: a platen's tons move more slowly. [s]"""


@dataclass(frozen=True)
class Controller:
    """How well one press holds its platens; the same for all its pressings."""

    ripple_K: float
    ripple_period_s: float
    drift_K: float
    dip_K: float
    dip_rise_s: float
    dip_recovery_s: float
    miss_K: tuple[float, float]
    """Lower and upper platen, mean minus set point."""


def draw_controller(rng: np.random.Generator) -> Controller:
    """Return a press's controller within what short-cycle presses show."""
    return Controller(
        ripple_K=float(rng.uniform(0.2, 0.8)),
        ripple_period_s=float(rng.uniform(15.0, 40.0)),
        drift_K=float(rng.uniform(0.2, 0.6)),
        dip_K=float(rng.uniform(1.5, 5.0)),
        dip_rise_s=float(rng.uniform(4.0, 9.0)),
        dip_recovery_s=float(rng.uniform(30.0, 70.0)),
        miss_K=(float(rng.normal(0.0, 0.8)), float(rng.normal(0.5, 0.8))),
    )


def coloured(rng: np.random.Generator, n: int, step_s: float, time_constant_s: float, sd: float) -> Array:
    """Return stationary first-order noise: standard deviation `sd`, correlation exp(-t / time constant)."""
    a = float(np.exp(-step_s / time_constant_s))
    white = rng.standard_normal(n) * sd * np.sqrt(1.0 - a * a)
    white[0] = rng.standard_normal() * sd
    return first_order(white, a)


def first_order(driven: Array, keep: float) -> Array:
    """Return y with y[n] = driven[n] + keep y[n - 1]."""
    return np.fromiter(accumulate(driven.tolist(), lambda before, new: new + keep * before), float, len(driven))


def draw_platens(
    controller: Controller,
    setpoint: float,
    span: tuple[float, float],
    loads: tuple[tuple[float, float], ...],
    rng: np.random.Generator,
) -> tuple[Platen, Platen]:
    """Return lower and upper platen over a span of time.

    `loads` are pairs of closing and opening times; each draws a dip. [s]
    """
    start, end = span
    n = int(np.ceil((end - start) / KNOT_S)) + 3
    t = start + KNOT_S * np.arange(n, dtype=np.float64)
    platens = []
    for miss in controller.miss_K:
        drift = coloured(rng, n // 20 + 2, 20 * KNOT_S, 90.0, controller.drift_K)
        smooth = np.interp(t, start + 20 * KNOT_S * np.arange(len(drift)), drift)
        phase = 2 * np.pi * (t / (controller.ripple_period_s * rng.uniform(0.93, 1.07)) + rng.random())
        ripple = controller.ripple_K * (np.sin(phase) + 0.25 * np.sin(2 * phase + 1.0))
        values = setpoint + miss + smooth + ripple
        for closed, opened in loads:
            values = values - _dip(controller, t, closed, opened) * rng.uniform(0.8, 1.2)
        platens.append(Platen(start, KNOT_S, _smoothed(values)))
    return platens[0], platens[1]


def _dip(controller: Controller, t: Array, closed: float, opened: float) -> Array:
    """Return the dip: it grows while the cold panel draws heat, then the controller makes up for it."""
    since = np.clip(t - closed, 0.0, None)
    dip = (1.0 - np.exp(-since / controller.dip_rise_s)) * np.exp(-since / controller.dip_recovery_s)
    over = 0.3 * (1.0 - np.exp(-np.clip(t - opened, 0.0, None) / 10.0))
    return np.asarray(controller.dip_K * (dip - over * np.exp(-np.clip(t - opened, 0.0, None) / 40.0)))


def _smoothed(values: Array) -> Array:
    kernel = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0
    padded = np.concatenate((np.full(2, values[0]), values, np.full(2, values[-1])))
    return np.asarray(np.convolve(padded, kernel, mode="valid"))
