"""Passes of the live sensor's filters over a run's scans, each with what was known of its moments at the time.

While a pass that knows better goes through the stored scans, the one before goes on answering.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from daq.records import Array, Moments, PressEventKind, PressState
from softsensor.live.block_steps import Counted, last_switch
from softsensor.live.blocks import ScanArrays, blocks_of, cut
from softsensor.live.budget import band_from
from softsensor.live.curing import ResinSetup
from softsensor.live.inside import Inside, look_inside
from softsensor.live.kalman import BetweenFaces, KalmanFilter
from softsensor.live.leaving import KnownPanel, known_panel
from softsensor.live.march_steps import LONGEST_STEP_S, PressTiming, SensorChain
from softsensor.live.mixture import Mixture, mix, model_variance
from softsensor.live.panels import LikelyPanel
from softsensor.live.priors import TIMING, FilterPlan, panel_plan, plans_for
from softsensor.live.setup import Linearised, RunSetup, linearise
from softsensor.signals.instrument import LIVE_MOMENT_S, START_K

if TYPE_CHECKING:
    from softsensor.heat.model_file import ModelFile

LEAST_WAIT_S = 0.5
"""A panel lies in the press for so long at least before it closes. [s] By hand."""
UNSURE = 2.0
"""Faces count from so many standard deviations after an insertion nobody saw: sooner they rise with the root of
time, and a straight line through that would be sure of a moment it cannot know. By hand."""
UNEVEN_K = 0.5
"""A panel's faces follow the air of the hall before its core does: where they contradict the header, they show the
core's start no better than this. [K] By hand."""
BLOCKS_PER_S, LEAST_BLOCKS = 250, 25
"""How fast a new pass over the stored scans catches up: blocks for each second of the run, and for each scan.
By hand."""
FOUND_LATER = 2
"""So many of `TIMING`, closing and opening, become known after the filters have begun."""
CLOSED = 2
"""Where the closing stands among a run's switches."""
EVEN = 0.5
"""Chance of a change from which on the core is no longer counted as before it. By hand."""


@dataclass(frozen=True)
class KnownMoments:
    """What has been found out about the run's moments."""

    moments: Moments = field(default_factory=Moments)
    inserted_sd: float = 0.0
    """0: as well as the faces show it. [s]"""
    closed_sd: float = LIVE_MOMENT_S
    opened_sd: float = LIVE_MOMENT_S
    initial_sd: float = START_K
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


class Pass:
    """Filters side by side, and how far they have come.

    Parameters
    ----------
    panels, model
        The panels that may lie in the press, the header's first, and the model in force.
    known
        The run's moments as known when the pass began.
    points
        Where to linearise; None starts from the priors.
    first
        Time of the first scan. [s]
    """

    def __init__(
        self,
        panels: Sequence[LikelyPanel],
        model: ModelFile | None,
        known: KnownMoments,
        points: Sequence[Array] | None,
        first: float,
    ) -> None:
        setup = panels[0].setup
        self._setup, self._known, self._first = setup, known, first
        self._panels = panels
        self.switches = known.switches(first)
        self._uneven = UNEVEN_K if known.initial_sd > setup.start_sd else 0.0
        planned = [
            (number, panel, plan) for number, panel in enumerate(panels) for plan in self._plans(panel, model)
        ]
        plans = [plan for _, _, plan in planned]
        if points is None or [len(p) for p in points] != [len(plan.priors) for plan in plans]:
            points = [plan.start.copy() for plan in plans]
        self._planned = planned
        self.points = list(points)
        self.filters = [self._filter(i, at) for i, at in enumerate(points)]
        self.between = [self._between_faces(panel.setup, model) for panel in panels]
        self._marched: list[KalmanFilter | BetweenFaces] = [*self.filters, *_known(self.between)]
        """What is taken over the scans: all, or until it has caught up what differs from the pass beside it."""
        self._beside: Pass | None = None
        self.done = 0
        """Scans taken in."""
        self.mixture: Mixture | None = None
        self._inside: tuple[Mixture | None, Inside] | None = None
        self._panel: tuple[Mixture | None, KnownPanel] | None = None
        self._sound = True
        """Whether nothing has changed at once so far."""

    def knows(self, known: KnownMoments) -> bool:
        """Return whether the run's moments are known just as when the pass began."""
        return self._known == known

    def _filter(self, i: int, at: Array) -> KalmanFilter:
        """Return a filter at its prior, linearised at a point."""
        number, panel, plan = self._planned[i]
        made = linearise(panel.setup, plan, at)
        return replace(
            KalmanFilter.at_prior(panel.setup, made, self._timing(made), plan, panel.chance), panel=number
        )

    def linearised_at(self, better: Sequence[Array | None]) -> Pass | None:
        """Return a pass whose filters are linearised at better points, None where every filter must begin anew.

        A filter without a better point would come to what it is now: it goes on here, and in the new pass once
        that has caught up.
        """
        new = copy(self)
        return new if new.begin_beside(self, better) else None

    def begin_beside(self, other: Pass, better: Sequence[Array | None]) -> bool:
        """As a copy of a pass, begin at better points beside it; return whether its other filters may go on."""
        fresh = {i: self._filter(i, at) for i, at in enumerate(better) if at is not None}
        self.filters = [fresh.get(i, one) for i, one in enumerate(other.filters)]
        if self.filters[0].timing.inserted != other.filters[0].timing.inserted:
            return False  # other readings count from here on, for all of them
        self.points = [old if at is None else at for old, at in zip(other.points, better, strict=True)]
        starts = [panel.setup.start_C for panel in self._panels]
        self.between = [
            None if one is None else replace(one, before_C=start, late_K=0.0)
            for one, start in zip(other.between, starts, strict=True)
        ]
        self._marched, self._beside = list(fresh.values()), other
        self.done, self.mixture, self._inside, self._panel, self._sound = 0, None, None, None, True
        return True

    def _plans(self, panel: LikelyPanel, model: ModelFile | None) -> list[FilterPlan]:
        setup, known = panel.setup, self._known
        unowned = [d.prior for d in setup.directions]
        return plans_for(setup.press, model, known.moments_sd, known.initial_sd, unowned, setup.stated)

    def _between_faces(self, setup: RunSetup, model: ModelFile | None) -> BetweenFaces | None:
        alone = setup.alone
        if alone is None:
            return None
        unowned = [d.prior for d in alone[0].directions]
        plan = panel_plan(model, alone[0].effects, self._known.initial_sd, unowned)
        made = linearise(alone[0], plan, np.zeros(len(plan.priors)))
        return BetweenFaces.at_start(made, self._timing(made), alone[1], setup.start_C)

    def _timing(self, made: Linearised) -> PressTiming:
        m = self._known.moments
        insertion, closing, opening = (made.shift(t) if t in made.names else 0.0 for t in TIMING)
        here = math.inf if self._known.idle and not math.isfinite(m.removed_s) else -math.inf

        def known(moment: float, otherwise: float = math.inf) -> float:
            return moment if math.isfinite(moment) else otherwise

        never = math.inf if self._setup.press.has_states else self._first
        units, closed = made.timing_units, known(m.closed_s, never) + closing
        return PressTiming(
            start=self._first,
            inserted=min(known(m.inserted_s, here) + insertion, closed - LEAST_WAIT_S),
            closed=closed,
            opened=known(m.opened_s) + opening,
            removed=known(m.removed_s),
            ramp=m.ramp_s,
            switching=self._setup.press.has_states,
            inserted_unit=units[0],
            closed_unit=units[1],
            opened_unit=units[2],
            longest=LONGEST_STEP_S,
        )

    @property
    def missed_K(self) -> float:  # noqa: N802
        """By how much both faces moved while they were not read, at most. [K]"""
        between = self.between[0]
        return 0.0 if between is None else float(between.read.jumped_K[1])

    @property
    def misfit(self) -> float:
        """Mean squared normalised innovation of the filter that does best."""
        return min(f.misfit for f in self.filters)

    def far_fetched(self, false_alarm: float) -> bool:
        """Return whether the core rests on states that a right model's readings would not have drawn so far.

        By the likeliest filter, but for a share of pressings. It rests on them where it would lie beyond the band,
        had they stayed; contacts of the open press may be as far off as they like.
        """
        if self.mixture is None:
            return False
        likeliest = self.filters[int(np.argmax([share.sum() for share in self.mixture.shares]))]
        if self.mixture.low_C <= likeliest.core_before_C <= self.mixture.high_C:
            return False
        return likeliest.by_chance < false_alarm

    @property
    def across(self) -> float:
        """Mean squared normalised innovation after the scans' worst hole, of the filter that expects it best."""
        return min(f.across for f in self.filters)

    @property
    def chain(self) -> SensorChain:
        """The measuring chain of the filter whose cause is none: what faces read and the core."""
        return self.filters[0].linearised.model.chain

    @property
    def rise(self) -> float:
        """How far the core has come from its start, 0 where that is not known. [K]"""
        rise = self.filters[0].core_C - self._setup.start_C
        return rise if rise == rise else 0.0

    @property
    def band_from(self) -> dict[str, float]:
        """Share of the band's variance by where it comes from, empty before there is a band."""
        if self.mixture is None:
            return {}
        return band_from(self.filters[0], self.mixture, self.margin(self.rise))

    @property
    def inside(self) -> Inside | None:
        """Profile and heat of the panel, None without one and before they are known."""
        if self.mixture is None or not len(self.filters[0].linearised.profile):
            return None
        if self._inside is None or self._inside[0] is not self.mixture:
            self._inside = self.mixture, look_inside(self.filters, self.mixture)
        return self._inside[1]

    @property
    def resin(self) -> ResinSetup | None:
        """How the paper cures and what must hold at opening; None where nobody asks."""
        return self._setup.resin

    @property
    def known_panel(self) -> KnownPanel | None:
        """Cure, steam and core as the filters know them; None where no resin is given, or nothing is known yet."""
        if self._setup.resin is None or self.mixture is None:
            return None
        if self._panel is None or self._panel[0] is not self.mixture:
            self._panel = self.mixture, known_panel(self.filters, self.mixture, self._setup.resin)
        return self._panel[1]

    def margin(self, rise: float, *, by_faces: bool = False) -> float:
        """Return what the model itself adds to the core's variance after so much rise. [K²]"""
        return model_variance(rise, self._uneven if by_faces else 0.0)

    def extend(self, scans: ScanArrays, limit: int, *, blind: bool = False) -> bool:
        """Take in the scans that make up complete blocks, `limit` blocks at most; return whether all are in.

        `blind` predicts from the platens and leaves what the faces read alone.
        """
        ends, whole = cut(scans, self.done, self.switches, limit)
        if len(ends):
            timing = self.filters[0].timing
            inserted = timing.inserted + UNSURE * self._known.inserted_sd
            counted = Counted(inserted, timing.removed, self.switches, blind)
            blocks = blocks_of(scans.rows, self.done, ends, counted)
            for one in self._marched:
                one.take(blocks)
            self.done = int(ends[-1]) + 1
            if whole:
                self._join(scans)
                self._mix(scans)
        return whole

    def _join(self, scans: ScanArrays) -> None:
        """Go on with the filters that the pass beside had, which is at an end."""
        if self._beside is not None:
            self._beside.extend(scans, len(scans))
            self._marched, self._beside = [*self.filters, *_known(self.between)], None

    def _mix(self, scans: ScanArrays) -> None:
        """Pool what all filters say, and what the faces alone do."""
        known = _known(self.between)
        late_K = scans.late_s(float(self.switches[CLOSED])) * float(self.chain.level[1])
        for between in known:
            between.late_K = late_K
        self.mixture = mix(self.filters, self.margin(self.rise, by_faces=True), self.between)
        self._sound = self._sound and self.mixture.changed < EVEN
        for between in known if self._sound else ():
            between.before_C = between.core[0]

    def better_points(self) -> list[Array | None]:
        """Return where to linearise each filter anew, None where the old point is still near enough."""
        return [one.better_point() for one in self.filters]


def _known(between: Sequence[BetweenFaces | None]) -> list[BetweenFaces]:
    return [one for one in between if one is not None]


class KnowsPress(Protocol):
    """Who follows the press."""

    state: PressState | None
    known: KnownMoments

    @property
    def pending(self) -> bool:
        """Whether a moment is in view that is not yet believed."""


class Passes:
    """The pass that answers, and one that knows better and has not caught up yet.

    Parameters
    ----------
    model
        The model in force.
    """

    def __init__(self, model: ModelFile | None) -> None:
        self.current: Pass | None = None
        self.overtaken = False
        """Whether the present pass knows the press in a state it has left: faces would mislead it."""
        self._model = model
        self._next: Pass | None = None
        self._points: list[Array] = []
        self._linearised_s = -math.inf

    def forget(self, moments: Sequence[PressEventKind]) -> None:
        """Forget where to linearise what these moments of the press have changed."""
        if PressEventKind.INSERTED in moments:
            self._points = []
        if moments:
            for point in self._points:
                point[-FOUND_LATER:] = 0.0

    def drop(self) -> None:
        """Begin anew, from what was known before the run, at the next scan."""
        self.current = self._next = None

    def advance(self, panels: Sequence[LikelyPanel], scans: ScanArrays, press: KnowsPress, *, stale: bool) -> None:
        """Bring the filters up to the newest scan, or a new pass of them nearer to it."""
        now = scans.now
        if stale or (self.current is None and self._next is None):
            self._begin(panels, scans, press, None if self.current is None else self._points)
            self.overtaken = stale
        elif self.current is not None and not press.pending:
            self.current.extend(scans, len(scans), blind=self.overtaken)
            if self._next is None and self._due(self.current, now):
                self._linearised_s = now
                self._linearise_anew(panels, scans, press, self.current)
        if self._next is not None:
            step = now - float(scans.time[-2]) if len(scans) > 1 else 0.0
            if self._next.extend(scans, max(LEAST_BLOCKS, round(BLOCKS_PER_S * step))):
                self.current, self._next, self._linearised_s = self._next, None, now
                self.overtaken = False
        if self.current is not None:
            scans.expect(self.current.chain.read)

    def _linearise_anew(
        self, panels: Sequence[LikelyPanel], scans: ScanArrays, press: KnowsPress, current: Pass
    ) -> None:
        """Begin a pass about better points, where any filter of the present one has moved far."""
        better = current.better_points()
        if all(point is None for point in better):
            return
        if current.knows(_known_now(press)) and (new := current.linearised_at(better)) is not None:
            self._next, self._points = new, new.points
        else:
            points = [old if at is None else at for old, at in zip(current.points, better, strict=True)]
            self._begin(panels, scans, press, points)

    def _begin(
        self, panels: Sequence[LikelyPanel], scans: ScanArrays, press: KnowsPress, points: Sequence[Array] | None
    ) -> None:
        """Begin a pass with what is known by now; the present one answers until it has caught up."""
        self._next = Pass(panels, self._model, _known_now(press), points, float(scans.time[0]))
        self._points = self._next.points

    def _due(self, current: Pass, now: float) -> bool:
        """Return whether it is time to ask if the filters are still linearised near enough."""
        since = now - float(last_switch(current.switches, now))
        return now - self._linearised_s >= max(0.7, 0.4 * since)


def _known_now(press: KnowsPress) -> KnownMoments:
    return replace(press.known, idle=press.state is PressState.IDLE)
