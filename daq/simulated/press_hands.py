"""Between pressings a person takes the thermocouples off one panel and tapes them to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.records import Array

HAND_C = (27.0, 34.0)
"""What sensors show that are taken in a hand: below skin, which stays below 37 °C. By hand, 2026-11. [°C]"""
STEP_S = 0.1
"""Of a hand's course. [s]"""


@dataclass(frozen=True)
class Between:
    """The time from one panel's removal (or the start) to the next one's insertion. [s, °C]"""

    removed: float
    inserted: float
    ambient: float
    next_panel: float
    """Temperature of the panel that comes."""


def wander(between: Between, first: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return times and one thermocouple's temperatures from removal to insertion.

    Parameters
    ----------
    between
        When, and how warm the surroundings are.
    first
        What it read when the panel was removed. [°C]
    rng
        Decides when it is pulled off, how often it is touched, and when it is taped on.
    """
    gap = between.inserted - between.removed
    t = np.append(np.arange(0.0, gap, STEP_S), gap)
    pulled, taped = gap * rng.uniform(0.1, 0.4), gap * rng.uniform(0.6, 0.9)
    target = between.ambient + (first - between.ambient) * np.exp(-t / 40.0)
    pace = np.full(len(t), 1.0)
    free = (t >= pulled) & (t < taped)
    target[free] = between.ambient
    pace[free] = rng.uniform(1.0, 2.5)
    for _ in range(int(rng.integers(1, 5))):
        begin = rng.uniform(pulled, taped)
        held = (t >= begin) & (t < begin + rng.uniform(0.5, 4.0)) & free
        target[held] = rng.uniform(*HAND_C)
        pace[held] = rng.uniform(0.5, 2.0)
    taping = (t >= taped) & (t < taped + rng.uniform(0.5, 2.0))
    target[t >= taped] = between.next_panel
    target[taping] = rng.uniform(*HAND_C)
    pace[t >= taped] = min(rng.uniform(0.3, 0.8), 0.05 * gap)
    return between.removed + t, _follow(first, target, pace)


def _follow(first: float, target: Array, pace: Array) -> Array:
    """Return a first-order answer to `target`, its time constant changing on the way."""
    share = 1.0 - np.exp(-STEP_S / pace)
    out = np.empty(len(target))
    value = first
    for i, (aim, x) in enumerate(zip(target.tolist(), share.tolist(), strict=True)):
        out[i] = value
        value += (aim - value) * x
    return out
