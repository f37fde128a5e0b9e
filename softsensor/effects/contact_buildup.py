"""A contact that needs time to grow after the press has closed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if np.isnan(scene.closed_s):
        return Terms()
    tau = values["time_constant_s"]

    def share(edge: Any) -> Any:
        """Integral of exp(-(t - closed)+/tau) up to an edge of a step."""
        since = edge - scene.closed_s
        after = np.real(since) > 0
        late = np.where(after, since, 0.0)
        return np.where(after, 0.0, since) + tau * (1.0 - np.exp(-late / tau))

    mean = (share(scene.step_end) - share(scene.step_start)) / (scene.step_end - scene.step_start)
    factor = 1.0 - values["deficit"] * mean
    return Terms(closed_contact=dict.fromkeys(scene.panel_contacts, factor))


EFFECT = Effect(
    name="contact_buildup",
    meaning="The contact between press and panel grows for some seconds after closing (resin melts and flows).",
    symptom="The faces rise more slowly than simulated in the first seconds after closing, then catch up.",
    confirm="Repeat with bare panels and with twice the closing speed; log pressure.",
    parameters=(
        Parameter(
            "deficit",
            "-",
            0.0,
            0.6,
            0.0,
            0.98,
            "share of the contact still missing at closing",
            0.0,
            most=1.0,
            meaning="share of the contact still missing at closing",
            told=(100.0, "%"),
        ),
        Parameter(
            "time_constant_s",
            "s",
            7.0,
            7.0,
            0.5,
            40.0,
            "melting and flow within seconds",
            0.0,
            1e-3,
            meaning="time constant of its growth",
        ),
    ),
    terms=_terms,
    source="Byrd, FPL 338 (1979): contact coefficients in press drying rise with time and moisture",
    core="Small, some tenths of a kelvin, but it bends the coefficients by a factor of up to 1.8.",
    needs="panel",
    called="contact that grows after closing",
)
