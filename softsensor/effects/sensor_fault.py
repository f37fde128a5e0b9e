"""Single channels that are loose, drifting or swapped: found by comparing channels, not by a model term."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms()


EFFECT = Effect(
    name="sensor_fault",
    meaning="Single channels are loose, drifting or swapped.",
    symptom="One channel departs from its neighbours on the same face.",
    confirm="Check the named thermocouples: fixing, polarity, plug position.",
    parameters=(),
    terms=_terms,
    source="comparison of each channel with the median of its face",
    measuring=True,
    core="None: the channel is left out.",
    called="a faulty sensor",
)
