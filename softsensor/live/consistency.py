"""Whether what a run says of itself can be true: how it begins, how its panel came, and readings that stand still.

With a wrong header, a run that begins in mid-press or a logger that repeats itself, a live sensor would report a
wrong core within a narrow band; here such a run is recognised before its numbers are used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from daq.press.detector import HAND_C
from daq.press.faces import BLIND_S
from daq.records import LONGEST_WAIT_S, USUAL_WAIT_S, WAIT_SD_S, Array
from softsensor.effects.parameters import uniform_sd
from softsensor.live.blocks import SPARSE_S, ScanArrays
from softsensor.live.channel_steps import Changes, Integers, note_changes
from softsensor.live.validity import Invalid, InvalidReason
from softsensor.signals.instrument import RAMP_S
from softsensor.signals.robust import Flags

# Numbers without another source were set by hand, 2026-11.

NOT_FRESH_K = 6.0
"""Faces of which the colder one is this far from the header's start temperature are no fresh panel's: a face in
the open press warms by so much in 1.5 s at most, where it does not touch a plate. [K]"""
START_OFF_K = 1.0
"""From here on the header's start temperature is known no better than it is off. [K]"""
COLD_K = 5.0
"""A lower face counts as cold up to what hands and room bring it to, or so much above the header's start. [K]"""
SLOPE_S = 1.3
"""So long a face is watched for its slope. [s]"""
UPPER_K, UPPER_S = 3.0, 3.0
"""Where the upper face of a panel in the open press warms by so much, it does within about a second; a hand that
held it or a slow sensor leave the moment open by so much. [K, s]"""
PLATE_K_ROOT_S, AIR_K_ROOT_S = 50.0, 6.0
"""By how much a face in the open press warms at most, on the plate and under it. [K/√s]"""
FROZEN_K = 3.0
"""A face that stands still to the last digit for `BLIND_S` has fallen silent where its model moves by so much; a
logger whose channels all do has. [K]"""
FEWEST_CHANNELS = 6
"""A logger with fewer channels may well repeat itself."""


def contradiction(off: float, start_C: float) -> Invalid | None:
    """Return why faces so far off are not those of a panel that starts so, None where they may be. [K, °C]"""
    if abs(off) <= NOT_FRESH_K:
        return None
    arguments = {"measured_C": round(start_C + off, 1), "header_C": start_C}
    return Invalid(InvalidReason.START_TEMPERATURE_CONTRADICTED, arguments)


def start_error(level: Array, start_C: float) -> float:
    """Return how far the colder face is off the header's start temperature, 0 if none is read. [K]

    `level` is what the faces read (M). Hands and the lower plate warm a face, nothing cools it.
    """
    off = level[np.isfinite(level)] - start_C
    return float(off.min()) if len(off) and math.isfinite(start_C) else 0.0


@dataclass(frozen=True)
class FaceReadings:
    """What the faces have read so far."""

    time: Array
    """When each scan was taken (N). [s]"""
    level: Array
    """What each face read, NaN where nothing did (N, M). [°C]"""
    lower: int
    """Place of the lower face, -1 for none."""

    def since(self, begin: float) -> tuple[Array, Array, Array]:
        """Return times and what lower and upper face read after a time, NaN where there is no such face."""
        late = self.time > begin
        time, level = self.time[late], self.level[late]
        silent = np.full(len(time), math.nan)
        low = level[:, self.lower] if self.lower >= 0 else silent
        return time, low, next((level[:, m] for m in range(level.shape[1]) if m != self.lower), silent)


@dataclass(frozen=True)
class Insertion:
    """When the panel came to lie in the press."""

    at: float
    """[s]"""
    sd: float = 0.0
    """0 where the lower face shows it. [s]"""


def place_insertion(
    scans: FaceReadings, start_C: float, at: float, closed: float, now: float, opened: float = -math.inf
) -> Insertion:
    """Place an insertion that the lower face does not show, since its sensors were silent or are missing.

    It lies after the last cold reading of the lower face, or the last one of the panel before, and before its
    first hot one or the closing. In between, a lower face first read on the plate shows by its slope how long it
    has lain there (temperatures rise with the root of time: age = rise / (2 slope)); else an upper face that warms
    well before the closing shows it, else the usual wait.

    Parameters
    ----------
    scans
        What the faces have read so far.
    start_C
        The panel's start temperature. [°C]
    at
        When the detector has it. [s]
    closed
        When the press closed, infinite where it has not. [s]
    now
        Time of the scan at which it was found. [s]
    opened
        When the press opened on the panel before. [s]
    """
    time, low, high = scans.since(opened)
    read = time[np.isfinite(low) & (time < at)]
    watched = _unbroken(opened, read)
    if at - watched <= SPARSE_S:
        return Insertion(at)  # hot as it may be from the panel before, the face has been watched all along
    hot, cold = low >= hot_from(start_C), low < hot_from(start_C)
    begins = max(float(time[cold].max(initial=-math.inf)), watched)
    hot &= (time > begins) & (time < closed - RAMP_S)
    joined = time[hot][np.diff(time[hot], prepend=-math.inf) > SPARSE_S]
    ends = min(float(joined[-1]) if len(joined) else math.inf, closed, now)
    if ends - begins <= SPARSE_S:
        return Insertion(min(at, ends))
    earliest, found = max(begins, ends - LONGEST_WAIT_S), Insertion(ends - USUAL_WAIT_S, WAIT_SD_S)
    there = hot & (time >= ends) & (time < ends + SLOPE_S)
    resting = time[(high < start_C + UPPER_K) & (time < ends)]
    if there.sum() > 1 and (age := _age(time[there], low[there] - start_C)) < USUAL_WAIT_S:
        found = Insertion(ends - age, 0.3 + 0.35 * age)
    elif len(resting) and earliest < resting[-1] < ends - SLOPE_S:
        found = Insertion(float(resting[-1]), UPPER_S)
    return Insertion(min(max(found.at, earliest), ends), min(found.sd, uniform_sd(ends - earliest)))


def hot_from(start_C: float) -> float:
    """Return the temperature from which on a face is too hot for hand and room. [°C]"""
    return max(HAND_C, start_C + COLD_K)


def _unbroken(begin: float, read: Array) -> float:
    """Return until when a face was read without a gap from a time on. [s]"""
    if not math.isfinite(begin):
        return -math.inf
    breaks = np.flatnonzero(np.diff(read, prepend=begin) > SPARSE_S)
    chain = read[: breaks[0]] if len(breaks) else read
    return float(chain[-1]) if len(chain) else begin


def _age(time: Array, rise: Array) -> float:
    """Return for how long a face has lain on the plate at its first reading, as its rise and slope show. [s]"""
    slope, middle = np.polyfit(time - time.mean(), rise, 1)
    if slope <= 0.0 or middle <= 0.0:
        return math.inf
    return max(float(middle / (2.0 * slope) - (time.mean() - time[0])), 0.0)


@dataclass(frozen=True)
class StartError:
    """How far off the header's start temperature a panel was when first read. [K]"""

    off: float
    certain: float
    """What of it is certain: a face read some time after the panel came may have warmed since."""
    faces: int
    """How many faces it rests on."""


def first_error(scans: FaceReadings, start_C: float, came: Insertion, closed: float) -> StartError:
    """Judge by each face when first read; that counts which may have warmed least, of such alike the colder one.

    A face that is colder than the header says proves it wrong, whatever the others do. Arguments as
    of `place_insertion`.
    """
    begin = max(int(np.searchsorted(scans.time, came.at, "right")) - 1, 0)
    errors = []
    for m in range(scans.level.shape[1]):
        read = begin + np.flatnonzero(np.isfinite(scans.level[begin:, m]))
        if not len(read) or scans.time[read[0]] > closed:
            continue
        since, off = float(scans.time[read[0]]) - came.at, float(scans.level[read[0], m]) - start_C
        rate = PLATE_K_ROOT_S if m == scans.lower else AIR_K_ROOT_S
        warmed = rate * math.sqrt(since + came.sd) if since > 0.0 and off > 0.0 else 0.0
        errors.append((warmed, off))
    if not errors:
        return StartError(0.0, 0.0, 0)
    warmed, off = min(errors)
    return StartError(off, off if off < 0.0 else max(off - warmed, 0.0), len(errors))


class Stillness:
    """Since when channels have repeated themselves to the last digit.

    Parameters
    ----------
    place
        Face of each panel channel (K).
    faces, platens
        How many faces (M) and platen channels (B) there are.
    """

    def __init__(self, place: Integers, faces: int, platens: int) -> None:
        of_face = np.concatenate([np.full(platens, -1), place])
        channels = len(of_face)
        never = np.full(channels, -math.inf)
        self._changes = Changes(of_face, np.full(channels, np.nan), never, np.full(faces, math.inf))
        self._silenced = np.full(faces, math.nan)
        self._any_still = self._any_struck = False

    def frozen(self, time_s: float, readings: Array) -> bool:
        """Note a scan of platen and panel channels (B + K); return whether the whole logger stands still."""
        newest, oldest = note_changes(self._changes, time_s, readings)
        self._any_still = time_s - oldest > BLIND_S
        return bool(len(readings) >= FEWEST_CHANNELS and time_s - newest > BLIND_S)

    def unread(self, *, frozen: bool) -> Flags | None:
        """Return which platen and panel channels only repeat themselves (B + K), None where none is known to.

        `frozen` says that the whole logger stands still, so that all do. Else those do of a face that stood still
        where it should have moved, and has not moved since.
        """
        if not frozen and not self._any_struck:
            return None
        struck = np.append(self._silenced == self._changes.since_face, [False])  # for platens, which are no face
        return np.asarray(struck[self._changes.place]) | frozen

    def silence(self, scans: ScanArrays, *, frozen: bool) -> bool:
        """Strike out the scans of faces that stand still where they should move; return whether any are new.

        `frozen` says that the whole logger stands still.
        """
        if not self._any_still:
            return False
        new, now = False, float(scans.time[-1])
        for face, since in enumerate(self._changes.since_face.tolist()):
            if now - since <= BLIND_S:
                continue
            known = self._silenced[face] == since
            if known or frozen or scans.expected_move(face, since) > FROZEN_K:
                scans.silence(face, since)
                self._silenced[face], self._any_struck = since, True
                new = new or not known
        return new
