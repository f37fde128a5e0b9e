"""The impregnated paper as a layer of its own on both faces."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import USUAL_SPREAD, Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(paper=(values["resistance_m2K_W"], values["capacity_J_m2K"]))


EFFECT = Effect(
    name="paper_layer",
    parameters=(
        Parameter(
            name="resistance_m2K_W",
            unit="m²K/W",
            neutral=1e-6,
            typical=5e-4,
            lower=1e-6,
            upper=5e-3,
            source="0.1-0.2 mm at 0.2-0.3 W/mK",
            spread=USUAL_SPREAD,
            least=1e-09,
        ),
        Parameter(
            name="capacity_J_m2K",
            unit="J/m²K",
            neutral=1.0,
            typical=500.0,
            lower=1.0,
            upper=5000.0,
            source="130-260 g/m² at 1.5 kJ/kgK",
            least=1e-06,
        ),
    ),
    terms=_terms,
    source="decor papers of 60-120 g/m², impregnated to about 2.2 times",
    chance=1.0,
    live=Live(Role.SCATTER),
    layers=True,
    needs=Need.PANEL,
)
