"""The catalogue: one short module an effect. Users add theirs through the entry point group below."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from daq.records import InputError
from softsensor.effects import (
    clock_offset,
    conductivity_offset,
    conductivity_temperature,
    contact_asymmetry,
    contact_buildup,
    contact_load,
    density_profile,
    edge_loss,
    heat_capacity_offset,
    heat_capacity_temperature,
    initial_press_state,
    moisture_evaporation,
    open_radiation,
    paper_layer,
    platen_offset,
    resin_cure,
    sensor_fault,
    thermocouple_footprint,
    thermocouple_lag,
    vapour_convection,
)
from softsensor.effects.effect import Conversion, Effect, Scene, Terms, on_panel

ENTRY_POINTS = "kerntemp.effects"
"""A package that declares an entry point of this group, naming an `Effect`, adds to the catalogue."""

BUILT_IN: tuple[Effect, ...] = tuple(
    module.EFFECT
    for module in (
        moisture_evaporation,
        vapour_convection,
        resin_cure,
        conductivity_temperature,
        heat_capacity_temperature,
        conductivity_offset,
        heat_capacity_offset,
        density_profile,
        contact_buildup,
        contact_load,
        contact_asymmetry,
        paper_layer,
        open_radiation,
        edge_loss,
        initial_press_state,
        thermocouple_lag,
        thermocouple_footprint,
        clock_offset,
        platen_offset,
        sensor_fault,
    )
)


@cache
def catalogue() -> dict[str, Effect]:
    """Return every effect by name: the built-in ones, then those of installed packages."""
    effects = {effect.name: effect for effect in BUILT_IN}
    for point in entry_points(group=ENTRY_POINTS):
        effect = point.load()
        if not isinstance(effect, Effect):
            raise InputError(f"entry point {point.name} = {point.value}: not a softsensor.effects.Effect")
        if effect.name in effects:
            raise InputError(f"entry point {point.name}: an effect called {effect.name!r} exists already")
        effects[effect.name] = effect
    return effects


def find_effect(name: str) -> Effect:
    """Return the effect of that name. Raises InputError with the known names."""
    try:
        return catalogue()[name]
    except KeyError:
        raise InputError(f"effect {name!r} is not in the catalogue; known are {', '.join(catalogue())}") from None


__all__ = [
    "BUILT_IN",
    "ENTRY_POINTS",
    "Conversion",
    "Effect",
    "Scene",
    "Terms",
    "catalogue",
    "find_effect",
    "on_panel",
]
