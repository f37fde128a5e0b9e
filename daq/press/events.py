"""Press events from temperatures: insertion, closing, opening, removal; causally, scan by scan.

The faces decide, each by the median of its sensors, so that a loose, dead or noisy one is outvoted:

* insertion: the lower face of a cool panel jumps on the hot lower plate while the upper face stays;
* closing: the upper face jumps towards the hot upper plate, tens of kelvins a second;
* opening: both faces, hot until then, start to fall at once; where both warm again within seconds, the press is
  closed as before, and a resin has cured;
* removal: the lower face loses its plate and falls, or the faces are cold again.

A limit switch or a pressure channel, where one is logged, goes before the temperatures
(`daq.press.wires`). The moment itself is placed between the scans by `daq.press.moments`, once enough
scans have followed to decide, at most 0.9 s later.
`find_moments` runs the same machine over a whole run and then looks at each moment with both sides known.

The recorder and the live sensor each run the machine (2026-11-25). The recorder's events, which the store keeps
with the scan that showed them, cut the runs and inform people. The live sensor cannot take those: it is a function
of header and scans alone, so that `predict`, an imported run, a sensor fed by hand and a restarted service answer
the same; it leaves out channels that stand still and follows what a run's header overrides, as the recorder does
not; and its steps need what is `pending` and the state at every scan, which no event holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.press.detector import ONE_STEP, OPENS_AFTER_S, UNSEEN_BEFORE_S, PressEventDetector
from daq.press.faces import columns_of, face_of
from daq.press.moments import (
    CLOSING_RAMPS_S,
    REACH_S,
    FaceHistory,
    Placed,
    insertion_moment,
    place_moment,
    usual_lag,
)
from daq.press.press_file import Press
from daq.press.wires import CLOSED, SILENT_S, closed_of
from daq.records import Array, EventSource, Moments, PressEvent, PressEventKind, Run

__all__ = ["PressEventDetector", "columns_of", "find_moments"]

# Numbers without another source were set by hand, 2026-11.

_CONCLUDED_S = UNSEEN_BEFORE_S + 0.1
"""An insertion so near to the closing was not seen: the machine has put it there. [s]"""
_STILL_OPEN_S = 0.8
"""Rows up to so long before the closing are looked at for a slow insertion. [s]"""
_SLOW_START_S, _SLOW_RISE_K, _SLOW_COLD_K = 2.0, 5.0, 1.0
"""A slow insertion: the lower face's start is its median over the first, it rises by the second in all, and has
not begun to while it is within the third. [s, K, K]"""
_SLOW_BEFORE_S, _SLOW_AFTER_S, _SLOW_NOTICED_S = 4.0, 3.0, 1.5
"""It is placed by the rows from and to so long before and after, as if noticed so long after. [s]"""
_ENDS_LIFTED_S = 15.0
"""A run that ends so soon after the panel seems to have left its plate ends with the removal. [s]"""
_PLACED_BEFORE_S, _PLACED_AFTER_S = 15.0, 0.6
"""Rows from and to so long before and after an event was noticed place it. [s]"""
_SCAN_S = 0.35
"""Between the scans of a stored run the machine looks at: enough to notice; all place the moment. [s]"""


def find_moments(run: Run, press: Press) -> Moments:
    """Return when a run's panel came, the press closed and opened, and the panel left. [s of the run]

    The column ``closed``, or what the press file names instead, decides where it holds values: closed from
    the time of its first 1, open from the first 0 after it. Else the faces' temperatures do, also for a
    moment that lies where the column is empty for longer than `SILENT_S`. Where the press closes on the same
    panel again, the pressing ends. A moment that did not happen is NaN; without any panel column and without
    such a wire all are, and `source` says ``unknown``. In a press of one state the panel is there from the first
    row.
    """
    if not press.has_states:
        return Moments(inserted_s=float(run.time_s[0]), source=EventSource.ONE_STATE)
    columns = columns_of(press)
    names = tuple(run.columns)
    top_names, bottom_names = columns.of_face(names)
    switch, wire = closed_of(run, press) or (None, EventSource.UNKNOWN)
    switched = switch is not None and bool(np.isfinite(switch).any())
    top, bottom = face_of(run, top_names), face_of(run, bottom_names)
    if not (np.isfinite(top).any() or np.isfinite(bottom).any() or switched):
        return Moments(source=EventSource.UNKNOWN)
    plate = face_of(run, tuple(n for n in names if n in columns.platens))
    noticed = _coarse(run.time_s, top, bottom, plate, switch if switched else None, press)
    found, again = noticed.at, noticed.again
    placed = _refined(found, run.time_s, top, bottom, plate)
    moments = {kind: placed[kind].middle if kind in placed else at for kind, at in found.items()}
    source, ramp = EventSource.TEMPERATURES, Moments().ramp_s
    if switched and switch is not None:
        moments.update(_switch_moments(run.time_s, switch, moments))
        source = wire
    elif PressEventKind.CLOSED in placed:
        ramp = placed[PressEventKind.CLOSED].ramp
    if again is not None:
        began = _began_to_close(again, run.time_s, top, bottom, plate)
        moments[PressEventKind.REMOVED] = max(began, moments[PressEventKind.OPENED])
    closed = moments.get(PressEventKind.CLOSED, math.nan)
    inserted = moments.get(PressEventKind.INSERTED, math.nan)
    if not math.isfinite(inserted) or closed - inserted <= _CONCLUDED_S:
        inserted = _slow_insertion(run.time_s, bottom, closed)
    return Moments(
        inserted_s=max(inserted, float(run.time_s[0])),
        closed_s=closed,
        opened_s=moments.get(PressEventKind.OPENED, math.nan),
        removed_s=moments.get(PressEventKind.REMOVED, math.nan),
        ramp_s=ramp,
        source=source,
        closed_again=again is not None,
    )


@dataclass
class _Noticed:
    """When the causal machine noticed each event of one pressing. [s]"""

    at: dict[PressEventKind, float] = field(default_factory=dict)
    again: float | None = None
    """When, if it did, the press closed on the same panel again."""

    def ends_before(self, event: PressEvent) -> bool:
        """Keep an event: the first of its kind, but the last opening. Return whether it is of the next panel."""
        if event.kind is PressEventKind.INSERTED and PressEventKind.CLOSED in self.at:
            return True
        if self._closes_again(event):
            self.again = event.noticed_s
        elif self.again is None:
            self._keep(event)
        elif event.kind is PressEventKind.OPENED:
            self.again = None  # sooner than a press closes: its switch flickered
        return False

    def ended(self, time_s: float) -> bool:
        """Whether the press has been closed on the same panel again for as long as closing takes."""
        return self.again is not None and time_s - self.again > CLOSING_RAMPS_S[-1]

    def _closes_again(self, event: PressEvent) -> bool:
        """Whether the press closes on a panel that it has pressed; faces that fall and warm show no opening."""
        if event.kind is not PressEventKind.CLOSED or PressEventKind.REMOVED in self.at:
            return False
        open_s = event.monotonic_s - self.at.get(PressEventKind.OPENED, math.inf)
        return open_s > (0.0 if event.source.is_wire else REACH_S)

    def _keep(self, event: PressEvent) -> None:
        if event.kind is PressEventKind.CLOSED:
            self.at.pop(PressEventKind.OPENED, None)
        if event.kind is PressEventKind.OPENED or event.kind not in self.at:
            left = event.kind is PressEventKind.REMOVED  # sure only once the sensors are cold
            self.at[event.kind] = event.monotonic_s if left else event.noticed_s


def _coarse(times: Array, top: Array, bottom: Array, plate: Array, switch: Array | None, press: Press) -> _Noticed:
    """Return when each event was noticed by the causal machine, at about 3 scans a second."""
    detector = PressEventDetector(press, placing=False)
    columns = columns_of(press)
    stand_in = {"top": _example(columns.top), "bottom": _example(columns.bottom)}
    noticed = _Noticed()
    for i in _looked_at(times, switch):
        values = {stand_in["top"]: float(top[i]), stand_in["bottom"]: float(bottom[i])}
        values |= {name: float(plate[i]) for name in columns.platens[:1]}
        if switch is not None:
            values[CLOSED] = float(switch[i])
        events = detector.update(float(times[i]), values)
        if any(noticed.ends_before(event) for event in events) or noticed.ended(times[i]):
            return noticed
    if detector.left_plate_s is not None and times[-1] - detector.left_plate_s < _ENDS_LIFTED_S:
        noticed.at[PressEventKind.REMOVED] = detector.left_plate_s  # the run ends with the panel's removal
    return noticed


def _looked_at(times: Array, switch: Array | None) -> Iterator[int]:
    """Yield the rows that the machine looks at: each at which the switch changes, and enough between."""
    last = -math.inf
    for i, time_s in enumerate(times.tolist()):
        if time_s - last >= _SCAN_S or (switch is not None and i and switch[i] != switch[i - 1]):
            last = time_s
            yield i


def _began_to_close(noticed: float, times: Array, top: Array, bottom: Array, plate: Array) -> float:
    """Return when a closing that was noticed had not begun yet, however long it took. [s]"""
    near = _window(times, noticed)
    hot = float(np.nanmedian(plate[near])) if np.isfinite(plate[near]).any() else math.nan
    faces = FaceHistory(times[near], top[near], bottom[near], hot)
    placed = place_moment(PressEventKind.CLOSED, faces, noticed, -math.inf, None)
    return (noticed if placed is None else min(noticed, placed.middle)) - float(CLOSING_RAMPS_S[-1])


def _slow_insertion(times: Array, bottom: Array, closed: float) -> float:
    """Return when the lower face began to warm, too slowly to be noticed; the first row where none shows it."""
    first = float(times[0])
    before = (times < (closed - _STILL_OPEN_S if closed == closed else times[-1])) & np.isfinite(bottom)
    if before.sum() < 4 or closed != closed:
        return first
    t, y = times[before], bottom[before]
    start = float(np.median(y[t < t[0] + _SLOW_START_S]))
    if y[-1] - start < _SLOW_RISE_K:
        return first
    cold = np.flatnonzero(y < start + _SLOW_COLD_K)
    place = int(cold[-1]) + 1 if len(cold) else 0
    if place <= 1 or place >= len(t):
        return first
    last, begun = closed - _STILL_OPEN_S, float(t[place])
    near = (times > begun - _SLOW_BEFORE_S) & (times < min(begun + _SLOW_AFTER_S, last))
    return insertion_moment(times[near], [bottom[near]], min(begun + _SLOW_NOTICED_S, last)).middle


def _example(patterns: Sequence[str]) -> str:
    """Return a name that matches the first pattern."""
    return patterns[0].replace("*", "1").replace("?", "1") if patterns else "none"


def _window(times: Array, noticed: float) -> slice:
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    first = int(np.searchsorted(times, noticed - _PLACED_BEFORE_S))
    return slice(first, int(np.searchsorted(times, noticed + max(_PLACED_AFTER_S, ONE_STEP * step), side="right")))


def _refined(
    found: Mapping[PressEventKind, float], times: Array, top: Array, bottom: Array, plate: Array
) -> dict[PressEventKind, Placed]:
    """Place all events, the sensors' lag learned from insertion and opening together."""
    after: dict[PressEventKind, float] = {}

    def place(kind: PressEventKind, lag: Array | None) -> Placed | None:
        near = _window(times, found[kind])
        hot = float(np.nanmedian(plate[near])) if np.isfinite(plate[near]).any() else math.nan
        faces = FaceHistory(times[near], top[near], bottom[near], hot)
        return place_moment(kind, faces, found[kind], after.get(kind, -math.inf), lag)

    if PressEventKind.CLOSED in found:
        closing = place(PressEventKind.CLOSED, None)
        closed = found[PressEventKind.CLOSED] if closing is None else closing.middle
        after[PressEventKind.OPENED] = closed + OPENS_AFTER_S
    lag = usual_lag()
    for kind in (PressEventKind.INSERTED, PressEventKind.OPENED):
        if kind in found and (first := place(kind, None)) is not None:
            lag = lag + first.lag_misfit
    placed = {kind: place(kind, lag) for kind in found}
    return {kind: value for kind, value in placed.items() if value is not None}


def _switch_moments(
    times: Array, switch: Array, moments: Mapping[PressEventKind, float]
) -> dict[PressEventKind, float]:
    """Return closing and opening by the contract's rule; as `moments` where the switch was silent meanwhile."""
    rows = np.flatnonzero(np.isfinite(switch))
    closed = switch[rows] > 0.5
    first = int(np.argmax(closed)) if closed.any() else len(rows)
    last = first + int(np.argmin(closed[first:])) if not closed[first:].all() else len(rows)

    def moment(kind: PressEventKind, place: int) -> float:
        before = int(rows[place - 1]) if place > 0 else -1
        row = int(rows[place]) if place < len(rows) else len(times)
        begin = float(times[before]) if before >= 0 else -math.inf
        end = float(times[row]) if row < len(times) else math.inf
        by_switch, by_faces = (end if end < math.inf else math.nan), moments.get(kind, math.nan)
        silent = row - before > 1 and end - begin > SILENT_S
        return by_faces if silent and begin < by_faces <= end else by_switch

    return {
        PressEventKind.CLOSED: moment(PressEventKind.CLOSED, first),
        PressEventKind.OPENED: moment(PressEventKind.OPENED, last),
    }
