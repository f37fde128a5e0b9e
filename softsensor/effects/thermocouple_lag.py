"""Panel thermocouples that answer late."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Role, Scene, Terms
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(lag=values["time_constant_s"])


EFFECT = Effect(
    name="thermocouple_lag",
    parameters=(
        Parameter(
            name="time_constant_s",
            unit="s",
            neutral=0.0,
            typical=0.5,
            lower=0.0,
            upper=10.0,
            source="0.5 mm sheath 0.03 s, bare bead 0.5 s",
            least=0,
        ),
    ),
    terms=_terms,
    source="first-order sensor; makers' response times in water",
    chance=0.35,
    live=Live(Role.SCATTER),
    measuring=True,
)
