"""Faces denser than the middle."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    factor = on_panel(scene, 1.0 + values["amplitude"] * (scene.z**4 - 0.2), 1.0)
    return Terms(conductivity=factor, capacity=factor)


EFFECT = Effect(
    name="density_profile",
    meaning="The panel's faces are denser than its middle; density and conductivity follow 1 + a (z^4 - 0.2).",
    symptom="Faces take up more heat than simulated just after closing and less later.",
    confirm="Measure the density profile (X-ray), or press a panel with a core thermocouple.",
    parameters=(
        Parameter(
            "amplitude",
            "-",
            0.0,
            0.25,
            -0.8,
            1.1,
            "faces 1.2 to 1.4 times the core, assumed",
            0.25,
            -1.2,
            4.9,
            meaning="faces denser than the middle by",
            told=(100.0, "% of the mean"),
        ),
    ),
    terms=_terms,
    source="boards are denser at their faces; the fourth-power shape is assumed",
    core="The core is 1 to 3 K off, since its layers hold less heat and conduct less.",
    needs="panel",
    called="faces denser than the middle",
)
