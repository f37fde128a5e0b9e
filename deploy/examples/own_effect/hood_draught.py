"""A hood above the press draws air along the rim and cools the panel's upper half.

An effect is data and one function. The function gets a scene (mesh, press, run) and the parameters,
and returns `Terms`: here heat lost to ambient per volume, growing from the middle to the upper face.
It is called with complex numbers as well, which is how its derivatives come about, so it keeps to
plain algebra: no `abs`, no comparison of parameters.

Install it with ``pip install deploy/examples/own_effect``; `kerntemp diagnose` then tests it like the
built-in ones, and a model file may name it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from softsensor.effects import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(exchange=on_panel(scene, values["W_m3K"] * np.maximum(scene.z, 0.0), 0.0))


EFFECT = Effect(
    name="hood_draught",
    meaning="The hood above the press cools the upper half of the panel's rim.",
    symptom="In long pressings the upper face settles below the simulation, the lower one does not.",
    confirm="Switch the hood off for one pressing.",
    parameters=(Parameter("W_m3K", "W/m³K at the upper face", 0.0, 1500.0, 0.0, 2.0e4, "assumed"),),
    terms=_terms,
    source="fin equation with a film that grows with height; assumed",
    core="A kelvin or two too low.",
    needs="panel",
)
