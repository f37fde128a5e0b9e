"""All runs of a press fitted together: coefficients drawn from one population, or shared by all.

`softsensor.fitting.population` joins what the runs know near their own minima. Where a run hardly knows a
coefficient its own minimum may lie far off or at a limit, and what it knows there says little about the
place where the others put it. So such a run is searched again with the population as its prior, and enters
the population anew, until nothing moves: the hierarchical fit at the price of a few more searches. A run that has
no others is where it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daq.records import Array
from softsensor.fitting.population import Knowledge, Population, information, population
from softsensor.fitting.problem import STALLED, minimise
from softsensor.fitting.result import RunFit
from softsensor.heat.batch import Each

# Numbers without another source were set by hand, 2026-11.

TRUSTED = 0.2
"""Change of a logarithm within which a run's quadratic form stands for its likelihood."""
ROUNDS = 6
"""Of population and runs in turn, at most. Set by hand, 2026-11."""
EVALUATIONS = 15
"""Allowed for one search."""


@dataclass(frozen=True)
class _Member:
    """Where a run stands between two rounds."""

    fitted: RunFit
    x: Array
    """Its unknowns, nuisances included."""
    knowledge: Knowledge


def fit_together(
    fits: Sequence[RunFit],
    names: Sequence[str],
    *,
    shared: Iterable[str] = (),
    known: Mapping[str, tuple[float, float]] | None = None,
    each: Each = map,
) -> Population:
    """Estimate the population of the named coefficients and every run given the others.

    Parameters
    ----------
    fits
        The runs, each fitted alone, which settled its moments and its noise; none gives what was known before.
    shared
        Coefficients with one value in all runs.
    known
        What was known of a coefficient before: median and standard deviation of the logarithm. Counts once.
    each
        Does some work for each of several things, as `map` does.
    """
    names, same = tuple(names), tuple(shared)
    if not fits:
        blind = Knowledge(np.zeros((len(names), len(names))), np.zeros(len(names)), np.zeros(len(names)))
        return replace(population(names, [blind], same=same, known=known), members=())
    members = [
        _Member(f, f.minimum.x, information(f.problem, f.minimum.evaluation, f.spread, names)) for f in fits
    ]
    people = population(names, [m.knowledge for m in members], same=same, known=known)
    for _ in range(ROUNDS if len(members) > 1 else 0):
        far = [
            i
            for i, (m, (mean, _)) in enumerate(zip(members, people.members, strict=True))
            if np.max(np.abs(mean - m.knowledge.start)) > TRUSTED
        ]
        if not far:
            break
        again = each(partial(_again, people), [(members[i], people.members[i][0]) for i in far])
        for i, member in zip(far, again, strict=True):
            members[i] = member
        people = population(names, [m.knowledge for m in members], same=same, known=known)
    return people


def _again(people: Population, one: tuple[_Member, Array]) -> _Member:
    """Search a run again from where the others put it, with the population as the prior of its coefficients."""
    (member, there), fitted = one, one[0].fitted
    problem, x = fitted.problem, member.x.copy()
    unknowns = list(problem.unknowns)
    for i, name in enumerate(people.names):
        if name not in problem.names:
            continue
        j = problem.names.index(name)
        sd = float(people.spread[i]) / fitted.spread
        unknowns[j] = replace(unknowns[j], centre=float(people.mean[i]), sd=sd)
        x[j] = there[i]
    problem = replace(problem, unknowns=tuple(unknowns))
    found = minimise(problem, x, max_evaluations=EVALUATIONS, decrease=STALLED)
    return _Member(fitted, found.x, information(problem, found.evaluation, fitted.spread, people.names))
