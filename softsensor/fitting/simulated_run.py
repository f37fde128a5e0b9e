"""A run simulated from its platen temperatures: what command, page and notebook show of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from daq.press.press_file import Press
from daq.printed import lines_of
from daq.records import COLDEST_C, HOTTEST_C, Array, Moments, Nonphysical, PressState, Run
from daq.words import say
from softsensor.fitting.problem import rows_with_panel
from softsensor.fitting.result import rms
from softsensor.heat.case import Case
from softsensor.heat.chain import Solution
from softsensor.heat.model import ThermalModel, states
from softsensor.heat.step_terms import Stack, heat
from softsensor.signals.moments import moments_of
from softsensor.signals.places import Place, collect_signals
from softsensor.signals.robust import nan_mean

# Numbers without another source were set by hand, 2026-11.

PROFILE_ROWS, PROFILE_DEPTHS = 160, 41
"""Times and depths of the temperature profile handed out, at most and exactly: enough for a picture."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """What the model says about a run, place by place."""

    time_s: Array
    """Of the run's rows. [s]"""
    state: tuple[PressState, ...]
    """What the press does in each row."""
    places: Mapping[str, Array]
    """Temperature at each sensor position, named as in ``at``. [°C]"""
    measured: Mapping[str, Array]
    """Mean of the sensors at each position while the panel is in the press, without what a fit leaves out. [°C]"""
    rmse: Mapping[str, float]
    """The fit's `rmse_K` by position: all good channels, each one's constant offset removed. [K]"""
    core: Array
    """In the middle of the panel, or where the press file puts it. [°C]"""
    profile_time_s: Array
    """When the profile is given. [s]"""
    profile_depth_mm: Array
    """From the panel's lower face. [mm]"""
    profile: Array
    """Temperature through the panel (times, depths). [°C]"""
    profile_heat: Array
    """Heat in the panel beyond its start (times), water and reactions not counted; zero without a panel. [J/m²]"""

    def __repr__(self) -> str:
        """Return on one screen how long it is, and at each place the range [°C] and the error [K]."""
        head = f"Simulated: {len(self.time_s)} rows, {self.time_s[0]:g} to {self.time_s[-1]:g} s"
        ranges = {**self.places, "core": self.core}
        errors = {place: f", {value:.2f} K from the readings" for place, value in self.rmse.items()}
        lines = [f"{p}: {min(v):.1f} to {max(v):.1f} °C{errors.get(p, '')}" for p, v in ranges.items()]
        return "\n".join([head, *lines_of(lines)])


def simulate_run(
    run: Run,
    press: Press,
    model: ThermalModel,
    values: Mapping[str, float],
    refined: Mapping[str, float] = MappingProxyType({}),
    known: Moments | None = None,
) -> Simulated:
    """Solve the model over a run, open loop; `refined` moments go before those found.

    `known`: the moments, where they need not be found.

    Raises
    ------
    InputError
        As `ThermalModel.solve`, and where a temperature is none that matter has.
    """
    moments = moments_of(run, press) if known is None else known
    moments = replace(
        moments,
        inserted_s=refined.get("inserted_s", moments.inserted_s),
        closed_s=refined.get("closed_s", moments.closed_s),
        opened_s=refined.get("opened_s", moments.opened_s),
        ramp_s=refined.get("ramp_s", moments.ramp_s),
    )
    case = model.prepare(run, moments)
    solution = model.solve(case, values, fields=True)
    _check_possible(run, solution.fields)
    places = {label: solution.places[:, i] for i, label in enumerate(case.labels[:-1])}
    signals = collect_signals(case.press, run, moments)
    believed = {place.label: place for place in signals.places}
    inside = rows_with_panel(case) > 0
    measured, rmse = {}, {}
    for i, label in enumerate(places):
        place = believed.get(label)
        mean = place.mean if place else _measured(run, case.place_of, i)
        measured[label] = np.where(inside, mean, np.nan)
        channels = [signals.cells[c] for c in place.columns] if place else [mean]
        away = [np.where(inside, channel - places[label], np.nan) for channel in channels]
        if any(np.isfinite(a).any() for a in away):
            rmse[label] = rms(a - nan_mean(a) for a in away if np.isfinite(a).any())
    profile = _profile(case, solution, model.build(case, values).stack)
    return Simulated(run.time_s, tuple(states(case)), places, measured, rmse, solution.core, *profile)


def _check_possible(run: Run, fields: Array) -> None:
    """Refuse temperatures that no matter has: the numbers mean nothing then. Raises `Nonphysical`. [°C]"""
    wrong = fields[~((fields > COLDEST_C) & (fields < HOTTEST_C))]
    if len(wrong):
        limits = {"coldest": COLDEST_C, "hottest": HOTTEST_C}
        raise Nonphysical(say("solve-impossible", run=run.source or run.name, found=f"{wrong[0]:.4g}", **limits))


def _profile(case: Case, solution: Solution, stack: Stack) -> tuple[Array, Array, Array, Array]:
    """Return times [s], depths [mm], temperatures [°C] through the panel (times, depths) and its heat [J/m²].

    All are empty without a panel.
    """
    if not case.press.panel_layers:
        return np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros(0)
    layer = case.press.panel_layers[0]
    cells, centres = case.mesh.cells(layer), case.mesh.centres(layer)
    depths = np.linspace(0.0, case.mesh.dx[cells].sum(), PROFILE_DEPTHS)
    rows = np.unique(np.linspace(0, len(case.edges) - 1, PROFILE_ROWS).astype(int))
    fields = np.stack([np.interp(depths, centres, solution.fields[row, cells]) for row in rows])
    start = float(np.average(solution.fields[0, stack.wet], weights=stack.dx[stack.wet]))
    warmth = np.array([heat(stack, start, solution.fields[row]) for row in rows])
    return case.edges[rows], depths * 1000.0, fields, warmth


def _measured(run: Run, place_of: Mapping[str, int], place: int) -> Array:
    """Mean of a place's sensors, their own offsets taken out."""
    columns = [name for name, at in place_of.items() if at == place]
    return Place.of("", columns, np.stack([run.columns[name] for name in columns], axis=1)).mean
