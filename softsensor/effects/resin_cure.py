"""The reaction heat of the resin in the impregnated paper on both faces."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from daq.press.resin_file import REFERENCE_C
from daq.records import COLDEST_C
from softsensor.effects.effect import Conversion, Effect, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import USUAL_SPREAD, Parameter

RATE = 0.06
"""Half cured, at the parameter's temperature; at the 165 °C of a closed press most of a resin for which that is
140 °C cures within 10 to 20 s. [1/s] By hand."""
ACTIVATION = 80e3
"""Activation energy of that cure. [J/mol] By hand. Both are those of deploy/resins/melamine_formaldehyde.toml."""
MOST_KJ_M2 = 80.0
"""More than any paper releases, of each face. [kJ/m²] By hand."""
SKIN = 0.08e-3
"""Depth under each face over which the heat is released, the paper's: 80 to 130 g/m² at some 1300 kg/m³ are 0.06
to 0.10 mm. Unverified. [m]"""


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if scene.face_cells is None:
        return Terms()
    first, last = scene.face_cells
    dx = scene.dx[first : last + 1]
    share = np.zeros(len(scene.dx))
    for order in (slice(None), slice(None, None, -1)):
        below = np.minimum(np.concatenate([[0.0], np.cumsum(dx[order])]), SKIN)
        share[first : last + 1] += (np.diff(below) / SKIN)[order] / dx
    heat = share * (values["heat_kJ_m2"] * 1e3)
    own = values["autocatalysis"]
    fast = RATE / (1.0 - 0.5 * own)
    return Terms(conversions=(Conversion(heat, 0, fast, ACTIVATION, values["temperature_C"] - COLDEST_C, own),))


EFFECT = Effect(
    name="resin_cure",
    parameters=(
        Parameter(
            name="heat_kJ_m2",
            unit="kJ/m² per face",
            neutral=0.0,
            typical=12.0,
            lower=0.0,
            upper=MOST_KJ_M2,
            source="80-130 g/m² x 50-150 J/g",
            spread=USUAL_SPREAD,
            least=0,
            shown_as=(1.0, "unit-kilojoule-per-face"),
        ),
        Parameter(
            name="temperature_C",
            unit="°C",
            neutral=REFERENCE_C,
            typical=REFERENCE_C,
            lower=REFERENCE_C - 30.0,
            upper=REFERENCE_C + 30.0,
            source="by hardener, up to five times as fast or as slow (by hand)",
        ),
        Parameter(
            name="autocatalysis",
            unit="-",
            neutral=0.0,
            typical=0.0,
            lower=0.0,
            upper=0.99,
            source="first order at 0; near 1 the cure begins by itself hardly at all",
            least=0,
            most=0.999,
            shown_as=(100.0, "%"),
        ),
    ),
    terms=_terms,
    source="Kamal & Sourour, Polym. Eng. Sci. 13, 59 (1973), both orders 1; an activation energy of 70 to 100 "
    "kJ/mol is assumed",
    chance=0.7,
    live=Live(Role.SCATTER, straight=True),
    nonlinear=True,
    needs=Need.PANEL,
    most_heat_J_m2=2.0e3 * MOST_KJ_M2,
)
