"""The jury: which candidate is named, what cannot be told from it, and when to stop.

Thresholds stand here with their reasons; see `diagnosis` for the method as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.records import Array
from softsensor.diagnosis_exchange import exchange, fit_alone
from softsensor.diagnosis_search import (
    Candidate,
    Stage,
    candidates_for,
    core_errors,
    extend,
    search,
)
from softsensor.diagnosis_tests import NEGLIGIBLE_K, adequacy, max_t, paired_t
from softsensor.extension import LOUDEST

ALPHA = 0.05
"""For a name; the size and held-out conditions on top make false names rarer than this."""
FEW_RUNS = 6
"""Below this sign flips cannot reach `ALPHA`."""
TWO_LOOKS = 8
"""Below so many runs there are too few flips to pay for asking gains as well as scores."""
LEAST_GAIN_K, LEAST_GAIN_SHARE = 0.005, 0.02
"""A cause must save this much on runs left out: kelvins, and share of the residual."""
FURTHER_GAIN_K = 0.015
"""The same for a further cause where what all runs have in common is negligible already: with many runs the least
fault of the first cause's law is sure, and would be given the names of causes that are not there. Not asked of the
measuring chain, which bends coefficients while hardly a kelvin shows. [K]"""
SMALLEST_SIZE = 0.25
"""Of an effect's typical size; below it a candidate is not a cause but a nuisance."""
LEAST_LOAD = 0.02
"""The same for an exponent of pressure: over a wide range of loads a small one is plain to see."""
SURE_T = 2.2
"""A candidate whose runs gain less by so many standard errors is told apart."""
NEAR = 0.5
"""A candidate must reach this share of the best gain to stand in its set."""
LARGEST_SET = 3
"""Within a set a cause in the measuring chain that could stand alone comes first: it is settled with least effort,
bends coefficients most, and leaves the core alone."""
RIM_EFFECT, RIM_K, RIM_T = "edge_loss", 0.15, 3.0
"""Rim sensors that fall by so much against central ones, and so many standard errors, settle a set for it."""
MOST_EFFECTS, FEW_EFFECTS = 3, 1
"""With few runs nothing vetoes what two or three causes explain together, as faults outside the catalogue. They
are looked for all the same: a second one shows where the first was wrong."""
AGREE, SAYS = 0.6, 4.0
"""Share of the runs that must gain by a cause with numbers from the others, of those that say anything: whose
sum of squares changes by more than the second, two standard deviations of one number."""
CORE_RATIO, CORE_K = 1.5, 0.5
"""Core thermocouples speak against a cause that is off by this factor and so much more than the best one."""
FEW_STEP, FEW_TOTAL = 0.85, 0.5
"""With few runs a cause brings the held-out residual down to the first share of the fitted one before, and to the
second of the held-out one."""
Progress = Callable[[str, float], None]
"""Called with what is being done and the share done."""


@dataclass(frozen=True)
class Round:
    """One search: what was found, and how sure."""

    candidates: list[Candidate]
    p_values: dict[str, float]
    chosen: Candidate | None
    set: tuple[str, ...]
    without: tuple[Candidate | None, ...] = ()
    """What would have been chosen without each run."""
    voted: str = ""
    """What all runs chose, before rim and cores were asked."""
    refuted: tuple[str, ...] = ()
    """Causes that the surfaces may like and core thermocouples speak against."""

    @property
    def name(self) -> str:
        """Of the chosen cause, empty for none."""
        return "" if self.chosen is None else self.chosen.effect.name


def cool_rim(falls: Array) -> bool:
    """Whether rim sensors fall against central ones in the runs, beyond chance."""
    known = falls[np.isfinite(falls)]
    if len(known) < 2:
        return False
    error = float(np.std(known, ddof=1)) / np.sqrt(len(known))
    return bool(known.mean() < -RIM_K and known.mean() < -RIM_T * error)


def search_all(
    base: Stage, effects: Sequence[str] | None, tell: Progress, rim_is_cool: bool
) -> tuple[list[Stage], list[Round]]:
    """Search cause after cause; return the fits, plain model first, and what each search found.

    `rim_is_cool`: rim sensors fall against central ones.
    """
    stages, looked_again = [base], False
    rounds: list[Round] = []
    while len(rounds) < MOST_EFFECTS:
        stage, number = stages[-1], len(rounds)
        pool = [
            e
            for e in candidates_for(stage)
            if (effects is None or e.name in effects) and e.name not in stage.effects
        ]
        if not pool:
            break
        done = {"n": 0}

        def note(name: str, number: int = number, size: int = len(pool), done: dict[str, int] = done) -> None:
            done["n"] += 1
            tell(f"cause {number + 1}: {name}", 0.05 + 0.28 * (number + min(done["n"] / (size + 6), 1.0)))

        found = _judge(stage, search(stage, pool, note), rim_is_cool)
        rounds.append(found)
        if found.chosen is None:
            break
        stages.append(extend(stage, found.chosen))
        if len(rounds) == 2 and not looked_again:
            looked_again = True
            again = _second_look(base, rounds[0], stages[-1], rim_is_cool)
            if again.chosen is not None and again.name != rounds[0].name:
                stages, rounds = [base, extend(base, again.chosen)], [again]
                continue
            refined = [c for c in again.candidates if c.refined]
            able = [c for c in refined if _acceptable(base, c, again.p_values[c.effect.name])]
            if better := exchange(stages, able, SMALLEST_SIZE):
                stages = better
                rounds[0] = _exchanged(again, stages[1].effects[-1])
    return stages, rounds


def _second_look(base: Stage, first: Round, both: Stage, rim_is_cool: bool) -> Round:
    """Judge the first search again with its second cause fitted alone, from the size it has beside the first.

    Where the plain model is far off, a cause's own fit may not find its way; found second, it shows how far it
    gets by itself.
    """
    second = both.fit.layout.model.effects[-1]
    better = fit_alone(base, second, both)
    known = next((c for c in first.candidates if c.effect.name == second.name), None)
    if known is None or (known.refined and known.gain >= better.gain):
        return first
    others = [c for c in first.candidates if c is not known]
    return _judge(base, sorted([*others, better], key=lambda c: (-c.gain, c.effect.name)), rim_is_cool)


def _exchanged(first: Round, name: str) -> Round:
    """Return the first round with the cause that a later one proved right."""
    chosen = next(c for c in first.candidates if c.effect.name == name)
    return replace(first, chosen=chosen, set=(name,), refuted=())


def _judge(stage: Stage, found: list[Candidate], rim_is_cool: bool) -> Round:
    runs, least = len(stage.data), least_gain(stage)
    everyone, before = np.arange(runs), core_errors(stage.fit, stage.data)
    p = _p_values(found, everyone)
    if runs < 2:
        return Round(found, p, None, (), (None,) * runs)
    chosen = _choose(stage, found, p, everyone, least)
    rests = [np.delete(everyone, r) for r in range(runs)]
    without = [_choose(stage, found, _p_values(found, rest), rest, least) for rest in rests]
    if chosen is None:
        return Round(found, p, None, (), tuple(without))
    near = [c for c in _rivals(found, chosen) if _not_told_apart(chosen.gains, c.gains)]
    jury = [chosen, *sorted(near, key=lambda c: -c.gain)[: LARGEST_SET - 1]]
    jury.sort(key=lambda c: not (c.effect.measuring and _acceptable(stage, c, p[c.effect.name], least)))
    rim = [c for c in jury if c.effect.name == RIM_EFFECT]
    jury = rim if rim and rim_is_cool else jury
    cores = {c.effect.name: core_errors(c.fit, stage.data) for c in jury}
    best = min(cores.values(), key=lambda e: float(np.nansum(e**2)))
    kept = [c for c in jury if not refuted_by_cores(cores[c.effect.name], best)]
    refuted = [
        c.effect.name for c in found if c.refined and refuted_by_cores(core_errors(c.fit, stage.data), before)
    ]
    refuted += [c.effect.name for c in jury if c not in kept]
    names = tuple(c.effect.name for c in kept)
    return Round(found, p, kept[0], names, tuple(without), chosen.effect.name, tuple(refuted))


def _p_values(found: Sequence[Candidate], runs: np.ndarray) -> dict[str, float]:
    """Return each candidate's p-value: by what runs say along its direction, or by what they gain left out.

    The direction starts at the plain model's fit; where that is far off, most runs have bent away from it, and
    only their gains show that they agree. Both are flipped together, so that looking twice is paid for. A clock
    shows in the switch alone: its gains may come from anything that moves with the moments.
    """
    says = [c.score[runs] for c in found]
    if len(runs) >= TWO_LOOKS:
        loudest = LOUDEST**2
        says += [np.clip(c.gains[runs], -loudest, loudest) * (c.effect.needs != "closed") for c in found]
    p = max_t(np.stack(says, axis=1)).reshape(-1, len(found)).min(axis=0)
    return dict(zip([c.effect.name for c in found], p.tolist(), strict=True))


def least_gain(stage: Stage) -> float:
    """Return what a cause on top of a stage must save on runs left out. [K]"""
    if not stage.effects:
        return LEAST_GAIN_K
    return FURTHER_GAIN_K if adequacy(stage.pockets()).energy < NEGLIGIBLE_K**2 else LEAST_GAIN_K


def _choose(
    stage: Stage, found: Sequence[Candidate], p: dict[str, float], runs: np.ndarray, least: float
) -> Candidate | None:
    """Return the acceptable cause that saves most, judged by some of the runs only."""
    some = stage.among(runs)
    part = [c.among(stage, runs) for c in found if c.refined]
    able = [c for c in part if _acceptable(some, c, p[c.effect.name], least)]
    if not able:
        return None
    best = max(able, key=lambda c: c.gain)
    return next(c for c in found if c.effect.name == best.effect.name)


def _rivals(found: Sequence[Candidate], chosen: Candidate) -> list[Candidate]:
    near = [c for c in found if c is not chosen and c.refined and c.gain > NEAR * chosen.gain]
    return [c for c in near if c.large_enough(SMALLEST_SIZE / 2) and c.gains.sum() > 0]


def refuted_by_cores(errors: Array, better: Array) -> bool:
    """Whether core thermocouples, which no fit has seen, speak against a model in every run that has one.

    `errors` and `better`: how far a model and its rival are from them, NaN where none is (runs). [K]
    """
    known = np.isfinite(errors)
    if known.sum() < 2:
        return False
    e, b = errors[known], better[known]
    return bool(((e > CORE_RATIO * b) & (e > b + CORE_K)).all())


def _not_told_apart(best: Array, other: Array) -> bool:
    if len(best) < FEW_RUNS:
        return bool((other >= best).any())
    return paired_t(best, other) < SURE_T


def agreed(gains: Array) -> bool:
    """Whether most of the runs that say anything gain by a cause, with numbers from the others (runs)."""
    speaking = gains[np.abs(gains) > SAYS]
    return len(speaking) > 0 and float((speaking > 0).mean()) >= AGREE


def _acceptable(stage: Stage, candidate: Candidate, p: float, least: float = LEAST_GAIN_K) -> bool:
    size = LEAST_LOAD if candidate.effect.needs == "load" else SMALLEST_SIZE
    if not candidate.large_enough(size) or candidate.gains.sum() <= 0 or candidate.too_large:
        return False
    ratio = candidate.heldout_ratio(stage)
    least = LEAST_GAIN_K if candidate.effect.measuring else least
    seen = candidate.heldout_gain(stage) >= least and ratio <= 1 - LEAST_GAIN_SHARE
    if not seen and candidate.effect.needs != "closed":
        return False
    if refuted_by_cores(core_errors(candidate.fit, stage.data), core_errors(stage.fit, stage.data)):
        return False
    if len(stage.data) >= FEW_RUNS:
        return p <= ALPHA and agreed(candidate.gains)
    return bool((candidate.gains > 0).all()) and ratio <= FEW_STEP
