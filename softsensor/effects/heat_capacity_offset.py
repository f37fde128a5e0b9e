"""A panel whose volumetric heat capacity is not the nominal one."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import ratio_to_nominal


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(capacity=on_panel(scene, values["ratio"], 1.0))


EFFECT = Effect(
    name="heat_capacity_offset",
    parameters=(ratio_to_nominal("moisture and density spread"),),
    terms=_terms,
    source="density and moisture of a board scatter about nominal; assumed",
    chance=0.035,
    live=Live(Role.HYPOTHESIS),
    needs=Need.PANEL,
    of_constant="panel.heat_capacity_J_kgK",
)
