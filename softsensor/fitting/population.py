"""Runs of one press estimated together: a log-normal population, and what each run knows about it.

Every run enters with the quadratic form of its likelihood in the logarithms of the coefficients, nuisances
eliminated. Where a coefficient sits at a limit the form keeps its slope, and where a run says nothing its
precision is zero, so nothing has to be left out by hand. Median and spread follow by expectation-maximisation.

Reference: Dempster, Rubin, Tsutakawa, JASA 76:341 (1981), covariance components by EM.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.fitting.problem import (
    Evaluation,
    FitProblem,
    carried_among,
    constants_among,
    inverse,
    normal_equations,
)
from softsensor.signals.instrument import SPREAD_LOG, SPREAD_RUNS

SAME_SPREAD = 1e-3
"""Spread of a coefficient that all runs share: none that matters."""
ITERATIONS = 200
"""At most: a bound against a search that circles. By hand."""


@dataclass(frozen=True)
class Knowledge:
    """What one run says about the logarithms: precision and precision times estimate."""

    precision: Array
    pull: Array
    start: Array
    """Where the likelihood was looked at: the run's own estimate, or where the others put it."""


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
    """Mean and covariance of each run's logarithms, the others and the error of the mean taken into account."""

    __repr__ = on_screen


def information(problem: FitProblem, at: Evaluation, spread: float, names: Sequence[str]) -> Knowledge:
    """Return what a run knows about the logarithms of the named coefficients, priors on them left out.

    Parameters
    ----------
    at
        The point about which the likelihood is taken as a quadratic form.
    spread
        How much larger the whitened residuals are than the noise model says.
    """
    bare = tuple(replace(u, sd=float("inf")) if u.name in names else u for u in problem.unknowns)
    matrix, right = normal_equations(replace(problem, unknowns=bare), at)
    own_places = [i for i, n in enumerate(names) if n in problem.names]
    own = [problem.names.index(names[i]) for i in own_places]
    held, carried = constants_among(problem), carried_among(problem)
    rest = [j for j in range(len(problem.names)) if j not in (*own, *held)]
    inner = inverse(matrix[np.ix_(rest, rest)])
    cross = matrix[np.ix_(own, rest)] @ inner
    information = (matrix[np.ix_(own, own)] - cross @ matrix[np.ix_(rest, own)]) / spread**2
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    known = (vectors * np.maximum(values, 0.0)) @ vectors.T
    leaning = (matrix[np.ix_(own, carried)] - cross @ matrix[np.ix_(rest, carried)]) / spread**2
    lean = inverse(known) @ leaning
    doubt = np.eye(len(carried)) + leaning.T @ lean  # a constant counts in its standard deviation
    share = leaning @ inverse(doubt)  # `problem.left_open`, as a loss of precision
    precision, slope = np.zeros((len(names), len(names))), np.zeros(len(names))
    precision[np.ix_(own_places, own_places)] = known - share @ leaning.T
    right = (right[own] - cross @ right[rest]) / spread**2
    slope[own_places] = right - share @ lean.T @ right
    x = np.log([problem.values[n] for n in names])
    x[own_places] = at.x[own]
    return Knowledge(precision, precision @ x + slope, x)


def population(
    names: Sequence[str],
    runs: Sequence[Knowledge],
    *,
    same: Iterable[str] = (),
    known: Mapping[str, tuple[float, float]] | None = None,
) -> Population:
    """Estimate median and spread of the population, and each run given the others.

    Parameters
    ----------
    same
        Coefficients that do not differ from run to run.
    known
        What was known of a median before: median and standard deviation of the logarithm.
    """
    size, count = SPREAD_LOG, SPREAD_RUNS
    before = _Before.of(names, known or {})
    free = np.array([name not in set(same) for name in names])
    mean = np.median([r.start for r in runs], axis=0)
    spread2 = np.where(free, size**2, SAME_SPREAD**2)
    members: list[tuple[Array, Array]] = []
    for _ in range(ITERATIONS):
        members = [_member(r, mean, spread2) for r in runs]
        total, weighted = _weights(runs, spread2, before)
        new_mean = inverse(total) @ weighted
        scatter = np.array([np.diag(c) + (m - new_mean) ** 2 for m, c in members]).sum(axis=0)
        scatter += np.diag(inverse(total))
        new_spread2 = np.where(free, (scatter + count * size**2) / (len(runs) + count), SAME_SPREAD**2)
        moved = float(np.max(np.abs(new_mean - mean)) + np.max(np.abs(np.sqrt(new_spread2) - np.sqrt(spread2))))
        mean, spread2 = new_mean, new_spread2
        if moved < 1e-5:
            break
    covariance = inverse(_weights(runs, spread2, before)[0])
    members = [_with_mean_error(_member(r, mean, spread2), covariance, spread2) for r in runs]
    return Population(tuple(names), mean, covariance, np.sqrt(spread2), tuple(members))


def _member(run: Knowledge, mean: Array, spread2: Array) -> tuple[Array, Array]:
    covariance = inverse(run.precision + np.diag(1.0 / spread2))
    return covariance @ (run.pull + mean / spread2), covariance


def _with_mean_error(member: tuple[Array, Array], error: Array, spread2: Array) -> tuple[Array, Array]:
    """Add to a run's covariance what it inherits from the error of the population's mean."""
    mean, covariance = member
    lean = covariance / spread2[None, :]
    return mean, covariance + lean @ error @ lean.T


@dataclass(frozen=True)
class _Before:
    """What was known of the medians before any run."""

    precision: Array
    pull: Array

    @staticmethod
    def of(names: Sequence[str], known: Mapping[str, tuple[float, float]]) -> _Before:
        """Return it from medians and standard deviations of the logarithm, in the order of `names`."""
        precision = np.array([known[n][1] ** -2 if n in known else 0.0 for n in names])
        centre = np.array([np.log(known[n][0]) if n in known else 0.0 for n in names])
        return _Before(precision, precision * centre)


def _weights(runs: Sequence[Knowledge], spread2: Array, before: _Before) -> tuple[Array, Array]:
    """Precision of the mean and its pull, each run's own estimate integrated out."""
    outer = np.diag(1.0 / spread2)
    total = 1e-6 * np.eye(len(spread2)) + np.diag(before.precision)
    weighted = before.pull.copy()
    for run in runs:
        inner = inverse(run.precision + outer)
        total = total + outer - outer @ inner @ outer
        weighted = weighted + outer @ inner @ run.pull
    return total, weighted
