"""What channels read falsely, found by comparison with their neighbours on the same face, before any fit.

First single bad cells go (`softsensor.signals.spikes`), then whole channels, then for how long the others depart.

Several thermocouples sit at one place (a face) and see the same temperature. Each is held against the median of
its face; the worst is left out, and the rest is looked at again. A channel that departs alone is faulty; two that
depart alike are a pattern over the face (a rim loss, a cold zone), which is physics and stays in. One screen for
fit and diagnosis since 2026-11-22; on the 66 runs of the reference campaigns the two before it found the same
channels but for one run, where a swapped channel and a loose one fell alike and the diagnosis kept both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, InputError, Moments, Run
from daq.words import Message, say
from softsensor.effects.vocabulary import place_words
from softsensor.signals.instrument import BEFORE_SWITCH_S, CHANNEL_GAIN, LAG_GONE_S, LOGGER_STEP_K
from softsensor.signals.robust import Flags, nan_median
from softsensor.signals.spikes import (
    SPIKE_K,
    SPIKE_RATIO,
    SPIKE_WINDOW,
    without_far_cells,
    without_jumps,
    without_single_cells,
)

# Numbers without another source were set by hand, 2026-11.

LIMIT_K = 1.5
"""Smallest departure that counts (rms over the quiet rows, offset and gain removed). Neighbours on one face differ
by 0.15 K; a channel that is loose, drifts or is swapped departs by 8 to 33 K in the reference campaigns. [K]"""
LIMIT_RATIO = 5.0
"""It must also exceed the usual departure on its face so many times: a thin panel under an uneven press."""
LEAST_CHANNELS = 3
"""A face needs so many channels for one of them to depart from the others."""
LARGEST_GAIN = 3.0 * CHANNEL_GAIN
"""So much of a departure may be the channel's gain: three deviations."""
ALIKE, ALIKE_SHARE = 0.85, 0.15
"""Correlation from which two departures are one pattern, and the least share of its energy the other must have."""
FOLLOWS_RATIO, FOLLOWS_K = 3.0, LOGGER_STEP_K
"""A channel follows another face where it departs from it less than so many times what that face's own do, which
counts as no less than the logger's step. [-, K]"""
KINK_SHARE = 0.15
"""A channel drifts where a level and one straight line leave less than this share of its departure."""
RECURRING = 0.5
"""Share of runs from which a channel's fault belongs to the press and not to a mishap of one run."""
LEAST_ROWS, LEAST_SHARE = 3, 0.05
"""A channel with fewer values, or values in fewer of the rows, is empty."""


class FaultKind(StrEnum):
    """What is wrong with a channel."""

    EMPTY = "empty"
    LOOSE = "loose"
    DRIFTING = "drifting"
    SWAPPED = "swapped"


@dataclass(frozen=True)
class ChannelFault:
    """A channel of one run that is left out, and why."""

    column: str
    kind: FaultKind
    departure_K: float  # noqa: N815
    """Root mean square from the median of its face. [K]"""
    follows: str = ""
    """The place it follows, where swapped."""

    @property
    def message(self) -> Message:
        """What a person should read."""
        return say(
            f"channel-{self.kind}", column=self.column, kelvin=self.departure_K, place=place_words(self.follows)
        )


def no_panel_channel(press: Press, run: Run) -> InputError:
    """Return the refusal of a run without a usable channel of the panel: which run, and which the press names."""
    named = tuple(p for s in press.sensor if s.role == "fit" for p in s.columns)
    source = run.source or run.name
    return InputError(say("run-no-panel-channel", run=source, named=named, count=len(named)))


def faces_of(press: Press, run: Run) -> tuple[dict[str, list[str]], tuple[ChannelFault, ...]]:
    """Return the channels at each place that hold values, and those that hold none."""
    faces: dict[str, list[str]] = {}
    for column, sensor in press.sensors_of(run).items():
        faces.setdefault(sensor.label, []).append(column)
    least = max(LEAST_ROWS, LEAST_SHARE * len(run.time_s))
    empty = [c for columns in faces.values() for c in columns if np.isfinite(run.columns[c]).sum() < least]
    full = {face: [c for c in columns if c not in empty] for face, columns in faces.items()}
    return full, tuple(ChannelFault(c, FaultKind.EMPTY, 0.0) for c in empty)


class Screened(NamedTuple):
    """A run without cells that cannot be believed, and what else cannot."""

    run: Run
    faults: tuple[ChannelFault, ...]
    dropped: int
    """Cells of other channels that were left out."""


def screened(press: Press, run: Run, moments: Moments) -> Screened:
    """Leave out what the channels of a run's faces read falsely, but the channels that hold nothing."""
    faces = faces_of(press, run)[0]
    sound = _with_cells(run, faces, lambda values: without_jumps(run.time_s, values, moments))
    sound = _with_cells(sound, _judged(faces), without_single_cells)
    faults = faulty_channels(press, sound, moments)
    bad = {fault.column for fault in faults}
    kept = {face: [c for c in columns if c not in bad] for face, columns in faces.items()}
    sound = _with_cells(sound, _judged(kept), without_far_cells)
    lost = [np.isfinite(run.columns[c]) & ~np.isfinite(sound.columns[c]) for cs in kept.values() for c in cs]
    return Screened(sound, faults, int(np.sum(lost)))


def _judged(faces: Mapping[str, Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the faces that have channels enough for one of them to depart from the others."""
    return {face: columns for face, columns in faces.items() if len(columns) >= LEAST_CHANNELS}


def _with_cells(run: Run, faces: Mapping[str, Sequence[str]], of: Callable[[Array], Array]) -> Run:
    """Return a run with the values of each face (rows, channels) as `of` has them."""
    columns = dict(run.columns)
    for named in faces.values():
        if named:
            columns |= zip(named, of(np.stack([columns[c] for c in named], axis=1)).T, strict=True)
    return replace(run, columns=columns)


def faulty_channels(press: Press, run: Run, moments: Moments) -> tuple[ChannelFault, ...]:
    """Return a run's channels that read something else than their face, or that came off where there are two."""
    rows = quiet_rows(run.time_s, moments)
    kept, faults = faces_of(press, run)[0], []
    values = {c: run.columns[c][rows] for columns in kept.values() for c in columns}
    while (worst := _worst(run.time_s[rows], kept, values)) is not None:
        face, fault = worst
        kept[face].remove(fault.column)
        faults.append(fault)
    faults += _came_off(kept, values, run.time_s[rows], moments)
    return tuple(sorted(faults, key=lambda fault: fault.column))


def _came_off(
    kept: Mapping[str, Sequence[str]], values: Mapping[str, Array], time_s: Array, moments: Moments
) -> Iterator[ChannelFault]:
    """Yield the channel of a pair that jumps away from the other between two scans, for good.

    No middle says which of two is right, but no face jumps while the press stands still: where one does and the
    other, which has followed the panel, does not, that one came off. At a moment of the press a sound one jumps
    away from one that reads nothing of the panel.
    """
    for columns in kept.values():
        if len(columns) != LEAST_CHANNELS - 1:
            continue
        pair = np.stack([values[c] for c in columns], axis=1)
        read = np.isfinite(pair).all(axis=1)
        times, pair = time_s[read], pair[read]
        for rows in _without_a_moment(times, moments):
            one = _jumps_away(pair[rows])
            if one is not None and np.ptp(pair[:, 1 - one]) > SPIKE_K:
                departs = departure(pair[:, one], pair[:, 1 - one])
                yield ChannelFault(columns[one], FaultKind.LOOSE, _rms(departs))
                break


def _without_a_moment(times: Array, moments: Moments) -> list[Array]:
    """Return the rows between two moments of the press, apart where more than one scan is missing between them."""
    moved = np.array([moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s])
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > 2.0 * usual) + 1
    ends = np.union1d(np.searchsorted(times, moved[np.isfinite(moved)]), gaps)
    return np.split(np.arange(len(times)), ends)


def _jumps_away(pair: Array) -> int | None:
    """Return which of two channels jumps away from the other for good (rows, 2); None where none does."""
    apart, steps = pair[:, 0] - pair[:, 1], np.abs(np.diff(pair, axis=0))
    jumps = np.abs(np.diff(apart))
    if len(jumps) < 2 * SPIKE_WINDOW:
        return None
    at = int(np.argmax(jumps[SPIKE_WINDOW - 1 : 1 - SPIKE_WINDOW])) + SPIKE_WINDOW
    limit = max(SPIKE_K, SPIKE_RATIO * float(np.median(jumps)))
    moved = np.median(apart[at : at + SPIKE_WINDOW]) - np.median(apart[at - SPIKE_WINDOW : at])
    one = int(np.argmax(steps[at - 1]))
    return one if abs(moved) > limit and steps[at - 1, 1 - one] < limit < steps[at - 1, one] else None


def recurring(faults: Sequence[tuple[ChannelFault, ...]]) -> dict[str, FaultKind]:
    """Return the channels that are faulty in at least half of the runs, with what they are."""
    count: dict[str, list[FaultKind]] = {}
    for run in faults:
        for fault in run:
            count.setdefault(fault.column, []).append(fault.kind)
    needed = max(2.0 if len(faults) > 2 else 1.0, RECURRING * len(faults))
    return {c: max(set(k), key=k.count) for c, k in sorted(count.items()) if len(k) >= needed}


def quiet_rows(time_s: Array, moments: Moments) -> Flags:
    """Rows with the panel in the press and away from switches, where neighbours on a face must agree."""
    quiet = np.ones(len(time_s), dtype=bool)
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        if np.isfinite(moment):
            quiet &= (time_s < moment - BEFORE_SWITCH_S) | (time_s > moment + LAG_GONE_S)
    for moment, before in ((moments.inserted_s, True), (moments.removed_s, False)):
        if np.isfinite(moment):
            quiet &= (time_s > moment) if before else (time_s < moment)
    return quiet if quiet.sum() > 10 else np.ones(len(time_s), dtype=bool)


def _worst(
    time_s: Array, kept: Mapping[str, Sequence[str]], values: Mapping[str, Array]
) -> tuple[str, ChannelFault] | None:
    """Return the channel that departs furthest from its face, and that face; None where all agree."""
    found = []
    middles = {
        face: nan_median(np.stack([values[c] for c in columns], axis=1))
        for face, columns in kept.items()
        if len(columns) >= LEAST_CHANNELS
    }
    for face, middle in middles.items():
        apart = {c: departure(values[c], middle) for c in kept[face]}
        size = {c: _rms(d) for c, d in apart.items()}
        limit = max(LIMIT_K, LIMIT_RATIO * float(np.median(list(size.values()))))
        for column in (c for c in kept[face] if size[c] > limit):
            others = {f: m for f, m in middles.items() if f != face}
            follows = next((f for f, m in others.items() if _follows(values[column], m, kept[f], values)), "")
            if follows:
                found.append((face, ChannelFault(column, FaultKind.SWAPPED, size[column], follows)))
            elif not any(_alike(apart[column], apart[o]) for o in kept[face] if o != column):
                kind = FaultKind.DRIFTING if _drifts(time_s, apart[column]) else FaultKind.LOOSE
                found.append((face, ChannelFault(column, kind, size[column])))
    return max(found, key=lambda one: one[1].departure_K, default=None)


def departure(values: Array, middle: Array) -> Array:
    """Return how a channel departs from its face, its own offset and a small gain removed (rows). [K]"""
    difference = values - middle
    ok = np.isfinite(difference)
    if ok.sum() < 3:
        return np.full(len(values), np.nan)
    difference = difference - np.median(difference[ok])
    spread = middle - middle[ok].mean()
    variance = float(spread[ok] @ spread[ok])
    if variance > 0:
        gain = float(spread[ok] @ difference[ok]) / variance
        difference = difference - np.clip(gain, -LARGEST_GAIN, LARGEST_GAIN) * spread
    return np.asarray(difference)


def _rms(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good * good))) if len(good) else 0.0


def _follows(value: Array, middle: Array, columns: Sequence[str], values: Mapping[str, Array]) -> bool:
    """Return whether a channel departs from another face no more than that face's own channels do."""
    usual = max(float(np.median([_rms(departure(values[c], middle)) for c in columns])), FOLLOWS_K)
    return _rms(departure(value, middle)) < FOLLOWS_RATIO * usual


def _alike(a: Array, b: Array) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    x, y = a[both], b[both]
    size = float(x @ x * (y @ y)) ** 0.5
    return size > 0 and float(x @ y) / size > ALIKE and float(y @ y) > ALIKE_SHARE * float(x @ x)


def _drifts(time_s: Array, apart: Array) -> bool:
    """Return whether a departure is a level that starts to drift at some moment."""
    good = np.isfinite(apart)
    t, d = time_s[good], apart[good]
    left = min(_left_by_kink(t, d, begin) for begin in np.linspace(t[0], t[-1], 12)[:-3])
    return left < KINK_SHARE * float(np.mean((d - d.mean()) ** 2))


def _left_by_kink(t: Array, d: Array, begin: float) -> float:
    """Mean square left by a level that starts to drift at `begin`."""
    rows = np.stack([np.ones_like(t), np.clip(t - begin, 0.0, None)], axis=1)
    rest = d - rows @ np.linalg.lstsq(rows, d, rcond=None)[0]
    return float(np.mean(rest**2))
