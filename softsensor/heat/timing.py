"""When the press is idle, open and closed: shares of the states at times, or averaged over steps.

Insertion, closing, opening and removal are ramps. All moments but the removal may be shifted and the ramps of
closing and opening stretched by nuisance parameters, so the shares come with derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.printed import on_screen
from daq.records import Array, Moments

# Numbers without another source were set by hand, 2026-11.

OPENING_RAMP_S = 0.35
"""How long opening takes; its middle is `Moments.opened_s`. Half and twice as long move a face by 0.26 and 1.1 K
within a second of it, twice as long by 0.41 K later and the core by 24 mK (`tests.calibration.steps`). By hand,
2026-11. [s]"""
HANDLING_RAMP_S = 0.2
"""How long insertion and removal take; half and twice as long move a face by 0.62 and 0.79 K within a second of
them (`tests.calibration.steps`). By hand, 2026-11. [s]"""
SHORTEST_RAMP_S = 0.02
"""A ramp is longer than this, so that its derivatives stay finite: a tenth of what the quickest press takes to
close, 0.2 s. No run of `tests.calibration.steps` (seed 2026, 2026-11-29) has one so short. [s]"""
TIMINGS = ("closed_s", "opened_s", "ramp_s", "inserted_s")
"""What shifts a field of `Moments`."""
OPENING_RAMP = "opening_ramp_s"
"""What stretches the opening ramp."""


@dataclass(frozen=True)
class Clock:
    """A press's moments in one run, and the times at which shares are asked for."""

    moments: Moments
    times: Array
    """Times, or step edges if `mean`. [s]"""
    mean: bool
    """Average between the times."""
    present: Array
    """Whether a panel is in, 0 .. 1 (rows)."""
    has_states: bool
    start: float
    """Of the run. [s]"""

    __repr__ = on_screen

    @staticmethod
    def of(moments: Moments, times: Array, start: float, *, mean: bool, has_states: bool) -> Clock:
        """Prepare for times of a run that starts at `start`. [s]"""
        inside = np.isfinite(moments.inserted_s) and moments.inserted_s > start
        present, _, _ = ramp(times, moments.inserted_s if inside else -np.inf, HANDLING_RAMP_S, mean=mean)
        if np.isfinite(moments.removed_s):
            present = present - ramp(times, moments.removed_s, HANDLING_RAMP_S, mean=mean)[0]
        return Clock(moments, times, mean, present, has_states, start)

    def ramps(self, values: Mapping[str, float]) -> list[tuple[float, float]]:
        """Return when the shares change, with nuisances of these values: from, to. [s]"""
        if not self.has_states:
            return []
        m = self.moments
        closing, opening = self._lengths(values)
        lengths = (HANDLING_RAMP_S, closing[0], opening[0], HANDLING_RAMP_S)
        shifted = [getattr(m, name) + values.get(name, 0.0) for name in ("inserted_s", "closed_s", "opened_s")]
        middles = (*shifted, m.removed_s)
        return [
            (a - b / 2, a + b / 2)
            for i, (a, b) in enumerate(zip(middles, lengths, strict=True))
            if np.isfinite(a) and (i > 0 or a > self.start)
        ]

    def _lengths(self, values: Mapping[str, float]) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return how long closing and opening take, each with its derivative by what stretches it. [s]"""
        closing = self.moments.ramp_s + values.get("ramp_s", 0.0)
        opening = OPENING_RAMP_S + values.get(OPENING_RAMP, 0.0)
        return ramp_length(closing), ramp_length(opening)

    def shares(self, values: Mapping[str, float], names: tuple[str, ...] = (), p: int = 0) -> tuple[Array, Array]:
        """Return the shares of idle, open and closed (rows, 3), and their derivatives (rows, 3, p)."""
        p = max(p, len(names))
        if not any(name in names or values.get(name, 0.0) != 0.0 for name in (*TIMINGS, OPENING_RAMP)):
            return self._unshifted, np.zeros((len(self.present), 3, p))
        return self._shares(values, names, p)

    @cached_property
    def _unshifted(self) -> Array:
        """Shares with no shift, not to be changed."""
        return self._shares({}, (), 0)[0]

    def _shares(self, values: Mapping[str, float], names: tuple[str, ...], p: int) -> tuple[Array, Array]:
        rows = len(self.present)
        weights, d_weights = np.zeros((rows, 3)), np.zeros((rows, 3, p))
        if not self.has_states:
            weights[:, 2] = 1.0
            return weights, d_weights
        m = self.moments
        (up_s, up_by), (down_s, down_by) = self._lengths(values)
        up, d_up, d_up_s = ramp(self.times, m.closed_s + values.get("closed_s", 0.0), up_s, mean=self.mean)
        down, d_down, d_down_s = ramp(self.times, m.opened_s + values.get("opened_s", 0.0), down_s, mean=self.mean)
        closed = up - down
        present, d_present = self._presence(values.get("inserted_s", 0.0), derive="inserted_s" in names)
        weights[:, 0] = 1.0 - present
        weights[:, 1] = present - closed
        weights[:, 2] = closed
        if "inserted_s" in names:
            weights_of = names.index("inserted_s")
            d_weights[:, 0, weights_of] = -d_present
            d_weights[:, 1, weights_of] = d_present
        changes = {
            "closed_s": d_up,
            "opened_s": -d_down,
            "ramp_s": up_by * d_up_s,
            OPENING_RAMP: -down_by * d_down_s,
        }
        for name, change in changes.items():
            if name in names:
                d_weights[:, 2, names.index(name)] = change
                d_weights[:, 1, names.index(name)] = -change
        return np.clip(weights, 0.0, 1.0, out=weights), d_weights

    def _presence(self, shift: float, *, derive: bool) -> tuple[Array, Array]:
        """Return whether a panel is in with the insertion shifted, and the derivative by the shift (rows)."""
        inserted = self.moments.inserted_s
        if (shift == 0.0 and not derive) or not np.isfinite(inserted) or inserted <= self.start:
            return self.present, np.zeros(len(self.present))
        there, _, _ = ramp(self.times, inserted, HANDLING_RAMP_S, mean=self.mean)
        moved, change, _ = ramp(self.times, inserted + shift, HANDLING_RAMP_S, mean=self.mean)
        return self.present + moved - there, change


def ramp_length(asked_s: float) -> tuple[float, float]:
    """Return how long a ramp takes that is asked to take so long, and its derivative by that. [s]

    As asked from twice the shortest on, smoothly towards the shortest below: a search that has shortened a ramp as
    far as it goes feels that nothing is left to gain, and does not reckon with a step that changes nothing.
    """
    if asked_s >= 2.0 * SHORTEST_RAMP_S:
        return asked_s, 1.0
    share = float(np.exp(asked_s / SHORTEST_RAMP_S - 2.0))
    return SHORTEST_RAMP_S * (1.0 + share), share


def ramp(edges: Array, middle: float, length: float, *, mean: bool) -> tuple[Array, Array, Array]:
    """Return a rise from 0 to 1 about `middle` and its derivatives by middle and length.

    With `mean`, averages between the edges instead of values at them.

    Examples
    --------
    >>> ramp(np.array([0.0, 1.0, 2.0]), 1.0, 1.0, mean=True)[0].tolist()
    [0.125, 0.875]
    """
    rows = len(edges) - 1 if mean else len(edges)
    value, by_middle, by_length = np.zeros(rows), np.zeros(rows), np.zeros(rows)
    if not np.isfinite(middle):
        value[:] = 1.0 if middle < 0 else 0.0
        return value, by_middle, by_length
    first, last = np.searchsorted(edges, (middle - length / 2, middle + length / 2))
    a, b = max(int(first) - 1, 0), min(int(last) + 1, len(edges))
    value[b - 1 if mean else b :] = 1.0
    near = edges[a:b]
    x = np.clip((near - middle) / length + 0.5, 0.0, 1.0)
    inner = (x > 0) & (x < 1)
    if not mean:
        value[a:b] = x
        by_middle[a:b] = np.where(inner, -1.0 / length, 0.0)
        by_length[a:b] = np.where(inner, -(x - 0.5) / length, 0.0)
        return value, by_middle, by_length
    h = np.diff(near)
    area = np.where(x >= 1, near - middle, length * x * x / 2)
    value[a : b - 1] = np.diff(area) / h  # the others are exactly 0 or 1, so that equal steps compare equal
    by_middle[a : b - 1] = -np.diff(x) / h
    by_length[a : b - 1] = np.diff(np.where(inner, x * (1 - x) / 2, 0.0)) / h
    return value, by_middle, by_length
