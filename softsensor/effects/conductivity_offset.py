"""A panel whose conductivity is not the nominal one."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(conductivity=on_panel(scene, values["ratio"], 1.0))


EFFECT = Effect(
    name="conductivity_offset",
    meaning="The panel's conductivity differs from the value in the run's header.",
    symptom="Faces run off the simulation in proportion to the square root of time, in every state.",
    confirm="Measure k of this board, or press panels of different thickness.",
    parameters=(
        Parameter(
            "ratio",
            "true / nominal",
            1.0,
            1.15,
            0.4,
            2.5,
            "Wood Handbook: +-20 % between boards",
            0.25,
            0.01,
            meaning="conductivity of the panel",
            told=(1.0, "times nominal"),
        ),
    ),
    terms=_terms,
    source="Wood Handbook, FPL-GTR-282, ch. 4: +-20 % about its rule for wood",
    core="The core is hotter (ratio above 1) or cooler by about 1 K for every 5 %.",
    needs="panel",
    called="conductivity other than nominal",
)
