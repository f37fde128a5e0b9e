"""Panel and platen channels that are not simultaneous."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(clock=values["seconds"])


EFFECT = Effect(
    name="clock_offset",
    parameters=(
        Parameter(
            name="seconds",
            unit="s, > 0: panel later",
            neutral=0.0,
            typical=0.3,
            lower=-3.0,
            upper=3.0,
            source="two loggers, two clocks",
            shown_as=(1.0, "s"),
        ),
    ),
    terms=_terms,
    source="channel skew of multiplexed loggers",
    live=Live(Role.OF_THE_RUN),
    measuring=True,
    needs=Need.SWITCH,
    made_up_by=("closed_s", "opened_s"),
)
SECONDS = EFFECT.key("seconds")
"""By how much the panel's channels are late, as a model's parameter; its tangent is minus the readings' slope."""
