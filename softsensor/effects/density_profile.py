"""Faces denser than the middle, as hot pressing makes them.

Lighter ones are another thing and take a press schedule of its own (step-closing: Wang et al., Holz Roh Werkst. 59
(2001) 19). A search that might turn this cause round took wet panels of another law for some 30 to 40 % lighter at
their faces (`tests.second_press`, moisture, seeds 5010, 5013).
"""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import USUAL_SPREAD, Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    factor = on_panel(scene, 1.0 + values["amplitude"] * (scene.z**4 - 0.2), 1.0)  # its mean, by definition
    return Terms(conductivity=factor, capacity=factor)


EFFECT = Effect(
    name="density_profile",
    parameters=(
        Parameter(
            name="amplitude",
            unit="-",
            neutral=0.0,
            typical=0.25,
            lower=0.0,
            upper=1.1,
            source="faces 1.2 to 1.4 times the core, assumed; lighter ones are not this cause",
            spread=USUAL_SPREAD,
            least=-1.2,
            most=4.9,
            shown_as=(100.0, "unit-percent-of-mean"),
        ),
    ),
    terms=_terms,
    source="boards are denser at their faces; the fourth-power shape is assumed",
    chance=0.02,
    live=Live(Role.HYPOTHESIS),
    needs=Need.PANEL,
    confirmed_in_core=True,
)
