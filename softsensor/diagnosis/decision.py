"""The rules by which a diagnosis names a cause or does not: two pure functions of evidence, numbers beside them.

`choose` is asked after every search: it takes a further cause into the model, with all that these runs cannot show
from it, or says why it stops; `explains_the_rest` says whether it stays. `conclude` is asked at the end and gives
the verdict, from three questions:

1. Is something left? A pattern that the runs share, a residual well above what the readings' own noise leaves, in
   all runs or in some alone, or panels that would have to differ more than panels of one product do.
2. Does a named cause explain it? Its law may be off, so a further one must explain nearly all that it leaves.
3. Is the gain real? On runs left out, with an interval above nothing; on runs predicted from their headers alone
   not surely a loss, nor a larger one than that gain, unless the model leaves no more than noise and runs left out
   are surely likelier by it, their own contacts at the price of their scatter; and its size surely not nothing.

A cause that fails the third question is suspected, and so is every cause where the second fails. What is suspected
is beyond chance all the same: the verdict is then that something is unknown, never that nothing is there. Fits
and tests are made elsewhere (`search`, `selection`, `sign_flips`, `gains`); nothing here knows a model or a run
file. What the numbers do to false names and power is measured by ``pytest -m benchmark
tests/benchmarks/test_diagnosis_confusion.py``, whose head holds the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from daq.records import Array
from softsensor.diagnosis.gains import Gain
from softsensor.diagnosis.sign_flips import PatternTest, paired_t, tempered
from softsensor.effects import Need
from softsensor.effects.parameters import SMALL_SHARE
from softsensor.signals.instrument import MEAN_SLOW_K
from softsensor.signals.unknown import ALPHA

FEW_RUNS = 6
"""The least p-value of n flipped runs is 2^(1-n): below six runs none reaches `ALPHA`. Derived."""
FEW_CAUSES, MOST_CAUSES = 1, 3
"""Causes named at most, with few runs and with enough. With few, nothing vetoes what two causes explain together:
without this, three faults outside the catalogue were given names in campaigns of 2 and 4 runs."""
FEW_TOTAL = 0.5
"""Few runs have no p-value: a cause brings the held-out residual down to this share at most. Set by hand on
campaigns of 2 and 4 runs, 2026-11-21."""
NEGLIGIBLE_K = 0.5 * MEAN_SLOW_K
"""A pattern common to the runs (rms over pockets) below half of a face's slow noise is none. [K]"""
SMALLEST_EXPONENT = 0.02
"""Where others have `SMALL_SHARE` of their typical size at least: an exponent of pressure over a wide range of
loads is plain to see when far smaller. Set by hand."""
CORE_RATIO, CORE_K = 1.5, 0.5
"""Core thermocouples refute a model that is further off than another by this factor and so many kelvins in every
run that has one. Set by hand, above what one is off of its own (`signals.instrument.BURIED_K`)."""
SURE_T = 2.2
"""Standard errors over runs by which a rival gains less before it is set apart; about Student's two-sided 5 % for
twelve runs (2.20)."""
NEAR = 0.5
"""A rival saves this share of what the best one saves, or is out of its set. Set by hand."""
LARGEST_SET = 3
"""Names in a set; more advise nobody. Set by hand."""
ALPHA_PATTERN = ALPHA / 2.0
"""Of the test for a pattern left over, so that it and a name together stay at `ALPHA`."""
EXPLAINED = 0.8
"""Share of the common pattern's energy that all named causes explain at least, or the verdict is that something is
unknown. Set by hand, 2026-11-21."""
EXPLAINED_FURTHER = 0.85
"""Share that a further cause explains at least of what those before it leave beyond noise, or their laws are off.
0.8 would keep a heat capacity beside moisture that is not there, and of second causes that are there none more
(`tests.calibration.further_causes`; seeds and what was not run again: deploy/guide/measured.md, 2026-11-24)."""
EXCESS = 1.5
"""Times the noise of the readings from which a residual, steep moments counting less, is not noise, whatever its
pattern. Measured: see `noise_floor` (numbers). With steep moments whole, scans that are late left 1.52 times the
noise where nothing was hidden, and leave 1.00 so (`tests.second_press`, seed 8621, 2026-11-28)."""


class Verdict(StrEnum):
    """What a diagnosis answers; values of the contract."""

    NO_EFFECT = "no_effect"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    UNKNOWN_EFFECT = "unknown_effect"
    TOO_FEW_RUNS = "too_few_runs"
    NOT_DESCRIBED = "not_described"


class SearchStep(StrEnum):
    """Why the search goes on, or why it stopped."""

    CAUSE_NAMED = "cause_named"
    ENOUGH_CAUSES = "enough_causes"
    ONE_RUN = "one_run"
    NOTHING_TO_TRY = "nothing_to_try"
    NO_CAUSE_CONVINCES = "no_cause_convinces"


class Objection(StrEnum):
    """What speaks against naming a candidate, in the order in which it is asked."""

    TOO_SMALL = "too_small"
    NO_GAIN_LEFT_OUT = "no_gain_left_out"
    UNPHYSICAL = "unphysical"
    REFUTED_BY_CORES = "refuted_by_cores"
    CHANCE = "chance"
    GAIN_NOT_SURE = "gain_not_sure"


UNPROVEN = frozenset({Objection.GAIN_NOT_SURE})
"""What makes a cause suspected instead of named."""


@dataclass(frozen=True)
class Claim:
    """What a fitted candidate has to show."""

    name: str
    measuring: bool
    """A property of the measuring chain."""
    needs: Need
    """As `Effect.needs`."""
    at_the_rim: bool
    """As `Effect.at_the_rim`: named alone out of its set where rim sensors fall against central ones."""
    size: float
    """Of its largest amplitude, in typical sizes."""
    unphysical: bool
    """Whether an amplitude has reached a limit."""
    p_value: float
    """Adjusted for the number of candidates."""
    saved: float
    """Sum of squares the fit to all runs saves."""
    saves: Array
    """Sum of squares each run saves with shared numbers from the others (runs)."""
    gain: Gain
    """On runs left out."""
    core_K: Array  # noqa: N815
    """Root mean square distance from core thermocouples, NaN where a run has none (runs)."""


@dataclass(frozen=True)
class Evidence:
    """What is known after a search on top of the model so far."""

    runs: int
    core_K: Array  # noqa: N815
    """Of the model so far, as `Claim.core_K` (runs)."""
    claims: tuple[Claim, ...] = ()
    """Of the candidates fitted to convergence."""
    causes: int = 0
    """In the model so far."""
    rim_is_cool: bool = False


@dataclass(frozen=True)
class Choice:
    """A further cause, or the end of the search."""

    step: SearchStep
    set: tuple[str, ...] = ()
    """The chosen cause first, then what these runs cannot distinguish from it."""
    strongest: str = ""
    """What the gains alone would choose, before rim and cores are asked."""
    refuted: tuple[str, ...] = ()
    """What core thermocouples speak against, though the faces may fit."""
    suspected: str = ""
    """Where none is chosen: the strongest that only lacks a sure gain."""


def choose(evidence: Evidence) -> Choice:
    """Take a further cause in, or stop."""
    if evidence.runs < 2:
        return Choice(SearchStep.ONE_RUN)
    if evidence.causes >= MOST_CAUSES:
        return Choice(SearchStep.ENOUGH_CAUSES)
    best = strongest(evidence)
    if best is None:
        nearly = strongest(evidence, allowed=UNPROVEN)
        step = SearchStep.NO_CAUSE_CONVINCES if evidence.claims else SearchStep.NOTHING_TO_TRY
        return Choice(step, suspected="" if nearly is None else nearly.name)
    names, refuted = _what_fits_as_well(evidence, best)
    return Choice(SearchStep.CAUSE_NAMED, names, best.name, refuted)


def strongest(evidence: Evidence, allowed: frozenset[Objection] = frozenset()) -> Claim | None:
    """Return the candidate that saves most of those nothing speaks against but what is allowed to."""
    able = [claim for claim in evidence.claims if not objections(claim, evidence) - allowed]
    return max(able, key=lambda claim: claim.saved, default=None)


def objections(claim: Claim, evidence: Evidence) -> set[Objection]:
    """Return everything that speaks against naming a candidate."""
    few = evidence.runs < FEW_RUNS
    against = {
        Objection.TOO_SMALL: claim.size < (SMALLEST_EXPONENT if claim.needs == Need.LOAD else SMALL_SHARE),
        Objection.NO_GAIN_LEFT_OUT: claim.saves.sum() <= 0 or claim.gain.surely_worse,
        Objection.UNPHYSICAL: claim.unphysical,
        Objection.REFUTED_BY_CORES: refuted_by_cores(claim.core_K, evidence.core_K),
        Objection.CHANCE: not (claim.saves > 0).all() if few else claim.p_value > ALPHA,
        Objection.GAIN_NOT_SURE: not claim.gain.sure,
    }
    return {reason for reason, holds in against.items() if holds}


def explains_the_rest(before: float, after: float) -> bool:
    """Return whether a further cause explains what those before it leave beyond noise; else their laws may be off.

    Parameters
    ----------
    before, after
        What the model leaves without it and with it, over what noise leaves.

    Examples
    --------
    >>> explains_the_rest(2.0, 1.2), explains_the_rest(2.0, 1.5), explains_the_rest(1.0, 0.9)
    (True, False, False)
    """
    return before > 1.0 and after**2 - 1.0 <= (1.0 - EXPLAINED_FURTHER) * (before**2 - 1.0)


def _what_fits_as_well(evidence: Evidence, best: Claim) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the best cause with those these runs cannot distinguish from it, and the causes that cores refute.

    The measuring chain comes first: it is settled with least effort, bends coefficients most, and leaves the core
    alone. Rim sensors settle a set for the rim, core thermocouples make it smaller.
    """
    rivals = [c for c in evidence.claims if c is not best and c.saved > NEAR * best.saved]
    rivals = [c for c in rivals if c.size >= SMALL_SHARE / 2 and c.saves.sum() > 0 and not clearly_better(best, c)]
    near = [best, *sorted(rivals, key=lambda c: -c.saved)[: LARGEST_SET - 1]]
    near.sort(key=lambda c: not (c.measuring and not objections(c, evidence)))
    rim = [c for c in near if c.at_the_rim]
    near = rim if rim and evidence.rim_is_cool else near
    nearest_K = min((c.core_K for c in near), key=lambda errors: float(np.nansum(errors**2)))
    kept = [c for c in near if not refuted_by_cores(c.core_K, nearest_K)]
    refuted = [c.name for c in evidence.claims if refuted_by_cores(c.core_K, evidence.core_K)]
    refuted += [c.name for c in near if c not in kept]
    return tuple(c.name for c in kept), tuple(refuted)


def refuted_by_cores(errors: Array, better: Array) -> bool:
    """Return whether core thermocouples, which no fit has seen, speak against a model in every run that has one.

    `errors` and `better`: how far a model and another are from them, NaN where none is (runs). [K]
    """
    known = np.isfinite(errors)
    if known.sum() < 2:
        return False
    e, b = errors[known], better[known]
    return bool(((e > CORE_RATIO * b) & (e > b + CORE_K)).all())


def clearly_better(best: Claim, other: Claim) -> bool:
    """Return whether the runs prefer one cause to another beyond chance; few runs must all do so."""
    return bool(beyond_chance(best.saves - other.saves))


def signed_root(saves: Array) -> Array:
    """Return what sums of squares are in standard deviations (...)."""
    return np.asarray(np.sign(saves) * np.sqrt(np.abs(saves)))


def beyond_chance(difference: Array) -> Array:
    """Return whether runs gain more by one cause than by another (...); few runs must all do so.

    Parameters
    ----------
    difference
        What each run saves by the one, less what it saves by the other (..., runs).
    """
    if difference.shape[-1] < FEW_RUNS:
        return np.asarray((difference > 0.0).all(axis=-1))
    return np.asarray(paired_t(difference) >= SURE_T)


@dataclass(frozen=True)
class Proof:
    """What a cause in the model has to show for itself at the end."""

    set: tuple[str, ...]
    gain: Gain
    """On runs left out, own contacts fitted."""
    predicted: Gain
    """On runs predicted from their headers and the others' numbers."""
    saves: Array
    """Sum of squares each run saves by numbers from the others (runs)."""
    times_noise: float
    """What the model with it leaves, steep moments counting less, over what noise leaves."""
    size_is_sure: bool
    """An amplitude's interval leaves out the neutral value, and none is at a limit."""
    heldout_ratio: float
    """Held-out residual of the model with it over the plain one's, geometric mean over runs as in its gain."""

    @property
    def holds(self) -> bool:
        """Whether the gain is real: sure on runs left out, and not lost again on predicted ones.

        In kelvins a prediction is off by its contacts first, which scatter from run to run, so that a cause worth
        a tenth of a kelvin falls or stands by chance. Where the model leaves no more than noise does, likelihood
        decides instead: what a run saves by the others' numbers, its own contacts at the price of their scatter.
        """
        likelier = self.times_noise <= EXCESS and bool(beyond_chance(tempered(signed_root(self.saves))))
        lost = self.predicted.surely_worse or not (likelier or self.gain.value_K + self.predicted.value_K > 0.0)
        return self.gain.sure and not lost and self.size_is_sure


@dataclass(frozen=True)
class Remains:
    """What a model leaves."""

    pattern: PatternTest
    """Of what the runs share."""
    explained: float
    """Share of the plain model's common pattern that it explains."""
    times_noise: float
    """Its residual, steep moments counting less, over what noise leaves."""
    described: bool
    """Not so far off that no statement can be made."""
    off: tuple[int, ...] = ()
    """Runs whose own residual is not noise, where others' is: what is missing is in these, not in all."""
    panels_as_given: bool = True
    """The middle of the panels that it needs is as near to those given as panels are."""
    panels_alike: bool = True
    """It needs panels to differ among themselves no more than panels of one product do."""
    cores_agree: bool = True
    """Core thermocouples do not show an error that the faces hide."""


@dataclass(frozen=True)
class VerdictBasis:
    """All that a verdict rests on."""

    runs: int
    proofs: tuple[Proof, ...]
    """Of the causes in the order they were taken in."""
    remains: tuple[Remains, ...]
    """After none, one, ... of them."""
    faulty_channels: bool = False
    """The same channels are faulty in many runs."""
    suspected: bool = False
    """The last search would have taken a cause in but for a sure gain, or for what it leaves."""
    let_go: bool = False
    """It was for what it leaves."""


@dataclass(frozen=True)
class Conclusion:
    """The verdict, and how many of the causes are named; the others are suspected."""

    verdict: Verdict
    named: int = 0


def conclude(case: VerdictBasis) -> Conclusion:
    """Give the verdict."""
    few = case.runs < FEW_RUNS
    proven = next((i for i, proof in enumerate(case.proofs) if not proof.holds), len(case.proofs))
    found = len(case.proofs) + case.let_go
    if few and proven and (found > FEW_CAUSES or case.proofs[proven - 1].heldout_ratio > FEW_TOTAL):
        proven = 0
    left = case.remains[proven]
    if something_left(left, case.runs):
        return Conclusion(Verdict.UNKNOWN_EFFECT)
    if any(len(proof.set) > 1 for proof in case.proofs[:proven]):
        return Conclusion(Verdict.AMBIGUOUS, proven)
    if proven or (case.faulty_channels and left.described):
        return Conclusion(Verdict.NAMED, proven)
    if not left.described:
        return Conclusion(Verdict.NOT_DESCRIBED)
    if few:
        return Conclusion(Verdict.TOO_FEW_RUNS)
    noise = left.times_noise <= EXCESS and not left.off
    nothing = not (case.suspected or case.proofs) and noise and left.panels_as_given and left.cores_agree
    return Conclusion(Verdict.NO_EFFECT if nothing else Verdict.UNKNOWN_EFFECT)


def something_left(left: Remains, runs: int) -> bool:
    """Return whether named causes leave something; few runs cannot show it.

    A pattern that the runs share, or panels that differ among themselves more than panels of one product do.
    """
    return runs >= FEW_RUNS and (not left.panels_alike or pattern_left(left, runs))


def beyond_noise(times_noise: Array) -> tuple[int, ...]:
    """Return which runs' residuals are more than noise, where others' are not; none where all are alike.

    Beyond noise the others leave less than a fifth of what these do (`EXPLAINED`): a run just above a line, among
    others just below it, is none apart. Of 264 runs with nothing hidden (seeds 877000 to 877023, and of the second
    press 99800 to 99803) none leaves more than 1.37 times the noise, 2026-11-30.

    Parameters
    ----------
    times_noise
        What a model leaves of each run, steep moments counting less, over what noise leaves (runs).

    Examples
    --------
    >>> beyond_noise(np.array([1.1, 3.0, 0.9])), beyond_noise(np.array([3.0, 4.0])), beyond_noise(np.ones(2))
    ((1,), (), ())
    >>> beyond_noise(np.array([1.4, 1.6, 1.45]))
    ()
    """
    off = times_noise > EXCESS
    if not off.any() or off.all():
        return ()
    rest, beyond = (float(np.mean(times_noise[some] ** 2)) - 1.0 for some in (~off, off))
    return tuple(np.flatnonzero(off).tolist()) if rest <= (1.0 - EXPLAINED) * beyond else ()


def pattern_left(left: Remains, runs: int) -> bool:
    """Return whether the runs share a pattern that named causes do not explain."""
    level = max(ALPHA_PATTERN, 0.5 ** (runs - 1))
    if left.pattern.p_value > level or left.pattern.energy < NEGLIGIBLE_K**2:
        return False
    return left.explained < EXPLAINED
