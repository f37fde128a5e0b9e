"""A contact that depends on the pressure: h = h_ref (p / p_ref)^exponent."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Effect, LawOf, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import Parameter

REFERENCE_PRESSURE = 350.0
"""Where h_ref holds when the pressure comes from the run's settings. [N/cm²]

With a load column it holds at the contact's ``reference``, or, without one, at the median load of the run.
"""


LEAST_LOAD = 0.01
"""Smaller shares of a run's largest load, or of the reference, count as that: no contact vanishes. By hand."""


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(closed_contact={m: np.exp(values["exponent"] * np.log(load)) for m, load in scene.load.items()})


def _as_law(kind: LawOf, x: Any, _: float) -> Iterator[Any]:
    p = EFFECT.parameters[0]
    for exponent in np.linspace(p.lower, p.upper, 151) if kind is LawOf.CONTACT_BY_LOAD else ():
        if abs(exponent) > LEAST_EXPONENT:
            yield np.exp(exponent * np.log(x))


LEAST_EXPONENT = 0.1
"""Below it, the contact hardly depends on the pressure: 7 % between the pressure and half of it."""

EFFECT = Effect(
    name="contact_load",
    parameters=(
        Parameter(
            name="exponent",
            unit="-",
            neutral=0.0,
            typical=0.7,
            lower=-1.0,
            upper=2.0,
            source="0.95 for metal contacts; saturates for paper",
        ),
    ),
    terms=_terms,
    source="power law, assumed; rough metal joints are known to follow about p^0.95",
    chance=0.61,  # an exponent anywhere from 0 to 0.95 has the root mean square 0.95/√3 = 0.55 = √0.61 x 0.7
    live=Live(Role.SCATTER),
    needs=Need.LOAD,
    as_law=_as_law,
)
