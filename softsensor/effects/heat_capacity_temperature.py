"""Heat capacity of the panel that changes with temperature."""

from collections.abc import Iterator, Mapping
from typing import Any

from softsensor.effects.effect import REFERENCE_C, Effect, LawOf, Live, Need, Role, Scene, Terms, on_panel
from softsensor.effects.parameters import change_per_100_K


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(capacity_slope=on_panel(scene, values["per_100_K"] / 100.0, 0.0))


def _as_law(kind: LawOf, x: Any, _: float) -> Iterator[Any]:
    if kind is LawOf.HEAT:
        yield x - REFERENCE_C


EFFECT = Effect(
    name="heat_capacity_temperature",
    parameters=(change_per_100_K("dry wood about +0.3 % per K, assumed"),),
    terms=_terms,
    source="heat capacity of wood rises with temperature; straight line assumed",
    chance=0.02,
    live=Live(Role.HYPOTHESIS),
    nonlinear=True,
    needs=Need.PANEL,
    as_law=_as_law,
    confirmed_in_core=True,
)
