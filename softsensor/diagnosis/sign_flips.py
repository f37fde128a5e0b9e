"""Tests whose unit is the run: sign flips with the maximum over all that is tested, likelihood of runs left out.

Samples of one run are far from independent, and so are residuals of neighbouring bins: testing them as if
they were named a false cause in 84 to 100 % of effect-free campaigns. Runs are exchangeable in sign when
nothing is there, so flipping the sign of whole runs gives the null distribution, whatever the noise is. Of six
runs all must agree, however much five of them say: where the noise is known, likelihood says more.

References
----------
Hemerik, Goeman & Finos, J. R. Stat. Soc. B 82 (2020) 841 (sign flipping of effective scores);
Westfall & Young, Resampling-Based Multiple Testing, 1993 (maximum over tests);
Wasserman, Ramdas & Balakrishnan, PNAS 117 (2020) 16880 (likelihood ratios by numbers from elsewhere, Markov).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from daq.records import Array
from softsensor.heat.timing import OPENING_RAMP_S
from softsensor.signals.digest import Digest
from softsensor.signals.instrument import RAMP_S
from softsensor.signals.unknown import ALPHA

# Numbers without another source were set by hand, 2026-11.

MANY = 4096
"""Flips drawn where all of them are more: p-values down to 2.4e-4."""
SINCE_S = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 1e9)
"""Edges of the bins of time since the last event, twice as wide each, as heat spreads. [s]"""
SHARES = 6
"""The pressing is also cut into so many equal shares, for what follows the program and not the clock."""
SCORE_LIMIT = 3.0
"""Standard deviations a run can say at most in what is put together over nights. By hand, 2026-11."""
MOST_SAID = SCORE_LIMIT**2
"""Standard deviations that a tempered score stays below: a score of three keeps three quarters of its weight."""


class ResidualPhase(StrEnum):
    """What the press does while residuals are averaged."""

    OPEN = "open"
    """Before closing."""
    CLOSED = "closed"
    OPENED = "opened"


MARGINS_S = {
    ResidualPhase.OPEN: RAMP_S / 2.0,
    ResidualPhase.CLOSED: OPENING_RAMP_S / 2.0,
    ResidualPhase.OPENED: 0.0,
}
"""Bins so shortly before a phase ends may hold some of the next: half of a ramp of usual length. [s]"""


def sign_patterns(runs: int) -> Array:
    """Return patterns of run signs, the plain one first; a pattern and its opposite count once."""
    if runs <= 12:
        codes = np.arange(2 ** max(runs - 1, 0))
        bits = (codes[:, None] >> np.arange(max(runs, 1))[None, :]) & 1
        return np.asarray(1.0 - 2.0 * bits, dtype=float)
    rng = np.random.default_rng(20)
    drawn = np.asarray(1.0 - 2.0 * rng.integers(0, 2, (MANY, runs)), dtype=float)
    drawn[0] = 1.0
    return drawn


def flip_statistics(scores: Array, *, alike: bool = False) -> Array:
    """Return |sum over runs|, over the root of their squares' sum unless `alike` (patterns, tests)."""
    norm = 1.0 if alike else np.sqrt(np.maximum((scores**2).sum(axis=0), 1e-300))
    return np.asarray(np.abs(sign_patterns(len(scores)) @ scores) / norm)


def tempered(scores: Array) -> Array:
    """Return scores in standard deviations, large ones as less: x / (1 + |x| / `MOST_SAID`) (...).

    Odd and growing. A few thin panels see far more of a cause than the others and would drown them, and a run
    whose fit has failed would drown every other cause. Cut off instead, at three, all scores of a campaign with
    much left over are the same, and what has their signs ties with the true cause. No number speaks against one.
    """
    known = np.nan_to_num(scores, nan=-np.finfo(float).max)
    return np.asarray(known / (1.0 + np.abs(known) / MOST_SAID))


def max_t(scores: Array, upward: Sequence[bool] = (), *, alike: bool = False) -> Array:
    """Return p-values of tests (runs, tests), adjusted for their number by the maximum.

    `alike`: scores of all tests are in the same unit; else each test counts in its own scatter.

    For a test that only a sum above zero speaks for (`upward`, of each test) any other has no p-value below 1.
    Flips count on both sides all the same, so its p-value is rather too large, and the least of n runs 2^(1-n).
    """
    if scores.shape[1] == 0:
        return np.zeros(0)
    statistics = flip_statistics(scores, alike=alike)
    largest = statistics.max(axis=1)
    p = np.asarray((largest[:, None] >= statistics[0][None, :] - 1e-9).mean(axis=0))
    return np.where(np.array(upward) & (scores.sum(axis=0) <= 0.0), 1.0, p) if len(upward) else p


def likelihood_p(saves: Array, tests: int) -> float:
    """Return a bound of the p-value of what runs left out save, adjusted for the number of tests.

    By numbers from other runs, twice the logarithm of the likelihood ratio is above 2 ln(1/p) with a chance of p
    at most (Markov). Runs here share those numbers, so that it is a bound near enough only; the third of the runs
    that save most are left out, lest a few odd ones name a cause, which more than makes up for it: in 40 campaigns
    of six runs with nothing in them the largest sum of any candidate is 2.4, where 20 candidates ask for 12
    (`tests.calibration.likelihood 6 none 9128000 40`, 2026-11-27).

    Parameters
    ----------
    saves
        Sum of squares in the noise that each run saves by the others' numbers (runs).
    tests
        Candidates it was chosen from.
    """
    bound = tests * np.exp(-max(saved_by_most(saves), 0.0) / 2.0)
    return float(np.clip(bound, 1.0 / MANY, 1.0))


def saved_by_most(saves: Array) -> float:
    """Return what all runs save together (runs), without the third of them that saves most."""
    return float(np.sort(saves)[: len(saves) - len(saves) // 3].sum())


def paired_t(difference: Array) -> Array:
    """Return how sure it is that runs gain more by one than by another: mean over its standard error (...).

    Parameters
    ----------
    difference
        What each run gains by the one, less what it gains by the other (..., runs).
    """
    runs = difference.shape[-1]
    if runs < 2:
        return np.asarray(np.sign(difference.sum(axis=-1)) * 10.0)
    error = np.std(difference, axis=-1, ddof=1) / np.sqrt(runs)
    return np.asarray(difference.mean(axis=-1) / np.maximum(error, 1e-9))


@dataclass(frozen=True)
class Pocket:
    """A place and a stretch of time in which residuals of all runs are averaged."""

    signal: str
    phase: ResidualPhase
    from_s: float
    """Since the phase began; a share of the press time where `shared`. [s]"""
    to_s: float
    shared: bool
    means: Array
    """By run, NaN where the run has nothing there. [K]"""

    @property
    def mean(self) -> float:
        """Over runs. [K]"""
        return float(np.nanmean(self.means))


class Stretch(NamedTuple):
    """A stretch of time in a phase."""

    phase: ResidualPhase
    from_s: float
    """Since the phase began; a share of the press time where `shared`. [s]"""
    to_s: float
    shared: bool = False


def pockets(digests: Sequence[Digest], residuals: Sequence[Array]) -> list[Pocket]:
    """Average residuals (bins, signals) over pockets that at least half of the runs share."""
    residuals = trusted(digests, residuals)
    stretches = [Stretch(phase, a, b) for phase in ResidualPhase for a, b in pairwise(SINCE_S)]
    stretches += [Stretch(ResidualPhase.CLOSED, i / SHARES, (i + 1) / SHARES, True) for i in range(SHARES)]
    found = [pocket(digests, residuals, signal, where) for signal in signals_of(digests) for where in stretches]
    return [p for p in found if np.isfinite(p.means).sum() >= max(2, (len(digests) + 1) // 2)]


def signals_of(digests: Sequence[Digest]) -> tuple[str, ...]:
    """Return the places any run has sensors at."""
    return tuple(dict.fromkeys(s for d in digests for s in d.signals))


def trusted(digests: Sequence[Digest], residuals: Sequence[Array]) -> list[Array]:
    """Return residuals (bins, signals), steep moments counting less."""
    return [r * d.trust for d, r in zip(digests, residuals, strict=True)]


def pocket(digests: Sequence[Digest], residuals: Sequence[Array], signal: str, where: Stretch) -> Pocket:
    """Average residuals (bins, signals) of every run over one stretch of time at one place."""
    means = [_mean_in(d, r, signal, inside(d, *where)) for d, r in zip(digests, residuals, strict=True)]
    return Pocket(signal, *where, np.array(means))


def inside(d: Digest, phase: ResidualPhase, from_s: float, to_s: float, shared: bool = False) -> np.ndarray:
    """Return which bins lie in a stretch of a phase (bins)."""
    begin, end = phase_of(d, phase)
    since = d.time - begin
    if shared:
        since = since / (end - begin)
    return np.asarray((since >= from_s) & (since < to_s) & (d.time < end - MARGINS_S[phase]))


def phase_of(d: Digest, phase: ResidualPhase) -> tuple[float, float]:
    """Return when a phase began and ended; infinite where it did not. [s of the run]"""
    m = d.moments
    closed = m.closed_s if np.isfinite(m.closed_s) else np.inf
    opened = m.opened_s if np.isfinite(m.opened_s) else np.inf
    return {
        ResidualPhase.OPEN: (float(d.time[0]), closed),
        ResidualPhase.CLOSED: (closed, opened),
        ResidualPhase.OPENED: (opened, np.inf),
    }[phase]


def _mean_in(d: Digest, residual: Array, signal: str, rows: np.ndarray) -> float:
    if signal not in d.signals:
        return float("nan")
    values = residual[rows, d.signals.index(signal)]
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else float("nan")


@dataclass(frozen=True)
class PatternTest:
    """Whether a pattern common to the runs is left in the residuals."""

    p_value: float
    energy: float
    """Mean square of the common pattern, what chance makes of it taken out. [K²]"""
    worst: Pocket | None
    """Of the pockets whose mean is beyond chance, the one that is most kelvins off."""


def pattern_test(found: Sequence[Pocket]) -> PatternTest:
    """Test run means of residuals in all pockets at once."""
    if not found:
        return PatternTest(1.0, 0.0, None)
    means = np.stack([np.nan_to_num(p.means) for p in found], axis=1)
    p = max_t(means)
    plain = [q for q in found if not q.shared]
    energy = float(np.mean([_common_energy(q.means) for q in plain])) if plain else 0.0
    sure = [q for q, level in zip(found, p, strict=True) if level <= max(ALPHA, float(p.min())) and not q.shared]
    worst = max(sure, key=lambda q: abs(q.mean), default=None)
    return PatternTest(float(p.min()), max(energy, 0.0), worst)


def _common_energy(means: Array) -> float:
    values = means[np.isfinite(means)]
    return float(values.mean() ** 2 - np.var(values, ddof=1) / len(values))
