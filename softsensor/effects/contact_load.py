"""A contact that depends on the pressure: h = h_ref (p / p_ref)^exponent."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter

REFERENCE_PRESSURE = 350.0
"""Where h_ref holds when the pressure comes from the run's settings. [N/cm²]

With a load column it holds at the contact's ``reference``, or, without one, at the median load of the run.
"""


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(closed_contact={m: np.exp(values["exponent"] * np.log(load)) for m, load in scene.load.items()})


EFFECT = Effect(
    name="contact_load",
    meaning="The contact between press and panel improves with pressure.",
    symptom="Residuals after closing change sign between runs at low and at high pressure.",
    confirm="Press the same kind of panel at three pressures.",
    parameters=(
        Parameter(
            "exponent",
            "-",
            0.0,
            0.7,
            -1.0,
            2.0,
            "0.95 for metal contacts; saturates for paper",
            meaning="the contact grows with the pressure to the power of",
        ),
    ),
    terms=_terms,
    source="power law, assumed; rough metal joints are known to follow about p^0.95",
    core="Below 1 K; it matters when the pressure is changed.",
    needs="load",
    called="contact that depends on pressure",
)
