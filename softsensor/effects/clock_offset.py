"""Panel and platen channels that are not simultaneous."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(clock=values["seconds"])


EFFECT = Effect(
    name="clock_offset",
    meaning="The panel channels are stamped later (or earlier) than the platen channels and the limit switch.",
    symptom="Every kink of the panel readings comes late by the same time, at closing and at opening.",
    confirm="Touch a platen and a panel thermocouple at once with a soldering iron and compare.",
    parameters=(
        Parameter(
            "seconds",
            "s, > 0: panel later",
            0.0,
            0.3,
            -3.0,
            3.0,
            "two loggers, two clocks",
            meaning="panel channels later than platen channels by",
            told=(1.0, "s"),
        ),
    ),
    terms=_terms,
    source="channel skew of multiplexed loggers",
    measuring=True,
    core="None by itself, but it bends the contact coefficients.",
    needs="closed",
    called="clocks that differ",
)
