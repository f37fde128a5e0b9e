"""How far the paper on a virtual panel has really cured: by the virtual press' own equations, on its own steps.

The reaction is dα/dt = (k + a k α) (1 - α)^n with k = rate · exp(-E/R (1/T - 1/T₀)), integrated by the classic
Runge-Kutta rule at the temperature of the panel's outermost nodes. Its heat is not in it; `resin_cure` has that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daq.records import GAS_CONSTANT, Array
from daq.simulated.physics import SolvedPressing
from daq.simulated.physics_kernel import ZERO_C

STEP_S = 0.02
"""The faces change by less than 2 K in it at closing. [s]"""


@dataclass(frozen=True)
class Paper:
    """How an impregnated paper cures."""

    rate: float = 0.05
    """At the reference temperature. [1/s]"""
    activation: float = 85e3
    """[J/mol]"""
    reference_C: float = 140.0
    order: float = 1.0
    autocatalysis: float = 0.0
    """Rate of the second, autocatalysed reaction over the first's."""


def draw_paper(
    rng: np.random.Generator, rate_sd: float, activation_sd: float, nominal: Paper | None = None
) -> Paper:
    """Return a paper that differs from the nominal one by relative standard deviations of rate and energy."""
    paper, (a, b) = nominal or Paper(), rng.standard_normal(2)
    return replace(
        paper, rate=paper.rate * np.exp(rate_sd * a), activation=paper.activation * (1 + activation_sd * b)
    )


def cured(solution: SolvedPressing, paper: Paper, times: Array) -> tuple[Array, Array]:
    """Return the degree of cure of the lower and the upper face at any times of the run."""
    first, last = solution.steps["time"][[0, -1]]
    grid = np.linspace(first, last, 2 * round((last - first) / (2 * STEP_S)) + 1)
    faces = np.stack([solution.at("panel_bottom", grid), solution.at("panel_top", grid)])
    kelvin = faces + ZERO_C
    k = paper.rate * np.exp(-paper.activation / GAS_CONSTANT * (1.0 / kelvin - 1.0 / (paper.reference_C + ZERO_C)))
    h = 2.0 * (grid[1] - grid[0])
    course = np.zeros((2, len(grid[::2])))

    def slope(alpha: Array, rate: Array) -> Array:
        return np.asarray(rate * (1.0 + paper.autocatalysis * alpha) * np.maximum(1.0 - alpha, 0.0) ** paper.order)

    for i in range(course.shape[1] - 1):
        begin, middle, end = k[:, 2 * i], k[:, 2 * i + 1], k[:, 2 * i + 2]
        now = course[:, i]
        s1 = slope(now, begin)
        s2 = slope(now + 0.5 * h * s1, middle)
        s3 = slope(now + 0.5 * h * s2, middle)
        s4 = slope(now + h * s3, end)
        course[:, i + 1] = now + h / 6.0 * (s1 + 2.0 * s2 + 2.0 * s3 + s4)
    low, high = (np.interp(times, grid[::2], one) for one in course)
    return low, high
