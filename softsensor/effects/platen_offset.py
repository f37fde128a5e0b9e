"""Platen readings that are off by a constant."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Role, Scene, Terms
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(boundary_offset=(values["bottom_K"], values["top_K"]))


EFFECT = Effect(
    name="platen_offset",
    parameters=tuple(
        Parameter(
            name=f"{end}_K",
            unit="K, true minus reading",
            neutral=0.0,
            typical=3.0,
            lower=-15.0,
            upper=15.0,
            source="class 1: 1.5 K, plus mounting",
            shown_as=(1.0, "K"),
        )
        for end in ("top", "bottom")
    ),
    terms=_terms,
    source="IEC 60584-1 tolerance classes",
    live=Live(Role.OF_THE_RUN),
    measuring=True,
    made_up_by=("boundary_top_K", "boundary_bottom_K"),
)
