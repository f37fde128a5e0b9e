"""A panel whose conductivity is not the nominal one."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import ratio_to_nominal


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(conductivity=on_panel(scene, values["ratio"], 1.0))


EFFECT = Effect(
    name="conductivity_offset",
    parameters=(ratio_to_nominal("Wood Handbook: +-20 % between boards"),),
    terms=_terms,
    source="Wood Handbook, FPL-GTR-282, ch. 4: +-20 % about its rule for wood",
    chance=0.035,
    live=Live(Role.HYPOTHESIS),
    needs=Need.PANEL,
    of_constant="panel.conductivity_W_mK",
)
