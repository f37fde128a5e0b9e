"""The virtual press as numbers for its kernel: nodes, links, capacities, knobs and first temperatures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daq.records import GAS_CONSTANT, Array
from daq.simulated.physics_kernel import Knobs, NodeState, PressStack
from daq.simulated.physics_pressing import EASING_S, LOAD_REFERENCE, Pressing

Accuracy = Literal["fast", "accurate"]

LATENT_HEAT = 2.4e6
"""Of bound water in wood near 100 °C, with the heat of sorption. [J/kg]"""
CURE_ACTIVATION = 85e3
"""[J/mol]"""
CURE_RATE_150 = 0.08
"""Of the impregnated paper's resin at 150 °C. [1/s]"""
SKIN = 0.15e-3
"""Depth over which the resin's heat is released. [m]"""
DRYING_WIDTH = 3.0
"""How sharply water leaves around its temperature. [K]"""
SORBED_WIDTH = 12.0
"""The same of water that is bound: a logistic 42 K wide at half of its height, about as wood dries. [K]"""
DRYING_TIME = 0.5
"""How fast water follows its equilibrium. [s]"""
WET_DEPTH, WET_WIDTH = 1.5e-3, 0.5e-3
"""Where steam of a wet spot condenses, below the upper face. [m]"""

INNER_WIDTH = 0.15
"""Of a source about the middle, one standard deviation as a share of the panel's thickness."""

_PANEL_NODES = {"fast": (5e-6, 1.06, 0.15e-3), "accurate": (4e-6, 1.03, 0.06e-3)}
_PLATE_NODES = {"fast": (0.1e-3, 1.2, 0.6e-3), "accurate": (0.04e-3, 1.08, 0.25e-3)}
"""Spacing at the panel's face, its growth, and its largest value. [m]"""


@dataclass(frozen=True)
class PressMesh:
    """A pressing's stack, and where its panel's nodes lie."""

    stack: PressStack
    depth: Array
    """Of panel nodes, from the lower face. [m]"""


def build_mesh(pressing: Pressing, accuracy: Accuracy) -> PressMesh:
    """Return nodes and everything attached to them, from the lower plate to the upper."""
    panel, plates, effects = pressing.panel, pressing.plates, pressing.effects
    half = _graded(panel.thickness / 2, *_PANEL_NODES[accuracy])
    depth = np.concatenate((half, panel.thickness - half[-2::-1]))
    plate = _graded(plates.thickness, *_PLATE_NODES[accuracy])
    paper = effects.get("paper_layer")
    nb, m = len(plate), len(depth)
    first = nb + (1 if paper else 0)
    n = m + 2 * first
    base, capacity = np.zeros(n + 1), np.empty(n)
    base[1:nb] = plates.conductivity / np.diff(plate)[::-1]
    base[n - nb + 1 : n] = plates.conductivity / np.diff(plate)
    base[first + 1 : first + m] = _profile(pressing, 0.5 * (depth[1:] + depth[:-1]))[0] / np.diff(depth)
    volume = _volumes(depth)
    capacity[:nb] = plates.stored * _volumes(plate)[::-1]
    capacity[n - nb :] = plates.stored * _volumes(plate)
    capacity[first : first + m] = _profile(pressing, depth)[1] * volume
    if paper:
        capacity[nb] = capacity[first + m] = paper["capacity_J_m2K"]
        base[first] = base[first + m] = 2.0 / paper["resistance_m2K_W"]
    moisture = effects.get("moisture_evaporation", {}).get("moisture_percent", 0.0)
    low, high = pressing.platen_bottom, pressing.platen_top
    if (low.start, low.step, len(low.values)) != (high.start, high.step, len(high.values)):
        raise ValueError("both platens need the same knots")
    stack = PressStack(
        lower=nb - 1,
        first=first,
        last=first + m - 1,
        upper=n - nb,
        base=base,
        capacity=capacity,
        volume=volume,
        latent=LATENT_HEAT * moisture / 100.0 * panel.density * volume,
        skin=_shares(volume * np.exp(-depth / SKIN)),
        wet=_shares(volume * np.exp(-0.5 * ((panel.thickness - WET_DEPTH - depth) / WET_WIDTH) ** 2)),
        inner=volume * np.exp(-0.5 * ((depth / panel.thickness - 0.5) / INNER_WIDTH) ** 2),
        start=low.start,
        step=low.step,
        low=low.values,
        high=high.values,
    )
    return PressMesh(stack, depth)


def build_knobs(pressing: Pressing, mesh: PressMesh) -> Knobs:
    """Return every number of the pressing that is not attached to a node."""
    effects, outside, h = pressing.effects, pressing.outside, pressing.coefficients

    def of(effect: str, parameter: str, default: float) -> float:
        return float(effects.get(effect, {}).get(parameter, default))

    levels_off = of("contact_levelling", "share", 0.0)
    return Knobs(
        **_floats(h),
        **_floats({name: value for name, value in vars(outside).items() if name in Knobs._fields}),
        ambient=float(pressing.ambient),
        inserted=float(pressing.inserted),
        close_0=pressing.closed - pressing.closing_ramp / 2,
        close_1=pressing.closed + pressing.closing_ramp / 2,
        open_0=pressing.opened - pressing.opening_ramp / 2,
        open_1=pressing.opened + pressing.opening_ramp / 2,
        removed=float(pressing.removed),
        k_slope=of("conductivity_temperature", "per_100_K", 0.0) / 100.0,
        c_slope=of("heat_capacity_temperature", "per_100_K", 0.0) / 100.0,
        deficit=of("contact_buildup", "deficit", 0.0),
        tau=of("contact_buildup", "time_constant_s", 1.0),
        ratio=of("contact_asymmetry", "ratio", 1.0),
        k_step=of("conductivity_step", "lost", 0.0),
        k_step_at=of("conductivity_step", "temperature_C", 100.0),
        broken=of("contact_break", "lost", 0.0),
        broken_at=of("contact_break", "temperature_C", 100.0),
        load=pressing.pressure / LOAD_REFERENCE,
        load_law=1 if levels_off else 0,
        load_by=levels_off or of("contact_load", "exponent", 0.0),
        eased=float(pressing.eased),
        eased_from=float(pressing.eased_from),
        eased_to=float(pressing.eased_from + EASING_S),
        emissivity=of("open_radiation", "emissivity", 0.0),
        edge=of("edge_loss", "W_m3K", 0.0),
        vapour=of("vapour_convection", "W_m3K", 0.0),
        inner=1e3 * of("inner_source", "kW_m3", 0.0),
        vapour_uniform=pressing.vapour_law == "uniform",
        evap_t=of("moisture_evaporation", "temperature_C", 100.0),
        evap_width=SORBED_WIDTH if pressing.drying_law == "sorbed" else DRYING_WIDTH,
        evap_tau=DRYING_TIME,
        evap_kinetic=pressing.drying_law == "kinetic",
        cure_heat=of("resin_cure", "heat_kJ_m2", 0.0) * 1e3,
        cure_rate=CURE_RATE_150,
        cure_kelvin=CURE_ACTIVATION / GAS_CONSTANT,
        paper_r=of("paper_layer", "resistance_m2K_W", 0.0),
        footprint=of("thermocouple_footprint", "weight", 0.0),
        lag=of("thermocouple_lag", "time_constant_s", 0.0),
        lapse_factor=1.0 - outside.lapse_drop,
        split_r=float(outside.split_resistance),
        split_link=mesh.stack.first + int(np.searchsorted(mesh.depth, outside.split_depth)),
    )


def first_state(pressing: Pressing, mesh: PressMesh, plates: tuple[Array, Array] | None) -> NodeState:
    """Return temperatures at the start: `plates` as given, or steady without a panel between them."""
    s = mesh.stack
    T = np.full(len(s.capacity), float(pressing.panel.initial_temperature))
    below, above = slice(0, s.lower + 1), slice(s.upper, len(T))
    if plates is not None:
        T[below], T[above] = plates
    else:
        h = pressing.coefficients
        offset = pressing.effects.get("initial_press_state", {}).get("offset_K", 0.0)
        path = 1.0 / h["h_p_o"] + pressing.plates.resistance + 1.0 / h["h_ap"]
        passed = 1.0 / h["h_p_o"] + np.concatenate(([0.0], np.cumsum(1.0 / s.base[1 : s.lower + 1])))
        for place, platen in ((below, pressing.platen_bottom), (above, pressing.platen_top)):
            hot = float(platen.at(np.array([pressing.start]))[0])
            profile = hot - (hot - pressing.ambient) / path * passed + offset
            T[place] = profile if place is below else profile[::-1]
    x = np.zeros(5)
    x[3:] = pressing.panel.initial_temperature
    return NodeState(T, np.ones(len(s.volume)), x)


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


def _shares(weights: Array) -> Array:
    return np.asarray(weights / weights.sum())


def _floats(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}
