"""Control charts over runs: does the press still do what it used to?

A run's value is held against all before it by its rank alone: where nothing changes, ranks among what came before
are independent and uniform whatever the values scatter like, wild fits among them, so that the chart needs no
spread and no limit for outliers. Rank `r` of `n` becomes the mean of the `r`-th of `n` equal parts of a normal
distribution; a likelihood ratio of such scores has a mean of one at most (Jensen), so it is an e-value. One is
asked for every run at which a change may have begun, a jump and a creep each, over a normal distribution of its
size. Their sum says how much speaks for a change by now; where there is none it grows by one a run on average, so
that it passes `n` once in `n` runs at most, however often one looks (an e-detector).

References
----------
Gordon & Pollak, Ann. Statist. 22 (1994) 763 (charts by sequential ranks); Shin, Ramdas & Rinaldo, New Engl. J.
Stat. Data Sci. 2 (2024) 229 (e-detectors); Kass & Wasserman, J. Am. Stat. Assoc. 90 (1995) 928 (unit information).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.records import Array, InputError
from daq.words import Message, say

if TYPE_CHECKING:
    from daq.store import Store

CHARTED_RUNS = 200
"""Runs the charts look back on: so many a change has to show itself in. It bounds a night's work."""
FALSE_ALARM_RUNS = 1000
"""Pressings from one false alarm of a press to the next, on average at least, all its coefficients together: as a
chart for means is laid out (Montgomery, Introduction to Statistical Quality Control, ch. 9, 370 to 1000)."""
CREEP_RUNS = 30
"""A creep is looked for that moves by about a standard deviation of the runs within so many, the time within which
one wants to know of it. A jump is looked for of about one standard deviation: what one run tells."""


@dataclass(frozen=True)
class RunValue:
    """One coefficient of one run."""

    run: str
    value: float


class Chart(StrEnum):
    """What kind of change it is."""

    JUMP = "jump"
    CREEP = "creep"


@dataclass(frozen=True)
class DriftAlarm:
    """A coefficient has left what is usual."""

    coefficient: str
    run: str
    """The first run of the new behaviour, most likely."""
    noticed: str
    """The run that made it plain."""
    factor: float
    """New level over the old one."""
    chart: Chart

    @property
    def message(self) -> Message:
        """One line for the journal."""
        return say(
            "coefficient-has-changed",
            coefficient=self.coefficient,
            percent=100.0 * self.factor,
            run=self.run,
            noticed=self.noticed,
        )


def last_change(name: str, values: Sequence[RunValue], watched: int = 1) -> DriftAlarm | None:
    """Look through a coefficient's runs, oldest first, for a change that still stands.

    `watched`: how many coefficients of the press are looked at; they share the false alarms that are allowed.
    """
    good = [v for v in values if v.value > 0 and math.isfinite(v.value)][-CHARTED_RUNS:]
    if len(good) < 3:
        return None
    logs = np.log([v.value for v in good])
    evidence = log_evidence(rank_scores(logs))
    beyond = detector(evidence) > math.log(FALSE_ALARM_RUNS * watched)
    if not beyond[-1]:
        return None
    chart = list(Chart)[int(np.argmax(np.logaddexp.reduce(evidence[:, :, -1], axis=1)))]
    first = _jumped(logs) if chart is Chart.JUMP else 1 + int(np.argmax(evidence[1, :, -1]))
    noticed = len(good) - int(np.argmin(np.append(beyond[::-1], False)))
    factor = math.exp(_moved(logs, _course(len(good))[chart][first - 1]))
    return DriftAlarm(name, good[first].run, good[max(noticed, first)].run, factor, chart)


def rank_scores(values: Array) -> Array:
    """Return each value's normal score by its rank among itself and those before (runs).

    Equal values share the ranks they take up.
    """
    from scipy.special import ndtri  # loads slowly, and the sensor is to be there at once

    before = np.tril(np.ones((len(values), len(values)), dtype=bool), -1)
    count = np.arange(1, len(values) + 1)
    low = (before & (values[None, :] < values[:, None])).sum(axis=1) / count
    high = low + (1 + (before & (values[None, :] == values[:, None])).sum(axis=1)) / count
    return np.asarray((_density(ndtri(low)) - _density(ndtri(high))) / (high - low))


def _density(z: Array) -> Array:
    return np.asarray(np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi))


def log_evidence(scores: Array) -> Array:
    """Return logarithms of likelihood ratios (2 shapes, first runs, runs so far) of a change against none.

    The first run may be the second to the last; where it has not come yet the ratio counts for nothing (-inf).
    """
    runs = len(scores)
    seen = np.arange(runs)[None, :] > np.arange(runs - 1)[:, None]
    shapes = np.stack(_shapes(runs))
    known = np.cumsum(shapes**2, axis=2)
    agreed = np.cumsum(shapes * scores, axis=2)
    ratio = 0.5 * agreed**2 / (1.0 + known) - 0.5 * np.log1p(known)
    return np.where(seen, ratio, -np.inf)


def detector(evidence: Array) -> Array:
    """Return the logarithm of the sum over first runs, both shapes alike, after each run (runs)."""
    return np.asarray(np.logaddexp.reduce(evidence, axis=(0, 1)) - math.log(len(evidence)))


@lru_cache(maxsize=8)
def _shapes(runs: int) -> tuple[Array, Array]:
    """Return what a unit change does to scores (first runs, runs), as a jump and as a creep.

    A score tells how a run is off from the mean of all up to it, which follow the change in their turn.
    """
    count = np.arange(1.0, runs + 1.0)
    jump, creep = (course - np.cumsum(course, axis=1) / count for course in _course(runs).values())
    return jump, creep


def _course(runs: int) -> dict[Chart, Array]:
    """Return how far a unit change has gone in each run (first runs, runs)."""
    since = np.maximum(np.arange(runs)[None, :] - np.arange(runs - 1)[:, None], 0.0)
    return {Chart.JUMP: np.minimum(since, 1.0), Chart.CREEP: since / CREEP_RUNS}


def _jumped(logs: Array) -> int:
    """Return the first run after a jump: where two medians leave the least absolute deviations.

    By the values, not their ranks: the larger a jump, the plainer its moment, which ranks do not show.
    """
    left = [sum(float(np.abs(p - np.median(p)).sum()) for p in np.split(logs, [k])) for k in range(1, len(logs))]
    return 1 + int(np.argmin(left))


def _moved(logs: Array, course: Array) -> float:
    """Return by how much the logarithm has changed up to the last run, by least squares."""
    away = course - course.mean()
    return float(away @ logs / (away @ away) * course[-1])


def alarms_of(store: Store, press: str) -> list[DriftAlarm]:
    """Return the alarms that stand over a press's newest runs, in the order in which they were pressed.

    Only fits made with the effects of the model in force count: beside other effects a coefficient means another
    thing, and the press would be blamed for what a promotion has changed. Nor do runs of which nobody said when
    they were: they have no place in an order.
    """
    active = store.active_model(press)
    in_force = _effects(active.model) if active is not None else frozenset()
    newest = store.coefficient_history(press=press, limit=CHARTED_RUNS).items
    fitted = [c for c in newest if c.started_utc is not None]
    effects = {version: _effects_of(store, version) for version in {c.model_version for c in fitted}}
    history: dict[str, list[RunValue]] = {}
    for c in reversed(fitted):
        if c.identifiable and effects[c.model_version] == in_force:
            history.setdefault(c.name, []).append(RunValue(c.run, c.value))
    found = (last_change(name, values, len(history)) for name, values in history.items())
    return [alarm for alarm in found if alarm is not None]


def _effects_of(store: Store, version: str) -> frozenset[str]:
    try:
        return _effects(store.model(version).model)
    except InputError:  # made with the press file alone, before there was a model
        return frozenset()


def _effects(model: Mapping[str, Any]) -> frozenset[str]:
    return frozenset(str(effect["name"]) for effect in model.get("effects", ()))
