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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press_events import PressEventDetector
from daq.pressfile import Press, panel_of, press_for_run
from daq.records import Array, Moments, PressEvent, PressEventKind, PressState, Run
from softsensor import observer_kernels as loops
from softsensor.effects import find_effect
from softsensor.modelfile import ModelFile
from softsensor.observer_priors import (
    SUSPECTS,
    TIMING,
    Prior,
    Suspect,
    coefficient_priors,
    effect_priors,
    nuisance_priors,
)
from softsensor.observer_setup import CHAIN_UNITS, Bench, Filter, make_filter, prepare_bench

UNKNOWN_STATE = "press state unknown"
NO_PLATENS = "platen reading missing"
BRIDGE_S = 10.0
"""Platen readings are held this long. [s]"""
CHANNEL_K, OFFSET_K = 0.1, 0.3
"""White noise and constant offset of a panel channel. [K]"""
FACE_K, FACE_S = 0.17, 25.0
"""Slow error common to a face, and how fast it is forgotten. [K, s]"""
ROUGH_S, ROUGH_MEMORY_S = 0.15, 3.0
"""How far the model may be off in time where readings jump, and for how long. [s]"""
MARGIN_K, MARGIN_SHARE = 0.08, 0.006
"""What the model itself adds: absolute, and of the core's rise."""
BLOCK_S, EAGER_S = 0.45, 4.0
"""Scans are absorbed together over `BLOCK_S`, one by one for `EAGER_S` after a switch. [s]"""
GATE = 4.0
EVAPORATION = ("moisture_evaporation.moisture_percent", "moisture_evaporation.temperature_C")
EVAPORATION_CHANCE = 0.03


@dataclass(frozen=True)
class Estimate:
    """What the live sensor says at one scan."""

    time_s: float
    state: PressState | None
    """None: unknown."""
    core_C: float  # noqa: N815
    core_sd_K: float  # noqa: N815
    core_low_C: float  # noqa: N815
    core_high_C: float  # noqa: N815
    valid: bool
    reason: str = ""


@dataclass
class _Member:
    """A filter with its belief and how well it has done."""

    filter: Filter
    suspects: tuple[Suspect, ...]
    chance: float
    x: Array
    cov: Array
    fit: float = 0.0
    misfit: float = 1.0
    """Mean squared normalised innovation, the newest weighing most."""

    @property
    def where(self) -> loops.Integers:
        names = self.filter.names
        return np.array([names.index(s.parameter) for s in self.suspects], dtype=np.int64)


@dataclass(frozen=True)
class _Row:
    """One stored scan."""

    time: float
    outside: tuple[float, float]
    level: Array
    votes: Array


@dataclass(frozen=True)
class _Mixture:
    weights: Array
    means: Array
    sds: Array

    @property
    def mean(self) -> float:
        return float(self.weights @ self.means)

    @property
    def sd(self) -> float:
        return float(np.sqrt(self.weights @ (self.sds**2 + (self.means - self.mean) ** 2)))


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
        self._bench: Bench | None = None
        self._detector = PressEventDetector(press)
        self._moments = Moments()
        self._closed_sd, self._opened_sd = 0.15, 0.15
        self._rows: list[_Row] = []
        self._done = 0
        self._members: list[_Member] = []
        self._points: list[Array] = []
        self._mixture: _Mixture | None = None
        self._platens = [math.nan, math.nan]
        self._platen_age = 0.0
        self._last_replay = -math.inf
        self._state: PressState | None = None

    # --- one scan -----------------------------------------------------------------------------------

    def update(self, time_s: float, values: Mapping[str, float]) -> Estimate:
        """Take a scan (missing values NaN or left out) and say what the core is doing now."""
        if self._bench is None:
            self._bench = self._prepare(time_s, values)
        stale = self._detect(time_s, values)
        outside = self._outside(time_s, values)
        if outside is None:
            return self._nothing(time_s, NO_PLATENS)
        self._store(time_s, values, outside)
        if not self._members or stale:
            self._replay()
        else:
            self._extend()
            self._settle()
        return self._say(time_s)

    def _nothing(self, time_s: float, reason: str) -> Estimate:
        nan = math.nan
        return Estimate(time_s, self._state, nan, nan, nan, nan, False, reason)

    def _prepare(self, time_s: float, values: Mapping[str, float]) -> Bench:
        columns = {name: np.full(2, v) for name, v in values.items()}
        run = Run("live", self._header, np.array([-2.0, 900.0]), columns, "live")
        press = press_for_run(self._press, run)
        own = tuple(name for name, _ in self._model.effects) if self._model else ()
        bench = prepare_bench(press, run, own)
        self._consensus = loops.Consensus(
            place=bench.place,
            shift=np.zeros(len(bench.place)),
            scatter=np.full(len(bench.place), 0.04),
            seen=np.zeros(len(bench.place)),
            level=np.full(len(bench.labels), np.nan),
        )
        return bench

    def _detect(self, time_s: float, values: Mapping[str, float]) -> bool:
        """Follow the press; return whether what was known of its moments has changed."""
        bench = self._bench
        if bench is None or not bench.press.has_states:
            self._state = PressState.CLOSED
            return False
        events = self._detector.update(time_s, values)
        self._state = self._detector.state
        if not bench.columns and self._state is PressState.IDLE:
            self._state = PressState.OPEN if "closed" in values else None
        for event in events:
            self._note(event, time_s)
        return bool(events)

    def _note(self, event: PressEvent, time_s: float) -> None:
        at, sd = event.monotonic_s, 0.15
        if event.source == "limit switch":
            before = self._rows[-1].time if self._rows else time_s
            at, sd = at - 0.5 * (time_s - before), 0.3 * (time_s - before) + 0.1
        first = self._rows[0].time if self._rows else time_s
        if event.kind is PressEventKind.INSERTED:
            seen = bool(self._bench and self._bench.columns)
            known = seen and at > first + 0.3
            if not seen and time_s - first > 30.0:
                at, known = max(first, time_s - 18.0), True
            self._moments = Moments(inserted_s=at if known else math.nan)
        elif event.kind is PressEventKind.CLOSED:
            self._moments = replace(self._moments, closed_s=at, opened_s=math.nan, removed_s=math.nan)
            self._closed_sd = sd
        elif event.kind is PressEventKind.OPENED:
            self._moments = replace(self._moments, opened_s=at)
            self._opened_sd = sd
        else:
            self._moments = replace(self._moments, removed_s=at)
        for point in self._points:
            point[-2:] = 0.0

    def _outside(self, time_s: float, values: Mapping[str, float]) -> tuple[float, float] | None:
        """Return both boundary temperatures, held for a while where missing; None where too long."""
        assert_press = self._bench.press if self._bench else self._press
        good = True
        for side, boundary in enumerate((assert_press.boundary.bottom, assert_press.boundary.top)):
            if boundary.kind != "measured":
                self._platens[side] = 0.0
                continue
            value = values.get(boundary.column or "", math.nan)
            if value == value:
                self._platens[side] = value
            else:
                good = False
        if any(v != v for v in self._platens):
            return None
        if good:
            self._platen_age = time_s
        return (self._platens[0], self._platens[1])

    def _store(self, time_s: float, values: Mapping[str, float], outside: tuple[float, float]) -> None:
        bench = self._bench
        columns = bench.columns if bench else ()
        readings = np.array([values.get(c, math.nan) for c in columns], dtype=float)
        level, votes = np.empty(len(self._consensus.level)), np.empty(len(self._consensus.level))
        loops.agree(self._consensus, readings, level, votes)
        self._rows.append(_Row(time_s, outside, level, votes))

    # --- filters ------------------------------------------------------------------------------------

    def _priors(self) -> tuple[list[Prior], list[Suspect], list[Prior]]:
        """Return common parameters, suspects of the joint filter, and the timing parameters."""
        bench = self._bench
        if bench is None:
            return [], [], []
        own = {name for name, _ in self._model.effects} if self._model else set()
        panel = bool(bench.press.panel_layers)
        common = coefficient_priors(bench.press, self._model) + effect_priors(self._model)
        common += nuisance_priors(bench.press, own, initial=True)
        suspects = [s for s in SUSPECTS if panel and s.effect not in own]
        timing = [Prior("closed_s", 0.0, self._closed_sd), Prior("opened_s", 0.0, self._opened_sd)]
        return common, suspects, timing if bench.press.has_states else []

    def _build(self) -> None:
        """Make the filters anew at the points they are linearised at."""
        bench = self._bench
        if bench is None:
            return
        common, suspects, timing = self._priors()
        own = {name for name, _ in self._model.effects} if self._model else set()
        joint = common + [_suspected(s) for s in suspects] + timing
        plans: list[tuple[list[Prior], tuple[Suspect, ...], float]] = [
            (joint, tuple(suspects), 1.0 - sum(s.chance for s in suspects) - EVAPORATION_CHANCE)
        ]
        if suspects and "moisture_evaporation" not in own:
            wet = [Prior(EVAPORATION[0], 4.0, 2.0), Prior(EVAPORATION[1], 102.0, 3.0)]
            firm = [Prior(s.parameter, 1.0, 0.01) for s in suspects if s.parameter.endswith(".ratio")]
            plans.append((common + wet + firm + timing, (), EVAPORATION_CHANCE))
        if [len(p) for p in self._points] != [len(plan[0]) for plan in plans]:
            self._points = [np.zeros(len(plan[0])) for plan in plans]
        self._members = []
        for (priors, mine, chance), at in zip(plans, self._points, strict=True):
            effects = list(
                dict.fromkeys([*bench.effects, *(p.name.partition(".")[0] for p in priors if _is_effect(p))])
            )
            neutral = {e.key(p.name): p.neutral for e in map(find_effect, effects) for p in e.parameters}
            made = make_filter(bench, priors, neutral, at, effects)
            size = len(priors) + 2 + 2 * len(bench.labels)
            cov = np.eye(size)
            m = len(bench.labels)
            for a in range(m):
                channels = max(1, int((bench.place == a).sum()))
                cov[-2 * m + a, -2 * m + a] = (OFFSET_K * 1.2) ** 2 / channels
                cov[-m + a, -m + a] = FACE_K**2
            self._members.append(_Member(made, mine, chance, np.zeros(size), cov))
        self._done = 0

    def _timing(self, filter_: Filter) -> loops.Timing:
        m = self._moments
        closing, opening = (filter_.shift(t) if t in filter_.names else 0.0 for t in TIMING)

        def known(moment: float) -> float:
            return moment if math.isfinite(moment) else math.inf

        units = filter_.timing_units
        return loops.Timing(
            start=self._rows[0].time,
            inserted=m.inserted_s if math.isfinite(m.inserted_s) else self._present,
            closed=known(m.closed_s) + closing,
            opened=known(m.opened_s) + opening,
            removed=known(m.removed_s),
            ramp=m.ramp_s,
            switching=bool(self._bench and self._bench.press.has_states),
            closed_unit=units[0],
            opened_unit=units[1],
        )

    @property
    def _present(self) -> float:
        """Without a known insertion the panel is either there from the start or not there yet."""
        return math.inf if self._state is PressState.IDLE else -math.inf

    # --- marching -----------------------------------------------------------------------------------

    def _replay(self) -> None:
        """Start anew with what is known by now and take in all scans."""
        self._build()
        self._extend()
        self._last_replay = self._rows[-1].time

    def _extend(self) -> None:
        """Take in the scans that make up complete blocks."""
        rows = self._rows
        if self._done == 0:
            self._block(0, 0)
            self._done = 1
        first = self._done
        for i in range(first, len(rows)):
            begin = rows[self._done - 1].time
            if rows[i].time - begin >= self._block_length(rows[i].time) - 1e-6:
                self._block(self._done, i)
                self._done = i + 1
        self._mix()

    def _block_length(self, now: float) -> float:
        m = self._moments
        for moment in (m.closed_s, m.opened_s, m.inserted_s, m.removed_s, self._rows[0].time):
            if -1.0 <= now - moment < EAGER_S:
                return 0.0
        return BLOCK_S

    def _block(self, first: int, last: int) -> None:
        """March over the scans `first` to `last` and correct by what they read."""
        rows = self._rows[first : last + 1]
        begin = self._rows[max(first - 1, 0)]
        end = rows[-1]
        elapsed = end.time - begin.time
        votes = np.array([r.votes for r in rows])
        levels = np.array([r.level for r in rows])
        good = np.isfinite(levels)
        count = good.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            level = np.where(good, levels, 0.0).sum(axis=0) / count
            times = np.array([r.time for r in rows])
            moment = np.where(good, times[:, None], 0.0).sum(axis=0) / count
            share = (moment - begin.time) / elapsed if elapsed > 0 else np.ones(len(level))
        vote = (np.where(good, votes, 0.0)).sum(axis=0)
        outside = np.array([begin.outside, end.outside])
        span = np.array([begin.time, end.time])
        errors = np.array([CHANNEL_K, ROUGH_S, ROUGH_MEMORY_S])
        units = np.array(CHAIN_UNITS)
        m = len(level)
        for member in self._members:
            f = member.filter
            read, d_read = f.chain.read.copy(), f.chain.d_read.copy()
            if elapsed > 0:
                loops.march(
                    f.stack, f.tangents, f.d_boundary, f.state, f.nonlinear, f.factors, f.chain, f.places,
                    self._timing(f), span, outside, f.moving,
                )  # fmt: skip
                loops.drift(member.x, member.cov, len(member.x) - m, math.exp(-elapsed / FACE_S), FACE_K**2)
            if m:
                fit, squares, n = loops.absorb_faces(
                    member.x,
                    member.cov,
                    f.at,
                    f.chain,
                    read,
                    d_read,
                    level,
                    share,
                    vote,
                    elapsed,
                    errors,
                    units,
                    GATE,
                )
                member.fit += fit
                if n:
                    keep = math.exp(-max(elapsed, 0.05) / 10.0)
                    member.misfit = keep * member.misfit + (1 - keep) * squares / n

    def _mix(self) -> None:
        """Blend what all hypotheses say about the core."""
        logs, means, variances = [], [], []
        for member in self._members:
            f = member.filter
            p = len(f.names)
            readout = np.zeros(len(member.x))
            readout[:p] = f.chain.d_level
            centre = f.chain.level[0] + f.chain.d_level @ (member.x[:p] - f.at)
            e = len(member.suspects)
            shift, spread, evidence, sizes = np.empty(e + 1), np.empty(e + 1), np.empty(e + 1), np.empty(e)
            spike = np.array([s.spike for s in member.suspects])
            sided = np.array([s.one_sided for s in member.suspects], dtype=bool)
            loops.blend(member.x, member.cov, readout, member.where, spike, sided, shift, spread, evidence, sizes)
            chances = np.array([member.chance, *(s.chance for s in member.suspects)])
            logs.append(np.log(chances) + evidence + member.fit)
            means.append(centre + shift)
            margin = MARGIN_K**2 + (MARGIN_SHARE * (centre - self._initial)) ** 2
            variances.append(spread + margin)
        log = np.concatenate(logs)
        weights = np.exp(log - log.max())
        self._mixture = _Mixture(
            weights / weights.sum(), np.concatenate(means), np.sqrt(np.concatenate(variances))
        )

    @property
    def _initial(self) -> float:
        return (
            panel_of(self._bench.run).initial_temperature
            if self._bench and self._bench.press.panel_layers
            else 0.0
        )

    def _settle(self) -> None:
        """Linearise anew where the belief has moved far."""

    # --- rows ---------------------------------------------------------------------------------------

    def _say(self, time_s: float) -> Estimate:
        if self._state is None:
            return self._nothing(time_s, UNKNOWN_STATE)
        if time_s - self._platen_age > BRIDGE_S:
            return self._nothing(time_s, NO_PLATENS)
        mixture = self._mixture
        if mixture is None:
            return self._nothing(time_s, "no estimate yet")
        f = self._members[0].filter
        ahead = f.chain.level[1] * (time_s - self._rows[self._done - 1].time)
        low = loops.quantile(mixture.weights, mixture.means, mixture.sds, 0.025)
        high = loops.quantile(mixture.weights, mixture.means, mixture.sds, 0.975)
        return Estimate(time_s, self._state, mixture.mean + ahead, mixture.sd, low + ahead, high + ahead, True)


def _suspected(suspect: Suspect) -> Prior:
    effect = find_effect(suspect.effect)
    neutral = next(p.neutral for p in effect.parameters if effect.key(p.name) == suspect.parameter)
    return Prior(suspect.parameter, neutral, suspect.sd)


def _is_effect(prior: Prior) -> bool:
    return "." in prior.name and not prior.name.startswith("skin.")
