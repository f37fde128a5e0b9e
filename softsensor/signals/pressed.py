"""Which thicknesses a press has had: panels within a norm's tolerance of each other are one product's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from softsensor.heat.model_file import PressedPanel
from softsensor.signals.doubt import one_product


def products(thicknesses_mm: Iterable[float]) -> tuple[PressedPanel, ...]:
    """Return the products that panels so thick were of, thinnest first, each at its panels' mean."""
    found: list[list[float]] = []
    for thickness in sorted(thicknesses_mm):
        if found and one_product(found[-1][0], thickness):
            found[-1].append(thickness)
        else:
            found.append([thickness])
    return tuple(PressedPanel(sum(group) / len(group), len(group)) for group in found)


def all_products(base: Sequence[PressedPanel], newer: Sequence[PressedPanel]) -> tuple[PressedPanel, ...]:
    """Return what a model's runs and newer ones were of; runs may be in both, so what is known keeps its count."""
    new = [p for p in newer if not any(one_product(p.thickness_mm, b.thickness_mm) for b in base)]
    return tuple(sorted((*base, *new), key=lambda p: p.thickness_mm))
