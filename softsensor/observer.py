"""The live sensor: core temperature with a band one can trust, scan by scan.

Method (decided 2026-11, see also `observer_priors`). The thermal model marches with the platens; forward
tangents say how faces and core answer to every uncertain parameter. A Kalman filter over these parameters
(coefficients, start temperature, platen offsets, moments, what bends the readings, and causes the model in
force leaves out) is corrected by one robust value a face. The belief is joint and Gaussian; "nothing is
missing" and "this cause is missing" are read off it by narrowing the others (`observer_kernels.blend`), so
that the band is a mixture: narrow while the faces agree with the plain model, wide or moved when they do
not. Evaporation, whose tangent at zero says little about its real size, has a filter of its own.

When the belief moves far from where the model was linearised, or a moment of the press becomes known
(always a little late), the stored scans are gone through again from the start, some blocks with each new
scan, while the pass before goes on answering: no scan waits for it. Everything is a function of the scans so
far: replay and live agree, and a run cut short gives the same rows.

What is told as the core is what the model in force says (2026-11-21): a cause that is only suspected widens the
band towards where it would put the core, and moves the number only once a diagnosis has put it into the model
(or once the number would lie more than `TOLD_K` from what all hypotheses together expect).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press_detector import BLIND_S, CHANGE_S
from daq.press_events import PressEventDetector
from daq.press_wires import WIRES
from daq.pressfile import Press, panel_of, press_for_run
from daq.records import Array, Moments, PressEvent, PressEventKind, PressState, Run
from softsensor.modelfile import ModelFile
from softsensor.observer_belief import Mixture
from softsensor.observer_blocks import Scans
from softsensor.observer_kernels_blocks import last_switch
from softsensor.observer_outlook import Inside, Outlook, Wishes, look_ahead, look_inside
from softsensor.observer_priors import INITIAL_K
from softsensor.observer_setup import Bench, fresh_consensus, prepare_bench, with_platens
from softsensor.observer_track import LEAST_WAIT_S, Known, Track
from softsensor.observer_trust import (
    DOUBTED_K,
    LONGEST_WAIT_S,
    Coming,
    Seen,
    Stillness,
    coming,
    contradiction,
    first_error,
    hot_from,
    start_error,
)

UNKNOWN_STATE = "press state unknown"
NO_PLATENS = "platen reading missing"
NOT_VALID = "model not valid"
NOT_OBSERVABLE = "core not observable"
BRIDGE_S = 10.0
"""Platen readings are held this long. [s]"""
MISFIT_LIMIT = 9.0
"""Mean squared normalised innovation over 10 s beyond which the model is not valid."""
WIDEST_K = 25.0
"""Half-width of a band beyond which the core is not observable. [K]"""
OUTLOOK_S = 2.0
"""How often the sensor looks ahead. [s]"""
BLOCKS_PER_S, LEAST_BLOCKS = 250, 25
"""How fast a new pass over the stored scans catches up: blocks for each second of the run, and for each scan."""
PLACED_S = 0.15
"""Standard deviation of a moment found in the temperatures, where scans are dense. [s]"""
LONGEST_HOLE_S, MISSED_K = 7.0, 25.0
"""A press that closed in a longer gap has pressed for a time nobody knows; where both faces have moved by more in
a gap and no closing was found, one was missed. [s, K]"""
LATE_S = 2.0
"""Platens may be unknown for so long while a panel lies in the press for the first time. [s]"""
REOPENED_S = 3.0
"""A press open for less than this has stayed closed: a bouncing switch, or steam let out. [s]"""
NOTICED_S = 2.0
"""After so long on the hot plate a panel is noticed, or its sensors came late. [s]"""
OTHER_K = 40.0
"""Faces colder than foretold by so much after the opening are another panel's. [K]"""
UNCLEAR_S = 1.5
"""A coming better known than this and before the first scan is taken to be with it. [s]"""
HOTTEST_START_C = 80.0
"""A start temperature above was read from a panel that has been pressed: a recorder begun in between. [°C]"""
FOUND_LATER = 2
"""So many of `TIMING`, closing and opening, become known after the filters have begun."""


@dataclass(frozen=True)
class Estimate:
    """What the live sensor says at one scan."""

    time_s: float
    state: PressState | None
    """None: unknown."""
    core_C: float = math.nan  # noqa: N815
    core_sd_K: float = math.nan  # noqa: N815
    core_low_C: float = math.nan  # noqa: N815
    core_high_C: float = math.nan  # noqa: N815
    """Low and high bound 95 %."""
    valid: bool = False
    reason: str = ""
    suspected: str = ""
    """The cause the readings speak for, where one is likelier than nothing."""


class LiveSensor:
    """Feeds on scans and says what the core is doing.

    Parameters
    ----------
    press
        The press file.
    header
        The run's header: panel, ambient, settings.
    model
        Coefficients and effects from earlier runs; None starts from the press file's guesses.
    """

    def __init__(self, press: Press, header: Mapping[str, Any], model: ModelFile | None = None) -> None:
        self._press = press
        self._header = dict(header)
        self._model = model
        self._detector = PressEventDetector(press)
        self._known = Known()
        self._bench: Bench | None = None
        self._state: PressState | None = None
        self._platens = [math.nan, math.nan]
        self._platens_seen = [math.nan, math.nan]
        self._initial = math.nan
        self._scans = Scans(0, 0)
        self._came: Coming | None = None
        """When the panel came to lie in the press, until its start has been held against the header."""
        self._judged = 0
        """By how many faces."""
        self._lower_heard = self._face_heard = -math.inf
        """When the lower face was heard last, and any. [s]"""
        self._hot_since, self._hot_C = math.inf, math.inf
        """Since when the lower face is too hot for a panel that is not in the press, and what that is. [s, °C]"""
        self._lies_since = math.inf
        """When the panel came to lie in the press. [s]"""
        self._doubt = ""
        """Why the run cannot be as the header says, empty while it may be."""
        self._track: Track | None = None
        self._next: Track | None = None
        """A pass that knows better and has not caught up yet."""
        self._overtaken = False
        """Whether the present pass knows the press in a state it has left: faces would mislead it."""
        self._points: list[Array] = []
        self._linearised = -math.inf
        self._wishes = wishes_of(header)
        self._inside: tuple[Mixture | None, Inside] | None = None
        self._outlook = Outlook()
        self._looked_ahead = -math.inf

    # --- one scan -----------------------------------------------------------------------------------

    def update(self, time_s: float, values: Mapping[str, float]) -> Estimate:
        """Take a scan (missing values NaN or left out) and say what the core is doing now."""
        bench = self._bench or self._prepare(values)
        readings = np.array([values.get(c, math.nan) for c in self._measured])
        frozen = self._still.frozen(time_s, readings)
        if frozen:
            values = {name: math.nan if name in self._measured else value for name, value in values.items()}
            readings[:] = math.nan
        stale = self._detect(bench, time_s, values)
        if not self._note_platens(bench, time_s, values):
            return Estimate(time_s, self._state, reason=NO_PLATENS)
        if not len(self._scans):
            self._bench = bench = with_platens(bench, self._platens)
            if self._state is not PressState.IDLE and time_s - self._lies_since > LATE_S:
                self._doubt = "platen temperatures were missing when the panel came to lie in the press"
        outside = self._platens[0], self._platens[1]
        self._scans.append(time_s, outside, readings[len(bench.platens) :], self._consensus)
        stale = self._still.silence(self._scans, frozen=frozen) or stale
        stale = self._check_start(bench) or stale
        self._listen(bench, time_s)
        try:
            self._take_in(bench, time_s, stale=stale)
            if self._track is not None:
                self._scans.foretell(self._track.read)
        except (ArithmeticError, np.linalg.LinAlgError):  # begin anew from what was known before the run
            self._track = self._next = None
            return Estimate(time_s, self._state, reason=NOT_VALID)
        return self._say(time_s)

    def _check_start(self, bench: Bench) -> bool:
        """Hold each face, when first heard in the press, against the header; return whether that is doubted."""
        if self._came is None or not bench.columns:
            return False
        closed = self._known.moments.closed_s
        error = first_error(
            self._seen(bench), self._initial, self._came, closed if math.isfinite(closed) else math.inf
        )
        if error.faces == len(bench.labels) or math.isfinite(closed):
            self._came = None
        if error.faces == self._judged:
            return False
        self._judged = error.faces
        self._doubt = self._doubt or contradiction(error.certain, self._initial)
        if abs(error.off) <= DOUBTED_K:
            return False
        self._known = replace(self._known, initial_sd=math.hypot(INITIAL_K, error.off))
        return True

    def _seen(self, bench: Bench) -> Seen:
        return Seen(self._scans.time, self._scans.level, bench.lower)

    def _listen(self, bench: Bench, time_s: float) -> None:
        """Note which faces are heard: nothing else tells that a panel has come, is there, or has gone."""
        level = self._scans.level[-1].tolist()
        low = level[bench.lower] if bench.lower >= 0 else math.nan
        if any(face == face for face in level):
            self._face_heard = time_s
        if low == low:
            self._lower_heard = time_s
        self._hot_since = min(self._hot_since, time_s) if low >= self._hot_C else math.inf
        moments = self._known.moments
        if not math.isfinite(moments.opened_s) or math.isfinite(moments.removed_s):
            return
        if time_s - moments.opened_s > CHANGE_S and time_s - self._face_heard > BLIND_S:
            self._doubt = "for long no sensor has shown whether the panel still lies in the open press"
        elif self._track is not None and (self._track.read - self._scans.level[-1] > OTHER_K).any():
            self._doubt = "faces far colder than those of the panel that was pressed; another one may lie there"

    def _take_in(self, bench: Bench, now: float, *, stale: bool) -> None:
        """Bring the filters up to the newest scan, or a new pass of them nearer to it."""
        scans = self._scans
        if stale or (self._track is None and self._next is None):
            self._begin(bench, None if self._track is None else self._points)
            self._overtaken = stale
        elif self._track is not None and self._detector.pending is None:
            self._track.extend(scans, len(scans), blind=self._overtaken)
            if self._next is None and self._due(self._track, now):
                self._linearised = now
                if (points := self._track.better_points()) is not None:
                    self._begin(bench, points)
        if self._next is not None:
            step = now - float(scans.time[-2]) if len(scans) > 1 else 0.0
            if self._next.extend(scans, max(LEAST_BLOCKS, round(BLOCKS_PER_S * step))):
                self._track, self._next, self._linearised = self._next, None, now
                self._overtaken = False

    def _begin(self, bench: Bench, points: Sequence[Array] | None) -> None:
        """Begin a pass with what is known by now; the present one answers until it has caught up."""
        known = replace(self._known, idle=self._state is PressState.IDLE)
        self._next = Track(bench, self._model, known, points, self._first, self._initial)
        self._points = self._next.points

    def _due(self, track: Track, now: float) -> bool:
        """Return whether it is time to ask if the filters are still linearised near enough."""
        since = now - float(last_switch(track.switches, now))
        return now - self._linearised >= max(0.7, 0.4 * since)

    @property
    def _first(self) -> float:
        """Time of the first scan. [s]"""
        return float(self._scans.time[0])

    @property
    def _now(self) -> float:
        """Time of the newest scan. [s]"""
        return float(self._scans.time[-1])

    @property
    def inside(self) -> Inside | None:
        """Profile and heat of the panel at the newest scan; None without a panel or before it is known."""
        track = self._track
        if track is None or self._state is PressState.IDLE or not len(track.members[0].filter.profile):
            return None
        if self._inside is None or self._inside[0] is not track.mixture:
            self._inside = track.mixture, look_inside(track.members[0])
        return self._inside[1]

    @property
    def outlook(self) -> Outlook:
        """What lies ahead for what the header wants of the core, as `look_ahead` last found it."""
        return self._outlook.later(self._now - self._looked_ahead) if len(self._scans) else self._outlook

    def look_ahead(self) -> None:
        """Work out what lies ahead, where that matters and the last look is `OUTLOOK_S` old. Takes some 10 ms."""
        track = self._track
        if track is None or not self._wishes.any or not math.isfinite(self._known.moments.closed_s):
            return
        now = self._now
        if now - self._looked_ahead < OUTLOOK_S:
            return
        self._looked_ahead, self._outlook = now, Outlook()
        if self._state is PressState.CLOSED or self._state is PressState.OPEN:
            done = float(self._scans.time[track.done - 1])
            ahead = look_ahead(track, self._wishes, self._state, done, np.array(self._platens))
            self._outlook = ahead.later(now - done)

    def _prepare(self, values: Mapping[str, float]) -> Bench:
        times = np.linspace(-2.0, 900.0, 24)  # close enough that no gap needs bridging
        columns = {name: np.full(len(times), v) for name, v in values.items()}
        run = Run("live", self._header, times, columns, "live")
        press = press_for_run(self._press, run)
        self._detector = PressEventDetector(press)
        own = tuple(name for name, _ in self._model.effects) if self._model else ()
        bench = prepare_bench(press, run, own)
        self._consensus = fresh_consensus(bench)
        self._scans = Scans(len(bench.labels), len(bench.columns))
        self._measured = (*bench.platens, *bench.columns)
        self._still = Stillness(bench.place, len(bench.labels), len(bench.platens))
        if press.panel_layers:
            self._initial = panel_of(run).initial_temperature
            self._hot_C = hot_from(self._initial)
        self._bench = bench
        return bench

    def _detect(self, bench: Bench, time_s: float, values: Mapping[str, float]) -> bool:
        """Follow the press; return whether what is known of its moments has changed."""
        if not bench.press.has_states:
            self._state = PressState.CLOSED
            return False
        events = self._detector.update(time_s, values)
        self._state = self._detector.state
        if not bench.columns and self._state is PressState.IDLE:
            self._state = PressState.OPEN
        closed = next((e.monotonic_s for e in events if e.kind is PressEventKind.CLOSED), math.inf)
        for event in events:
            if event.kind is PressEventKind.INSERTED:
                self._note_coming(bench, event.monotonic_s, time_s, closed)
            else:
                self._note(bench, event, time_s)
        return bool(events)

    def _placed(self, event: PressEvent, time_s: float) -> tuple[float, float]:
        """Return when a moment was, and how well that is known: a hole or a wire places it less well."""
        at = event.monotonic_s
        if event.source in WIRES:
            between = time_s - (self._now if len(self._scans) else time_s)
            return at - 0.5 * between, 0.3 * between + 0.1
        if (hole := self._scans.hole(at, time_s)) is not None:
            return 0.5 * (hole[0] + hole[1]), 0.3 * (hole[1] - hole[0])
        return at, PLACED_S

    def _note(self, bench: Bench, event: PressEvent, time_s: float) -> None:
        """Keep a moment the detector found, and how well it is known."""
        known, (at, sd) = self._known, self._placed(event, time_s)
        if event.kind is PressEventKind.CLOSED and at - known.moments.opened_s < REOPENED_S:
            known = replace(known, moments=replace(known.moments, opened_s=math.nan))
        elif event.kind is PressEventKind.CLOSED:
            if not len(self._scans):
                self._doubt = "the run begins in the closed press"
            elif math.isfinite(known.moments.opened_s) and not bench.columns:
                self._doubt = "the press has closed again on the same panel"
            if sd > 0.3 * LONGEST_HOLE_S:
                self._doubt = "the press closed while nothing was heard of it for long"
            moments = replace(known.moments, closed_s=at, opened_s=math.nan, removed_s=math.nan)
            known = replace(known, moments=moments, closed_sd=sd)
        elif event.kind is PressEventKind.OPENED:
            known = replace(known, moments=replace(known.moments, opened_s=at), opened_sd=sd)
        else:
            known = replace(known, moments=replace(known.moments, removed_s=at))
        self._known = known
        for point in self._points:
            point[-FOUND_LATER:] = 0.0

    def _note_coming(self, bench: Bench, at: float, time_s: float, closed: float) -> None:
        """Keep when the panel came, as the detector has it; `closed` where only the closing showed it. [s]"""
        scans, came, doubt = self._scans, Coming(at), ""
        if len(scans) and not bench.columns and time_s - self._first <= LONGEST_WAIT_S:
            came = Coming(self._first)
        elif len(scans):
            opened = self._known.moments.opened_s
            opened = opened if math.isfinite(opened) else -math.inf
            came = coming(self._seen(bench), self._initial, at, closed, time_s, opened)
            warm = bench.lower >= 0 and scans.level[0, bench.lower] >= self._hot_C
            if warm and came.at < self._first - UNCLEAR_S:
                doubt = "the run begins with the panel on the hot plate"
            if came.sd > UNCLEAR_S:  # before the first scan it could not be carried on
                came = replace(came, at=max(came.at, self._first + LEAST_WAIT_S))
        if self._initial > HOTTEST_START_C:
            doubt = f"no fresh panel starts at {self._initial:.0f} °C, as the header has it"
        seen = len(scans) > 0 and came.at > self._first + 0.3
        self._known = replace(
            self._known,
            moments=Moments(inserted_s=came.at if seen else math.nan),
            inserted_sd=came.sd if seen else 0.0,
            initial_sd=INITIAL_K,
        )
        self._came, self._judged, self._lies_since = came, 0, came.at
        self._doubt, self._points = doubt, []
        if seen:
            # forget what the channels were like before the panel lay in the press
            self._consensus = fresh_consensus(bench)
            scans.agree_anew(came.at, self._consensus)

    def _note_platens(self, bench: Bench, time_s: float, values: Mapping[str, float]) -> bool:
        """Keep both boundary temperatures, held where missing; return whether both are known at all."""
        for side, boundary in enumerate((bench.press.boundary.bottom, bench.press.boundary.top)):
            value = values.get(boundary.column or "", math.nan) if boundary.kind == "measured" else 0.0
            if value == value:
                self._platens[side], self._platens_seen[side] = value, time_s
        return self._platens[0] == self._platens[0] and self._platens[1] == self._platens[1]

    def _say(self, time_s: float) -> Estimate:
        track = self._track
        mixture = track.mixture if track is not None else None
        if self._state is None:
            return Estimate(time_s, None, reason=UNKNOWN_STATE)
        if track is None or mixture is None or time_s - min(self._platens_seen) > BRIDGE_S:
            return Estimate(time_s, self._state, reason=NO_PLATENS)
        slope = float(track.members[0].filter.chain.level[1])
        ahead = slope * (time_s - float(self._scans.time[track.done - 1]))
        low, high = mixture.low + ahead, mixture.high + ahead
        reason, doubt = "", self._doubt
        waiting = self._state is PressState.IDLE and not math.isfinite(self._known.moments.removed_s)
        if waiting:
            doubt = contradiction(start_error(self._scans.level[-1], self._initial), self._initial)
        if not math.isfinite(self._known.moments.closed_s) and track.missed_K > MISSED_K:
            doubt = doubt or "both faces have leapt while they were not heard"
        if doubt:
            reason = f"{NOT_VALID}: {doubt}"
        elif min(member.misfit for member in track.members) > MISFIT_LIMIT and not mixture.by_faces:
            reason = NOT_VALID
        elif waiting and time_s - self._lower_heard > BLIND_S:
            reason = f"{NOT_OBSERVABLE}: no sensor of the lower face shows whether a panel lies in the press"
        elif (waiting and time_s - self._hot_since > NOTICED_S) or (
            self._overtaken and self._known.inserted_sd > 0.0
        ):
            reason = f"{NOT_OBSERVABLE}: nothing has shown when the panel came"
        elif high - low > 2.0 * WIDEST_K:
            reason = f"{NOT_OBSERVABLE}: band wider than {WIDEST_K:g} K to either side"
        return Estimate(
            time_s=time_s,
            state=self._state,
            core_C=mixture.told + ahead,
            core_sd_K=mixture.sd,
            core_low_C=low,
            core_high_C=high,
            valid=not reason,
            reason=reason,
            suspected=mixture.names[mixture.leading],
        )


def wishes_of(header: Mapping[str, Any]) -> Wishes:
    """Return what a run's header wants of the core."""

    def number(key: str) -> float:
        value = header.get(key)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan

    return Wishes(number("setting.core_target_C"), number("setting.core_limit_C"))
