"""Causes as a diagnosis states them: what was taken in, what is only suspected, and what is a channel's fault."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from softsensor.diagnosis.extension import SharedFit, from_the_others, predicted
from softsensor.diagnosis.finding import Contest, Finding
from softsensor.diagnosis.gains import Gain, paired_gain
from softsensor.diagnosis.numbers import Errors, Interval, intervals, intervals_of_models, short
from softsensor.diagnosis.search import Candidate, extend
from softsensor.diagnosis.selection import Round
from softsensor.diagnosis.settling import SettledModel, gain_of, run_errors
from softsensor.diagnosis.sign_flips import PatternTest, paired_t, pattern_test, pockets
from softsensor.effects import find_effect, platen_offset, sensor_fault
from softsensor.signals.screen import LEAST_CHANNELS, ChannelFault

NOT_A_MODEL = Gain(0.0, None)
"""Of faulty channels: they are left out before anything is fitted."""


def sensor_findings(faults: Sequence[tuple[ChannelFault, ...]], columns: Iterable[str]) -> tuple[Finding, ...]:
    """Return the channels that stand apart in several runs as a cause, nothing where there is none."""
    if not columns:
        return ()
    name = sensor_fault.EFFECT.name
    share = sum(any(f.column in columns for f in run) for run in faults)
    value = Interval(tuple(columns), None)
    return (Finding(name, (name,), {"columns": value}, 2.0 ** (1 - share), NOT_A_MODEL, NOT_A_MODEL, 1.0),)


def explained(tests: Sequence[PatternTest]) -> list[float]:
    """Return the share of the plain model's common pattern that each stage explains, 0 for the plain model."""
    plain = tests[0].energy
    return [float(np.clip(1.0 - t.energy / plain, 0.0, 1.0)) if plain > 0 else 0.0 for t in tests]


def findings_of(
    stages: list[SettledModel],
    rounds: list[Round],
    shares: list[float],
    errors: Sequence[Errors],
    models: Sequence[SharedFit],
) -> tuple[Finding, ...]:
    """Return the causes taken in; `models`: the last fit, and that with what is suspected beside them."""
    found = []
    final = stages[-1]
    chosen = [(r, r.chosen) for r in rounds if r.chosen is not None]
    steps = zip(chosen, pairwise(stages), pairwise(shares), pairwise(errors), strict=True)
    for (round_, cause), (before, _), (share, more), (without, with_it) in steps:
        names = (*_alternatives(round_, cause, final.effects), *_lone_channels(cause.effect.name, final))
        against = [
            (c.effect.name, round(float(paired_t(cause.gains - c.gains)), 2))
            for c in round_.candidates
            if c.refined and c.effect.name not in round_.set
        ]
        found.append(
            Finding(
                name=cause.effect.name,
                set=names,
                parameters=intervals_of_models(models, cause.effect),
                p_value=short(round_.p_values[cause.effect.name]),
                gain=cause.held or gain_of(final.data, without.left_out, with_it.left_out),
                predicted=paired_gain(without.predicted, with_it.predicted),
                explained_share=short(max(more - share, 0.0)),
                against=tuple(against[:3]),
                saves=cause.saves,
                contest=_contest(before, round_.candidates, names),
            )
        )
    return tuple(found)


def with_the_suspected(stages: Sequence[SettledModel], rounds: Sequence[Round]) -> tuple[SettledModel, ...]:
    """Return the last model settled with what the last search suspected, if anything."""
    suspected = rounds[-1].suspected if rounds else None
    return () if suspected is None else (extend(stages[-1], suspected),)


def with_wider_intervals(causes: Sequence[Finding], models: Sequence[SharedFit]) -> tuple[Finding, ...]:
    """Return named causes with intervals that hold whether what is suspected beside them is there or not."""
    return tuple(replace(f, parameters=intervals_of_models(models, find_effect(f.name))) for f in causes)


def _contest(stage: SettledModel, found: Iterable[Candidate], names: Sequence[str]) -> Contest:
    tried = {c.effect.name: c for c in found}
    return Contest(stage, tuple(tried[name] for name in names if name in tried))


def _alternatives(round_: Round, cause: Candidate, named: Sequence[str]) -> tuple[str, ...]:
    """Return the set of a search without what is named beside its cause and gained no more alone.

    Needed beside the cause, it cannot stand in its place; nor can the cause then be spared beside it.
    """
    weaker = {c.effect.name for c in round_.candidates if c is not cause and c.gain <= cause.gain}
    return tuple(n for n in round_.set if n not in weaker.intersection(named))


def _lone_channels(cause: str, stage: SettledModel) -> tuple[str, ...]:
    """Return the name of faulty channels beside that of platens that are off, where nothing excludes the former.

    A platen that is off shifts what lies near it by a constant, and so reads a channel that is off. Three or more
    at a place are compared with each other; of fewer nobody knows.
    """
    if cause != platen_offset.EFFECT.name:
        return ()
    few = any(len(columns) < LEAST_CHANNELS for d in stage.data for columns in d.digest.channels.values())
    return (sensor_fault.EFFECT.name,) if few else ()


def nearly_named(
    rounds: Sequence[Round], stage: SettledModel, beside: tuple[SettledModel, ...]
) -> tuple[Finding, ...]:
    """Return the cause the last search would have chosen but for a sure gain; `beside`: the model with it."""
    if not beside or (c := rounds[-1].suspected) is None:
        return ()
    ahead = [predicted(f, stage.data, from_the_others(f, stage.data)) for f in (stage.fit, c.fit)]
    plain, with_it = (run_errors(stage.data, states) for states in ahead)
    return (
        Finding(
            name=c.effect.name,
            set=(c.effect.name, *_lone_channels(c.effect.name, stage)),
            parameters=intervals(beside[0].fit, c.effect),
            p_value=short(rounds[-1].p_values[c.effect.name]),
            gain=c.heldout_gain(stage),
            predicted=paired_gain(plain, with_it),
            explained_share=_explained_by(c, stage),
            saves=c.saves,
            contest=_contest(stage, (c,), (c.effect.name,)),
        ),
    )


def _explained_by(c: Candidate, stage: SettledModel) -> float:
    before = pattern_test(stage.pockets())
    after = pattern_test(pockets([d.digest for d in stage.data], [r.misfit for r in c.fit.runs]))
    return short(explained([before, after])[1])
