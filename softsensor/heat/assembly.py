"""Parameter values in, arrays for the compiled steps out.

What does not depend on values is worked out once in a `Layout`, so that a fit can solve the same case
thousands of times.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.press.press_file import BoundaryKind, Contact, Press
from daq.printed import on_screen
from daq.records import Array, InputError, Panel
from daq.words import say
from softsensor.effects.effect import BENDS_C, Terms
from softsensor.heat import implicit_steps
from softsensor.heat.mesh import Mesh

PAPER = ("paper_bottom", "paper_top")
PAPER_WIDTH = 1e-4
"""Nominal width of a paper cell; resistance and capacity follow from the effect. [m] By hand."""

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Layout:
    """The parts of a stack that no parameter changes."""

    k: Array
    """Nominal conductivity, or 1 where a table rules (n). [W/mK]"""
    c: Array
    """Nominal heat capacity, or the density where a table rules (n). [J/m³K | kg/m³]"""
    k_table: implicit_steps.Integers
    c_table: implicit_steps.Integers
    table_x: Array
    table_y: Array
    paper: Flags
    panel: Flags
    """Cells of the panel and of its papers (n)."""
    wet: Flags
    """Cells of the panel proper (n)."""
    interface: implicit_steps.Integers
    parts: Flags
    bare: Flags
    spots: tuple[Spot, ...]
    measured: Flags
    flux: Array
    radiates: bool
    """Whether an end radiates."""
    zeros: Array
    """(n), not to be changed."""
    no_heat: Array
    """Of no conversion (0, n)."""
    no_law: Array
    """(0, 5)"""
    unmoved: implicit_steps.Tangents
    """Of a stack without conversions by no parameter."""

    __repr__ = on_screen

    @staticmethod
    def of(press: Press, mesh: Mesh, panel: Panel | None, ambient: float) -> Layout:
        """Lay out a press and its panel on a mesh; `ambient` is the room's temperature. [°C]"""
        n = len(mesh.dx)
        k, c, k_table, c_table, tables = _constants(press, mesh, panel)
        rows = max([len(t) for t in tables], default=1)
        table_x, table_y = np.zeros((len(tables), rows)), np.zeros((len(tables), rows))
        for i, table in enumerate(tables):
            xs, ys = np.array(table, dtype=float).T
            table_x[i] = np.concatenate([xs, xs[-1] + np.arange(1, rows - len(xs) + 1)])
            table_y[i] = np.concatenate([ys, np.full(rows - len(ys), ys[-1])])
        paper = mask_cells(mesh, tuple(name for name in PAPER if name in mesh.layer))
        wet = mask_cells(mesh, press.panel_layers)
        interface, parts, spots = _contacts(press, mesh)
        flux = _flux_table(press, ambient)
        return Layout(
            k=k,
            c=c,
            k_table=k_table,
            c_table=c_table,
            table_x=table_x,
            table_y=table_y,
            paper=paper,
            panel=wet | paper,
            wet=wet,
            interface=np.array(interface, dtype=np.int64),
            parts=np.array(parts, dtype=bool),
            bare=np.arange(len(interface)) >= len(press.contact),
            spots=tuple(spots),
            measured=np.array(
                [b.kind is BoundaryKind.MEASURED for b in (press.boundary.bottom, press.boundary.top)]
            ),
            flux=flux,
            radiates=bool((flux[:, 1] > 0).any()),
            zeros=np.zeros(n),
            no_heat=np.zeros((0, n)),
            no_law=np.zeros((0, 5)),
            unmoved=_tangents(n, len(interface), 0, 0),
        )

    def stack(self, mesh: Mesh, terms: Terms, values: Mapping[str, float], ambient: float) -> implicit_steps.Stack:
        """Return the stack at parameter values; `ambient` is the room's temperature. [°C]"""
        k, c = self.k, self.c
        if terms.paper is not None and self.paper.any():
            k, c = k.copy(), c.copy()
            k[self.paper] = PAPER_WIDTH / terms.paper[0]
            c[self.paper] = terms.paper[1] / PAPER_WIDTH
        contact = np.zeros((len(self.interface), 3, 3))
        for m, state, kind, name in self.spots:
            contact[m, state, kind] = values[name]
        heat, law = self.no_heat, self.no_law
        if terms.conversions:
            heat = np.array([x.heat for x in terms.conversions], dtype=float)
            law = np.array([[x.kind, x.a, x.b, x.c, x.own] for x in terms.conversions], dtype=float)
        return implicit_steps.Stack(
            dx=mesh.dx,
            k=k * terms.conductivity,
            k_slope=self._spread(terms.conductivity_slope),
            k_table=self.k_table,
            bends=_bends(terms),
            c=c * terms.capacity,
            c_slope=self._spread(terms.capacity_slope),
            c_table=self.c_table,
            table_x=self.table_x,
            table_y=self.table_y,
            exchange=self._spread(terms.exchange),
            source=_sources(terms, len(self.k)),
            interface=self.interface,
            contact=contact,
            parts=self.parts,
            bare=self.bare,
            emissivity=float(terms.emissivity),
            convection=float(terms.convection),
            wet=self.wet,
            ambient=ambient,
            measured=self.measured,
            flux=self.flux,
            heat=heat,
            law=law,
        )

    def _spread(self, value: Any) -> Array:
        """Return a value in every cell (n)."""
        return self.zeros if isinstance(value, float) and value == 0.0 else self.zeros + value

    def tangents(
        self, terms: Terms, d_terms: Mapping[str, Terms], names: tuple[str, ...], p: int
    ) -> implicit_steps.Tangents:
        """Return the derivatives of the stack by the named parameters, with room for `p`."""
        n, rows = len(self.k), len(BENDS_C) if bent(terms) else 0
        if not (names or terms.conversions or rows or terms.sources):
            return self.unmoved
        d = _tangents(n, len(self.interface), len(terms.conversions), p, rows, len(terms.sources))
        index = {name: i for i, name in enumerate(names)}
        for m, state, kind, name in self.spots:
            if name in index:
                d.contact[m, state, kind, index[name]] = 1.0
        for name, t in d_terms.items():
            i = index[name]
            d.k[i] = self.k * t.conductivity
            d.c[i] = self.c * t.capacity
            d.k_slope[i] = t.conductivity_slope
            d.c_slope[i] = t.capacity_slope
            if bent(t):
                d.bends[0, i], d.bends[1, i] = t.conductivity_bend, t.contact_bend
            d.exchange[i] = t.exchange
            d.source[:, i] = _sources(t, n)
            d.emissivity[i] = t.emissivity
            d.convection[i] = t.convection
            if t.paper is not None and terms.paper is not None:
                d.k[i, self.paper] = -PAPER_WIDTH / terms.paper[0] ** 2 * t.paper[0]
                d.c[i, self.paper] = t.paper[1] / PAPER_WIDTH
            for j, conversion in enumerate(t.conversions):
                d.heat[j, i] = conversion.heat
                d.law[j, 1:, i] = conversion.a, conversion.b, conversion.c, conversion.own
        return d


def bent(terms: Terms) -> bool:
    """Whether a free function of temperature is among the terms."""
    return bool(np.ndim(terms.conductivity_bend) or np.ndim(terms.contact_bend))


def _bends(terms: Terms) -> Array:
    """Return both free functions of temperature (2, 61), or none at all (2, 0)."""
    if not bent(terms):
        return np.zeros((2, 0))
    return np.stack([np.zeros(len(BENDS_C)) + x for x in (terms.conductivity_bend, terms.contact_bend)])


def _sources(terms: Terms, n: int) -> Array:
    """Return what the panel releases by itself (k, n)."""
    return np.array([np.zeros(n) + source.heat for source in terms.sources]).reshape(-1, n)


def _tangents(n: int, contacts: int, r: int, p: int, bends: int = 0, k: int = 0) -> implicit_steps.Tangents:
    """Return tangents of nothing yet, by `p` parameters."""
    z = np.zeros
    return implicit_steps.Tangents(
        z((p, n)), z((p, n)), z((p, n)), z((p, n)), z((p, n)), z((k, p, n)), z((contacts, 3, 3, p)), z(p), z(p),
        z((2, p)), z((r, p, n)), z((r, 5, p)), z((2, p, bends)),
    )  # fmt: skip


def layer_constants(press: Press, name: str, panel: Panel | None) -> tuple[float, float, float]:
    """Return a layer's thickness [m], conductivity [W/mK] and heat capacity [J/m³K] at 20 °C (first row)."""
    layer = next(x for x in press.layer if x.name == name)
    if layer.from_run:
        if panel is None:
            raise InputError(say("layer-from-run-without-panel", layer=name))
        return panel.thickness, panel.conductivity, panel.density * panel.heat_capacity

    def first(value: object) -> float:
        return float(value[0][1]) if isinstance(value, tuple) else float(value)  # type: ignore[arg-type]

    density, thickness = layer.density_kg_m3, layer.thickness_mm
    if density is None or thickness is None:
        raise InputError(say("layer-incomplete", layer=name))
    return thickness / 1000.0, first(layer.conductivity_W_mK), density * first(layer.heat_capacity_J_kgK)


def _constants(
    press: Press, mesh: Mesh, panel: Panel | None
) -> tuple[Array, Array, implicit_steps.Integers, implicit_steps.Integers, list[tuple[tuple[float, float], ...]]]:
    n = len(mesh.dx)
    k, c = np.ones(n), np.ones(n)
    k_table, c_table = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    tables: list[tuple[tuple[float, float], ...]] = []
    for layer in press.layer:
        cells = mesh.cells(layer.name)
        _, k[cells], c[cells] = layer_constants(press, layer.name, panel)
        conductivity, capacity, density = layer.conductivity_W_mK, layer.heat_capacity_J_kgK, layer.density_kg_m3
        if layer.from_run and panel is not None:
            conductivity, capacity = panel.conductivity_table, panel.heat_capacity_table
            density = panel.density
        if isinstance(conductivity, tuple) and conductivity:
            k[cells], k_table[cells] = 1.0, len(tables)
            tables.append(conductivity)
        if isinstance(capacity, tuple) and capacity:
            c[cells], c_table[cells] = density or 0.0, len(tables)
            tables.append(capacity)
    return k, c, k_table, c_table, tables


def _interfaces(press: Press, mesh: Mesh) -> list[int]:
    """Interface number of each contact of the press file; paper lies inside a panel's contact."""
    found = []
    for contact in press.contact:
        lower, upper = contact.between
        if lower == "boundary.bottom":
            found.append(0)
        elif upper == "boundary.top":
            found.append(len(mesh.dx))
        else:
            papered = lower in press.panel_layers and PAPER[1] in mesh.layer
            found.append(mesh.cells(lower).stop + (1 if papered else 0))
    return found


Spot = tuple[int, int, int, str]
"""Contact, state, kind (coupling, lower and upper face to air) and coefficient."""


def _contacts(press: Press, mesh: Mesh) -> tuple[list[int], list[bool], list[Spot]]:
    """Where each coefficient acts, in which state; ends without a contact come last.

    A contact with an insulated end passes nothing; one with air or a flux lies before the boundary's surface,
    whose own coefficient is that surface's to the air.
    """
    interfaces = _interfaces(press, mesh)
    parts = [isinstance(c.open, tuple) for c in press.contact]
    ends = {"boundary.bottom": press.boundary.bottom, "boundary.top": press.boundary.top}
    insulated = {name for name, end in ends.items() if end.kind is BoundaryKind.INSULATED}
    spots = [x for m, c in enumerate(press.contact) if not insulated & set(c.between) for x in _spots(press, m, c)]
    for j, side, boundary in ((0, 1, press.boundary.bottom), (len(mesh.dx), 2, press.boundary.top)):
        if boundary.kind is BoundaryKind.MEASURED:
            continue
        if j not in interfaces:
            interfaces.append(j)
            parts.append(False)
        if boundary.coefficient is not None and boundary.kind is not BoundaryKind.INSULATED:
            spots += [(interfaces.index(j), state, side, boundary.coefficient) for state in range(3)]
    return interfaces, parts, spots


def _spots(press: Press, m: int, contact: Contact) -> Iterator[Spot]:
    """Yield where the coefficients of a contact between two bodies act."""
    yield m, 2, 0, contact.closed
    if isinstance(contact.open, tuple):
        yield m, 1, 1, contact.open[0]
        yield m, 1, 2, contact.open[1]
    else:
        yield m, 1, 0, contact.open or contact.closed
    panel = set(press.panel_layers)
    if not panel & set(contact.between):
        yield m, 0, 0, contact.open if isinstance(contact.open, str) else contact.closed
        return
    away = next((c.open[1] for c in press.contact if isinstance(c.open, tuple)), None)
    plate_side = 2 if contact.between[0] in panel else 1
    if away is not None and not contact.between[plate_side - 1].startswith("boundary"):
        yield m, 0, plate_side, away


def _flux_table(press: Press, ambient: float) -> Array:
    rows = []
    for boundary in (press.boundary.bottom, press.boundary.top):
        surroundings = ambient if boundary.ambient_C is None else boundary.ambient_C
        absorbed = boundary.absorptivity * boundary.incident_W_m2 if boundary.kind is BoundaryKind.FLUX else 0.0
        radiates = boundary.kind in (BoundaryKind.FLUX, BoundaryKind.AIR)
        rows.append((absorbed, boundary.emissivity if radiates else 0.0, surroundings))
    return np.array(rows)


def mask_cells(mesh: Mesh, names: tuple[str, ...]) -> Flags:
    """Return which cells belong to the named layers."""
    mask = np.zeros(len(mesh.dx), dtype=bool)
    for name in names:
        mask[mesh.cells(name)] = True
    return mask
