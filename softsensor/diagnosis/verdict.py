"""What the simulation gets wrong, the cause by name, the extended model, and what it gains.

The method and why it is so:

1. Faulty channels are found first, by comparison with their neighbours, and left out (`screen.faulty_channels`).
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
chosen without it (`unseen.never_seen`); its own contacts, offsets, share of a cause and, unless a cause is one of
them, its panel's own constants are fitted to it, or for a prediction left at what the others say. Sizes of noise
and scatter, and starting points of fits, come from all runs.

With fewer than six runs no p-value can fall below 0.05 by flipping. A cause is then named only if it is the only
one found, every single run, by numbers from the others, gains by it, the interval of the gain lies above nothing,
the held-out residual at least halves, and every candidate outside the set loses in every run; else the verdict is
`too_few_runs`.

What stays hidden: an exponent of pressure of 0.5 to 1 over 280 to 400 N/cm2 in twelve runs whose contacts
scatter by 12 to 30 %; even the true contacts would show it in 28 % of campaigns (96 runs: 93 %).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import Press, press_for_run
from daq.records import Array, InputError, Run
from daq.words import Message, say, spoken
from softsensor.diagnosis.advice import (
    CORE_OFF_K,
    AdviceBasis,
    next_measurement,
    notes,
    rim_notes,
    spike_notes,
    thickness_notes,
)
from softsensor.diagnosis.causes import (
    explained,
    findings_of,
    nearly_named,
    sensor_findings,
    with_the_suspected,
    with_wider_intervals,
)
from softsensor.diagnosis.decision import (
    ALPHA_PATTERN,
    Proof,
    Remains,
    Verdict,
    VerdictBasis,
    beyond_noise,
    conclude,
    something_left,
)
from softsensor.diagnosis.extension_unknowns import is_shape
from softsensor.diagnosis.finding import Diagnosis, Finding
from softsensor.diagnosis.laws.choice import free_law
from softsensor.diagnosis.numbers import Errors, Interval, is_described, noise_floor, short, sure_core_error_K
from softsensor.diagnosis.selection import Progress, Round, cool_rim, search_all
from softsensor.diagnosis.settling import SettledModel, panels_as_usual, settle_base, with_whole_panels
from softsensor.diagnosis.sign_flips import PatternTest, pattern_test
from softsensor.diagnosis.unseen import stage_errors
from softsensor.diagnosis.where import MOST, stretches, where_row
from softsensor.effects import Effect, find_effect
from softsensor.heat.model import ThermalModel
from softsensor.heat.run_checks import load_remarks
from softsensor.signals.digest import Digest, Whitened, screened_digest
from softsensor.signals.faces import rim_falls
from softsensor.signals.screen import ChannelFault, recurring
from softsensor.signals.spikes import Spikes


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
        settled = time.perf_counter()
        found = replace(found, law=free_law(found.final))
        found = replace(found, law_seconds=round(time.perf_counter() - settled, 3))
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


def _closed_again(data: Sequence[Whitened]) -> list[Message]:
    pressed = [(d.digest.run.name, d.digest.moments) for d in data]
    again = [(run, say("fit-closed-again", at=m.removed_s)) for run, m in pressed if m.closed_again]
    return [say("at-place", place=run, what=what) for run, what in again]


def _lacking_loads(press: Press, runs: Sequence[Run]) -> list[Message]:
    return [spoken(remark) for run in runs for remark in load_remarks(press_for_run(press, run), run)]


def _conclude(readings: _Readings, stages: list[SettledModel], rounds: list[Round]) -> Diagnosis:
    press, runs, faults = readings.press, readings.runs, readings.faults
    tests = [pattern_test(s.pockets()) for s in stages]
    shares = explained(tests)
    columns = recurring(faults)
    errors = stage_errors(stages, rounds)
    noise = noise_floor(stages)
    beside = with_the_suspected(stages, rounds)
    models = [s.fit for s in (*stages, *beside)]
    causes = findings_of(stages, rounds, shares, errors, models[len(stages) - 1 :])
    nearly = nearly_named(rounds, stages[-1], beside)
    leaves = zip(stages, tests, shares, errors, strict=True)
    basis = VerdictBasis(
        runs=len(runs),
        proofs=tuple(_proof(f, errors[0], e, noise) for f, e in zip(causes, errors[1:], strict=True)),
        remains=tuple(_remains(*one, noise) for one in leaves),
        faulty_channels=bool(columns),
        suspected=bool(nearly),
        let_go=bool(rounds) and rounds[-1].let_go,
    )
    conclusion = conclude(basis)
    named = conclusion.named
    suspected = causes[named:] + nearly
    findings = sensor_findings(faults, columns) + with_wider_intervals(causes[:named], models[named:])
    left = basis.remains[named]
    to_confirm = () if something_left(left, len(runs)) else suspected
    base, extended = errors[0], errors[named]
    cores = (base.core_rmse_K, extended.core_rmse_K)
    advice_basis = AdviceBasis(
        len(runs), bool(press.panel_layers), *cores, apart=len(left.off), cores_agree=left.cores_agree
    )
    return Diagnosis(
        verdict=conclusion.verdict,
        findings=findings,
        suspected=suspected,
        base=base,
        extended=extended,
        noise_floor_K=short(noise),
        where=_where(stages[0]),
        candidates=_candidate_rows(rounds, stages, (*findings, *suspected)),
        next_measurement=next_measurement(conclusion.verdict, findings, advice_basis, to_confirm),
        seconds=0.0,
        faults={r.name: f for r, f in zip(runs, faults, strict=True) if f},
        stages=tuple(stages[: named + 1]),
        remains=basis.remains[: named + 1],
        rivals=_rivals(rounds),
        remarks=(*thickness_notes(findings, runs), *_remarks(readings, rounds, stages[0].data)),
    )


def _remarks(readings: _Readings, rounds: list[Round], data: Sequence[Whitened]) -> tuple[Message, ...]:
    return (
        *notes(readings.runs, readings.faults, rounds),
        *spike_notes(readings.spikes),
        *rim_notes(readings.rim),
        *_closed_again(data),
        *_lacking_loads(readings.press, readings.runs),
    )


def _remains(stage: SettledModel, test: PatternTest, explained: float, errors: Errors, noise_K: float) -> Remains:
    middle, differ = panels_as_usual(with_whole_panels(stage) if stage.effects else stage)
    return Remains(
        pattern=test,
        explained=explained,
        times_noise=errors.weighed_rmse_K / noise_K,
        described=is_described(errors.rmse_K, noise_K, [d.digest for d in stage.data]),
        off=beyond_noise(errors.weighed / noise_K),
        panels_as_given=middle > ALPHA_PATTERN / 2,
        panels_alike=differ > ALPHA_PATTERN / 2,
        cores_agree=sure_core_error_K(stage) <= CORE_OFF_K,
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


def _size_is_sure(effect: Effect, parameters: dict[str, Interval]) -> bool:
    """Return whether the interval of an amplitude leaves out the value at which the cause is absent."""
    sizes = [(p.neutral, parameters[p.name].ci95) for p in effect.parameters if not is_shape(p)]
    return any(ci is not None and not ci[0] <= neutral <= ci[1] for neutral, ci in sizes)


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
                "score": short(c.gain),
                "p_value": short(rounds[0].p_values[c.effect.name]),
                "heldout_gain_K": short((settled.get(c.effect.name) or c.heldout_gain(stages[0])).value_K),
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
