"""The start between a run's first readings: straight in height, or at rest.

A stack at rest passes the same flux everywhere between two readings, so its temperature is straight along the
thermal resistance: of the layers, at their temperatures, and of the contacts. Where contacts are open each body
has the temperature of its own readings. What is taken or given between two readings (sources, losses to the air)
is not counted. One that was not quite at rest differs, in each gap between two readings, by a parabola along the
resistance, whose height is a parameter (``start_0_K`` for the lowest gap): flux and temperature stay continuous.

The live sensor starts at rest, at the coefficients in force and with their doubt. A fit starts straight in
height, with no say of its contacts: at rest, the first readings become evidence on them, though a press is
loaded otherwise before its first row. On the press rig, whose later readings hardly separate its two contacts,
such a fit put the whole resistance into one of them (100 kW/m²K in the other), where their author finds 1.2 to
4.5 in both; so it did with the parabolas among its unknowns, and with contacts as guessed one of the six runs
left that range. (Decided 2026-11-22.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.press.press_file import At, BoundaryKind, InitialKind, Press
from daq.records import Array, Panel, Run, StartNotRead
from daq.words import say
from softsensor.effects import Terms
from softsensor.effects.parameters import uniform_sd
from softsensor.heat import implicit_steps
from softsensor.heat.assembly import layer_constants
from softsensor.heat.case import Case
from softsensor.heat.solve_request import SolveRequest
from softsensor.heat.step_terms import DG, DROWS, DSTAR, ROWS, STAR, Coefficients, G, coefficients

ENDS = ("boundary.bottom", "boundary.top")

# Numbers without another source were set by hand, 2026-11.

_PARABOLA = 4.0
"""Times u (1 - u) it is 1 in the middle, by definition."""
LEAST_SHARE = 1e-9
"""An interface that conducts less than this share of the best one conducts nothing."""


@dataclass(frozen=True)
class Conditions:
    """What a start at rest follows: the arrays of a solve, of which the first step counts."""

    request: SolveRequest
    stack: implicit_steps.Stack
    tangents: implicit_steps.Tangents
    drive: implicit_steps.Drive


@dataclass(frozen=True)
class Resistance:
    """Thermal resistance from the lowest cell's middle on, with its derivatives. [m²K/W]"""

    cells: Array
    """Up to each cell's middle (n)."""
    d_cells: Array
    """(P, n)"""
    ends: tuple[float, float]
    """Down and up to the boundaries."""
    d_ends: Array
    """(2, P)"""

    @property
    def least(self) -> float:
        """Places are one where there is less between them, in the unit of `cells`."""
        return 1e-6 * float(np.diff(self.cells).min())

    @staticmethod
    def of(co: Coefficients) -> Resistance:
        """Add up the interfaces of a step's coefficients."""
        g = np.maximum(co.w[G], LEAST_SHARE * co.w[G].max())
        steps = 1.0 / g
        d_steps = -co.dw[DG] * steps**2 * (co.w[G] == g)
        inner, d_inner = steps[1:-1], d_steps[:, 1:-1]
        none = np.zeros((len(d_steps), 1))
        d_cells = np.concatenate([none, np.cumsum(d_inner, axis=1)], axis=1)
        cells = np.concatenate([[0.0], np.cumsum(inner)])
        return Resistance(
            cells,
            d_cells,
            (-float(steps[0]), float(cells[-1] + steps[-1])),
            np.stack([-d_steps[:, 0], d_cells[:, -1] + d_steps[:, -1]]),
        )

    def at(self, case: Case, place: str) -> tuple[float, Array]:
        """Return it, and its derivatives (P), at a boundary or a place of the case."""
        if place in ENDS:
            end = ENDS.index(place)
            return self.ends[end], self.d_ends[end]
        weights = case.places[case.labels.index(place)]
        return float(weights @ self.cells), self.d_cells @ weights

    def share(self, case: Case, between: tuple[str, str]) -> tuple[Array, Array]:
        """Return how far along from one place to another each cell lies, from 0 to 1 (n), and its derivatives."""
        (low, d_low), (high, d_high) = (self.at(case, place) for place in between)
        u = (self.cells - low) / (high - low)
        d_u = (self.d_cells - d_low[:, None] - u * (d_high - d_low)[:, None]) / (high - low)
        return np.clip(u, 0.0, 1.0), np.where((u > 0.0) & (u < 1.0), d_u, 0.0)


def gap_priors(press: Press, run: Run, panel: Panel | None) -> dict[str, float]:
    """Return how far from rest the start may be in each gap: anywhere between its readings, width/√12. [K]"""
    if press.initial.kind is not InitialKind.SENSORS:
        return {}
    places: list[tuple[float, float]] = []
    top = 0.0
    for layer in press.layer:
        thickness, _, _ = layer_constants(press, layer.name, panel)
        named = {f"{layer.name}.bottom": 0.0, f"{layer.name}.middle": 0.5, f"{layer.name}.top": 1.0}
        read: dict[float, list[float]] = {}
        for column, sensor in press.sensors_of(run).items():
            at = sensor.at
            depth = at.depth_mm / 1000.0 if isinstance(at, At) and at.layer == layer.name else None
            height = named[str(at)] * thickness if at in named else depth
            first = _first(run, column)
            if height is not None and np.isfinite(first):
                read.setdefault(top + height, []).append(first)
        places += [(height, float(np.mean(values))) for height, values in sorted(read.items())]
        top += thickness
    for (_, end), height, index in zip(press.boundary.ends, (0.0, top), (0, len(places) + 1), strict=True):
        if (
            end.kind is BoundaryKind.MEASURED
            and end.column is not None
            and np.isfinite(first := _first(run, end.column))
        ):
            places.insert(index, (height, first))
    gaps = enumerate(pairwise(places))
    return {f"start_{i}_K": uniform_sd(abs(b - a)) for i, ((low, a), (high, b)) in gaps if high > low}


def in_height(case: Case, state: implicit_steps.State) -> None:
    """Set the state to the first readings joined by straight lines in height."""
    height = np.cumsum(case.mesh.dx)
    cells = height - case.mesh.dx / 2
    straight = Resistance(cells, np.zeros((0, len(cells))), (0.0, float(height[-1])), np.zeros((2, 0)))
    state.t[:], _ = _between(case, SolveRequest({}, (), Terms(), {}), first_readings(case), straight, {})


def at_rest(case: Case, of: Conditions, state: implicit_steps.State) -> None:
    """Set the state to the temperatures between the first readings, in the first step's conditions."""
    readings = first_readings(case, of.request.boundary_shift)
    state.t[:] = np.mean(list(readings.values()))
    for _ in range(implicit_steps.REST_ROUNDS):
        resistance = _resistance(of, state)
        d_read = {name: of.drive.d_boundary[end] for end, name in enumerate(ENDS)}
        t, s = _between(case, of.request, readings, resistance, d_read)
        change = max(np.abs(t - state.t).max(), 1e-3 * np.abs(s - state.s).max(initial=0.0))
        state.t[:], state.s[:] = t, s
        if change < implicit_steps.SETTLED_K:
            break


def first_readings(case: Case, shifts: tuple[float, float] = (0.0, 0.0)) -> dict[str, float]:
    """Return the mean of the first readings at each place that has any, and at measured boundaries. [°C]"""
    found: dict[str, list[float]] = {}
    for column, place in case.fitted_places.items():
        if np.isfinite(first := _first(case.run, column)):
            found.setdefault(case.labels[place], []).append(first)
    for end, name in enumerate(ENDS):
        if case.layout.measured[end]:
            found[name] = [float(case.outside[0, end]) + shifts[end]]
    if not found:
        raise StartNotRead(say("start-no-readings", run=case.run.source or case.run.name))
    return {place: float(np.mean(values)) for place, values in found.items()}


def _first(run: Run, column: str) -> float:
    """Return a channel's first reading that is there; NaN where none is. [°C]"""
    good = run.columns[column][np.isfinite(run.columns[column])]
    return float(good[0]) if len(good) else float("nan")


def _resistance(of: Conditions, state: implicit_steps.State) -> Resistance:
    """Return the thermal resistance in the first step's conditions at a state's temperatures."""
    (p, n), r = state.s.shape, len(of.stack.heat)
    co = Coefficients(
        np.zeros((ROWS, n + 1)), np.zeros((DROWS, p, n + 1)), np.zeros((r, 2, n)), np.zeros((r, 2, p, n))
    )
    co.w[STAR, :n], co.dw[DSTAR, :, :n] = state.t, state.s
    coefficients(of.stack, of.tangents, of.drive, np.int64(0), state, co)
    return Resistance.of(co)


def _between(
    case: Case, request: SolveRequest, readings: dict[str, float], along: Resistance, d_read: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return temperatures along the resistance (n), and their derivatives (P, n)."""
    none = np.zeros(len(along.d_cells))
    groups: list[list[str]] = []
    for place in sorted(readings, key=lambda place: along.at(case, place)[0]):
        if (
            groups and along.at(case, place)[0] - along.at(case, groups[-1][0])[0] < along.least
        ):  # joined perfectly
            groups[-1].append(place)
        else:
            groups.append([place])
    values = [np.mean([readings[place] for place in group]) for group in groups]
    d_values = [np.mean([d_read.get(place, none) for place in group], axis=0) for group in groups]
    t = np.full(len(along.cells), values[0])
    s = np.repeat(d_values[0][:, None], len(t), axis=1)
    for i, (low, high) in enumerate(pairwise(groups)):
        u, d_u = along.share(case, (low[0], high[0]))
        name = f"start_{sum(map(len, groups[: i + 1])) - 1}_K"
        rise, bend = values[i + 1] - values[i], _PARABOLA * request.values.get(name, 0.0)
        t += u * rise + bend * u * (1.0 - u)
        s += d_u * (rise + bend * (1.0 - 2.0 * u)) + np.outer(d_values[i + 1] - d_values[i], u)
        if name in request.names:
            s[request.names.index(name)] += _PARABOLA * u * (1.0 - u)
    return t, s
