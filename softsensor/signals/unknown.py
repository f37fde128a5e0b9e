"""An unknown of a fit, a campaign or the live sensor: a number, its normal prior, and where it must stay."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

ALPHA = 0.05
"""Share in which a test, or a band, may be wrong by chance; a convention."""
CENTRAL = (ALPHA / 2.0, 1.0 - ALPHA / 2.0)
"""Shares of a distribution below the ends of its central 95 %."""
BAND = NormalDist().inv_cdf(CENTRAL[1])
"""Half-width of a normal estimate's 95 % band, in standard deviations."""
FAR_LOG = 50.0
"""An interval of a logarithm ends here at the latest, before it overflows: e⁵⁰ times anything is beyond all
limits. By hand, 2026-11."""


@dataclass(frozen=True)
class Unknown:
    """A number to be estimated. Where `log`, prior, limits and start are of its natural logarithm."""

    name: str
    centre: float
    """Of the prior."""
    sd: float
    """Of the prior; infinite: there is none."""
    lower: float = -np.inf
    upper: float = np.inf
    log: bool = False
    start: float | None = None
    """Where a search begins; None: at the centre."""
    step: float = np.inf
    """Largest change in one step of a search."""
    considered: bool = False
    """Held at its centre, but what the answer is off if it is wrong is followed (Schmidt's consider filter)."""
    loose: float = 1.0
    """Of a considered one: share of its variance whose size is known only within a range (`doubt.DOUBT_SIZES`)."""
    shared: str = ""
    """Of a run's number: the campaign's that its centre counts from."""
    share_of: str = ""
    """Of a run's number: the effect parameter of which this run has so much more or less."""

    @property
    def begin(self) -> float:
        """Where a search begins."""
        return self.centre if self.start is None else self.start

    @property
    def unit(self) -> float:
        """What a scaled search counts in: 1 of a logarithm, else one standard deviation."""
        return 1.0 if self.log else self.sd

    def value(self, estimate: float) -> float:
        """Return the number an estimate stands for."""
        return float(np.exp(estimate)) if self.log else estimate

    def estimate(self, value: float) -> float:
        """Return the estimate that stands for a number."""
        return float(np.log(value)) if self.log else value

    def slope(self, estimate: float) -> float:
        """Return the derivative of the number by the estimate."""
        return float(np.exp(estimate)) if self.log else 1.0

    def deviation(self, estimate: float) -> float:
        """Return how far an estimate lies from the prior's centre, in its standard deviations."""
        return (estimate - self.centre) / self.sd
