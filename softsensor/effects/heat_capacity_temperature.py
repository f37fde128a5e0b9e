"""Heat capacity of the panel that changes with temperature."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(capacity_slope=on_panel(scene, values["per_100_K"] / 100.0, 0.0))


EFFECT = Effect(
    name="heat_capacity_temperature",
    meaning="The panel needs more heat per kelvin when hot than at room temperature.",
    symptom="The faces cool more slowly after opening than simulated while heating up fits.",
    confirm="Measure c at 20 to 100 °C (DSC), or press a panel with a core thermocouple.",
    parameters=(
        Parameter(
            "per_100_K",
            "of the value at 20 °C",
            0.0,
            0.2,
            -0.5,
            1.5,
            "dry wood about +0.3 % per K, assumed",
            0.25,
            meaning="rise of the heat capacity per 100 K",
            told=(100.0, "% of the value at 20 °C"),
        ),
    ),
    terms=_terms,
    source="heat capacity of wood rises with temperature; straight line assumed",
    core="With a rising heat capacity the core is 1 to 2 K cooler than simulated.",
    nonlinear=True,
    needs="panel",
    called="heat capacity that changes with temperature",
)
