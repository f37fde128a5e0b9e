"""The live sensor: core temperature with a band one can trust, scan by scan.

Method (decided 2026-11, see also `observer_priors`). The thermal model marches with the platens; forward
tangents say how faces and core answer to every uncertain parameter. A Kalman filter over these parameters
(coefficients, start temperature, platen offsets, moments, what bends the readings, and causes the model in
force leaves out) is corrected by one robust value a face. The belief is joint and Gaussian; "nothing is
missing" and "this cause is missing" are read off it by narrowing the others (`observer_kernels.blend`), so
that the band is a mixture: narrow while the faces agree with the plain model, wide or moved when they do
not. Evaporation, whose tangent at zero says little about its real size, has a filter of its own.

When the belief moves far from where the model was linearised, or a moment of the press becomes known
(always a little late), the stored scans are replayed from the start. Everything is a function of the
scans so far: replay and live agree, and a run cut short gives the same rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from daq.press_events import PressEventDetector
from daq.pressfile import Press, panel_of, press_for_run
from daq.records import Array, Moments, PressEvent, PressEventKind, PressState, Run
from softsensor import observer_kernels as loops
from softsensor.effects import find_effect
from softsensor.modelfile import ModelFile
from softsensor.observer_belief import QUIET_S, Driven, Member, Mixture, mix
from softsensor.observer_priors import TIMING, Plan, panel_plan, plans_for
from softsensor.observer_setup import Bench, Filter, make_filter, panel_bench, prepare_bench

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
BLOCK_S, EAGER_S = 0.45, 4.0
"""Scans are absorbed together over `BLOCK_S`, one by one for `EAGER_S` after a switch. [s]"""
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


@dataclass(frozen=True)
class _Row:
    """One stored scan."""

    time: float
    outside: tuple[float, float]
    level: Array
    votes: Array


@dataclass
class _Known:
    """What has been found out about the run's moments."""

    moments: Moments = field(default_factory=Moments)
    closed_sd: float = 0.15
    opened_sd: float = 0.15


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
        self._known = _Known()
        self._bench: Bench | None = None
        self._state: PressState | None = None
        self._platens = [math.nan, math.nan]
        self._platens_seen = math.nan
        self._rows: list[_Row] = []
        self._done = 0
        self._members: list[Member] = []
        self._driven: Driven | None = None
        self._points: list[Array] = []
        self._mixture: Mixture | None = None
        self._looked_at = -math.inf
        self._initial = math.nan

    # --- one scan -----------------------------------------------------------------------------------

    def update(self, time_s: float, values: Mapping[str, float]) -> Estimate:
        """Take a scan (missing values NaN or left out) and say what the core is doing now."""
        bench = self._bench or self._prepare(values)
        stale = self._detect(bench, time_s, values)
        if not self._note_platens(bench, time_s, values):
            return Estimate(time_s, self._state, reason=NO_PLATENS)
        readings = np.array([values.get(c, math.nan) for c in bench.columns])
        level, votes = np.empty(len(bench.labels)), np.empty(len(bench.labels))
        loops.agree(self._consensus, readings, level, votes)
        self._rows.append(_Row(time_s, (self._platens[0], self._platens[1]), level, votes))
        plain = self._detector.pending is None
        if stale or not self._members or (plain and self._extend() and self._relinearise(time_s)):
            self._replay()
        return self._say(time_s)

    def _prepare(self, values: Mapping[str, float]) -> Bench:
        times = np.linspace(-2.0, 900.0, 24)  # close enough that no gap needs bridging
        columns = {name: np.full(len(times), v) for name, v in values.items()}
        run = Run("live", self._header, times, columns, "live")
        press = press_for_run(self._press, run)
        own = tuple(name for name, _ in self._model.effects) if self._model else ()
        bench = prepare_bench(press, run, own)
        count = len(bench.place)
        self._consensus = loops.Consensus(
            place=bench.place,
            shift=np.zeros(count),
            scatter=np.full(count, 0.04),
            seen=np.zeros(count),
            level=np.full(len(bench.labels), np.nan),
        )
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
        if event.source == "limit switch":
            before = self._rows[-1].time if self._rows else time_s
            at, sd = at - 0.5 * (time_s - before), 0.3 * (time_s - before) + 0.1
        if event.kind is PressEventKind.INSERTED:
            seen = bool(bench.columns) and at > first + 0.3
            if not bench.columns and time_s - first > UNSEEN_WAIT_S:
                at, seen = max(first, time_s - USUAL_WAIT_S), True
            known.moments = Moments(inserted_s=at if seen else math.nan)
        elif event.kind is PressEventKind.CLOSED:
            known.moments = replace(known.moments, closed_s=at, opened_s=math.nan, removed_s=math.nan)
            known.closed_sd = sd
        elif event.kind is PressEventKind.OPENED:
            known.moments, known.opened_sd = replace(known.moments, opened_s=at), sd
        else:
            known.moments = replace(known.moments, removed_s=at)
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

    # --- filters ------------------------------------------------------------------------------------

    def _replay(self) -> None:
        """Start anew with what is known by now and take in all scans."""
        bench = self._bench
        if bench is None:
            return
        plans = plans_for(bench.press, self._model, self._known.closed_sd, self._known.opened_sd)
        if [len(p) for p in self._points] != [len(plan.priors) for plan in plans]:
            self._points = [np.zeros(len(plan.priors)) for plan in plans]
        self._members = [self._start(bench, plan, at) for plan, at in zip(plans, self._points, strict=True)]
        self._driven = self._start_driven(bench)
        self._done = 0
        self._extend()
        self._looked_at = self._rows[-1].time

    def _start(self, bench: Bench, plan: Plan, at: Array) -> Member:
        made = self._filter(bench, plan, at)
        return Member.fresh(bench, made, self._timing(bench, made), plan.suspects, plan.chance, plan.label)

    def _start_driven(self, bench: Bench) -> Driven | None:
        alone = panel_bench(bench) if bench.press.has_states else None
        if alone is None:
            return None
        plan = panel_plan(self._model, alone[0].effects)
        made = self._filter(alone[0], plan, np.zeros(len(plan.priors)))
        return Driven.fresh(made, self._timing(bench, made), alone[1], self._initial)

    def _filter(self, bench: Bench, plan: Plan, at: Array) -> Filter:
        effects = tuple(dict.fromkeys([*bench.effects, *plan.effects]))
        neutral = {e.key(p.name): p.neutral for e in map(find_effect, effects) for p in e.parameters}
        return make_filter(bench, plan.priors, neutral, at, effects)

    def _timing(self, bench: Bench, made: Filter) -> loops.Timing:
        m = self._known.moments
        closing, opening = (made.shift(t) if t in made.names else 0.0 for t in TIMING)
        here = math.inf if self._state is PressState.IDLE and not math.isfinite(m.removed_s) else -math.inf

        def known(moment: float, otherwise: float = math.inf) -> float:
            return moment if math.isfinite(moment) else otherwise

        units = made.timing_units
        return loops.Timing(
            start=self._rows[0].time,
            inserted=known(m.inserted_s, here),
            closed=known(m.closed_s) + closing,
            opened=known(m.opened_s) + opening,
            removed=known(m.removed_s),
            ramp=m.ramp_s,
            switching=bench.press.has_states,
            closed_unit=units[0],
            opened_unit=units[1],
        )

    def _relinearise(self, time_s: float) -> bool:
        """Move the points of linearisation where the belief has gone far from them; return whether it has."""
        since = time_s - self._last_switch(time_s)
        if self._mixture is None or time_s - self._looked_at < max(0.7, 0.4 * since):
            return False
        self._looked_at = time_s
        leading, start, moved = self._mixture.leading, 0, False
        sure = bool(self._mixture.weights[leading] > 0.9)
        for i, member in enumerate(self._members):
            own = leading - start
            inside = 0 <= own <= len(member.suspects)
            point = member.better_point(own if inside else 0, sure and inside)
            if point is not None:
                self._points[i] = point
                moved = True
            start += 1 + len(member.suspects)
        return moved

    def _last_switch(self, now: float) -> float:
        m = self._known.moments
        moments = (m.inserted_s, m.closed_s, m.opened_s, m.removed_s, self._rows[0].time)
        return max(moment for moment in moments if moment <= now)

    # --- marching -----------------------------------------------------------------------------------

    def _extend(self) -> bool:
        """Take in the scans that make up complete blocks; return whether there were any."""
        rows, before = self._rows, self._done
        if self._done == 0:
            self._block(0, 0)
            self._done = 1
        for i in range(self._done, len(rows)):
            since = rows[i].time - rows[self._done - 1].time
            if since >= BLOCK_S - 1e-6 or rows[i].time - self._last_switch(rows[i].time + 1.0) < EAGER_S:
                self._block(self._done, i)
                self._done = i + 1
        if self._done == before:
            return False
        rise = float(self._members[0].filter.chain.level[0]) - self._initial
        self._mixture = mix(self._members, rise if rise == rise else 0.0, self._driven)
        return True

    def _block(self, first: int, last: int) -> None:
        """March over the scans `first` to `last` and correct by what they read."""
        rows = self._rows
        begin, end = rows[max(first - 1, 0)], rows[last]
        elapsed = end.time - begin.time
        if first == last:
            level, votes = end.level, end.votes
            moment = np.ones(len(level))
        else:
            block = rows[first : last + 1]
            levels = np.array([r.level for r in block])
            good = np.isfinite(levels)
            count = np.maximum(good.sum(axis=0), 1)
            times = np.array([[r.time] for r in block])
            level = np.where(good.any(axis=0), np.where(good, levels, 0.0).sum(axis=0) / count, np.nan)
            moment = (np.where(good, times, 0.0).sum(axis=0) / count - begin.time) / elapsed
            votes = np.where(good, [r.votes for r in block], 0.0).sum(axis=0)
        span, outside = np.array([begin.time, end.time]), np.array([begin.outside, end.outside])
        quiet = not first or end.time - self._last_switch(end.time + 1.0) < QUIET_S
        for member in self._members:
            member.take(span, outside, level, moment, votes, quiet=quiet)
        if self._driven is not None:
            self._driven.take(span, end.level)

    # --- rows ---------------------------------------------------------------------------------------

    def _say(self, time_s: float) -> Estimate:
        mixture = self._mixture
        if self._state is None:
            return Estimate(time_s, None, reason=UNKNOWN_STATE)
        if mixture is None or time_s - self._platens_seen > BRIDGE_S:
            return Estimate(time_s, self._state, reason=NO_PLATENS)
        chain = self._members[0].filter.chain
        ahead = float(chain.level[1]) * (time_s - self._rows[self._done - 1].time)
        low, high = mixture.low + ahead, mixture.high + ahead
        reason = ""
        if min(member.misfit for member in self._members) > MISFIT_LIMIT:
            reason = NOT_VALID
        elif high - low > 2.0 * WIDEST_K:
            reason = f"{NOT_OBSERVABLE}: band wider than {WIDEST_K:g} K to either side"
        return Estimate(
            time_s=time_s,
            state=self._state,
            core_C=mixture.mean + ahead,
            core_sd_K=mixture.sd,
            core_low_C=low,
            core_high_C=high,
            valid=not reason,
            reason=reason,
            suspected=mixture.names[mixture.leading],
        )
