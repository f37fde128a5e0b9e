"""Whether what a run says of itself can be true: how it begins, and readings that stand still.

A sensor that believes a wrong header, a run that begins in mid-press or a logger that repeats itself tells a wrong
core within a narrow band; here such a run is told from a sound one before its numbers are used.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from daq.records import Array
from softsensor import observer_kernels as loops
from softsensor.observer_kernels_blocks import note_moves

if TYPE_CHECKING:
    from softsensor.observer_blocks import Scans

START_K = 6.0
"""A face this far from the header's start temperature, with the other one farther, is no fresh panel's: a face in
the open press warms by so much in 1.5 s at most, where it does not touch a plate. [K]"""
DOUBTED_K = 1.0
"""From here on the header's start temperature is known no better than it is off. [K]"""
FROZEN_S, FROZEN_K = 3.0, 3.0
"""A face that stands still to the last digit for so long has fallen silent where its model moves by so much; a
logger whose channels all do has. [s, K]"""
FEWEST_CHANNELS = 6
"""A logger with fewer channels may well repeat itself."""


def contradiction(level: Array, start_C: float) -> str:
    """Say why faces that read `level` (M) are not those of a panel at its start; empty where they may be. [°C]

    Every face with a reading must be far off: the lower one warms from the first moment on.
    """
    off = start_error(level, start_C)
    if abs(off) <= START_K:
        return ""
    return f"sensors read {start_C + off:.0f} °C where the header has the panel start at {start_C:.0f} °C"


def start_error(level: Array, start_C: float) -> float:
    """Return how far the face nearer to the header's start temperature is off it, 0 if none is heard. [K]"""
    off = level[np.isfinite(level)] - start_C
    if not len(off) or not math.isfinite(start_C):
        return 0.0
    return float(off[np.abs(off).argmin()])


class Stillness:
    """Since when channels have repeated themselves to the last digit.

    Parameters
    ----------
    place
        Face of each panel channel (K).
    faces, platens
        How many faces (M) and platen channels (B) there are.
    """

    def __init__(self, place: loops.Integers, faces: int, platens: int) -> None:
        self._place = np.concatenate([np.full(platens, -1), place])
        self._last = np.full(len(self._place), np.nan)
        self._since = np.full(len(self._place), -math.inf)
        self._since_face = np.full(faces, math.inf)
        self._silenced = np.full(faces, math.nan)
        self._any_still = False

    def frozen(self, time_s: float, readings: Array) -> bool:
        """Note a scan of platen and panel channels (B + K); return whether the whole logger stands still."""
        newest, oldest = note_moves(time_s, readings, self._place, self._last, self._since, self._since_face)
        self._any_still = time_s - oldest > FROZEN_S
        return bool(len(readings) >= FEWEST_CHANNELS and time_s - newest > FROZEN_S)

    def silence(self, scans: Scans, *, frozen: bool) -> bool:
        """Strike out the scans of faces that stand still where they should move; return whether any are new.

        `frozen` says that the whole logger stands still.
        """
        if not self._any_still:
            return False
        new, now = False, float(scans.time[-1])
        for face, since in enumerate(self._since_face.tolist()):
            if now - since <= FROZEN_S:
                continue
            known = self._silenced[face] == since
            if known or frozen or scans.foretold_move(face, since) > FROZEN_K:
                scans.silence(face, since)
                self._silenced[face] = since
                new = new or not known
        return new
