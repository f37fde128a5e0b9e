"""Conductivity of the panel that changes with temperature."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import change_per_100_K


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(conductivity_slope=on_panel(scene, values["per_100_K"] / 100.0, 0.0))


EFFECT = Effect(
    name="conductivity_temperature",
    parameters=(change_per_100_K("Wood Handbook: 2-3 % per 10 K"),),
    terms=_terms,
    source="Wood Handbook, FPL-GTR-282, ch. 4: conductivity of wood rises by 2 to 3 % per 10 K",
    chance=0.03,
    live=Live(Role.HYPOTHESIS),
    nonlinear=True,
    needs=Need.PANEL,
    confirmed_in_core=True,
)
