"""A physical number with its unit, limits and source, and how people are told it."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from math import inf, isfinite


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
    meaning: str = ""
    """What it is, in words an operator knows; the name stands in where there are none."""
    told: tuple[float, str] | None = None
    """Factor and unit people are told it with, such as (100, "%"); None: the value itself with `unit`."""

    @property
    def words(self) -> str:
        """What people call it."""
        return self.meaning or self.name.replace("_", " ")

    @property
    def scale(self) -> tuple[float, str]:
        """Factor and unit people are told it with; no unit where `unit` is a dash."""
        return self.told or (1.0, self.unit.strip("-"))

    def check(self, value: float) -> None:
        """Raise ValueError when a value lies outside the limits."""
        if not self.lower <= value <= self.upper:
            raise ValueError(
                f"{self.name} = {value:g} {self.unit} lies outside its limits "
                f"{self.lower:g}..{self.upper:g} {self.unit} ({self.source})"
            )


def plain(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits and no exponent.

    Examples
    --------
    >>> plain(247.3, 2), plain(0.01234), plain(68437.0), plain(1.1e-6), plain(float("nan"))
    ('250', '0.0123', '68400', '0.0000011', 'nan')
    """
    if not isfinite(value):
        return f"{value:g}"
    text = f"{Decimal(f'{value:.{digits}g}'):f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
