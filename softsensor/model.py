"""The thermal model: a press, effects, and one run in; temperatures and their sensitivities out.

    rho c dT/dt = d/dx (k dT/dx) + q

The paper this follows prints the equation with a sign slip and without rho c; this is the form used.
Units: K, s, W, m; temperatures in °C. Parameters are named: coefficients as in the press file
(``h_pp_c``), effect parameters ``edge_loss.W_m3K``, and these nuisances of a run:

========================  ==========================================================
``closed_s, opened_s``    middle of the closing and opening ramp, shift from the case [s]
``ramp_s``                length of the closing ramp, shift from the case [s]
``initial_K``             shift of the panel's initial temperature [K]
``boundary_bottom_K``     shift of the measured bottom boundary [K]
``boundary_top_K``        shift of the measured top boundary [K]
========================  ==========================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.pressfile import Press
from daq.records import Array, InputError, Moments, PressState, Run
from softsensor import kernels
from softsensor.case import (
    HANDLING_RAMP_S,
    OPENING_RAMP_S,
    PAPER,
    PAPER_WIDTH,
    Case,
    layer_constants,
    mask_cells,
    prepare_case,
)
from softsensor.effects import Effect, Scene, Terms, find_effect

NUISANCES = ("closed_s", "opened_s", "ramp_s", "initial_K", "boundary_bottom_K", "boundary_top_K")
"""Per-run parameters every model has; 0 where nothing is known better."""
_PERFECT = 1e9
_TINY = 1e-30
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
    final: kernels.State

    def column(self, name: str) -> Array:
        """Return one channel (rows). [°C]"""
        return np.asarray(self.sensors[:, self.columns.index(name)])


@dataclass(frozen=True)
class Build:
    """The arrays of one solve, ready for the kernels."""

    stack: kernels.Stack
    tangents: kernels.Tangents
    drive: kernels.Drive
    start: kernels.State
    terms: Terms
    d_terms: Mapping[str, Terms]
    nonlinear: bool
    names: tuple[str, ...]


@dataclass(frozen=True)
class ThermalModel:
    """A press and the effects its model takes into account.

    Examples
    --------
    >>> from softsensor.effects import find_effect
    >>> from daq.pressfile import parse_press
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

    def prepare(self, run: Run, moments: Moments, *, fineness: float = 1.0, max_step_s: float = 0.5) -> Case:
        """Lay out a run for solving; `fineness` 2 halves cells and steps. Raises InputError."""
        paper = any(e.layers for e in self.effects)
        return prepare_case(self.press, run, moments, paper=paper, fineness=fineness, max_step_s=max_step_s)

    def build(self, case: Case, values: Mapping[str, float], tangents: tuple[str, ...] = ()) -> Build:
        """Assemble the arrays the kernels work on. Raises InputError for a missing coefficient."""
        missing = [n for n in case.press.coefficient_names if n not in values]
        if missing:
            raise InputError(f"coefficient {missing[0]} is missing; give all of {case.press.coefficient_names}")
        terms = self._terms(case, values)
        d_terms = {name: self._terms(case, values, name) for name in tangents if "." in name or name == "closed_s"}
        stack, d_stack = _stack(case, terms, d_terms, values, tangents)
        drive = _drive(case, terms, d_terms, values, tangents)
        nonlinear = (
            any(e.nonlinear for e in self.effects)
            or bool((stack.k_table >= 0).any() or (stack.c_table >= 0).any())
            or bool((stack.flux[:, 1] > 0).any())
        )
        start = _start(case, stack, d_stack, drive, terms, d_terms, values, tangents)
        return Build(stack, d_stack, drive, start, terms, d_terms, nonlinear, tangents)

    def solve(
        self,
        case: Case,
        values: Mapping[str, float],
        tangents: Iterable[str] = (),
        *,
        fields: bool = False,
    ) -> Solution:
        """Run the model over a case.

        Parameters
        ----------
        values
            Every coefficient of the press; effect parameters left out are neutral, nuisances 0.
        tangents
            Parameters to differentiate by.
        fields
            Keep all cell temperatures at every step.
        """
        names = tuple(tangents)
        build = self.build(case, values, names)
        steps, m, p = len(build.drive.h), len(case.places), len(names)
        n = len(case.mesh.dx)
        faces = build.terms.footprint != 0 or any(t.footprint != 0 for t in build.d_terms.values())
        places = np.concatenate([case.places, case.press_face]) if faces else case.places
        out = np.empty((steps + 1, len(places)))
        d_out = np.empty((steps + 1, len(places), p))
        kept = np.empty((steps + 1 if fields else 0, n))
        kernels.march(
            build.stack, build.tangents, build.drive, build.start, places, build.nonlinear, out, d_out, kept
        )
        return self._observe(case, build, values, out, d_out, kept, m)

    def _observe(
        self,
        case: Case,
        build: Build,
        values: Mapping[str, float],
        out: Array,
        d_out: Array,
        kept: Array,
        m: int,
    ) -> Solution:
        """Apply the measuring chain and read off the rows."""
        names = build.names
        weights, _ = state_weights(case, case.run.time_s, values)
        read = _Reader.at(case.edges, case.run.time_s)
        true = read(out[:, :m])
        core = true[:, m - 1]
        d_core = read(d_out[:, m - 1])
        y, dy = out[:, :m].copy(), d_out[:, :m].copy()
        _mix_footprint(case, build, values, y, dy, out, d_out)
        lag = float(build.terms.lag)
        d_lag = np.array([float(build.d_terms[n].lag) if n in build.d_terms else 0.0 for n in names])
        if lag != 0.0 or d_lag.any():
            kernels.delay(build.drive.h, y, dy, max(lag, 1e-3), d_lag)
        clock = float(build.terms.clock)
        at = case.run.time_s - clock
        if clock != 0.0:
            read = _Reader.at(case.edges, at)
        rows, d_rows = read(y), read(dy)
        columns = [case.place_of[c] for c in case.columns]
        d_sensors = {}
        for i, name in enumerate(names):
            d = d_rows[:, columns, i]
            shift = float(build.d_terms[name].clock) if name in build.d_terms else 0.0
            if shift:
                step = 0.02
                later, earlier = (_Reader.at(case.edges, at + k * step)(y) for k in (1, -1))
                slope = (later - earlier) / (2 * step)
                d = d - shift * slope[:, columns]
            d_sensors[name] = d
        return Solution(
            columns=case.columns,
            sensors=rows[:, columns],
            core=core,
            places=true,
            d_sensors=d_sensors,
            d_core={name: d_core[:, i] for i, name in enumerate(names)},
            closed_share=weights[:, 2],
            fields=kept,
            final=build.start,
        )

    def _terms(self, case: Case, values: Mapping[str, float], by: str | None = None) -> Terms:
        """Merge the effects' terms; with `by`, their derivative by that parameter."""
        closed: complex = case.moments.closed_s + values.get("closed_s", 0.0)
        if by == "closed_s":
            closed += 1j * _TINY
        scene = _scene(case, closed)
        merged = Terms()
        for effect in self.effects:
            own: dict[str, Any] = {
                p.name: complex(values.get(effect.key(p.name), p.neutral)) for p in effect.parameters
            }
            for p in effect.parameters:
                if effect.key(p.name) == by:
                    own[p.name] += 1j * _TINY
            merged = _merge(merged, effect.terms(scene, own))
        return _part(merged, imaginary=by is not None)


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
        return np.imag(x) / _TINY if imaginary else np.real(x)

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
            replace(c, heat=take(c.heat), a=take(c.a), b=take(c.b), c=take(c.c)) for c in terms.conversions
        ),
        paper=None if terms.paper is None else (take(terms.paper[0]), take(terms.paper[1])),
        plates_offset=take(terms.plates_offset),
        boundary_offset=(take(terms.boundary_offset[0]), take(terms.boundary_offset[1])),
        lag=take(terms.lag),
        footprint=take(terms.footprint),
        clock=take(terms.clock),
    )


def _scene(case: Case, closed_s: complex) -> Scene:
    mesh, press = case.mesh, case.press
    panel_cells = mask_cells(mesh, press.panel_layers)
    paper = mask_cells(mesh, tuple(n for n in PAPER if n in mesh.layer))
    z = np.zeros(len(mesh.dx))
    faces = None
    if panel_cells.any():
        inside = np.flatnonzero(panel_cells)
        height = np.cumsum(mesh.dx[inside]) - mesh.dx[inside] / 2
        z[inside] = 2.0 * height / mesh.dx[inside].sum() - 1.0
        faces = (int(inside[0]), int(inside[-1]))
    touching = tuple(m for m, c in enumerate(press.contact) if set(c.between) & set(press.panel_layers))
    return Scene(
        dx=mesh.dx,
        panel_cells=panel_cells,
        plate_cells=~panel_cells & ~paper,
        z=z,
        face_cells=faces,
        panel=case.panel,
        panel_contacts=touching,
        contacts=len(press.contact),
        step_start=case.edges[:-1],
        step_end=case.edges[1:],
        closed_s=closed_s,
        load=case.load,
        ambient=case.ambient,
    )


def _interfaces(case: Case) -> list[int]:
    """Interface number of each contact of the press file; paper lies inside a panel's contact."""
    mesh, press = case.mesh, case.press
    chain = press.chain
    found = []
    for contact in press.contact:
        lower = contact.between[0]
        i = chain.index(lower)
        if lower == "boundary.bottom":
            found.append(0)
        elif chain[i + 1] == "boundary.top":
            found.append(len(mesh.dx))
        else:
            stop = mesh.cells(lower).stop
            papered = lower in press.panel_layers and PAPER[1] in mesh.layer
            found.append(stop + 1 if papered else stop)
    return found


def _stack(
    case: Case,
    terms: Terms,
    d_terms: Mapping[str, Terms],
    values: Mapping[str, float],
    names: tuple[str, ...],
) -> tuple[kernels.Stack, kernels.Tangents]:
    mesh, press = case.mesh, case.press
    n, p = len(mesh.dx), len(names)
    k0, c0 = np.zeros(n), np.zeros(n)
    k_table, c_table = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    tables: list[tuple[tuple[float, float], ...]] = []
    for layer in press.layer:
        cells = mesh.cells(layer.name)
        _, k0[cells], c0[cells] = layer_constants(layer, case.panel)
        if isinstance(layer.conductivity_W_mK, tuple):
            k0[cells] = 1.0
            k_table[cells] = len(tables)
            tables.append(layer.conductivity_W_mK)
        if isinstance(layer.heat_capacity_J_kgK, tuple):
            c0[cells] = layer.density_kg_m3 or 0.0
            c_table[cells] = len(tables)
            tables.append(layer.heat_capacity_J_kgK)
    paper = mask_cells(mesh, tuple(name for name in PAPER if name in mesh.layer))
    if paper.any() and terms.paper is not None:
        k0[paper] = PAPER_WIDTH / terms.paper[0]
        c0[paper] = terms.paper[1] / PAPER_WIDTH
    d = _zeros_tangents(n, p, len(terms.conversions))
    contact, d_contact, interface, parts = _contact_table(case, values, names)
    for i, name in enumerate(names):
        if name not in d_terms:
            continue
        t = d_terms[name]
        d.k[:, i] = k0 * t.conductivity
        d.c[:, i] = c0 * t.capacity
        d.k_slope[:, i] = t.conductivity_slope
        d.c_slope[:, i] = t.capacity_slope
        d.exchange[:, i] = t.exchange
        d.emissivity[i] = t.emissivity
        d.convection[i] = t.convection
        if paper.any() and t.paper is not None and terms.paper is not None:
            d.k[paper, i] = -PAPER_WIDTH / terms.paper[0] ** 2 * t.paper[0]
            d.c[paper, i] = t.paper[1] / PAPER_WIDTH
        for r, conversion in enumerate(t.conversions):
            d.heat[r, :, i] = conversion.heat
            d.law[r, 1, i], d.law[r, 2, i], d.law[r, 3, i] = conversion.a, conversion.b, conversion.c
    rows = max([len(t) for t in tables], default=1)
    table_x, table_y = np.zeros((len(tables), rows)), np.zeros((len(tables), rows))
    for i, table in enumerate(tables):
        xs, ys = np.array(table, dtype=float).T
        table_x[i] = np.concatenate([xs, xs[-1] + np.arange(1, rows - len(xs) + 1)])
        table_y[i] = np.concatenate([ys, np.full(rows - len(ys), ys[-1])])
    full = np.zeros(n)
    stack = kernels.Stack(
        dx=mesh.dx,
        k=k0 * terms.conductivity,
        k_slope=full + terms.conductivity_slope,
        k_table=k_table,
        c=c0 * terms.capacity,
        c_slope=full + terms.capacity_slope,
        c_table=c_table,
        table_x=table_x,
        table_y=table_y,
        exchange=full + terms.exchange,
        interface=interface,
        contact=contact,
        parts=parts,
        emissivity=float(terms.emissivity),
        convection=float(terms.convection),
        wet=mask_cells(mesh, press.panel_layers),
        ambient=case.ambient,
        measured=np.array([b.kind == "measured" for b in (press.boundary.bottom, press.boundary.top)]),
        flux=_flux_table(case),
        heat=np.array([c.heat for c in terms.conversions]).reshape(-1, n).astype(float),
        law=np.array([[c.kind, c.a, c.b, c.c] for c in terms.conversions]).reshape(-1, 4).astype(float),
    )
    return stack, d._replace(contact=d_contact)


def _zeros_tangents(n: int, p: int, r: int) -> kernels.Tangents:
    z = np.zeros
    return kernels.Tangents(
        z((n, p)), z((n, p)), z((n, p)), z((n, p)), z((n, p)), z((0, 3, 3, p)), z(p), z(p), z((2, p)),
        z((r, n, p)), z((r, 4, p)),
    )  # fmt: skip


def _contact_table(
    case: Case, values: Mapping[str, float], names: tuple[str, ...]
) -> tuple[Array, Array, np.ndarray[Any, np.dtype[np.int64]], np.ndarray[Any, np.dtype[np.bool_]]]:
    """Coupling and losses of each contact in each state, with tangents; free ends come last."""
    press = case.press
    spots: list[tuple[int, int, int, str]] = []
    interfaces = _interfaces(case)
    parts = [isinstance(c.open, tuple) for c in press.contact]
    panel = set(press.panel_layers)
    away = next((c.open[1] for c in press.contact if isinstance(c.open, tuple)), None)
    for m, contact in enumerate(press.contact):
        spots.append((m, 2, 0, contact.closed))
        if contact.open is None:
            spots.append((m, 1, 0, contact.closed))
        elif isinstance(contact.open, str):
            spots.append((m, 1, 0, contact.open))
        else:
            spots += [(m, 1, 1, contact.open[0]), (m, 1, 2, contact.open[1])]
        if panel & set(contact.between):
            plate_side = 2 if contact.between[0] in panel else 1
            if away is not None and not contact.between[3 - plate_side - 1].startswith("boundary"):
                spots.append((m, 0, plate_side, away))
        else:
            spots.append((m, 0, 0, contact.open if isinstance(contact.open, str) else contact.closed))
    ends = {0, len(case.mesh.dx)}
    for j, boundary in zip(sorted(ends), (press.boundary.bottom, press.boundary.top), strict=True):
        if j not in interfaces and boundary.kind != "measured":
            m = len(interfaces)
            interfaces.append(j)
            parts.append(False)
            if boundary.coefficient is not None:
                spots += [(m, s, 0, boundary.coefficient) for s in range(3)]
    table = np.zeros((len(interfaces), 3, 3))
    d_table = np.zeros((len(interfaces), 3, 3, len(names)))
    for m, state, kind, name in spots:
        table[m, state, kind] = values[name]
        if name in names:
            d_table[m, state, kind, names.index(name)] = 1.0
    return table, d_table, np.array(interfaces, dtype=np.int64), np.array(parts, dtype=bool)


def _flux_table(case: Case) -> Array:
    rows = []
    for boundary in (case.press.boundary.bottom, case.press.boundary.top):
        surroundings = case.ambient if boundary.ambient_C is None else boundary.ambient_C
        if boundary.kind == "flux":
            rows.append((boundary.absorptivity * boundary.incident_W_m2, boundary.emissivity, surroundings))
        else:
            rows.append((0.0, 0.0, surroundings))
    return np.array(rows)


def state_weights(
    case: Case, edges: Array, values: Mapping[str, float], names: tuple[str, ...] = (), *, mean: bool = False
) -> tuple[Array, Array]:
    """Return the shares of idle, open and closed at times, or (`mean`) averaged between them.

    Returns arrays (rows, 3) and, by parameter, (rows, 3, P).
    """
    moments = case.moments
    ramp = max(moments.ramp_s + values.get("ramp_s", 0.0), 0.02)
    closing = moments.closed_s + values.get("closed_s", 0.0)
    opening = moments.opened_s + values.get("opened_s", 0.0)
    if not case.press.has_states:
        rows = len(edges) - 1 if mean else len(edges)
        return np.tile([0.0, 0.0, 1.0], (rows, 1)), np.zeros((rows, 3, len(names)))
    inside = np.isfinite(moments.inserted_s) and moments.inserted_s > case.run.time_s[0]
    present, _, _ = _ramp(edges, moments.inserted_s if inside else -np.inf, HANDLING_RAMP_S, mean=mean)
    if np.isfinite(moments.removed_s):
        present = present - _ramp(edges, moments.removed_s, HANDLING_RAMP_S, mean=mean)[0]
    up, d_up, d_ramp = _ramp(edges, closing, ramp, mean=mean)
    down, d_down, _ = _ramp(edges, opening, OPENING_RAMP_S, mean=mean)
    closed = up - down
    weights = np.stack([1.0 - present, present - closed, closed], axis=1)
    d_weights = np.zeros((len(weights), 3, len(names)))
    for name, change in (("closed_s", d_up), ("opened_s", -d_down), ("ramp_s", d_ramp)):
        if name in names:
            d_weights[:, 2, names.index(name)] = change
            d_weights[:, 1, names.index(name)] = -change
    return np.clip(weights, 0.0, 1.0), d_weights


def _ramp(edges: Array, middle: float, length: float, *, mean: bool) -> tuple[Array, Array, Array]:
    """A rise from 0 to 1 about `middle`, its derivatives by middle and by length; means if asked."""
    if np.isnan(middle):
        zero = np.zeros(len(edges) - 1 if mean else len(edges))
        return zero, zero, zero
    if np.isinf(middle):
        one = np.ones(len(edges) - 1 if mean else len(edges))
        return one, 0 * one, 0 * one
    x = np.clip((edges - middle) / length + 0.5, 0.0, 1.0)
    inner = (x > 0) & (x < 1)
    if not mean:
        return x, np.where(inner, -1.0 / length, 0.0), np.where(inner, -(x - 0.5) / length, 0.0)
    area = np.where(x >= 1, edges - middle, length * x * x / 2)
    d_length = np.where(inner, x * (1 - x) / 2, 0.0)
    h = np.diff(edges)
    return np.diff(area) / h, -np.diff(x) / h, np.diff(d_length) / h


def _drive(
    case: Case, terms: Terms, d_terms: Mapping[str, Terms], values: Mapping[str, float], names: tuple[str, ...]
) -> kernels.Drive:
    steps, p = len(case.edges) - 1, len(names)
    weight, d_weight = state_weights(case, case.edges, values, names, mean=True)
    contacts = len(case.press.contact) + 2
    factor, d_factor = np.ones((steps, contacts)), np.zeros((steps, contacts, p))
    for m, f in terms.closed_contact.items():
        factor[:, m] = f
    for i, name in enumerate(names):
        if name in d_terms:
            for m, f in d_terms[name].closed_contact.items():
                d_factor[:, m, i] = f
    offset = np.array(terms.boundary_offset, dtype=float)
    offset += [values.get("boundary_bottom_K", 0.0), values.get("boundary_top_K", 0.0)]
    boundary = case.boundary.copy()
    boundary[:, :, 0] += offset
    d_boundary = np.zeros((2, p))
    for i, name in enumerate(names):
        if name in d_terms:
            d_boundary[:, i] = d_terms[name].boundary_offset
        elif name in ("boundary_bottom_K", "boundary_top_K"):
            d_boundary[0 if "bottom" in name else 1, i] = 1.0
    measured = [b.kind == "measured" for b in (case.press.boundary.bottom, case.press.boundary.top)]
    d_boundary[~np.array(measured)] = 0.0
    return kernels.Drive(
        _snap(np.diff(case.edges)), weight, d_weight, factor, d_factor, np.ascontiguousarray(boundary), d_boundary
    )


def _snap(h: Array) -> Array:
    """Make steps that differ only by rounding equal, so that the kernel can keep its factors."""
    same = np.abs(np.diff(h)) < 1e-9 * h[1:]
    group = np.concatenate([[0], np.cumsum(~same)])
    first = np.concatenate([[0], np.flatnonzero(~same) + 1])
    return np.asarray(h[first][group])


def _start(
    case: Case,
    stack: kernels.Stack,
    d_stack: kernels.Tangents,
    drive: kernels.Drive,
    terms: Terms,
    d_terms: Mapping[str, Terms],
    values: Mapping[str, float],
    names: tuple[str, ...],
) -> kernels.State:
    n, p = len(case.mesh.dx), len(names)
    r = len(terms.conversions)
    zeros = np.zeros
    state = kernels.State(
        zeros(n), zeros(n), zeros((r, n)), zeros((n, p)), zeros((n, p)), zeros((r, n, p)), zeros(1)
    )
    initial = case.press.initial
    if initial.kind == "steady":
        _rest_state(case, stack, d_stack, drive, terms, d_terms, values, names, state)
    elif initial.kind == "uniform":
        state.t[:] = initial.temperature_C or 0.0
    else:
        state.t[:] = _sensor_profile(case)
    if initial.kind != "steady" and "initial_K" in names:
        state.s[:, names.index("initial_K")] = 1.0
    if initial.kind != "steady":
        state.t[:] += values.get("initial_K", 0.0)
    state.t_before[:] = state.t
    state.s_before[:] = state.s
    return state


def _rest_state(
    case: Case,
    stack: kernels.Stack,
    d_stack: kernels.Tangents,
    drive: kernels.Drive,
    terms: Terms,
    d_terms: Mapping[str, Terms],
    values: Mapping[str, float],
    names: tuple[str, ...],
    state: kernels.State,
) -> None:
    """Plates steady at the first row's outside temperatures, the panel at its initial temperature."""
    n, p = len(case.mesh.dx), len(names)
    paper = tuple(name for name in PAPER if name in case.mesh.layer)
    held = mask_cells(case.mesh, case.press.panel_layers + paper)
    held_t, d_held = np.zeros(n), np.zeros((n, p))
    if case.panel is not None:
        held_t[held] = case.panel.initial_temperature + values.get("initial_K", 0.0)
        if "initial_K" in names:
            d_held[held, names.index("initial_K")] = 1.0
    weight = np.zeros((1, 3))
    weight[0, 0 if held.any() else (1 if case.press.has_states else 2)] = 1.0
    first = np.array(case.first_boundary) + np.array(terms.boundary_offset, dtype=float)
    first += [values.get("boundary_bottom_K", 0.0), values.get("boundary_top_K", 0.0)]
    outside = np.zeros((1, 2, 2))
    outside[0, :, 0] = first
    still = drive._replace(
        h=np.ones(1),
        weight=weight,
        d_weight=np.zeros((1, 3, p)),
        factor=np.ones((1, drive.factor.shape[1])),
        d_factor=np.zeros((1, drive.factor.shape[1], p)),
        boundary=outside,
    )
    kernels.rest(stack, d_stack, still, held, held_t, d_held, state)
    state.t[~held] += float(terms.plates_offset)
    for i, name in enumerate(names):
        if name in d_terms:
            state.s[~held, i] += float(d_terms[name].plates_offset)


def _sensor_profile(case: Case) -> Array:
    """Temperatures through the stack interpolated in the first readings of sensors and boundaries."""
    x = np.cumsum(case.mesh.dx) - case.mesh.dx / 2
    points: dict[float, list[float]] = {}
    for column in case.columns:
        values = case.run.columns[column]
        good = values[np.isfinite(values)]
        if len(good):
            height = float(case.places[case.place_of[column]] @ x)
            points.setdefault(height, []).append(float(good[0]))
    ends = (case.press.boundary.bottom, case.press.boundary.top)
    for height, boundary, first in zip((0.0, float(case.mesh.dx.sum())), ends, case.first_boundary, strict=True):
        if boundary.kind == "measured":
            points.setdefault(height, []).append(first)
    if not points:
        raise InputError(
            f'{case.run.source or case.run.name}: [initial] kind = "sensors" needs a reading; '
            "all panel columns are empty"
        )
    heights = sorted(points)
    return np.interp(x, heights, [float(np.mean(points[h])) for h in heights])


def _mix_footprint(
    case: Case, build: Build, values: Mapping[str, float], y: Array, dy: Array, out: Array, d_out: Array
) -> None:
    """Mix the opposite press face into the panel's surface sensors while closed."""
    m = y.shape[1]
    if out.shape[1] == m:
        return
    w = float(build.terms.footprint)
    weights, d_weights = state_weights(case, case.edges, values, build.names)
    closed = weights[:, 2]
    for place in range(m):
        if not case.press_face[place].any():
            continue
        gap = out[:, m + place] - y[:, place]
        d_gap = d_out[:, m + place] - dy[:, place]
        y[:, place] += w * closed * gap
        dy[:, place] += (w * closed)[:, None] * d_gap + (w * gap)[:, None] * d_weights[:, 2]
        for i, name in enumerate(build.names):
            if name in build.d_terms:
                dy[:, place, i] += float(build.d_terms[name].footprint) * closed * gap


@dataclass(frozen=True)
class _Reader:
    """Reads series given at step edges off at other times: straight in fine steps, cubic in coarse ones."""

    first: Any
    weights: Array

    @staticmethod
    def at(edges: Array, times: Array) -> _Reader:
        times = np.clip(times, edges[0], edges[-1])
        last = len(edges) - 1
        i = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, last - 1)
        first = np.clip(i - 1, 0, max(last - 3, 0))
        weights = np.zeros((len(times), 4))
        rows = np.arange(len(times))
        h = edges[i + 1] - edges[i]
        u = (times - edges[i]) / h
        coarse = (h > 0.06) & (i > 0) & (i < last - 1)
        straight = ~coarse
        weights[rows[straight], (i - first)[straight]] = 1.0 - u[straight]
        weights[rows[straight], (i - first + 1)[straight]] = u[straight]
        x = times[coarse]
        nodes = [edges[i[coarse] + k] for k in (-1, 0, 1, 2)]
        for a in range(4):
            weight = np.ones(len(x))
            for b in range(4):
                if a != b:
                    weight *= (x - nodes[b]) / (nodes[a] - nodes[b])
            weights[coarse, a] = weight
        return _Reader(first, weights)

    def __call__(self, y: Array) -> Array:
        """Return the rows of `y` (steps + 1, ...) read off (rows, ...)."""
        flat = np.ascontiguousarray(y).reshape(len(y), -1)
        out = np.empty((len(self.first), flat.shape[1]))
        kernels.gather(self.first, self.weights, flat, out)
        return out.reshape(len(self.first), *y.shape[1:])


def states(case: Case, solution: Solution) -> list[PressState]:
    """Return the press state at each row."""
    weights, _ = state_weights(case, case.run.time_s, {})
    return [_STATES[i] for i in np.argmax(weights, axis=1)]
