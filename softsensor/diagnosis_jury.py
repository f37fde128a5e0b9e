"""The jury: which candidate is named, what cannot be told from it, and when to stop.

Thresholds stand here with their reasons; see `diagnosis` for the method as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.records import Array
from softsensor.diagnosis_search import Candidate, Stage, candidates_for, exchange, extend, large_in, search
from softsensor.diagnosis_tests import max_t, paired_t

ALPHA = 0.05
"""For a name; the size and held-out conditions on top make false names rarer than this."""
FEW_RUNS = 6
"""Below this sign flips cannot reach `ALPHA`."""
LEAST_GAIN_K, LEAST_GAIN_SHARE = 0.005, 0.02
"""A cause must save this much on runs left out: kelvins, and share of the residual."""
SMALLEST_SIZE = 0.25
"""Of an effect's typical size; below it a candidate is not a cause but a nuisance."""
LEAST_LOAD = 0.02
"""The same for an exponent of pressure: over a wide range of loads a small one is plain to see."""
SURE_T = 2.2
"""A candidate whose runs gain less by so many standard errors is told apart."""
NEAR = 0.5
"""A candidate must reach this share of the best gain to stand in its set."""
LARGEST_SET = 3
RIM_EFFECT, RIM_K, RIM_T = "edge_loss", 0.15, 3.0
"""Rim sensors that fall by so much against central ones, and so many standard errors, settle a set for it."""
MOST_EFFECTS = 3
FEW_STEP, FEW_TOTAL = 0.85, 0.5
"""With few runs each cause brings the held-out residual down to the first share, all together to the second."""
STRONG, LENIENT = 40.0, 0.2
"""Runs that differ much in what they can say (thin and thick panels) count as fewer in sign flips. A cause that
saves so much misfit on runs left out, in two thirds of them, is named up to this p-value."""

Progress = Callable[[str, float], None]
"""Called with what is being done and the share done."""


@dataclass(frozen=True)
class Round:
    """One search: what was found, and how sure."""

    candidates: list[Candidate]
    p_values: dict[str, float]
    chosen: Candidate | None
    set: tuple[str, ...]


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
    stages, rounds = [base], []
    for number in range(MOST_EFFECTS):
        stage = stages[-1]
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

        found = _judge(stage, search(stage, pool, note))
        if rim_is_cool:
            found = _rim_decides(found)
        rounds.append(found)
        if found.chosen is None:
            break
        stages.append(extend(stage, found.chosen))
        if number == 1:
            first = rounds[0]
            able = [
                c for c in first.candidates if c.refined and _acceptable(base, c, first.p_values[c.effect.name])
            ]
            better = exchange(stages, able)
            if better is not None:
                stages = better
                rounds = [_again(rounds[0], stages[1].effects[-1]), found]
            stages, rounds = _without_shadow(stages, rounds)
    return stages, rounds


def _without_shadow(stages: list[Stage], rounds: list[Round]) -> tuple[list[Stage], list[Round]]:
    """Drop a first cause that the second leaves nothing of: it only stood in for it."""
    model = stages[-1].fit.layout.model
    first, second = model.effects[0], model.effects[1].name
    least = LEAST_LOAD if first.needs == "load" else SMALLEST_SIZE
    alone = next((c for c in rounds[0].candidates if c.refined and c.effect.name == second), None)
    if alone is None or large_in(stages[-1].fit, first, least):
        return stages, rounds
    return [stages[0], extend(stages[0], alone)], [replace(rounds[0], chosen=alone, set=(second,))]


def _rim_decides(found: Round) -> Round:
    """Where the set holds a rim loss and the rim is seen to be cool, it is the rim loss."""
    rim = next((c for c in found.candidates if c.effect.name == RIM_EFFECT), None)
    if rim is None or RIM_EFFECT not in found.set:
        return found
    return replace(found, chosen=rim, set=(RIM_EFFECT,))


def _again(first: Round, name: str) -> Round:
    """Return the first round with the cause that a later one proved right."""
    chosen = next(c for c in first.candidates if c.effect.name == name)
    return replace(first, chosen=chosen, set=(name,))


def _judge(stage: Stage, found: list[Candidate]) -> Round:
    scores = np.stack([c.score for c in found], axis=1)
    p = dict(zip([c.effect.name for c in found], max_t(scores).tolist(), strict=True))
    able = [c for c in found if c.refined and _acceptable(stage, c, p[c.effect.name])]
    if not able:
        return Round(found, p, None, ())
    chosen = max(able, key=lambda c: c.gain)
    others = [c for c in found if c is not chosen and c.refined and c.gain > NEAR * chosen.gain]
    others = [c for c in others if c.large_enough(SMALLEST_SIZE / 2) and c.gains.sum() > 0]
    near = [c for c in others if _not_told_apart(chosen.gains, c.gains)]
    near = sorted(near, key=lambda c: -c.gain)[: LARGEST_SET - 1]
    return Round(found, p, chosen, (chosen.effect.name, *(c.effect.name for c in near)))


def _not_told_apart(best: Array, other: Array) -> bool:
    if len(best) < FEW_RUNS:
        return bool((other >= best).any())
    return paired_t(best, other) < SURE_T


def _acceptable(stage: Stage, candidate: Candidate, p: float) -> bool:
    runs = len(stage.data)
    ratio = candidate.heldout_ratio(stage)
    size = LEAST_LOAD if candidate.effect.needs == "load" else SMALLEST_SIZE
    if not candidate.large_enough(size) or candidate.gains.sum() <= 0:
        return False
    seen = candidate.heldout_gain(stage) >= LEAST_GAIN_K and ratio <= 1 - LEAST_GAIN_SHARE
    if not seen and candidate.effect.needs != "closed":
        return False
    if runs >= FEW_RUNS:
        agree = float((candidate.gains > 0).mean())
        return (p <= ALPHA and agree >= 0.6) or (
            p <= LENIENT and agree >= 0.66 and float(candidate.gains.sum()) >= STRONG
        )
    return runs >= 2 and bool((candidate.gains > 0).all()) and candidate.heldout_ratio(stage) <= FEW_STEP
