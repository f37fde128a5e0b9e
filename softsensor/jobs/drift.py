"""Control charts over runs: does the press still do what it used to?

A run's value is held against all before it by its rank alone: where nothing changes, ranks among what came before
are independent and uniform whatever the values scatter like, wild fits among them, so that the chart needs no
spread and no limit for outliers. Rank `r` of `n` becomes the mean of the `r`-th of `n` equal parts of a normal
distribution, its score. How much likelier a score is after a shift than without one is asked for several shifts
and for every run at which the shift may have come; the mean over shifts of the sum over such runs says how much
speaks for a change by now. Where there is none it grows by one a run on average, so that it passes `n` once in `n`
runs at most, however often one looks: Shiryaev's and Roberts' chart, an e-detector.

References
----------
Gordon & Pollak, Ann. Statist. 22 (1994) 763 (the chart by sequential ranks); Shin, Ramdas & Rinaldo, New Engl. J.
Stat. Data Sci. 2 (2024) 229 (e-detectors).
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
SHIFTS = (-4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0)
"""Shifts looked for, in standard deviations of the runs, twice as large each: one between two of them loses a
ninth of its evidence at most, as a shift `d` looked for as `s` gives `s d - s^2 / 2` a run instead of `d^2 / 2`.
A smaller one than the least takes more than the runs looked back on."""


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
    beyond = log_evidence(rank_scores(logs)) > math.log(FALSE_ALARM_RUNS * watched)
    if not beyond[-1]:
        return None
    chart, first, factor = _course_of(logs)
    noticed = len(good) - int(np.argmin(np.append(beyond[::-1], False)))
    return DriftAlarm(name, good[first].run, good[max(noticed, first)].run, factor, chart)


def rank_scores(values: Array) -> Array:
    """Return each value's normal score by its rank among itself and those before (runs).

    Equal values share the ranks they take up.
    """
    before = np.tril(np.ones((len(values), len(values)), dtype=bool), -1)
    count = np.arange(1, len(values) + 1)
    low = (before & (values[None, :] < values[:, None])).sum(axis=1) / count
    high = low + (1 + (before & (values[None, :] == values[:, None])).sum(axis=1)) / count
    return _part_mean(low, high)


def _part_mean(low: Array, high: Array) -> Array:
    """Return the mean of a normal distribution between two of its shares."""
    from scipy.special import ndtri  # loads slowly, and the sensor is to be there at once

    density = np.exp(-0.5 * ndtri(np.stack([low, high])) ** 2) / math.sqrt(2.0 * math.pi)
    return np.asarray((density[0] - density[1]) / (high - low))


def log_evidence(scores: Array) -> Array:
    """Return the logarithm of what speaks for a change after each run (runs)."""
    ratios = np.outer(scores, SHIFTS) - _log_usual(len(scores))
    evidence, so_far = np.empty(len(scores)), np.full(len(SHIFTS), -np.inf)
    for i, ratio in enumerate(ratios):
        so_far = np.logaddexp(0.0, so_far) + ratio
        evidence[i] = np.logaddexp.reduce(so_far) - math.log(len(SHIFTS))
    return evidence


@lru_cache(maxsize=4)
def _log_usual(runs: int) -> Array:
    """Return the logarithm of the mean of `exp(shift score)` where all ranks are alike (runs, shifts).

    Equal values have the mean score of their ranks, and so no more than that.
    """
    usual = np.empty((runs, len(SHIFTS)))
    for i in range(1, runs + 1):
        edges = np.arange(i + 1) / i
        scores = _part_mean(edges[:-1], edges[1:])
        usual[i - 1] = np.logaddexp.reduce(np.outer(scores, SHIFTS), axis=0) - math.log(i)
    return usual


def _course_of(logs: Array) -> tuple[Chart, int, float]:
    """Return whether it was a jump or a creep, its first run, and the new level over the old one.

    By least squares over all first runs and both courses; of values, since a large jump makes its moment plain.
    """
    since = np.maximum(np.arange(len(logs))[None, :] - np.arange(len(logs) - 1)[:, None], 0.0)
    courses = np.stack([np.minimum(since, 1.0), since])
    away = courses - courses.mean(axis=2, keepdims=True)
    squares = (away**2).sum(axis=2)
    shape, before = np.unravel_index(int(np.argmax((away @ logs) ** 2 / squares)), squares.shape)
    slope = away[shape, before] @ logs / squares[shape, before]
    return tuple(Chart)[int(shape)], int(before) + 1, math.exp(slope * courses[shape, before, -1])


def alarms_of(store: Store, press: str) -> list[DriftAlarm]:
    """Return the alarms that stand over a press's newest runs, in the order in which they were pressed.

    Only fits made with the effects of the model in force count: beside other effects a coefficient means another
    thing, and the press would be blamed for what a promotion has changed. Nor do runs without a known time
    count: they have no place in an order.
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
