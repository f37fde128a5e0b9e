"""What is to be solved: values of the parameters, and by which of them to differentiate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from softsensor.effects import Terms


@dataclass(frozen=True)
class SolveRequest:
    """What a solve is for."""

    values: Mapping[str, float]
    """Of the parameters; nuisances left out are 0."""
    names: tuple[str, ...]
    """Parameters to differentiate by."""
    terms: Terms
    """Of all effects together."""
    d_terms: Mapping[str, Terms]
    """Their derivatives by those parameters that they depend on."""

    @property
    def boundary_shift(self) -> tuple[float, float]:
        """What is added to the measured boundary temperatures, bottom and top. [K]"""
        bottom, top = self.terms.boundary_offset
        values = self.values
        return float(bottom) + values.get("boundary_bottom_K", 0.0), float(top) + values.get("boundary_top_K", 0.0)
