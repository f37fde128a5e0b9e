"""Numbers as JSON carries them, and fewer points for a chart without losing a peak in any column."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from daq.records import Array

Rows: TypeAlias = np.ndarray[tuple[int], np.dtype[np.int_]]


def number_or_none(value: float | None) -> float | None:
    """Return a number JSON can carry: None for NaN and infinities."""
    return None if value is None or not math.isfinite(value) else float(value)


def column_values(values: Array) -> list[float | None]:
    """Return a column for JSON, NaN as null, rounded to 0.1 mK."""
    return [None if not math.isfinite(v) else round(v, 4) for v in values.tolist()]


def kept_rows(columns: Sequence[Array], rows: int, max_points: int | None) -> Rows:
    """Return the numbers of at most `max_points` rows (two at least) that keep every column's peaks.

    The rows are cut into buckets of one length. Of each bucket stay the rows with the lowest and the highest
    value of each column, whole and at their own times, and the first row where a column has no value at all.
    There are as many buckets as leave no more rows than asked for. Below two rows for each column even one
    bucket has too many: then its rows are thinned evenly, and peaks may be lost.

    Examples
    --------
    >>> peak = np.zeros(100)
    >>> peak[37] = 5.0
    >>> kept_rows([peak], 100, 10).tolist()
    [0, 20, 37, 40, 60, 80]
    """
    if max_points is None or rows <= max(max_points, 2):
        return np.arange(rows)
    buckets = max(max_points // 2, 1)
    while len(kept := _extreme_rows(columns, rows, buckets)) > max_points and buckets > 1:
        buckets = max(min(buckets - 1, buckets * max_points // len(kept)), 1)
    if len(kept) > max_points:
        kept = kept[np.linspace(0, len(kept) - 1, max_points).astype(int)]
    return kept


def decimate(
    time_s: Array, columns: Mapping[str, Array], max_points: int | None
) -> tuple[Array, dict[str, Array]]:
    """Return times and columns at the rows that `kept_rows` chooses."""
    kept = kept_rows(list(columns.values()), len(time_s), max_points)
    return time_s[kept], {name: values[kept] for name, values in columns.items()}


def _extreme_rows(columns: Sequence[Array], rows: int, buckets: int) -> Rows:
    width = -(-rows // buckets)
    starts = np.arange(0, rows, width)
    kept = [starts[:0]]
    for values in columns:
        known = np.isfinite(values)
        for worst, extreme in ((np.inf, np.argmin), (-np.inf, np.argmax)):  # missing is never an extreme
            padded = np.full(len(starts) * width, worst)
            padded[:rows] = np.where(known, values, worst)
            kept.append(starts + extreme(padded.reshape(-1, width), axis=1))
    return np.unique(np.concatenate(kept))
