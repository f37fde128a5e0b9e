"""The virtual press: the truth against which the model, the fit and the diagnosis are tested.

Stack from bottom to top: platen, steel plate, panel, steel plate, platen. Method of lines on nodes that
are finest at the panel's faces, every effect at full nonlinearity, closing and opening as ramps. It
shares no code with the soft sensor; `tests/daq/test_simulated_physics.py` checks it against closed forms.

Conventions where the contract leaves them open:
evaporable water counts on ``panel.density_kg_m3`` as the dry mass; `contact_load` refers to 350 N/cm²;
`contact_asymmetry` changes the upper contact and leaves the lower; `open_radiation` crosses the upper gap;
the paper lies between plate and panel, half its resistance on either side of its capacity, and the
thermocouples lie under it; steam condenses in proportion to 100 °C minus the temperature.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from daq.records import Array, Panel
from daq.simulated import physics_kernel as kernel

Accuracy = Literal["fast", "accurate"]

BASE_COEFFICIENTS: Mapping[str, float] = {
    "h_p_o": 800.0,
    "h_p_c": 900.0,
    "h_pp_o": 40.0,
    "h_pp_c": 700.0,
    "h_wa": 12.0,
    "h_ap": 10.0,
}
"""Heat transfer coefficients of the laboratory press. [W/m²K]"""

PLATE_THICKNESS = 0.010
PLATE_CONDUCTIVITY = 45.0
PLATE_HEAT_CAPACITY = 7850.0 * 490.0
"""Per volume. [J/m³K]"""
LATENT_HEAT = 2.4e6
"""Of bound water in wood near 100 °C, with the heat of sorption. [J/kg]"""
LOAD_REFERENCE = 350.0
"""[N/cm²]"""
CURE_ACTIVATION = 85e3
"""[J/mol]"""
CURE_RATE_150 = 0.08
"""Of the impregnated paper's resin at 150 °C. [1/s]"""
GAS_CONSTANT = 8.314462618
SKIN = 0.15e-3
"""Depth over which the resin's heat is released. [m]"""
NEVER = 1e9


@dataclass(frozen=True)
class Platen:
    """A platen's true temperature: a smooth curve through evenly spaced knots."""

    start: float
    step: float
    values: Array

    def at(self, times: Array) -> Array:
        """Return the temperature at any times inside the knots. [°C]"""
        return np.asarray(kernel.platen_curve(times, self.start, self.step, self.values))


def constant_platen(temperature: float, end: float = 1e4) -> Platen:
    """Return a platen that stays at one temperature."""
    return Platen(0.0, end, np.full(2, temperature))


@dataclass(frozen=True)
class Outside:
    """Faults outside the catalogue; the defaults do nothing. Times in s of the run."""

    lapse_drop: float = 0.0
    """The upper contact loses this share between `lapse_from` and `lapse_to`."""
    lapse_from: float = NEVER
    lapse_to: float = 2 * NEVER
    split_resistance: float = 0.0
    """A delamination inside the panel opens within 2 s. [m²K/W]"""
    split_depth: float = 0.0
    """From the lower face. [m]"""
    split_from: float = NEVER
    draught: float = 1.0
    """Panel-air and plate-air coefficients are multiplied by this from `draught_from` on."""
    draught_from: float = NEVER
    lift: float = 1.0
    """The open contact to the lower plate is multiplied by this from `lift_from` on."""
    lift_from: float = NEVER
    wet_heat: float = 0.0
    """Heat that condensing steam releases near each face and takes back later. [J/m²]"""
    wet_release: float = NEVER
    wet_return: float = NEVER
    wet_width: float = 1.5


@dataclass(frozen=True)
class Pressing:
    """Everything that decides one pressing. SI units, times in s of the run."""

    panel: Panel
    ambient: float
    platen_bottom: Platen
    platen_top: Platen
    start: float
    end: float
    inserted: float
    closed: float = NEVER
    """Middle of the closing ramp."""
    opened: float = 2 * NEVER
    """Middle of the opening ramp."""
    removed: float = 3 * NEVER
    closing_ramp: float = 0.5
    opening_ramp: float = 0.3
    coefficients: Mapping[str, float] = field(default_factory=lambda: dict(BASE_COEFFICIENTS))
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Physical effects by the contract's names, and thermocouple lag and footprint."""
    outside: Outside = Outside()
    pressure: float = LOAD_REFERENCE
    """[N/cm²]"""
    vapour_law: Literal["proportional", "uniform"] = "proportional"
    """How steam spreads over the cooler layers; a second law keeps tests from leaning on the first."""
    drying_law: Literal["equilibrium", "kinetic"] = "equilibrium"


@dataclass(frozen=True)
class Solution:
    """A solved pressing: values after each step, and any time in between."""

    steps: Mapping[str, Array]
    """``time`` and every name of `SIGNALS`."""
    stretches: tuple[tuple[int, int], ...]
    """First and one-past-last row between two jumps."""
    plates: tuple[Array, Array]
    """Node temperatures of the lower and upper plate at the end. [°C]"""

    def at(self, signal: str, times: Array) -> Array:
        """Return a signal at any times: cubic between the steps, never across a jump."""
        t, y = self.steps["time"], self.steps[signal]
        out = np.empty(len(times))
        for first, last in self.stretches:
            final = last == len(t)
            chosen = (times >= t[first] - (1e9 if first == 0 else 0.0)) & (
                (times < t[last - 1]) | (final and times >= t[last - 1])
            )
            if chosen.any():
                out[chosen] = _cubic(t[first:last], y[first:last], times[chosen])
        return out


def solve(pressing: Pressing, accuracy: Accuracy = "fast", plates: tuple[Array, Array] | None = None) -> Solution:
    """Integrate a pressing from its start to its end.

    Parameters
    ----------
    pressing
        The conditions.
    accuracy
        ``fast`` agrees with ``accurate`` within 0.02 K at core and faces and takes a few milliseconds.
    plates
        Node temperatures to start from, as an earlier `Solution` ended; else the plates stand steady
        without a panel, as the contract's ``[initial] kind = "steady"`` says.
    """
    mesh = _mesh(pressing, accuracy)
    p = _parameters(pressing, mesh)
    T = _initial(pressing, mesh, plates)
    m = mesh.p1 - mesh.p0
    w, x = np.ones(m), np.zeros(5)
    x[3:] = pressing.panel.initial_temperature
    tolerance, longest = (1e-3, 0.5) if accuracy == "fast" else (1e-5, 0.1)
    rows = 4000 + int(8 * (pressing.end - pressing.start) / longest)
    out = np.empty((rows, 1 + len(kernel.SIGNALS)))
    low, high = pressing.platen_bottom, pressing.platen_top
    if (low.start, low.step, len(low.values)) != (high.start, high.step, len(high.values)):
        raise ValueError("both platens need the same knots")
    times = _breakpoints(pressing)
    k, stretches = 0, []
    for a, b in itertools.pairwise(times):
        first = k
        k = kernel.advance(
            a, b, T, w, x, p, mesh.layout, mesh.base, mesh.capacity, mesh.volume, mesh.latent, mesh.skin,
            mesh.wet, low.start, low.step, low.values, high.values, tolerance, longest, out, k,
        )  # fmt: skip
        if k < 0:
            raise RuntimeError(f"virtual press: more than {rows} steps up to {b:g} s")
        stretches.append((first, k))
    table = out[:k]
    steps = {name: table[:, 1 + i].copy() for i, name in enumerate(kernel.SIGNALS)}
    steps["time"] = table[:, 0].copy()
    return Solution(steps, tuple(stretches), (T[: mesh.nb].copy(), T[len(T) - mesh.nb :].copy()))


@dataclass(frozen=True)
class _Mesh:
    nb: int
    p0: int
    p1: int
    depth: Array
    layout: NDArray[np.int64]
    base: Array
    capacity: Array
    volume: Array
    latent: Array
    skin: Array
    wet: Array


def _graded(length: float, first: float, growth: float, largest: float) -> Array:
    """Return node places from 0 to `length`, finest at 0, their spacing growing smoothly."""
    spacing = []
    size, total = first, 0.0
    while total < length:
        spacing.append(size)
        total += size
        size = min(size * growth, largest)
    places = np.concatenate(([0.0], np.cumsum(spacing)))
    return np.asarray(places * (length / places[-1]))


def _mesh(pressing: Pressing, accuracy: Accuracy) -> _Mesh:
    panel, effects = pressing.panel, pressing.effects
    fast = accuracy == "fast"
    half = _graded(panel.thickness / 2, *((5e-6, 1.06, 0.15e-3) if fast else (4e-6, 1.03, 0.06e-3)))
    depth = np.concatenate((half, panel.thickness - half[-2::-1]))
    plate = _graded(PLATE_THICKNESS, *((0.1e-3, 1.2, 0.6e-3) if fast else (0.04e-3, 1.08, 0.25e-3)))
    lower = PLATE_THICKNESS - plate[::-1]
    nb, m = len(plate), len(depth)
    paper = effects.get("paper_layer")
    extra = 1 if paper else 0
    p0, p1 = nb + extra, nb + extra + m
    n = p1 + extra + nb
    base, capacity = np.zeros(n + 1), np.empty(n)
    base[1:nb] = PLATE_CONDUCTIVITY / np.diff(lower)
    base[n - nb + 1 : n] = PLATE_CONDUCTIVITY / np.diff(plate)
    middle = 0.5 * (depth[1:] + depth[:-1])
    base[p0 + 1 : p1] = _profile(pressing, middle)[0] / np.diff(depth)
    volume = _volumes(depth)
    capacity[:nb] = PLATE_HEAT_CAPACITY * _volumes(lower)
    capacity[n - nb :] = PLATE_HEAT_CAPACITY * _volumes(plate)
    capacity[p0:p1] = _profile(pressing, depth)[1] * volume
    if paper:
        capacity[nb], capacity[p1] = paper["capacity_J_m2K"], paper["capacity_J_m2K"]
        base[nb + 1] = base[p1] = 2.0 / paper["resistance_m2K_W"]
    moisture = effects.get("moisture_evaporation", {}).get("moisture_percent", 0.0)
    latent = LATENT_HEAT * moisture / 100.0 * panel.density * volume
    skin = volume * np.exp(-depth / SKIN)
    place = (depth - 1.5e-3) / 0.5e-3
    wet = volume * (np.exp(-0.5 * place**2) + np.exp(-0.5 * place[::-1] ** 2))
    layout = np.array([nb, p0, p1], dtype=np.int64)
    return _Mesh(nb, p0, p1, depth, layout, base, capacity, volume, latent, skin / skin.sum(), 2 * wet / wet.sum())


def _profile(pressing: Pressing, depth: Array) -> tuple[Array, Array]:
    """Return conductivity [W/mK] and heat capacity per volume [J/m³K] at 20 °C over the depth."""
    panel, effects = pressing.panel, pressing.effects
    z = 2.0 * depth / panel.thickness - 1.0
    shape = 1.0 + effects.get("density_profile", {}).get("amplitude", 0.0) * (z**4 - 0.2)
    conductivity = panel.conductivity * effects.get("conductivity_offset", {}).get("ratio", 1.0)
    rho_c = panel.density * panel.heat_capacity * effects.get("heat_capacity_offset", {}).get("ratio", 1.0)
    return conductivity * shape, rho_c * shape


def _volumes(depth: Array) -> Array:
    gaps = np.diff(depth)
    return np.concatenate(([gaps[0] / 2], (gaps[1:] + gaps[:-1]) / 2, [gaps[-1] / 2]))


def _parameters(pressing: Pressing, mesh: _Mesh) -> Array:
    effects, outside, h = pressing.effects, pressing.outside, pressing.coefficients

    def of(effect: str, parameter: str, default: float) -> float:
        return effects.get(effect, {}).get(parameter, default)

    load = (pressing.pressure / LOAD_REFERENCE) ** of("contact_load", "exponent", 0.0)
    values = {
        **h,
        "h_pp_c": h["h_pp_c"] * load,
        "ambient": pressing.ambient,
        "inserted": pressing.inserted,
        "close_0": pressing.closed - pressing.closing_ramp / 2,
        "close_1": pressing.closed + pressing.closing_ramp / 2,
        "open_0": pressing.opened - pressing.opening_ramp / 2,
        "open_1": pressing.opened + pressing.opening_ramp / 2,
        "removed": pressing.removed,
        "k_slope": of("conductivity_temperature", "per_100_K", 0.0) / 100.0,
        "c_slope": of("heat_capacity_temperature", "per_100_K", 0.0) / 100.0,
        "deficit": of("contact_buildup", "deficit", 0.0),
        "tau": of("contact_buildup", "time_constant_s", 1.0),
        "ratio": of("contact_asymmetry", "ratio", 1.0),
        "emissivity": of("open_radiation", "emissivity", 0.0),
        "edge": of("edge_loss", "W_m3K", 0.0),
        "vapour": of("vapour_convection", "W_m3K", 0.0),
        "vapour_uniform": float(pressing.vapour_law == "uniform"),
        "evap_t": of("moisture_evaporation", "temperature_C", 100.0),
        "evap_width": 3.0,
        "evap_tau": 0.5,
        "evap_kinetic": float(pressing.drying_law == "kinetic"),
        "cure_heat": of("resin_cure", "heat_kJ_m2", 0.0) * 1e3,
        "cure_rate": CURE_RATE_150,
        "cure_kelvin": CURE_ACTIVATION / GAS_CONSTANT,
        "paper_r": of("paper_layer", "resistance_m2K_W", 0.0),
        "footprint": of("thermocouple_footprint", "weight", 0.0),
        "lag": of("thermocouple_lag", "time_constant_s", 0.0),
        "lapse_factor": 1.0 - outside.lapse_drop,
        "lapse_from": outside.lapse_from,
        "lapse_to": outside.lapse_to,
        "split_r": outside.split_resistance,
        "split_from": outside.split_from,
        "split_node": mesh.p0 + int(np.searchsorted(mesh.depth, outside.split_depth)) - 1.0,
        "draught": outside.draught,
        "draught_from": outside.draught_from,
        "lift": outside.lift,
        "lift_from": outside.lift_from,
        "wet_heat": outside.wet_heat,
        "wet_release": outside.wet_release,
        "wet_return": outside.wet_return,
        "wet_width": outside.wet_width,
    }
    return np.array([values[name] for name in kernel.PARAMETERS])


def _initial(pressing: Pressing, mesh: _Mesh, plates: tuple[Array, Array] | None) -> Array:
    T = np.full(len(mesh.capacity), pressing.panel.initial_temperature)
    if plates is not None:
        T[: mesh.nb], T[len(T) - mesh.nb :] = plates
        return T
    h = pressing.coefficients
    path = 1.0 / h["h_p_o"] + PLATE_THICKNESS / PLATE_CONDUCTIVITY + 1.0 / h["h_ap"]
    offset = pressing.effects.get("initial_press_state", {}).get("offset_K", 0.0)
    inner = np.cumsum(1.0 / mesh.base[1 : mesh.nb])
    from_platen = 1.0 / h["h_p_o"] + np.concatenate(([0.0], inner))
    for side, platen in enumerate((pressing.platen_bottom, pressing.platen_top)):
        hot = float(platen.at(np.array([pressing.start]))[0])
        profile = hot - (hot - pressing.ambient) / path * from_platen + offset
        if side == 0:
            T[: mesh.nb] = profile
        else:
            T[len(T) - mesh.nb :] = profile[::-1]
    return T


def _breakpoints(pressing: Pressing) -> list[float]:
    """Return start, every jump in between, and end."""
    o = pressing.outside
    ramp, ramp_open = pressing.closing_ramp / 2, pressing.opening_ramp / 2
    jumps = [
        pressing.inserted, pressing.closed - ramp, pressing.closed, pressing.closed + ramp,
        pressing.opened - ramp_open, pressing.opened + ramp_open, pressing.removed,
        o.lapse_from, o.lapse_to, o.split_from, o.split_from + 2.0, o.draught_from, o.lift_from,
    ]  # fmt: skip
    inside = sorted({t for t in jumps if pressing.start + 1e-6 < t < pressing.end - 1e-6})
    return [pressing.start, *inside, pressing.end]


def _cubic(t: Array, y: Array, at: Array) -> Array:
    """Interpolate with a cubic whose slopes are those of parabolas through three neighbours."""
    if len(t) < 3:
        return np.interp(at, t, y)
    h = np.diff(t)
    d = np.diff(y) / h
    m = np.empty(len(t))
    m[1:-1] = (d[:-1] * h[1:] + d[1:] * h[:-1]) / (h[:-1] + h[1:])
    m[0] = d[0] + (d[0] - d[1]) * h[0] / (h[0] + h[1])
    m[-1] = d[-1] + (d[-1] - d[-2]) * h[-1] / (h[-1] + h[-2])
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(h) - 1)
    s = np.clip((at - t[i]) / h[i], 0.0, 1.0)
    left = (1 + 2 * s) * (1 - s) ** 2 * y[i] + s * (1 - s) ** 2 * h[i] * m[i]
    right = s**2 * (3 - 2 * s) * y[i + 1] + s**2 * (s - 1) * h[i] * m[i + 1]
    return np.asarray(left + right)


def nominal_panel(thickness: float = 0.016, initial_temperature: float = 20.8) -> Panel:
    """Return an MDF panel with the constants of the contract's example."""
    return Panel("MDF", thickness, 740.0, 0.12, 1550.0, initial_temperature, 8.0)


def without_effects(pressing: Pressing) -> Pressing:
    """Return the same pressing with everything the plain model leaves out switched off."""
    return replace(pressing, effects={}, outside=Outside())
