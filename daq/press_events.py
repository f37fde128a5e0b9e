"""Press events from temperatures: insertion, closing, opening, removal; causally, scan by scan.

The faces decide, each by the median of its sensors, so that a loose, dead or noisy one is outvoted:

* insertion: the lower face of a cool panel jumps on the hot lower plate while the upper face stays;
* closing: the upper face jumps towards the hot upper plate, tens of kelvins a second;
* opening: both faces, hot until then, start to fall at once;
* removal: the lower face loses its plate and falls, or the faces are cold again.

A limit switch, where one is logged, goes before the temperatures. The moment itself is placed between
the scans by `daq.press_moments`, once enough scans have followed to tell, at most 0.9 s later.
`find_moments` runs the same machine over a whole run and then looks at each moment with both sides known.
"""

from __future__ import annotations

import fnmatch
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from daq.press_moments import Placed, closing_moment, insertion_moment, opening_moment, usual_lag
from daq.pressfile import At, Press
from daq.records import Array, Moments, PressEvent, PressEventKind, PressState, Run

SWITCH = "closed"
_MEMORY_S = 12.0
_LOOK_BACK_S = 0.9
"""Changes are judged over about this time, at least one scan. [s]"""
_SETTLE_S = 0.65
"""Scans awaited after a closing or opening is plain, to place it. [s]"""
_HAND_C = 38.0
"""Hands and room never bring a sensor above this. [°C]"""
_RATTLE_S = 10.0
"""How long a sensor's restlessness is remembered. [s]"""
_LOW_C, _HIGH_C = -60.0, 500.0
"""A panel's sensor outside this is broken. [°C]"""
_BLIND_S = 3.0
"""Without a usable sensor this long, the state is unknown. [s]"""


@dataclass(frozen=True)
class Columns:
    """Which columns tell what, by patterns of the press file."""

    top: tuple[str, ...]
    bottom: tuple[str, ...]
    platens: tuple[str, ...]

    def of_face(self, names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the names that lie on the upper and on the lower face."""
        return _matching(names, self.top), _matching(names, self.bottom)


def _matching(names: Sequence[str], patterns: Sequence[str]) -> tuple[str, ...]:
    return tuple(n for n in names if any(fnmatch.fnmatchcase(n, p) for p in patterns))


def columns_of(press: Press) -> Columns:
    """Return the patterns of face and platen columns of a press file."""
    faces: dict[str, list[str]] = {"top": [], "bottom": []}
    for sensor in press.sensor:
        if sensor.role != "fit" or isinstance(sensor.at, At):
            continue
        layer, _, place = sensor.at.rpartition(".")
        if layer in press.panel_layers and place in faces:
            faces[place] += sensor.columns
    ends = (press.boundary.bottom, press.boundary.top)
    platens = tuple(b.column for b in ends if b.kind == "measured" and b.column)
    return Columns(tuple(faces["top"]), tuple(faces["bottom"]), platens)


class _Face:
    """The median of a face's sensors, without a step where a sensor drops out or returns."""

    def __init__(self) -> None:
        self.before: dict[str, float] = {}
        self.shift = 0.0
        self.level = math.nan
        self.members: frozenset[str] = frozenset()
        self.motion: dict[str, tuple[float, float]] = {}
        self.rattle: dict[str, float] = {}

    def update(self, values: Mapping[str, float], elapsed_s: float) -> float:
        """Return the face's temperature after a scan's usable values."""
        values = self._quiet(values, elapsed_s)
        if not values:
            self.before, self.level = {}, math.nan
            return math.nan
        common = frozenset(values).intersection(self.before) or frozenset(values)
        self.shift *= math.exp(-elapsed_s / 10.0)
        if self.level != self.level or not common <= self.before.keys():
            self.shift = 0.0
        elif common != self.members:
            self.shift = self.level - median(self.before[c] for c in common)
        self.level = median(values[c] for c in common) + self.shift
        self.members, self.before = common, dict(values)
        return self.level

    def _quiet(self, values: Mapping[str, float], elapsed_s: float) -> Mapping[str, float]:
        """Leave out sensors that rattle far more than the others of the face."""
        share = min(1.0, elapsed_s / _RATTLE_S)
        for name, value in values.items():
            last, slope = self.motion.get(name, (value, 0.0))
            bend = abs(value - last - slope)
            self.motion[name] = (value, value - last)
            self.rattle[name] = (1.0 - share) * self.rattle.get(name, 0.0) + share * bend
        if len(values) < 3:
            return values
        limit = 0.4 + 5.0 * median(self.rattle[n] for n in values)
        return {n: v for n, v in values.items() if self.rattle[n] <= limit} or values


@dataclass(frozen=True)
class _Row:
    time: float
    top: float
    bottom: float
    plate: float
    values: Mapping[str, float]


class PressEventDetector:
    """Scans in, press events out. It knows no clock but the scans' own times.

    Parameters
    ----------
    press
        Tells which columns lie on which face and which are platens.
    inserted
        The first scan lies at the insertion or later: start in the open press, not idle. None: find out.
    """

    def __init__(self, press: Press, inserted: bool | None = None) -> None:
        self._columns = columns_of(press)
        self._rows: deque[_Row] = deque()
        self._top, self._bottom = _Face(), _Face()
        self._names: tuple[str, ...] = ()
        self._top_names: tuple[str, ...] = ()
        self._bottom_names: tuple[str, ...] = ()
        self._platen_names: tuple[str, ...] = ()
        self._state = PressState.OPEN if inserted else PressState.IDLE
        self._pending: tuple[PressEventKind, float] | None = None
        self._switch: bool | None = None
        self._seen = -math.inf
        self._since = -math.inf
        self._first = math.nan
        self._bottom_high = -math.inf
        self._was_closed = False
        self._lag: Array | None = None
        self.disagreement: str | None = None
        """Why switch and temperatures contradict each other, for the journal; None while they agree."""

    @property
    def state(self) -> PressState | None:
        """What the press is doing; None where nothing usable has been seen for 3 s."""
        if self._switch is None and (not self._rows or self._rows[-1].time - self._seen > _BLIND_S):
            return None
        return self._state

    @property
    def pending(self) -> PressEventKind | None:
        """An event that is plain already while its moment is still being placed."""
        return None if self._pending is None else self._pending[0]

    def update(self, time_s: float, values: Mapping[str, float]) -> list[PressEvent]:
        """Take one scan (unusable values NaN or left out); return what it brought to light."""
        self._append(time_s, values)
        switch = values.get(SWITCH, math.nan)
        if switch == switch:
            return self._by_switch(time_s, switch > 0.5)
        if self._pending is not None:
            return self._place(time_s)
        kind = self._look()
        if kind is None:
            return []
        self._pending = (kind, time_s)
        return self._place(time_s)

    def _append(self, time_s: float, values: Mapping[str, float]) -> None:
        names = tuple(values)
        if names != self._names:
            self._names = names
            self._top_names, self._bottom_names = self._columns.of_face(names)
            self._platen_names = tuple(n for n in names if n in self._columns.platens)
        elapsed = time_s - self._rows[-1].time if self._rows else 0.0
        top = {n: v for n in self._top_names if _LOW_C < (v := values[n]) < _HIGH_C}
        bottom = {n: v for n in self._bottom_names if _LOW_C < (v := values[n]) < _HIGH_C}
        platens = [v for n in self._platen_names if (v := values[n]) == v]
        plate = median(platens) if platens else (self._rows[-1].plate if self._rows else math.nan)
        row = _Row(
            time_s,
            self._top.update(top, elapsed),
            self._bottom.update(bottom, elapsed),
            plate,
            {**top, **bottom},
        )
        if top or bottom:
            self._seen = time_s
        if self._first != self._first:
            self._first = time_s
        self._rows.append(row)
        while self._rows[0].time < time_s - _MEMORY_S and len(self._rows) > 4:
            self._rows.popleft()

    # --- limit switch ---------------------------------------------------------------------------

    def _by_switch(self, time_s: float, closed: bool) -> list[PressEvent]:
        """Closing and opening by the switch; insertion and removal still by temperatures."""
        before, self._switch = self._switch, closed
        events: list[PressEvent] = []
        if closed and self._state is not PressState.CLOSED:
            if self._state is PressState.IDLE:
                events.append(self._event(PressEventKind.INSERTED, time_s, time_s))
            events.append(self._event(PressEventKind.CLOSED, time_s, time_s, "limit switch"))
        elif not closed and self._state is PressState.CLOSED:
            events.append(self._event(PressEventKind.OPENED, time_s, time_s, "limit switch"))
        elif self._pending is not None:
            events += self._place(time_s)
        elif before is not None:
            kind = self._look()
            if kind in (PressEventKind.INSERTED, PressEventKind.REMOVED):
                self._pending = (kind, time_s)
                events += self._place(time_s)
        self._compare(time_s, closed)
        return events

    def _compare(self, time_s: float, closed: bool) -> None:
        row = self._rows[-1]
        self.disagreement = None
        if time_s - self._since < 5.0 or row.plate - row.top != row.plate - row.top:
            return
        reach = (row.top - 25.0) / max(row.plate - 25.0, 30.0)
        if closed and reach < 0.2:
            self.disagreement = "the limit switch says closed, but the upper face is cold; check switch and panel"
        elif not closed and not self._was_closed and reach > 0.6 and self._state is PressState.OPEN:
            self.disagreement = "the limit switch says open, but the upper face is hot; check it"

    # --- temperatures ---------------------------------------------------------------------------

    def _look(self) -> PressEventKind | None:
        """Say what is plain at the newest scan, if anything."""
        now, then = self._rows[-1], self._row_before(self._look_back)
        if then is None:
            return None
        if self._state is PressState.CLOSED:
            return PressEventKind.OPENED if self._opened(now, then) else None
        if self._closed(now, then):
            return PressEventKind.CLOSED
        if self._state is PressState.IDLE:
            return PressEventKind.INSERTED if self._inserted(now, then) else None
        return PressEventKind.REMOVED if self._removed(now) else None

    @property
    def _look_back(self) -> float:
        step = self._rows[-1].time - self._rows[-2].time if len(self._rows) > 1 else 0.0
        return max(_LOOK_BACK_S, 1.01 * step)

    def _row_before(self, seconds: float) -> _Row | None:
        """Return the newest row at least `seconds` before the newest, or the first where all are younger."""
        limit = self._rows[-1].time - seconds
        found = None
        for row in self._rows:
            if row.time > limit:
                break
            found = row
        if found is None and len(self._rows) > 1:
            return self._rows[0]
        return found

    def _closed(self, now: _Row, then: _Row) -> bool:
        """The upper face jumps towards the plate (the lower one, where no upper sensor works)."""
        if now.top == now.top and then.top == then.top:
            gap = _gap(now.plate, then.top)
            if gap < 25.0 or now.top - then.top < max(6.0, 0.11 * gap) or now.top < _HAND_C:
                return False
            return self._together(now, then, self._top_names, 0.11 * gap)
        if self._state is PressState.IDLE or now.bottom != now.bottom or then.bottom != then.bottom:
            return False
        gap = _gap(now.plate, then.bottom)
        expected = self._slope_before(then) * (now.time - then.time)
        return gap > 15.0 and now.bottom - then.bottom - max(expected, 0.0) > max(5.0, 0.2 * gap)

    def _slope_before(self, then: _Row) -> float:
        """Return how fast the lower face moved in the 2 s before a row. [K/s]"""
        early = [r for r in self._rows if then.time - 2.0 <= r.time <= then.time and r.bottom == r.bottom]
        if len(early) < 2:
            return 0.0
        return (early[-1].bottom - early[0].bottom) / (early[-1].time - early[0].time)

    def _opened(self, now: _Row, then: _Row) -> bool:
        """Both faces fall at once; one may stay where panel and plates had become equally hot."""
        if now.time - self._since < 1.5:
            return False
        top, bottom = then.top - now.top, then.bottom - now.bottom
        if top == top and bottom == bottom:
            ratio = bottom > 0.2 * top
            beyond = top > 4.0 and top > 1.7 * max(then.plate - then.top, 0.0) + 2.0
            sinking = top > 25.0
            return (top > 1.8 and bottom > 0.35 and ratio) or beyond or sinking
        fall = top if top == top else bottom
        return fall > (3.0 if top == top else 2.0)

    def _inserted(self, now: _Row, then: _Row) -> bool:
        """The lower face leaves hand and room temperature, all its sensors together, the upper stays."""
        if now.bottom != now.bottom or then.bottom != then.bottom:
            return self._upper_only(now, then)
        early = self._row_before(9.0) or then
        if now.bottom < _HAND_C:
            return False
        return self._jumped(now, then, 0.04) or (early.bottom < _HAND_C and self._jumped(now, early, 0.08))

    def _jumped(self, now: _Row, then: _Row, share: float) -> bool:
        """Whether the lower face alone rose by a share of its distance to the plate."""
        gap, rise = _gap(now.plate, then.bottom), now.bottom - then.bottom
        if not (gap > 25.0 and rise > max(4.0, share * gap)):
            return False
        if now.top - then.top > 0.5 * rise:
            return False
        return self._together(now, then, self._bottom_names, 0.5 * share * gap)

    def _upper_only(self, now: _Row, then: _Row) -> bool:
        return now.top == now.top and now.top > 1.3 * _HAND_C and then.top == then.top

    def _together(self, now: _Row, then: _Row, names: Sequence[str], least: float) -> bool:
        """Whether most sensors of a face rose from `then` to `now`, not a few that a hand touched."""
        rises = [now.values[n] - then.values[n] for n in names if n in now.values and n in then.values]
        return not rises or sum(r > 0.4 * least for r in rises) >= 0.7 * len(rises)

    def _removed(self, now: _Row) -> bool:
        """The lower face falls against its trend, or both faces are cold again."""
        level = now.bottom if now.bottom == now.bottom else now.top
        if level != level:
            return False
        self._bottom_high = max(self._bottom_high, level)
        gap = _gap(now.plate, 25.0)
        if self._bottom_high > 25.0 + 0.25 * gap and level < 25.0 + 0.12 * gap:
            return True
        if now.bottom != now.bottom or now.time - self._since < 4.0:
            return False
        then, early = self._row_before(max(2.5, self._look_back)), self._row_before(6.5)
        if then is None or early is None or then.bottom != then.bottom or early.bottom != early.bottom:
            return False
        if then.time - early.time < 2.0 or early.time < self._since + 0.5:
            return False
        trend = (then.bottom - early.bottom) / (then.time - early.time)
        fall = then.bottom + trend * (now.time - then.time) - now.bottom
        if not (fall > 3.0 and then.bottom - now.bottom > 2.5 and now.bottom > _HAND_C):
            return False
        return self._together(then, now, self._bottom_names, 5.0)

    # --- the moment -----------------------------------------------------------------------------

    def _place(self, time_s: float) -> list[PressEvent]:
        """Report the pending event once enough scans followed to say when it was."""
        if self._pending is None:
            return []
        kind, noticed = self._pending
        step = self._rows[-1].time - self._rows[-2].time if len(self._rows) > 1 else 0.0
        settle = _SETTLE_S if kind in (PressEventKind.CLOSED, PressEventKind.OPENED) else 0.2
        if time_s - noticed + step <= settle:
            return []
        self._pending = None
        moment = min(self._moment(kind, noticed), time_s)
        events = []
        if kind is PressEventKind.CLOSED and self._state is PressState.IDLE:
            events.append(self._event(PressEventKind.INSERTED, max(self._first, moment - 1.0), time_s))
        return [*events, self._event(kind, moment, time_s)]

    def _moment(self, kind: PressEventKind, noticed: float) -> float:
        times = np.array([r.time for r in self._rows])
        top, bottom = np.array([r.top for r in self._rows]), np.array([r.bottom for r in self._rows])
        placed = place_moment(kind, times, top, bottom, self._rows[-1].plate, noticed, self._lag)
        if placed is None:
            return max(noticed, self._first)
        if kind is PressEventKind.INSERTED:
            self._lag = usual_lag() + placed.lag_misfit
        return max(placed.middle, self._first)

    def _event(
        self, kind: PressEventKind, moment: float, noticed: float, source: str = "temperatures"
    ) -> PressEvent:
        self._state = {
            PressEventKind.INSERTED: PressState.OPEN,
            PressEventKind.CLOSED: PressState.CLOSED,
            PressEventKind.OPENED: PressState.OPEN,
            PressEventKind.REMOVED: PressState.IDLE,
        }[kind]
        self._since = moment
        self._was_closed = kind is PressEventKind.OPENED or (
            self._was_closed and kind is not PressEventKind.INSERTED
        )
        self._bottom_high = -math.inf
        return PressEvent(kind, moment, noticed, source)


def _gap(plate: float, face: float) -> float:
    """Return how much hotter the plate is; with no platen column, what a press usually has."""
    return plate - face if plate == plate else 150.0


def place_moment(
    kind: PressEventKind,
    times: Array,
    top: Array,
    bottom: Array,
    plate: float,
    noticed: float,
    lag: Array | None,
) -> Placed | None:
    """Place an event by the faces around the scan it was noticed at; None where they cannot tell."""
    near = times > noticed - 6.0
    times, top, bottom = times[near], top[near], bottom[near]
    seen = [face for face in (top, bottom) if np.isfinite(face).sum() >= 2]
    if not seen or len(times) < 2:
        return None
    if kind is PressEventKind.CLOSED:
        hot = plate - 3.0 if plate == plate else float(np.nanmax(seen[0])) + 30.0
        return closing_moment(times, seen[0], hot, noticed, lag)
    if kind is PressEventKind.OPENED:
        return opening_moment(times, seen, noticed, plate, lag)
    lower = bottom if np.isfinite(bottom).sum() >= 2 else top
    if kind is PressEventKind.INSERTED:
        return insertion_moment(times, [lower], noticed, plate, lag)
    return opening_moment(times, [lower], noticed, math.nan, lag)


def find_moments(run: Run, press: Press) -> Moments:
    """Return when a run's panel came, the press closed and opened, and the panel left. [s of the run]

    The column ``closed`` decides where it holds values: closed from the time of its first 1, open from
    the first 0 after it. Else the faces' temperatures do. A moment that did not happen is NaN; without
    any panel column and without ``closed`` all are, and `source` says ``unknown``. In a press of one state
    the panel is there from the first row.
    """
    if not press.has_states:
        return Moments(inserted_s=float(run.time_s[0]), source="one state")
    columns = columns_of(press)
    names = tuple(run.columns)
    top_names, bottom_names = columns.of_face(names)
    switch = run.closed
    switched = switch is not None and bool(np.isfinite(switch).any())
    top, bottom = _face(run, top_names), _face(run, bottom_names)
    if not (np.isfinite(top).any() or np.isfinite(bottom).any() or switched):
        return Moments(source="unknown")
    plate = _face(run, tuple(n for n in names if n in columns.platens))
    found = _coarse(run.time_s, top, bottom, plate, switch if switched else None, press)
    placed = _refined(found, run.time_s, top, bottom, plate)
    moments = {kind: placed[kind].middle if kind in placed else at for kind, at in found.items()}
    source, ramp = "temperatures", Moments().ramp_s
    if switched and switch is not None:
        moments.update(_switch_moments(run.time_s, switch))
        source = "limit switch"
    elif PressEventKind.CLOSED in placed:
        ramp = placed[PressEventKind.CLOSED].ramp
    if PressEventKind.REMOVED in found and not _stays_cold(run.time_s, bottom, plate, found):
        del moments[PressEventKind.REMOVED]
    nan = math.nan
    inserted = moments.get(PressEventKind.INSERTED, nan)
    closed = moments.get(PressEventKind.CLOSED, nan)
    if inserted != inserted or inserted > closed:
        inserted = float(run.time_s[0])
    return Moments(
        inserted_s=max(inserted, float(run.time_s[0])),
        closed_s=closed,
        opened_s=moments.get(PressEventKind.OPENED, nan),
        removed_s=moments.get(PressEventKind.REMOVED, nan),
        ramp_s=ramp,
        source=source,
    )


def _face(run: Run, names: Sequence[str]) -> Array:
    """Return the median over columns, short gaps bridged; NaN where nothing is known."""
    if not names:
        return np.full(len(run.time_s), np.nan)
    table = np.array([_bridged(run.time_s, _plausible(run.columns[n])) for n in names])
    table = table[np.isfinite(table).any(axis=1)]
    if len(table) >= 3 and table.shape[1] >= 10:
        rattle = np.nan_to_num(np.nanmean(np.abs(np.diff(table, 2, axis=1)), axis=1), nan=np.inf)
        table = table[rattle <= 0.4 + 5.0 * float(np.median(rattle))]
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
    return np.asarray(np.where((values > _LOW_C) & (values < _HIGH_C), values, np.nan))


def _bridged(times: Array, values: Array) -> Array:
    """Fill gaps up to 3 s by a straight line."""
    good = np.isfinite(values)
    if good.all() or good.sum() < 2:
        return values
    filled = np.interp(times, times[good], values[good])
    place = np.clip(np.searchsorted(times[good], times), 1, good.sum() - 1)
    gap = times[good][place] - times[good][place - 1]
    inside = (times >= times[good][0]) & (times <= times[good][-1])
    return np.asarray(np.where(good | (inside & (gap <= 3.0)), filled, np.nan))


def _coarse(
    times: Array, top: Array, bottom: Array, plate: Array, switch: Array | None, press: Press
) -> dict[PressEventKind, float]:
    """Return when each event was noticed by the causal machine, at about 3 scans a second."""
    detector = PressEventDetector(press)
    columns = columns_of(press)
    stand_in = {"top": _example(columns.top), "bottom": _example(columns.bottom)}
    found: dict[PressEventKind, float] = {}
    last = -math.inf
    for i, time_s in enumerate(times.tolist()):
        if time_s - last < 0.3 and (switch is None or i == 0 or switch[i] == switch[i - 1]):
            continue
        last = time_s
        values = {stand_in["top"]: float(top[i]), stand_in["bottom"]: float(bottom[i])}
        values |= {name: float(plate[i]) for name in columns.platens[:1]}
        if switch is not None:
            values[SWITCH] = float(switch[i])
        for event in detector.update(time_s, values):
            if event.kind is PressEventKind.INSERTED and PressEventKind.CLOSED in found:
                return found
            found.setdefault(event.kind, event.noticed_s)
    return found


def _example(patterns: Sequence[str]) -> str:
    """Return a name that matches the first pattern."""
    return patterns[0].replace("*", "1").replace("?", "1") if patterns else "none"


def _window(times: Array, noticed: float) -> slice:
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    first = int(np.searchsorted(times, noticed - 8.0))
    return slice(first, int(np.searchsorted(times, noticed + max(0.6, 1.01 * step), side="right")))


def _refined(
    found: Mapping[PressEventKind, float], times: Array, top: Array, bottom: Array, plate: Array
) -> dict[PressEventKind, Placed]:
    """Place all events, the sensors' lag learned from insertion and opening together."""

    def place(kind: PressEventKind, lag: Array | None) -> Placed | None:
        near = _window(times, found[kind])
        hot = float(np.nanmedian(plate[near])) if np.isfinite(plate[near]).any() else math.nan
        return place_moment(kind, times[near], top[near], bottom[near], hot, found[kind], lag)

    lag = usual_lag()
    for kind in (PressEventKind.INSERTED, PressEventKind.OPENED):
        if kind in found and (first := place(kind, None)) is not None:
            lag = lag + first.lag_misfit
    placed = {kind: place(kind, lag) for kind in found}
    return {kind: value for kind, value in placed.items() if value is not None}


def _stays_cold(times: Array, bottom: Array, plate: Array, found: Mapping[PressEventKind, float]) -> bool:
    """Tell a removal from a panel that only lost touch: it ends the run, or the face gets cold for good."""
    after = times > found[PressEventKind.REMOVED] + 8.0
    if not after.any() or not np.isfinite(bottom[after]).any():
        return True
    hot = float(np.nanmedian(plate)) if np.isfinite(plate).any() else 180.0
    return bool(np.nanmin(bottom[after]) < 25.0 + 0.3 * (hot - 25.0))


def _switch_moments(times: Array, switch: Array) -> dict[PressEventKind, float]:
    """Return closing and opening by the contract's rule."""
    known = np.isfinite(switch)
    t, s = times[known], switch[known] > 0.5
    moments = {PressEventKind.CLOSED: math.nan, PressEventKind.OPENED: math.nan}
    if s.any():
        first = int(np.argmax(s))
        moments[PressEventKind.CLOSED] = float(t[first])
        if not s[first:].all():
            moments[PressEventKind.OPENED] = float(t[first + int(np.argmin(s[first:]))])
    return moments
