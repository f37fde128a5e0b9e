"""Water that leaves the panel for good and takes its latent heat along."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Conversion, Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter

LATENT_HEAT = 2.4e6
"""Heat of vaporisation at 100 °C (2.26 MJ/kg) plus sorption heat below 10 % moisture. [J/kg]"""
RATE = 0.05
"""How fast water leaves above the temperature, assumed. [1/sK]"""
SOFTNESS = 2.0
"""Width of the onset, assumed. [K]"""


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if scene.panel is None:
        return Terms()
    dry = scene.panel.density / (1.0 + (scene.panel.moisture_percent or 0.0) / 100.0)
    heat = -LATENT_HEAT * dry * values["moisture_percent"] / 100.0
    return Terms(conversions=(Conversion(on_panel(scene, heat, 0.0), 1, RATE, values["temperature_C"], SOFTNESS),))


EFFECT = Effect(
    name="moisture_evaporation",
    meaning="Water evaporates in the panel, leaves it, and takes latent heat along.",
    symptom="Readings stop rising or lag behind near 85 to 115 °C and stay below the simulation afterwards.",
    confirm="Weigh the panel before and after pressing, or press one dried to zero moisture.",
    parameters=(
        Parameter(
            "moisture_percent",
            "% of dry mass",
            0.0,
            3.0,
            0.0,
            30.0,
            "board moisture 5 to 12 %",
            0.25,
            0.0,
            meaning="water that evaporates",
        ),
        Parameter(
            "temperature_C",
            "°C",
            103.0,
            103.0,
            80.0,
            130.0,
            "boiling point with pore pressure",
            meaning="temperature from which it evaporates",
        ),
    ),
    terms=_terms,
    source="plateau of hot-pressed mats near 100 °C; rate and softness of the onset are assumed",
    core="The core heats more slowly than simulated once steam forms: several kelvin too low.",
    nonlinear=True,
    needs="panel",
    called="evaporating moisture",
)
