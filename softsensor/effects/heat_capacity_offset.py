"""A panel whose volumetric heat capacity is not the nominal one."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(capacity=on_panel(scene, values["ratio"], 1.0))


EFFECT = Effect(
    name="heat_capacity_offset",
    meaning="The panel's density times heat capacity differs from the value in the run's header.",
    symptom="Faces run off the simulation in every state, least in thick panels early on.",
    confirm="Weigh and measure the panel; measure its heat capacity; press panels of different thickness.",
    parameters=(
        Parameter(
            "ratio",
            "true / nominal",
            1.0,
            1.15,
            0.4,
            2.5,
            "moisture and density spread",
            0.25,
            0.01,
            meaning="heat capacity of the panel",
            told=(1.0, "times nominal"),
        ),
    ),
    terms=_terms,
    source="density and moisture of a board scatter about nominal; assumed",
    core="The core is cooler (ratio above 1) or hotter by about 1 K for every 5 %.",
    needs="panel",
    called="heat capacity other than nominal",
)
