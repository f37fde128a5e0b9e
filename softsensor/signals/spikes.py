"""Single cells of a platen that jump and come back: no model has them, and nothing else stands beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, Run

# Numbers without another source were set by hand, 2026-11.

SPIKE_K, SPIKE_WINDOW, SPIKE_RATIO = 10.0, 5, 10.0
"""A boundary cell so far from the median of the cells around it, and so many times as far as usual, was not the
platen: tons of metal do not move by 10 K for one scan or two."""


class Spikes(NamedTuple):
    """Cells of one channel that were left out."""

    column: str
    cells: int


def without_spikes(press: Press, run: Run) -> tuple[Run, tuple[Spikes, ...]]:
    """Leave out single cells of the measured boundaries that jump and come back; say which.

    Face channels are held against their neighbours (`collect_signals`); a platen has one channel, and a single
    cell of 150 K in it moves h_p_c by a third.

    Parameters
    ----------
    press
        With the run's overrides applied, or without: only its boundaries' columns are read.
    run
        Is not changed.
    """
    columns, found = dict(run.columns), []
    for name in dict.fromkeys(end.column for _, end in press.boundary.ends if end.column is not None):
        if name not in columns:
            continue
        values = run.columns[name].copy()
        there = np.flatnonzero(np.isfinite(values))
        if len(there) < SPIKE_WINDOW:
            continue
        off = np.abs(values[there] - _running_median(values[there]))
        far = there[off > max(SPIKE_K, SPIKE_RATIO * float(np.median(off)))]
        if len(far):
            values[far] = np.nan
            columns[name] = values
            found.append(Spikes(name, len(far)))
    return (replace(run, columns=columns) if found else run), tuple(found)


def _running_median(values: Array) -> Array:
    """Return the median of each value and its neighbours, `SPIKE_WINDOW` of them; beyond an end they come again.

    The end itself does not: it would be the middle of its own neighbours, whatever it is.
    """
    padded = np.pad(values, SPIKE_WINDOW // 2, mode="reflect")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, SPIKE_WINDOW), axis=1))
