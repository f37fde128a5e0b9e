"""The live sensor's compiled loops over single channels: one robust mean a face, and channels that stand still."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Channels(NamedTuple):
    """What is known of the channels of all places; changed in place."""

    place: Integers
    """Place of each channel (K)."""
    shift: Array
    """Of each channel against its place's robust mean (K). [K]"""
    scatter: Array
    """Mean square departure from it, single bad readings aside (K). [K²]"""
    before: Array
    """Departure of each channel's reading before (K). [K]"""
    seen: Array
    """How many readings each channel has given (K)."""
    level: Array
    """Last robust mean of each place, NaN at first (M). [°C]"""


# Numbers without another source were set by hand, 2026-11.

SOUND_K2 = 0.04
"""A channel counts half where its mean square departure is (0.2 K)², as sensors of one face differ when sound."""
_FAR_K = 0.6
"""A reading further from the others than this loses weight with the square of its distance."""
_LONGEST_MEMORY = 300.0
"""Readings after which a channel's shift is no longer learned faster than by so much."""


@compiled()
def robust_mean(channels, values, out, votes):
    """Write the robust mean of each place's channels into `out` (M), NaN where none is usable.

    A channel's constant shift against the others is learned, so that it may drop out and return; one
    that departs from the others loses its vote. `votes` (M) gets the effective number of channels.
    """
    near = np.empty(channels.place.shape[0])
    who = np.empty(channels.place.shape[0], np.int64)
    for m in range(out.shape[0]):
        count = _usable(channels, values, m, False, near, who)
        if count == 0:
            count = _usable(channels, values, m, True, near, who)
        if count == 0:
            out[m] = math.nan
            votes[m] = 0.0
            continue
        middle = _median(near, count)
        total, weights = 0.0, 0.0
        for c in range(count):
            w = SOUND_K2 / (SOUND_K2 + channels.scatter[who[c]])
            away = abs(near[c] - middle)
            w *= 1.0 if away < _FAR_K else (_FAR_K / away) ** 2
            total += w * near[c]
            weights += w
        out[m] = channels.level[m] = total / weights
        votes[m] = weights
        _learn(channels, values, m)


@compiled(inner=True)
def _median(values, count):
    """Return the median of the first `count` values; it hardly compiles beside Numba's own, for a dozen values."""
    ranked = np.empty(count)
    for i in range(count):
        j = i
        while j > 0 and ranked[j - 1] > values[i]:
            ranked[j] = ranked[j - 1]
            j -= 1
        ranked[j] = values[i]
    return 0.5 * (ranked[(count - 1) // 2] + ranked[count // 2])


@compiled(inner=True)
def _usable(channels, values, m, newcomers, near, who):
    """Collect a place's readings without their shifts, those of newcomers only where there are no others."""
    count = 0
    for k in range(channels.place.shape[0]):
        if channels.place[k] != m or not math.isfinite(values[k]):
            continue
        if newcomers or channels.seen[k] > 0.0 or math.isnan(channels.level[m]):
            near[count] = values[k] if newcomers else values[k] - channels.shift[k]
            who[count] = k
            count += 1
    return count


@compiled(inner=True)
def _learn(channels, values, m):
    """Learn the shift and the scatter of a place's channels from their newest readings.

    A single bad reading is no scatter: one counts as no further off than the one before it, or than `_FAR_K`.
    """
    level = channels.level[m]
    for k in range(channels.place.shape[0]):
        if channels.place[k] != m or not math.isfinite(values[k]):
            continue
        seen = channels.seen[k]
        away = values[k] - level - channels.shift[k]
        if seen == 0.0:
            channels.shift[k] = values[k] - level
            away = 0.0
        bounded = min(max(away, -_FAR_K), _FAR_K)
        channels.shift[k] += 1.0 / min(seen + 1.0, _LONGEST_MEMORY) * bounded
        counted = min(abs(away), max(channels.before[k], _FAR_K))
        channels.before[k] = abs(away)
        channels.scatter[k] += max(0.05, 1.0 / (seen + 1.0)) * (counted * counted - channels.scatter[k])
        channels.seen[k] = seen + 1.0


class Changes(NamedTuple):
    """When channels last changed to the last digit; changed in place."""

    place: Integers
    """Face of each channel, -1 for a platen's (K)."""
    last: Array
    """What each channel read last (K). [°C]"""
    since: Array
    """Since when each has read that (K). [s]"""
    since_face: Array
    """Since when all channels of a face have (M). [s]"""


@compiled()
def note_changes(changes, time, readings):
    """Note a scan; return when the newest change of all channels was, and that of the stillest face. [s]

    A face without a reading keeps what it had.
    """
    newest = -np.inf
    received = np.full(changes.since_face.shape[0], -np.inf)
    for k in range(readings.shape[0]):
        if not np.isfinite(readings[k]):
            continue
        if readings[k] != changes.last[k]:
            changes.last[k] = readings[k]
            changes.since[k] = time
        newest = max(newest, changes.since[k])
        m = changes.place[k]
        if m >= 0:
            received[m] = max(received[m], changes.since[k])
    oldest = np.inf
    for m in range(changes.since_face.shape[0]):
        if received[m] > -np.inf:
            changes.since_face[m] = received[m]
        oldest = min(oldest, changes.since_face[m])
    return newest, oldest
