"""One pass of the live sensor's filters over a run's scans, with what was known of its moments at the time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from daq.records import Array, Moments
from softsensor import observer_kernels as loops
from softsensor.effects import find_effect
from softsensor.observer_belief import QUIET_S, Driven, Member, Mixture, mix, timing_inside
from softsensor.observer_priors import TIMING, Plan, panel_plan, plans_for
from softsensor.observer_setup import Bench, Filter, make_filter

if TYPE_CHECKING:
    from softsensor.modelfile import ModelFile

BLOCK_S, EAGER_S = 0.45, 4.0
"""Scans are absorbed together over `BLOCK_S`, one by one for `EAGER_S` after a switch. [s]"""


EVEN = 0.5
"""Chance of a change from which on the core is no longer counted as before it."""


@dataclass(frozen=True)
class Row:
    """One stored scan."""

    time: float
    outside: tuple[float, float]
    level: Array
    votes: Array
    readings: Array
    """Of the single channels. [°C]"""


@dataclass(frozen=True)
class Known:
    """What has been found out about the run's moments."""

    moments: Moments = field(default_factory=Moments)
    closed_sd: float = 0.15
    opened_sd: float = 0.15
    idle: bool = False
    """Whether the press stands empty."""

    def last_switch(self, now: float, first: float) -> float:
        """Return the newest moment up to `now`; `first` is the run's first scan. [s]"""
        m = self.moments
        return max(t for t in (m.inserted_s, m.closed_s, m.opened_s, m.removed_s, first) if t <= now)


class Track:
    """Filters side by side, and how far they have come.

    Parameters
    ----------
    bench, model
        The press with the run's overrides, and the model in force.
    known
        The run's moments as known when the pass began.
    points
        Where to linearise; None starts from the priors.
    first
        Time of the first scan. [s]
    initial
        The panel's start temperature, NaN without a panel. [°C]
    """

    def __init__(
        self,
        bench: Bench,
        model: ModelFile | None,
        known: Known,
        points: Sequence[Array] | None,
        first: float,
        initial: float,
    ) -> None:
        self._bench, self._known, self._first, self._initial = bench, known, first, initial
        seen = model.adequacy if model is not None else None
        self.unexplained = seen.unexplained_K if seen is not None else 0.0
        plans = plans_for(bench.press, model, known.closed_sd, known.opened_sd)
        if points is None or [len(p) for p in points] != [len(plan.priors) for plan in plans]:
            points = [plan.start for plan in plans]
        self.points = list(points)
        self.members = [self._start(plan, at) for plan, at in zip(plans, points, strict=True)]
        self.driven = self._start_driven(model)
        self.done = 0
        """Scans taken in."""
        self.mixture: Mixture | None = None
        self._sound = True
        """Whether nothing has changed at once so far."""

    def _start(self, plan: Plan, at: Array) -> Member:
        made = _filter(self._bench, plan, at)
        return Member.fresh(self._bench, made, self._timing(made), plan)

    def _start_driven(self, model: ModelFile | None) -> Driven | None:
        alone = self._bench.alone
        if alone is None:
            return None
        plan = panel_plan(model, alone[0].effects)
        made = _filter(alone[0], plan, np.zeros(len(plan.priors)))
        return Driven.fresh(made, self._timing(made), alone[1], self._initial)

    def _timing(self, made: Filter) -> loops.Timing:
        m = self._known.moments
        closing, opening = (made.shift(t) if t in made.names else 0.0 for t in TIMING)
        here = math.inf if self._known.idle and not math.isfinite(m.removed_s) else -math.inf

        def known(moment: float, otherwise: float = math.inf) -> float:
            return moment if math.isfinite(moment) else otherwise

        units = made.timing_units
        return loops.Timing(
            start=self._first,
            inserted=known(m.inserted_s, here),
            closed=known(m.closed_s) + closing,
            opened=known(m.opened_s) + opening,
            removed=known(m.removed_s),
            ramp=m.ramp_s,
            switching=self._bench.press.has_states,
            closed_unit=units[0],
            opened_unit=units[1],
            longest=loops.LONGEST_STEP_S,
        )

    @property
    def rise(self) -> float:
        """How far the core has come from its start, 0 where that is not known. [K]"""
        rise = float(self.members[0].filter.chain.level[0]) - self._initial
        return rise if rise == rise else 0.0

    def extend(self, rows: Sequence[Row], limit: int, *, blind: bool = False) -> bool:
        """Take in the scans that make up complete blocks, `limit` blocks at most; return whether all are in.

        `blind` foretells from the platens and leaves what the faces read alone.
        """
        before = self.done
        if self.done == 0:
            self._block(rows, 0, 0, blind=blind)
            self.done = 1
        for i in range(self.done, len(rows)):
            since = rows[i].time - rows[self.done - 1].time
            fresh = rows[i].time - self._last_switch(rows[i].time + 1.0) < EAGER_S
            if since < BLOCK_S - 1e-6 and not fresh:
                continue
            if limit == 0:
                return False
            self._block(rows, self.done, i, blind=blind)
            self.done = i + 1
            limit -= 1
        if self.done > before:
            self.mixture = mix(self.members, self.rise, self.unexplained, self.driven)
            self._sound = self._sound and self.mixture.changed < EVEN
            if self.driven is not None and self._sound:
                self.driven.before_C = self.driven.core[0]
        return True

    def _block(self, rows: Sequence[Row], first: int, last: int, *, blind: bool) -> None:
        """March over the scans `first` to `last` and correct by what they read."""
        begin, end = rows[max(first - 1, 0)], rows[last]
        elapsed = end.time - begin.time
        if first == last:
            level, votes = self._heard(end), end.votes
            moment = np.ones(len(level))
        else:
            block = rows[first : last + 1]
            levels = np.array([self._heard(r) for r in block])
            good = np.isfinite(levels)
            count = np.maximum(good.sum(axis=0), 1)
            times = np.array([[r.time] for r in block])
            level = np.where(good.any(axis=0), np.where(good, levels, 0.0).sum(axis=0) / count, np.nan)
            moment = (np.where(good, times, 0.0).sum(axis=0) / count - begin.time) / elapsed
            votes = np.where(good, [r.votes for r in block], 0.0).sum(axis=0)
        span, outside = np.array([begin.time, end.time]), np.array([begin.outside, end.outside])
        quiet = not first or end.time - self._last_switch(end.time + 1.0) < QUIET_S
        heard = np.full(len(level), np.nan) if blind else level
        for member in self.members:
            member.take(span, outside, heard, moment, votes, quiet=quiet)
        if self.driven is not None:
            self.driven.take(span, end.level)

    def _heard(self, row: Row) -> Array:
        """Return what the faces read, NaN while no panel is in the press: sensors tell of hands and air then."""
        inside = timing_inside(self.members[0].timing, row.time)
        return row.level if inside else np.full(len(row.level), np.nan)

    def _last_switch(self, now: float) -> float:
        return self._known.last_switch(now, self._first)

    def better_points(self) -> list[Array] | None:
        """Return where to linearise anew, None where the belief is still near enough."""
        better = [member.better_point() for member in self.members]
        if all(point is None for point in better):
            return None
        return [old if new is None else new for old, new in zip(self.points, better, strict=True)]


def _filter(bench: Bench, plan: Plan, at: Array) -> Filter:
    effects = tuple(dict.fromkeys([*bench.effects, *plan.effects]))
    neutral = {e.key(p.name): p.neutral for e in map(find_effect, effects) for p in e.parameters}
    return make_filter(bench, plan.priors, neutral, at, effects)
