"""Scans as the live sensor keeps them, and the blocks its filters take them in by.

The filters take in a block at a time: scans one by one just after the press has moved, together over half a
second else. A pass over stored scans takes many blocks in one call of a compiled loop.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from daq.materials import MATERIALS
from daq.records import Array
from softsensor.live import block_steps as compiled
from softsensor.live.block_steps import Blocks, Counted, ScanRows
from softsensor.live.channel_steps import SOUND_K2, Channels, Integers, robust_mean
from softsensor.signals.screen import LEAST_CHANNELS, LIMIT_K, LIMIT_RATIO

# Numbers without another source were set by hand, 2026-11.

SPARSE_S, BESIDE_S = 2.2, 0.5
"""Faces unread for longer leave a moment in or so near beside the gap unknown: it may lie anywhere in it. [s]"""
MOVED_SHARE = 2.0 / math.sqrt(math.pi) * 50.0 * math.sqrt(2.0) / MATERIALS["MDF"].effusivity
"""A face that a closed press heats has gone so much of its way to the platens within 2 s where the contact passes
50 W/m²K (a half-space: 2/√π h √t / e), and poorer ones are no press's. [-]"""
_ROOM = 1024
"""Scans there is room for at first."""


class ScanArrays:
    """A run's scans so far, in arrays that grow.

    Parameters
    ----------
    place
        Face of each panel channel (K).
    faces
        How many faces have sensors (M).
    loads
        How many contacts' loads stand beside the boundaries.
    """

    def __init__(self, place: Integers, faces: int, loads: int = 0) -> None:
        self._place, self._faces, self._count = place, faces, 0
        self._channels = fresh_channels(place, faces)
        self._time, self._outside = np.empty(_ROOM), np.empty((_ROOM, 2 + loads))
        self._level, self._votes = np.empty((_ROOM, faces)), np.empty((_ROOM, faces))
        self._readings = np.empty((_ROOM, len(place)))
        self._expected = np.full((_ROOM, faces), np.nan)
        self._late_s: dict[float, float] = {}

    def __len__(self) -> int:
        return self._count

    def append(self, time_s: float, outside: Sequence[float], readings: Array) -> None:
        """Keep a scan: what is outside (`outside`), single channels, and their robust mean. [s, °C]"""
        i = self._count
        if i == len(self._time):
            self._time, self._outside = _doubled(self._time), _doubled(self._outside)
            self._level, self._votes = _doubled(self._level), _doubled(self._votes)
            self._readings, self._expected = _doubled(self._readings), _doubled(self._expected)
        self._time[i], self._outside[i], self._readings[i] = time_s, outside, readings
        robust_mean(self._channels, self._readings[i], self._level[i], self._votes[i])
        self._expected[i] = np.nan
        self._count = i + 1

    def left_out(self) -> dict[int, float]:
        """Return the channels that read something else than their place, and by how much. [K]

        Now, or of late (rms) if that is more. The same limits as the screen of a finished run: a departure of
        `LIMIT_K` and of `LIMIT_RATIO` times what is usual there; a place needs three channels to judge.
        """
        if not self._count:
            return {}
        far, away = np.sqrt(self._channels.scatter), self._away()
        most = np.copysign(np.maximum(far, np.abs(away)), away)
        return {k: float(most[k]) for k, limit in self._limits() if far[k] > limit and np.isfinite(away[k])}

    def departing(self) -> dict[int, float]:
        """Return those that read something else at the newest scan, whatever they read of late. [K]

        Just after a switch faces change by 100 K/s, and channels read one after another differ by kelvins: of late
        they then departed for seconds more, and a shift learned then is none. A channel departs here from both
        its place and its shift.
        """
        if not self._count:
            return {}
        away = self._away()
        own = np.minimum(np.abs(away), np.abs(away - self._channels.shift))
        return {k: float(away[k]) for k, limit in self._limits() if own[k] > limit}

    def _away(self) -> Array:
        """Return how far the channels read from their places at the newest scan (K). [K]"""
        newest = self._count - 1
        away: Array = self._readings[newest] - self._level[newest, self._channels.place]
        return away

    def _limits(self) -> Iterator[tuple[int, float]]:
        """Give each channel whose place can be judged by, and the departure that counts there. [K]"""
        for m in range(self._faces):
            there = np.flatnonzero((self._channels.place == m) & (self._channels.seen > 0))
            if len(there) < LEAST_CHANNELS:
                continue
            limit = max(LIMIT_K, LIMIT_RATIO * float(np.median(np.sqrt(self._channels.scatter[there]))))
            yield from ((int(k), limit) for k in there)

    def average_anew(self, since_s: float) -> None:
        """Forget what the channels were like, and average those of scans from a time on again."""
        self._channels = fresh_channels(self._place, self._faces)
        for i in np.flatnonzero(self.time >= since_s).tolist():
            robust_mean(self._channels, self._readings[i], self._level[i], self._votes[i])

    def gap(self, at_s: float, now_s: float) -> tuple[float, float] | None:
        """Return between which times no face was read, where a moment lies in or beside such a gap. [s]"""
        read = np.append(self.time[np.isfinite(self.level).any(axis=1)], now_s)
        begins, ends = read[:-1], read[1:]
        near = (begins < at_s + BESIDE_S) & (ends > at_s - BESIDE_S) & (ends - begins > SPARSE_S)
        if not near.any():
            return None
        k = int(np.argmax(np.where(near, ends - begins, 0.0)))
        return float(begins[k]), float(ends[k])

    def expect(self, read: Array) -> None:
        """Keep what the model says the faces read at the newest scan (M). [°C]"""
        self._expected[self._count - 1] = read

    def expected_move(self, face: int, since_s: float) -> float:
        """Return how far the model says a face has moved since a time, 0 where it says nothing. [K]"""
        first = int(np.searchsorted(self.time, since_s - 1e-9))
        course = self._expected[first : self._count, face]
        known = course[np.isfinite(course)]
        return float(np.ptp(known)) if len(known) else 0.0

    def late_s(self, closed_s: float) -> float:
        """Return how long after the press closed the last face began to move, up to now where it has not. [s]"""
        if closed_s in self._late_s:  # every face has begun to move: that is so for good
            return self._late_s[closed_s]
        first, late_s, all_moved = int(np.searchsorted(self.time, closed_s)), 0.0, True
        for level in self.level.T if 0 < first < self._count else ():
            read = level[:first][np.isfinite(level[:first])]
            if not len(read):
                continue
            way = MOVED_SHARE * abs(float(self.outside[first, :2].mean()) - float(read[-1]))
            moved = np.flatnonzero(np.abs(level[first:] - read[-1]) >= way)
            begun = first + int(moved[0]) if len(moved) else self._count - 1
            late_s, all_moved = max(late_s, float(self.time[begun]) - closed_s), all_moved and len(moved) > 0
        if all_moved and 0 < first < self._count:
            self._late_s[closed_s] = late_s
        return late_s

    def silence(self, face: int, since_s: float) -> None:
        """Forget what a face has read after a time."""
        self._level[int(np.searchsorted(self.time, since_s + 1e-9)) : self._count, face] = np.nan
        self._late_s.clear()

    @property
    def time(self) -> Array:
        """When each was taken (N). [s]"""
        return self._time[: self._count]

    @property
    def now(self) -> float:
        """Time of the newest. [s]"""
        return float(self._time[self._count - 1])

    @property
    def outside(self) -> Array:
        """Boundary temperatures, bottom and top, and the logarithms of the contacts' loads (N, 2 + L). [°C, -]"""
        return self._outside[: self._count]

    @property
    def level(self) -> Array:
        """What each face reads, NaN where nothing does (N, M). [°C]"""
        return self._level[: self._count]

    @property
    def rows(self) -> ScanRows:
        """All of it, as the compiled loops take it."""
        n = self._count
        return ScanRows(self._time[:n], self._outside[:n], self._level[:n], self._votes[:n])


def fresh_channels(place: Integers, faces: int) -> Channels:
    """Return what is known of panel channels before the first reading, given the face of each (K)."""
    count = len(place)
    none = np.zeros((3, count))
    return Channels(place, none[0], np.full(count, SOUND_K2), none[1], none[2], np.full(faces, np.nan))


def _doubled(array: Array) -> Array:
    return np.concatenate([array, np.empty_like(array)])


def blocks_of(rows: ScanRows, done: int, ends: Integers, counted: Counted) -> Blocks:
    """Gather the scans from `done` on into blocks whose last scans are `ends`."""
    count, places = len(ends), rows.level.shape[1]
    made = Blocks(
        np.empty((count, 2)), np.empty((count, 2, rows.outside.shape[1])), np.empty((count, places)),
        np.empty((count, places)), np.empty((count, places)), rows.level[ends], np.empty(count, dtype=np.bool_),
    )  # fmt: skip
    compiled.gather_blocks(rows, done, ends, counted, made)
    return made


def cut(scans: ScanArrays, done: int, moments: Array, limit: int) -> tuple[Integers, bool]:
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
    count, whole = compiled.cut_blocks(scans.time, done, moments, limit, ends)
    return ends[:count], whole
