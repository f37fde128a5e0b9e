"""A physical number with its unit, limits and source."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect."""

    name: str
    unit: str
    neutral: float
    """The value at which the effect is absent."""
    typical: float
    """A physical size to try first; differences to `neutral` of this size are what a diagnosis tests."""
    lower: float
    upper: float
    source: str
    spread: float = 0.0
    """How much it differs between pressings, as a share of its value; 0 where all share one value."""
    least: float = -inf
    most: float = inf
    """What can be at all, wider than the limits of a search: beyond, the equations mean nothing."""

    def check(self, value: float) -> None:
        """Raise ValueError when a value lies outside the limits."""
        if not self.lower <= value <= self.upper:
            raise ValueError(
                f"{self.name} = {value:g} {self.unit} lies outside its limits "
                f"{self.lower:g}..{self.upper:g} {self.unit} ({self.source})"
            )
