"""Fewer points for a chart without losing a peak in any column."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from daq.records import Array


def decimate(
    time_s: Array, columns: Mapping[str, Array], max_points: int | None
) -> tuple[Array, dict[str, Array]]:
    """Return at most `max_points` rows (at least 4) that span the same values.

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
    if max_points is None or rows <= max(max_points, 4):
        return time_s, dict(columns)
    buckets = max(max_points // 2, 2)
    edges = np.linspace(0, rows, buckets + 1).astype(int)
    ends = np.stack([edges[:-1], edges[1:] - 1], axis=1).ravel()
    return time_s[ends], {name: _extremes(values, edges) for name, values in columns.items()}


def _extremes(values: Array, edges: np.ndarray[tuple[int], np.dtype[np.int_]]) -> Array:
    kept = np.full(2 * (len(edges) - 1), np.nan)
    for i, (start, stop) in enumerate(pairwise(edges)):
        piece = values[start:stop]
        good = np.flatnonzero(np.isfinite(piece))
        if len(good):
            ends = sorted((good[piece[good].argmin()], good[piece[good].argmax()]))
            kept[2 * i : 2 * i + 2] = piece[ends]
    return kept
