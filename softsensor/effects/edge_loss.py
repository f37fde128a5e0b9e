"""Heat lost at the rim of the panel."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from softsensor.effects.effect import Effect, LawOf, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(exchange=on_panel(scene, values["W_m3K"], 0.0))


def _as_law(kind: LawOf, x: Any, _: float) -> Iterator[Any]:
    if kind is LawOf.EXCHANGE:
        yield np.ones_like(x)


EFFECT = Effect(
    name="edge_loss",
    parameters=(
        Parameter(
            name="W_m3K",
            unit="W/m³K",
            neutral=0.0,
            typical=1200.0,
            lower=0.0,
            upper=2.0e4,
            source="10 W/m²K over the rim of a small panel",
            least=0,
        ),
    ),
    terms=_terms,
    source="fin equation, Incropera & DeWitt, sec. 3.6",
    chance=0.02,
    live=Live(Role.HYPOTHESIS),
    needs=Need.PANEL,
    as_law=_as_law,
    at_the_rim=True,
)
