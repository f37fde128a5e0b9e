"""Plates that still remember the pressing before."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Role, Scene, Terms
from softsensor.effects.parameters import USUAL_SPREAD, Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(plates_offset=values["offset_K"])


EFFECT = Effect(
    name="initial_press_state",
    parameters=(
        Parameter(
            name="offset_K",
            unit="K",
            neutral=0.0,
            typical=-7.0,
            lower=-60.0,
            upper=60.0,
            source="plates take 15 to 60 s to recover",
            spread=USUAL_SPREAD,
        ),
    ),
    terms=_terms,
    source="thermal memory of the plates: thickness x rho c / h",
    chance=0.5,
    live=Live(Role.SCATTER, with_states=True, straight=True),
)
