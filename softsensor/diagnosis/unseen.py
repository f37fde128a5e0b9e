"""Errors of the models on runs that neither fitted nor chose with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

from softsensor.diagnosis.extension import RunState, from_the_others, held_out, predicted
from softsensor.diagnosis.numbers import Errors, measure_errors
from softsensor.diagnosis.search import Candidate
from softsensor.diagnosis.selection import Round
from softsensor.diagnosis.settling import LeftOut, SettledModel
from softsensor.signals.digest import Whitened


def stage_errors(stages: Sequence[SettledModel], rounds: Sequence[Round]) -> list[Errors]:
    """Return the errors of every stage, its runs left out in turn (stages).

    Panels are as free in all of them as in the last: held the nearer to those given only in the models before it,
    they would favour its cause. They are held at those given in all where a cause is among them that they can
    make up for.
    """
    given = any(e.of_constant for e in stages[-1].fit.layout.model.effects)
    data = [[_panels_as(last, d, given) for last, d in zip(stages[-1].data, s.data, strict=True)] for s in stages]
    thetas = [from_the_others(s.fit, s.data, rounds=1) for s in stages]
    others = [held_out(s.fit, d, rounds=3, thetas=t) for s, d, t in zip(stages, data, thetas, strict=True)]
    ahead = [predicted(s.fit, s.data, t) for s, t in zip(stages, thetas, strict=True)]
    base = stages[0].data

    @cache
    def others_of(c: Candidate) -> list[RunState]:
        return held_out(c.fit, data[0], rounds=3, thetas=from_the_others(c.fit, base))

    @cache
    def ahead_of(c: Candidate) -> list[RunState]:
        return predicted(c.fit, base, from_the_others(c.fit, base))

    return [
        measure_errors(
            stage,
            LeftOut(never_seen(others[: i + 1], rounds, others_of), others[i]),
            never_seen(ahead[: i + 1], rounds, ahead_of),
        )
        for i, stage in enumerate(stages)
    ]


def _panels_as(last: Whitened, data: Whitened, given: bool) -> Whitened:
    return data.as_given if given else replace(data, panel_sd=last.panel_sd)


def never_seen(
    states: Sequence[Sequence[RunState]],
    rounds: Sequence[Round],
    of: Callable[[Candidate], Sequence[RunState]],
) -> list[RunState]:
    """Return each run as the others have it that neither fitted nor chose with it, by the last stage.

    Every search has been judged again without each run (`Round.without`). Where the others would have chosen
    another cause, the run has that one's state; where none, the model before.

    Parameters
    ----------
    states
        Runs by the others' numbers (stages, runs).
    of
        The same of a candidate (runs).
    """
    found = list(states[-1])
    for r in range(len(found)):
        for i, round_ in enumerate(rounds[: len(states) - 1]):
            chosen = round_.without[r]
            if chosen is None or chosen.effect.name != round_.voted:
                found[r] = states[i][r] if chosen is None else of(chosen)[r]
                break
    return found
