"""Plates that still remember the pressing before."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(plates_offset=values["offset_K"])


EFFECT = Effect(
    name="initial_press_state",
    meaning="The press plates are still cooler (or warmer) than at rest when the panel comes in.",
    symptom="The lower face is off from the moment of insertion, and the deviation fades within a minute.",
    confirm="Wait two minutes between pressings, or tape a thermocouple to a press plate.",
    parameters=(
        Parameter(
            "offset_K",
            "K",
            0.0,
            -7.0,
            -60.0,
            60.0,
            "plates take 15 to 60 s to recover",
            0.25,
            meaning="plates at the start, above their steady temperature by",
        ),
    ),
    terms=_terms,
    source="thermal memory of the plates: thickness x rho c / h",
    core="Below 0.5 K.",
    called="plates that remember the pressing before",
)
