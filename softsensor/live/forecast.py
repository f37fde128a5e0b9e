"""The live sensor's forecast: with the platens as they are now and the press as it stands.

The whole Gaussian mixture is marched on, so the band of a time to come holds what the core's band holds, and
grows as it must.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from daq.printed import on_screen
from daq.records import Array, PressState
from daq.words import Message, say
from softsensor.heat import implicit_steps as kernels
from softsensor.heat.timing import HANDLING_RAMP_S, OPENING_RAMP_S
from softsensor.live.curing import ResinSetup
from softsensor.live.inside import believed
from softsensor.live.kalman import KalmanFilter
from softsensor.live.leaving import known_panel
from softsensor.live.march_steps import SensorChain, march_span
from softsensor.live.mixture import Mixture, mix
from softsensor.live.passes import Pass
from softsensor.live.possible import Possible
from softsensor.opening.limits import NOTHING_FORESEEN, Broken, Opening, opening, surely_known

Believed = Sequence[tuple[KalmanFilter, float, Array]]
"""Filters with their shares, and the cells' temperatures they expect (`live.inside.believed`)."""

# Numbers without another source were set by hand, 2026-11.

HORIZON_S, EVERY_S = 240.0, 4.0
"""How far ahead is looked, and at how many times. [s]"""
COURSE_POINTS = 12
"""Points of a course handed on: a curve without visible corners, and no more text than two scans take."""
STRIDE_S = 2.0
"""Longest step of a look ahead. [s]"""
AFTER_S = 150.0
"""After the panel is taken out, the core's peak is looked for so long. [s]"""
FLAT_K = 0.05
"""A core this far below its highest has passed its peak. [K]"""
NOTICE_S = 20.0
"""A limit is warned of this long before it may be passed. [s]"""


@dataclass(frozen=True)
class Wishes:
    """What the operator wants of the core, from the run's header; NaN: nothing."""

    target_C: float = math.nan  # noqa: N815
    """``setting.core_target_C``"""
    limit_C: float = math.nan  # noqa: N815
    """``setting.core_limit_C``"""

    @property
    def any(self) -> bool:
        """Whether there is anything to look ahead for."""
        return self.target_C == self.target_C or self.limit_C == self.limit_C


def wishes_of(header: Mapping[str, Any]) -> Wishes:
    """Return what a run's header wants of the core."""

    def number(key: str) -> float:
        value = header.get(key)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan

    return Wishes(number("setting.core_target_C"), number("setting.core_limit_C"))


@dataclass(frozen=True)
class Forecast:
    """What lies ahead; NaN where it does not happen within `HORIZON_S`."""

    target_in_s: float = math.nan
    """Until the core reaches the target if the press stays as it is, 0 if it has."""
    target_earliest_s: float = math.nan
    """Lower bound of 95 % of the time until then. [s]"""
    target_latest_s: float = math.nan
    """Upper bound of 95 % of it. [s]"""
    open_in_s: float = math.nan
    """When to open so that the core just reaches the target by the heat that is in the panel then."""
    open_earliest_s: float = math.nan
    """Lower bound of 95 % of that. [s]"""
    open_latest_s: float = math.nan
    """Upper bound of 95 % of it, not looked for where it is 0. [s]"""
    peak_C: float = math.nan  # noqa: N815
    """Highest core temperature still to come if the panel is taken out now."""
    limit_in_s: float = math.nan
    """Until the core's upper bound passes the limit."""
    forecast_age_s: float = math.nan
    """How long ago this was looked for; the times above are counted from now."""
    limits_in_s: float = math.nan
    """From when on every limit of the resin file holds with the wanted probability, if the press stays closed."""
    limits_earliest_s: float = math.nan
    """Lower bound of 95 % of when that will be known. [s]"""
    limits_latest_s: float = math.nan
    """Upper bound of 95 % of it; NaN where it is not met. [s]"""
    limits_likely_in_s: float = math.nan
    """From when on that is likelier than not."""
    limits_blocking: str = ""
    """Where `limits_in_s` is not known: the limit that stands most in the way (`softsensor.opening.limits`)."""
    course: tuple[tuple[float, float, float, float], ...] = ()
    """The core to come if the press stays closed: time from the look on, as reported, lower and upper bound of
    95 %, at most `COURSE_POINTS` of them. [s, °C]"""
    warning: Message | None = None
    """What is about to go wrong, in words; None: nothing."""

    __repr__ = on_screen

    def later(self, seconds: float) -> Forecast:
        """Return the same forecast some seconds on."""
        names = (
            "target_in_s", "target_earliest_s", "target_latest_s", "open_in_s", "open_earliest_s", "open_latest_s",
            "limit_in_s", "limits_in_s", "limits_earliest_s", "limits_latest_s", "limits_likely_in_s",
        )  # fmt: skip
        left = {name: getattr(self, name) - seconds for name in names}
        ahead = {name: v if v != v else max(v, 0.0) for name, v in left.items()}
        return replace(self, forecast_age_s=self.forecast_age_s + seconds, **ahead)


def look_ahead(
    run: Pass, wishes: Wishes, state: PressState, now: float, outside: Array, can_be: Possible
) -> Forecast:
    """Return what lies ahead of a press that stays open or closed.

    Parameters
    ----------
    now
        Time to which the pass has come. [s]
    outside
        Boundary temperatures, bottom and top. [°C]
    can_be
        Between which temperatures a core can be.
    """
    if run.mixture is None:
        return Forecast()
    filters = believed(run.filters, run.mixture)
    peak, _ = _peak(filters, now, now, outside)
    if state is PressState.OPEN:
        return Forecast(peak_C=peak, forecast_age_s=0.0, warning=_warning_when_open(peak, wishes.limit_C))
    ahead, (reported, low, high), limits = _course(run, wishes, now, outside, can_be)
    until = _crossing(ahead, reported, wishes.target_C)
    opens = earliest = 0.0 if peak >= wishes.target_C else math.nan
    latest = math.nan
    out = None if opens == 0.0 else _opening(filters, now, outside, wishes.target_C, (peak, until))
    if out is not None:
        opens, (earliest, latest) = out.waited_s, _opening_band(run, out, now, outside, wishes.target_C)
    found = Forecast(
        target_in_s=until,
        target_earliest_s=_crossing(ahead, high, wishes.target_C),
        target_latest_s=_crossing(ahead, low, wishes.target_C),
        open_in_s=opens,
        open_earliest_s=earliest,
        open_latest_s=latest,
        peak_C=peak,
        limit_in_s=_crossing(ahead, high, wishes.limit_C),
        forecast_age_s=0.0,
        limits_in_s=limits.in_s,
        limits_earliest_s=limits.earliest_s,
        limits_latest_s=limits.latest_s,
        limits_likely_in_s=limits.likely_in_s,
        limits_blocking=limits.blocking,
        course=_thinned(np.stack([ahead, reported, low, high], axis=1)),
    )
    return replace(found, warning=_warning(found, wishes.limit_C))


def _warning_when_open(peak: float, limit_C: float) -> Message | None:
    return say("core-will-pass-limit", peak_C=peak, limit_C=limit_C) if peak > limit_C else None


def _warning(found: Forecast, limit_C: float) -> Message | None:
    """Return what the operator of a closed press must know."""
    if found.peak_C > limit_C:
        return say("core-will-pass-limit-even-if-opened", peak_C=found.peak_C, limit_C=limit_C)
    if found.limit_in_s < NOTICE_S:
        return say("core-may-pass-limit-soon", limit_C=limit_C, seconds=found.limit_in_s)
    return None


def _course(
    run: Pass, wishes: Wishes, now: float, outside: Array, can_be: Possible
) -> tuple[Array, Array, Opening]:
    """Return times ahead [s], the core then (reported, low, high) as far as it matters, and when limits hold."""
    copies = [_copy(one) for one in run.filters]
    start = copies[0].core_C - run.rise
    ahead = np.arange(0.0, HORIZON_S + EVERY_S / 2, EVERY_S)
    rows: list[tuple[float, float, float]] = []
    limits = _Limits(run.resin)
    platens = np.stack([outside, outside])
    for k in range(len(ahead)):
        if k:
            for copy in copies:
                _march(copy, now + ahead[k - 1], now + ahead[k], platens)
                copy.cure(EVERY_S)
        mixture = mix(copies, run.margin(copies[0].core_C - start))
        core, low, high = (can_be.within(t) for t in (mixture.core_C, mixture.low_C, mixture.high_C))
        rows.append((core, low, high))
        limits.look(copies, mixture)
        if limits.settled and not (mixture.low_C < wishes.target_C or mixture.high_C < wishes.limit_C):
            break
    times = ahead[: len(rows)]
    return times, np.array(rows).T, limits.opening(times)


class _Limits:
    """What every look ahead says of the limits; without a resin nothing."""

    def __init__(self, resin: ResinSetup | None) -> None:
        self._resin = resin
        self._broken: list[Broken] = []
        self.settled = resin is None or not resin.limits.any
        """Whether nothing is to be looked for any further."""

    def look(self, filters: list[KalmanFilter], mixture: Mixture) -> None:
        """Note how likely each limit is broken at the moment the filters have come to."""
        if self._resin is None or self.settled:
            return
        leave = known_panel(filters, mixture, self._resin).leave(self._resin)
        wanted = self._resin.limits.probability
        self._broken.append(leave.broken)
        if leave.holds(wanted):
            before, risk = (float(self._broken[k].risk) for k in (max(len(self._broken) - 2, 0), -1))
            self.settled = risk >= before or risk <= surely_known(wanted)

    def opening(self, ahead: Array) -> Opening:
        """Return from when on they hold, for the moments looked at."""
        if self._resin is None or not self._broken:
            return NOTHING_FORESEEN
        return opening(ahead[: len(self._broken)], Broken.along(self._broken), self._resin.limits.probability)


def _thinned(course: Array) -> tuple[tuple[float, float, float, float], ...]:
    """Return few rows of a course, evenly, with its first and last."""
    rows = np.unique(np.linspace(0, len(course) - 1, COURSE_POINTS).round().astype(int))
    return tuple((float(t), float(c), float(low), float(high)) for t, c, low, high in course[rows])


def _crossing(ahead: Array, course: Array, level: float) -> float:
    """Return when a course first reaches a level, NaN where it does not. [s]"""
    if not math.isfinite(level):
        return math.nan
    over = np.flatnonzero(course >= level)
    if not len(over):
        return math.nan
    k = int(over[0])
    if k == 0:
        return 0.0
    share = (level - course[k - 1]) / (course[k] - course[k - 1])
    return float(ahead[k - 1] + share * (ahead[k] - ahead[k - 1]))


class _LetOut(NamedTuple):
    """A panel taken out of the press."""

    waited_s: float
    """How long from now the press stays closed before."""
    peak_s: float
    """When its core is hottest."""
    rise: float
    """By how much a second more in the closed press raises that. [K/s]"""


def _opening(
    filters: Believed, now: float, outside: Array, target: float, ends: tuple[float, float]
) -> _LetOut | None:
    """Return when a panel must come out so that its peak, too low by now, reaches the target; None: not known.

    `ends`: the peak of one taken out now, and how long until its core is at the target if it stays. [°C, s]
    """
    early, (below, late) = 0.0, ends
    if not math.isfinite(late):
        return None
    above, at = _peak(filters, now, now + late, outside)
    if not below < target <= above:  # what is believed of single filters is not quite the mixture
        return None
    waited, rise, straight = late, (above - below) / late, True
    while late - early > 0.5:
        rise = (above - below) / (late - early)
        waited = early + (target - below) / rise if straight else 0.5 * (early + late)
        peak, at = _peak(filters, now, now + waited, outside)
        if abs(peak - target) < FLAT_K:
            break
        early, below, late, above = (waited, peak, late, above) if peak < target else (early, below, waited, peak)
        straight = not straight
    return _LetOut(waited, at, rise)


def _opening_band(run: Pass, out: _LetOut, now: float, outside: Array, target: float) -> tuple[float, float]:
    """Return bounds of 95 % of when to open, about the time expected. [s from now]

    By how far the peak's own band is off, over what a second more in the closed press adds to it.
    """
    platens = np.stack([outside, outside])
    copies = [_taken_out(_copy(one), now + out.waited_s) for one in run.filters]
    start = copies[0].core_C - run.rise
    for copy in copies:
        _march(copy, now, out.peak_s, platens)
    mixture = mix(copies, run.margin(copies[0].core_C - start))
    sooner, later = ((t - target) / out.rise for t in (mixture.high_C, mixture.low_C))
    return max(out.waited_s - max(sooner, 0.0), 0.0), out.waited_s - min(later, 0.0)


def _peak(filters: Believed, now: float, opening: float, outside: Array) -> tuple[float, float]:
    """Return the highest core to be expected if the panel is taken out of the press at a time, and when. [°C, s]

    What it gets from the hot plate until somebody takes it is not counted: nobody knows how long that is.
    """
    peaks = [_peak_of(_bare(one, cells, opening), now, opening, outside) for one, _, cells in filters]
    shares = [share for _, share, _ in filters]
    return sum(share * peak for share, (peak, _) in zip(shares, peaks, strict=True)), peaks[np.argmax(shares)][1]


def _peak_of(bare: KalmanFilter, now: float, opening: float, outside: Array) -> tuple[float, float]:
    """Return the highest core still to come by one filter, and when. [°C, s]"""
    platens = np.stack([outside, outside])
    if opening > now:
        _march(bare, now, opening, platens)
    highest, highest_at, at = bare.core_C, opening, opening
    while at < opening + AFTER_S:
        _march(bare, at, at + EVERY_S, platens)
        at += EVERY_S
        core = bare.core_C
        if core < highest - FLAT_K:
            break
        if core > highest:
            highest, highest_at = core, at
    return highest, highest_at


def _copy(one: KalmanFilter) -> KalmanFilter:
    model = one.linearised.model
    state = kernels.State(*(a.copy() for a in model.state))
    made = replace(
        one.linearised, model=model._replace(state=state, chain=_chain(model.chain, model.chain.d_true))
    )
    return replace(one, linearised=made, timing=one.timing._replace(longest=STRIDE_S))


def _chain(chain: SensorChain, like: Array) -> SensorChain:
    q = like.shape[1]
    return chain._replace(
        true=chain.true.copy(),
        d_true=chain.d_true[:, :q].copy(),
        read=chain.read.copy(),
        d_read=chain.d_read[:, :q].copy(),
        level=chain.level.copy(),
        d_level=chain.d_level[: q - 2].copy(),
    )


def _bare(one: KalmanFilter, cells: Array, opening: float) -> KalmanFilter:
    """Return a copy without tangents, at these temperatures of its cells, whose panel is then out of the press."""
    model = one.linearised.model
    s, factors = model.state, model.factors
    chain = _chain(model.chain, np.empty((len(model.chain.true), 2)))
    chain = chain._replace(moved=np.full_like(chain.moved, -1))
    chain.level[0] = model.places[-1] @ cells  # the core there, of the last output
    state = s._replace(
        t=cells.copy(), t_before=s.t_before + (cells - s.t), done=s.done.copy(), clock=s.clock.copy(),
        s=s.s[:0].copy(), s_before=s.s_before[:0].copy(), s_done=s.s_done[:, :0].copy(),
    )  # fmt: skip
    bare = model._replace(
        tangents=_without(model.tangents),
        d_boundary=model.d_boundary[:, :0].copy(),
        factors=factors._replace(
            d_total=factors.d_total[:, :, :0].copy(),
            by_load=factors.by_load._replace(d_log=factors.by_load.d_log[:, :, :0].copy()),
        ),
        moving=np.full_like(model.moving, -1),
        state=state,
        chain=chain,
    )
    return _taken_out(replace(one, linearised=replace(one.linearised, model=bare)), opening)


def _taken_out(one: KalmanFilter, opening: float) -> KalmanFilter:
    """Return a filter of a press that opens at a time, unless it is open, and whose panel is then taken out."""
    opened = min(one.timing.opened, opening)
    out = max(opened, opening) + 0.5 * (OPENING_RAMP_S + HANDLING_RAMP_S)
    timing = one.timing._replace(longest=STRIDE_S, opened=opened, removed=min(one.timing.removed, out))
    model = one.linearised.model
    return replace(
        one, linearised=replace(one.linearised, model=model._replace(stack=_in_air(model.stack))), timing=timing
    )


def _in_air(stack: kernels.Stack) -> kernels.Stack:
    """Return a stack whose panel, if it has one, loses heat on both sides by its film while out of the press."""
    panel = np.flatnonzero(stack.wet)
    below, above = (np.flatnonzero(side) for side in (stack.interface <= panel[:1], stack.interface > panel[-1:]))
    if not (len(below) and len(above)):
        return stack
    bottom, top = below[np.argmax(stack.interface[below])], above[np.argmin(stack.interface[above])]
    contact = stack.contact.copy()
    film = max(contact[bottom, 1, 2], contact[top, 1, 1])
    contact[bottom, 0], contact[top, 0] = (0.0, 0.0, film), (0.0, film, 0.0)
    return stack._replace(contact=contact)


def _without(tangents: kernels.Tangents) -> kernels.Tangents:
    """Return tangents by no parameter at all."""
    t = tangents
    return kernels.Tangents(
        t.k[:0], t.k_slope[:0], t.c[:0], t.c_slope[:0], t.exchange[:0], t.source[:, :0].copy(),
        t.contact[..., :0].copy(), t.emissivity[:0], t.convection[:0], t.flux[:, :0].copy(),
        t.heat[:, :0].copy(), t.law[:, :0].copy(), t.bends[:, :0].copy(),
    )  # fmt: skip


def _march(one: KalmanFilter, begin: float, end: float, platens: Array) -> None:
    march_span(one.linearised.model, one.timing, np.array([begin, end]), platens)
