"""Press time, platens and pressure for a panel not pressed yet, under limits at a wanted probability.

For each program of a grid all draws (`made_up`) are marched once, closed as long as the range allows: what a
panel is like at an opening does not depend on what comes after it. Cure, steam and core at each press time are
normal in the quantities of `softsensor.opening.limits` with the draws' mean and standard deviation, and the
limits' rules say from which press time all hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import product
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import ValidationError

from daq.press.header import panel_of
from daq.press.press_file import Press, press_for_run
from daq.press.resin_file import LimitsTable, Resin
from daq.printed import on_screen
from daq.records import Array, InputError
from daq.tables import explained
from daq.words import say
from softsensor.opening.kinetics import Kinetics, equivalent_course, kinetics_of
from softsensor.opening.limits import Broken, Normal, Opening, PanelState, broken, opening
from softsensor.opening.steam import MOISTURE, stated_moisture
from softsensor.planning.made_up import (
    KINETICS,
    ROW_S,
    SHARE,
    STEAM_ROWS,
    Courses,
    Ensemble,
    Programme,
    Task,
    ensemble,
    heat_taken,
    made_up_run,
    sources_of,
    steam_of,
)
from softsensor.planning.program import Ranges
from softsensor.planning.wishes import USUAL_OPEN_S
from softsensor.signals.doubt import constant_doubts

# Numbers without another source were set by hand, 2026-11.

PLATEN_LEVELS, PRESSURE_LEVELS = 7, 3
"""Programs looked at between the ends of a range."""
PRESSURE = "pressure_N_cm2"
DEFAULT_RANGES: Ranges = MappingProxyType(
    {
        "platen_temperature_C": (160.0, 200.0),
        "press_time_s": (5.0, 180.0),
        PRESSURE: (200.0, 300.0),
    }
)
"""Laminating of MDF: 160 to 200 °C, 2 to 3 MPa, 40 to 60 s (facts, physics.md, section 5), the time from the
shortest a press can do to three times the longest."""
KWH_J = 3.6e6
"""Joules of a kilowatt hour, by definition."""
Progress = Callable[[str, float], None]


class Goal(StrEnum):
    """What is to be least, or most; values of the command line."""

    TIME = "time"
    ENERGY = "energy"
    THROUGHPUT = "throughput"


@dataclass(frozen=True)
class Wish:
    """What the user wants."""

    limits: LimitsTable
    resin: Resin | None = None
    ranges: Ranges = field(default_factory=dict)
    """`DEFAULT_RANGES` where not given."""
    goal: Goal = Goal.TIME
    open_s: float = USUAL_OPEN_S
    """How long the press stands open between two panels, for energy and throughput. [s]"""
    price_per_kWh: float | None = None  # noqa: N815
    """In euros."""

    __repr__ = on_screen


@dataclass(frozen=True)
class Quantities:
    """What limits are about, by draw and press time (draws, t): as `opening.limits.PanelState` has them."""

    cure_bottom: Array
    cure_top: Array
    core: Array
    steam: Array

    __repr__ = on_screen

    def known(self) -> PanelState:
        """Return them as they are known."""
        bottom, top = (q - q.mean(axis=0) for q in (self.cure_bottom, self.cure_top))
        with np.errstate(invalid="ignore"):
            together = (bottom * top).sum(axis=0) / np.sqrt((bottom**2).sum(axis=0) * (top**2).sum(axis=0))
        return PanelState(
            _normal(self.cure_bottom),
            _normal(self.cure_top),
            _normal(self.core),
            _normal(self.steam),
            np.nan_to_num(together),
        )

    def without(self, unit: Array, slopes: Array, columns: np.ndarray) -> Quantities:
        """Return them without the doubt in some columns of the draws, by a straight line through the draws.

        Parameters
        ----------
        unit, slopes
            The draws (draws, P), and their pseudo-inverse (P, draws).
        """
        return Quantities(
            *(
                q - unit[:, columns] @ (slopes[columns] @ (q - q.mean(axis=0)))
                for q in (self.cure_bottom, self.cure_top, self.core, self.steam)
            )
        )


def _normal(draws: Array) -> Normal:
    return Normal(draws.mean(axis=0), draws.std(axis=0, ddof=1))


@dataclass(frozen=True, eq=False)
class TriedProgramme:
    """One program, and the press time it needs."""

    programme: Programme
    """What the press does."""
    press_time_s: Array
    """Looked at (t). [s]"""
    broken: Broken
    """How likely limits are (t)."""
    opening: Opening
    """From which press time on every limit holds, and until when."""
    energy_kWh: float  # noqa: N815
    """Of a panel: heat it takes up, and what the plates lose while the press is open; NaN without a press time."""
    panels_per_h: float
    """At the press time that it needs; NaN without one. [1/h]"""
    price: float | None
    """Of a kWh, None where none was given. [€]"""

    __repr__ = on_screen

    @property
    def possible(self) -> bool:
        """Whether there is a press time at which every limit holds."""
        return isfinite(self.opening.in_s)

    def as_json(self) -> dict[str, Any]:
        """Return the program's entry."""
        cost = None if self.price is None else self.price * self.energy_kWh
        return {
            "platen_temperature_C": self.programme.platen_C,
            "pressure_N_cm2": self.programme.pressure_N_cm2,
            "press_time_s": _number(self.opening.in_s),
            "likely_press_time_s": _number(self.opening.likely_in_s),
            "latest_press_time_s": _number(self.opening.until_s),
            "risk": _number(self.opening.risk),
            "blocking": self.opening.blocking or None,
            "energy_kWh": _number(self.energy_kWh),
            "cost_eur": _number(cost),
            "panels_per_h": _number(self.panels_per_h),
        }


def _number(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else float(f"{value:.5g}")


@dataclass(frozen=True)
class Saving:
    """What knowing one thing exactly would save."""

    source: str
    """`made_up.COEFFICIENTS` and so on, or a key of the header."""
    press_time_s: float
    """That would do then. [s]"""

    __repr__ = on_screen

    def as_json(self) -> dict[str, Any]:
        """Return its entry."""
        return {"source": self.source, "press_time_s": _number(self.press_time_s)}


@dataclass(frozen=True)
class ProgrammeAdvice:
    """The program to take, those beside it, and what to measure to press shorter."""

    panel: Mapping[str, Any]
    """Of which panel and room, by keys of a run's header."""
    wish: Wish
    """Limits, ranges, goal and prices asked for."""
    tried: tuple[TriedProgramme, ...]
    """All that were looked at."""
    best: TriedProgramme | None
    """None: no program within the ranges keeps all limits."""
    nearest: TriedProgramme
    """The best, or the one that comes nearest."""
    savings: tuple[Saving, ...]
    """Most seconds first."""

    __repr__ = on_screen

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``advise --json``."""
        shown = self.nearest
        limits = self.wish.limits.model_dump(
            include={"cure_least", "core_least_C", "core_most_C", "steam_most_kPa"}
        )
        return {
            "panel": dict(self.panel),
            "resin": None if self.wish.resin is None else self.wish.resin.resin.name,
            "limits": limits,
            "probability": self.wish.limits.probability,
            "goal": self.wish.goal.value,
            "best": None if self.best is None else self.best.as_json(),
            "programs": [t.as_json() for t in self.tried],
            "tradeoff": {
                "platen_temperature_C": shown.programme.platen_C,
                "press_time_s": [round(float(t), 2) for t in shown.press_time_s],
                "risk": _list(np.broadcast_to(shown.broken.risk, shown.press_time_s.shape)),
                "limits": {name: _list(chance) for name, chance in shown.broken.chances.items()},
            },
            "measure": [s.as_json() for s in self.savings],
        }


def _list(values: Array) -> list[float]:
    return [float(f"{v:.4g}") for v in values]


def advise(task: Task, wish: Wish, progress: Progress | None = None) -> ProgrammeAdvice:
    """Return the program to take.

    Raises
    ------
    InputError
        For no limit, one of cure without a resin or of steam without the panel's moisture, a panel that cannot be,
        or a press without states.
    """
    _check_limits(task, wish)
    report = progress or (lambda what, share: None)
    programmes = _grid(task, wish)
    report("draws", 0.0)
    drawn = ensemble(task, programmes[len(programmes) // 2])
    if not len(_allowed(drawn.press_times, wish)[0]):
        low, high = wish.ranges["press_time_s"]
        raise InputError(say("advise-press-time-narrow", low=low, high=high, step=ROW_S))
    kinetics = None if wish.resin is None else kinetics_of(wish.resin)
    tried, known = [], []
    for i, programme in enumerate(programmes):
        report(f"{programme.platen_C:g}", (i + 1) / (len(programmes) + 1))
        courses = drawn.courses(programme)
        quantities = quantities_of(drawn, courses, wish, kinetics)
        known.append(quantities)
        tried.append(_tried(drawn, wish, kinetics, (programme, courses, quantities)))
    possible = [t for t in tried if t.possible]
    best = min(possible, key=lambda t: _cost(t, wish.goal)) if possible else None
    nearest = best or min(tried, key=lambda t: (t.opening.risk, t.opening.beyond))
    savings = _savings(drawn, wish, kinetics, (nearest, known[tried.index(nearest)]))
    return ProgrammeAdvice(task.header, wish, tuple(tried), best, nearest, savings)


def _check_limits(task: Task, wish: Wish) -> None:
    """Refuse limits that nothing could show to hold. Raises `InputError`."""
    limits = wish.limits
    if not limits.any:
        raise InputError(say("advise-no-limit"))
    if limits.cure_least is not None and wish.resin is None:
        raise InputError(say("advise-cure-without-resin"))
    moisture = stated_moisture(constant_doubts(task.header, task.press))
    if limits.steam_most_kPa is not None and moisture is None:
        raise InputError(say("advise-steam-without-moisture", key=MOISTURE))


def limits_of(resin: Resin | None, given: Mapping[str, float]) -> LimitsTable:
    """Return the limits: those given before the resin's. Raises InputError for one that cannot be."""
    known = LimitsTable() if resin is None else resin.limits
    kept = tuple((key, sd) for key, sd in known.sd if key not in given)  # a number given anew comes without
    try:
        return LimitsTable.model_validate(known.model_dump(exclude_none=True) | {"sd": kept} | dict(given))
    except ValidationError as error:
        raise InputError(explained(error, LimitsTable)) from error


def _cost(tried: TriedProgramme, goal: Goal) -> float:
    if goal is Goal.ENERGY:
        return tried.energy_kWh
    return -tried.panels_per_h if goal is Goal.THROUGHPUT else tried.opening.in_s


def _grid(task: Task, wish: Wish) -> list[Programme]:
    """Return the programs to look at; pressures only where the model knows what they do."""
    ranges = {**DEFAULT_RANGES, **wish.ranges}
    platens = np.unique(np.linspace(*ranges["platen_temperature_C"], PLATEN_LEVELS)).tolist()
    pressures: list[float | None] = [None]
    if task.follows_load:
        pressures = np.unique(np.linspace(*ranges[PRESSURE], PRESSURE_LEVELS)).tolist()
    return [Programme(round(t, 1), p) for t, p in product(platens, pressures)]


def quantities_of(drawn: Ensemble, courses: Courses, wish: Wish, kinetics: Kinetics | None) -> Quantities:
    """Return what the limits are about, for every draw and press time."""
    unknown = np.full(courses.layers_C.shape[:2], np.nan)
    cured = np.stack([unknown, unknown])
    if kinetics is not None:
        equivalent = equivalent_course(kinetics, courses.time_s, courses.faces_C, drawn.draws.of(KINETICS).T)
        cured = np.log(np.maximum(equivalent[..., courses.rows], 1e-30))
    steam = unknown
    if wish.limits.steam_most_kPa is not None:
        steam = np.log(_steam(drawn, courses, wish.resin))
    return Quantities(cured[0], cured[1], courses.core_C, steam)


def _steam(drawn: Ensemble, courses: Courses, resin: Resin | None) -> Array:
    """Return the steam's pressure (draws, t). [kPa]"""
    rows = np.unique(np.append(np.arange(0, len(courses.press_time_s), STEAM_ROWS), len(courses.press_time_s) - 1))
    pressure = steam_of(drawn, courses.layers_C[:, rows], resin)
    times, thin = courses.press_time_s, courses.press_time_s[rows]
    return np.exp([np.interp(times, thin, log_p) for log_p in np.log(pressure)])


def _tried(
    drawn: Ensemble, wish: Wish, kinetics: Kinetics | None, what: tuple[Programme, Courses, Quantities]
) -> TriedProgramme:
    programme, courses, quantities = what
    times, allowed = _allowed(courses.press_time_s, wish)
    risks = broken(wish.limits, kinetics, quantities.known()).at(allowed)
    found = opening(times, risks, wish.limits.probability)
    energy = np.nan
    if isfinite(found.in_s):
        row = int(np.flatnonzero(allowed)[np.searchsorted(times, found.in_s)])
        layers, at_s = courses.layers_C[:, row].mean(axis=0), float(courses.press_time_s[row])
        energy = _energy(drawn.task, layers, programme, wish.open_s, heat_taken(drawn.task, programme, at_s))
    per_hour = 3600.0 / (found.in_s + wish.open_s)
    return TriedProgramme(programme, times, risks, found, float(energy), per_hour, wish.price_per_kWh)


def _allowed(times: Array, wish: Wish) -> tuple[Array, np.ndarray]:
    low, high = {**DEFAULT_RANGES, **wish.ranges}["press_time_s"]
    inside = (times >= low) & (times <= high)
    return times[inside], inside


def _energy(task: Task, layers: Array, programme: Programme, open_s: float, converted_J_m2: float = 0.0) -> float:
    """Return the energy of a panel. [kWh]

    What it has taken up when it leaves, as heat and by what its water and resin have become, and what both open
    plates lose to the room by ``h_ap`` (or whatever the press file calls the plate's open side) until the next.
    What platens lose outwards is not known here.
    """
    run, _ = made_up_run(task, programme)
    panel = panel_of(run)
    taken_up = (
        panel.density * panel.heat_capacity * panel.thickness * float(SHARE @ (layers - panel.initial_temperature))
    )
    films = _open_films(task, press_for_run(task.press, run))
    lost = 2.0 * float(np.mean(films or [0.0])) * (programme.platen_C - run.ambient_temperature) * open_s
    return task.press.press.area_m2 * (taken_up + converted_J_m2 + lost) / KWH_J


def _open_films(task: Task, press: Press) -> list[float]:
    """Return the coefficients by which a plate that parts from the panel loses heat to air. [W/m²K]"""
    panels = task.press.panel_layers
    names = (
        c.open[1 if c.between[0] in panels else 0]
        for c in press.contact
        if isinstance(c.open, tuple) and {*c.between} & {*panels}
    )
    return [task.model.values.get(name, 0.0) for name in names]


def _savings(
    drawn: Ensemble, wish: Wish, kinetics: Kinetics | None, what: tuple[TriedProgramme, Quantities]
) -> tuple[Saving, ...]:
    """Return the press time that would do if one source of doubt after the other were none; those that save."""
    tried, quantities = what
    found = []
    times, allowed = _allowed(drawn.press_times, wish)
    slopes = np.asarray(np.linalg.pinv(drawn.draws.unit))
    for source in sources_of(drawn.draws):
        columns = np.flatnonzero([s == source for s in drawn.draws.sources])
        known = quantities.without(drawn.draws.unit, slopes, columns).known()
        seconds = opening(times, broken(wish.limits, kinetics, known).at(allowed), wish.limits.probability).in_s
        if isfinite(seconds) and not seconds >= tried.opening.in_s:
            found.append(Saving(source, seconds))
    return tuple(sorted(found, key=lambda s: s.press_time_s))
