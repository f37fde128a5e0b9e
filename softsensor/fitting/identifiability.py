"""What a run knows about each coefficient, from the profile of its likelihood; never from its name.

The profile of a coefficient is the smallest loss that the other unknowns can reach while it is held at a
value. Where the profile rises by half the squared 95 % quantile on both sides inside the press file's
limits, the coefficient is identifiable and the crossings are its interval; where it rises on one side
only, one end of the interval is the limit; where it rises nowhere, the run says nothing. Narrow intervals
are taken from the curvature at the minimum, which is then the same.
A prior on the coefficient itself is left out of its profile: what only a prior says is not identified.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.records import Array
from daq.words import Message, say
from softsensor.fitting.experiment_advice import ALONE, SEEN_K, Company, Side, explain
from softsensor.fitting.problem import MAX_MOVE, FitProblem, damped_step, free_of, minimise, normal_equations
from softsensor.fitting.result import Coefficient, Identifiability, RunFit
from softsensor.fitting.unknowns import is_coefficient

# Numbers without another source were set by hand, 2026-11.

NARROW = 0.5
"""Half intervals of a logarithm below this are taken from the curvature: there the profile is a parabola."""
WIDE = float(np.log(4.0))
"""An interval whose ends differ by more than four times is no knowledge to build on, even if both are closed."""
SETTLED = 0.3
"""Where the other unknowns still promise less than this, one Gauss-Newton step shows where they would end."""
NEAR_RISE = 0.15
"""A point whose rise is so near to the one looked for, as a share, is the end: 7 % of the interval's width."""
FURTHER, LEAST_STEP, BETWEEN = 1.5, 0.5, (0.1, 0.9)
"""Where nothing rises enough yet, the next point is so many times further out, counted from at least the second of
a logarithm; between two points it keeps these shares away from both."""
MOST_FOLLOWED = 3.0
"""How far the other unknowns are taken along a profile to begin with, in their own units."""
BEYOND, LEAST_WIDTH = 0.25, 1e-3
"""A profile that is drawn goes beyond the interval by this share of its width, which counts at least so much."""
MUCH_WORSE = 1.5
"""A procedure that ends this many times as far from the readings as they can be met has not found them."""
PROFILE_POINTS = 5
"""Odd: the best value is the one in the middle."""
EVALUATIONS = 7
"""Allowed for each point of a profile that decides a verdict."""
PROFILE_STEPS = 3
"""Allowed for each point of a profile that is drawn."""


def held_against(fitted: RunFit, own: RunFit) -> RunFit:
    """Return another procedure's fit with the verdicts of our own, and say where the two cannot both be right.

    It counts as not converged where it ends worse than it began, or `MUCH_WORSE` times as far from the
    readings as this run can be met.
    """
    coefficients, notes = dict(fitted.coefficients), []
    for name, c in fitted.coefficients.items():
        judged = own.coefficients[name]
        low, high = judged.ci95
        if judged.verdict is Identifiability.FIXED:
            continue
        if c.ci95[1] < low or c.ci95[0] > high:
            notes.append(say("fit-outside-allowed", name=name, value=c.value, low=low, high=high))
        ends = c.ci95 if judged.identifiable else (min(low, c.value), max(high, c.value))
        coefficients[name] = replace(
            c, ci95=ends, identifiable=judged.identifiable, verdict=judged.verdict, reason=judged.reason
        )
    notes += verdict_notes(coefficients)
    left, first, best = fitted.rmse_still_K, fitted.initial_rmse_still_K, own.rmse_still_K
    if left > best + SEEN_K and left > min(MUCH_WORSE * best, first):
        notes.append(say("fit-stuck", rmse=left, first=first, own=best))
        fitted = replace(fitted, converged=False)
    if misfit := fitted.misfit or own.misfit:
        return _unmet(replace(fitted, misfit=misfit, warnings=(*fitted.warnings, *notes)))
    return replace(fitted, coefficients=coefficients, warnings=(*fitted.warnings, *notes))


def verdict_notes(coefficients: Mapping[str, Coefficient]) -> list[Message]:
    """Say of each coefficient the run does not determine why."""
    return [
        say("fit-coefficient-unknown", name=name, verdict=c.verdict.message, reason=c.reason)
        for name, c in coefficients.items()
        if c.verdict in (Identifiability.ONE_SIDED, Identifiability.NOT_IDENTIFIABLE) and c.reason is not None
    ]


def is_verdict_on(warning: Message, names: Container[str]) -> bool:
    """Return whether a warning only repeats the verdict on one of some coefficients."""
    return warning.code == "fit-coefficient-unknown" and warning.arguments["name"] in names


def with_verdicts(fitted: RunFit, company: Company = ALONE) -> RunFit:
    """Return the fit with every free coefficient's interval and verdict, and advice fit for its company."""
    if not fitted.met:
        return _unmet(fitted)
    coefficients = dict(fitted.coefficients)
    for i, u in enumerate(fitted.problem.unknowns):
        if is_coefficient(u.name):
            coefficients[u.name] = _judge_one(fitted, i, coefficients[u.name], company)
    return replace(fitted, coefficients=coefficients, warnings=(*fitted.warnings, *verdict_notes(coefficients)))


def _unmet(fitted: RunFit) -> RunFit:
    """Return a fit of a run the model does not describe: whatever value stands there, nothing is known."""
    free = [u.name for u in fitted.problem.unknowns if is_coefficient(u.name)]
    press = fitted.problem.case.press
    reason = None if fitted.misfit is None else say("fit-not-described", misfit=fitted.misfit)
    unknown = {
        name: Coefficient(
            fitted.coefficients[name].value,
            float("nan"),
            press.coefficient(name).limits,
            False,
            Identifiability.NOT_IDENTIFIABLE,
            reason,
        )
        for name in free
    }
    return replace(fitted, coefficients={**fitted.coefficients, **unknown})


def _judge_one(fitted: RunFit, i: int, c: Coefficient, company: Company) -> Coefficient:
    u, best = fitted.problem.unknowns[i], fitted.minimum
    reach = fitted.quantile * float(np.sqrt(fitted.covariance[i, i]))
    low, high = (side[i] for side in fitted.problem.limits)
    inside = best.x[i] - reach > low and best.x[i] + reach < high
    if not best.held[i] and 0 < reach < NARROW and inside and not np.isfinite(u.sd):
        return replace(c, identifiable=True, verdict=Identifiability.IDENTIFIABLE)
    below, above = (_widened(fitted, i, _side(fitted, i, direction, reach)) for direction in (-1, 1))
    interval = (u.value(below.x), u.value(above.x))
    if below.closed and above.closed:
        if above.x - below.x < WIDE:
            ends = c.ci95 if np.isfinite(u.sd) else interval
            return replace(c, ci95=ends, identifiable=True, verdict=Identifiability.IDENTIFIABLE)
        verdict = Identifiability.NOT_IDENTIFIABLE
    else:
        one_sided = below.closed or above.closed
        verdict = Identifiability.ONE_SIDED if one_sided else Identifiability.NOT_IDENTIFIABLE
    reason = explain(fitted, i, below, above, company)
    return replace(c, ci95=interval, identifiable=False, verdict=verdict, reason=reason)


def _widened(fitted: RunFit, i: int, side: Side) -> Side:
    """Return the end of an interval with what the constants leave open, of which a profile knows nothing."""
    if not side.closed:
        return side
    away = side.x - fitted.minimum.x[i]
    more = fitted.quantile**2 * float(fitted.minimum.from_constants[i, i])
    at = float(fitted.minimum.x[i] + np.copysign(np.sqrt(away**2 + more), away))
    limit = float(fitted.problem.limits[0 if away < 0 else 1][i])
    return (
        Side(limit, False) if abs(at - fitted.minimum.x[i]) > abs(limit - fitted.minimum.x[i]) else Side(at, True)
    )


def _side(fitted: RunFit, i: int, direction: int, reach: float) -> Side:
    """Look for the end of the profile interval on one side."""
    limit = fitted.problem.limits[0 if direction < 0 else 1][i]
    x0 = fitted.minimum.x[i]
    if abs(limit - x0) < 1e-6:
        return Side(limit, False)
    rise = 0.5 * fitted.quantile**2 * fitted.spread**2
    near = x0 + direction * reach if 0 < reach < abs(limit - x0) else limit
    points = [(x0, 0.0)]
    at = near
    for _ in range(5):
        height = profile_rise(fitted, i, at)
        points.append((at, height))
        if abs(height / rise - 1.0) < NEAR_RISE:
            return Side(at, True)
        if height < rise and abs(at - limit) < 1e-9:
            return Side(limit, False)
        at = _next(points, rise, limit, direction)
    lower = max((p for p in points if p[1] < rise), key=lambda p: direction * p[0])
    upper = [p for p in points if p[1] >= rise]
    if not upper:
        return Side(limit, False)
    end = min(upper, key=lambda p: direction * p[0])
    share = (np.sqrt(rise) - np.sqrt(lower[1])) / max(np.sqrt(end[1]) - np.sqrt(lower[1]), 1e-9)
    return Side(float(lower[0] + share * (end[0] - lower[0])), True)


def _next(points: list[tuple[float, float]], rise: float, limit: float, direction: int) -> float:
    """Where to look next: between the points that bracket the rise, else further out."""
    inner = max((p for p in points if p[1] < rise), key=lambda p: direction * p[0])
    outer = [p for p in points if p[1] >= rise]
    if not outer:
        grown = inner[0] + FURTHER * direction * max(abs(inner[0] - points[0][0]), LEAST_STEP)
        return limit if direction * (grown - limit) > 0 or len(points) > 3 else grown
    end = min(outer, key=lambda p: direction * p[0])
    root = np.sqrt(max(inner[1], 0.0)), np.sqrt(end[1])
    share = np.clip((np.sqrt(rise) - root[0]) / max(root[1] - root[0], 1e-9), *BETWEEN)
    return float(inner[0] + share * (end[0] - inner[0]))


def profile_rise(fitted: RunFit, i: int, x: float, steps: int = EVALUATIONS) -> float:
    """Return how much the loss rises above its minimum when unknown `i` is held at `x`.

    Few `steps` give an upper estimate where the other unknowns have far to go.
    """
    problem, best = fitted.problem, fitted.minimum
    held = _hold(problem, i, x)
    start = best.x.copy()
    if best.covariance[i, i] > 0:
        start += best.covariance[:, i] / best.covariance[i, i] * (x - best.x[i])
    start[i] = x
    start = best.x + np.clip(start - best.x, -MOST_FOLLOWED, MOST_FOLLOWED)
    start[i] = x
    u = problem.unknowns[i]
    own = 0.5 * u.deviation(best.x[i] * u.unit) ** 2
    at = minimise(held, start, max_evaluations=steps, decrease=SETTLED).evaluation
    matrix, right = normal_equations(held, at)
    step, promise = damped_step(matrix, right, free_of(at.x, right, *held.limits), 0.0)
    lowest = at.loss - (promise if promise < 2.0 * SETTLED and np.max(np.abs(step)) < MAX_MOVE else 0.0)
    return float(max(lowest - (best.evaluation.loss - own), 0.0))


@dataclass(frozen=True)
class LikelihoodProfile:
    """How much worse a run is met the further a coefficient is moved, the other unknowns following."""

    value: Array
    """Values looked at, rising, the best one among them."""
    rise: Array
    """Of half of minus two log likelihood above its minimum, over the noise the residuals really have."""
    threshold: float
    """Rise at which a 95 % interval ends."""

    def as_json(self) -> dict[str, Any]:
        """Return the profile's entry in ``fit --json``."""
        return {
            "value": [float(v) for v in self.value],
            "rise": [round(float(v), 4) for v in self.rise],
            "threshold": round(self.threshold, 4),
        }


def profile(fitted: RunFit, name: str, points: int = PROFILE_POINTS) -> LikelihoodProfile:
    """Return the profile of a parameter over about one and a half times its interval."""
    i = fitted.problem.names.index(name)
    u, c = fitted.problem.unknowns[i], fitted.coefficients[name]
    low, high = (side[i] for side in fitted.problem.limits)
    ends = np.log(c.ci95)
    middle, most = fitted.minimum.x[i], max(abs(ends[1] - ends[0]), LEAST_WIDTH)
    alone = fitted.spread**2 * float(fitted.minimum.covariance[i, i])
    first = max(low, min(middle, ends[0]) - BEYOND * most)
    last = min(high, max(middle, ends[1]) + BEYOND * most)
    below = np.linspace(first, middle, points // 2 + 1)[:-1] if middle > first else np.zeros(0)
    above = np.linspace(middle, last, points // 2 + 1)[1:] if last > middle else np.zeros(0)
    xs = np.concatenate([below, [middle], above])
    stretch = float(np.sqrt(1.0 + fitted.minimum.from_constants[i, i] / alone)) if alone > 0.0 else 1.0
    at = middle + (xs - middle) / stretch  # held constants make a profile steeper than what is known
    rise = np.array([0.0 if x == middle else profile_rise(fitted, i, x, PROFILE_STEPS) for x in at])
    values = np.array([u.value(x) for x in xs])
    return LikelihoodProfile(values, rise / fitted.spread**2, 0.5 * fitted.quantile**2)


def profiles_of(fitted: RunFit) -> dict[str, LikelihoodProfile]:
    """Return the profile of every free coefficient of a run; none where the model does not describe it."""
    if not fitted.met:
        return {}
    return {u.name: profile(fitted, u.name) for u in fitted.problem.unknowns if is_coefficient(u.name)}


def _hold(problem: FitProblem, i: int, x: float) -> FitProblem:
    """Return the problem with one coefficient fixed, its own prior left out."""
    u = problem.unknowns[i]
    fixed = replace(u, lower=x, upper=x, sd=float("inf"))
    return replace(problem, unknowns=(*problem.unknowns[:i], fixed, *problem.unknowns[i + 1 :]))
