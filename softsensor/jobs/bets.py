"""How sure it is by now that a press's model leaves something out, however many nights have asked.

A test at 5 % that is asked every night names a cause sooner or later where there is none. Here each pressing is a
bet, settled once: where a cause has its least size or none, a run's score is as likely below zero as above it, or
likelier (`diagnosis.run_scores`), so that a stake on it multiplies by `2 / (1 + exp(-2 stake score))`, one in the
mean at most, whatever the scores scatter like. Products of such factors are averaged over stakes, over the run at
which the cause may have begun, and over causes and the ways they can show; where nothing is missing the average
ever passes `1 / p` in a share `p` of presses at most (Ville's inequality). It says that something is missing; what
it is, a night's diagnosis says.

References
----------
Ramdas, Ruf, Larsson & Koolen, arXiv:2009.03167 (processes for symmetric scores); Shafer, J. R. Stat. Soc. A 184
(2021) 407 (testing by betting).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from softsensor.diagnosis.run_scores import ways

ALPHA = 0.05
"""Share of presses with nothing missing in which something is ever taken for missing; a convention."""
STAKES = (0.5, 2.0)
"""Shifts of the scores that are bet on, in their standard deviations; one in between is bet on as its half or its
double at worst."""
MOST = 1e9
"""Where products are cut off, far above every limit; cutting only makes it less sure."""


@dataclass(frozen=True)
class Bets:
    """The bets so far, all against one model. Numbers are as the store keeps them."""

    against: str = ""
    """Fingerprint of the model bet against, with its press file; empty before the first."""
    models: int = 0
    """How many models were bet against, each with its own part of `ALPHA`."""
    counted: int = 0
    """Runs up to this number have had their turn."""
    runs: int = 0
    """Runs counted against this model."""
    wealth: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """What has become of what was laid so far, by way (`diagnosis.run_scores.ways`) and stake."""
    sure: str = ""
    """The run that made it sure, empty where it is not. No more is bet then."""

    @property
    def average(self) -> float:
        """What one unit has become, in the mean over ways."""
        kept = [sum(self.wealth[name]) if name in self.wealth else _laid(self.runs) for name in ways()]
        return 1.0 - _laid(self.runs) + sum(kept) / len(kept)

    @property
    def limit(self) -> float:
        """What `average` has to reach: parts of `ALPHA` shrink from model to model and add up to it."""
        return self.models * (self.models + 1) / ALPHA

    def facing(self, model: str, made_of: int = 0) -> Bets:
        """Return the bets against a model; where it is another one, new bets on runs that none has counted yet.

        `made_of`: runs up to this number may have taken part in making it, and say nothing against it.
        """
        if model == self.against:
            return self
        return Bets(model, self.models + 1, max(self.counted, made_of))

    def after(self, run: str, number: int, scores: Mapping[str, float]) -> Bets:
        """Return the bets with a further run settled; `scores` by way, those it has."""
        if self.sure:
            return replace(self, counted=number)
        before, now = _laid(self.runs), _laid(self.runs + 1)
        equal = [before / len(STAKES)] * len(STAKES)
        held = np.array([self.wealth.get(name, equal) for name in ways()])
        said = np.array([scores.get(name, 0.0) for name in ways()])
        factors = 2.0 / (1.0 + np.exp(-2.0 * np.outer(said, STAKES)))
        held = np.minimum((held + (now - before) / len(STAKES)) * factors, MOST)
        wealth = dict(zip(ways(), held.tolist(), strict=True))
        found = replace(self, counted=number, runs=self.runs + 1, wealth=wealth)
        return replace(found, sure=run, wealth={}) if found.average >= self.limit else found


def _laid(runs: int) -> float:
    """Return the share of the unit laid by a run: half at the first, then ever less, and all of it in the end."""
    return 1.0 - 1.0 / (1.0 + math.log2(runs + 1.0))
