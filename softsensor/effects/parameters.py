"""A physical number with its unit, limits and source, and how it is shown to people."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from statistics import NormalDist

from daq.words import Message, say

QUARTILE = NormalDist().inv_cdf(0.75)
"""Upper quartile of a normal, in standard deviations: half of its values lie within, by definition."""
_ROOT_12 = 12.0**0.5
"""Width of a range over the standard deviation of what lies anywhere within alike, by definition."""
SMALL_SHARE = 0.25
"""A cause that is a smaller share of its typical size does not matter. By hand."""
USUAL_SPREAD = 0.25
"""How much panels differ in what they hold of a cause, where nothing is known of it. By hand."""


def uniform_sd(width: float) -> float:
    """Return the standard deviation of what lies anywhere in a range of this width alike."""
    return width / _ROOT_12


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect."""

    name: str
    """Which it is among the effect's."""
    unit: str
    """Of its value, as written; empty for a share."""
    neutral: float
    """The value at which the effect is absent."""
    typical: float
    """A physical size to try first; differences to `neutral` of this size are what a diagnosis tests."""
    lower: float
    """Lowest value that a search tries."""
    upper: float
    """Highest value that a search tries."""
    source: str
    """Where the numbers are from."""
    spread: float = 0.0
    """How much it differs between pressings, as a share of its value; 0 where all share one value."""
    least: float = -inf
    """The least that can be at all: below, the equations mean nothing."""
    most: float = inf
    """The most that can be at all; both are wider than the limits of a search."""
    sd: float = 0.0
    """How far it may lie from `typical` where the effect is present; 0: as far as from `neutral`."""
    within: float = 0.0
    """Factor within which its size is known where the effect is present (one standard deviation of the logarithm);
    0: `sd` says."""
    fixed: bool = False
    """Whether it only says what the effect is, so that nothing searches or doubts it."""
    shown_as: tuple[float, str] | None = None
    """Factor and unit it is shown with, such as (100, "%"), a unit in words by its code in the catalogues
    (``unit-times-nominal``); None: the value itself with `unit`."""

    @property
    def size(self) -> float:
        """Typical size: how far `typical` lies from `neutral`."""
        return abs(self.typical - self.neutral)

    @property
    def present(self) -> tuple[float, float]:
        """Mean and standard deviation where the effect is present.

        Of a size known within a factor they are those of the normal with the log-normal's quartiles, for a band's
        end lies near the upper one where the effect itself is in doubt.
        """
        if self.within <= 1.0:
            return self.typical, self.sd or self.size
        quartile = self.within**QUARTILE
        low, high = ((self.typical - self.neutral) * share for share in (1.0 / quartile, quartile))
        return self.neutral + 0.5 * (low + high), abs(high - low) / (2.0 * QUARTILE)

    @property
    def one_sided(self) -> bool:
        """Whether it cannot lie below neutral."""
        return self.lower >= self.neutral

    @property
    def factor(self) -> float:
        """Factor it is shown with."""
        return 1.0 if self.shown_as is None else self.shown_as[0]

    @property
    def shown_unit(self) -> Message:
        """Unit it is shown with; no text where `unit` is a dash."""
        unit = self.unit.strip("-") if self.shown_as is None else self.shown_as[1]
        return Message(unit) if unit.startswith("unit-") else say("plain-text", text=unit)


def ratio_to_nominal(source: str) -> Parameter:
    """Return the parameter of a constant of the panel that is not the nominal one."""
    shown = (1.0, "unit-times-nominal")
    return Parameter(
        "ratio", "true / nominal", 1.0, 1.15, 0.4, 2.5, source, spread=USUAL_SPREAD, least=0.01, shown_as=shown
    )


def change_per_100_K(source: str) -> Parameter:  # noqa: N802 - kelvin
    """Return the parameter of a constant of the panel that changes with temperature."""
    shown = (100.0, "unit-percent-of-value-at-20-degrees")
    return Parameter(
        "per_100_K", "of the value at 20 °C", 0.0, 0.2, -0.5, 1.5, source, spread=USUAL_SPREAD, shown_as=shown
    )
