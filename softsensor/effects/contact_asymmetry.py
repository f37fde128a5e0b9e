"""Upper and lower contact that differ while the press is closed."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if len(scene.panel_contacts) < 2:
        return Terms()
    root = values["ratio"] ** 0.5
    return Terms(closed_contact={scene.panel_contacts[0]: 1.0 / root, scene.panel_contacts[-1]: root})


EFFECT = Effect(
    name="contact_asymmetry",
    meaning="Upper and lower contact differ while the press is closed; the coefficient is their geometric mean.",
    symptom="After closing one face runs above the simulation and the other below.",
    confirm="Turn the panel over, or exchange the press plates.",
    parameters=(
        Parameter(
            "ratio",
            "upper / lower",
            1.0,
            0.7,
            0.1,
            10.0,
            "worn plates, one-sided paper",
            0.0,
            1e-3,
            meaning="upper contact",
            told=(1.0, "times the lower one"),
        ),
    ),
    terms=_terms,
    source="two contact resistances in series with the panel; the split about their mean is assumed",
    core="Below 1 K in the middle; the hottest plane moves off it.",
    needs="panel",
    called="upper and lower contact that differ",
)
