"""The rule by which a diagnosis names a cause or stops: one pure function of the evidence, thresholds beside it.

`decide` is asked after every search. It names a further cause with all that these runs cannot tell from it, or
says why it stops, how many of the named causes stand, and the verdict. Fits and tests are made elsewhere
(`search`, `selection`, `sign_flips`); nothing here knows a model or a run file.

Where the thresholds come from: all were set by hand on 2026-11-21, while campaigns of the virtual press were read,
and then measured on seeds not looked at before (150000 on) by ``pytest -m benchmark
tests/benchmarks/test_diagnosis_confusion.py``, whose head holds the table. Only `ALPHA` is a stated error rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from daq.records import Array
from softsensor.diagnosis.sign_flips import PatternTest, paired_t
from softsensor.effects import Need

ALPHA = 0.05
"""Of the p-value adjusted for the number of candidates; a convention. Measured with the conditions on gain and
size: 0 names in 20 campaigns without an effect."""
FEW_RUNS = 6
"""The least p-value of n flipped runs is 2^(1-n): below six runs none reaches `ALPHA`. Derived."""
FEW_CAUSES, MOST_CAUSES = 1, 3
"""Causes named at most, with few runs and with enough. With few, nothing vetoes what two causes explain together:
without this, three faults outside the catalogue were given names in campaigns of 2 and 4 runs."""
FEW_STEP, FEW_TOTAL = 0.85, 0.5
"""Few runs: a cause brings the held-out residual down to the first share of the fitted one before it, and the
last model to the second share of the plain one's. Set by hand on campaigns of 2 and 4 runs."""
LEAST_GAIN_K, LEAST_GAIN_SHARE = 0.005, 0.02
"""What a cause saves on runs left out, at least: kelvins, and share of the residual. Set by hand."""
FURTHER_GAIN_K = 0.015
"""The same for a further physical cause where what the runs have in common is negligible already: with 24 runs the
faults of the first cause's law are sure, and were given two names that were not there (seed 915007). [K]"""
NEGLIGIBLE_K = 0.06
"""A pattern common to the runs (rms over pockets) below this is none. Set by hand, half of the slow noise a face
is given (0.12 K). [K]"""
SMALLEST_SIZE, SMALLEST_EXPONENT = 0.25, 0.02
"""A cause has a quarter of its typical size at least. An exponent of pressure over a wide range of loads is plain
to see when far smaller. Set by hand."""
AGREE, MATTERS = 0.6, 4.0
"""Share of the runs that gain by a cause with numbers from the others, among those whose sum of squares changes by
more than the second: two standard deviations of one number. Set on a campaign with a clock 0.24 s off."""
CORE_RATIO, CORE_K = 1.5, 0.5
"""Core thermocouples refute a model that is further off than another by this factor and so many kelvins in every
run that has one. Set by hand; their own error on a rig is 0.1 to 0.75 K (facts, decision.md)."""
SURE_T = 2.2
"""Standard errors over runs by which a rival gains less before it is told apart; about Student's two-sided 5 % for
twelve runs (2.20)."""
NEAR = 0.5
"""A rival saves this share of what the best one saves, or is out of its set. Set by hand."""
LARGEST_SET = 3
"""Names in a set; more advise nobody. Set by hand."""
ALPHA_PATTERN = 0.025
"""Of the test for a pattern left over. Set by hand."""
EXPLAINED = 0.8
"""Share of the common pattern that named causes explain, or the verdict is that something is unknown: two or three
causes of the catalogue imitate a fault outside it badly, but significantly. Set by hand."""
SMALL_K = 0.2
"""Of the common pattern one cause may leave so much, two half of it, three a third: what takes many causes to
explain is rather one outside the catalogue. Set by hand. [K]"""


class Verdict(StrEnum):
    """What a diagnosis answers; values of the contract."""

    NO_EFFECT = "no_effect"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    UNKNOWN_EFFECT = "unknown_effect"
    TOO_FEW_RUNS = "too_few_runs"


class Step(StrEnum):
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
    HARDLY_SAVES = "hardly_saves"
    REFUTED_BY_CORES = "refuted_by_cores"
    CHANCE = "chance"
    RUNS_DISAGREE = "runs_disagree"


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
    heldout_gain_K: float  # noqa: N815
    heldout_ratio: float
    """Residual of runs left out over that of the model before."""
    core_K: Array  # noqa: N815
    """Root mean square distance from core thermocouples, NaN where a run has none (runs)."""


@dataclass(frozen=True)
class Evidence:
    """What is known after a search on top of the model so far."""

    runs: int
    left: PatternTest
    """Of the pattern that the model so far leaves in the residuals of all runs."""
    core_K: Array  # noqa: N815
    """Of the model so far, as `Claim.core_K` (runs)."""
    claims: tuple[Claim, ...] = ()
    """Of the candidates fitted to convergence."""
    sets: tuple[tuple[str, ...], ...] = ()
    """Of the causes in the model so far: each with what the runs cannot tell from it."""
    rim_is_cool: bool = False
    shares: tuple[float, ...] = ()
    """Of the plain model's pattern, explained with each further cause; only the verdict asks for it."""
    heldout_ratio: float = 1.0
    """Held-out residual of the model so far over the plain one's; asked of few runs."""
    faulty_channels: bool = False
    """The same channels are faulty in many runs."""


@dataclass(frozen=True)
class Decision:
    """A further cause, or the end."""

    step: Step
    verdict: Verdict
    """On the causes in the model so far."""
    kept: int
    """How many of them stand."""
    set: tuple[str, ...] = ()
    """The named cause first, then what these runs cannot tell from it."""
    strongest: str = ""
    """What the gains alone would name, before rim and cores are asked."""
    refuted: tuple[str, ...] = ()
    """What core thermocouples speak against, though the faces may fit."""


def decide(evidence: Evidence) -> Decision:
    """Name a further cause or stop, and give the verdict on the causes in the model so far."""
    best, causes = strongest(evidence), len(evidence.sets)
    unexplained = something_left(evidence)
    share = evidence.shares[0] if evidence.shares else 0.0
    few = evidence.runs < FEW_RUNS
    too_many = few and (causes > FEW_CAUSES or evidence.heldout_ratio > FEW_TOTAL)
    kept = 0 if too_many or (unexplained and share < EXPLAINED) else causes
    if unexplained:
        verdict = Verdict.UNKNOWN_EFFECT
    elif any(len(names) > 1 for names in evidence.sets[:kept]):
        verdict = Verdict.AMBIGUOUS
    elif kept or evidence.faulty_channels:
        verdict = Verdict.NAMED
    else:
        verdict = Verdict.TOO_FEW_RUNS if few else Verdict.NO_EFFECT
    if evidence.runs < 2:
        return Decision(Step.ONE_RUN, verdict, kept)
    if causes >= MOST_CAUSES:
        return Decision(Step.ENOUGH_CAUSES, verdict, kept)
    if best is None:
        step = Step.NO_CAUSE_CONVINCES if evidence.claims else Step.NOTHING_TO_TRY
        return Decision(step, verdict, kept)
    names, refuted = _what_fits_as_well(evidence, best)
    return Decision(Step.CAUSE_NAMED, verdict, kept, names, best.name, refuted)


def strongest(evidence: Evidence) -> Claim | None:
    """Return the candidate without objection that saves most."""
    able = [claim for claim in evidence.claims if objection(claim, evidence) is None]
    return max(able, key=lambda claim: claim.saved, default=None)


def objection(claim: Claim, evidence: Evidence) -> Objection | None:
    """Return the first thing that speaks against naming a candidate; None where nothing does."""
    further = bool(evidence.sets) and evidence.left.energy < NEGLIGIBLE_K**2 and not claim.measuring
    least_K = FURTHER_GAIN_K if further else LEAST_GAIN_K
    shows = claim.heldout_gain_K >= least_K and claim.heldout_ratio <= 1 - LEAST_GAIN_SHARE
    few = evidence.runs < FEW_RUNS
    stands = (claim.saves > 0).all() and claim.heldout_ratio <= FEW_STEP if few else agreed(claim.saves)
    against = {
        Objection.TOO_SMALL: claim.size < (SMALLEST_EXPONENT if claim.needs == Need.LOAD else SMALLEST_SIZE),
        Objection.NO_GAIN_LEFT_OUT: claim.saves.sum() <= 0,
        Objection.UNPHYSICAL: claim.unphysical,
        # moments make up for a clock that is off, so it saves no kelvins: the limit switch shows it
        Objection.HARDLY_SAVES: not shows and claim.needs != Need.SWITCH,
        Objection.REFUTED_BY_CORES: refuted_by_cores(claim.core_K, evidence.core_K),
        Objection.CHANCE: not few and claim.p_value > ALPHA,
        Objection.RUNS_DISAGREE: not stands,
    }
    return next((reason for reason, holds in against.items() if holds), None)


def _what_fits_as_well(evidence: Evidence, best: Claim) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the best cause with those these runs cannot tell from it, and the causes that cores refute.

    The measuring chain comes first: it is settled with least effort, bends coefficients most, and leaves the core
    alone. Rim sensors settle a set for the rim, core thermocouples make it smaller.
    """
    rivals = [c for c in evidence.claims if c is not best and c.saved > NEAR * best.saved]
    rivals = [c for c in rivals if c.size >= SMALLEST_SIZE / 2 and c.saves.sum() > 0 and not told_apart(best, c)]
    near = [best, *sorted(rivals, key=lambda c: -c.saved)[: LARGEST_SET - 1]]
    near.sort(key=lambda c: not (c.measuring and objection(c, evidence) is None))
    rim = [c for c in near if c.at_the_rim]
    near = rim if rim and evidence.rim_is_cool else near
    nearest_K = min((c.core_K for c in near), key=lambda errors: float(np.nansum(errors**2)))
    kept = [c for c in near if not refuted_by_cores(c.core_K, nearest_K)]
    refuted = [c.name for c in evidence.claims if refuted_by_cores(c.core_K, evidence.core_K)]
    refuted += [c.name for c in near if c not in kept]
    return tuple(c.name for c in kept), tuple(refuted)


def something_left(evidence: Evidence) -> bool:
    """Return whether the runs share a pattern that the named causes do not explain; few runs cannot show one."""
    causes, left = len(evidence.sets), evidence.left
    level = max(ALPHA_PATTERN, 0.5 ** (evidence.runs - 1))
    if evidence.runs < FEW_RUNS or left.p_value > level or left.energy < NEGLIGIBLE_K**2:
        return False
    share = evidence.shares[-1] if evidence.shares else 0.0
    return not (causes and share >= EXPLAINED and left.energy < (SMALL_K / causes) ** 2)


def refuted_by_cores(errors: Array, better: Array) -> bool:
    """Return whether core thermocouples, which no fit has seen, speak against a model in every run that has one.

    `errors` and `better`: how far a model and another are from them, NaN where none is (runs). [K]
    """
    known = np.isfinite(errors)
    if known.sum() < 2:
        return False
    e, b = errors[known], better[known]
    return bool(((e > CORE_RATIO * b) & (e > b + CORE_K)).all())


def told_apart(best: Claim, other: Claim) -> bool:
    """Return whether the runs prefer one cause to another beyond chance; few runs must all do so."""
    if len(best.saves) < FEW_RUNS:
        return not bool((other.saves >= best.saves).any())
    return paired_t(best.saves, other.saves) >= SURE_T


def agreed(saves: Array) -> bool:
    """Return whether most of the runs that say anything gain by a cause, with numbers from the others (runs)."""
    speaking = saves[np.abs(saves) > MATTERS]
    return len(speaking) > 0 and float((speaking > 0).mean()) >= AGREE
