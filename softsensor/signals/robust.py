"""Means and medians over channels of which some may be missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.records import Array
from softsensor.effects.parameters import QUARTILE

Flags = NDArray[np.bool_]


def nan_mean(values: Array) -> Array:
    """Return the mean over the last axis of what is there, NaN where nothing is: (…, n) to (…)."""
    good = np.isfinite(values)
    count = good.sum(axis=-1)
    total = np.where(good, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def nan_median(values: Array) -> Array:
    """Return the median over the last axis of what is there, NaN where nothing is: (…, n) to (…)."""
    ordered = np.sort(values, axis=-1)
    count = np.isfinite(values).sum(axis=-1)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[..., None], axis=-1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[-1] - 1)[..., None], axis=-1)[..., 0]
    return np.where(count > 0, (low + high) / 2, np.nan)


def robust_sd(away: Array) -> Array:
    """Return the standard deviation of normal values about zero from their median distance to it: (…, n) to (…).

    NaN where nothing is.
    """
    return np.asarray(nan_median(np.abs(away)) / QUARTILE)


def channel_scatter(values: Array, *, own_offsets: bool) -> Array:
    """Standard deviation over channels in each row (rows, channels), their own offsets taken out if asked for."""
    good = np.isfinite(values)
    apart = np.where(good, values - nan_mean(values)[:, None], 0.0)
    if own_offsets:
        apart = np.where(good, apart - apart.sum(axis=0) / np.maximum(good.sum(axis=0), 1), 0.0)
    return np.asarray(np.sqrt((apart**2).sum(axis=1) / np.maximum(good.sum(axis=1), 1)))
