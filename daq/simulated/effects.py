"""What can be hidden in the virtual press: the contract's effects at random sizes, and faults outside them.

Sizes are those at which a cause must be named (facts on the thermal model, section 7). An effect that
lies in the panel differs from run to run by 25 %; the rest belongs to press or measuring chain and stays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from daq.records import InputError
from daq.simulated.physics_pressing import OutsideFault, Pressing
from daq.words import say

Parameters = Mapping[str, float]

SIZES: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "moisture_evaporation": {"moisture_percent": (2.0, 6.0), "temperature_C": (98.0, 106.0)},
        "vapour_convection": {"W_m3K": (1e4, 2e4)},
        "resin_cure": {"heat_kJ_m2": (10.0, 25.0)},
        "conductivity_temperature": {"per_100_K": (0.12, 0.30)},
        "heat_capacity_temperature": {"per_100_K": (0.12, 0.30)},
        "conductivity_offset": {"ratio": (1.10, 1.20)},
        "heat_capacity_offset": {"ratio": (1.10, 1.20)},
        "density_profile": {"amplitude": (0.15, 0.30)},
        "contact_buildup": {"deficit": (0.4, 0.8), "time_constant_s": (4.0, 12.0)},
        "contact_load": {"exponent": (0.5, 1.0)},
        "contact_asymmetry": {"ratio": (0.6, 0.8)},
        "paper_layer": {"resistance_m2K_W": (3e-4, 8e-4), "capacity_J_m2K": (300.0, 800.0)},
        "open_radiation": {"emissivity": (0.3, 0.7)},
        "edge_loss": {"W_m3K": (800.0, 2000.0)},
        "initial_press_state": {"offset_K": (4.0, 10.0)},
        "thermocouple_lag": {"time_constant_s": (0.3, 1.0)},
        "thermocouple_footprint": {"weight": (0.05, 0.12)},
        "clock_offset": {"seconds": (0.2, 0.5)},
        "platen_offset": {"top_K": (2.0, 4.0), "bottom_K": (2.0, 4.0)},
        "sensor_fault": {},
    }
)
"""Every effect of the contract, and from where to where its parameters are drawn."""

OUTSIDE = (
    "contact_lapse",
    "delamination",
    "heater_zone_out",
    "steam_condensation",
    "draught",
    "lifted_panel",
    "steam_burst",
)
"""Faults that are in no catalogue and that no combination of its entries explains."""

UNLISTED: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "contact_levelling": {"share": (0.3, 0.8)},
        "contact_break": {"lost": (0.3, 0.6), "temperature_C": (140.0, 160.0)},
        "conductivity_step": {"lost": (0.25, 0.5), "temperature_C": (60.0, 110.0)},
        "inner_source": {"kW_m3": (600.0, 1500.0)},
    }
)
"""Laws of physics that are in no catalogue, and from where to where their parameters are drawn.

``contact_levelling``: a contact grows with the pressure p as 1 - exp(-p / (share p_ref)), 1 at the reference.
``contact_break``: both contacts lose a share where the face they touch is above a temperature.
``conductivity_step``: the panel's conductivity loses a share above a temperature.
``inner_source``: heat released about the middle of the panel as long as the press is closed.
"""

_DRAWN = {**SIZES, **UNLISTED}

CHAIN_EFFECTS = ("clock_offset", "platen_offset", "sensor_fault")
"""Put in by the measuring chain, not by the physics."""

_PANEL_SIZE = {
    "moisture_evaporation": "moisture_percent",
    "vapour_convection": "W_m3K",
    "resin_cure": "heat_kJ_m2",
    "conductivity_temperature": "per_100_K",
    "heat_capacity_temperature": "per_100_K",
    "conductivity_offset": "ratio",
    "heat_capacity_offset": "ratio",
    "density_profile": "amplitude",
    "paper_layer": "resistance_m2K_W",
}
"""Causes in the panel, and the parameter that differs from panel to panel."""


def draw_effect(name: str, rng: np.random.Generator, scale: float = 1.0) -> dict[str, float]:
    """Return an effect's parameters, drawn at the size range; `scale` 0.5 halves the size.

    Offsets of conductivity and heat capacity lie above or below nominal with equal chance, platen
    offsets take either sign on each side, sensor faults are drawn later, run by run.
    """
    if name not in _DRAWN:
        raise InputError(say("simulated-no-effect", name=name, known=(*_DRAWN, *OUTSIDE)))
    drawn = {key: float(rng.uniform(*limits)) for key, limits in _DRAWN[name].items()}
    if name in UNLISTED:
        return drawn
    if name.endswith("_offset") and "ratio" in drawn:
        sign = 1.0 if rng.random() < 0.5 else -1.0
        return {"ratio": 1.0 + sign * scale * (drawn["ratio"] - 1.0)}
    if name == "contact_asymmetry":
        ratio = 1.0 - scale * (1.0 - drawn["ratio"])
        return {"ratio": ratio if rng.random() < 0.5 else 1.0 / ratio}
    if name == "platen_offset":
        return {key: scale * value * (1.0 if rng.random() < 0.5 else -1.0) for key, value in drawn.items()}
    keep = ("temperature_C", "time_constant_s") if name != "thermocouple_lag" else ("temperature_C",)
    return {key: value if key in keep else scale * value for key, value in drawn.items()}


def usual_effect(name: str) -> dict[str, float]:
    """Return the parameters of an effect of the contract in the middle of its size range."""
    return {key: 0.5 * (low + high) for key, (low, high) in SIZES[name].items()}


def for_run(name: str, parameters: Parameters, rng: np.random.Generator, spread: float = 0.25) -> dict[str, float]:
    """Return what an effect amounts to in one run: causes in the panel differ from panel to panel."""
    factor = max(0.2, 1.0 + spread * rng.standard_normal())
    key = _PANEL_SIZE.get(name)
    if key is None or key not in parameters:
        return dict(parameters)
    varied = dict(parameters)
    varied[key] = 1.0 + factor * (varied[key] - 1.0) if key == "ratio" else factor * varied[key]
    return varied


def draw_outside(name: str, rng: np.random.Generator, scale: float = 1.0) -> dict[str, float]:
    """Return the parameters of a fault outside the catalogue; times are shares of the press time."""
    if name == "contact_lapse":
        lasts = 2.0 if rng.random() < 0.5 else float(rng.uniform(0.25, 0.6))
        return {"drop": scale * rng.uniform(0.25, 0.6), "from_share": rng.uniform(0.25, 0.5), "lasts_share": lasts}
    if name == "delamination":
        return {
            "resistance_m2K_W": scale * rng.uniform(0.008, 0.02),
            "depth_mm": rng.uniform(1.0, 2.0),
            "from_share": rng.uniform(0.2, 0.4),
        }
    if name == "heater_zone_out":
        return {"K_s": scale * rng.uniform(0.3, 0.7), "from_share": rng.uniform(-0.2, 0.2)}
    if name == "steam_condensation":
        return {
            "heat_kJ_m2": scale * rng.uniform(20.0, 40.0),
            "release_share": rng.uniform(0.15, 0.25),
            "return_share": rng.uniform(0.5, 0.7),
        }
    if name == "draught":
        return {"factor": 1.0 + scale * rng.uniform(1.0, 2.5), "after_s": rng.uniform(5.0, 12.0)}
    if name == "lifted_panel":
        return {"factor": 1.0 - scale * rng.uniform(0.7, 0.9), "after_s": rng.uniform(4.0, 10.0)}
    if name == "steam_burst":
        return {"per_s": scale * rng.uniform(0.04, 0.12), "lasts_s": rng.uniform(2.0, 4.0)}
    raise InputError(say("simulated-no-fault", name=name, known=tuple(OUTSIDE)))


def with_outside(pressing: Pressing, faults: Mapping[str, Parameters]) -> Pressing:
    """Return the pressing with faults outside the catalogue put in (but a heater zone: see the campaign)."""
    fields: dict[str, float] = {}
    for name in faults.keys() & _OUTSIDE_FIELDS.keys():
        fields |= _OUTSIDE_FIELDS[name](pressing, faults[name])
    return replace(pressing, outside=OutsideFault(**fields))


def _when(pressing: Pressing, share: float) -> float:
    """Return the time at which the press has been closed for a share of its press time. [s]"""
    return pressing.closed + share * (pressing.opened - pressing.closed)


def _lapse(pressing: Pressing, p: Parameters) -> dict[str, float]:
    until = min(p["from_share"] + p["lasts_share"], 1.2)
    begun = _when(pressing, p["from_share"])
    return {"lapse_drop": p["drop"], "lapse_from": begun, "lapse_to": _when(pressing, until)}


def _split(pressing: Pressing, p: Parameters) -> dict[str, float]:
    depth = pressing.panel.thickness - p["depth_mm"] / 1000.0
    begun = _when(pressing, p["from_share"])
    return {"split_resistance": p["resistance_m2K_W"], "split_depth": depth, "split_from": begun}


def _condensed(pressing: Pressing, p: Parameters) -> dict[str, float]:
    return {
        "wet_heat": p["heat_kJ_m2"] * 1e3,
        "wet_release": _when(pressing, p["release_share"]),
        "wet_return": _when(pressing, p["return_share"]),
        "wet_width": max(1.0, 0.04 * (pressing.opened - pressing.closed)),
    }


_OUTSIDE_FIELDS: dict[str, Callable[[Pressing, Parameters], dict[str, float]]] = {
    "contact_lapse": _lapse,
    "delamination": _split,
    "steam_condensation": _condensed,
    "draught": lambda now, p: {"draught": p["factor"], "draught_from": now.opened + p["after_s"]},
    "lifted_panel": lambda now, p: {"lift": p["factor"], "lift_from": now.opened + p["after_s"]},
    "steam_burst": lambda now, p: {
        "flash_rate": p["per_s"],
        "flash_from": now.opened,
        "flash_to": now.opened + p["lasts_s"],
    },
}
"""What each fault sets of a pressing's `OutsideFault`."""


def split_names(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return catalogue names and outside names of a list; raise InputError for any other."""
    for name in names:
        if name not in _DRAWN and name not in OUTSIDE:
            raise InputError(say("simulated-no-effect", name=name, known=(*_DRAWN, *OUTSIDE)))
    return [n for n in names if n not in OUTSIDE], [n for n in names if n in OUTSIDE]
