"""What channels of a place say together, and how they differ: scatter, a rim that falls behind the middle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, Moments, Run
from softsensor.signals.robust import nan_mean

RIM, INNER = 0.8, 0.6
"""Of the way from a face's middle to its outermost sensor: from the first on sensors lie at its rim, up to the
second within. By hand, 2026-11."""


def place_scatter(run: Run, channels: Sequence[str], rows: np.ndarray) -> float:
    """Return how single channels scatter about their place's mean, offsets removed. [K]"""
    if len(channels) < 2:
        return float("nan")
    values = np.stack([run.columns[c][rows] for c in channels], axis=1)
    rest = values - nan_mean(values)[:, None]
    rest = rest - np.nanmean(rest, axis=0)
    return float(np.sqrt(np.nanmean(rest**2) * len(channels) / (len(channels) - 1)))


def measured_core(press: Press, run: Run) -> Array:
    """Return the mean of the channels at the core that nothing else sees, NaN where none reads (rows). [°C]"""
    channels = [run.columns[c] for c in press.at_core(run)]
    return nan_mean(np.array(channels).reshape(-1, len(run.time_s)).T)


def rim_falls(press: Press, run: Run, moments: Moments, excluded: frozenset[str]) -> float:
    """Return by how much rim sensors fall against central ones in the course of a run; NaN without places. [K]

    Constant offsets drop out: the last quarter of the run is compared with its first tenth. Sensors count as
    rim beyond four fifths of the largest distance from the middle of all places, as central within three.
    """
    rows = _panel_rows(run, moments)
    changes = []
    for sensor in press.sensor:
        columns = run.matching(sensor.columns)
        if sensor.role != "fit" or sensor.position_mm is None or len(columns) != len(sensor.position_mm):
            continue
        places = np.array(sensor.position_mm)
        away = np.abs(places - (places.max(axis=0) + places.min(axis=0)) / 2).max(axis=1)
        far, near = away >= RIM * away.max(), away <= INNER * away.max()
        groups = []
        for group in (far, near):
            chosen = [c for c, inside in zip(columns, group, strict=True) if inside and c not in excluded]
            if chosen:
                groups.append(nan_mean(np.stack([run.columns[c][rows] for c in chosen], axis=1)))
        if len(groups) == 2:
            gap = groups[0] - groups[1]
            n = len(gap)
            changes.append(float(np.nanmean(gap[-n // 4 :]) - np.nanmean(gap[: max(n // 10, 1)])))
    return float(np.mean(changes)) if changes else float("nan")


def _panel_rows(run: Run, moments: Moments) -> np.ndarray:
    start = moments.inserted_s if np.isfinite(moments.inserted_s) else run.time_s[0]
    end = moments.removed_s - 0.5 if np.isfinite(moments.removed_s) else run.time_s[-1]
    return (run.time_s >= start) & (run.time_s <= end)
