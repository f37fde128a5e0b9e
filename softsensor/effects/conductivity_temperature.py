"""Conductivity of the panel that changes with temperature."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(conductivity_slope=on_panel(scene, values["per_100_K"] / 100.0, 0.0))


EFFECT = Effect(
    name="conductivity_temperature",
    meaning="The panel conducts heat differently when hot than at room temperature.",
    symptom="Late in the pressing and after opening the faces drift off the simulation, more so for thick panels.",
    confirm="Measure k at 25 and 100 °C (guarded hot plate), or press a panel with a core thermocouple.",
    parameters=(
        Parameter(
            "per_100_K",
            "of the value at 20 °C",
            0.0,
            0.2,
            -0.5,
            1.5,
            "Wood Handbook: 2-3 % per 10 K",
            0.25,
            meaning="rise of the conductivity per 100 K",
            told=(100.0, "% of the value at 20 °C"),
        ),
    ),
    terms=_terms,
    source="Wood Handbook, FPL-GTR-282, ch. 4: conductivity of wood rises by 2 to 3 % per 10 K",
    core="With a rising conductivity the core is 1 to 4 K hotter than simulated.",
    nonlinear=True,
    needs="panel",
    called="conductivity that changes with temperature",
)
