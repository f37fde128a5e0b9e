"""What a cause saves on runs it was not fitted to, with the interval that decides whether it is real."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor.signals.student import student

HARDLY = 0.05
"""Share of the residual on runs left out below which saving it is not what a cause, or a law, is worth. By hand,
2026-11."""

BY_CHANCE = 0.3
"""What the logarithm of a run's errors scatters by without a cause: root mean squares of ten stretches that know
nothing of each other, as slow noise has in a pressing of some minutes, have 1 / sqrt(20) each. Derived; with 0.2
or 0.5 the interval holds as often (`tests.calibration.gains`)."""
LEAST = 1e-9
"""No error is smaller."""


@dataclass(frozen=True)
class Gain:
    """What errors of the same runs have fallen by. [K]"""

    value_K: float  # noqa: N815
    ci95: tuple[float, float] | None
    """None for one run."""

    @property
    def sure(self) -> bool:
        """Whether the interval lies above nothing."""
        return self.ci95 is not None and self.ci95[0] > 0.0

    @property
    def surely_worse(self) -> bool:
        """Whether the interval lies below nothing."""
        return self.ci95 is not None and self.ci95[1] < 0.0


def paired_gain(before: Array, after: Array, moved: Array | None = None, whole: float | None = None) -> Gain:
    """Return what errors of the same runs have fallen by, with its 95 % interval.

    Paired over runs: the mean logarithm of before over after, so that one run that leaves much over does not
    decide alone, and two runs need to agree closely. In kelvins it is what that ratio takes from the root mean
    square before, as is the value itself.

    A run counts by what the cause would take from it if it were there. Faces of thick panels show nothing of
    their middle: neither right constants nor wrong ones change what is left there, and such runs are no scatter
    beside a few thin panels. So the logarithms are regressed on what is expected of them, through nothing, with
    the jackknife's error and as many degrees of freedom as runs count, less one. Where all runs count alike, this
    is Student's interval of their mean.

    Parameters
    ----------
    before, after
        Errors of each run by numbers from the others, in any unit (runs).
    moved
        How far the two models lie apart in each run, in that unit (runs); by default all runs count alike.
    whole
        The root mean square before. [K] By default that of `before`.

    Examples
    --------
    >>> paired_gain(np.array([2.0, 2.0, 4.0]), np.array([1.0, 1.0, 2.0])).value_K  # halved, of root of 8
    1.41421
    """
    whole = float(np.sqrt(np.mean(before**2))) if whole is None else whole
    before, after = np.maximum(before, LEAST), np.maximum(after, LEAST)
    fell = np.log(before / after)
    counts = np.ones(len(fell)) if moved is None else BY_CHANCE + np.log1p(moved**2 / (before * after)) / 2.0
    power = float(counts @ counts)
    times = power / float(counts.sum())
    slope = float(counts @ fell) / power
    n, runs = len(fell), power**2 / float(np.sum(counts**4))
    if n < 2:
        return Gain(_kelvins(whole, times * slope), None)
    without = counts * (fell - slope * counts) / (power - counts**2)
    half = student(max(runs - 1.0, 1.0)) * float(np.sqrt((n - 1) / n * (without @ without)))
    ends = (_kelvins(whole, times * (slope - half)), _kelvins(whole, times * (slope + half)))
    return Gain(_kelvins(whole, times * slope), ends)


def _kelvins(whole: float, logarithm: float) -> float:
    return float(f"{-whole * np.expm1(-logarithm):.6g}")
