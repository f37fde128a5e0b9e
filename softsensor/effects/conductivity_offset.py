"""A panel whose conductivity is not the nominal one."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(conductivity=on_panel(scene, values["ratio"], 1.0))


EFFECT = Effect(
    name="conductivity_offset",
    parameters=(
        Parameter(
            name="ratio",
            unit="true / nominal",
            neutral=1.0,
            typical=1.15,
            lower=0.4,
            upper=2.5,
            source="Wood Handbook: +-20 % between boards",
            spread=0.25,
            least=0.01,
            told=(1.0, "unit-times-nominal"),
        ),
    ),
    terms=_terms,
    source="Wood Handbook, FPL-GTR-282, ch. 4: +-20 % about its rule for wood",
    chance=0.035,
    live=Live(Role.HYPOTHESIS, absent=0.06),
    needs=Need.PANEL,
)
