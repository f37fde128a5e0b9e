"""The causal machine: scans in, press events out; see `daq.press.events` for what it looks at."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.press.faces import BLIND_S, HIGH_C, LOW_C, Face, columns_of, middle
from daq.press.moments import BREAK_K, INSERTION_S, REACH_S, FaceHistory, place_moment, usual_lag
from daq.press.press_file import Press
from daq.press.wires import Wires
from daq.records import ROOM_C, Array, EventSource, PressEvent, PressEventKind, PressState
from daq.words import Message, say

# Thresholds without another source were set by hand, 2026-11-21, between what hands and noise do to a sensor and
# what a plate does to a face (tens of kelvins a second); tests/daq/test_press_events.py holds what they find.

_LOOK_BACK_S = 0.9
"""Changes are judged over about this time, at least one scan. [s]"""
_SETTLE_S = 0.65
"""Scans awaited after a closing or opening is plain, to place it. [s]"""
_SETTLE_PANEL_S = 0.2
"""And after an insertion or removal, whose kinks are long in the past by then. [s]"""
HAND_C = 38.0
"""Hands and room never bring a sensor above this: skin stays below 37 °C. [°C]"""
_USUAL_GAP_K = 150.0
"""How much hotter a plate is than a face where no platen is logged. [K]"""
_LEAST_GAP_K = 25.0
"""A face so near the plate's temperature shows neither insertion nor closing. [K]"""
_COLD_SHARE, _COOLING_SHARE, HOT_SHARE = 0.12, 0.3, 0.25
"""Of the way from room to plate: below the first a face lies in no press, below the second one that left its plate
is gone, above the third a face was in the press."""
_CLOSING_K, _CLOSING_SHARE = 6.0, 0.11
"""The upper face jumps by both, the share of its distance to the plate, when the press closes. [K]"""
_LOWER_GAP_K, _LOWER_CLOSING_K, _LOWER_CLOSING_SHARE = 15.0, 5.0, 0.2
"""The same of the lower face, which lies on its plate already and rises beforehand. [K]"""
_INSERTION_K, _INSERTION_SHARE, _SLOW_INSERTION_SHARE = 4.0, 0.04, 0.08
"""The lower face jumps by so much within the look-back, or by the larger share within `_SLOW_S`. [K]"""
_SLOW_S = 9.0
"""A panel on a plate that conducts badly warms over this. [s]"""
_INSERTION_RATIO = 0.5
"""And the upper face by less than this share of it: that lies on no plate yet. [-]"""
_OPENING_AFTER_S = 1.5
"""No press opens sooner after it closed. [s]"""
UNSEEN_BEFORE_S = 1.0
"""A panel whose insertion nobody saw is put this long before its closing. [s]"""
OPENS_AFTER_S = 1.0
"""Rows so long after the middle of the closing still belong to it, not to the opening. [s]"""
_OPENING_TOP_K, _OPENING_BOTTOM_K, _OPENING_RATIO = 1.8, 0.35, 0.2
"""Both faces fall, the lower by a share of the upper. [K]"""
_PLAIN_FALL_K = 25.0
"""The upper face alone falls by so much: nothing but an opening does that. [K]"""
_SANK_BACK_S = (3.0, 6.0)
"""The upper face is also compared with what it was so long ago, where the closing was over by then. [s]"""
_SANK_K, _SANK_RATIO, _SANK_SPARE_K = 4.0, 1.7, 2.5
"""It sank, not only touched worse, where it fell by the first, and by more than its distance to the plate had been
times the second and the third. [K, -, K]"""
_ONE_FACE_TOP_K, _ONE_FACE_BOTTOM_K = 3.0, 2.0
"""Where one face is read: its fall. [K]"""
_TOP_COLD_SHARE, _TOP_HOT_SHARE = 0.2, 0.6
"""Of the way from room to plate: an upper face below the first contradicts a wire that says closed, above the
second one that says open."""
HOLD_S, HOLD_SCANS = 1.5, 1.5
"""A channel's last value stands for this long, at least for so many scans: some loggers are slower than the scans
they answer to, and a faulty answer is no change of the press. [s, scans]"""
CHANGE_S = 15.0
"""A press opened for so long without a sensor to look at may hold another panel. [s]"""
_WARMED_K = 2.0
"""An upper face that stands or falls comes to no plate; one in the open press warms by more in 9 s. [K]"""
_SPREAD_K = 25.0
"""Sensors of one face that part by this much have been taken off the panel. [K]"""
_LEFT_AFTER_S, _LEFT_BACK_S, _TREND_FROM_S, _TREND_S = 4.0, 2.5, 6.5, 2.0
"""A panel may leave its plate so long after the press moved: its lower face is compared with what it was at least
the second ago, carried on by the trend since the third ago, taken over at least the fourth. [s]"""
_TREND_AFTER_S = 0.5
"""The trend begins so long after the press moved. [s]"""
_LEFT_FALL_K, _LEFT_STEP_K, _LEFT_SENSORS_K = 3.0, 2.5, 5.0
"""It falls below that trend by the first, by the second in all, and its sensors `_together`, by the third. [K]"""
_LIES_AGAIN_K = 5.0
"""A face that has warmed by so much since it left its plate lies on one again. [K]"""
_SENSORS_RISE, _SENSORS_SHARE = 0.4, 0.7
"""Of the least rise of a face each sensor does the first, or as many as the second of them. [-]"""
_HAND_RATIO = 1.3
"""Where only the upper face is read, a panel in the open press is hotter than a hand by this. [-]"""
_COMPARED_AFTER_S, _COMPARED_LEAST_K = 5.0, 30.0
"""Wire and temperatures are compared so long after the press moved; a plate counts as hotter than the room by at
least the second. [s, K]"""
ONE_STEP = 1.01
"""A scan's step is taken so much longer, lest a clock's jitter leaves out the scan meant. [-]"""
_SLOPE_OVER_S = 2.0
"""The lower face's slope before a closing is taken over this. [s]"""


class FaceRow(NamedTuple):
    """A scan: the faces' medians, the plate, and the usable sensors of each face."""

    time: float
    top: float
    bottom: float
    plate: float
    tops: Mapping[str, float]
    bottoms: Mapping[str, float]


class PressEventDetector:
    """Scans in, press events out. It knows no clock but the scans' own times.

    Parameters
    ----------
    press
        Gives which columns lie on which face and which are platens.
    inserted
        The first scan lies at the insertion or later: start in the open press, not idle. None: find out.
    placing
        Place moments between the scans; without, an event's moment is the scan it was noticed at.
    """

    def __init__(self, press: Press, inserted: bool | None = None, *, placing: bool = True) -> None:
        self._columns = columns_of(press)
        self._placing = placing
        self._rows: list[FaceRow] = []
        self._times: list[float] = []
        """Of the rows. [s]"""
        self._top, self._bottom = Face(), Face()
        self._names: tuple[str, ...] = ()
        self._top_names: tuple[str, ...] = ()
        self._bottom_names: tuple[str, ...] = ()
        self._platen_names: tuple[str, ...] = ()
        self._state = PressState.OPEN if inserted else PressState.IDLE
        self._pending: tuple[PressEventKind, float] | None = None
        self.wires = Wires(press.press)
        """Limit switch and pressure channel, as the press file names them."""
        self.closed_by_wire: bool | None = None
        """What a wire says at the newest scan; None where none does."""
        self._switch: bool | None = None
        self._last: dict[str, tuple[float, float]] = {}
        """Of each channel: when it was read last, and its value; while `_whole` is one, of before it. [s]"""
        self._whole: tuple[float, Mapping[str, float]] | None = None
        """The last scan, if it had a value of every channel: its time [s] and its values."""
        self._step_s = math.inf
        """Between the scans before the newest. [s]"""
        self._read_s = -math.inf
        """When a sensor of the panel was read last."""
        self._since = -math.inf
        self._first = math.nan
        self._by_bottom, self._face_high = True, -math.inf
        self._was_closed = False
        self._lag: Array | None = None
        self._lifted: tuple[float, float, float] | None = None
        self.disagreement: Message | None = None
        """Why wire and temperatures contradict each other, for the journal; None while they agree."""

    def looks_at(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return those columns that it reads: faces, platens and wires."""
        top, bottom = self._columns.of_face(names)
        known = {*top, *bottom, *self._columns.platens, *self.wires.columns}
        return tuple(name for name in names if name in known)

    @property
    def state(self) -> PressState | None:
        """What the press is doing; None where nothing usable has been seen for 3 s."""
        if self._switch is None and (not self._rows or self._rows[-1].time - self._read_s > BLIND_S):
            return None
        return self._state

    @property
    def left_plate_s(self) -> float | None:
        """When the panel seems to have left the lower plate, not confirmed yet by cold or parting sensors. [s]"""
        return None if self._lifted is None else self._lifted[0]

    @property
    def pending(self) -> PressEventKind | None:
        """An event that is plain already while its moment is still being placed."""
        return None if self._pending is None else self._pending[0]

    def update(self, time_s: float, values: Mapping[str, float]) -> list[PressEvent]:
        """Take one scan as it is (unusable values NaN or left out); return what it brought to light."""
        values = self._held(time_s, values)
        self._append(self._seen(time_s, values))
        self.closed_by_wire = switch = self.wires.read(time_s, values)
        if switch is not None:
            return self._by_switch(time_s, switch)
        self.disagreement = None
        return self._by_temperatures(time_s)

    def take(self, row: FaceRow) -> list[PressEvent]:
        """Take a scan whose faces are known, of a press without wires; return what it brought to light."""
        self._append(row)
        self._read_s = row.time
        return self._by_temperatures(row.time)

    def skip(self, rows: Sequence[FaceRow]) -> None:
        """Take the newest of scans that bring nothing to light (`waits_for`), as `rows_kept` says which."""
        self._rows, self._times = list(rows), [row.time for row in rows]

    def _by_temperatures(self, time_s: float) -> list[PressEvent]:
        if self._pending is not None:
            return self._place(time_s)
        kind = self._look()
        if kind is None:
            return []
        self._pending = (kind, time_s)
        return self._place(time_s)

    def _held(self, time_s: float, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values, where a channel has none its last one for a moment longer."""
        step = time_s - self._times[-1] if self._times else math.inf
        before_s, self._step_s, held = self._step_s, step, dict(values)
        if not math.isnan(sum(held.values())) and tuple(held) == self._names:
            self._whole = (time_s, held)
            return held
        if self._whole is not None:
            at, last = self._whole
            self._last, self._whole = {name: (at, value) for name, value in last.items()}, None
        since_s = time_s - max(HOLD_S, HOLD_SCANS * min(step, before_s))
        for name, value in values.items():
            if value == value:
                self._last[name] = (time_s, value)
        for name, (at, value) in self._last.items():
            if at < time_s:
                held[name] = value if at >= since_s else math.nan
        return held

    def _seen(self, time_s: float, values: Mapping[str, float]) -> FaceRow:
        """Return the faces as a scan shows them."""
        names = tuple(values)
        if names != self._names:
            self._names = names
            self._top_names, self._bottom_names = self._columns.of_face(names)
            self._platen_names = tuple(n for n in names if n in self._columns.platens)
        elapsed = time_s - self._rows[-1].time if self._rows else 0.0
        top = {n: v for n in self._top_names if LOW_C < (v := values[n]) < HIGH_C}
        bottom = {n: v for n in self._bottom_names if LOW_C < (v := values[n]) < HIGH_C}
        platens = [v for n in self._platen_names if (v := values[n]) == v]
        plate = middle(platens) if platens else (self._rows[-1].plate if self._rows else math.nan)
        levels = self._top.update(top, elapsed), self._bottom.update(bottom, elapsed)
        if any(self._whole is not None or self._last[name][0] == time_s for name in (*top, *bottom)):
            self._read_s = time_s
        return FaceRow(time_s, *levels, plate, top, bottom)

    def _append(self, row: FaceRow) -> None:
        if self._first != self._first:
            self._first = row.time
        self._rows.append(row)
        self._times.append(row.time)
        while self._times[0] < row.time - INSERTION_S and len(self._times) > 4:
            del self._rows[0], self._times[0]

    # --- limit switch, pressure channel ----------------------------------------------------------

    def _by_switch(self, time_s: float, closed: bool) -> list[PressEvent]:
        """Closing and opening by the wire; insertion and removal still by temperatures."""
        before, self._switch = self._switch, closed
        events: list[PressEvent] = []
        if closed is not (self._state is PressState.CLOSED):
            events = self._switched(time_s, closed)
        elif self._pending is not None:
            events += self._place(time_s)
        elif before is not None:
            kind = self._look()
            if kind in (PressEventKind.INSERTED, PressEventKind.REMOVED):
                self._pending = (kind, time_s)
                events += self._place(time_s)
        self._compare(time_s, closed)
        return events

    def _switched(self, time_s: float, closed: bool) -> list[PressEvent]:
        """Return the wire's closing or opening, and the panel's coming or going where it must be concluded."""
        kind = PressEventKind.CLOSED if closed else PressEventKind.OPENED
        around: list[PressEventKind] = []
        if closed and self._unseen_change(time_s):
            around.append(PressEventKind.REMOVED)
        if closed and (around or self._state is PressState.IDLE):
            around.append(PressEventKind.INSERTED)
        self._pending = None
        events = [self._event(x, time_s, time_s) for x in around]
        events.append(self._event(kind, time_s, time_s, self.wires.source))
        if not closed and self._nothing_hot(self._rows[-1]):
            events.append(self._event(PressEventKind.REMOVED, time_s, time_s))
        return events

    def _unseen_change(self, time_s: float) -> bool:
        """Whether the pressed panel may have gone for another one while no sensor showed it."""
        opened = self._state is PressState.OPEN and self._was_closed
        return opened and time_s - self._since > CHANGE_S and time_s - self._read_s > BLIND_S

    def _nothing_hot(self, row: FaceRow) -> bool:
        """Whether the sensors, as far as there are any, lie in no press: it was closed with nothing in it."""
        limit = ROOM_C + _COLD_SHARE * _gap(row.plate, ROOM_C)
        faces = [face for face in (row.top, row.bottom) if face == face]
        return bool(faces) and max(faces) < limit

    def _compare(self, time_s: float, closed: bool) -> None:
        row = self._rows[-1]
        self.disagreement = None
        if time_s - self._since < _COMPARED_AFTER_S or row.plate - row.top != row.plate - row.top:
            return
        reach = (row.top - ROOM_C) / max(row.plate - ROOM_C, _COMPARED_LEAST_K)
        wire = self.wires.source.message
        if closed and reach < _TOP_COLD_SHARE:
            self.disagreement = say("wire-closed-face-cold", wire=wire)
        elif not closed and not self._was_closed and reach > _TOP_HOT_SHARE and self._state is PressState.OPEN:
            self.disagreement = say("wire-open-face-hot", wire=wire)

    # --- temperatures ---------------------------------------------------------------------------

    def _look(self) -> PressEventKind | None:
        """Say what is plain at the newest scan, if anything."""
        now, then = self._rows[-1], self._row_before(self._look_back)
        if then is None:
            return None
        if self._state is PressState.CLOSED:
            return PressEventKind.OPENED if self._opened(now, then) else None
        if self._closed(now, then) or self._warms_since() is not None:
            return PressEventKind.CLOSED
        if self._state is PressState.IDLE:
            return PressEventKind.INSERTED if self._inserted(now, then) else None
        return PressEventKind.REMOVED if self._removed(now) else None

    @property
    def _look_back(self) -> float:
        step = self._rows[-1].time - self._rows[-2].time if len(self._rows) > 1 else 0.0
        return max(_LOOK_BACK_S, ONE_STEP * step)

    def _row_before(self, seconds: float) -> FaceRow | None:
        """Return the newest row at least `seconds` before the newest, or the first where all are younger."""
        rows = bisect_right(self._times, self._times[-1] - seconds)
        if rows:
            return self._rows[rows - 1]
        return self._rows[0] if len(self._rows) > 1 else None

    def _bottom_before(self, seconds: float) -> FaceRow | None:
        """Return the newest row at least `seconds` before the newest that shows the lower face."""
        for at in reversed(range(bisect_right(self._times, self._times[-1] - seconds))):
            if (row := self._rows[at]).bottom == row.bottom:
                return row
        return None

    def _closed(self, now: FaceRow, then: FaceRow) -> bool:
        """The upper face jumps towards the plate (the lower one, where no upper sensor works)."""
        if now.top == now.top and then.top == then.top:
            gap = _gap(now.plate, then.top)
            least = max(_CLOSING_K, _CLOSING_SHARE * gap)
            if gap < _LEAST_GAP_K or now.top - then.top < least or now.top < HAND_C:
                return False
            return _together(now.tops, then.tops, _CLOSING_SHARE * gap)
        if self._state is PressState.IDLE or now.bottom != now.bottom or then.bottom != then.bottom:
            return False
        gap = _gap(now.plate, then.bottom)
        expected = self._slope_before(then) * (now.time - then.time)
        least = max(_LOWER_CLOSING_K, _LOWER_CLOSING_SHARE * gap)
        return gap > _LOWER_GAP_K and now.bottom - then.bottom - max(expected, 0.0) > least

    def _slope_before(self, then: FaceRow) -> float:
        """Return how fast the lower face moved before a row. [K/s]"""
        since = then.time - _SLOPE_OVER_S
        early = [r for r in self._rows if since <= r.time <= then.time and r.bottom == r.bottom]
        if len(early) < 2:
            return 0.0
        return (early[-1].bottom - early[0].bottom) / (early[-1].time - early[0].time)

    def _opened(self, now: FaceRow, then: FaceRow) -> bool:
        """Both faces fall at once; the lower may stay where panel and plates had become equally hot."""
        if now.time - self._since < _OPENING_AFTER_S:
            return False
        top, bottom = then.top - now.top, then.bottom - now.bottom
        if top == top and bottom == bottom:
            both = top > _OPENING_TOP_K and bottom > _OPENING_BOTTOM_K and bottom > _OPENING_RATIO * top
            earlier = (then, *(self._row_before(back) for back in _SANK_BACK_S))
            plain = (both or top > _PLAIN_FALL_K) and _most_fell(now.tops, then.tops)
            return plain or any(self._sank(now, row) for row in earlier)
        if top == top:
            return top > _ONE_FACE_TOP_K and _most_fell(now.tops, then.tops)
        return bottom > _ONE_FACE_BOTTOM_K and _most_fell(now.bottoms, then.bottoms)

    def _sank(self, now: FaceRow, then: FaceRow | None) -> bool:
        """Whether the upper face fell further than a worse contact could let it: it follows the plate then."""
        if then is None or then.time < self._since + OPENS_AFTER_S:
            return False
        fall = (then.top - now.top) - max(then.plate - now.plate, 0.0)
        if not (fall > _SANK_K and fall > _SANK_RATIO * max(then.plate - then.top, 0.0) + _SANK_SPARE_K):
            return False
        return _most_fell(now.tops, then.tops)

    def _warms_since(self) -> float | None:
        """Return since when both faces warm again after a fall too short for an opening, if they do. [s]

        A face that lost its plate falls as the root of time, for as long as the panel is a half space. Where both
        warm again sooner, the plates are there: what had ended is the heat of a resin that cures within seconds.
        One face alone does not show it: after an opening a single noisy sensor rises by kelvins, too.
        """
        if self._state is not PressState.OPEN or not self._was_closed or self._times[0] > self._since + REACH_S:
            return None
        after = self._rows[bisect_left(self._times, self._since) :]
        since = [row for row in after if row.top + row.bottom == row.top + row.bottom]
        lowest = min(since, key=lambda row: row.top, default=None)
        if lowest is None or lowest.time - self._since >= REACH_S:
            return None
        risen = min(since[-1].top - lowest.top, since[-1].bottom - min(row.bottom for row in since))
        return lowest.time if risen > BREAK_K else None

    def _inserted(self, now: FaceRow, then: FaceRow) -> bool:
        """The lower face leaves hand and room temperature, all its sensors together, the upper stays."""
        if now.bottom != now.bottom or then.bottom != then.bottom:
            return self._upper_only(now, then)
        if now.bottom < HAND_C:
            return False
        if self._jumped(now, then, _INSERTION_SHARE):
            return True
        early = self._row_before(_SLOW_S) or then
        return early.bottom < HAND_C and self._jumped(now, early, _SLOW_INSERTION_SHARE)

    def _jumped(self, now: FaceRow, then: FaceRow, share: float) -> bool:
        """Whether the lower face alone rose by a share of its distance to the plate."""
        gap, rise = _gap(now.plate, then.bottom), now.bottom - then.bottom
        if not (gap > _LEAST_GAP_K and rise > max(_INSERTION_K, share * gap)):
            return False
        if now.top - then.top > _INSERTION_RATIO * rise:
            return False
        return _together(now.bottoms, then.bottoms, 0.5 * share * gap)

    def _upper_only(self, now: FaceRow, then: FaceRow) -> bool:
        """Where no sensor of the lower face is read, not only for a scan, the upper one has warmed."""
        early = self._row_before(_SLOW_S) or then
        if self._bottom_before(0.0) is not None or not now.top > _HAND_RATIO * HAND_C:
            return False
        return now.top > then.top and now.top - early.top > _WARMED_K

    def _removed(self, now: FaceRow) -> bool:
        """The lower face lost its plate, and then got cold or its sensors came off one by one."""
        by_bottom = now.bottom == now.bottom or any(row.bottom == row.bottom for row in self._rows)
        level = now.bottom if by_bottom else now.top
        if level != level:
            return False  # the cool upper face is no stand-in for a lower sensor that blinks
        if by_bottom is not self._by_bottom:
            self._by_bottom, self._face_high = by_bottom, -math.inf
        self._face_high = max(self._face_high, level)
        gap = _gap(now.plate, ROOM_C)
        if self._face_high > ROOM_C + HOT_SHARE * gap and level < ROOM_C + _COLD_SHARE * gap:
            return True
        if self._was_closed and self._switch is not None and self._nothing_hot(now):
            self._lifted = (now.time, level, self._spread(now))
            return True
        if self._lifted is None:
            if self._left_plate(now):
                self._lifted = (self._moment(PressEventKind.REMOVED, now.time), level, self._spread(now))
            return False
        moment, lowest, spread = self._lifted
        if level > lowest + _LIES_AGAIN_K:
            self._lifted = None
            return False
        self._lifted = (moment, min(level, lowest), spread)
        return level < ROOM_C + _COOLING_SHARE * gap or self._spread(now) > spread + _SPREAD_K

    def _spread(self, now: FaceRow) -> float:
        """Return how far the lower face's sensors lie apart, without the two most extreme where there are many."""
        values = sorted(now.bottoms.values())
        if len(values) < 2:
            return 0.0
        return values[-2] - values[1] if len(values) >= 4 else values[-1] - values[0]

    def _left_plate(self, now: FaceRow) -> bool:
        """Whether the lower face falls against its trend."""
        if now.bottom != now.bottom or now.time - self._since < _LEFT_AFTER_S:
            return False
        then, early = self._bottom_before(max(_LEFT_BACK_S, self._look_back)), self._bottom_before(_TREND_FROM_S)
        if then is None or early is None:
            return False
        if then.time - early.time < _TREND_S or early.time < self._since + _TREND_AFTER_S:
            return False
        trend = (then.bottom - early.bottom) / (then.time - early.time)
        fall = then.bottom + trend * (now.time - then.time) - now.bottom
        if not (fall > _LEFT_FALL_K and then.bottom - now.bottom > _LEFT_STEP_K and now.bottom > HAND_C):
            return False
        return _together(then.bottoms, now.bottoms, _LEFT_SENSORS_K)

    # --- the moment -----------------------------------------------------------------------------

    def _place(self, time_s: float) -> list[PressEvent]:
        """Report the pending event once enough scans followed to say when it was."""
        if self._pending is None:
            return []
        kind, noticed = self._pending
        step = self._rows[-1].time - self._rows[-2].time if len(self._rows) > 1 else 0.0
        settle = _SETTLE_S if kind in (PressEventKind.CLOSED, PressEventKind.OPENED) else _SETTLE_PANEL_S
        if time_s - noticed + step <= settle:
            return []
        self._pending = None
        lifted = self._lifted[0] if self._lifted and kind is PressEventKind.REMOVED else None
        moment = min(self._moment(kind, noticed) if lifted is None else lifted, time_s)
        events = []
        if kind is PressEventKind.CLOSED and self._state is PressState.IDLE:
            events.append(self._event(PressEventKind.INSERTED, max(self._first, moment - UNSEEN_BEFORE_S), time_s))
        return [*events, self._event(kind, moment, time_s)]

    def _moment(self, kind: PressEventKind, noticed: float) -> float:
        warms_since = self._warms_since() if kind is PressEventKind.CLOSED else None
        if warms_since is not None:
            return warms_since
        if not self._placing:
            return noticed
        times = np.array(self._times)
        top, bottom = np.array([r.top for r in self._rows]), np.array([r.bottom for r in self._rows])
        after = self._since + OPENS_AFTER_S if kind is PressEventKind.OPENED else -math.inf
        placed = place_moment(
            kind, FaceHistory(times, top, bottom, self._rows[-1].plate), noticed, after, self._lag
        )
        if placed is None:
            return max(noticed, self._first)
        if kind is PressEventKind.INSERTED:
            self._lag = usual_lag() + placed.lag_misfit
        return max(placed.middle, self._first)

    def _event(
        self,
        kind: PressEventKind,
        moment: float,
        noticed: float,
        source: EventSource = EventSource.TEMPERATURES,
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
        self._face_high, self._lifted = -math.inf, None
        return PressEvent(kind, moment, noticed, source)


def _together(now: Mapping[str, float], then: Mapping[str, float], least: float) -> bool:
    """Whether most sensors of a face rose from `then` to `now`, not a few that a hand touched."""
    rises = [value - then[name] for name, value in now.items() if name in then]
    return not rises or sum(r > _SENSORS_RISE * least for r in rises) >= _SENSORS_SHARE * len(rises)


def _most_fell(now: Mapping[str, float], then: Mapping[str, float]) -> bool:
    """Whether most sensors of a face fell from `then` to `now`; else only the bridge over a lost one fades."""
    falls = [then[name] - value for name, value in now.items() if name in then]
    return 2 * sum(f > 0.0 for f in falls) >= len(falls)


def _gap(plate: float, face: float) -> float:
    """Return how much hotter the plate is; with no platen column, what a press usually has."""
    return plate - face if plate == plate else _USUAL_GAP_K


def rows_kept(times: Array) -> Array:
    """Return from which row on a detector holds rows at each of a table's rows (rows)."""
    near, fourth = np.searchsorted(times, times - INSERTION_S), np.arange(len(times)) - 3
    return np.asarray(np.maximum(np.minimum(near, fourth), 0))


def waits_for(times: Array, top: Array, bottom: Array) -> dict[PressState, NDArray[np.intp]]:
    """Return the rows of a table at which something may be plain, by what the press is doing: no other shows any.

    Each is the least that `PressEventDetector` asks of the faces in that state. In the open press, where a panel
    may leave, it asks every row.
    """
    kept = rows_kept(times)

    def before(seconds: Array | float) -> Array:
        return np.maximum(np.searchsorted(times, times - seconds, side="right") - 1, kept)

    steps = np.diff(times, prepend=times[:1])
    then, early = before(np.maximum(_LOOK_BACK_S, ONE_STEP * steps)), before(_SLOW_S)
    sank = np.any([top[row] - top > _SANK_K for row in map(before, _SANK_BACK_S)], axis=0)
    fell = (top[then] - top > _OPENING_TOP_K) | (bottom[then] - bottom > _ONE_FACE_BOTTOM_K)
    closes = top - top[then] >= _CLOSING_K
    jumped = (bottom - bottom[then] > _INSERTION_K) | (bottom - bottom[early] > _INSERTION_K)
    upper_only = np.isnan(bottom + bottom[then]) & (top > _HAND_RATIO * HAND_C)
    inserted = (jumped & (bottom >= HAND_C)) | upper_only
    return {
        PressState.CLOSED: np.flatnonzero(fell | sank),
        PressState.IDLE: np.flatnonzero(closes | inserted),
    }
