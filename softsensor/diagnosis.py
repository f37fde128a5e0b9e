"""What the simulation gets wrong, the cause by name, the extended model, and what it gains.

The method and why it is so:

1. Faulty channels are found first, by comparison with their neighbours, and left out (`channels`).
2. Each run is boiled down to place means in bins (`evidence`) and fitted together with all others: its
   own coefficients, moments, start temperature, platen errors and sensor offsets, with priors learned
   from the campaign (`extension`). What these can absorb is no evidence for a cause.
3. Every candidate of the catalogue is fitted for real on top, all of that following it. A score along a
   finite-size secant gives each run's say, three standard deviations at most, and so does what it gains by
   numbers from the others; signs of whole runs are flipped for the p-value, with the maximum over candidates
   and both (`diagnosis_tests`). The facts this project started from name samples tested as if independent as
   the classic error: 84 to 100 % false names.
4. The best candidate is named if its p-value holds, if runs left out gain by it, if its size is physical
   and core thermocouples do not speak against it. Candidates that the runs do not tell from it form its
   `set`; core thermocouples, which no fit sees, make it smaller. Within a set the measuring chain comes first.
5. The same again on top of the extended model, for a second and third cause. A second cause is then tried
   alone, since where the plain model is far off a cause may not have found its way, and others are tried
   in the place of the first (`diagnosis_exchange`). Where what is left is negligible, a further cause must
   save more: over many runs the least fault of the first one's law is sure.
6. Residuals of all runs are averaged by place and time since the last event. What common pattern remains
   vetoes: a model that explains less than four fifths of it, or leaves more than a few tenths of a kelvin,
   is not the cause, however significant, and the verdict is `unknown_effect`, with where and when. Faults
   outside the catalogue are otherwise explained, badly, by two or three causes of the catalogue together.

Better than a linear score test alone: all candidates get a non-linear fit, so amplitude and shape are
right before anything is compared; timing, lag and clock, which bend coefficients by a factor, get it
with the coefficients free.

Held-out numbers: each run is predicted with shared numbers fitted to the others, by the cause that the
others would have chosen without it (`never_seen`). The choice is judged again without the run's say; sizes
of noise and scatter, and starting points of fits, come from all runs.

With fewer than six runs no p-value can fall below 0.05 by flipping. A cause is then named only if it is the only
one found, every single run, by numbers from the others, gains by it, the held-out residual at least halves,
and every candidate outside the set loses in every run; else the verdict is `too_few_runs`.

What cannot be told: an exponent of pressure of 0.5 to 1 over 280 to 400 N/cm2 in twelve runs whose contacts
scatter by 12 to 30 %; even the true contacts would show it in 28 % of campaigns (96 runs: 93 %).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.pressfile import Press, press_for_run
from daq.records import Array, InputError, Moments, Run
from softsensor.admission import load_remarks
from softsensor.channels import ChannelFault, faulty_channels, recurring, rim_falls
from softsensor.diagnosis_advice import next_measurement, notes, rim_notes
from softsensor.diagnosis_jury import FEW_EFFECTS, FEW_RUNS, FEW_TOTAL, Progress, Round, cool_rim, search_all
from softsensor.diagnosis_model import model_of
from softsensor.diagnosis_numbers import Errors, Interval, intervals, measure_errors
from softsensor.diagnosis_search import (
    Stage,
    rms,
    settle_base,
)
from softsensor.diagnosis_tests import NEGLIGIBLE_K, Adequacy, Pocket, adequacy, paired_t
from softsensor.diagnosis_where import MOST, stretches, where_row
from softsensor.effects import find_effect
from softsensor.evidence import Digest, digest_run, moments_of
from softsensor.extension import RunState, held_out
from softsensor.model import ThermalModel
from softsensor.modelfile import ModelFile

ALPHA_ADEQUACY = 0.025
"""For something left; with so few runs that flips cannot reach it, the least they can."""
EXPLAINED = 0.8
"""Share of the common residual pattern a named cause must explain."""
SMALL_K = 0.2
"""Of a common pattern (rms over pockets) one named cause may leave so much, two half of it, three a third: what
takes many causes to explain is rather one outside the catalogue. [K]"""


@dataclass(frozen=True)
class Finding:
    """One named cause."""

    name: str
    set: tuple[str, ...]
    """With the causes these runs cannot tell from it; one that is named beside it is no alternative to it."""
    parameters: dict[str, Interval]
    p_value: float
    heldout_gain_K: float  # noqa: N815
    explained_share: float
    against: tuple[tuple[str, float], ...] = ()
    """Runners-up outside the set and by how many standard errors the runs prefer the name."""
    votes: tuple[int, int] | None = None
    """Of how many runs, each left out in turn, how many are met better with it; first of the two those."""


@dataclass(frozen=True)
class Diagnosis:
    """The answer."""

    verdict: str
    findings: tuple[Finding, ...]
    base: Errors
    extended: Errors
    noise_floor_K: float  # noqa: N815
    where: tuple[dict[str, Any], ...]
    candidates: tuple[dict[str, Any], ...]
    next_measurement: str
    seconds: float
    faults: dict[str, tuple[ChannelFault, ...]]
    """Faulty channels by run."""
    stages: tuple[Stage, ...]
    """Fits: the plain model, then with each cause."""
    adequacy: Adequacy
    rivals: tuple[tuple[str, Array], ...]
    """The first cause and the runners-up, with what each run, left out, saves by them."""
    warnings: tuple[str, ...] = ()

    @property
    def final(self) -> Stage:
        """The last fit."""
        return self.stages[-1]

    def model_file(self, version: str = "") -> ModelFile:
        """Return the extended model (the plain one where nothing was named)."""
        return model_of(self.final, version)

    def as_json(self) -> dict[str, Any]:
        """Return the contract's JSON content."""
        effects = [
            {
                "name": f.name,
                "set": list(f.set),
                "parameters": {k: i.as_json() for k, i in f.parameters.items()},
                "p_value": f.p_value,
                "heldout_gain_K": f.heldout_gain_K,
                "explained_share": f.explained_share,
            }
            for f in self.findings
        ]
        return {
            "verdict": self.verdict,
            "effects": effects,
            "base": self.base.as_json(),
            "extended": self.extended.as_json(),
            "noise_floor_K": self.noise_floor_K,
            "where": list(self.where),
            "candidates": list(self.candidates),
            "next_measurement": self.next_measurement,
            "warnings": list(self.warnings),
            "seconds": self.seconds,
        }


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
        raise InputError("no runs to diagnose; give at least one run file")
    runs = sorted(runs, key=lambda r: r.name)
    tell("reading runs", 0.0)
    moments = [moments_of(press, r) for r in runs]
    faults = [faulty_channels(press, r, m) for r, m in zip(runs, moments, strict=True)]
    digests = [_digest(press, r, m, f) for r, m, f in zip(runs, moments, faults, strict=True)]
    tell("plain model", 0.03)
    base = settle_base(ThermalModel(press), digests)
    rim = [
        rim_falls(press, r, m, frozenset(x.column for x in f))
        for r, m, f in zip(runs, moments, faults, strict=True)
    ]
    stages, rounds = search_all(base, effects, tell, cool_rim(np.array(rim)))
    tell("what is left", 0.9)
    return _conclude(press, runs, faults, stages, rounds, began, np.array(rim))


def _lacking_loads(press: Press, runs: Sequence[Run]) -> list[str]:
    return [remark for run in runs for remark in load_remarks(press_for_run(press, run), run)]


def _digest(press: Press, run: Run, moments: Moments, faults: tuple[ChannelFault, ...]) -> Digest:
    excluded = frozenset(f.column for f in faults) | frozenset(f.partner for f in faults if f.partner)
    return digest_run(press, run, moments, excluded)


def _conclude(
    press: Press,
    runs: Sequence[Run],
    faults: list[tuple[ChannelFault, ...]],
    stages: list[Stage],
    rounds: list[Round],
    began: float,
    rim: Array,
) -> Diagnosis:
    plain = adequacy(stages[0].pockets())
    tests = [plain, *(adequacy(s.pockets()) for s in stages[1:])]
    shares = [float(np.clip(1.0 - t.energy / plain.energy, 0.0, 1.0)) if plain.energy > 0 else 0.0 for t in tests]
    left = tests[-1]
    unexplained = _unexplained(left, shares[-1], len(stages) - 1, len(runs))
    several = len(stages) > 1 + FEW_EFFECTS
    if len(stages) > 1 and len(runs) < FEW_RUNS and (several or _heldout_ratio(stages) > FEW_TOTAL):
        stages = stages[:1]
    kept = 1 if unexplained and max(shares[:2]) < EXPLAINED else len(stages)
    stages = stages[:kept]
    findings = _sensor_findings(faults) + _findings(stages, rounds, shares)
    base = measure_errors(stages[0], held_out(stages[0].fit, stages[0].data, rounds=2))
    extended = measure_errors(stages[-1], never_seen(stages, rounds)) if kept > 1 else base
    findings = _with_gains(findings, base, extended)
    verdict = _verdict(findings, unexplained, len(runs))
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        base=base,
        extended=extended,
        noise_floor_K=_rounded(extended.noise_K),
        where=_where(stages[0], left.worst if unexplained and kept > 1 else None),
        candidates=_candidate_rows(rounds, stages),
        next_measurement=next_measurement(
            verdict, findings, (base.core_rmse_K, extended.core_rmse_K), len(runs), bool(press.panel_layers)
        ),
        seconds=round(time.perf_counter() - began, 3),
        faults={r.name: f for r, f in zip(runs, faults, strict=True) if f},
        stages=tuple(stages),
        adequacy=left,
        rivals=_rivals(rounds),
        warnings=(*notes(runs, faults, rounds), *rim_notes(rim), *_lacking_loads(press, runs)),
    )


def never_seen(stages: Sequence[Stage], rounds: Sequence[Round]) -> list[RunState]:
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


def _heldout_ratio(stages: list[Stage]) -> float:
    """Held-out residual of the last model over that of the first, root mean square."""
    first, last = (rms(s.data, held_out(s.fit, s.data, rounds=2)) for s in (stages[0], stages[-1]))
    return last / first


def _unexplained(left: Adequacy, share: float, causes: int, runs: int) -> bool:
    level = max(ALPHA_ADEQUACY, 0.5 ** (runs - 1))
    if runs < FEW_RUNS or left.p_value > level or left.energy < NEGLIGIBLE_K**2:
        return False
    return not (causes and share >= EXPLAINED and left.energy < (SMALL_K / causes) ** 2)


def _sensor_findings(faults: list[tuple[ChannelFault, ...]]) -> tuple[Finding, ...]:
    columns = recurring(faults)
    if not columns:
        return ()
    share = sum(any(f.column in columns for f in run) for run in faults)
    value = Interval(tuple(columns), None)
    return (Finding("sensor_fault", ("sensor_fault",), {"columns": value}, 2.0 ** (1 - share), 0.0, 1.0),)


def _findings(stages: list[Stage], rounds: list[Round], shares: list[float]) -> tuple[Finding, ...]:
    found = []
    final = stages[-1]
    for i in range(1, len(stages)):
        round_ = rounds[i - 1]
        name = final.effects[i - 1]
        chosen = round_.chosen
        against: list[tuple[str, float]] = []
        votes = None
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
    weight = sum(f.explained_share for f in findings if f.name != "sensor_fault") or 1.0
    return tuple(
        f if f.name == "sensor_fault" else replace(f, heldout_gain_K=_rounded(total * f.explained_share / weight))
        for f in findings
    )


def _verdict(findings: tuple[Finding, ...], unexplained: bool, runs: int) -> str:
    if unexplained:
        return "unknown_effect"
    if any(len(f.set) > 1 for f in findings):
        return "ambiguous"
    if findings:
        return "named"
    return "too_few_runs" if runs < FEW_RUNS else "no_effect"


def _where(plain: Stage, left: Pocket | None) -> tuple[dict[str, Any], ...]:
    """Where the plain simulation is wrong, most kelvins first; before that what the causes leave, if told."""
    digests = [d.digest for d in plain.data]
    found = stretches(digests, [r.misfit for r in plain.fit.runs])[:MOST]
    return tuple(where_row(p, digests) for p in ([left] if left else []) + found)


def _candidate_rows(rounds: list[Round], stages: list[Stage]) -> tuple[dict[str, Any], ...]:
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
