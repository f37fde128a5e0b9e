"""Single bad cells: a reading that jumps for one scan or two and comes back, which no model has.

They go before anything is judged by the readings (`softsensor.signals.screen`): one cell in a hundred that is 80 K
too high made half of the channels of a sound press "loose".
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, Moments, Run
from softsensor.signals.robust import Flags, nan_median, robust_sd

# Numbers without another source were set by hand, 2026-11.

SPIKE_K, SPIKE_WINDOW, SPIKE_RATIO = 10.0, 5, 10.0
"""A boundary cell so far from the median of the cells around it, and so many times as far as usual, was not the
platen: tons of metal do not move by 10 K for one scan or two. Nor does a face while the press stands still."""
OUTLIER_K = 1.0
"""A single cell that departs from its face by more than this, and by `OUTLIER_SD`, is dropped. [K]"""
OUTLIER_SD = 6.0
"""Of its channel and of its row. [standard deviations]"""


class Spikes(NamedTuple):
    """Cells of one channel that were left out."""

    column: str
    cells: int


def without_spikes(press: Press, run: Run) -> tuple[Run, tuple[Spikes, ...]]:
    """Leave out single cells of the measured boundaries that jump and come back; say which.

    A platen has one channel, and a single cell of 150 K in it moves h_p_c by a third.

    Parameters
    ----------
    press
        With the run's overrides applied, or without: only its boundaries' columns are read.
    run
        Is not changed.
    """
    columns, found = dict(run.columns), []
    for name in dict.fromkeys(end.column for _, end in press.boundary.ends if end.column is not None):
        if name in columns and (far := _jumps(run.columns[name])).any():
            columns[name] = np.where(far, np.nan, run.columns[name])
            found.append(Spikes(name, int(far.sum())))
    return (replace(run, columns=columns) if found else run), tuple(found)


def without_jumps(time_s: Array, values: Array, moments: Moments) -> Array:
    """Leave out cells of a face that jump and come back, of all its channels or of the only one (rows, channels).

    Held against readings between the same two moments of the press, on either side: at a moment faces jump. At the
    run's end against those before.
    """
    moved = np.array([moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s])
    middle, bad, side = nan_median(values), np.zeros(len(time_s), dtype=bool), SPIKE_WINDOW // 2
    read = np.flatnonzero(np.isfinite(middle))
    between = np.split(read, np.searchsorted(time_s[read], np.sort(moved[np.isfinite(moved)])))
    for rows in between:
        judged = slice(side, None if rows is between[-1] else -side)
        bad[rows[judged]] = _jumps(middle[rows])[judged]
    return np.where(bad[:, None], np.nan, values)


def without_single_cells(values: Array) -> Array:
    """Leave out cells of one channel that jump away from its face and come back (rows, channels). [°C]"""
    apart = values - nan_median(values)[:, None]
    return np.where(_far(np.stack([one - _running_median(one) for one in apart.T], axis=1)), np.nan, values)


def without_far_cells(values: Array) -> Array:
    """Leave out cells that depart from their face, for how long they may (rows, channels). [°C]"""
    apart = values - nan_median(values)[:, None]
    return np.where(_far(apart - nan_median(apart.T)[None, :]), np.nan, values)


def _far(apart: Array) -> Flags:
    """Return which departures are far beyond what is usual in their channel and in their row (rows, channels)."""
    usual = np.maximum(robust_sd(apart.T)[None, :], robust_sd(apart)[:, None])
    return np.abs(apart) > np.maximum(OUTLIER_SD * usual, OUTLIER_K)


def _jumps(values: Array) -> Flags:
    """Return which of a series' values jump and come back (rows)."""
    off = np.abs(values - _running_median(values))
    known = off[np.isfinite(off)]
    return off > max(SPIKE_K, SPIKE_RATIO * float(np.median(known)) if len(known) else 0.0)


def _running_median(values: Array) -> Array:
    """Return the median of each value and its neighbours, `SPIKE_WINDOW` of them; beyond an end they come again.

    The end itself does not: it would be the middle of its own neighbours, whatever it is. NaN where there is no
    value, and in all of a series of fewer.
    """
    there, found = np.flatnonzero(np.isfinite(values)), np.full(len(values), np.nan)
    if len(there) >= SPIKE_WINDOW:
        padded = np.pad(values[there], SPIKE_WINDOW // 2, mode="reflect")
        found[there] = np.median(np.lib.stride_tricks.sliding_window_view(padded, SPIKE_WINDOW), axis=1)
    return found
