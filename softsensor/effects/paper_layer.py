"""The impregnated paper as a layer of its own on both faces."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(paper=(values["resistance_m2K_W"], values["capacity_J_m2K"]))


EFFECT = Effect(
    name="paper_layer",
    meaning="The impregnated paper on both faces resists and stores heat.",
    symptom="Faces answer later than simulated to closing, and the coefficient of the open press comes out low.",
    confirm="Press the same board bare.",
    parameters=(
        Parameter(
            "resistance_m2K_W",
            "m²K/W",
            1e-6,
            5e-4,
            1e-6,
            5e-3,
            "0.1-0.2 mm at 0.2-0.3 W/mK",
            0.25,
            1e-9,
            meaning="thermal resistance of the paper",
        ),
        Parameter(
            "capacity_J_m2K",
            "J/m²K",
            1.0,
            500.0,
            1.0,
            5000.0,
            "130-260 g/m² at 1.5 kJ/kgK",
            0.0,
            1e-6,
            meaning="heat capacity of the paper",
        ),
    ),
    terms=_terms,
    source="decor papers of 60-120 g/m², impregnated to about 2.2 times",
    core="Some tenths of a kelvin.",
    layers=True,
    needs="panel",
    called="an insulating paper layer",
)
