"""The two faces of the panel as their sensors show them: which columns, and the median nobody can fool."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.press.press_file import At, Press
from daq.records import Array, Run, matches

# Numbers without another source were set by hand, 2026-11.

RATTLE_S = 10.0
"""How long a sensor's restlessness is remembered: longer than a closing, shorter than a pressing. [s]"""
LOW_C, HIGH_C = -60.0, 500.0
"""A panel's sensor outside this is broken: colder than any hall, hotter than charred wood. [°C]"""
RATTLE_K, RATTLE_RATIO = 0.4, 5.0
"""A sensor is left out where its second differences exceed both together: so many kelvins, and so many times what
the middle sensor of its face does. [K]"""
STEP_FADES_S = 10.0
"""How fast the step of a sensor that dropped out or returned is let go. [s]"""
BLIND_S = 3.0
"""A face unread for longer may have moved in any way: a stored run's gap is bridged by a straight line up to this,
and without a usable sensor for longer the press's state is unknown. [s]"""


@dataclass(frozen=True)
class PressColumns:
    """Which columns hold what, by patterns of the press file."""

    top: tuple[str, ...]
    bottom: tuple[str, ...]
    platens: tuple[str, ...]

    def of_face(self, names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the names that lie on the upper and on the lower face."""
        return _matching(names, self.top), _matching(names, self.bottom)


def _matching(names: Sequence[str], patterns: Sequence[str]) -> tuple[str, ...]:
    return tuple(n for n in names if matches(n, patterns))


def columns_of(press: Press) -> PressColumns:
    """Return the patterns of face and platen columns of a press file."""
    faces: dict[str, list[str]] = {"top": [], "bottom": []}
    for sensor in press.sensor:
        if sensor.role != "fit" or isinstance(sensor.at, At):
            continue
        layer, _, place = sensor.at.rpartition(".")
        if layer in press.panel_layers and place in faces:
            faces[place] += sensor.columns
    return PressColumns(tuple(faces["top"]), tuple(faces["bottom"]), press.platens)


def middle(values: list[float]) -> float:
    """Return the median of a few numbers; `statistics.median` takes ten times as long."""
    values.sort()
    half = len(values) // 2
    return values[half] if len(values) % 2 else (values[half - 1] + values[half]) / 2


class Face:
    """The median of a face's sensors, without a step where a sensor drops out or returns."""

    def __init__(self) -> None:
        self.before: Mapping[str, float] = {}
        self.shift = 0.0
        self.level = math.nan
        self.members: Sequence[str] = ()
        """Sensors of the last scan that were there in the one before as well."""
        self.motion: dict[str, tuple[float, float, float]] = {}
        """Of each sensor seen before, those of the last scan aside: last value, last step, how much it rattles.
        [°C, K, K]"""
        self.moved: Sequence[str] = ()
        """Sensors of the last scan; in their order the three numbers of each below."""
        self.last: list[float] = []
        self.steps: list[float] = []
        self.rattles: list[float] = []

    def update(self, values: Mapping[str, float], elapsed_s: float) -> float:
        """Return the face's temperature after a scan's usable values, which are kept as they are."""
        values = self._quiet(values, elapsed_s)
        if not values:
            self.before, self.members, self.level = {}, (), math.nan
            return math.nan
        names: Sequence[str] = tuple(values)
        if self.shift:
            self.shift *= math.exp(-elapsed_s / STEP_FADES_S)
        if names != self.members:
            names = self._common(names)
        self.level = middle([values[c] for c in names]) + self.shift
        self.members, self.before = names, values
        return self.level

    def _common(self, names: Sequence[str]) -> Sequence[str]:
        """Return the sensors that were there before, all where none was; they make no step of their own."""
        common = tuple(name for name in names if name in self.before)
        if not common:
            self.shift, common = 0.0, tuple(names)
        elif set(common) != set(self.members):
            self.shift = self.level - middle([self.before[c] for c in common])
        return common

    def _quiet(self, values: Mapping[str, float], elapsed_s: float) -> Mapping[str, float]:
        """Leave out sensors that rattle far more than the others of the face."""
        names, now = tuple(values), list(values.values())
        if names != self.moved:
            self._take(names, now)
        share = min(1.0, elapsed_s / RATTLE_S)
        keep, before = 1.0 - share, self.steps
        self.steps = [value - last for value, last in zip(now, self.last, strict=True)]
        moves = zip(self.rattles, self.steps, before, strict=True)
        self.rattles = rattles = [keep * rattle + share * abs(new - old) for rattle, new, old in moves]
        self.last = now
        if len(now) < 3 or (most := max(rattles)) <= RATTLE_K:
            return values
        limit = RATTLE_K + RATTLE_RATIO * middle(rattles.copy())
        if most <= limit:
            return values
        return {n: v for (n, v), rattle in zip(values.items(), rattles, strict=True) if rattle <= limit}

    def _take(self, names: Sequence[str], now: Sequence[float]) -> None:
        """Go on with other sensors than at the last scan, each from where it was seen last."""
        self.motion |= dict(zip(self.moved, zip(self.last, self.steps, self.rattles, strict=True), strict=True))
        known = [self.motion.get(name, (value, 0.0, 0.0)) for name, value in zip(names, now, strict=True)]
        self.moved = names
        self.last, self.steps, self.rattles = ([one[part] for one in known] for part in range(3))


def face_of(run: Run, names: Sequence[str]) -> Array:
    """Return the median over columns, short gaps bridged; NaN where nothing is known."""
    if not names:
        return np.full(len(run.time_s), np.nan)
    table = np.array([_bridged(run.time_s, _plausible(run.columns[n])) for n in names])
    table = table[np.isfinite(table).any(axis=1)]
    if len(table) >= 3 and table.shape[1] >= 10:
        rattle = np.nan_to_num(np.nanmean(np.abs(np.diff(table, 2, axis=1)), axis=1), nan=np.inf)
        table = table[rattle <= RATTLE_K + RATTLE_RATIO * float(np.median(rattle))]
    if not len(table):
        return np.full(len(run.time_s), np.nan)
    lost = np.isnan(table).all(axis=0)
    if not np.isnan(table).any():
        return np.asarray(np.median(table, axis=0))
    table[:, lost] = 0.0
    out = np.asarray(np.nanmedian(table, axis=0))
    out[lost] = np.nan
    return out


def _plausible(values: Array) -> Array:
    return np.asarray(np.where((values > LOW_C) & (values < HIGH_C), values, np.nan))


def _bridged(times: Array, values: Array) -> Array:
    """Fill gaps up to `BLIND_S` by a straight line."""
    good = np.isfinite(values)
    if good.all() or good.sum() < 2:
        return values
    filled = np.interp(times, times[good], values[good])
    place = np.clip(np.searchsorted(times[good], times), 1, good.sum() - 1)
    gap = times[good][place] - times[good][place - 1]
    inside = (times >= times[good][0]) & (times <= times[good][-1])
    return np.asarray(np.where(good | (inside & (gap <= BLIND_S)), filled, np.nan))
