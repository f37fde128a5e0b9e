"""Channels that do not tell the truth, found by comparison with their neighbours on the same place.

Several thermocouples sit at one place (a face). Each is compared with the median of the others after its
constant offset is taken out. A channel that departs from them alone is faulty; two that depart alike are
a pattern over the face (a rim loss, a cold zone), which is physics and left in. This happens before any
fit, channel by channel, so that a loose thermocouple never bends a coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.pressfile import Press
from daq.records import Array, Moments, Run
from softsensor.evidence import nan_mean, nan_median

SUSPECT_K = 1.2
"""Smallest departure (rms over the run) that counts. [K]"""
SUSPECT_RATIO = 5.0
"""It must also exceed the usual scatter of a channel about its place by this factor."""
ALIKE = 0.85
"""Correlation from which two departures are the same pattern."""
RECURRING = 0.5
"""Share of runs from which a channel's fault belongs to the press and not to a mishap of one run."""


@dataclass(frozen=True)
class ChannelFault:
    """A faulty channel of one run."""

    column: str
    kind: str
    """``swapped``, ``drifting`` or ``loose``."""
    departure_K: float  # noqa: N815
    """Root mean square of its distance from the place's other channels. [K]"""
    partner: str = ""


def faulty_channels(press: Press, run: Run, moments: Moments) -> tuple[ChannelFault, ...]:
    """Return the faulty panel channels of a run; places with fewer than three channels tell nothing."""
    rows = _panel_rows(run, moments)
    places: dict[str, list[str]] = {}
    for column, sensor in press.sensors_of(run).items():
        if np.isfinite(run.columns[column][rows]).sum() > 5:
            places.setdefault(sensor.label, []).append(column)
    places = {label: columns for label, columns in places.items() if len(columns) >= 3}
    departures: dict[str, Array] = {}
    middles: dict[str, Array] = {}
    for label, columns in places.items():
        values = np.stack([run.columns[c][rows] for c in columns], axis=1)
        middles[label] = nan_median(values)
        for c, v in zip(columns, values.T, strict=True):
            rest = v - middles[label]
            departures[c] = rest - np.nanmedian(rest)
    if not departures:
        return ()
    sizes = {c: float(np.sqrt(np.nanmean(d**2))) for c, d in departures.items()}
    limit = max(SUSPECT_K, SUSPECT_RATIO * float(np.median(list(sizes.values()))))
    suspects = [c for c, size in sizes.items() if size > limit]
    faults = []
    for column in suspects:
        label = next(k for k, v in places.items() if column in v)
        if any(_alike(departures[column], departures[o]) for o in places[label] if o != column):
            continue
        faults.append(_judge(column, label, run, rows, places, middles, departures, sizes))
    return tuple(sorted(faults, key=lambda f: f.column))


def recurring(faults: Sequence[tuple[ChannelFault, ...]]) -> dict[str, str]:
    """Return the channels that are faulty in at least half of the runs, with what they are."""
    count: dict[str, list[str]] = {}
    for run in faults:
        for fault in run:
            count.setdefault(fault.column, []).append(fault.kind)
    needed = max(2.0 if len(faults) > 2 else 1.0, RECURRING * len(faults))
    return {c: max(set(k), key=k.count) for c, k in sorted(count.items()) if len(k) >= needed}


def _panel_rows(run: Run, moments: Moments) -> np.ndarray:
    start = moments.inserted_s if np.isfinite(moments.inserted_s) else run.time_s[0]
    end = moments.removed_s - 0.5 if np.isfinite(moments.removed_s) else run.time_s[-1]
    return (run.time_s >= start) & (run.time_s <= end)


def _alike(a: Array, b: Array) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    x, y = a[both], b[both]
    size = float(x @ x * (y @ y)) ** 0.5
    return size > 0 and float(x @ y) / size > ALIKE and float(y @ y) > 0.15 * float(x @ x)


def _judge(
    column: str,
    label: str,
    run: Run,
    rows: np.ndarray,
    places: Mapping[str, Sequence[str]],
    middles: Mapping[str, Array],
    departures: Mapping[str, Array],
    sizes: Mapping[str, float],
) -> ChannelFault:
    values = run.columns[column][rows]
    for other, middle in middles.items():
        if other == label:
            continue
        rest = values - middle
        rest = rest - np.nanmedian(rest)
        if np.sqrt(np.nanmean(rest**2)) < 0.35 * sizes[column]:
            partners = [c for c in places[other] if sizes[c] > 0.4 * sizes[column]]
            return ChannelFault(column, "swapped", sizes[column], partners[0] if partners else "")
    t = run.time_s[rows]
    d = departures[column]
    good = np.isfinite(d)
    t, d = t[good], d[good]
    begins = np.linspace(t[0], t[-1], 12)[:-3]
    straight = min(_kinked(t, d, b) for b in begins)
    kind = "drifting" if straight < 0.15 * float(np.mean((d - d.mean()) ** 2)) else "loose"
    return ChannelFault(column, kind, sizes[column])


def _kinked(t: Array, d: Array, begin: float) -> float:
    """Mean square left by a level that starts to drift at `begin`."""
    rows = np.stack([np.ones_like(t), np.clip(t - begin, 0.0, None)], axis=1)
    rest = d - rows @ np.linalg.lstsq(rows, d, rcond=None)[0]
    return float(np.mean(rest**2))


def place_scatter(run: Run, channels: Sequence[str], rows: np.ndarray) -> float:
    """Return how single channels scatter about their place's mean, offsets removed. [K]"""
    if len(channels) < 2:
        return float("nan")
    values = np.stack([run.columns[c][rows] for c in channels], axis=1)
    rest = values - nan_mean(values)[:, None]
    rest = rest - np.nanmean(rest, axis=0)
    return float(np.sqrt(np.nanmean(rest**2) * len(channels) / (len(channels) - 1)))


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
        far, near = away >= 0.8 * away.max(), away <= 0.6 * away.max()
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
