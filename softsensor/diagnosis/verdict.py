"""What the simulation gets wrong, the cause by name, the extended model, and what it gains.

The method and why it is so:

1. Faulty channels are found first, by comparison with their neighbours, and left out (`suspect_channels`).
2. Each run is boiled down to place means in bins (`digest`) and fitted together with all others: its
   own coefficients, moments, start temperature, platen errors and sensor offsets, with priors learned
   from the campaign, and conductivity and heat capacity about those given, as panels of one product differ
   (`extension`). What these can absorb is no evidence for a cause. Where a model is further off than noise, panels
   are held the nearer to those given, or they would take up what it leaves (`settling.finer`).
3. Every candidate of the catalogue is fitted for real on top, all of that following it. A score along a
   finite-size secant gives each run's score, and so does what it gains by numbers from the others, large ones
   tempered; signs of whole runs are flipped for the p-value, with the maximum over candidates
   and both; where a candidate leaves no more than noise, the likelihood of runs left out may say more than flips
   of a few runs can (`diagnosis.sign_flips`). The facts this project started from name samples tested as if
   independent as the classic error: 84 to 100 % false names.
4. Two rules decide (`decision`). The best candidate is taken in if its p-value holds, if runs left out gain by it
   with an interval above nothing, if its size is physical, core thermocouples do not speak against it, and beside
   a cause taken in before, if it explains what that one leaves beyond noise (`EXPLAINED_FURTHER`): else that
   one's law is off. Candidates that fit the runs as well form its `set`; core thermocouples, which no fit
   sees, make it smaller. Within a set the measuring chain comes first.
5. The same again on top of the extended model, for a second and third cause. A second cause is then tried
   alone, since where the plain model is far off a cause may not have found its way, and others are tried
   in the place of the first (`diagnosis.exchange`).
6. The verdict answers three questions: is something left, does a named cause explain it, is the gain real.
   Residuals of all runs are averaged by place and time since the last event; a model that explains less than four
   fifths of that common pattern's energy is not the cause, however significant. Gains are asked for on runs left
   out, in kelvins and with contacts at their price, and on runs predicted from their headers alone.

Better than a linear score test alone: all candidates get a non-linear fit, so amplitude and shape are
right before anything is compared; timing, lag and clock, which bend coefficients by a factor, get it
with the coefficients free.

Held-out numbers: each run by shared numbers fitted to the others, and by the cause that the others would have
chosen without it (`never_seen`); its own contacts, offsets, share of a cause and, unless a cause is one of them,
its panel's own constants are fitted to it, or for a prediction left at what the others say. Sizes of noise and
scatter, and starting points of fits, come from all runs.

With fewer than six runs no p-value can fall below 0.05 by flipping. A cause is then named only if it is the only
one found, every single run, by numbers from the others, gains by it, the interval of the gain lies above nothing,
the held-out residual at least halves, and every candidate outside the set loses in every run; else the verdict is
`too_few_runs`.

What stays hidden: an exponent of pressure of 0.5 to 1 over 280 to 400 N/cm2 in twelve runs whose contacts
scatter by 12 to 30 %; even the true contacts would show it in 28 % of campaigns (96 runs: 93 %).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from daq.press.press_file import Press, press_for_run
from daq.records import Array, InputError, Run
from daq.words import Message, say, spoken
from softsensor.diagnosis.advice import AdviceBasis, next_measurement, notes, rim_notes, spike_notes
from softsensor.diagnosis.decision import (
    ALPHA_PATTERN,
    Proof,
    Remains,
    Verdict,
    VerdictBasis,
    conclude,
    something_left,
)
from softsensor.diagnosis.extension import RunState, SharedFit, from_the_others, held_out, predicted
from softsensor.diagnosis.extension_unknowns import is_shape
from softsensor.diagnosis.finding import Contest, Diagnosis, Finding
from softsensor.diagnosis.gains import Gain, paired_gain
from softsensor.diagnosis.laws.choice import free_law
from softsensor.diagnosis.numbers import (
    Errors,
    Interval,
    intervals,
    intervals_of_models,
    is_described,
    measure_errors,
    noise_floor,
)
from softsensor.diagnosis.search import Candidate, extend
from softsensor.diagnosis.selection import Progress, Round, cool_rim, search_all
from softsensor.diagnosis.settling import SettledModel, panels_as_usual, run_errors, settle_base, with_whole_panels
from softsensor.diagnosis.sign_flips import PatternTest, paired_t, pattern_test, pockets
from softsensor.diagnosis.where import MOST, stretches, where_row
from softsensor.effects import Effect, find_effect, platen_offset, sensor_fault
from softsensor.heat.model import ThermalModel
from softsensor.heat.run_checks import load_remarks
from softsensor.signals.digest import Digest, Whitened, screened_digest
from softsensor.signals.faces import rim_falls
from softsensor.signals.screen import LEAST_CHANNELS, ChannelFault, recurring
from softsensor.signals.spikes import Spikes

NOT_A_MODEL = Gain(0.0, None)
"""Of faulty channels: they are left out before anything is fitted."""


def diagnose(
    press: Press,
    runs: Sequence[Run],
    progress: Progress | None = None,
    effects: Sequence[str] | None = None,
    *,
    law: bool | None = None,
) -> Diagnosis:
    """Diagnose a campaign.

    Parameters
    ----------
    press
        The press the runs come from; headers may override it.
    runs
        Measured runs, in any order: they are worked on in the order of their names.
    progress
        Called with what is being done and the share done.
    effects
        Candidates; by default the whole catalogue.
    law
        Whether to look for what is missing as a free function; by default where the verdict is unknown.

    Raises
    ------
    InputError
        For no run, one that does not fit the press, or a candidate the catalogue does not hold.
    """
    began = time.perf_counter()
    report = progress or (lambda what, share: None)
    for name in effects or ():
        find_effect(name)
    if not runs:
        raise InputError(say("diagnosis-no-runs"))
    report("reading runs", 0.0)
    readings, digests = _screened(press, sorted(runs, key=lambda r: r.name))
    report("plain model", 0.03)
    base = settle_base(ThermalModel(press), digests)
    stages, rounds = search_all(base, effects, report, cool_rim(readings.rim))
    report("what is left", 0.9)
    found = _conclude(readings, stages, rounds)
    if law or (law is None and found.verdict is Verdict.UNKNOWN_EFFECT):
        report("law", 0.95)
        found = replace(found, law=free_law(found.final))
    return replace(found, seconds=round(time.perf_counter() - began, 3))


@dataclass(frozen=True)
class _Readings:
    """The runs, and what comparing channels with their neighbours has shown of each."""

    press: Press
    runs: Sequence[Run]
    faults: Sequence[tuple[ChannelFault, ...]]
    spikes: Sequence[tuple[Spikes, ...]]
    """Cells of platens that were left out, by run."""
    rim: Array
    """By how much rim sensors fall against central ones (runs). [K]"""


def _screened(press: Press, runs: Sequence[Run]) -> tuple[_Readings, list[Digest]]:
    """Return the readings, and a digest of each run without its faulty channels."""
    digests, faults, spikes = zip(*(screened_digest(press, run) for run in runs), strict=True)
    rim = [
        rim_falls(press, digest.run, digest.moments, frozenset(fault.column for fault in found))
        for digest, found in zip(digests, faults, strict=True)
    ]
    return _Readings(press, runs, faults, spikes, np.array(rim)), list(digests)


def _lacking_loads(press: Press, runs: Sequence[Run]) -> list[Message]:
    return [spoken(remark) for run in runs for remark in load_remarks(press_for_run(press, run), run)]


def _conclude(readings: _Readings, stages: list[SettledModel], rounds: list[Round]) -> Diagnosis:
    press, runs, faults = readings.press, readings.runs, readings.faults
    tests = [pattern_test(s.pockets()) for s in stages]
    shares = _explained(tests)
    columns = recurring(faults)
    errors = _errors(stages, rounds)
    noise = noise_floor(stages)
    beside = _with_the_suspected(stages, rounds)
    models = [s.fit for s in (*stages, *beside)]
    causes = _findings(stages, rounds, shares, errors, models[len(stages) - 1 :])
    nearly = _nearly(rounds, stages[-1], beside)
    basis = VerdictBasis(
        runs=len(runs),
        proofs=tuple(_proof(f, errors[0], e, noise) for f, e in zip(causes, errors[1:], strict=True)),
        remains=tuple(
            _remains(s, t, share, e, noise) for s, t, share, e in zip(stages, tests, shares, errors, strict=True)
        ),
        faulty_channels=bool(columns),
        suspected=bool(nearly),
        let_go=bool(rounds) and rounds[-1].let_go,
    )
    conclusion = conclude(basis)
    named = conclusion.named
    suspected = causes[named:] + nearly
    findings = _sensor_findings(faults, columns) + _with_wider_intervals(causes[:named], models[named:])
    to_confirm = () if something_left(basis.remains[named], len(runs)) else suspected
    base, extended = errors[0], errors[named]
    advice_basis = AdviceBasis(len(runs), bool(press.panel_layers), base.core_rmse_K, extended.core_rmse_K)
    return Diagnosis(
        verdict=conclusion.verdict,
        findings=findings,
        suspected=suspected,
        base=base,
        extended=extended,
        noise_floor_K=_rounded(noise),
        where=_where(stages[0]),
        candidates=_candidate_rows(rounds, stages, (*findings, *suspected)),
        next_measurement=next_measurement(conclusion.verdict, findings, advice_basis, to_confirm),
        seconds=0.0,
        faults={r.name: f for r, f in zip(runs, faults, strict=True) if f},
        stages=tuple(stages[: named + 1]),
        remains=basis.remains[: named + 1],
        rivals=_rivals(rounds),
        warnings=(
            *notes(runs, faults, rounds),
            *spike_notes(readings.spikes),
            *rim_notes(readings.rim),
            *_lacking_loads(press, runs),
        ),
    )


def _remains(stage: SettledModel, test: PatternTest, explained: float, errors: Errors, noise_K: float) -> Remains:
    middle, differ = panels_as_usual(with_whole_panels(stage) if stage.effects else stage)
    return Remains(
        pattern=test,
        explained=explained,
        times_noise=errors.weighed_rmse_K / noise_K,
        described=is_described(errors.rmse_K, noise_K, [d.digest for d in stage.data]),
        panels_as_given=middle > ALPHA_PATTERN / 2,
        panels_alike=differ > ALPHA_PATTERN / 2,
    )


def _proof(found: Finding, plain: Errors, with_it: Errors, noise: float) -> Proof:
    return Proof(
        set=found.set,
        gain=found.gain,
        predicted=found.predicted,
        saves=found.saves,
        times_noise=with_it.weighed_rmse_K / noise,
        size_is_sure=_size_is_sure(find_effect(found.name), found.parameters),
        heldout_ratio=float(np.exp(np.mean(np.log(with_it.heldout / plain.heldout)))),
    )


def _errors(stages: Sequence[SettledModel], rounds: Sequence[Round]) -> list[Errors]:
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
            stage, never_seen(others[: i + 1], rounds, others_of), never_seen(ahead[: i + 1], rounds, ahead_of)
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


def _size_is_sure(effect: Effect, parameters: dict[str, Interval]) -> bool:
    """Return whether the interval of an amplitude leaves out the value at which the cause is absent."""
    sizes = [(p.neutral, parameters[p.name].ci95) for p in effect.parameters if not is_shape(p)]
    return any(ci is not None and not ci[0] <= neutral <= ci[1] for neutral, ci in sizes)


def _sensor_findings(faults: Sequence[tuple[ChannelFault, ...]], columns: Iterable[str]) -> tuple[Finding, ...]:
    if not columns:
        return ()
    name = sensor_fault.EFFECT.name
    share = sum(any(f.column in columns for f in run) for run in faults)
    value = Interval(tuple(columns), None)
    return (Finding(name, (name,), {"columns": value}, 2.0 ** (1 - share), NOT_A_MODEL, NOT_A_MODEL, 1.0),)


def _explained(tests: Sequence[PatternTest]) -> list[float]:
    """Return the share of the plain model's common pattern that each stage explains, 0 for the plain model."""
    plain = tests[0].energy
    return [float(np.clip(1.0 - t.energy / plain, 0.0, 1.0)) if plain > 0 else 0.0 for t in tests]


def _findings(
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
                p_value=_rounded(round_.p_values[cause.effect.name]),
                gain=cause.held or paired_gain(without.heldout, with_it.heldout),
                predicted=paired_gain(without.predicted, with_it.predicted),
                explained_share=_rounded(max(more - share, 0.0)),
                against=tuple(against[:3]),
                saves=cause.saves,
                contest=_contest(before, round_.candidates, names),
            )
        )
    return tuple(found)


def _with_the_suspected(stages: Sequence[SettledModel], rounds: Sequence[Round]) -> tuple[SettledModel, ...]:
    """Return the last model settled with what the last search suspected, if anything."""
    suspected = rounds[-1].suspected if rounds else None
    return () if suspected is None else (extend(stages[-1], suspected),)


def _with_wider_intervals(causes: Sequence[Finding], models: Sequence[SharedFit]) -> tuple[Finding, ...]:
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


def _nearly(rounds: Sequence[Round], stage: SettledModel, beside: tuple[SettledModel, ...]) -> tuple[Finding, ...]:
    """Return the cause the last search would have chosen but for a sure gain; `beside`: the model with it."""
    if not beside or (c := rounds[-1].suspected) is None:
        return ()
    ahead = [predicted(f, stage.data, from_the_others(f, stage.data)) for f in (stage.fit, c.fit)]
    return (
        Finding(
            name=c.effect.name,
            set=(c.effect.name,),
            parameters=intervals(beside[0].fit, c.effect),
            p_value=_rounded(rounds[-1].p_values[c.effect.name]),
            gain=c.heldout_gain(stage),
            predicted=paired_gain(*(run_errors(stage.data, states) for states in ahead)),
            explained_share=_explained_by(c, stage),
            saves=c.saves,
            contest=_contest(stage, (c,), (c.effect.name,)),
        ),
    )


def _explained_by(c: Candidate, stage: SettledModel) -> float:
    before = pattern_test(stage.pockets())
    after = pattern_test(pockets([d.digest for d in stage.data], [r.misfit for r in c.fit.runs]))
    return _rounded(_explained([before, after])[1])


def _where(plain: SettledModel) -> tuple[dict[str, Any], ...]:
    """Where the plain simulation is wrong, most kelvins first."""
    digests = [d.digest for d in plain.data]
    found = stretches(digests, [r.misfit for r in plain.fit.runs])[:MOST]
    return tuple(where_row(p, digests) for p in found)


def _candidate_rows(
    rounds: list[Round], stages: list[SettledModel], found: Sequence[Finding]
) -> tuple[dict[str, Any], ...]:
    """Return what each cause had to show; one that is named or suspected saves what its finding states.

    The others were not settled: theirs is what the search's fit of them alone saves.
    """
    if not rounds:
        return ()
    rows = []
    settled = {finding.name: finding.gain for finding in found}
    for c in rounds[0].candidates:
        rows.append(
            {
                "name": c.effect.name,
                "score": _rounded(c.gain),
                "p_value": _rounded(rounds[0].p_values[c.effect.name]),
                "heldout_gain_K": _rounded((settled.get(c.effect.name) or c.heldout_gain(stages[0])).value_K),
            }
        )
    return tuple(rows)


def _rivals(rounds: list[Round]) -> tuple[tuple[str, Array], ...]:
    if not rounds:
        return ()
    first = rounds[0]
    refined = [c for c in first.candidates if c.refined]
    refined.sort(key=lambda c: (c is not first.chosen, -c.gain))
    return tuple((c.effect.name, c.gains) for c in refined[:3])


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
