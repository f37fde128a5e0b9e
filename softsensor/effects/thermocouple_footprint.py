"""A panel thermocouple pressed between two bodies reads a mixture of both."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(footprint=values["weight"])


EFFECT = Effect(
    name="thermocouple_footprint",
    meaning="While closed, the panel's thermocouples read a mixture of panel face and press face.",
    symptom="Readings jump upwards at closing and downwards at opening by a share of the contact's drop.",
    confirm="Use thinner wire, or put one thermocouple under a sheet of foil.",
    parameters=(
        Parameter(
            "weight",
            "of the press face",
            0.0,
            0.08,
            0.0,
            0.6,
            "wire 0.2 to 0.5 mm in the joint",
            0.0,
            0.0,
            1.0,
            meaning="share of the press face in the reading",
            told=(100.0, "%"),
        ),
    ),
    terms=_terms,
    source="a wire in a joint holds the faces apart and takes a mean of both; the share is assumed",
    measuring=True,
    core="Below 0.1 K, but it bends the contact coefficients.",
    needs="panel",
    called="panel sensors that read a mixture",
)
