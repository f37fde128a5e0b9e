"""What the live sensor says beyond the core: the profile through the panel, its heat, and what lies ahead.

Ahead means: with the platens as they are now and the press as it stands. The whole belief is marched on, so
the band of a time to come holds what the core's band holds, and grows as it must.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.records import Array, PressState
from softsensor import kernels
from softsensor import observer_kernels as loops
from softsensor import observer_kernels_mixture as mixture
from softsensor.observer_belief import Member, mix
from softsensor.observer_setup import Filter
from softsensor.observer_track import Track

HORIZON_S, EVERY_S = 240.0, 4.0
"""How far ahead is looked, and at how many times. [s]"""
STRIDE_S = 2.0
"""Longest step of a look ahead. [s]"""
AFTER_S = 150.0
"""After opening, the core's peak is looked for so long. [s]"""
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


@dataclass(frozen=True)
class Outlook:
    """What lies ahead; NaN where it does not happen within `HORIZON_S`."""

    target_in_s: float = math.nan
    """Until the core reaches the target if the press stays as it is, 0 if it has."""
    target_earliest_s: float = math.nan
    target_latest_s: float = math.nan
    """Bounds of 95 %."""
    open_in_s: float = math.nan
    """When to open so that the core's peak after opening just reaches the target."""
    peak_C: float = math.nan  # noqa: N815
    """Highest core temperature still to come if the press is opened now, or is open."""
    limit_in_s: float = math.nan
    """Until the core's upper bound passes the limit."""
    warning: str = ""

    def later(self, seconds: float) -> Outlook:
        """Return the same outlook some seconds on."""
        names = ("target_in_s", "target_earliest_s", "target_latest_s", "open_in_s", "limit_in_s")
        left = {name: getattr(self, name) - seconds for name in names}
        return replace(self, **{name: v if v != v else max(v, 0.0) for name, v in left.items()})


@dataclass(frozen=True)
class Inside:
    """The panel now."""

    profile_C: Array  # noqa: N815
    """At even heights from the lower to the upper face. [°C]"""
    energy_kJ_m2: float  # noqa: N815
    """Heat in the panel beyond its start, water and reactions not counted. [kJ/m²]"""


def look_inside(member: Member) -> Inside:
    """Return profile and heat as the model in force sees them."""
    field = _field(member)
    return Inside(member.filter.profile @ field, heat_taken_up(member.filter, field) / 1000.0)


def heat_taken_up(f: Filter, field: Array) -> float:
    """Return the heat that takes the panel from its start to `field` (n), rho c(T) integrated. [J/m²]"""
    s = f.stack
    return float(mixture.heat(s.dx, s.c, s.c_slope, s.c_table, s.table_x, s.table_y, s.wet, f.start_C, field))


def _field(member: Member) -> Array:
    """Cell temperatures under "nothing is missing" (n). [°C]"""
    f, b = member.filter, member
    return np.asarray(mixture.cells(b.x, b.cov, b.where, b.absent, b.spikes, f.at, f.state.t, f.state.s))


def look_ahead(track: Track, wishes: Wishes, state: PressState, now: float, outside: Array) -> Outlook:
    """Return what lies ahead of a press that stays open or closed.

    Parameters
    ----------
    now
        Time to which the track has come. [s]
    outside
        Boundary temperatures, bottom and top. [°C]
    """
    members = track.members
    if state is PressState.OPEN:
        peak = _peak(members[0], now, now, outside)
        over = peak > wishes.limit_C
        warning = f"core will peak at {peak:.0f} °C, above the limit of {wishes.limit_C:g} °C" if over else ""
        return Outlook(peak_C=peak, warning=warning)
    ahead, told, low, high = _course(track, wishes, now, outside)
    until = _crossing(ahead, told, wishes.target_C)
    found = Outlook(
        target_in_s=until,
        target_earliest_s=_crossing(ahead, high, wishes.target_C),
        target_latest_s=_crossing(ahead, low, wishes.target_C),
        open_in_s=_opening(members[0], now, outside, wishes.target_C, until),
        peak_C=_peak(members[0], now, now, outside),
        limit_in_s=_crossing(ahead, high, wishes.limit_C),
    )
    if found.peak_C > wishes.limit_C:
        warning = f"core will peak at {found.peak_C:.0f} °C even if opened now, above {wishes.limit_C:g} °C"
    elif found.limit_in_s < NOTICE_S:
        warning = f"core may pass {wishes.limit_C:g} °C in {found.limit_in_s:.0f} s: open the press"
    else:
        warning = ""
    return replace(found, warning=warning)


def _course(track: Track, wishes: Wishes, now: float, outside: Array) -> tuple[Array, Array, Array, Array]:
    """Return times ahead and the core then, as far as it matters: as told, and its bounds. [s, °C]"""
    copies = [_copy(member) for member in track.members]
    start = float(copies[0].filter.chain.level[0]) - track.rise
    ahead = np.arange(0.0, HORIZON_S + EVERY_S / 2, EVERY_S)
    rows: list[tuple[float, float, float]] = []
    platens = np.stack([outside, outside])
    for k in range(len(ahead)):
        if k:
            for copy in copies:
                _march(copy, now + ahead[k - 1], now + ahead[k], platens)
        mixture = mix(copies, float(copies[0].filter.chain.level[0]) - start, track.unexplained)
        rows.append((mixture.told, mixture.low, mixture.high))
        if not (mixture.low < wishes.target_C or mixture.high < wishes.limit_C):
            break
    told, low, high = np.array(rows).T
    return ahead[: len(rows)], told, low, high


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


def _opening(member: Member, now: float, outside: Array, target: float, until: float) -> float:
    """Return how long to stay closed so that the peak after opening reaches the target. [s]"""
    if not math.isfinite(until):
        return math.nan
    early, late = 0.0, until
    if _peak(member, now, now, outside) >= target:
        return 0.0
    while late - early > 0.5:
        middle = 0.5 * (early + late)
        if _peak(member, now, now + middle, outside) >= target:
            late = middle
        else:
            early = middle
    return late


def _peak(member: Member, now: float, opening: float, outside: Array) -> float:
    """Return the highest core temperature still to come if the press opens at a time. [°C]"""
    bare = _bare(member, opening)
    platens = np.stack([outside, outside])
    if opening > now:
        _march(bare, now, opening, platens)
    highest, at = float(bare.filter.chain.level[0]), opening
    while at < opening + AFTER_S:
        _march(bare, at, at + EVERY_S, platens)
        at += EVERY_S
        core = float(bare.filter.chain.level[0])
        if core < highest - FLAT_K:
            break
        highest = max(highest, core)
    return highest


def _copy(member: Member) -> Member:
    f = member.filter
    made = replace(f, state=kernels.State(*(a.copy() for a in f.state)), chain=_chain(f.chain, f.chain.d_true))
    return replace(member, filter=made, timing=member.timing._replace(longest=STRIDE_S))


def _chain(chain: loops.Chain, like: Array) -> loops.Chain:
    q = like.shape[1]
    return chain._replace(
        true=chain.true.copy(),
        d_true=chain.d_true[:, :q].copy(),
        read=chain.read.copy(),
        d_read=chain.d_read[:, :q].copy(),
        level=chain.level.copy(),
        d_level=chain.d_level[: q - 2].copy(),
    )


def _bare(member: Member, opening: float) -> Member:
    """Return a copy without tangents, at what the belief thinks the cells' temperatures are."""
    f = member.filter
    s = f.state
    state = s._replace(
        t=_field(member), t_before=s.t_before.copy(), done=s.done.copy(), clock=s.clock.copy(),
        s=s.s[:0].copy(), s_before=s.s_before[:0].copy(), s_done=s.s_done[:, :0].copy(),
    )  # fmt: skip
    chain = _chain(f.chain, np.empty((len(f.chain.true), 2)))
    factors = f.factors._replace(d_total=f.factors.d_total[:, :, :0].copy())
    made: Filter = replace(
        f, state=state, tangents=_without(f.tangents), chain=chain, factors=factors,
        d_boundary=f.d_boundary[:, :0].copy(), moving=np.full_like(f.moving, -1),
    )  # fmt: skip
    timing = member.timing._replace(longest=STRIDE_S)
    if member.timing.opened > opening:
        timing = timing._replace(opened=opening)
    return replace(member, filter=made, timing=timing)


def _without(tangents: kernels.Tangents) -> kernels.Tangents:
    """Return tangents by no parameter at all."""
    t = tangents
    return kernels.Tangents(
        t.k[:0], t.k_slope[:0], t.c[:0], t.c_slope[:0], t.exchange[:0], t.contact[..., :0].copy(),
        t.emissivity[:0], t.convection[:0], t.flux[:, :0].copy(), t.heat[:, :0].copy(), t.law[:, :0].copy(),
    )  # fmt: skip


def _march(member: Member, begin: float, end: float, platens: Array) -> None:
    f = member.filter
    loops.march(
        f.stack, f.tangents, f.d_boundary, f.state, f.nonlinear, f.factors, f.chain, f.places,
        member.timing, np.array([begin, end]), platens, f.moving,
    )  # fmt: skip
