"""Faces denser than the middle."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    factor = on_panel(scene, 1.0 + values["amplitude"] * (scene.z**4 - 0.2), 1.0)
    return Terms(conductivity=factor, capacity=factor)


EFFECT = Effect(
    name="density_profile",
    parameters=(
        Parameter(
            name="amplitude",
            unit="-",
            neutral=0.0,
            typical=0.25,
            lower=-0.8,
            upper=1.1,
            source="faces 1.2 to 1.4 times the core, assumed",
            spread=0.25,
            least=-1.2,
            most=4.9,
            told=(100.0, "unit-percent-of-mean"),
        ),
    ),
    terms=_terms,
    source="boards are denser at their faces; the fourth-power shape is assumed",
    chance=0.02,
    live=Live(Role.HYPOTHESIS, one_sided=True),
    needs=Need.PANEL,
    confirmed_in_core=True,
)
