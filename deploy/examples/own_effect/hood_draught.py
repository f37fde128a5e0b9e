"""A hood above the press draws air along the rim and cools the panel's upper half.

An effect is data, words and one function, all in this file. The function gets a scene (mesh, press, run) and the
parameters, and returns `Terms`: here heat lost to ambient per volume, growing from the middle to the upper face.
It is called with complex numbers as well, which is how its derivatives come about, so it keeps to
plain algebra: no `abs`, no comparison of parameters.

Install it with ``pip install deploy/examples/own_effect``. `kerntemp diagnose` then tests it like the built-in
ones, the live sensor doubts it as likely and as large as it says here, a model file may name it, and terminal,
reports and page use its words; languages that it lacks show the English ones.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from softsensor.effects import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(exchange=on_panel(scene, values["W_m3K"] * np.maximum(scene.z, 0.0), 0.0))


EFFECT = Effect(
    name="hood_draught",
    parameters=(
        Parameter(
            name="W_m3K",
            unit="W/m³K",
            neutral=0.0,
            typical=1500.0,
            lower=0.0,
            upper=2.0e4,
            source="assumed",
        ),
    ),
    terms=_terms,
    source="fin equation with a film that grows with height; assumed",
    chance=0.02,
    live=Live(Role.HYPOTHESIS),
    needs=Need.PANEL,
    words={
        "en": {
            "called": "a draught of the hood",
            "meaning": "The hood above the press cools the upper half of the panel's rim.",
            "symptom": "In long pressings the upper face settles below the simulation, the lower one does not.",
            "confirmed-by": "Switch the hood off for one pressing.",
            "core": "A kelvin or two too low.",
            "parameter-W_m3K": "heat lost at the top of the rim, per volume and kelvin above ambient",
        },
        "de": {
            "called": "Zug der Haube",
            "meaning": "Die Haube über der Presse kühlt den Rand der oberen Plattenhälfte.",
            "symptom": "In langen Pressungen bleibt die obere Seite unter der Simulation, die untere nicht.",
            "confirmed-by": "Die Haube für eine Pressung abschalten.",
            "core": "Ein bis zwei Kelvin zu niedrig.",
            "parameter-W_m3K": "am oberen Rand verlorene Wärme je Volumen und Kelvin über Umgebung",
        },
    },
)
