"""Control charts over runs: does the press still do what it used to?

For each coefficient the logarithm of every run's value is standardised by what runs differ by, smoothed
exponentially (EWMA, for creeping wear) and accumulated (CUSUM, for jumps). A chart that leaves its limits
names the run at which the change began, not the one at which it was noticed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri, stdtr

from daq.records import InputError
from daq.words import Message, say
from softsensor.signals.instrument import LEAST_SPREAD_LOG

if TYPE_CHECKING:
    from daq.store import Store

# Numbers without another source were set by hand, 2026-11.

CHARTED_RUNS = 200
"""Runs the charts look back on."""
LEARN_RUNS = 8
"""Runs that say what is usual."""
EWMA_WEIGHT, EWMA_LIMIT = 0.25, 3.2
"""Weight of the newest run; limit in standard deviations of the smoothed value."""
CUSUM_SLACK, CUSUM_LIMIT = 0.6, 5.0
"""In standard deviations of one run: half the shift to be found, and the alarm. A false alarm every
thousand runs or so (Montgomery, Introduction to Statistical Quality Control, ch. 9)."""
SUDDEN = 2.5
"""A run beyond this many standard deviations is no creep."""
OUTLIER = 4.0
"""One run beyond this many standard deviations counts as this many."""


@dataclass(frozen=True)
class RunValue:
    """One coefficient of one run."""

    run: str
    value: float
    sd: float
    """Of the value."""


class Chart(StrEnum):
    """Which chart has left its limits."""

    JUMP = "cusum"
    CREEP = "ewma"


@dataclass(frozen=True)
class DriftAlarm:
    """A coefficient has left what is usual."""

    coefficient: str
    run: str
    """The first run of the new behaviour."""
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


def last_change(name: str, values: Sequence[RunValue]) -> DriftAlarm | None:
    """Look through a coefficient's runs, oldest first, for the latest change that still stands.

    Each run is held against all before it, `LEARN_RUNS` at least.
    """
    good = [v for v in values if v.value > 0 and math.isfinite(v.value) and math.isfinite(v.sd)]
    if len(good) <= LEARN_RUNS:
        return None
    logs = np.array([math.log(v.value) for v in good])
    errors = np.array([v.sd / v.value for v in good])
    z = np.zeros(len(good))
    tame = logs.copy()
    for i in range(LEARN_RUNS, len(good)):
        centre, spread = _usual(tame[:i])
        away = (logs[i] - centre) / math.hypot(spread, errors[i])
        # the past is known from i runs only: Student's t, as a normal deviate
        away = float(ndtri(np.clip(stdtr(i - 1, away / math.sqrt(1.0 + 1.0 / i)), 1e-9, 1 - 1e-9)))
        z[i] = min(max(away, -OUTLIER), OUTLIER)
        tame[i] = min(max(logs[i], centre - 2.5 * spread), centre + 2.5 * spread)
    return _chart(name, good, logs, z)


def _usual(logs: np.ndarray) -> tuple[float, float]:
    """Return mean and standard deviation of the runs so far (self-starting chart, Hawkins 1987)."""
    return float(logs.mean()), max(float(logs.std(ddof=1)), LEAST_SPREAD_LOG)


def _chart(name: str, runs: Sequence[RunValue], logs: np.ndarray, z: np.ndarray) -> DriftAlarm | None:
    high = low = smooth = 0.0
    high_from = low_from = smooth_from = LEARN_RUNS
    alarm: DriftAlarm | None = None
    scale = math.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT))
    for i in range(LEARN_RUNS, len(z)):
        high, high_from = (high + z[i] - CUSUM_SLACK, high_from) if high > 0 else (z[i] - CUSUM_SLACK, i)
        low, low_from = (low - z[i] - CUSUM_SLACK, low_from) if low > 0 else (-z[i] - CUSUM_SLACK, i)
        high, low = max(high, 0.0), max(low, 0.0)
        before = smooth
        smooth = (1.0 - EWMA_WEIGHT) * smooth + EWMA_WEIGHT * z[i]
        if before * smooth <= 0.0:
            smooth_from = i
        first, chart = -1, Chart.JUMP
        if high > CUSUM_LIMIT or low > CUSUM_LIMIT:
            first, chart = _jump(logs, high_from if high > low else low_from, i), Chart.JUMP
        elif abs(smooth) > EWMA_LIMIT * scale:
            first, chart = (_jump(logs, smooth_from, i) if abs(z[i]) > SUDDEN else smooth_from), Chart.CREEP
        if first < 0:
            alarm = None
        elif alarm is None or alarm.run != runs[first].run:
            factor = math.exp(float(np.mean(logs[first : i + 1]) - np.mean(logs[:first])))
            noticed = runs[i].run if alarm is None else alarm.noticed
            alarm = DriftAlarm(name, runs[first].run, noticed, factor, chart)
    return alarm


def _jump(logs: np.ndarray, begun: int, noticed: int) -> int:
    """Return the first run of the new level: where two means fit the runs up to the alarm best.

    The sum may have begun to rise by luck before the jump; it is looked for from there on.
    """
    options = range(max(begun, LEARN_RUNS), noticed + 1)

    def left(k: int) -> float:
        return float(logs[:k].var() * k + logs[k : noticed + 1].var() * (noticed + 1 - k))

    return min(options, key=left)


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
            history.setdefault(c.name, []).append(RunValue(c.run, c.value, c.sd))
    found = (last_change(name, values) for name, values in history.items())
    return [alarm for alarm in found if alarm is not None]


def _effects_of(store: Store, version: str) -> frozenset[str]:
    try:
        return _effects(store.model(version).model)
    except InputError:  # made with the press file alone, before there was a model
        return frozenset()


def _effects(model: Mapping[str, Any]) -> frozenset[str]:
    return frozenset(str(effect["name"]) for effect in model.get("effects", ()))
