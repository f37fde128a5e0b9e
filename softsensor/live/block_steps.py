"""The live sensor's compiled loops over scans: cut into blocks, averaged, and the panel alone taken over them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from daq.press.faces import BLIND_S
from softsensor.live.march_steps import march_span

Array = NDArray[np.float64]

BLOCK_S, EAGER_S = 0.45, 4.0
"""Scans are taken together over `BLOCK_S`, one by one for `EAGER_S` after a switch. [s] By hand."""

# Numbers without another source were set by hand, 2026-11.

QUIET_S = 2.5
"""So long after a switch innovations say nothing about changes. [s]"""


class ScanRows(NamedTuple):
    """Scans as they came (N)."""

    time: Array
    """[s]"""
    outside: Array
    """Boundary temperatures, bottom and top (N, 2). [°C]"""
    level: Array
    """What each face reads, NaN where nothing does (N, M). [°C]"""
    votes: Array
    """How many good channels each face has (N, M)."""


class Blocks(NamedTuple):
    """Scans taken together, block after block (K)."""

    span: Array
    """Begin and end (K, 2). [s]"""
    outside: Array
    """Boundary temperatures at begin and end, bottom and top (K, 2, 2). [°C]"""
    level: Array
    """What the faces read in the mean, NaN where that does not count (K, M). [°C]"""
    moment: Array
    """Mean time of what they read, as a share of the block (K, M)."""
    votes: Array
    """Number of good readings (K, M)."""
    newest: Array
    """What the faces read in the block's last scan, whatever counts (K, M). [°C]"""
    quiet: NDArray[np.bool_]
    """Whether it lies just after a switch (K)."""


def single(blocks: Blocks, k: int) -> Blocks:
    """Return one of the blocks."""
    own = slice(k, k + 1)
    return Blocks(
        blocks.span[own], blocks.outside[own], blocks.level[own], blocks.moment[own], blocks.votes[own],
        blocks.newest[own], blocks.quiet[own],
    )  # fmt: skip


class Counted(NamedTuple):
    """Which readings of the faces count, and when the press moved."""

    inserted: float
    """The panel lies in the press from here on. [s]"""
    removed: float
    """[s]"""
    moments: Array
    """When the press moved, and the first scan. [s]"""
    blind: bool
    """Leave what the faces read alone."""


class FacesRead(NamedTuple):
    """What the panel's lower and upper face read last; changed in place."""

    last: Array
    """(2) [°C]"""
    silent_s: Array
    """For how long one of them has been silent (1). [s]"""
    jumped_K: Array  # noqa: N815
    """By how much one face and both had moved at most when they were read again after `BLIND_S` (2). [K]"""


@compiled()
def last_switch(moments, now):
    """Return the newest of the moments up to `now`. [s]"""
    newest = -np.inf
    for moment in moments:
        if newest < moment <= now:
            newest = moment
    return newest


@compiled()
def cut_blocks(time, done, moments, limit, ends):
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


@compiled()
def gather_blocks(rows, done, ends, counted, blocks):
    """Fill `blocks` from the scans `done` and on, whose last scans are `ends`."""
    first = done
    for k in range(ends.shape[0]):
        last = ends[k]
        before = max(first - 1, 0)
        begin, end = rows.time[before], rows.time[last]
        blocks.span[k, 0], blocks.span[k, 1] = begin, end
        for side in range(rows.outside.shape[1]):  # by number: a whole row takes two seconds to compile
            blocks.outside[k, 0, side] = rows.outside[before, side]
            blocks.outside[k, 1, side] = rows.outside[last, side]
        blocks.quiet[k] = first == 0 or end - last_switch(counted.moments, end + 1.0) < QUIET_S
        for a in range(rows.level.shape[1]):
            total, when, count = 0.0, 0.0, 0
            blocks.votes[k, a] = 0.0
            for i in range(first, last + 1):
                # while no panel is in the press, sensors read hands and air
                lies = counted.inserted <= rows.time[i] <= counted.removed
                if not counted.blind and lies and np.isfinite(rows.level[i, a]):
                    total += rows.level[i, a]
                    when += rows.time[i]
                    blocks.votes[k, a] += rows.votes[i, a]
                    count += 1
            blocks.level[k, a] = total / count if count else np.nan
            blocks.moment[k, a] = (when / count - begin) / (end - begin) if count and last > first else 1.0
        first = last + 1


@compiled()
def march_between_faces(model, timing, blocks, faces, read):
    """Take the panel alone over blocks, its faces at what they read; a silent one keeps its last temperature.

    `faces` are the places of lower and upper face, `read` a `FacesRead`.
    """
    outside = np.empty((2, 2))
    for k in range(blocks.span.shape[0]):
        outside[0, 0], outside[0, 1] = read.last[0], read.last[1]
        elapsed = blocks.span[k, 1] - blocks.span[k, 0]
        seen = np.isfinite(blocks.newest[k, faces[0]]) and np.isfinite(blocks.newest[k, faces[1]])
        most, least = 0.0, np.inf
        for side in range(2):
            now = blocks.newest[k, faces[side]]
            if np.isfinite(now) and timing.inserted <= blocks.span[k, 1] <= timing.removed:
                moved = abs(now - read.last[side])
                most, least = max(most, moved), min(least, moved)
                read.last[side] = now
        outside[1, 0], outside[1, 1] = read.last[0], read.last[1]
        silent = read.silent_s[0] + elapsed
        if seen and silent > BLIND_S:
            read.jumped_K[0] = max(read.jumped_K[0], most)
            read.jumped_K[1] = max(read.jumped_K[1], min(least, most))
        read.silent_s[0] = 0.0 if seen else silent
        if elapsed > 0.0:
            march_span(model, timing, blocks.span[k], outside)
