"""Platen readings that are off by a constant."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(boundary_offset=(values["bottom_K"], values["top_K"]))


EFFECT = Effect(
    name="platen_offset",
    meaning="The platen thermocouples read too low (positive) or too high (negative) by a constant.",
    symptom="Both faces end off the simulation in a long pressing, in proportion to the heat taken up.",
    confirm="Compare the platen thermocouples with a calibrated one at working temperature.",
    parameters=(
        Parameter(
            "top_K",
            "K, true minus reading",
            0.0,
            3.0,
            -15.0,
            15.0,
            "class 1: 1.5 K, plus mounting",
            meaning="upper platen hotter than its reading by",
            told=(1.0, "K"),
        ),
        Parameter(
            "bottom_K",
            "K, true minus reading",
            0.0,
            3.0,
            -15.0,
            15.0,
            "class 1: 1.5 K, plus mounting",
            meaning="lower platen hotter than its reading by",
            told=(1.0, "K"),
        ),
    ),
    terms=_terms,
    source="IEC 60584-1 tolerance classes",
    measuring=True,
    core="About 0.3 K for each kelvin.",
    called="a platen reading that is off",
)
