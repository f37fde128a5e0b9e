"""Steam that carries heat from the hot layers of the closed panel to its cool ones."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(convection=values["W_m3K"])


EFFECT = Effect(
    name="vapour_convection",
    meaning="While the press is closed, steam carries heat from layers above 100 °C into cooler ones.",
    symptom="The surfaces need more heat than simulated while closed; the core runs ahead by kelvins.",
    confirm="Press one sacrificial panel with a thermocouple in its middle.",
    parameters=(
        Parameter(
            "W_m3K",
            "W/m³K",
            0.0,
            1.2e4,
            0.0,
            1.0e5,
            "order of magnitude, assumed",
            0.25,
            0.0,
            meaning="heat carried by steam, per volume and kelvin above 100 °C",
        ),
    ),
    terms=_terms,
    source="steam moves heat inwards in hot-pressed mats (Humphrey & Bolton 1989); this lumped law is assumed",
    core="The core is hotter than simulated, typically by 2 to 7 K.",
    nonlinear=True,
    closed_step_s=0.1,
    needs="panel",
    called="steam that carries heat",
)
