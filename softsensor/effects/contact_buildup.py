"""A contact that needs time to grow after the press has closed."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Effect, LawOf, Live, Need, Role, Scene, Terms
from softsensor.effects.parameters import Parameter


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


def _as_law(kind: LawOf, x: Any, _: float) -> Iterator[Any]:
    tau = EFFECT.parameters[1]
    for missing in np.linspace(0.1, 0.95, 18) if kind is LawOf.CONTACT else ():
        for seconds in np.geomspace(tau.lower, tau.upper, 15):
            built = 1.0 - missing * np.exp(-x / seconds)
            yield built / built[-1]


EFFECT = Effect(
    name="contact_buildup",
    parameters=(
        Parameter(
            name="deficit",
            unit="-",
            neutral=0.0,
            typical=0.6,
            lower=0.0,
            upper=0.98,
            source="share of the contact still missing at closing",
            most=1.0,
            shown_as=(100.0, "%"),
        ),
        Parameter(
            name="time_constant_s",
            unit="s",
            neutral=7.0,
            typical=7.0,
            lower=0.5,
            upper=40.0,
            source="melting and flow within seconds",
            least=0.001,
        ),
    ),
    terms=_terms,
    source="Byrd, FPL 338 (1979): contact coefficients in press drying rise with time and moisture",
    chance=0.25,
    live=Live(Role.SCATTER, with_states=True),
    needs=Need.PANEL,
    as_law=_as_law,
)
