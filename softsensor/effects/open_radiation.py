"""Radiation between the hot upper plate and the panel while the press is open."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(emissivity=values["emissivity"])


EFFECT = Effect(
    name="open_radiation",
    parameters=(
        Parameter(
            name="emissivity",
            unit="effective",
            neutral=0.0,
            typical=0.4,
            lower=0.0,
            upper=1.0,
            source="MDF 0.9 against steel 0.1 to 0.8",
            least=0,
            most=1.0,
            shown_as=(1.0, ""),
        ),
    ),
    terms=_terms,
    source="grey parallel plates with one effective emissivity",
    chance=0.55,
    live=Live(Role.SCATTER, with_states=True, straight=True),
    nonlinear=True,
    needs=Need.PANEL,
)
