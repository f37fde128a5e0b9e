"""What a cause saves on runs it was not fitted to, with the interval that decides whether it is real."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor.signals.student import student

HARDLY = 0.05
"""Share of the residual on runs left out below which saving it is not what a cause, or a law, is worth. By hand,
2026-11."""


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


def paired_gain(before: Array, after: Array) -> Gain:
    """Return what errors of the same runs have fallen by, with its 95 % interval.

    Paired over runs: Student's interval, n - 1 degrees of freedom, of the mean logarithm of before over after, so
    that one run that leaves much over does not decide alone, and two runs need to agree closely. In kelvins it is
    what that ratio takes from the root mean square before, as is the value itself.

    Parameters
    ----------
    before, after
        Errors of each run by numbers from the others (runs). [K]

    Examples
    --------
    >>> paired_gain(np.array([2.0, 2.0, 4.0]), np.array([1.0, 1.0, 2.0])).value_K  # halved, of root of 8
    1.41421
    """
    whole = float(np.sqrt(np.mean(before**2)))
    fell = np.log(np.maximum(before, 1e-9)) - np.log(np.maximum(after, 1e-9))
    middle = float(fell.mean())
    if len(fell) < 2:
        return Gain(_kelvins(whole, middle), None)
    half = student(len(fell) - 1) * float(fell.std(ddof=1)) / len(fell) ** 0.5
    return Gain(_kelvins(whole, middle), (_kelvins(whole, middle - half), _kelvins(whole, middle + half)))


def _kelvins(whole: float, logarithm: float) -> float:
    return float(f"{-whole * np.expm1(-logarithm):.6g}")
