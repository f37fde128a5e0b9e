"""How sure it is by now that a press's model leaves something out, however many nights have asked.

A test at 5 % that is asked every night names a cause sooner or later where there is none. Here each pressing is a
bet, settled once: where a cause has its least size or none, a run's score is as likely below zero as above it, or
likelier (`diagnosis.run_scores`), so that a stake on it multiplies by `2 / (1 + exp(-2 stake score))`, one in the
mean at most, whatever the scores scatter like. Products of such factors are averaged over stakes, over the run at
which the cause may have begun, and over causes and the ways they can show; where nothing is missing the average
ever passes `1 / p` in a share `p` of presses at most (Ville's inequality). It says that something is missing; what
it is, a night's diagnosis says.

The average over beginnings is a recursion (Shiryaev's): a share waits and is not bet, so it is not lost while
nothing is there; at each run a part of it, `_begins`, is laid on every stake. That part may depend on nothing but
earlier runs. A cause is there from the first run with chance one half; else it begins at each run with one chance
that is not known, of a Beta(1, `WAIT`) distribution, whose predictive chance after `n` runs without it is
`1 / (WAIT + 1 + n)` (Laplace's rule of succession). A factor is 2 at most, so that a cause which shows in one way
takes at least `log2(limit * number of ways)` runs, eleven against the first model, whenever it is laid.

References
----------
Ramdas, Ruf, Larsson & Koolen, arXiv:2009.03167 (processes for symmetric scores); Shafer, J. R. Stat. Soc. A 184
(2021) 407 (testing by betting); Shiryaev, Theory Probab. Appl. 8 (1963) 22 (a beginning with a prior chance).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from softsensor.diagnosis.run_scores import ways
from softsensor.signals.unknown import ALPHA

STAKES = (0.5, 2.0)
"""Shifts of the scores that are bet on, in their standard deviations; one in between is bet on as its half or its
double at worst."""
WAIT = 100.0
"""Runs within which a cause that was not there at first begins with chance one half; a convention. It moves how
soon a cause is seen, not the bound on how often one is seen where there is none."""
MOST = 1e9
"""Where products are cut off, far above every limit; cutting only makes it less sure."""


@dataclass(frozen=True)
class Bets:
    """The bets so far, all against one model. Numbers are as the store keeps them."""

    against: str = ""
    """Fingerprint of the model bet against, with its press file; empty before the first."""
    models: int = 0
    """How many models were bet against, each with its own part of `ALPHA`: the share of presses with nothing
    missing in which something is ever taken for missing."""
    counted: int = 0
    """Runs up to this number have had their turn."""
    runs: int = 0
    """Runs counted against this model."""
    waiting: float = 1.0
    """Share of the unit that waits for a cause to begin."""
    wealth: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """What has become of what was laid so far, by way (`diagnosis.run_scores.ways`) and stake."""
    sure: str = ""
    """The run that made it sure, empty where it is not. No more is bet then."""

    @classmethod
    def stored(cls, content: Mapping[str, Any]) -> Bets:
        """Return the bets that the store kept.

        Before 2026-11-25 it did not keep what waits, which was `1 / (1 + log2(runs + 1))`. The bets go on from
        there: what is laid from now on may follow any rule.
        """
        return cls(**{"waiting": 1.0 / (1.0 + math.log2(content.get("runs", 0) + 1.0)), **content})

    @property
    def average(self) -> float:
        """What one unit has become, in the mean over ways."""
        kept = [sum(self.wealth[name]) if name in self.wealth else 1.0 - self.waiting for name in ways()]
        return self.waiting + sum(kept) / len(kept)

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
        begins = self.waiting * _begins(self.runs)
        equal = [(1.0 - self.waiting) / len(STAKES)] * len(STAKES)
        names = tuple(ways())
        held = np.array([self.wealth.get(name, equal) for name in names])
        scored = np.array([scores.get(name, 0.0) for name in names])
        factors = 2.0 / (1.0 + np.exp(-2.0 * np.outer(scored, STAKES)))
        held = np.minimum((held + begins / len(STAKES)) * factors, MOST)
        wealth = dict(zip(names, held.tolist(), strict=True))
        found = replace(self, counted=number, runs=self.runs + 1, waiting=self.waiting - begins, wealth=wealth)
        return replace(found, sure=run, wealth={}) if found.average >= self.limit else found


def _begins(runs: int) -> float:
    """Return the chance that a cause begins at the next run, given that it has not in so many."""
    return 1.0 / (WAIT + runs) if runs else 0.5
