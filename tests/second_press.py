"""A second virtual press: finite elements by scikit-fem, laws and sensors of its own, drawn widely.

`daq.simulated` and the live sensor were written in one house; this press shares neither mesh nor laws with them.
Each layer is a mesh of linear elements with lumped capacities, marched by the implicit Euler method in steps of
0.1 s (0.02 s where the press moves); contacts couple the ends of layers, so that the whole is one tridiagonal
system. Water is a bound phase and a vapour: the local vapour pressure is what Darcy's law and desorption leave in
balance, so steam flows inwards and condenses there. It is the slow one: some seconds a pressing.

Runs come as tables with the header in ``attrs``, and the press as the text of a press file: what the contract says
of both, and nothing else, is known here.

References
----------
Gustafsson & McBain, scikit-fem (2020), J. Open Source Softw. 5, 2369. Vapour pressure: Antoine's equation for
water, NIST, 379 to 573 K, and Magnus' below. Sorption: Henderson's isotherm. Growth of contact: a fractional law,
as molten resin spreads; cure: autocatalytic.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from skfem import Basis, BilinearForm, ElementLineP1, MeshLine
from skfem.helpers import dot, grad

Array = NDArray[np.float64]

GAS_CONSTANT, LATENT, ROOM_VAPOUR_PA = 8.314462618, 2.5e6, 1.5e3
PACE = 1.5e-5
"""Of desorption, drawn so that a layer follows its balance within seconds. [kg/(m³ s Pa)]"""
ESCAPE = 2e-8
"""Of vapour through a papered face. [kg/(m² s Pa)]"""
PLATE, PANEL, LID = range(3)
"""Layers from bottom to top."""
USUAL = {"h_p_o": 700.0, "h_p_c": 1000.0, "h_pp_o": 35.0, "h_pp_c": 800.0, "h_wa": 11.0, "h_ap": 9.0}
SIZES: Mapping[str, tuple[float, float]] = {
    "conductivity_offset": (1.12, 1.22),
    "heat_capacity_offset": (0.80, 0.88),
    "conductivity_temperature": (0.15, 0.30),
    "heat_capacity_temperature": (0.15, 0.30),
    "density_profile": (0.20, 0.35),
    "edge_loss": (1000.0, 2000.0),
    "contact_buildup": (0.5, 0.8),
    "contact_asymmetry": (0.55, 0.75),
    "paper_layer": (4e-4, 8e-4),
    "open_radiation": (0.4, 0.8),
    "moisture": (6.0, 10.0),
    "resin_cure": (12.0, 25.0),
    "initial_press_state": (5.0, 10.0),
    "thermocouple_lag": (0.5, 1.2),
    "thermocouple_footprint": (0.06, 0.12),
    "clock_offset": (0.3, 0.6),
    "platen_offset": (2.5, 4.0),
}
"""What can be hidden, and from where to where its size is drawn; in the contract's units, but for the moisture:
bound water, % of dry mass, which both evaporates and carries heat inwards."""


@BilinearForm
def _conduction(u: Any, v: Any, w: Any) -> Any:
    return w["k"] * dot(grad(u), grad(v))


@BilinearForm
def _unit(u: Any, v: Any, _: Any) -> Any:
    return u * v


@dataclass(frozen=True)
class Layer:
    """A layer's mesh and properties at its nodes (n)."""

    basis: Basis
    k: Array
    """At 20 °C. [W/mK]"""
    c: Array
    """Volumetric heat capacity at 20 °C. [J/m³K]"""
    k_slope: float = 0.0
    """Relative. [1/K]"""
    c_slope: float = 0.0

    @staticmethod
    def of(thickness: float, k: float, c: float, cells: int) -> Layer:
        """Return a uniform layer, its cells finer towards both faces. [m, W/mK, J/m³K]"""
        at = np.tanh(np.linspace(-2.2, 2.2, cells + 1))
        nodes = 0.5 * thickness * (1.0 + at / at[-1])
        basis = Basis(MeshLine(nodes), ElementLineP1())
        return Layer(basis, np.full(cells + 1, k), np.full(cells + 1, c))

    @property
    def z(self) -> Array:
        """Heights of the nodes above the layer's lower face. [m]"""
        return np.asarray(self.basis.mesh.p[0])

    @cached_property
    def width(self) -> Array:
        """What each node stands for, the lumped mass of a capacity of 1 (n). [m]"""
        return np.asarray(_unit.assemble(self.basis).sum(axis=1)).ravel()

    def stiffness(self, values: Array) -> tuple[Array, Array]:
        """Return diagonal (n) and couplings (n - 1) of div(values grad)."""
        matrix = _conduction.assemble(self.basis, k=self.basis.interpolate(values))
        return matrix.diagonal(0), -matrix.diagonal(1)


@dataclass(frozen=True)
class World:
    """A press with a panel, as it really is; SI units and °C."""

    layers: tuple[Layer, ...]
    coefficients: Mapping[str, float] = field(default_factory=lambda: dict(USUAL))
    ambient: float = 22.0
    start: float = 21.0
    """Of the panel."""
    exchange: float = 0.0
    """Heat lost at the rim. [W/m³K]"""
    growth: tuple[float, float] = (0.0, 1.0)
    """Of the closed contacts: h (1 - d / (1 + t / tau)). [-, s]"""
    asymmetry: float = 1.0
    """Upper closed contact over the lower one."""
    paper: tuple[float, float] = (0.0, 0.0)
    """Resistance and capacity of the paper on each face. [m²K/W, J/m²K]"""
    emissivity: float = 0.0
    """Between the open upper plate and the panel."""
    plates_offset: float = 0.0
    dry_density: float = 0.0
    """Of a panel whose water moves. [kg/m³]"""
    moisture: float = 0.0
    """Water over dry mass."""
    permeance: float = 2.5e-11
    """Permeability over the vapour's kinematic viscosity. [kg/(m s Pa)]"""
    cure_heat: float = 0.0
    """At each face. [J/m²]"""


@dataclass(frozen=True)
class Program:
    """What is done with the press. [s], platen temperatures as functions of time [°C]."""

    inserted: float
    closed: float
    opened: float
    end: float
    platen_bottom: Callable[[float], float]
    platen_top: Callable[[float], float]
    ramp: float = 0.4


@dataclass(frozen=True)
class Course:
    """What happened: times (s) and temperatures at them. [°C]"""

    time: Array
    lower: Array
    """Of the panel's lower face."""
    upper: Array
    core: Array
    lower_plate: Array
    """Of the plates' faces towards the panel."""
    upper_plate: Array
    heat_in: float
    """Taken up through the ends since the insertion, after losses to air and rim. [J/m²]"""
    heat_stored: float
    """By plates and panel since the insertion. [J/m²]"""
    heat_of_water: float
    """Taken by water that left its place. [J/m²]"""
    water_gone: float
    """[kg/m²]"""


def vapour_pressure(celsius: Array) -> Array:
    """Return water's saturation pressure. [Pa]"""
    kelvin = celsius + 273.15
    antoine = 1e5 * 10.0 ** (3.55959 - 643.748 / (kelvin - 198.043))
    magnus = 610.94 * np.exp(17.625 * celsius / (celsius + 243.04))
    return np.where(celsius > 105.0, antoine, magnus)


def activity(moisture: Array) -> Array:
    """Return the relative humidity above wood with so much water over dry mass (Henderson's isotherm, 100 °C)."""
    return 1.0 - np.exp(-60.0 * np.maximum(moisture, 0.0) ** 1.5)


class _March:
    """The tridiagonal system of a world, marched step by step."""

    def __init__(self, world: World, program: Program) -> None:
        self.world, self.program = world, program
        sizes = [len(layer.z) for layer in world.layers]
        self.first = np.cumsum([0, *sizes[:-1]])
        self.last = np.cumsum(sizes) - 1
        self.panel = slice(self.first[PANEL], self.last[PANEL] + 1)
        self.width = np.concatenate([layer.width for layer in world.layers])
        self.water = np.full(sizes[PANEL], world.moisture * world.dry_density)
        self.cured = np.full(2, 1e-3)
        self.fixed = {i: world.layers[i].stiffness(world.layers[i].k) for i in (PLATE, LID)}
        self.T = np.full(sum(sizes), world.start)

    def share_closed(self, time: float) -> float:
        """Return how far the press is closed, a straight ramp each way."""
        ramp, program = self.program.ramp, self.program
        up = np.clip((time - program.closed) / ramp + 0.5, 0.0, 1.0)
        return float(up * np.clip((program.opened - time) / ramp + 0.5, 0.0, 1.0))

    def contacts(self, time: float, T: Array) -> tuple[Array, Array, Array]:
        """Return couplings platen-plate, plate-panel, panel-plate, plate-platen (4), and losses to air of the
        panel's upper face and the two plates' inner faces (3), radiation between the parted faces (1). [W/m²K]"""
        world, h = self.world, self.world.coefficients
        closed = self.share_closed(time)
        late = max(time - self.program.closed, 0.0)
        grown = 1.0 - world.growth[0] / (1.0 + late / world.growth[1])
        ends = (1.0 - closed) * h["h_p_o"] + closed * h["h_p_c"]
        pressed = closed * h["h_pp_c"] * grown
        there = 1.0 if time >= self.program.inserted else 0.0
        couple = np.array([ends, pressed + (1.0 - closed) * h["h_pp_o"] * there, pressed * world.asymmetry, ends])
        if world.paper[0]:
            couple[1:3] = couple[1:3] / (1.0 + couple[1:3] * world.paper[0])
        apart = 1.0 - closed
        air = np.array([apart * h["h_wa"] * there, (1.0 - there) * h["h_ap"], apart * h["h_ap"]])
        a, b = T[self.last[PANEL]] + 273.15, T[self.first[LID]] + 273.15
        radiation = apart * there * world.emissivity * 5.670374e-8 * (a * a + b * b) * (a + b)
        return couple, air, np.array([radiation])

    def system(self, time: float, T: Array) -> tuple[Array, Array, Array, Array]:
        """Return diagonal, couplings, right side [W/m²] and capacities [J/m²K] at a time."""
        world, panel = self.world, self.world.layers[PANEL]
        inside = T[self.panel]
        warm = np.maximum(inside, 0.0) - 20.0
        parts = [self.fixed[PLATE], panel.stiffness(panel.k * (1.0 + panel.k_slope * warm)), self.fixed[LID]]
        diagonal = np.concatenate([part[0] for part in parts])
        off = np.concatenate([np.concatenate([part[1], [0.0]]) for part in parts])[:-1]
        c = np.concatenate([layer.c for layer in world.layers])
        c[self.panel] *= 1.0 + panel.c_slope * warm
        capacity = c * self.width
        if world.paper[1]:
            capacity[[self.first[PANEL], self.last[PANEL]]] += world.paper[1] / 2.0
            capacity[[self.last[PLATE], self.first[LID]]] += world.paper[1] / 2.0
        couple, air, radiation = self.contacts(time, T)
        right = np.zeros_like(T)
        platens = self.program.platen_bottom(time), self.program.platen_top(time)
        for at, h, beyond in (
            (0, couple[0], platens[0]),
            (len(T) - 1, couple[3], platens[1]),
            (self.last[PANEL], air[0], world.ambient),
            (self.last[PLATE], air[1], world.ambient),
            (self.first[LID], air[2], world.ambient),
        ):
            diagonal[at] += h
            right[at] += h * beyond
        for lower, h in ((self.last[PLATE], couple[1]), (self.last[PANEL], couple[2] + radiation[0])):
            diagonal[lower] += h
            diagonal[lower + 1] += h
            off[lower] += h
        if time >= self.program.inserted:
            loss = world.exchange * self.width[self.panel]
            diagonal[self.panel] += loss
            right[self.panel] += loss * world.ambient
        return diagonal, off, right, capacity

    def stand(self, time: float) -> None:
        """Let the plates stand as they do before the insertion."""
        T = self.T
        for _ in range(3):
            diagonal, off, right, _ = self.system(time, T)
            diagonal[self.panel] += 1e6  # the panel lies beside the press
            right[self.panel] += 1e6 * self.world.start
            T = solve_banded((1, 1), _bands(diagonal, off), right)
        T[self.panel] = self.world.start
        T[: self.last[PLATE] + 1] += self.world.plates_offset
        T[self.first[LID] :] += self.world.plates_offset
        self.T = T

    def step(self, time: float, dt: float) -> tuple[float, float]:
        """March one step; return the heat that came in and the heat that water took. [J/m²]"""
        T = self.T
        diagonal, off, right, capacity = self.system(time + 0.5 * dt, T)
        if time < self.program.inserted:
            diagonal[self.panel] += 1e6
            right[self.panel] += 1e6 * self.world.start
        taken = self._dry(T[self.panel], dt) if self.world.moisture and time >= self.program.inserted else 0.0
        right[self.panel] -= taken
        cured = self._cure(T, dt)
        right[[self.first[PANEL], self.last[PANEL]]] += cured
        new = solve_banded((1, 1), _bands(diagonal + capacity / dt, off), right + capacity / dt * T)
        came = float(right.sum() - (diagonal * new).sum() + (off * (new[1:] + new[:-1])).sum())
        self.T = new
        taken_heat = float(np.sum(taken)) * dt
        return came * dt + taken_heat - float(cured.sum()) * dt, taken_heat

    def _dry(self, T: Array, dt: float) -> Array:
        """Move water for one step; return the heat it takes at each node. [W/m²]"""
        world, panel = self.world, self.world.layers[PANEL]
        width = panel.width
        balance = vapour_pressure(np.maximum(T, 0.0)) * activity(self.water / world.dry_density)
        pace = PACE * width
        diagonal, off = panel.stiffness(np.full(len(T), world.permeance))
        right = pace * balance
        diagonal = diagonal + pace
        diagonal[[0, -1]] += ESCAPE
        right[[0, -1]] += ESCAPE * ROOM_VAPOUR_PA
        pressure = solve_banded((1, 1), _bands(diagonal, off), right)
        rate = pace * (balance - pressure)
        rate = np.minimum(rate, self.water * width / dt)
        self.water = self.water - rate * dt / width
        return LATENT * rate

    def _cure(self, T: Array, dt: float) -> Array:
        """Let the resin at both faces cure for one step, autocatalytically; return its heat. [W/m²]"""
        if not self.world.cure_heat:
            return np.zeros(2)
        kelvin = T[[self.first[PANEL], self.last[PANEL]]] + 273.15
        rate = 0.12 * np.exp(-80e3 / GAS_CONSTANT * (1.0 / kelvin - 1.0 / 423.15))
        change = np.minimum(rate * (0.02 + self.cured) * (1.0 - self.cured) * dt * 4.0, 1.0 - self.cured)
        self.cured = self.cured + change
        return self.world.cure_heat * change / dt


def _bands(diagonal: Array, off: Array) -> Array:
    bands = np.zeros((3, len(diagonal)))
    bands[0, 1:], bands[1], bands[2, :-1] = -off, diagonal, -off
    return bands


def course(world: World, program: Program) -> Course:
    """March a pressing; see the head."""
    march = _March(world, program)
    march.stand(0.0)
    begun, water = None, float((march.water * world.layers[PANEL].width).sum())
    middle, at = world.layers[PANEL].z, march.panel
    rows, time, heat, taken = [], 0.0, 0.0, 0.0
    while True:
        T = march.T
        core = np.interp(0.5 * middle[-1], middle, T[at])
        rows.append((time, T[at][0], T[at][-1], core, T[march.last[PLATE]], T[march.first[LID]]))
        if time >= program.end - 1e-9:
            break
        if begun is None and time >= program.inserted - 1e-9:
            begun = T.copy()
        moves = min(abs(time - when) for when in (program.inserted, program.closed, program.opened))
        dt = 0.02 if moves < 2.0 else 0.1
        came, took = march.step(time, dt)
        if begun is not None:
            heat, taken = heat + came, taken + took
        time = round(time + dt, 6)
    stored = 0.0 if begun is None else float((march.system(time, begun)[3] * (march.T - begun)).sum())
    gone = water - float((march.water * world.layers[PANEL].width).sum())
    return Course(*np.array(rows).T, heat, stored, taken, gone)


@dataclass(frozen=True)
class Hidden:
    """What a campaign hides, and its size."""

    name: str = ""
    size: float = 0.0


@dataclass(frozen=True)
class Pressing:
    """A run as a laboratory would hand it on, and what really happened."""

    run: pd.DataFrame
    course: Course
    world: World
    program: Program


@dataclass(frozen=True)
class Campaign:
    """Pressings of one press, the text of its press file, and what is hidden."""

    press: str
    pressings: tuple[Pressing, ...]
    hidden: Hidden

    @property
    def runs(self) -> list[pd.DataFrame]:
        """What a diagnosis is given."""
        return [pressing.run for pressing in self.pressings]


def campaign(seed: int, hidden: str = "", runs: int = 12, half: bool = False) -> Campaign:
    """Draw a press and its panels, press them, and read the sensors."""
    rng, secret = np.random.default_rng([seed, 2]), np.random.default_rng([seed, 3])
    what = Hidden(hidden, _size(secret, hidden, half))
    plate = (rng.uniform(0.008, 0.014), rng.uniform(16.0, 50.0), rng.uniform(3.6e6, 3.95e6))
    usual = {name: value * rng.lognormal(0.0, 0.35) for name, value in USUAL.items()}
    product = (rng.uniform(0.105, 0.14), rng.uniform(1450.0, 1650.0), rng.uniform(690.0, 790.0))
    thicknesses = rng.choice([10.0, 12.0, 16.0, 19.0], size=2, replace=False)
    chain = _Chain.drawn(rng, what)
    made = []
    for number in range(runs):
        world, header = _panel(rng, plate, product, float(rng.choice(thicknesses)), usual)
        program, world = _program(rng), _with_hidden(world, what, secret)
        happened = course(world, program)
        table = chain.read(happened, program, rng)
        table.attrs = {"run": f"second-{seed}-{number + 1:02d}", **header}
        made.append(Pressing(table, happened, world, program))
    return Campaign(_press_file(plate), tuple(made), what)


def _size(rng: np.random.Generator, hidden: str, half: bool) -> float:
    if not hidden:
        return 0.0
    size = float(rng.uniform(*SIZES[hidden]))
    one = 1.0 if hidden in ("conductivity_offset", "heat_capacity_offset", "contact_asymmetry") else 0.0
    return one + 0.5 * (size - one) if half else size


def _panel(rng, plate, product, thickness_mm, usual) -> tuple[World, dict[str, Any]]:  # type: ignore[no-untyped-def]
    k, c, rho = product
    start, ambient = rng.uniform(18.0, 24.0), rng.uniform(18.0, 26.0)
    thickness = thickness_mm / 1000.0
    true_k, true_c = k * rng.lognormal(0.0, 0.05), rho * c * rng.lognormal(0.0, 0.05)
    steel = Layer.of(*plate, 16)
    panel = Layer.of(thickness, true_k, true_c, 60)
    coefficients = {name: value * rng.lognormal(0.0, 0.12) for name, value in usual.items()}
    header = {
        "panel.material": "MDF",
        "panel.thickness_mm": thickness_mm,
        "panel.density_kg_m3": round(rho, 1),
        "panel.conductivity_W_mK": round(k, 4),
        "panel.heat_capacity_J_kgK": round(c, 1),
        "panel.moisture_percent": 8.0,
        "panel.initial_temperature_C": round(start + rng.normal(0.0, 0.2), 1),
        "ambient.temperature_C": round(ambient + rng.normal(0.0, 0.5), 1),
        "setting.pressure_N_cm2": 350,
    }
    return World((steel, panel, steel), coefficients, ambient, start, dry_density=rho / 1.08), header


def _program(rng: np.random.Generator) -> Program:
    inserted = rng.uniform(0.0, 8.0)
    closed = inserted + rng.uniform(6.0, 25.0)
    opened = closed + rng.uniform(30.0, 110.0)
    platens = []
    level = rng.uniform(180.0, 210.0)
    for _ in range(2):
        base, dip, phase = level + rng.normal(0.0, 1.0), rng.uniform(1.0, 4.0), rng.uniform(0.0, 6.3)

        def platen(t: float, base: float = base, dip: float = dip, phase: float = phase) -> float:
            late = max(t - closed, 0.0)
            return base - dip * (late / 15.0) * np.exp(1.0 - late / 15.0) + 0.4 * np.sin(0.05 * t + phase)

        platens.append(platen)
    ramp = rng.uniform(0.2, 1.0)
    return Program(inserted, closed, opened, opened + rng.uniform(30.0, 100.0), platens[0], platens[1], ramp)


def _with_hidden(world: World, hidden: Hidden, rng: np.random.Generator) -> World:
    """Put what is hidden into a pressing; what lies in the panel scatters by a fifth."""
    size, panel = hidden.size, world.layers[PANEL]
    own = size * rng.normal(1.0, 0.2)
    height = 2.0 * panel.z / panel.z[-1] - 1.0
    profile = 1.0 + size * (np.cosh(3.0 * height) / np.mean(np.cosh(3.0 * np.linspace(-1, 1, 401))) - 1.0) / 3.0
    layers = {
        "conductivity_offset": lambda: replace(panel, k=panel.k * size),
        "heat_capacity_offset": lambda: replace(panel, c=panel.c * size),
        "conductivity_temperature": lambda: replace(panel, k_slope=own / 100.0),
        "heat_capacity_temperature": lambda: replace(panel, c_slope=own / 100.0),
        "density_profile": lambda: replace(panel, k=panel.k * profile, c=panel.c * profile),
    }
    changes: dict[str, Callable[[], dict[str, Any]]] = {
        "edge_loss": lambda: {"exchange": size},
        "contact_buildup": lambda: {"growth": (size, 6.0)},
        "contact_asymmetry": lambda: {"asymmetry": size},
        "paper_layer": lambda: {"paper": (size, 600.0)},
        "open_radiation": lambda: {"emissivity": size},
        "moisture": lambda: {"moisture": own / 100.0, "permeance": 2.5e-11 * rng.lognormal(0.0, 0.4)},
        "resin_cure": lambda: {"cure_heat": 1e3 * own},
        "initial_press_state": lambda: {"plates_offset": size},
    }
    if hidden.name in layers:
        return replace(world, layers=(world.layers[PLATE], layers[hidden.name](), world.layers[LID]))
    return replace(world, **changes.get(hidden.name, dict)())


@dataclass(frozen=True)
class _Chain:
    """Loggers and thermocouples of a press."""

    rate_hz: float
    offsets: Array
    """Of the panel's 14 channels. [K]"""
    skews: Array
    """How late in its scan each of 16 channels is read. [s]"""
    lag: float
    footprint: float
    clock: float
    platens: tuple[float, float]
    switch: bool

    @staticmethod
    def drawn(rng: np.random.Generator, hidden: Hidden) -> _Chain:
        """Draw one, with what is hidden in it."""
        size, quick = hidden.size, rng.uniform(0.03, 0.1)
        return _Chain(
            rate_hz=float(rng.choice([1.0, 2.0, 4.0])),
            offsets=rng.normal(0.0, 0.4, 14),
            skews=np.linspace(0.0, rng.uniform(0.02, 0.2), 16),
            lag=size if hidden.name == "thermocouple_lag" else quick,
            footprint=size if hidden.name == "thermocouple_footprint" else 0.0,
            clock=size if hidden.name == "clock_offset" else 0.0,
            platens=(size, size) if hidden.name == "platen_offset" else (0.0, 0.0),
            switch=bool(rng.random() < 0.5) or hidden.name == "clock_offset",
        )

    def read(self, course: Course, program: Program, rng: np.random.Generator) -> pd.DataFrame:
        """Return the logger's table: quantised to 0.1 K, noise white and slow, of each channel its own."""
        times = np.arange(0.0, program.end, 1.0 / self.rate_hz)
        times = np.round(np.sort(times + rng.uniform(-0.02, 0.02, len(times))), 3)
        times[0] = 0.0
        columns: dict[str, Array] = {}
        for name, skew, platen, off in zip(
            ("platen_top", "platen_bottom"),
            self.skews,
            (program.platen_top, program.platen_bottom),
            self.platens,
            strict=False,
        ):
            columns[name] = np.array([platen(t + skew) for t in times]) - off + _noise(times, rng)
        for side, (face, steel) in {
            "top": (course.upper, course.upper_plate),
            "bottom": (course.lower, course.lower_plate),
        }.items():
            pressed = (course.time > program.closed) & (course.time < program.opened)
            junction = _lagged(course.time, face + self.footprint * pressed * (steel - face), self.lag)
            for number in range(7):
                channel = number + (0 if side == "top" else 7)
                at = np.interp(times + self.skews[channel + 2] - self.clock, course.time, junction)
                columns[f"{side}_{number + 1}"] = at + self.offsets[channel] + _noise(times, rng)
        table = pd.DataFrame({name: np.round(values, 1) for name, values in columns.items()})
        if self.switch:
            table["closed"] = ((times >= program.closed) & (times < program.opened)).astype(int)
        table.index = pd.Index(times, name="time_s")
        return table


def _noise(times: Array, rng: np.random.Generator) -> Array:
    """White noise of 0.04 K, and slow noise of 0.1 K that forgets within 15 s."""
    slow = np.empty(len(times))
    slow[0] = rng.normal(0.0, 0.1)
    for i, kept in enumerate(np.exp(-np.diff(times) / 15.0)):
        slow[i + 1] = kept * slow[i] + rng.normal(0.0, 0.1 * np.sqrt(1.0 - kept**2))
    return slow + rng.normal(0.0, 0.04, len(times))


def _lagged(time: Array, values: Array, lag: float) -> Array:
    """What a junction of first order reads, of values straight between the times."""
    out = np.empty_like(values)
    out[0] = values[0]
    for i, dt in enumerate(np.diff(time)):
        kept = np.exp(-dt / lag)
        slope = (values[i + 1] - values[i]) / dt
        out[i + 1] = values[i + 1] - slope * lag + (out[i] - values[i] + slope * lag) * kept
    return out


def _press_file(plate: tuple[float, float, float]) -> str:
    thickness, k, c = plate
    steel = f"thickness_mm = {1e3 * thickness:.3f}\nconductivity_W_mK = {k:.2f}\n"
    steel += f"density_kg_m3 = 7850.0\nheat_capacity_J_kgK = {c / 7850.0:.2f}\n"
    text = '[press]\nname = "second"\narea_m2 = 0.36\n'
    text += f'[[layer]]\nname = "lower"\n{steel}[[layer]]\nname = "panel"\nfrom_run = true\n'
    text += f'[[layer]]\nname = "upper"\n{steel}'
    for end in ("bottom", "top"):
        text += f'[boundary.{end}]\nkind = "measured"\ncolumn = "platen_{end}"\n'
    for pair, states in (
        ('"boundary.bottom", "lower"', 'open = "h_p_o"\nclosed = "h_p_c"'),
        ('"lower", "panel"', 'open = "h_pp_o"\nclosed = "h_pp_c"'),
        ('"panel", "upper"', 'open = ["h_wa", "h_ap"]\nclosed = "h_pp_c"'),
        ('"upper", "boundary.top"', 'open = "h_p_o"\nclosed = "h_p_c"'),
    ):
        text += f"[[contact]]\nbetween = [{pair}]\n{states}\n"
    for face in ("top", "bottom"):
        text += f'[[sensor]]\ncolumns = ["{face}_*"]\nat = "panel.{face}"\n'
    return text
