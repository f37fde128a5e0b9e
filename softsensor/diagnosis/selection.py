"""Model selection: cause after cause is fitted, claimed and decided on (`decision`), until the rule stops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.records import Array
from softsensor.diagnosis.decision import (
    FEW_RUNS,
    MOST_CAUSES,
    UNPROVEN,
    Choice,
    Claim,
    Evidence,
    Objection,
    SearchStep,
    choose,
    explains_the_rest,
    objections,
    signed_root,
    strongest,
)
from softsensor.diagnosis.exchange import exchange, fit_alone
from softsensor.diagnosis.numbers import noise_floor, residual_K
from softsensor.diagnosis.search import FAR_OFF, Candidate, candidates_for, core_errors, extend, search
from softsensor.diagnosis.settling import SettledModel, panels_given
from softsensor.diagnosis.sign_flips import likelihood_p, max_t, tempered
from softsensor.effects import Need
from softsensor.effects.parameters import SMALL_SHARE

RIM_K, RIM_T = 0.15, 3.0
"""Rim sensors that fall by so much against central ones, and so many standard errors, speak for a loss at the rim.
Set by hand; means over virtual runs without one stay within 0.15 K. [K], [1]"""
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
    suspected: Candidate | None = None
    """Where none was chosen: the strongest that only lacks a sure gain, or does not explain what was left."""
    let_go: bool = False
    """Whether that is all that speaks against it."""

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
    base: SettledModel, effects: Sequence[str] | None, report: Progress, rim_is_cool: bool
) -> tuple[list[SettledModel], list[Round]]:
    """Search cause after cause; return the fits, plain model first, and what each search found.

    `rim_is_cool`: rim sensors fall against central ones.
    """
    stages, rounds, looked_again = [base], list[Round](), False
    before = Evidence(len(base.data), core_errors(base.fit, base.data), rim_is_cool=rim_is_cool)
    while len(rounds) < MOST_CAUSES:
        stage = stages[-1]
        pool = [
            e
            for e in candidates_for(stage)
            if (effects is None or e.name in effects) and e.name not in stage.effects
        ]
        if not pool:
            break
        found = search(stage, pool, _counted(report, len(rounds), len(pool)))
        rounds.append(judge(stage, found, replace(before, causes=len(rounds))))
        chosen = rounds[-1].chosen
        if chosen is None:
            break
        further = extend(stage, chosen)
        if len(stages) > 1 and not explains_the_rest(*left_beside(stages, further)):
            rounds[-1] = replace(rounds[-1], chosen=None, set=(), suspected=chosen, let_go=True)
            break
        stages.append(further)
        if len(rounds) == 2 and not looked_again:
            looked_again = True
            stages, rounds = _second_look(stages, rounds, before)
    return stages, rounds


def _counted(report: Progress, causes: int, size: int) -> Callable[[str], None]:
    """Return what reports each candidate of a search by its name and the share done."""
    done = 0

    def note(name: str) -> None:
        nonlocal done
        done += 1
        report(f"cause {causes + 1}: {name}", 0.05 + 0.28 * (causes + min(done / (size + 6), 1.0)))

    return note


def _second_look(
    stages: list[SettledModel], rounds: list[Round], before: Evidence
) -> tuple[list[SettledModel], list[Round]]:
    """Judge the first search again once a second cause is known; return where the search goes on from.

    The second cause is fitted alone, from the size it has beside the first, since where the plain model is far off
    a cause's own fit may not have found its way. Then others are tried in the place of the first.
    """
    base, second = stages[0], stages[-1].fit.layout.model.effects[-1]
    first = rounds[0]
    better = fit_alone(base, second, stages[-1])
    known = next((c for c in first.candidates if c.effect.name == second.name), None)
    if known is not None and not (known.refined and known.gain >= better.gain):
        candidates = [c for c in first.candidates if c is not known] + [better]
        first = judge(base, sorted(candidates, key=lambda c: (-c.gain, c.effect.name)), before)
        if first.chosen is not None and first.name != rounds[0].name:
            return [base, extend(base, first.chosen)], [first]
    everyone = np.arange(len(base.data))
    claims = {c.name: c for c in claims_of(base, first.candidates, first.p_values, everyone)}
    able = [c for c in first.candidates if c.refined and not objections(claims[c.effect.name], before)]
    if exchanged := exchange(stages, able, SMALL_SHARE):
        found, beside = exchanged
        name = found[1].effects[-1]
        chosen = next(c for c in first.candidates if c.effect.name == name)
        return found, [replace(first, chosen=chosen, set=(name,), refuted=()), replace(rounds[1], chosen=beside)]
    return stages, rounds


def left_beside(stages: Sequence[SettledModel], further: SettledModel) -> tuple[float, float]:
    """Return what the last of some stages leaves, and a model with a further cause, over what noise leaves.

    Where panels' own constants can make up for the cause, they are held at those given, or it explains nothing.
    """
    noise = noise_floor([*stages, further])
    before, after = stages[-1], further
    if after.fit.layout.model.effects[-1].of_constant:
        before, after = panels_given(before), panels_given(after)
    return residual_K(before) / noise, residual_K(after) / noise


def judge(stage: SettledModel, found: Sequence[Candidate], before: Evidence) -> Round:
    """Decide on a search, with all runs and without each of them. `before`: what is known of the stage."""
    everyone = np.arange(len(stage.data))
    p = chances(stage, found)
    evidence = replace(
        before, claims=claims_of(stage, found, p, everyone), core_K=core_errors(stage.fit, stage.data)
    )
    choice = choose(evidence)
    named = {c.effect.name: c for c in found}
    if choice.step is SearchStep.ONE_RUN:
        return Round(list(found), p, None, (), (None,))
    without = []
    for rest in (np.delete(everyone, r) for r in everyone):
        # which cause the others would choose, not whether: one run fewer has fewer flips
        claims = claims_of(stage, found, p, rest)
        fewer = replace(evidence, runs=len(rest), claims=claims, core_K=evidence.core_K[rest])
        best = strongest(fewer, allowed=UNPROVEN | {Objection.CHANCE})
        without.append(None if best is None else named[best.name])
    return _round(list(found), p, tuple(without), choice)


def _round(
    found: list[Candidate], p: dict[str, float], without: tuple[Candidate | None, ...], choice: Choice
) -> Round:
    if choice.step is not SearchStep.CAUSE_NAMED:
        suspected = next((c for c in found if c.effect.name == choice.suspected), None)
        return Round(found, p, None, (), without, suspected=suspected)
    chosen = next(c for c in found if c.effect.name == choice.set[0])
    return Round(found, p, chosen, choice.set, without, choice.strongest, choice.refuted)


def claims_of(
    stage: SettledModel, found: Sequence[Candidate], p: dict[str, float], runs: np.ndarray
) -> tuple[Claim, ...]:
    """Return what the candidates fitted to convergence have to show, as some of the runs see them."""
    some = stage.among(runs)
    return tuple(claim_of(some, c.among(stage, runs), p[c.effect.name]) for c in found if c.refined)


def claim_of(stage: SettledModel, candidate: Candidate, p: float) -> Claim:
    """Return what a candidate has to show against the stage it was fitted on top of."""
    return Claim(
        name=candidate.effect.name,
        measuring=candidate.effect.measuring,
        needs=candidate.effect.needs,
        at_the_rim=candidate.effect.at_the_rim,
        size=candidate.size,
        unphysical=candidate.too_large,
        p_value=p,
        saved=candidate.gain,
        saves=candidate.gains,
        gain=candidate.heldout_gain(stage),
        core_K=core_errors(candidate.fit, stage.data),
    )


def chances(stage: SettledModel, found: Sequence[Candidate]) -> dict[str, float]:
    """Return each candidate's p-value by flips, or by likelihood where that is less and may be believed.

    It may where the model with the candidate leaves no more than the readings' own noise, not that which was taken
    larger for what the plain model leaves: dry pine would get a heat capacity by it. What few runs can show is
    asked otherwise (`decision`), and of a clock the switch alone speaks.
    """
    runs = len(stage.data)
    p = p_values(found, np.arange(runs))
    for c in found if runs >= FEW_RUNS else ():
        if c.refined and c.effect.needs != Need.SWITCH and replace(stage, fit=c.fit).own_misfit <= FAR_OFF:
            p[c.effect.name] = min(p[c.effect.name], likelihood_p(c.gains, len(found)))
    return p


def p_values(found: Sequence[Candidate], runs: np.ndarray) -> dict[str, float]:
    """Return each candidate's p-value by flips, of runs' scores along its direction or of what they gain left out.

    The direction starts at the plain model's fit; where that is far off, most runs have bent away from it, and
    only their gains show that they agree. Both are flipped together, so that looking twice is paid for. A clock
    shows in the switch alone: its gains may come from anything that moves with the moments. That all runs lose by
    a cause, or that one which can only be positive would have to be negative, speaks for nothing.
    """
    scores = [c.score[runs] for c in found]
    roots = [signed_root(c.gains[runs]) * (c.effect.needs != Need.SWITCH) for c in found]
    upward = [c.effect.one_sided for c in found] + [True] * len(found)
    p = max_t(tempered(np.stack(scores + roots, axis=1)), upward, alike=True).reshape(-1, len(found)).min(axis=0)
    return dict(zip([c.effect.name for c in found], p.tolist(), strict=True))
