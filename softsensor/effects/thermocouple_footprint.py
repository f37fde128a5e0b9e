"""A panel thermocouple pressed between two bodies reads a mixture of both."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(footprint=values["weight"])


EFFECT = Effect(
    name="thermocouple_footprint",
    parameters=(
        Parameter(
            name="weight",
            unit="of the press face",
            neutral=0.0,
            typical=0.08,
            lower=0.0,
            upper=0.6,
            source="wire 0.2 to 0.5 mm in the joint",
            least=0,
            most=1.0,
            shown_as=(100.0, "%"),
        ),
    ),
    terms=_terms,
    source="a wire in a joint holds the faces apart and takes a mean of both; the share is assumed",
    chance=0.4,
    live=Live(Role.SCATTER),
    measuring=True,
    needs=Need.PANEL,
)
