"""Single channels that are loose, drifting or swapped: found by comparing channels, not by a model term."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Role, Scene, Terms


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms()


EFFECT = Effect(
    name="sensor_fault",
    parameters=(),
    terms=_terms,
    source="comparison of each channel with the median of its face",
    live=Live(Role.OF_THE_RUN),
    measuring=True,
)
