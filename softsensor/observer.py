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

from daq.press_events import PressEventDetector
from daq.press_wires import WIRES
from daq.pressfile import Press, panel_of, press_for_run
from daq.records import Array, Moments, PressEvent, PressEventKind, PressState, Run
from softsensor import observer_kernels as loops
from softsensor.modelfile import ModelFile
from softsensor.observer_belief import Mixture
from softsensor.observer_outlook import Inside, Outlook, Wishes, look_ahead, look_inside
from softsensor.observer_priors import TIMING
from softsensor.observer_setup import Bench, fresh_consensus, prepare_bench
from softsensor.observer_track import Known, Row, Track

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
UNSEEN_WAIT_S, USUAL_WAIT_S = 30.0, 18.0
"""A panel nobody saw coming in is taken to lie in the open press from the first scan, but not longer than
the first; else for the second, the usual time. [s]"""


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
        self._platens_seen = math.nan
        self._initial = math.nan
        self._rows: list[Row] = []
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
        stale = self._detect(bench, time_s, values)
        if not self._note_platens(bench, time_s, values):
            return Estimate(time_s, self._state, reason=NO_PLATENS)
        readings = np.array([values.get(c, math.nan) for c in bench.columns])
        self._rows.append(self._agreed(bench, time_s, (self._platens[0], self._platens[1]), readings))
        try:
            self._take_in(bench, time_s, stale=stale)
        except (ArithmeticError, np.linalg.LinAlgError):  # begin anew from what was known before the run
            self._track = self._next = None
            return Estimate(time_s, self._state, reason=NOT_VALID)
        return self._say(time_s)

    def _agreed(self, bench: Bench, time_s: float, outside: tuple[float, float], readings: Array) -> Row:
        """Bring a scan's channels to one value a face."""
        level, votes = np.empty(len(bench.labels)), np.empty(len(bench.labels))
        loops.agree(self._consensus, readings, level, votes)
        return Row(time_s, outside, level, votes, readings)

    def _listen_anew(self, bench: Bench, since: float) -> None:
        """Forget what the channels were like before the panel lay in the press, and go through the scans since."""
        self._consensus = fresh_consensus(bench)
        rows = self._rows
        for i, row in enumerate(rows):
            if row.time >= since:
                rows[i] = self._agreed(bench, row.time, row.outside, row.readings)

    def _take_in(self, bench: Bench, now: float, *, stale: bool) -> None:
        """Bring the filters up to the newest scan, or a new pass of them nearer to it."""
        rows = self._rows
        if stale or (self._track is None and self._next is None):
            self._begin(bench, None if self._track is None else self._points)
            self._overtaken = stale
        elif self._track is not None and self._detector.pending is None:
            self._track.extend(rows, len(rows), blind=self._overtaken)
            if self._next is None and self._due(now):
                self._linearised = now
                if (points := self._track.better_points()) is not None:
                    self._begin(bench, points)
        if self._next is not None:
            step = now - rows[-2].time if len(rows) > 1 else 0.0
            if self._next.extend(rows, max(LEAST_BLOCKS, round(BLOCKS_PER_S * step))):
                self._track, self._next, self._linearised = self._next, None, now
                self._overtaken = False

    def _begin(self, bench: Bench, points: Sequence[Array] | None) -> None:
        """Begin a pass with what is known by now; the present one answers until it has caught up."""
        known = replace(self._known, idle=self._state is PressState.IDLE)
        self._next = Track(bench, self._model, known, points, self._rows[0].time, self._initial)
        self._points = self._next.points

    def _due(self, now: float) -> bool:
        """Return whether it is time to ask if the filters are still linearised near enough."""
        since = now - self._known.last_switch(now, self._rows[0].time)
        return now - self._linearised >= max(0.7, 0.4 * since)

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
        return self._outlook.later(self._rows[-1].time - self._looked_ahead) if self._rows else self._outlook

    def look_ahead(self) -> None:
        """Work out what lies ahead, where that matters and the last look is `OUTLOOK_S` old. Takes some 10 ms."""
        track = self._track
        if track is None or not self._wishes.any or not math.isfinite(self._known.moments.closed_s):
            return
        now = self._rows[-1].time
        if now - self._looked_ahead < OUTLOOK_S:
            return
        self._looked_ahead, self._outlook = now, Outlook()
        if self._state is PressState.CLOSED or self._state is PressState.OPEN:
            done = self._rows[track.done - 1].time
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
        if press.panel_layers:
            self._initial = panel_of(run).initial_temperature
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
        for event in events:
            self._note(bench, event, time_s)
        return bool(events)

    def _note(self, bench: Bench, event: PressEvent, time_s: float) -> None:
        """Keep a moment the detector found, and how well it is known."""
        at, sd, known = event.monotonic_s, 0.15, self._known
        first = self._rows[0].time if self._rows else time_s
        if event.source in WIRES:
            before = self._rows[-1].time if self._rows else time_s
            at, sd = at - 0.5 * (time_s - before), 0.3 * (time_s - before) + 0.1
        if event.kind is PressEventKind.INSERTED:
            seen = bool(bench.columns) and at > first + 0.3
            if not bench.columns and time_s - first > UNSEEN_WAIT_S:
                at, seen = max(first, time_s - USUAL_WAIT_S), True
            known = replace(known, moments=Moments(inserted_s=at if seen else math.nan))
            if seen:
                self._listen_anew(bench, at)
        elif event.kind is PressEventKind.CLOSED:
            moments = replace(known.moments, closed_s=at, opened_s=math.nan, removed_s=math.nan)
            known = replace(known, moments=moments, closed_sd=sd)
        elif event.kind is PressEventKind.OPENED:
            known = replace(known, moments=replace(known.moments, opened_s=at), opened_sd=sd)
        else:
            known = replace(known, moments=replace(known.moments, removed_s=at))
        self._known = known
        for point in self._points:
            point[-len(TIMING) :] = 0.0

    def _note_platens(self, bench: Bench, time_s: float, values: Mapping[str, float]) -> bool:
        """Keep both boundary temperatures, held where missing; return whether both are known at all."""
        good = True
        for side, boundary in enumerate((bench.press.boundary.bottom, bench.press.boundary.top)):
            value = values.get(boundary.column or "", math.nan) if boundary.kind == "measured" else 0.0
            if value == value:
                self._platens[side] = value
            else:
                good = False
        if good:
            self._platens_seen = time_s
        return self._platens[0] == self._platens[0] and self._platens[1] == self._platens[1]

    def _say(self, time_s: float) -> Estimate:
        track = self._track
        mixture = track.mixture if track is not None else None
        if self._state is None:
            return Estimate(time_s, None, reason=UNKNOWN_STATE)
        if track is None or mixture is None or time_s - self._platens_seen > BRIDGE_S:
            return Estimate(time_s, self._state, reason=NO_PLATENS)
        slope = float(track.members[0].filter.chain.level[1])
        ahead = slope * (time_s - self._rows[track.done - 1].time)
        low, high = mixture.low + ahead, mixture.high + ahead
        reason = ""
        if min(member.misfit for member in track.members) > MISFIT_LIMIT and not mixture.by_faces:
            reason = NOT_VALID
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
