"""What a run knows about each coefficient, from the profile of its likelihood; never from its name.

The profile of a coefficient is the smallest loss that the other unknowns can reach while it is held at a
value. Where the profile rises by half the squared 95 % quantile on both sides inside the press file's
limits, the coefficient is identifiable and the crossings are its interval; where it rises on one side
only, one end of the interval is the limit; where it rises nowhere, the run says nothing. Narrow intervals
are taken from the curvature at the minimum, which is then the same.
A prior on the coefficient itself is left out of its profile: what only a prior says is not identified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from daq.pressfile import Press
from daq.records import Array
from softsensor.fit_problem import Problem, minimise
from softsensor.fit_result import Coefficient, RunFit
from softsensor.fit_unknowns import is_parameter

NARROW = 0.5
"""Half intervals of a logarithm below this are taken from the curvature: there the profile is a parabola."""
WIDE = float(np.log(4.0))
"""An interval whose ends differ by more than four times is no knowledge to build on, even if both are closed."""
SEEN_K = 0.05
"""A coefficient that moves no reading by this much when it grows by e goes unseen. [K]"""
EVALUATIONS = 7
"""Allowed for each point of a profile."""


@dataclass(frozen=True)
class Side:
    """One end of a profile interval."""

    x: float
    """Internal variable at the end; the limit where open."""
    closed: bool


def judge(fitted: RunFit) -> RunFit:
    """Return the fit with every free coefficient's interval and verdict."""
    coefficients = dict(fitted.coefficients)
    for i, u in enumerate(fitted.problem.unknowns):
        if is_parameter(u.name):
            coefficients[u.name] = _judge_one(fitted, i, coefficients[u.name])
    notes = [
        f"{name} is {c.verdict}: {c.reason}"
        for name, c in coefficients.items()
        if c.verdict in ("one-sided", "not identifiable")
    ]
    return replace(fitted, coefficients=coefficients, warnings=(*fitted.warnings, *notes))


def _judge_one(fitted: RunFit, i: int, c: Coefficient) -> Coefficient:
    u, best = fitted.problem.unknowns[i], fitted.minimum
    reach = fitted.quantile * float(np.sqrt(fitted.covariance[i, i]))
    low, high = (side[i] for side in fitted.problem.limits)
    narrow = NARROW if u.scale == "log" else 0.25 * (high - low)
    inside = best.x[i] - reach > low and best.x[i] + reach < high
    if not best.held[i] and 0 < reach < narrow and inside and not np.isfinite(u.sd):
        return replace(c, identifiable=True, verdict="identifiable")
    below, above = (_side(fitted, i, direction, reach) for direction in (-1, 1))
    interval = (u.value(below.x), u.value(above.x))
    if below.closed and above.closed:
        if u.scale != "log" or above.x - below.x < WIDE:
            return replace(c, ci95=interval, identifiable=True, verdict="identifiable")
        verdict = "not identifiable"
    else:
        verdict = "one-sided" if below.closed or above.closed else "not identifiable"
    reason = explain(fitted, i, below, above)
    return replace(c, ci95=interval, identifiable=False, verdict=verdict, reason=reason)


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
        if abs(height / rise - 1.0) < 0.15:
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
        grown = inner[0] + 1.5 * direction * max(abs(inner[0] - points[0][0]), 0.5)
        return limit if direction * (grown - limit) > 0 or len(points) > 3 else grown
    end = min(outer, key=lambda p: direction * p[0])
    root = np.sqrt(max(inner[1], 0.0)), np.sqrt(end[1])
    share = np.clip((np.sqrt(rise) - root[0]) / max(root[1] - root[0], 1e-9), 0.1, 0.9)
    return float(inner[0] + share * (end[0] - inner[0]))


def profile_rise(fitted: RunFit, i: int, x: float) -> float:
    """Return how much the loss rises above its minimum when unknown `i` is held at `x`."""
    problem, best = fitted.problem, fitted.minimum
    held = _hold(problem, i, x)
    start = best.x.copy()
    if best.covariance[i, i] > 0:
        start += best.covariance[:, i] / best.covariance[i, i] * (x - best.x[i])
    start[i] = x
    start = best.x + np.clip(start - best.x, -3.0, 3.0)
    start[i] = x
    u = problem.unknowns[i]
    own = 0.5 * ((best.x[i] - u.mean) / u.sd) ** 2
    found = minimise(held, start, max_evaluations=EVALUATIONS, decrease=0.05)
    return float(max(found.evaluation.loss - (best.evaluation.loss - own), 0.0))


def profile(fitted: RunFit, name: str, points: int = 9) -> tuple[Array, Array]:
    """Return values of a parameter over twice its interval, and the rise of the loss there."""
    i = fitted.problem.names.index(name)
    u, c = fitted.problem.unknowns[i], fitted.coefficients[name]
    low, high = (side[i] for side in fitted.problem.limits)
    ends = [u.inside(max(v, 1e-12)) for v in c.ci95] if u.scale == "log" else [v / u.size for v in c.ci95]
    middle, half = fitted.minimum.x[i], max(abs(ends[1] - ends[0]), 1e-3)
    xs = np.linspace(max(low, middle - half), min(high, middle + half), points)
    return np.array([u.value(x) for x in xs]), np.array([profile_rise(fitted, i, x) for x in xs])


def _hold(problem: Problem, i: int, x: float) -> Problem:
    """Return the problem with one unknown fixed, its own prior left out."""
    u = problem.unknowns[i]
    fixed = replace(u, lower=u.value(x), upper=u.value(x), sd=float("inf"))
    return replace(problem, unknowns=(*problem.unknowns[:i], fixed, *problem.unknowns[i + 1 :]))


def explain(fitted: RunFit, i: int, below: Side, above: Side) -> str:
    """Say why a coefficient is not identifiable in this run, and which measurement would fix it."""
    name = fitted.problem.names[i]
    largest = max(float(np.abs(d[:, i]).max()) for d in fitted.minimum.evaluation.derivative)
    role, remedy = role_of(fitted.problem.case.press, name, fitted)
    if largest < SEEN_K:
        return f"{role}; no reading of this run moves by more than {largest:.2g} K when it grows by e. {remedy}"
    if below.closed and not above.closed:
        least = fitted.problem.unknowns[i].value(below.x)
        return f"{role}; anything above {least:.3g} fits as well: its resistance is too small to be seen. {remedy}"
    partner, correlation = partner_of(fitted, i)
    if below.closed and above.closed:
        role += f"; it is known to a factor of {np.exp((above.x - below.x) / 2):.0f} only"
    if abs(correlation) > 0.8:
        return f"{role}; it moves together with {partner} (correlation {correlation:+.2f}). {remedy}"
    return f"{role}; its effect of {largest:.2g} K drowns in the slow noise of the faces. {remedy}"


def partner_of(fitted: RunFit, i: int) -> tuple[str, float]:
    """Return the unknown that correlates most with unknown `i`, and the correlation."""
    row = fitted.correlation[i].copy()
    row[i] = 0.0
    j = int(np.argmax(np.abs(row)))
    return fitted.problem.names[j], float(row[j])


def role_of(press: Press, name: str, fitted: RunFit) -> tuple[str, str]:
    """Return what a coefficient does in this press, and which record would show it."""
    share = fitted.minimum.evaluation.solution.closed_share
    period = fitted.problem.signals.period_s
    t = fitted.problem.signals.time_s
    after = float((t > fitted.opened_s).sum() * period) if np.isfinite(fitted.opened_s) else 0.0
    closed = float((share > 0.5).sum() * period)
    for contact in press.contact:
        pair = " and ".join(contact.between)
        if contact.closed == name:
            return (
                f"it couples {pair} while closed ({closed:.0f} s here)",
                "Press longer, and log at 5 Hz or faster.",
            )
        opened = contact.open or ()
        if name in ((opened,) if isinstance(opened, str) else opened):
            remedy = (
                "Log for a minute after opening"
                if after < 30.0
                else "Log a minute of the open press before closing"
            )
            return (
                f"it acts at {pair} while open ({after:.0f} s after opening here)",
                f"{remedy}, or put a thermocouple on the face of the layer next to it.",
            )
    if "." in name:
        return "it is a parameter of an effect", "See the effect's confirming measurement."
    return "it acts at a boundary", "Put a thermocouple next to that boundary."


def quantile(freedom: float) -> float:
    """Return the two-sided 95 % quantile of Student's t.

    Examples
    --------
    >>> round(quantile(10), 2)
    2.23
    """
    return float(student.ppf(0.975, freedom))
