"""Upper and lower contact that differ while the press is closed."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Effect, LawOf, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import USUAL_SPREAD, Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if len(scene.panel_contacts) < 2:
        return Terms()
    root = values["ratio"] ** 0.5
    return Terms(closed_contact={scene.panel_contacts[0]: 1.0 / root, scene.panel_contacts[-1]: root})


def _as_law(kind: LawOf, x: Any, _: float) -> Iterator[Any]:
    ratio = EFFECT.parameters[0]
    for factor in np.geomspace(ratio.lower, ratio.upper, 1001) if kind in _SIDES else ():  # half a percent apart
        yield np.full(len(x), factor)


_SIDES = (LawOf.CONTACT_LOWER, LawOf.CONTACT_UPPER)

EFFECT = Effect(
    name="contact_asymmetry",
    parameters=(
        Parameter(
            name="ratio",
            unit="upper / lower",
            neutral=1.0,
            typical=0.7,
            lower=0.1,
            upper=10.0,
            source="worn plates, one-sided paper",
            spread=USUAL_SPREAD,
            least=0.001,
            shown_as=(1.0, "unit-times-the-lower-contact"),
        ),
    ),
    terms=_terms,
    source="two contact resistances in series with the panel; the split about their mean is assumed",
    chance=0.45,
    live=Live(Role.SCATTER, with_states=True),
    needs=Need.PANEL,
    as_law=_as_law,
)
