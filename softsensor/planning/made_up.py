"""Pressings of a panel not pressed yet: a made-up program, drawn many times with all that is not known of it.

Platens stand at their set point, for what a press's control does to them nobody has measured; how far a platen
may be off (`signals.instrument.PLATEN_TOTAL_K`) is drawn. A draw has its own coefficients and effects (the model
file's covariance, scatter from run to run included), constants (`signals.doubt`), platens, kinetics and sorption.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Legendre

from daq.press.header import LIMITS, panel_of
from daq.press.press_file import Press, press_for_run
from daq.press.resin_file import Resin, SorptionTable
from daq.records import Array, InputError, Moments, Run
from daq.words import say
from softsensor.effects import contact_load, find_effect
from softsensor.fitting.constants import changed_run
from softsensor.heat.batch import solve_many
from softsensor.heat.case import Case
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import ModelFile
from softsensor.opening.steam import MOISTURE, isotherm_sd, stated_moisture, steam_pressure
from softsensor.signals.digest import STEP_S
from softsensor.signals.doubt import Doubt, constant_doubts
from softsensor.signals.instrument import PLATEN_TOTAL_K, RAMP_S

HALF = 48
"""Draws, each with its mirror image, so that their mean is exact to first order: a standard deviation from twice
as many is good to 7 %. Set by hand, for answers within 10 s."""
ADVISED = "advised"
"""What a made-up run is called."""
SEED = 22
"""The same draws for all programs, so that they differ by the program alone; any seed does."""

# Numbers without another source were set by hand, 2026-11.

ROW_S = 1.0
"""Rows of a made-up run. [s]"""
STEAM_ROWS = 5
"""Steam, which follows the whole panel, is worked out at every fifth row, straight in between."""


def nodes(count: int) -> tuple[Array, Array]:
    """Return so many depths as shares of a panel's thickness, both faces among them, and what each stands for.

    Nodes and weights of Gauss-Lobatto quadrature (Abramowitz & Stegun, 25.4.32).

    Examples
    --------
    >>> depths, share = nodes(3)  # Simpson's rule
    >>> depths.round(6).tolist(), share.round(4).tolist()
    ([0.0, 0.5, 1.0], [0.1667, 0.6667, 0.1667])
    """
    inside = Legendre.basis(count - 1)
    at = np.concatenate([[-1.0], np.sort(inside.deriv().roots().real), [1.0]])
    return 0.5 + 0.5 * at, 1.0 / (count * (count - 1) * inside(at) ** 2)


READ = 17
"""Depths at which a panel is read: heat within 0.2 % and steam within 7 % of what all cells have (8 and 20 % with
nine depths, no better with 21: `tests/calibration/panel_depths.py`, draws of seed 22, 2026-11-30)."""
DEPTHS, SHARE = nodes(READ)
"""Where temperatures are read, as shares of the thickness, and of how much of the panel each is."""
DRIEST_PERCENT = 0.1
"""A draw's panel holds at least so much water: what is drawn below is no panel. [% of dry mass]"""
STILL_MATTER = 0.8
"""A draw may take so large a share of a constant away: what is nearly nothing, or less, is no matter."""
COEFFICIENTS, EFFECTS, PLATENS, KINETICS, SORPTION = "coefficients", "effects", "platens", "kinetics", "sorption"
"""Sources of doubt besides the constants, which go by their keys in the header."""


@dataclass(frozen=True)
class Programme:
    """What a press does with a panel."""

    platen_C: float  # noqa: N815
    """Set point of both platens. [°C]"""
    pressure_N_cm2: float | None  # noqa: N815
    """None: the press file and the model know of none. [N/cm²]"""


@dataclass(frozen=True)
class Task:
    """What is to be pressed, on what."""

    press: Press
    model: ModelFile
    header: Mapping[str, Any]
    """Of the panel and the room, by keys of a run's header."""
    waiting_s: float
    """From laying the panel in to closing. [s]"""
    longest_s: float
    """The longest press time looked at. [s]"""

    @property
    def follows_load(self) -> bool:
        """Whether the model knows what pressure does."""
        return contact_load.EFFECT.name in dict(self.model.effects)


@dataclass(frozen=True)
class Draws:
    """Standard normal numbers, and what each column stands for."""

    unit: Array
    """(draws, P)"""
    sources: tuple[str, ...]
    """Of each column (P)."""

    def of(self, source: str) -> Array:
        """Return a source's columns (draws, n)."""
        return self.unit[:, [s == source for s in self.sources]]


@dataclass(frozen=True)
class Courses:
    """Panels through one program, while it is closed."""

    press_time_s: Array
    """Since the middle of the closing (t). [s]"""
    layers_C: Array  # noqa: N815
    """By draw and depth (draws, t, depths). [°C]"""
    core_C: Array  # noqa: N815
    """By draw (draws, t). [°C]"""
    faces_C: Array  # noqa: N815
    """Both faces, lower first, over all of the run (2, draws, rows). [°C]"""
    time_s: Array
    """Of the run (rows). [s]"""
    rows: np.ndarray
    """Which rows the press times are (t)."""


def made_up_run(task: Task, programme: Programme) -> tuple[Run, Moments]:
    """Return the run of a program that stays closed.

    Raises
    ------
    InputError
        For a panel that cannot be, and for a load whose unit is unknown where the model follows it.
    """
    if not task.press.has_states:
        raise InputError(say("advise-press-without-states", press=task.press.name))
    end = task.waiting_s + task.longest_s
    time_s = np.arange(0.0, end + ROW_S, ROW_S)
    header = {"run": ADVISED, **task.header}
    if programme.pressure_N_cm2 is not None:
        header["setting.pressure_N_cm2"] = programme.pressure_N_cm2
    empty = Run(ADVISED, header, time_s, {})
    described = press_for_run(task.press, empty)
    columns = {platen: np.full(len(time_s), programme.platen_C) for platen in described.platens}
    for contact in described.contact:
        if contact.load is not None and programme.pressure_N_cm2 is not None:
            if contact.load.unit is None and task.follows_load:
                raise InputError(say("advise-load-unit", press=task.press.name, column=contact.load.column))
            columns[contact.load.column] = np.full(len(time_s), contact.load.reading(programme.pressure_N_cm2))
    return replace(empty, columns=columns), Moments(inserted_s=0.0, closed_s=task.waiting_s, ramp_s=RAMP_S)


@dataclass(frozen=True)
class Ensemble:
    """Draws of one task, ready to be solved for any program."""

    task: Task
    start: Programme
    draws: Draws
    cases: tuple[Case, ...]
    """At the start's platens and pressure, by draw."""
    values: tuple[dict[str, float], ...]
    doubts: Mapping[str, Doubt]

    def courses(self, programme: Programme) -> Courses:
        """Return the temperatures of all draws through a program."""
        warmer = programme.platen_C - self.start.platen_C
        ratio = 1.0
        if programme.pressure_N_cm2 is not None and self.start.pressure_N_cm2 is not None:
            ratio = programme.pressure_N_cm2 / self.start.pressure_N_cm2
        shift = np.array([warmer, 0.0])
        cases = [
            replace(
                c,
                boundary=c.boundary + shift,
                outside=c.outside + warmer,
                load={m: ratio * load for m, load in c.load.items()},
            )
            for c in self.cases
        ]
        solved = solve_many(self.model, cases, list(self.values))
        layers, core = (np.stack([s.places[:, at] for s in solved]) for at in (slice(-1), -1))
        faces = np.stack([layers[:, :, 0], layers[:, :, -1]])
        rows = self.rows
        return Courses(self.press_times, layers[:, rows], core[:, rows], faces, cases[0].run.time_s, rows)

    @cached_property
    def rows(self) -> np.ndarray:
        """Rows of the run at which the press may open, a second apart (t)."""
        closed = self.cases[0].run.time_s >= self.task.waiting_s + RAMP_S
        return np.flatnonzero(closed)[:: round(1.0 / ROW_S)]

    @property
    def press_times(self) -> Array:
        """Press time at these rows (t). [s]"""
        return np.asarray(self.cases[0].run.time_s[self.rows] - self.task.waiting_s)

    @cached_property
    def model(self) -> ThermalModel:
        """The thermal model with the model file's effects."""
        return self.task.model.model(self.task.press)


def ensemble(task: Task, start: Programme) -> Ensemble:
    """Draw what is not known. Raises `InputError` for a panel or press that cannot be solved."""
    run, moments = made_up_run(task, start)
    drawn = draw(run, task.press, task.model, moments)
    return Ensemble(task, start, drawn.draws, drawn.cases, drawn.values, drawn.doubts)


def heat_taken(task: Task, programme: Programme, press_time_s: float) -> float:
    """Return the heat that a panel's own conversions have taken when the press opens, at the middle of all doubt.

    Water that evaporates takes heat, resin that cures gives some (which counts below 0). [J/m²]
    """
    run, moments = made_up_run(replace(task, longest_s=press_time_s), programme)
    taken = _taken(constant_doubts(run.header, task.press, task.model.learned))
    model = task.model.model(task.press)
    case = model.prepare(replace(run, header={**taken, **run.header}), moments, max_step_s=STEP_S)
    values = _central(task.press, task.model)
    released = model.build(case, values).stack.heat
    if not len(released):
        return 0.0
    return -float(((released * model.solve(case, values).final.done) @ case.mesh.dx).sum())


def _taken(doubts: Mapping[str, Doubt]) -> dict[str, Any]:
    """Return what is taken for a panel's constants that its header does not state, by key."""
    return {key: doubt.value for key, doubt in doubts.items() if key.startswith("panel.")}


@dataclass(frozen=True)
class Drawn:
    """A pressing drawn many times."""

    draws: Draws
    cases: tuple[Case, ...]
    """By draw, read at `DEPTHS` and in the core."""
    values: tuple[dict[str, float], ...]
    """Of the model's parameters, by draw."""
    doubts: Mapping[str, Doubt]


def steam_of(drawn: Drawn | Ensemble, layers_C: Array, resin: Resin | None) -> Array:
    """Return the pressure of steam in panels drawn (draws, t, depths at `DEPTHS`): (draws, t). [kPa]

    NaN where nobody stated how moist the panel is, as live.
    """
    if (moisture := stated_moisture(drawn.doubts)) is None:
        return np.full(layers_C.shape[:2], np.nan)
    draws, sorption = drawn.draws, SorptionTable() if resin is None else resin.sorption
    percent = np.maximum(moisture.value + moisture.sd * draws.of(MOISTURE), DRIEST_PERCENT)
    boards = np.exp(isotherm_sd(sorption, moisture.value) * draws.of(SORPTION))
    return steam_pressure(layers_C, SHARE, percent, sorption.factor * boards)


def draw(run: Run, press: Press, model: ModelFile, moments: Moments) -> Drawn:
    """Draw what is not known of a pressing. Raises `InputError` for a panel or press that cannot be solved."""
    panel_of(run)
    doubts = {k: d for k, d in constant_doubts(run.header, press, model.learned).items() if d.sd > 0.0}
    run = replace(run, header={**_taken(doubts), **run.header})
    sources = [COEFFICIENTS if name in press.coefficient_names else EFFECTS for name in model.names]
    sources += [*doubts, PLATENS, PLATENS, KINETICS, KINETICS, SORPTION]
    half = np.random.default_rng(SEED).standard_normal((HALF, len(sources)))
    draws = Draws(np.concatenate([half, -half]), tuple(sources))
    thermal = model.model(press)
    cases = [
        _read_through(thermal.prepare(_drawn(run, press, doubts, draws, i), moments, max_step_s=STEP_S))
        for i in range(len(draws.unit))
    ]
    return Drawn(draws, tuple(cases), tuple(_values(press, model, draws)), doubts)


def _drawn(run: Run, press: Press, doubts: Mapping[str, Doubt], draws: Draws, i: int) -> Run:
    """Return the run with its constants as one draw has them, within what can be; what no matter has stays."""
    for key, doubt in doubts.items():
        change = doubt.sd * float(draws.of(key)[i, 0])
        if (limits := LIMITS.get(key)) is not None:
            change = min(max(change, limits.lower - doubt.value), limits.upper - doubt.value)
        if key.startswith(("ambient.", "panel.initial")) or abs(change) < STILL_MATTER * abs(doubt.value):
            run = changed_run(run, press, key, change)
    return run


def _read_through(case: Case) -> Case:
    """Return the case read at `DEPTHS` of its panel, its core last."""
    layer = case.press.panel_layers[0]
    width = float(case.mesh.dx[case.mesh.cells(layer)].sum())
    places = np.stack([*(case.mesh.place(layer, z * width) for z in DEPTHS), case.places[-1]])
    labels = (*(f"{layer}@{z:g}" for z in DEPTHS), "core")
    return replace(case, places=places, labels=labels, columns=(), place_of={}, press_face=np.zeros_like(places))


def _values(press: Press, model: ModelFile, draws: Draws) -> list[dict[str, float]]:
    """Return every parameter of each draw."""
    own = np.concatenate([draws.of(COEFFICIENTS), draws.of(EFFECTS)], axis=1)
    order = [i for i, s in enumerate(model.names) if s in press.coefficient_names]
    order += [i for i, s in enumerate(model.names) if s not in press.coefficient_names]
    unit = np.zeros((len(own), len(model.names)))
    unit[:, order] = own
    sd, vectors = np.linalg.eigh(model.covariance) if len(model.names) else (np.zeros(0), np.zeros((0, 0)))
    root = (vectors * np.sqrt(np.maximum(sd, 0.0))) @ vectors.T
    moved = unit @ root
    central = _central(press, model)
    found = []
    for row, platens in zip(moved, draws.of(PLATENS), strict=True):
        values = dict(central)
        for name, change in zip(model.names, row, strict=True):
            if name in press.coefficient_names:
                values[name] *= float(np.exp(change))
            else:
                values[name] = _within(name, values[name] + float(change))
        values["boundary_bottom_K"], values["boundary_top_K"] = (PLATEN_TOTAL_K * platens).tolist()
        found.append(values)
    return found


def _central(press: Press, model: ModelFile) -> dict[str, float]:
    """Return the model file's parameters, and the press file's guesses of coefficients that it does not have."""
    return {name: press.coefficient(name).guess for name in press.coefficient_names} | model.values


def _within(name: str, value: float) -> float:
    effect, _, parameter = name.partition(".")
    limits = next(p for p in find_effect(effect).parameters if p.name == parameter)
    return float(np.clip(value, limits.lower, limits.upper))


def sources_of(draws: Draws) -> Sequence[str]:
    """Return the sources of doubt, each once."""
    return tuple(dict.fromkeys(draws.sources))
