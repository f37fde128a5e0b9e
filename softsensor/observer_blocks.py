"""Scans as the live sensor keeps them, and the blocks its filters take them in by.

The filters take in a block at a time: scans one by one just after the press has moved, together over half a
second else. A pass over stored scans takes many blocks in one call of a compiled loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor import observer_kernels as loops
from softsensor import observer_kernels_blocks as compiled

SPARSE_S, BESIDE_S = 2.2, 0.5
"""Faces unheard for longer leave a moment in or so near beside the hole unknown: it may lie anywhere in it. [s]"""
_ROOM = 1024
"""Scans there is room for at first."""


class Scans:
    """A run's scans so far, in arrays that grow.

    Parameters
    ----------
    places, channels
        How many faces have sensors, and how many sensors there are.
    """

    def __init__(self, places: int, channels: int) -> None:
        self._count = 0
        self._time, self._outside = np.empty(_ROOM), np.empty((_ROOM, 2))
        self._level, self._votes = np.empty((_ROOM, places)), np.empty((_ROOM, places))
        self._readings = np.empty((_ROOM, channels))
        self._foretold = np.full((_ROOM, places), np.nan)

    def __len__(self) -> int:
        return self._count

    def append(
        self, time_s: float, outside: tuple[float, float], readings: Array, consensus: loops.Consensus
    ) -> None:
        """Keep a scan: boundary temperatures, single channels, and their consensus. [s, °C]"""
        i = self._count
        if i == len(self._time):
            self._time, self._outside = _doubled(self._time), _doubled(self._outside)
            self._level, self._votes = _doubled(self._level), _doubled(self._votes)
            self._readings, self._foretold = _doubled(self._readings), _doubled(self._foretold)
        self._time[i], self._outside[i], self._readings[i] = time_s, outside, readings
        loops.agree(consensus, self._readings[i], self._level[i], self._votes[i])
        self._foretold[i] = np.nan
        self._count = i + 1

    def agree_anew(self, since_s: float, consensus: loops.Consensus) -> None:
        """Bring the channels of scans from a time on to one value a face again."""
        for i in np.flatnonzero(self.time >= since_s).tolist():
            loops.agree(consensus, self._readings[i], self._level[i], self._votes[i])

    def hole(self, at_s: float, now_s: float) -> tuple[float, float] | None:
        """Return between which times no face was heard, where a moment lies in or beside such a hole. [s]"""
        heard = np.append(self.time[np.isfinite(self.level).any(axis=1)], now_s)
        begins, ends = heard[:-1], heard[1:]
        near = (begins < at_s + BESIDE_S) & (ends > at_s - BESIDE_S) & (ends - begins > SPARSE_S)
        if not near.any():
            return None
        k = int(np.argmax(np.where(near, ends - begins, 0.0)))
        return float(begins[k]), float(ends[k])

    def foretell(self, read: Array) -> None:
        """Keep what the model says the faces read at the newest scan (M). [°C]"""
        self._foretold[self._count - 1] = read

    def foretold_move(self, face: int, since_s: float) -> float:
        """Return how far the model says a face has moved since a time, 0 where it says nothing. [K]"""
        first = int(np.searchsorted(self.time, since_s - 1e-9))
        course = self._foretold[first : self._count, face]
        known = course[np.isfinite(course)]
        return float(np.ptp(known)) if len(known) else 0.0

    def silence(self, face: int, since_s: float) -> None:
        """Forget what a face has read after a time."""
        self._level[int(np.searchsorted(self.time, since_s + 1e-9)) : self._count, face] = np.nan

    @property
    def time(self) -> Array:
        """When each was taken (N). [s]"""
        return self._time[: self._count]

    @property
    def outside(self) -> Array:
        """Boundary temperatures, bottom and top (N, 2). [°C]"""
        return self._outside[: self._count]

    @property
    def level(self) -> Array:
        """What each face reads, NaN where nothing does (N, M). [°C]"""
        return self._level[: self._count]

    @property
    def votes(self) -> Array:
        """How many good channels each face has (N, M)."""
        return self._votes[: self._count]


def _doubled(array: Array) -> Array:
    return np.concatenate([array, np.empty_like(array)])


@dataclass(frozen=True)
class Blocks:
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
    quiet: Array
    """Whether it lies just after a switch (K)."""

    @staticmethod
    def of(
        scans: Scans, done: int, ends: loops.Integers, lies: tuple[float, float], moments: Array, *, blind: bool
    ) -> Blocks:
        """Gather the scans from `done` on into blocks whose last scans are `ends`.

        `lies` is from when to when the panel lies in the press, and its faces count; `moments` are those at which
        the press moved [s]; `blind` leaves what the faces read alone.
        """
        count, places = len(ends), scans.level.shape[1]
        made = Blocks(
            np.empty((count, 2)), np.empty((count, 2, 2)), np.empty((count, places)), np.empty((count, places)),
            np.empty((count, places)), scans.level[ends], np.empty(count, dtype=np.bool_),
        )  # fmt: skip
        compiled.gather(
            scans.time, scans.outside, scans.level, scans.votes, done, ends, *lies, moments, blind,
            made.span, made.outside, made.level, made.moment, made.votes, made.quiet,
        )  # fmt: skip
        return made


def cut(scans: Scans, done: int, moments: Array, limit: int) -> tuple[loops.Integers, bool]:
    """Return the last scans of the blocks that are complete, and whether those are all.

    Parameters
    ----------
    done
        Scans taken in before.
    moments
        When the press moved, and the first scan. [s]
    limit
        Blocks at most; a run's first scan is a block that does not count.
    """
    ends = np.empty(min(limit, len(scans) - done) + 1, dtype=np.int64)
    count, whole = compiled.cut(scans.time, done, moments, limit, ends)
    return ends[:count], whole
