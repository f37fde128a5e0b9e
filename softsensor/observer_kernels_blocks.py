"""The live sensor's compiled loops over scans: cut into blocks, averaged, and the panel alone taken over them."""

from __future__ import annotations

import numpy as np
from numba import njit

from softsensor import observer_kernels as loops

BLOCK_S, EAGER_S = 0.45, 4.0
"""Scans are absorbed together over `BLOCK_S`, one by one for `EAGER_S` after a switch. [s]"""
QUIET_S = 2.5
"""So long after a switch innovations say nothing about changes. [s]"""
HOLE_S = 3.0
"""A face silent for longer may have moved in any way meanwhile. [s]"""


@njit(cache=True)
def last_switch(moments, now):
    """Return the newest of the moments up to `now`. [s]"""
    newest = -np.inf
    for moment in moments:
        if newest < moment <= now:
            newest = moment
    return newest


@njit(cache=True)
def cut(time, done, moments, limit, ends):
    """Write the last scans of complete blocks into `ends`; return how many, and whether those are all."""
    count, begin = 0, done
    if done == 0:
        ends[0] = 0
        count, begin = 1, 1
    most = count + limit
    for i in range(begin, time.shape[0]):
        fresh = time[i] - last_switch(moments, time[i] + 1.0) < EAGER_S
        if time[i] - time[begin - 1] < BLOCK_S - 1e-6 and not fresh:
            continue
        if count == most:
            return count, False
        ends[count] = i
        count += 1
        begin = i + 1
    return count, True


@njit(cache=True)
def gather(
    time, outside, level, votes, done, ends, inserted, removed, moments, blind,
    span, outsides, mean, moment, trust, quiet,
):  # fmt: skip
    """Fill the arrays of `observer_blocks.Blocks` from the scans `done` and on."""
    first = done
    for k in range(ends.shape[0]):
        last = ends[k]
        before = max(first - 1, 0)
        span[k, 0], span[k, 1] = time[before], time[last]
        outsides[k, 0], outsides[k, 1] = outside[before], outside[last]
        quiet[k] = first == 0 or time[last] - last_switch(moments, time[last] + 1.0) < QUIET_S
        for a in range(level.shape[1]):
            total, when, count = 0.0, 0.0, 0
            trust[k, a] = 0.0
            for i in range(first, last + 1):
                # while no panel is in the press, sensors tell of hands and air
                if not blind and inserted <= time[i] <= removed and np.isfinite(level[i, a]):
                    total += level[i, a]
                    when += time[i]
                    trust[k, a] += votes[i, a]
                    count += 1
            mean[k, a] = total / count if count else np.nan
            elapsed = time[last] - time[before]
            moment[k, a] = (when / count - time[before]) / elapsed if count and last > first else 1.0
        first = last + 1


@njit(cache=True)
def drive(
    stack, tangents, d_boundary, state, nonlinear, factors, chain, places, timing, moving,
    span, level, faces, shown, unheard,
):  # fmt: skip
    """Take the panel alone over blocks, its faces at what they read; `shown` (2) is what they showed last.

    A face that is silent keeps its last temperature. `unheard` (3): for how long a face has been silent [s], and
    by how much one face and both had moved at most when they were heard again after more than `HOLE_S` [K].
    """
    outside = np.empty((2, 2))
    for k in range(span.shape[0]):
        outside[0] = shown
        elapsed = span[k, 1] - span[k, 0]
        seen = np.isfinite(level[k, faces[0]]) and np.isfinite(level[k, faces[1]])
        most, least = 0.0, np.inf
        for side in range(2):
            now = level[k, faces[side]]
            if np.isfinite(now) and timing.inserted <= span[k, 1] <= timing.removed:
                most, least = max(most, abs(now - shown[side])), min(least, abs(now - shown[side]))
                shown[side] = now
        outside[1] = shown
        silent = unheard[0] + elapsed
        if seen and silent > HOLE_S:
            unheard[1] = max(unheard[1], most)
            unheard[2] = max(unheard[2], min(least, most))
        unheard[0] = 0.0 if seen else silent
        if elapsed > 0.0:
            loops.march(
                stack, tangents, d_boundary, state, nonlinear, factors, chain, places, timing,
                span[k], outside, moving,
            )  # fmt: skip


@njit(cache=True)
def note_moves(time, readings, place, last, since, since_face):
    """Note when channels moved (K) and each face last (M); return the newest of all and the oldest face's. [s]

    `place` is the face of each channel, -1 for none; a face without a reading keeps what it had.
    """
    newest = -np.inf
    heard = np.full(since_face.shape[0], -np.inf)
    for k in range(readings.shape[0]):
        if not np.isfinite(readings[k]):
            continue
        if readings[k] != last[k]:
            last[k] = readings[k]
            since[k] = time
        newest = max(newest, since[k])
        if place[k] >= 0:
            heard[place[k]] = max(heard[place[k]], since[k])
    oldest = np.inf
    for m in range(since_face.shape[0]):
        if heard[m] > -np.inf:
            since_face[m] = heard[m]
        oldest = min(oldest, since_face[m])
    return newest, oldest
