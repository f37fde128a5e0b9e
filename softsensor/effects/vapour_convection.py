"""Steam that carries heat from the hot layers of the closed panel to its cool ones."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import USUAL_SPREAD, Parameter

SIZE_WITHIN = 3.0
"""Steam flows as any gas: the gas permeability of boards from one fibre, 18 kinds by adhesive, paraffin and
direction, spans 0.38e-13 to 6.26e-13 (Gorgan, J. Wood Forest Sci. Technol., jwfst.gau.ac.ir/article_789, abstract;
its unit does not matter). A range of 18 is 3.64 standard deviations (Tippett): 0.77, a factor of 2.2; densities
beside, and a factor of 2 in the law's own size: 3. [-]"""


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(convection=values["W_m3K"])


EFFECT = Effect(
    name="vapour_convection",
    parameters=(
        Parameter(
            name="W_m3K",
            unit="W/m³K",
            neutral=0.0,
            typical=1.2e4,
            lower=0.0,
            upper=1.0e5,
            source="order of magnitude, assumed",
            spread=USUAL_SPREAD,
            least=0,
            within=SIZE_WITHIN,
        ),
    ),
    terms=_terms,
    source="steam moves heat inwards in hot-pressed mats (Humphrey & Bolton 1989); this lumped law is assumed",
    chance=0.1,
    live=Live(Role.OWN_FILTER),  # what it does about a size of zero is half of what it does where it is at work
    nonlinear=True,
    needs=Need.PANEL,
    confirmed_in_core=True,
)
