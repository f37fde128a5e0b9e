"""Several runs that share unknowns, fitted together: effect parameters, or coefficients a press has once.

Runs are eliminated one by one from the Gauss-Newton equations (Schur complement), so the cost is linear in runs
and every run keeps its own moments, offsets and remaining coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from daq.records import Array, Moments, Run
from softsensor.fit import fit_run
from softsensor.fit_problem import (
    MAX_MOVE,
    Evaluation,
    Problem,
    covariance_of,
    damped_step,
    free_of,
    normal_equations,
    solve_scaled,
)
from softsensor.fit_result import Coefficient
from softsensor.model import ThermalModel


def fit_shared(
    model: ThermalModel,
    runs: Sequence[tuple[Run, Moments]],
    shared: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
) -> tuple[dict[str, Coefficient], SharedMinimum]:
    """Fit runs that share the named coefficients or effect parameters; the rest is each run's own.

    Each run is fitted alone first, which settles its moments and its noise.

    Returns
    -------
    The shared values with their intervals, and the joint minimum.
    """
    own = [n for n in model.press.coefficient_names if not model.press.coefficient(n).fixed]
    free = list(dict.fromkeys([*own, *shared]))
    fits = [fit_run(model, run, moments, start=start, free=free, verdicts=False) for run, moments in runs]
    problems = [f.problem for f in fits]
    index = [problems[0].names.index(n) for n in shared]
    middle = np.median([f.minimum.x[index] for f in fits], axis=0)
    starts = []
    for f in fits:
        x = f.minimum.x.copy()
        x[index] = middle
        starts.append(x)
    found = minimise_together(problems, shared, starts=starts)
    spread = float(np.sqrt(np.mean([f.spread**2 for f in fits])))
    reach = float(norm.ppf(0.975)) * spread
    table = {}
    for j, (name, i) in enumerate(zip(shared, index, strict=True)):
        u, x = problems[0].unknowns[i], found.x[j]
        sd = float(np.sqrt(found.covariance[j, j]))
        ends = (max(u.value(x - reach * sd), u.lower), min(u.value(x + reach * sd), u.upper))
        table[name] = Coefficient(u.value(x), abs(u.slope(x)) * sd * spread, ends, sd > 0)
    return table, found


@dataclass(frozen=True)
class SharedMinimum:
    """Where a search over several runs ended."""

    runs: tuple[Evaluation, ...]
    names: tuple[str, ...]
    """The shared unknowns."""
    x: Array
    """Their internal variables."""
    covariance: Array
    """Of the shared ones."""
    loss: float
    converged: bool
    evaluations: int


def minimise_together(
    problems: Sequence[Problem],
    shared: Sequence[str],
    *,
    starts: Sequence[Array] | None = None,
    max_evaluations: int = 30,
    decrease: float = 1e-2,
) -> SharedMinimum:
    """Find the unknowns of several runs that share some of them.

    Every problem must list the shared names among its unknowns, with equal limits and priors; a shared
    prior counts once. Runs are eliminated one by one (Schur complement), so the cost is linear in runs.
    """
    shared = tuple(shared)
    first = problems[0]
    own = [first.names.index(name) for name in shared]
    unknowns = [first.unknowns[i] for i in own]
    mean, precision = first.precision[0][own], first.precision[1][own]
    problems = [_without_prior(p, shared) for p in problems]
    low, high = (side[own] for side in first.limits)
    points = [np.array(p.start if starts is None else starts[r]) for r, p in enumerate(problems)]
    top = np.array([u.inside(u.start) for u in unknowns]) if starts is None else points[0][own]
    state = _Together(problems, shared, low, high, mean, precision)
    at = state.evaluate(points, top)
    damping, count, converged = 1e-3, 1, False
    while count < max_evaluations:
        steps, top_step, promise, _ = state.step(at, damping)
        if promise < decrease:
            converged = True
            break
        new = state.evaluate([a.x + s for a, s in zip(at.runs, steps, strict=True)], at.x + top_step)
        count += 1
        if np.isfinite(new.loss) and new.loss < at.loss:
            damping, at = max(damping * 0.2, 1e-9), new
        else:
            damping *= 8.0
            if damping > 1e10:
                break
    covariance = state.step(at, 0.0)[3]
    return replace(at, covariance=covariance, converged=converged, evaluations=count)


def _without_prior(problem: Problem, shared: tuple[str, ...]) -> Problem:
    unknowns = tuple(replace(u, sd=float("inf")) if u.name in shared else u for u in problem.unknowns)
    return replace(problem, unknowns=unknowns)


@dataclass(frozen=True)
class _Together:
    """The runs of one joint search."""

    problems: Sequence[Problem]
    shared: tuple[str, ...]
    low: Array
    high: Array
    mean: Array
    precision: Array

    def evaluate(self, points: Sequence[Array], top: Array) -> SharedMinimum:
        """Evaluate every run with the shared values put in."""
        top = np.clip(top, self.low, self.high)
        runs = []
        for problem, point in zip(self.problems, points, strict=True):
            x = np.clip(point, *problem.limits)
            x[[problem.names.index(n) for n in self.shared]] = top
            runs.append(problem.evaluate(x))
        pull = top - self.mean
        loss = sum(r.loss for r in runs) + 0.5 * float(pull @ (self.precision * pull))
        return SharedMinimum(tuple(runs), self.shared, top, np.zeros((len(top), len(top))), loss, False, 0)

    def step(self, at: SharedMinimum, damping: float) -> tuple[list[Array], Array, float, Array]:
        """Return each run's step, the shared step, the promised decrease and the shared covariance."""
        matrix = np.diag(self.precision)
        right = -self.precision * (at.x - self.mean)
        parts = []
        promise = 0.0
        for problem, run in zip(self.problems, at.runs, strict=True):
            a, g = normal_equations(problem, run)
            s = np.array([problem.names.index(n) for n in self.shared])
            free = free_of(run.x, g, *problem.limits)
            free[s] = False
            i = np.flatnonzero(free)
            block = a[np.ix_(i, i)]
            block = block + np.diag(damping * np.maximum(np.diag(block), 1e-12))
            solved = np.column_stack(
                [solve_scaled(block, g[i]), *(solve_scaled(block, c) for c in a[np.ix_(i, s)].T)]
            )
            matrix = matrix + a[np.ix_(s, s)] - a[np.ix_(s, i)] @ solved[:, 1:]
            right = right + g[s] - a[np.ix_(s, i)] @ solved[:, 0]
            promise += 0.5 * float(g[i] @ solved[:, 0])
            parts.append((i, s, solved))
        free = free_of(at.x, right, self.low, self.high)
        top, more = damped_step(matrix, right, free, damping)
        steps = []
        for run, (i, s, solved) in zip(at.runs, parts, strict=True):
            step = np.zeros(len(run.x))
            step[i] = np.clip(solved[:, 0] - solved[:, 1:] @ top, -MAX_MOVE, MAX_MOVE)
            step[s] = top
            steps.append(step)
        return steps, top, promise + more, covariance_of(matrix, free)
