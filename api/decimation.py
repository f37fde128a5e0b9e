"""Numbers as JSON carries them, and fewer points for a chart without losing a peak in any column."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from daq.qualities import OTHERS, QUALITY, quality_text, row_faults
from daq.records import Array, Quality, Run


def number_or_none(value: float | None) -> float | None:
    """Return a number JSON can carry: None for NaN and infinities."""
    return None if value is None or not math.isfinite(value) else float(value)


def column_values(values: Array) -> list[float | None]:
    """Return a column for JSON, NaN as null, rounded to 0.1 mK."""
    return [None if not math.isfinite(v) else round(v, 4) for v in values.tolist()]


def decimate(
    time_s: Array, columns: Mapping[str, Array], max_points: int | None
) -> tuple[Array, dict[str, Array]]:
    """Return at most `max_points` rows (two at least) that span the same values.

    The rows are cut into equal buckets. Each gives two rows, at the times of its first and last
    row; every column puts its lowest and highest value of the bucket there, in the order in which
    they occurred. What is missing is skipped; a bucket without any value stays missing.

    Examples
    --------
    >>> peak = np.zeros(100)
    >>> peak[37] = 5.0
    >>> time_s, columns = decimate(np.arange(100.0), {"top_1": peak}, 10)
    >>> len(time_s), float(columns["top_1"].max())
    (10, 5.0)
    """
    rows = len(time_s)
    if max_points is None or rows <= max(max_points, 2):
        return time_s, dict(columns)
    buckets = max(max_points // 2, 1)
    edges = np.linspace(0, rows, buckets + 1).astype(int)
    ends = np.stack([edges[:-1], edges[1:] - 1], axis=1).ravel()
    return time_s[ends], {name: _extremes(values, edges) for name, values in columns.items()}


def kept_qualities(run: Run, time_s: Array, columns: Mapping[str, Array]) -> dict[str, tuple[str, ...]]:
    """Return a run's column of qualities at the rows that are left; a value that is shown is no missing one."""
    faults = row_faults(run)
    if faults is None or len(time_s) == len(run.time_s):
        return dict(run.texts)
    kept = []
    for place, row in enumerate(np.searchsorted(run.time_s, time_s)):
        shown = {name for name, values in columns.items() if values[place] == values[place]}
        named = {n: q for n, q in faults[row].items() if q.usable or n not in shown}
        rest = named.get(OTHERS, Quality.GOOD)
        if not rest.usable:
            named = {n: named.get(n, rest) for n in columns if n not in shown}
        kept.append(quality_text(named))
    return {QUALITY: tuple(kept)} if any(kept) else {}


def _extremes(values: Array, edges: np.ndarray[tuple[int], np.dtype[np.int_]]) -> Array:
    kept = np.full(2 * (len(edges) - 1), np.nan)
    for i, (start, stop) in enumerate(pairwise(edges)):
        piece = values[start:stop]
        good = np.flatnonzero(np.isfinite(piece))
        if len(good):
            ends = sorted((good[piece[good].argmin()], good[piece[good].argmax()]))
            kept[2 * i : 2 * i + 2] = piece[ends]
    return kept
