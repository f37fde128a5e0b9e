"""Panel thermocouples that answer late."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(lag=values["time_constant_s"])


EFFECT = Effect(
    name="thermocouple_lag",
    meaning="The panel's thermocouples answer late.",
    symptom="Readings trail the simulation in proportion to their slope, most of all in the second after closing.",
    confirm="Dip one thermocouple into hot water and log its step response.",
    parameters=(
        Parameter(
            "time_constant_s",
            "s",
            0.0,
            0.5,
            0.0,
            10.0,
            "0.5 mm sheath 0.03 s, bare bead 0.5 s",
            0.0,
            0.0,
            meaning="time constant of the panel sensors",
        ),
    ),
    terms=_terms,
    source="first-order sensor; makers' response times in water",
    measuring=True,
    core="None by itself, but it bends the contact coefficients by a factor of up to 3.",
    called="panel sensors that answer late",
)
