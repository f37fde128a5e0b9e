"""Conductivity of the panel that changes with temperature."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import REFERENCE_C, Effect, LawOf, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import change_per_100_K


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(conductivity_slope=on_panel(scene, values["per_100_K"] / 100.0, 0.0))


def _as_law(kind: LawOf, x: Any, _: float) -> Iterator[Any]:
    p = EFFECT.parameters[0]
    for slope in np.linspace(p.lower, p.upper, 151) if kind is LawOf.CONDUCTIVITY else ():
        factor = 1.0 + slope * (x - REFERENCE_C) / 100.0
        if factor.min() > 0.0:
            yield factor


EFFECT = Effect(
    name="conductivity_temperature",
    parameters=(change_per_100_K("Wood Handbook: 2-3 % per 10 K"),),
    terms=_terms,
    source="Wood Handbook, FPL-GTR-282, ch. 4: conductivity of wood rises by 2 to 3 % per 10 K",
    chance=0.03,
    live=Live(Role.HYPOTHESIS),
    nonlinear=True,
    needs=Need.PANEL,
    as_law=_as_law,
    confirmed_in_core=True,
)
