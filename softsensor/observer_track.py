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
from softsensor.observer_belief import Driven, Member, Mixture, mix
from softsensor.observer_blocks import Blocks, Scans, cut
from softsensor.observer_priors import INITIAL_K, TIMING, Plan, panel_plan, plans_for
from softsensor.observer_setup import Bench, Filter, make_filter

if TYPE_CHECKING:
    from softsensor.modelfile import ModelFile

LEAST_WAIT_S = 0.5
"""A panel lies in the press for so long at least before it closes. [s]"""
UNSURE = 2.0
"""Faces count from so many standard deviations after an insertion nobody saw: sooner they rise with the root of
time, and a straight line through that would be sure of a moment it cannot know."""
UNEVEN_K = 0.5
"""A panel's faces follow the air of the hall before its core does: where they contradict the header, they tell the
core's start no better than this. [K]"""
EVEN = 0.5
"""Chance of a change from which on the core is no longer counted as before it."""


@dataclass(frozen=True)
class Known:
    """What has been found out about the run's moments."""

    moments: Moments = field(default_factory=Moments)
    inserted_sd: float = 0.0
    """0: as well as the faces show it. [s]"""
    closed_sd: float = 0.15
    opened_sd: float = 0.15
    initial_sd: float = INITIAL_K
    """Of the header's start temperature. [K]"""
    idle: bool = False
    """Whether the press stands empty."""

    @property
    def moments_sd(self) -> tuple[float, float, float]:
        """Standard deviations of the moments of `TIMING`. [s]"""
        return self.inserted_sd, self.closed_sd, self.opened_sd

    def switches(self, first: float) -> Array:
        """Return when the press moved, NaN where it has not; `first` is the run's first scan. [s]"""
        m = self.moments
        return np.array([first, m.inserted_s, m.closed_s, m.opened_s, m.removed_s])


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
        self.switches = known.switches(first)
        seen = model.adequacy if model is not None else None
        self.unexplained = seen.unexplained_K if seen is not None else 0.0
        self.uneven = UNEVEN_K if known.initial_sd > INITIAL_K else 0.0
        plans = plans_for(bench.press, model, known.moments_sd, known.initial_sd)
        if points is None or [len(p) for p in points] != [len(plan.priors) for plan in plans]:
            points = [plan.start.copy() for plan in plans]
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
        plan = panel_plan(model, alone[0].effects, self._known.initial_sd)
        made = _filter(alone[0], plan, np.zeros(len(plan.priors)))
        return Driven.fresh(made, self._timing(made), alone[1], self._initial)

    def _timing(self, made: Filter) -> loops.Timing:
        m = self._known.moments
        coming, closing, opening = (made.shift(t) if t in made.names else 0.0 for t in TIMING)
        here = math.inf if self._known.idle and not math.isfinite(m.removed_s) else -math.inf

        def known(moment: float, otherwise: float = math.inf) -> float:
            return moment if math.isfinite(moment) else otherwise

        units, closed = made.timing_units, known(m.closed_s) + closing
        return loops.Timing(
            start=self._first,
            inserted=min(known(m.inserted_s, here) + coming, closed - LEAST_WAIT_S),
            closed=closed,
            opened=known(m.opened_s) + opening,
            removed=known(m.removed_s),
            ramp=m.ramp_s,
            switching=self._bench.press.has_states,
            inserted_unit=units[0],
            closed_unit=units[1],
            opened_unit=units[2],
            longest=loops.LONGEST_STEP_S,
        )

    @property
    def missed_K(self) -> float:  # noqa: N802
        """By how much both faces moved while they were not heard, at most. [K]"""
        return 0.0 if self.driven is None else float(self.driven.unheard[2])

    @property
    def read(self) -> Array:
        """What the model says the faces read (M). [°C]"""
        return self.members[0].filter.chain.read

    @property
    def rise(self) -> float:
        """How far the core has come from its start, 0 where that is not known. [K]"""
        rise = float(self.members[0].filter.chain.level[0]) - self._initial
        return rise if rise == rise else 0.0

    def extend(self, scans: Scans, limit: int, *, blind: bool = False) -> bool:
        """Take in the scans that make up complete blocks, `limit` blocks at most; return whether all are in.

        `blind` foretells from the platens and leaves what the faces read alone.
        """
        ends, whole = cut(scans, self.done, self.switches, limit)
        if len(ends):
            timing = self.members[0].timing
            lies = timing.inserted + UNSURE * self._known.inserted_sd, timing.removed
            blocks = Blocks.of(scans, self.done, ends, lies, self.switches, blind=blind)
            for member in self.members:
                member.take(blocks)
            if self.driven is not None:
                self.driven.take(blocks)
            self.done = int(ends[-1]) + 1
            if whole:
                self.mixture = mix(self.members, self.rise, self.unexplained, self.driven, self.uneven)
                self._sound = self._sound and self.mixture.changed < EVEN
                if self.driven is not None and self._sound:
                    self.driven.before_C = self.driven.core[0]
        return whole

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
