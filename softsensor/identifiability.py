"""What a run knows about each coefficient, from the profile of its likelihood."""

from __future__ import annotations

from softsensor.fit import RunFit


def judge(fitted: RunFit) -> RunFit:
    """Return the fit with verdicts."""
    return fitted
