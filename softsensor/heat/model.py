"""The thermal model: a press, effects, and one run in; temperatures and their sensitivities out.

    rho c dT/dt = d/dx (k dT/dx) + q          T in °C, x in m from the bottom, q in W/m³

Notes on the paper this follows:

* It prints the equation with the sign of the conduction term turned and without rho c; the form above is
  meant, since heat flows down the gradient and the printed one has other units on either side.
* Its figure of the layers and its table of transitions give the labels h_p and h_pp the other way round
  for the open press. Here the figure counts: h_p couples platen and plate, h_pp couples plate and panel.
* Its pressures are read as N/cm² (350 N/cm² = 3.5 MPa, usual for laminating); the same figures in bar or
  N/mm² would be ten or a hundred times that.
* Its values table, read literally, weakens both contacts on closing, and no panel face could get warm
  enough to laminate; only closed values in kW/m²K do. ``deploy/examples/paper_table`` computes the face
  temperature under each reading. The file's guesses are ours.

Accuracy of the default mesh and steps (fineness 1, steps up to 0.5 s) on the laboratory press, panels of 8 to
19 mm, contacts of 100 to 2000 W/m²K, against a mesh six times as fine, from 0.25 s after a ramp: faces within
0.06 K, core within 0.055 K (rms of all 0.03 K). With 2 to 6 % of evaporating water, whose front is thinner than
the cells behind the face: faces within 0.45 K in the first 1.2 s after closing and 0.15 K later, core within
0.1 K. Nearly all of it is the mesh's: `fineness` 2 quarters it.

With steam (vapour convection of 1.5e4 W/m³K) that lifts the core of an 8 mm panel over 100 °C, where its law
breaks off: core within 0.3 K on the steps of 0.1 s taken while closed (1.5 K on steps of 0.5 s, if asked for).
Inside a ramp, where faces move by up to 400 K/s, rows are good to about 2 ms of time. Radiation of an end is
taken with its slope at each step's face temperature: no step is too long for a foil to settle.

Units: K, s, W, m; temperatures in °C. Parameters are named: coefficients as in the press file
(``h_pp_c``), effect parameters ``edge_loss.W_m3K``, and these nuisances of a run:

========================  ==========================================================
``closed_s, opened_s``    middle of the closing and opening ramp, shift from the case [s]
``inserted_s``            insertion, shift from the case; without effect where the run starts at it [s]
``ramp_s``                length of the closing ramp, shift from the case [s]
``initial_K``             shift of the panel's initial temperature [K]
``boundary_bottom_K``     shift of the measured bottom boundary [K]
``boundary_top_K``        shift of the measured top boundary [K]
========================  ==========================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import accumulate
from math import isfinite
from typing import Any, Literal

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, InputError, Moments, Nonphysical, NoSteadyState, PressState, Run
from daq.words import say
from softsensor.effects import Conversion, Effect, Terms, find_effect
from softsensor.heat import implicit_steps
from softsensor.heat.assembly import initial_profile
from softsensor.heat.case import FINE_STEP_S, GROWTH, Case, Fineness, prepare_case
from softsensor.heat.exact import exact_grid, run_exact
from softsensor.heat.readout import Derivatives, Reader
from softsensor.heat.run_checks import check_first_readings, check_values, value_limits
from softsensor.heat.timing import Clock

NUISANCES = (
    "closed_s",
    "opened_s",
    "ramp_s",
    "inserted_s",
    "initial_K",
    "boundary_bottom_K",
    "boundary_top_K",
)
"""Per-run parameters every model has; 0 where nothing is known better."""
_TINY = 1e-30
"""Imaginary step of complex-step derivatives: its square vanishes beside 1."""
_STATES = (PressState.IDLE, PressState.OPEN, PressState.CLOSED)


@dataclass(frozen=True)
class Solution:
    """What the model says about a run."""

    columns: tuple[str, ...]
    sensors: Array
    """Panel channels as their thermocouples would read (rows, columns). [°C]"""
    core: Array
    """Middle of the panel (rows). [°C]"""
    places: Array
    """True temperature at each of the case's places (rows, places). [°C]"""
    d_sensors: Mapping[str, Array]
    """Derivative of `sensors` by parameter."""
    d_core: Mapping[str, Array]
    closed_share: Array
    """0 open .. 1 closed at each row."""
    fields: Array
    """Cell temperatures at every step edge (steps + 1, n), empty unless asked for. [°C]"""
    final: implicit_steps.State

    def column(self, name: str) -> Array:
        """Return one channel (rows). [°C]"""
        return np.asarray(self.sensors[:, self.columns.index(name)])


@dataclass(frozen=True)
class Build:
    """The arrays of one solve, ready for the implicit_steps."""

    stack: implicit_steps.Stack
    tangents: implicit_steps.Tangents
    drive: implicit_steps.Drive
    start: implicit_steps.State
    terms: Terms
    d_terms: Mapping[str, Terms]
    nonlinear: bool
    names: tuple[str, ...]

    @property
    def width(self) -> int:
        """Room for parameters in the tangent arrays: theirs, filled up to a multiple of four."""
        return int(self.start.s.shape[0])


@dataclass(frozen=True)
class ThermalModel:
    """A press and the effects its model takes into account.

    Examples
    --------
    >>> from softsensor.effects import find_effect
    >>> from daq.press.press_file import parse_press
    >>> press = parse_press('''
    ... [[layer]]
    ... name = "panel"
    ... from_run = true
    ... [boundary.bottom]
    ... kind = "measured"
    ... column = "platen"
    ... ''')
    >>> ThermalModel(press, (find_effect("edge_loss"),)).parameter_names
    ('edge_loss.W_m3K',)
    """

    press: Press
    effects: tuple[Effect, ...] = ()

    @staticmethod
    def of(press: Press, names: Iterable[str] = ()) -> ThermalModel:
        """Make a model from effect names of the catalogue. Raises InputError for an unknown name."""
        return ThermalModel(press, tuple(find_effect(name) for name in names))

    def extended(self, *effects: Effect) -> ThermalModel:
        """Return the model with more effects."""
        return replace(self, effects=(*self.effects, *effects))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Coefficients of the press, then the effects' parameters."""
        own = tuple(e.key(p.name) for e in self.effects for p in e.parameters)
        return self.press.coefficient_names + own

    @property
    def guesses(self) -> dict[str, float]:
        """The press file's guesses, and the effects' typical sizes."""
        values = {name: self.press.coefficient(name).guess for name in self.press.coefficient_names}
        return values | {e.key(p.name): p.typical for e in self.effects for p in e.parameters}

    def prepare(
        self,
        run: Run,
        moments: Moments,
        *,
        fineness: float = 1.0,
        max_step_s: float | None = None,
        switch_step_s: float = FINE_STEP_S,
        growth: float = GROWTH,
    ) -> Case:
        """Lay out a run for solving.

        Parameters
        ----------
        fineness
            2 halves cells and steps, and quarters the error.
        max_step_s, switch_step_s
            Longest step, and step around a switch. None: 0.5 s, or while closed what the effects bear. [s]
        growth
            Of a step over the one before, after a switch.

        Raises
        ------
        InputError
            For a run the press file cannot be solved with, see `prepare_case`.
        """
        paper = any(e.layers for e in self.effects)
        closed = min((e.closed_step_s for e in self.effects), default=np.inf) if max_step_s is None else np.inf
        how = Fineness(fineness, 0.5 if max_step_s is None else max_step_s, switch_step_s, growth, closed)
        return prepare_case(self.press, run, moments, paper=paper, fineness=how)

    def build(self, case: Case, values: Mapping[str, float], tangents: tuple[str, ...] = ()) -> Build:
        """Assemble the arrays the compiled steps work on. Raises InputError for a missing coefficient.

        A coefficient that only the run's header names is its guess there unless given.
        """
        coefficients = case.press.coefficient_names
        if case.press is not self.press:
            own = set(coefficients).difference(self.press.coefficient_names)
            values = {name: case.press.coefficient(name).guess for name in own} | dict(values)
        missing = [n for n in coefficients if n not in values]
        if missing:
            raise InputError(say("coefficient-missing", name=missing[0], all=coefficients))
        for name in coefficients:
            if not 0.0 <= values[name] < np.inf:
                raise Nonphysical(say("coefficient-negative", name=name, value=f"{values[name]:g}"))
        for name in values:
            if not isfinite(values[name]):
                raise Nonphysical(say("value-not-finite", name=name, value=f"{values[name]:g}"))
        parts = self._parts(case, values)
        terms = _part(reduce(_merge, parts, Terms()), imaginary=False)
        late = any(e.nonlinear or terms.closed_contact for e in self.effects)
        d_terms = self._derived(case, values, parts, tangents, late=late)
        p = -(-len(tangents) // 4) * 4
        layout = case.layout
        stack = layout.stack(case.mesh, terms, values, case.ambient)
        d_stack = layout.tangents(terms, d_terms, tangents, p)
        drive = _drive(case, terms, d_terms, values, tangents, p)
        nonlinear = any(e.nonlinear for e in self.effects) or bool(len(stack.table_x)) or layout.radiates
        start = _start(case, stack, d_stack, drive, terms, d_terms, values, tangents)
        return Build(stack, d_stack, drive, start, terms, d_terms, nonlinear, tangents)

    def solve(
        self,
        case: Case,
        values: Mapping[str, float],
        tangents: Iterable[str] = (),
        *,
        method: Literal["implicit", "exact"] = "implicit",
        fields: bool = False,
    ) -> Solution:
        """Run the model over a case.

        Parameters
        ----------
        values
            Every coefficient of the press; effect parameters left out are neutral, nuisances 0.
        tangents
            Parameters to differentiate by.
        method
            ``implicit`` (TR-BDF2) for any model; ``exact`` in time for a linear one, see `exact`.
        fields
            Keep all cell temperatures at every step edge of the case (of the exact solver's own grid).

        Raises
        ------
        Nonphysical
            For a value that is no number, or outside what its parameter can be.
        NoSteadyState
            For plates without a steady start.
        InputError
            For a missing coefficient, a value or a tangent the model does not have, an unknown method, a start
            from readings that are not there, or a model the exact solver cannot take.
        """
        names = tuple(tangents)
        if method not in ("implicit", "exact"):
            raise InputError(say("solve-unknown-method", method=repr(method)))
        self.check(case, values, names)
        grid = (
            exact_grid(case, values, fine=self._late(case, values) or bool(names)) if method == "exact" else None
        )
        build = self.build(grid.sparse if grid else case, values, names)
        steps, m, p = len(case.h), len(case.places), build.width
        places = read_places(case, build)
        shares, _ = case.row_clock.shares(values)
        if grid is not None:
            if build.nonlinear:
                bent = [e.name for e in self.effects if e.nonlinear]
                what = bent[0] if bent else say("solve-table-or-radiation")
                raise InputError(say("solve-exact-not-linear", what=what))
            out, d_out, kept = run_exact(grid, build, places, fields=fields)
            return observe(grid.case, build, values, out, d_out[: len(names)], m, kept, shares[:, 2])
        out = np.empty((steps + 1, len(places)))
        d_out = np.empty((p, steps + 1, len(places)))
        kept = np.empty((steps + 1 if fields else 0, len(case.mesh.dx)))
        record = implicit_steps.Record(places, out, d_out, kept)
        implicit_steps.march(build.stack, build.tangents, build.drive, build.start, record, build.nonlinear)
        return observe(case, build, values, out, d_out[: len(names)], m, kept, shares[:, 2])

    def check(self, case: Case, values: Mapping[str, float], tangents: Iterable[str] = ()) -> None:
        """Refuse what `solve` does, but for models the exact solver cannot take."""
        limits = self._limits
        if case.press is not self.press:
            limits = value_limits((), case.press.coefficient_names, ()) | limits
        check_values(limits, values)
        if unknown := [name for name in tangents if name not in limits]:
            raise InputError(say("parameter-unknown", name=unknown[0], known=tuple(limits)))
        if case.press.initial.kind == "sensors":
            check_first_readings(case.run, case.press.panel_layers, case.place_of, case.labels)

    @cached_property
    def _limits(self) -> dict[str, tuple[float, float]]:
        return value_limits(self.effects, self.press.coefficient_names, NUISANCES)

    def _late(self, case: Case, values: Mapping[str, float]) -> bool:
        """Whether what a channel reads depends on more than its row's moment."""
        terms = self._terms(case, values)
        return bool(terms.lag != 0.0 or terms.clock != 0.0)

    def _terms(self, case: Case, values: Mapping[str, float]) -> Terms:
        """Merge the effects' terms."""
        return _part(reduce(_merge, self._parts(case, values), Terms()), imaginary=False)

    def _parts(self, case: Case, values: Mapping[str, float], shift: complex = 0.0) -> list[Terms]:
        """Return each effect's terms, with the moment of closing shifted. [s]"""
        scene = replace(case.scene, closed_s=case.moments.closed_s + values.get("closed_s", 0.0) + shift)
        return [effect.terms(scene, _own(effect, values)) for effect in self.effects]

    def _derived(
        self, case: Case, values: Mapping[str, float], parts: list[Terms], by: Iterable[str], *, late: bool
    ) -> dict[str, Terms]:
        """Return the derivatives of the merged terms by those parameters that they depend on.

        `parts` are the effects' terms; a parameter changes those of its own effect only, and the moment of
        closing, if `late`, those of all.
        """
        owners = {e.key(p.name): (i, p.name) for i, e in enumerate(self.effects) for p in e.parameters}
        scene = replace(case.scene, closed_s=case.moments.closed_s + values.get("closed_s", 0.0))
        before = list(accumulate(parts, _merge, initial=Terms()))
        after = list(accumulate(reversed(parts), lambda a, b: _merge(b, a), initial=Terms()))[::-1]
        derived = {}
        for name in by:
            if name in owners:
                i, own = owners[name]
                here = _own(self.effects[i], values)
                moved = self.effects[i].terms(scene, here | {own: here[own] + 1j * _TINY})
                merged = _merge(_merge(before[i], moved), after[i + 1])
            elif name == "closed_s" and late:
                merged = reduce(_merge, self._parts(case, values, 1j * _TINY), Terms())
            else:
                continue
            derived[name] = _part(merged, imaginary=True)
        return derived


def _own(effect: Effect, values: Mapping[str, float]) -> dict[str, Any]:
    """Return an effect's parameters by their short names."""
    return {p.name: values.get(effect.key(p.name), p.neutral) for p in effect.parameters}


def _merge(a: Terms, b: Terms) -> Terms:
    contact = dict(a.closed_contact)
    for m, factor in b.closed_contact.items():
        contact[m] = contact[m] * factor if m in contact else factor
    return Terms(
        conductivity=a.conductivity * b.conductivity,
        conductivity_slope=a.conductivity_slope + b.conductivity_slope,
        capacity=a.capacity * b.capacity,
        capacity_slope=a.capacity_slope + b.capacity_slope,
        exchange=a.exchange + b.exchange,
        closed_contact=contact,
        emissivity=a.emissivity + b.emissivity,
        convection=a.convection + b.convection,
        conversions=a.conversions + b.conversions,
        paper=b.paper if b.paper is not None else a.paper,
        plates_offset=a.plates_offset + b.plates_offset,
        boundary_offset=(a.boundary_offset[0] + b.boundary_offset[0], a.boundary_offset[1] + b.boundary_offset[1]),
        lag=a.lag + b.lag,
        footprint=a.footprint + b.footprint,
        clock=a.clock + b.clock,
    )


def _part(terms: Terms, *, imaginary: bool) -> Terms:
    """Take the real part of terms, or their derivative from the imaginary one."""

    def take(x: Any) -> Any:
        return x.imag / _TINY if imaginary else x.real

    return Terms(
        conductivity=take(terms.conductivity),
        conductivity_slope=take(terms.conductivity_slope),
        capacity=take(terms.capacity),
        capacity_slope=take(terms.capacity_slope),
        exchange=take(terms.exchange),
        closed_contact={m: take(f) for m, f in terms.closed_contact.items()},
        emissivity=take(terms.emissivity),
        convection=take(terms.convection),
        conversions=tuple(
            Conversion(take(c.heat), c.kind, take(c.a), take(c.b), take(c.c)) for c in terms.conversions
        ),
        paper=None if terms.paper is None else (take(terms.paper[0]), take(terms.paper[1])),
        plates_offset=take(terms.plates_offset),
        boundary_offset=(take(terms.boundary_offset[0]), take(terms.boundary_offset[1])),
        lag=take(terms.lag),
        footprint=take(terms.footprint),
        clock=take(terms.clock),
    )


def _boundary_shift(terms: Terms, values: Mapping[str, float]) -> tuple[float, float]:
    """What is added to the measured boundary temperatures. [K]"""
    bottom, top = terms.boundary_offset
    return float(bottom) + values.get("boundary_bottom_K", 0.0), float(top) + values.get("boundary_top_K", 0.0)


def _drive(
    case: Case,
    terms: Terms,
    d_terms: Mapping[str, Terms],
    values: Mapping[str, float],
    names: tuple[str, ...],
    p: int,
) -> implicit_steps.Drive:
    steps, contacts = len(case.h), len(case.layout.interface)
    weight, d_weight = case.step_clock.shares(values, names, p)
    factor, d_factor = case.unchanged, np.zeros((steps, contacts, p))
    if terms.closed_contact:
        factor = factor.copy()
        for m, f in terms.closed_contact.items():
            factor[:, m] = f
    boundary, shift = case.boundary, _boundary_shift(terms, values)
    if shift[0] != 0.0 or shift[1] != 0.0:
        boundary = boundary.copy()
        boundary[:, :, 0] += shift
    d_boundary = np.zeros((2, p))
    for i, name in enumerate(names):
        if name in d_terms:
            for m, f in d_terms[name].closed_contact.items():
                d_factor[:, m, i] = f
            d_boundary[:, i] = d_terms[name].boundary_offset
        if name in ("boundary_bottom_K", "boundary_top_K"):
            d_boundary[0 if "bottom" in name else 1, i] = 1.0
    d_boundary[~case.layout.measured] = 0.0
    return implicit_steps.Drive(case.h, weight, d_weight, factor, d_factor, boundary, d_boundary)


def _start(
    case: Case,
    stack: implicit_steps.Stack,
    d_stack: implicit_steps.Tangents,
    drive: implicit_steps.Drive,
    terms: Terms,
    d_terms: Mapping[str, Terms],
    values: Mapping[str, float],
    names: tuple[str, ...],
) -> implicit_steps.State:
    n, p, r = len(case.mesh.dx), drive.d_boundary.shape[1], len(terms.conversions)
    z = np.zeros
    state = implicit_steps.State(z(n), z(n), z((r, n)), z((p, n)), z((p, n)), z((r, p, n)), z(1))
    initial, panel = case.press.initial, case.layout.panel
    shift = values.get("initial_K", 0.0)
    if initial.kind == "steady":
        _rest(case, stack, d_stack, drive, _boundary_shift(terms, values), shift, names, state)
        state.t[~panel] += float(terms.plates_offset)
        for i, name in enumerate(names):
            if name in d_terms:
                state.s[i, ~panel] += float(d_terms[name].plates_offset)
    else:
        state.t[:] = shift + (initial.temperature_C or 0.0 if initial.kind == "uniform" else _first_profile(case))
        if "initial_K" in names:
            state.s[names.index("initial_K")] = 1.0
    state.t_before[:] = state.t
    state.s_before[:] = state.s
    return state


def _rest(
    case: Case,
    stack: implicit_steps.Stack,
    d_stack: implicit_steps.Tangents,
    drive: implicit_steps.Drive,
    boundary_shift: tuple[float, float],
    panel_shift: float,
    names: tuple[str, ...],
    state: implicit_steps.State,
) -> None:
    """Plates steady at the first row's outside temperatures, the panel at its initial temperature."""
    p, n = state.s.shape
    held = case.layout.panel
    held_t, d_held = np.zeros(n), np.zeros((p, n))
    if case.panel is not None:
        held_t[held] = case.panel.initial_temperature + panel_shift
        if "initial_K" in names:
            d_held[names.index("initial_K"), held] = 1.0
    weight, outside = np.zeros((1, 3)), np.zeros((1, 2, 2))
    weight[0, 0 if case.panel is not None else (1 if case.press.has_states else 2)] = 1.0
    for end in range(2):
        outside[0, end, 0] = case.first_boundary[end] + boundary_shift[end]
    one, contacts = case.unchanged[:1], drive.factor.shape[1]
    still = implicit_steps.Drive(
        np.ones(1), weight, np.zeros((1, 3, p)), one, np.zeros((1, contacts, p)), outside, drive.d_boundary
    )
    cell = implicit_steps.rest(stack, d_stack, still, implicit_steps.Held(held, held_t, d_held), state)
    if cell >= 0:
        _refuse_start(case, cell)


def _refuse_start(case: Case, cell: int) -> None:
    """Say why there is no steady start: the cell is tied to nothing, or, beyond the last, nothing settles."""
    why = say("start-not-steady-steep")
    if cell < len(case.mesh.dx):
        layer = next(name for name in case.mesh.layer if cell in range(*case.mesh.cells(name).indices(cell + 1)))
        why = say("start-not-steady-untied", layer=layer)
        if case.panel is not None:
            why = say("start-not-steady-untied-without-panel", layer=layer)
    raise NoSteadyState(say("start-not-steady", run=case.run.source or case.run.name, why=why))


def _first_profile(case: Case) -> Array:
    """Temperatures through the stack interpolated in the first readings of sensors and boundaries."""
    x = np.cumsum(case.mesh.dx) - case.mesh.dx / 2
    heights = {column: float(case.places[case.place_of[column]] @ x) for column in case.columns}
    ends = zip((0.0, float(case.mesh.dx.sum())), case.first_boundary, case.layout.measured, strict=True)
    return initial_profile(case.run, case.mesh, heights, {x: t for x, t, measured in ends if measured})


def read_places(case: Case, build: Build) -> Array:
    """Return the weights that read off the places, and the press faces opposite them where they mix in."""
    faces = build.terms.footprint != 0 or any(t.footprint != 0 for t in build.d_terms.values())
    return np.concatenate([case.places, case.press_face]) if faces else case.places


def observe(
    case: Case,
    build: Build,
    values: Mapping[str, float],
    out: Array,
    d_out: Array,
    m: int,
    kept: Array,
    closed_share: Array,
) -> Solution:
    """Apply the measuring chain and read off the rows."""
    names, terms, d_terms = build.names, build.terms, build.d_terms
    true, d_true = out[:, :m], d_out[:, :, :m]
    rows = case.reader(true)
    d_rows = case.reader(d_true) if names else np.empty((0, *rows.shape))
    true_rows, d_core = rows, d_rows[:, :, m - 1]
    d_lag = np.array([float(d_terms[name].lag) if name in d_terms else 0.0 for name in names])
    lag, clock = float(terms.lag), float(terms.clock)
    late = lag != 0.0 or bool(d_lag.any())
    y, dy = true, d_true
    if out.shape[1] > m:
        y, dy = _mix_footprint(case, build, values, out, d_out, m)
    if late:
        y, dy = y.copy(), dy.copy()
        implicit_steps.delay(case.h, y, dy, max(lag, 1e-3), d_lag)
    read = case.reader if clock == 0.0 else Reader.at(case.edges, case.run.time_s - clock)
    if clock != 0.0 or y is not true:
        rows, d_rows = read(y), read(dy)
    for i, name in enumerate(names):
        if name in d_terms and d_terms[name].clock:
            slope = case.slope_reader
            if clock != 0.0:
                slope = Reader.at(case.edges, case.run.time_s - clock, slope=True)
            d_rows = d_rows.copy() if d_core.base is d_rows else d_rows
            d_rows[i] -= float(d_terms[name].clock) * slope(y)
    columns = tuple(case.place_of[c] for c in case.columns)
    return Solution(
        columns=case.columns,
        sensors=rows[:, columns],
        core=true_rows[:, m - 1],
        places=true_rows,
        d_sensors=Derivatives(names, d_rows, columns),
        d_core={name: d_core[i] for i, name in enumerate(names)},
        closed_share=closed_share,
        fields=kept,
        final=build.start,
    )


def _mix_footprint(
    case: Case, build: Build, values: Mapping[str, float], out: Array, d_out: Array, m: int
) -> tuple[Array, Array]:
    """Mix the opposite press face into the panel's surface sensors while closed."""
    y, dy = out[:, :m].copy(), d_out[:, :, :m].copy()
    w = float(build.terms.footprint)
    shares, d_shares = case.edge_clock.shares(values, build.names)
    closed, d_closed = shares[:, 2], d_shares[:, 2]
    for place in np.flatnonzero(case.press_face.any(axis=1)):
        gap = out[:, m + place] - y[:, place]
        d_gap = d_out[:, :, m + place] - dy[:, :, place]
        y[:, place] += w * closed * gap
        dy[:, :, place] += w * closed * d_gap + w * gap * d_closed.T
        for i, name in enumerate(build.names):
            if name in build.d_terms:
                dy[i, :, place] += float(build.d_terms[name].footprint) * closed * gap
    return y, dy


def state_weights(
    case: Case, times: Array, values: Mapping[str, float], names: tuple[str, ...] = ()
) -> tuple[Array, Array]:
    """Return the shares of idle, open and closed at times (rows, 3), and their derivatives (rows, 3, P)."""
    clock = Clock.of(case.moments, times, float(case.run.time_s[0]), mean=False, has_states=case.press.has_states)
    return clock.shares(values, names)


def states(case: Case) -> list[PressState]:
    """Return the press state at each row: a moment's own row already has the new state."""
    if not case.press.has_states:
        return [PressState.CLOSED] * len(case.run.time_s)
    moments, t = case.moments, case.run.time_s + 1e-9
    gone = t >= moments.removed_s
    closed = (t >= moments.closed_s) & ~(t >= moments.opened_s) & ~gone
    idle = gone | ((t < moments.inserted_s) & ~closed)
    return [_STATES[0 if away else 2 if shut else 1] for away, shut in zip(idle, closed, strict=True)]
