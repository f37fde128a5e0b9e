"""What the simulation gets wrong, the cause by name, the extended model, and what it gains.

The method and why it is so:

1. Faulty channels are found first, by comparison with their neighbours, and left out (`suspect_channels`).
2. Each run is boiled down to place means in bins (`digest`) and fitted together with all others: its
   own coefficients, moments, start temperature, platen errors and sensor offsets, with priors learned
   from the campaign (`extension`). What these can absorb is no evidence for a cause.
3. Every candidate of the catalogue is fitted for real on top, all of that following it. A score along a
   finite-size secant gives each run's score, three standard deviations at most, and so does what it gains by
   numbers from the others; signs of whole runs are flipped for the p-value, with the maximum over candidates
   and both (`diagnosis.sign_flips`). The facts this project started from name samples tested as if independent as
   the classic error: 84 to 100 % false names.
4. One rule decides (`decision`). The best candidate is named if its p-value holds, if runs left out gain by it,
   if its size is physical and core thermocouples do not speak against it. Candidates that the runs do not tell
   from it form its `set`; core thermocouples, which no fit sees, make it smaller. Within a set the measuring
   chain comes first.
5. The same again on top of the extended model, for a second and third cause. A second cause is then tried
   alone, since where the plain model is far off a cause may not have found its way, and others are tried
   in the place of the first (`diagnosis.exchange`). Where what is left is negligible, a further cause must
   save more: over many runs the least fault of the first one's law is sure.
6. Residuals of all runs are averaged by place and time since the last event. What common pattern remains
   vetoes: a model that explains less than four fifths of it, or leaves more than a few tenths of a kelvin,
   is not the cause, however significant, and the verdict is `unknown_effect`, with where and when. Faults
   outside the catalogue are otherwise explained, badly, by two or three causes of the catalogue together.

Better than a linear score test alone: all candidates get a non-linear fit, so amplitude and shape are
right before anything is compared; timing, lag and clock, which bend coefficients by a factor, get it
with the coefficients free.

Held-out numbers: each run is predicted with shared numbers fitted to the others, by the cause that the
others would have chosen without it (`never_seen`). The choice is judged again without the run; sizes
of noise and scatter, and starting points of fits, come from all runs.

With fewer than six runs no p-value can fall below 0.05 by flipping. A cause is then named only if it is the only
one found, every single run, by numbers from the others, gains by it, the held-out residual at least halves,
and every candidate outside the set loses in every run; else the verdict is `too_few_runs`.

What stays hidden: an exponent of pressure of 0.5 to 1 over 280 to 400 N/cm2 in twelve runs whose contacts
scatter by 12 to 30 %; even the true contacts would show it in 28 % of campaigns (96 runs: 93 %).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import Press, press_for_run
from daq.records import Array, InputError, Run
from daq.words import Message, say, spoken
from softsensor.diagnosis.advice import AdviceBasis, next_measurement, notes, rim_notes
from softsensor.diagnosis.decision import FEW_RUNS, Evidence, Verdict, decide
from softsensor.diagnosis.extension import RunState, held_out
from softsensor.diagnosis.finding import Diagnosis, Finding
from softsensor.diagnosis.numbers import Errors, Interval, intervals, measure_errors
from softsensor.diagnosis.search import SettledModel, core_errors, rms, settle_base
from softsensor.diagnosis.selection import Progress, Round, claims_of, cool_rim, search_all
from softsensor.diagnosis.sign_flips import PatternTest, Pocket, paired_t, pattern_test
from softsensor.diagnosis.where import MOST, stretches, where_row
from softsensor.effects import find_effect, sensor_fault
from softsensor.heat.model import ThermalModel
from softsensor.heat.run_checks import load_remarks
from softsensor.signals.digest import Digest, digest_run
from softsensor.signals.faces import rim_falls
from softsensor.signals.moments import moments_seen
from softsensor.signals.screen import ChannelFault, faulty_channels, recurring


def diagnose(
    press: Press, runs: Sequence[Run], progress: Progress | None = None, effects: Sequence[str] | None = None
) -> Diagnosis:
    """Diagnose a campaign.

    Parameters
    ----------
    press
        The press the runs come from; headers may override it.
    runs
        Measured runs, in any order: they are worked on in the order of their names.
    progress
        Told what is being done and the share done.
    effects
        Candidates; by default the whole catalogue.

    Raises
    ------
    InputError
        For no run, one that does not fit the press, or a candidate the catalogue does not hold.
    """
    began = time.perf_counter()
    tell = progress or (lambda what, share: None)
    for name in effects or ():
        find_effect(name)
    if not runs:
        raise InputError(say("diagnosis-no-runs"))
    tell("reading runs", 0.0)
    readings, digests = _screened(press, sorted(runs, key=lambda r: r.name))
    tell("plain model", 0.03)
    base = settle_base(ThermalModel(press), digests)
    stages, rounds = search_all(base, effects, tell, cool_rim(readings.rim))
    tell("what is left", 0.9)
    found = _conclude(readings, stages, rounds)
    return replace(found, seconds=round(time.perf_counter() - began, 3))


@dataclass(frozen=True)
class _Readings:
    """The runs, and what comparing channels with their neighbours has shown of each."""

    press: Press
    runs: Sequence[Run]
    faults: Sequence[tuple[ChannelFault, ...]]
    rim: Array
    """By how much rim sensors fall against central ones (runs). [K]"""


def _screened(press: Press, runs: Sequence[Run]) -> tuple[_Readings, list[Digest]]:
    """Return the readings, and a digest of each run without its faulty channels."""
    faults, digests, rim = [], [], []
    for run in runs:
        moments = moments_seen(run, press)
        found = faulty_channels(press, run, moments)
        columns = frozenset(f.column for f in found)
        digests.append(digest_run(press, run, moments, columns))
        rim.append(rim_falls(press, run, moments, columns))
        faults.append(found)
    return _Readings(press, runs, faults, np.array(rim)), digests


def _lacking_loads(press: Press, runs: Sequence[Run]) -> list[Message]:
    return [spoken(remark) for run in runs for remark in load_remarks(press_for_run(press, run), run)]


def _conclude(readings: _Readings, stages: list[SettledModel], rounds: list[Round]) -> Diagnosis:
    press, runs, faults = readings.press, readings.runs, readings.faults
    tests = [pattern_test(s.pockets()) for s in stages]
    shares = _explained(tests)
    columns = recurring(faults)
    decision = decide(_evidence(stages, rounds, tests[-1], shares, bool(columns)))
    stages = stages[: decision.kept + 1]
    findings = _sensor_findings(faults, columns) + _findings(stages, rounds, shares)
    base = measure_errors(stages[0], held_out(stages[0].fit, stages[0].data, rounds=2))
    extended = measure_errors(stages[-1], never_seen(stages, rounds)) if decision.kept else base
    findings = _with_gains(findings, base, extended)
    verdict = decision.verdict
    seen = AdviceBasis(len(runs), bool(press.panel_layers), base.core_rmse_K, extended.core_rmse_K)
    remains = tests[-1].worst if verdict is Verdict.UNKNOWN_EFFECT and decision.kept else None
    return Diagnosis(
        verdict=verdict,
        stopped=decision.step,
        findings=findings,
        base=base,
        extended=extended,
        noise_floor_K=_rounded(extended.noise_K),
        where=_where(stages[0], remains),
        candidates=_candidate_rows(rounds, stages),
        next_measurement=next_measurement(verdict, findings, seen),
        seconds=0.0,
        faults={r.name: f for r, f in zip(runs, faults, strict=True) if f},
        stages=tuple(stages),
        left=tests[-1],
        rivals=_rivals(rounds),
        warnings=(*notes(runs, faults, rounds), *rim_notes(readings.rim), *_lacking_loads(press, runs)),
    )


def never_seen(stages: Sequence[SettledModel], rounds: Sequence[Round]) -> list[RunState]:
    """Return each run as the others predict it that neither fitted nor chose with it.

    Every search has been judged again without each run (`Round.without`). Where the verdict stays, the run gets
    the extended model with numbers from the others; where another cause would have been chosen, or none, that.
    """
    by_stage = [held_out(s.fit, s.data, rounds=2) for s in stages]
    found = list(by_stage[-1])
    for r in range(len(found)):
        for i, round_ in enumerate(rounds[: len(stages) - 1]):
            chosen = round_.without[r]
            if chosen is not None and chosen.effect.name == round_.voted:
                continue
            found[r] = by_stage[i][r] if chosen is None else chosen.others[r]
            break
    return found


def _heldout_ratio(stages: list[SettledModel]) -> float:
    """Held-out residual of the last model over that of the first, root mean square."""
    first, last = (rms(s.data, held_out(s.fit, s.data, rounds=2)) for s in (stages[0], stages[-1]))
    return last / first


def _sensor_findings(faults: Sequence[tuple[ChannelFault, ...]], columns: Iterable[str]) -> tuple[Finding, ...]:
    if not columns:
        return ()
    name = sensor_fault.EFFECT.name
    share = sum(any(f.column in columns for f in run) for run in faults)
    value = Interval(tuple(columns), None)
    return (Finding(name, (name,), {"columns": value}, 2.0 ** (1 - share), 0.0, 1.0),)


def _explained(tests: Sequence[PatternTest]) -> list[float]:
    """Return the share of the plain model's common pattern that each stage explains, 0 for the plain model."""
    plain = tests[0].energy
    return [float(np.clip(1.0 - t.energy / plain, 0.0, 1.0)) if plain > 0 else 0.0 for t in tests]


def _evidence(
    stages: list[SettledModel],
    rounds: list[Round],
    left: PatternTest,
    shares: Sequence[float],
    faulty_channels: bool,
) -> Evidence:
    """Return what is known after the last search."""
    last, named = stages[-1], rounds[: len(stages) - 1]
    claims = rounds[-1] if len(rounds) > len(named) else None
    everyone = np.arange(len(last.data))
    return Evidence(
        runs=len(everyone),
        left=left,
        core_K=core_errors(last.fit, last.data),
        claims=claims_of(last, claims.candidates, claims.p_values, everyone) if claims else (),
        sets=tuple(_alternatives(r, last.effects) for r in named),
        shares=tuple(shares[1:]),
        heldout_ratio=_heldout_ratio(stages) if named and len(everyone) < FEW_RUNS else 1.0,
        faulty_channels=faulty_channels,
    )


def _findings(stages: list[SettledModel], rounds: list[Round], shares: list[float]) -> tuple[Finding, ...]:
    found = []
    final = stages[-1]
    for i in range(1, len(stages)):
        round_ = rounds[i - 1]
        name = final.effects[i - 1]
        chosen = round_.chosen
        against: list[tuple[str, float]] = []
        votes = (0, 0)
        if chosen is not None:
            votes = (int((chosen.gains > 0.0).sum()), len(chosen.gains))
            against = [
                (c.effect.name, round(paired_t(chosen.gains, c.gains), 2))
                for c in round_.candidates
                if c.refined and c.effect.name not in round_.set
            ][:3]
        found.append(
            Finding(
                name=name,
                set=_alternatives(round_, final.effects),
                parameters=intervals(final.fit, find_effect(name)),
                p_value=_rounded(round_.p_values.get(name, 1.0)),
                heldout_gain_K=0.0,
                explained_share=_rounded(max(shares[i] - shares[i - 1], 0.0)),
                against=tuple(against),
                votes=votes,
            )
        )
    return tuple(found)


def _alternatives(round_: Round, named: Sequence[str]) -> tuple[str, ...]:
    """Return the set of a search without what is named beside its cause and gained no more alone.

    Needed beside the cause, it cannot stand in its place; nor can the cause then be spared beside it.
    """
    most = round_.chosen.gain if round_.chosen else 0.0
    weaker = {c.effect.name for c in round_.candidates if c is not round_.chosen and c.gain <= most}
    return tuple(n for n in round_.set if n not in weaker.intersection(named))


def _with_gains(findings: tuple[Finding, ...], base: Errors, extended: Errors) -> tuple[Finding, ...]:
    """Share the held-out gain out among the named causes, by what each explains."""
    total = base.heldout_rmse_K - extended.heldout_rmse_K
    weight = sum(f.explained_share for f in findings if not f.of_channels) or 1.0
    return tuple(
        f if f.of_channels else replace(f, heldout_gain_K=_rounded(total * f.explained_share / weight))
        for f in findings
    )


def _where(plain: SettledModel, left: Pocket | None) -> tuple[dict[str, Any], ...]:
    """Where the plain simulation is wrong, most kelvins first; before that what the causes leave, if given."""
    digests = [d.digest for d in plain.data]
    found = stretches(digests, [r.misfit for r in plain.fit.runs])[:MOST]
    return tuple(where_row(p, digests) for p in ([left] if left else []) + found)


def _candidate_rows(rounds: list[Round], stages: list[SettledModel]) -> tuple[dict[str, Any], ...]:
    if not rounds:
        return ()
    rows = []
    for c in rounds[0].candidates:
        rows.append(
            {
                "name": c.effect.name,
                "score": _rounded(c.gain),
                "p_value": _rounded(rounds[0].p_values[c.effect.name]),
                "heldout_gain_K": _rounded(c.heldout_gain(stages[0])),
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
