"""Water that leaves the panel for good and takes its latent heat along."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Conversion, Effect, LawOf, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import USUAL_SPREAD, Parameter

LATENT_HEAT = 2.4e6
"""Heat of vaporisation at 100 °C (2.26 MJ/kg) plus sorption heat below 10 % moisture. [J/kg]"""
RATE = 0.05
"""How fast water leaves above the temperature, assumed. [1/sK]"""
SOFTNESS = 2.0
"""Width of the onset, assumed. [K]"""


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if scene.panel is None:
        return Terms()
    dry = scene.panel.density / (1.0 + (scene.panel.moisture_percent or 0.0) / 100.0)
    heat = -LATENT_HEAT * dry * values["moisture_percent"] / 100.0
    return Terms(conversions=(Conversion(on_panel(scene, heat, 0.0), 1, RATE, values["temperature_C"], SOFTNESS),))


def _as_law(kind: LawOf, x: Any, apart: float) -> Iterator[Any]:
    for boils in np.arange(92.0, 112.0, 2.0) if kind is LawOf.HEAT else ():
        for width in (0.5 * apart, 0.75 * apart, apart):
            yield np.exp(-0.5 * ((x - boils) / width) ** 2)


EFFECT = Effect(
    name="moisture_evaporation",
    parameters=(
        Parameter(
            name="moisture_percent",
            unit="% of dry mass",
            neutral=0.0,
            typical=3.0,
            lower=0.0,
            upper=30.0,
            source="board moisture 5 to 12 %",
            spread=USUAL_SPREAD,
            least=0,
            shown_as=(1.0, "unit-percent-of-dry-mass"),
            sd=2.0,
        ),
        Parameter(
            name="temperature_C",
            unit="°C",
            neutral=103.0,
            typical=103.0,
            lower=80.0,
            upper=130.0,
            source="boiling point with pore pressure",
            sd=3.0,
        ),
    ),
    terms=_terms,
    source="plateau of hot-pressed mats near 100 °C; rate and softness of the onset are assumed",
    chance=0.03,
    live=Live(Role.OWN_FILTER),
    nonlinear=True,
    needs=Need.PANEL,
    as_law=_as_law,
)
