"""Heat lost at the rim of the panel."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms, on_panel
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(exchange=on_panel(scene, values["W_m3K"], 0.0))


EFFECT = Effect(
    name="edge_loss",
    meaning="Heat leaves through the rim of the panel.",
    symptom="Long pressings settle below the simulation; rim sensors read lower than centre ones.",
    confirm="Insulate the rim, or compare sensors at the rim with sensors in the middle.",
    parameters=(
        Parameter(
            "W_m3K",
            "W/m³K",
            0.0,
            1200.0,
            0.0,
            2.0e4,
            "10 W/m²K over the rim of a small panel",
            0.0,
            0.0,
            meaning="heat lost at the rim, per volume and kelvin above ambient",
        ),
    ),
    terms=_terms,
    source="fin equation, Incropera & DeWitt, sec. 3.6",
    core="The core is 2 to 4 K cooler than simulated in a long pressing.",
    needs="panel",
    called="heat lost at the rim",
)
