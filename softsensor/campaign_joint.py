"""Runs of one press estimated together: a log-normal population, and what each run knows about it.

Every run enters with the quadratic form of its likelihood in the logarithms of the coefficients, nuisances
eliminated. Where a coefficient sits at a limit the form keeps its slope, and where a run says nothing its
precision is zero, so nothing has to be left out by hand. Median and spread follow by expectation-maximisation.

Reference: Dempster, Rubin, Tsutakawa, JASA 76:341 (1981), covariance components by EM.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor.fit_problem import inverse, normal_equations
from softsensor.fit_result import RunFit

SPREAD_PRIOR = (0.15, 2.0)
"""Coefficients differ from run to run by 12 to 30 %: size of the spread, and how many runs this counts for."""
ITERATIONS = 200


@dataclass(frozen=True)
class Knowledge:
    """What one run says about the logarithms: precision and precision times estimate."""

    precision: Array
    pull: Array
    start: Array
    """The run's own estimate."""


@dataclass(frozen=True)
class Population:
    """What the runs of a press have in common."""

    names: tuple[str, ...]
    mean: Array
    """Of the logarithms."""
    mean_covariance: Array
    """How well the mean is known."""
    spread: Array
    """Standard deviation of the logarithms from run to run."""
    members: tuple[tuple[Array, Array], ...]
    """Mean and covariance of each run's logarithms, the others taken into account."""


def information(fitted: RunFit, names: Sequence[str]) -> Knowledge:
    """Return what a run knows about the logarithms of the named coefficients."""
    problem, best = fitted.problem, fitted.minimum
    matrix, right = normal_equations(problem, best.evaluation)
    own = [problem.names.index(n) for n in names]
    rest = [j for j in range(len(problem.names)) if j not in own]
    inner = inverse(matrix[np.ix_(rest, rest)])
    cross = matrix[np.ix_(own, rest)] @ inner
    precision = (matrix[np.ix_(own, own)] - cross @ matrix[np.ix_(rest, own)]) / fitted.spread**2
    slope = (right[own] - cross @ right[rest]) / fitted.spread**2
    precision = 0.5 * (precision + precision.T)
    values, vectors = np.linalg.eigh(precision)
    precision = (vectors * np.maximum(values, 0.0)) @ vectors.T
    x = best.x[own]
    return Knowledge(precision, precision @ x + slope, x)


def population(names: Sequence[str], runs: Sequence[Knowledge]) -> Population:
    """Estimate median and spread of the population, and each run given the others."""
    n = len(names)
    size, count = SPREAD_PRIOR
    mean = np.median([r.start for r in runs], axis=0)
    spread2 = np.full(n, size**2)
    members: list[tuple[Array, Array]] = []
    for _ in range(ITERATIONS):
        members = [_member(r, mean, spread2) for r in runs]
        total, weighted = _weights(runs, spread2)
        new_mean = inverse(total) @ weighted
        scatter = np.array([np.diag(c) + (m - new_mean) ** 2 for m, c in members]).sum(axis=0)
        scatter += np.diag(inverse(total))
        new_spread2 = (scatter + count * size**2) / (len(runs) + count)
        moved = float(np.max(np.abs(new_mean - mean)) + np.max(np.abs(np.sqrt(new_spread2) - np.sqrt(spread2))))
        mean, spread2 = new_mean, new_spread2
        if moved < 1e-5:
            break
    covariance = inverse(_weights(runs, spread2)[0])
    members = [_member(r, mean, spread2) for r in runs]
    return Population(tuple(names), mean, covariance, np.sqrt(spread2), tuple(members))


def _member(run: Knowledge, mean: Array, spread2: Array) -> tuple[Array, Array]:
    covariance = inverse(run.precision + np.diag(1.0 / spread2))
    return covariance @ (run.pull + mean / spread2), covariance


def _weights(runs: Sequence[Knowledge], spread2: Array) -> tuple[Array, Array]:
    """Precision of the mean and its pull, each run's own estimate integrated out."""
    outer = np.diag(1.0 / spread2)
    total = 1e-6 * np.eye(len(spread2))
    weighted = np.zeros(len(spread2))
    for run in runs:
        inner = inverse(run.precision + outer)
        total = total + outer - outer @ inner @ outer
        weighted = weighted + outer @ inner @ run.pull
    return total, weighted
