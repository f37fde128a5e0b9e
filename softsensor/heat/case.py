"""One run made ready for the solver: mesh, step grid, outside temperatures, places of the sensors.

Everything that does not depend on coefficients or effect parameters is worked out here once, so that
a fit can solve the same case a hundred times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from numbers import Real

import numpy as np

from daq.press.header import panel_of
from daq.press.press_file import At, Press, press_for_run
from daq.printed import on_screen
from daq.records import (
    Array,
    InputError,
    Moments,
    OutsideLayer,
    Panel,
    Run,
)
from daq.words import say
from softsensor.effects.contact_load import REFERENCE_PRESSURE
from softsensor.effects.effect import Scene
from softsensor.heat.assembly import PAPER, PAPER_WIDTH, Layout, layer_constants
from softsensor.heat.mesh import Mesh, build_mesh
from softsensor.heat.readout import Reader
from softsensor.heat.run_checks import (
    boundary_series,
    check_ambient,
    check_load,
    check_times,
    load_series,
    setting_load,
)
from softsensor.heat.timing import OPENING_RAMP_S, Clock

FINE_STEP_S = 0.03
"""Step around a switch; half as long moves a face by 92 mK there, by 2 a second away, the core by 0.1. [s]

What these numbers do was measured (`tests.calibration.steps`: three sample runs, seed 2026, 2026-11-29)."""
GROWTH = 1.13
"""Of steps after it; with half the excess over 1 faces and core move by 4 and 0.5 mK."""
HANDLED_S, SWITCHED_S = 0.3, 0.4
"""Fine steps go so far to either side of insertion and removal, and of the ramps of closing and opening; twice as
far moves a face by 0.7 and 7 mK, the core by 0.1. [s]"""
LATER = 0.005
"""Where nothing outside changes, a step may be as long as this share of the time since the last switch: heat that
diffuses has grown as smooth by then. Beside steps of 0.1 s, on two slabs of pine of 50 min and a disc of 19, water
drying away in them, faces and core are 15 and 4 mK off (rms; 0.25 and 0.05 K at most), with twice as much 49 and
12, steps of 1.5 s throughout 22 and 27 with three times as many; without water 1 mK at most (2026-11-30)."""
LAST_STEP = 0.25
"""What is left before a switch is part of the step before it up to this share of it, so that no step is much
shorter than its neighbours; in the three runs none is, so twice and half of it move nothing."""
GRIDS = {
    "fineness": (0.05, 50.0),
    "max_step_s": (1e-4, 3600.0),
    "switch_step_s": (1e-4, 60.0),
    "growth": (1.0, 10.0),
}
"""Within these a grid may be asked for: beyond, a mistyped unit. By hand. [-, s, s, -]"""


@dataclass(frozen=True)
class Case:
    """A run, its press with the run's overrides, and the grids to solve it on."""

    run: Run
    press: Press
    panel: Panel | None
    mesh: Mesh
    moments: Moments
    edges: Array
    """Step edges (steps + 1). [s of the run]"""
    boundary: Array
    """Measured boundary temperature: mean and change in each step (steps, 2, 2). [°C, K]"""
    outside: Array
    """Measured boundary temperatures at the rows of the run as it was read (rows, 2). [°C]"""
    load: Mapping[int, Array]
    """Pressure over reference in each step, by contact."""
    columns: tuple[str, ...]
    """Panel channels in the run that sensors of role ``fit`` or ``validation`` name."""
    labels: tuple[str, ...]
    """Distinct places, named as in ``at``; the last is the core."""
    place_of: Mapping[str, int]
    """Place number of each column."""
    places: Array
    """Weights that read the places off the cells (m, n)."""
    press_face: Array
    """Weights that read the press face opposite each place, zero rows where there is none (m, n)."""
    layout: Layout
    """What no parameter changes."""

    __repr__ = on_screen

    @cached_property
    def fitted_places(self) -> dict[str, int]:
        """Place number of each column at a place of sensors of role ``fit``."""
        fitted = {sensor.label for sensor in self.press.sensor if sensor.role == "fit"}
        return {column: place for column, place in self.place_of.items() if self.labels[place] in fitted}

    @property
    def ambient(self) -> float:
        """Of the run. [°C]"""
        return self.run.ambient_temperature

    @cached_property
    def h(self) -> Array:
        """Step lengths (steps). [s]"""
        return snap(np.diff(self.edges))

    @cached_property
    def unchanged(self) -> Array:
        """Factor 1 on every contact in each step, not to be changed (steps, contacts)."""
        return np.ones((len(self.edges) - 1, len(self.layout.interface)))

    @cached_property
    def step_clock(self) -> Clock:
        """Shares of the states averaged over steps."""
        return self.clock(self.edges, mean=True)

    @cached_property
    def edge_clock(self) -> Clock:
        """Shares at step edges."""
        return self.clock(self.edges)

    @cached_property
    def row_clock(self) -> Clock:
        """Shares at the run's rows."""
        return self.clock(self.run.time_s)

    @cached_property
    def reader(self) -> Reader:
        """Reads step edges off at the run's rows."""
        return Reader.at(self.edges, self.run.time_s)

    @cached_property
    def slope_reader(self) -> Reader:
        """Reads slopes in time off at the run's rows."""
        return Reader.at(self.edges, self.run.time_s, slope=True)

    @cached_property
    def scene(self) -> Scene:
        """What effects may look at; its closing moment is the case's own."""
        mesh, wet, z, faces = self.mesh, self.layout.wet, np.zeros(len(self.mesh.dx)), None
        if wet.any():
            inside = np.flatnonzero(wet)
            height = np.cumsum(mesh.dx[inside]) - mesh.dx[inside] / 2
            z[inside] = 2.0 * height / mesh.dx[inside].sum() - 1.0
            faces = (int(inside[0]), int(inside[-1]))
        layers = set(self.press.panel_layers)
        return Scene(
            dx=mesh.dx,
            panel_cells=wet,
            z=z,
            face_cells=faces,
            panel=self.panel,
            panel_contacts=tuple(m for m, c in enumerate(self.press.contact) if set(c.between) & layers),
            contacts=len(self.press.contact),
            step_start=self.edges[:-1],
            step_end=self.edges[1:],
            closed_s=self.moments.closed_s,
            load=self.load,
            ambient=self.ambient,
        )

    def clock(self, times: Array, *, mean: bool = False) -> Clock:
        """Return the press's states at some times, or their means between them. [s]"""
        start = float(self.edges[0])
        return Clock.of(self.moments, times, start, mean=mean, has_states=self.press.has_states)


@dataclass(frozen=True)
class Fineness:
    """How finely a run is laid out."""

    cells: float = 1.0
    """2 halves cells and steps."""
    max_step_s: float = 0.5
    switch_step_s: float = FINE_STEP_S
    """Step around a switch. [s]"""
    growth: float = GROWTH
    """Of steps after it."""

    def __post_init__(self) -> None:
        for name, value, lower, upper in (
            ("fineness", self.cells, *GRIDS["fineness"]),
            ("max_step_s", self.max_step_s, *GRIDS["max_step_s"]),
            ("switch_step_s", self.switch_step_s, *GRIDS["switch_step_s"]),
            ("growth", self.growth, *GRIDS["growth"]),
        ):
            if not isinstance(value, Real) or not lower <= value <= upper:
                raise InputError(
                    say("solve-value-out-of-range", name=name, value=repr(value), lower=lower, upper=upper)
                )


def prepare_case(press: Press, run: Run, moments: Moments, *, paper: bool, fineness: Fineness) -> Case:
    """Check a run against a press and lay out its grids.

    Raises
    ------
    BrokenTime
        For times that fall or rows missing for more than `heat.run_checks.MAX_GAP_S`.
    BoundaryGap
        For a measured boundary or a load that is empty for more than `heat.run_checks.bridged_s`.
    OutsideLayer
        For a sensor outside its layer.
    Nonphysical
        For properties of panel or layers, temperatures outside, or loads that no matter has.
    InputError
        For a missing boundary column or panel constant, or moments that contradict each other.
    """
    press = press_for_run(press, run)
    check_times(press, run, moments)
    check_ambient(run)
    panel = panel_of(run) if press.panel_layers else None
    mesh = _mesh(press, panel, paper=paper, fineness=fineness.cells)
    fine, coarse = fineness.switch_step_s / fineness.cells, fineness.max_step_s / fineness.cells
    ends = (press.boundary.bottom, press.boundary.top)
    driven = press.platens or any(contact.load for contact in press.contact)
    later = 0.0 if driven else LATER / fineness.cells
    edges = step_edges(run.time_s, moments, coarse, fine, fineness.growth, later)
    series = [boundary_series(run, name, b) for name, b in zip(("bottom", "top"), ends, strict=True)]
    sensors = press.sensors_of(run) | press.sensors_of(run, "validation")
    weights = {sensor.label: _place(press, run, mesh, panel, sensor.at) for sensor in sensors.values()}
    labels = (*weights, "core")
    weights["core"] = _place(press, run, mesh, panel, press.core_at)
    return Case(
        run=run,
        press=press,
        panel=panel,
        mesh=mesh,
        moments=moments,
        edges=edges,
        boundary=np.stack([step_means(run.time_s, s, edges) for s in series], axis=1),
        outside=np.stack(series, axis=1),
        load=_loads(press, run, moments, edges),
        columns=tuple(sensors),
        labels=labels,
        place_of={column: labels.index(sensor.label) for column, sensor in sensors.items()},
        places=np.stack([weights[label] for label in labels]),
        press_face=np.stack([_press_face(press, mesh, label) for label in labels]),
        layout=Layout.of(press, mesh, panel, run.ambient_temperature),
    )


def snap(h: Array) -> Array:
    """Return steps with those that differ only by rounding made equal, so that steps keep their factors."""
    same = np.abs(np.diff(h)) < 1e-9 * h[1:]
    group = np.concatenate([[0], np.cumsum(~same)])
    first = np.concatenate([[0], np.flatnonzero(~same) + 1])
    return np.asarray(h[first][group])


def step_edges(
    time_s: Array, moments: Moments, max_step: float, fine: float, growth: float = GROWTH, later: float = 0.0
) -> Array:
    """Return step edges: fine around each switch, up to `max_step` or the share `later` of the time since. [s]

    Examples
    --------
    >>> edges = step_edges(np.array([0.0, 20.0]), Moments(inserted_s=0.0, closed_s=8.0), 0.5, 0.04)
    >>> bool(np.diff(edges).max() <= 1.25 * 0.5), bool(np.diff(edges)[np.searchsorted(edges, 8.0)] < 0.05)
    (True, True)
    """
    start, end = float(time_s[0]), float(time_s[-1])
    switches = [start]
    for moment, half in (
        (moments.inserted_s, HANDLED_S),
        (moments.closed_s, moments.ramp_s / 2 + SWITCHED_S),
        (moments.opened_s, OPENING_RAMP_S / 2 + SWITCHED_S),
        (moments.removed_s, HANDLED_S),
    ):
        if start < moment < end:
            switches += [max(start, moment - half), min(end, moment + half)]
    edges = [start]
    t, since, h = start, start, fine / 4
    spans = list(zip(switches[1::2], switches[2::2], strict=True))
    for begin, finish in [*spans, (end, end)]:
        while t < begin - 1e-9:
            t = min(t + h, begin)
            if begin - t < LAST_STEP * h:
                t = begin
            edges.append(t)
            h = min(h * growth, max(max_step, later * (t - since)))
        if finish > t:
            inner = np.linspace(t, finish, max(1, round((finish - t) / fine)) + 1)[1:]
            edges += inner.tolist()
            t, since, h = finish, finish, fine
    return np.array(edges) if len(edges) > 3 else np.linspace(start, end, 4)


def _mesh(press: Press, panel: Panel | None, *, paper: bool, fineness: float) -> Mesh:
    layers: list[tuple[str, float, float]] = []
    for layer in press.layer:
        thickness, k, c = layer_constants(press, layer.name, panel)
        body = (layer.name, thickness, k / c)
        if paper and layer.from_run:
            layers += [(PAPER[0], PAPER_WIDTH, 0.0), body, (PAPER[1], PAPER_WIDTH, 0.0)]
        else:
            layers.append(body)
    return build_mesh(layers, fineness)


def step_means(time_s: Array, values: Array, edges: Array) -> Array:
    """Return the mean over each step and change across it of a series joined by straight lines (steps, 2).

    `edges` are on the clock of `time_s`; what is returned has the unit of the series.
    """
    area = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * (values[1:] + values[:-1]) / 2)])
    at = np.interp(edges, time_s, values)
    i = np.clip(np.searchsorted(time_s, edges, side="right") - 1, 0, max(len(time_s) - 2, 0))
    total = area[i] + (edges - time_s[i]) * (values[i] + at) / 2
    return np.stack([np.diff(total) / np.diff(edges), np.diff(at)], axis=1)


def _place(press: Press, run: Run, mesh: Mesh, panel: Panel | None, at: str | At) -> Array:
    layer_name = at.layer if isinstance(at, At) else at.rpartition(".")[0]
    thickness = layer_constants(press, layer_name, panel)[0]
    if isinstance(at, At):
        height = at.depth_mm / 1000.0
        if height > thickness * (1 + 1e-9):
            raise OutsideLayer(
                say(
                    "sensor-outside-layer",
                    run=run.source or run.name,
                    depth_mm=at.depth_mm,
                    layer=layer_name,
                    thickness_mm=thickness * 1000,
                )
            )
    else:
        height = {"bottom": 0.0, "middle": 0.5, "top": 1.0}[at.rpartition(".")[2]] * thickness
    return mesh.place(layer_name, height)


def _press_face(press: Press, mesh: Mesh, label: str) -> Array:
    """Weights of the press face that touches a panel face while closed, zero for any other place."""
    names = [layer.name for layer in press.layer]
    layer_name, _, place = label.rpartition(".")
    if layer_name not in press.panel_layers or place not in ("bottom", "top"):
        return np.zeros(len(mesh.dx))
    i = names.index(layer_name) + (1 if place == "top" else -1)
    if not 0 <= i < len(names):
        return np.zeros(len(mesh.dx))
    neighbour = names[i]
    height = 0.0 if place == "top" else float(mesh.dx[mesh.cells(neighbour)].sum())
    return mesh.place(neighbour, height)


def _loads(press: Press, run: Run, moments: Moments, edges: Array) -> dict[int, Array]:
    """Pressure over its reference in each step, for contacts that have one in a column or the run's settings.

    A contact without either is left out: an effect that follows the load passes it by.
    """
    loads: dict[int, Array] = {}
    pressure = setting_load(run)
    for m, contact in enumerate(press.contact):
        if contact.load is not None:
            series = load_series(run, contact.load)
            if series is None:
                continue  # `load_remarks` says so
            check_load(run, contact.load, moments)
            reference = contact.load.reference or float(np.median(series))
            loads[m] = step_means(run.time_s, series / reference, edges)[:, 0]
        elif pressure is not None and set(contact.between) & set(press.panel_layers):
            loads[m] = np.full(len(edges) - 1, pressure / REFERENCE_PRESSURE)
    return loads
