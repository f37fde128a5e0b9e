"""A night's judgement: what the runs say is missing, a candidate with it, and whether it is better.

Nothing is promoted that has not been held against the model in force on the same runs and, where there is a core
thermocouple, on the same scans of the core (`night_comparison`). A test asked every night names something sooner
or later: what a diagnosis would name is only suspected until the bets over all nights (`bets`) are sure that
something is missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from daq.records import InputError
from daq.store.records import ModelStatus
from daq.words import say
from softsensor.diagnosis.decision import Verdict
from softsensor.effects.vocabulary import called
from softsensor.heat.model_file import ModelFile
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.fitter import fit_one
from softsensor.jobs.model_in_force import combined_model, next_version, with_stored_fits
from softsensor.jobs.night_basis import FEWEST_RUNS, NOTHING_CHANGED, NightBasis, NightOutcome
from softsensor.jobs.night_comparison import Comparison, compare
from softsensor.jobs.night_sure import held_back, unsure_causes
from softsensor.jobs.run_reader import PROCESS

# Numbers without another source were set by hand, 2026-11.

DIAGNOSED_RUNS = 24
"""The newest runs a diagnosis looks at."""
SPLIT_FROM = 18
"""From this many runs on, the newest third takes no part in diagnosis and judges the result."""
JUDGES = 12
"""Runs at most that judge a candidate: each costs a fit. Set by hand, 2026-11."""


def judge_night(night: NightBasis, outcome: NightOutcome) -> NightOutcome:
    """Diagnose, make a candidate, and promote it if runs that took no part are the better for it.

    A candidate with fewer effects than the model in force, where the diagnosis no longer finds them, need not
    be better: it is promoted unless those effects still help. Nor need the press's own where that is its sisters'.
    """
    good = [r.run for r in night.records if r.run in night.fits]
    if len(good) < FEWEST_RUNS:
        return replace(
            outcome,
            verdict=Verdict.TOO_FEW_RUNS,
            reason=say("night-too-few-runs", runs=len(good), needed=FEWEST_RUNS),
        )
    held = good[-min(JUDGES, len(good) // 3) :] if len(good) >= SPLIT_FROM else []
    diagnosed = [run for run in good if run not in held][-DIAGNOSED_RUNS:]
    base = combined_model(night.press, night.base, [night.fits[run] for run in good])
    report, extended, unsure = _diagnose(night, diagnosed)
    night.store.put_diagnosis(night.name, {**report, "runs": diagnosed})
    named = tuple(str(effect["name"]) for effect in report.get("effects", ()))
    outcome = replace(outcome, verdict=str(report["verdict"]), named=named)
    if unsure:
        outcome = replace(outcome, reason=say("night-not-sure-yet", causes=tuple(map(called, unsure))))
    fewer = _leaves_out(night.base, extended) if outcome.verdict in (Verdict.NO_EFFECT, Verdict.NAMED) else ()
    if not extended.effects and not fewer:
        return _keep_or_begin(night, base, outcome)
    if night.base is not None and not night.of_sisters and _same_effects(night.base, extended):
        return replace(outcome, reason=say("night-diagnosis-confirms"))
    candidate = replace(extended, version=next_version(night.store, night.name), press=night.name)
    fits = _fits_with(night, candidate, (held or diagnosed)[-JUDGES:])
    candidate = with_stored_fits(replace(candidate, panels=base.panels), list(fits.values()))
    found = compare(night, report, candidate, fits, apart=bool(held), fewer=fewer)
    found = replace(found, figures={"diagnosed_runs": diagnosed, **found.figures})
    outcome = _promote_or_leave(night, candidate, found, outcome)
    return outcome if found.better else _keep_or_begin(night, base, outcome)


def _promote_or_leave(
    night: NightBasis, candidate: ModelFile, found: Comparison, outcome: NightOutcome
) -> NightOutcome:
    """Store a candidate, and promote it if it is better and no one has gone back from a model like it."""
    unwanted = _rolled_back(night, candidate) if found.better else ""
    reason = say("night-like-rolled-back", reason=found.reason, version=unwanted) if unwanted else found.reason
    night.store.put_model(
        night.name,
        candidate.version,
        {**candidate.as_json(), "basis": {**found.figures, "reason": reason.to_json()}},
        status=ModelStatus.CANDIDATE if found.better else ModelStatus.REJECTED,
        reason=str(reason),
    )
    if not found.better:
        reason = say("night-rejected", version=candidate.version, reason=reason)
        return replace(outcome, refused=candidate.version, reason=reason)
    if unwanted:
        reason = say("night-left-to-you", version=candidate.version, reason=reason)
        return replace(outcome, refused=candidate.version, reason=reason)
    night.store.promote_model(candidate.version, PROCESS, reason)
    return replace(outcome, version=candidate.version, promoted=True, reason=reason)


def _leaves_out(old: ModelFile | None, new: ModelFile) -> tuple[str, ...]:
    """Return the effects of the model in force that a new one does without, none where it has others instead."""
    before = {name for name, _ in old.effects} if old is not None else set()
    after = {name for name, _ in new.effects}
    return tuple(sorted(before - after)) if after < before else ()


def _keep_or_begin(night: NightBasis, base: ModelFile, outcome: NightOutcome) -> NightOutcome:
    """Leave the promoted model; where there is none yet, begin with the runs' coefficients."""
    if night.base is not None:
        return outcome
    first = replace(base, version=next_version(night.store, night.name), press=night.name)
    described = sum(bool(fit.get("met", True)) for fit in night.fits.values())
    reason = say("night-first-model", runs=described)
    if outcome.reason != NOTHING_CHANGED:
        reason = say("night-first-model-although", runs=described, although=outcome.reason)
    content = {**first.as_json(), "basis": {"fitted_runs": list(night.fits), "reason": reason.to_json()}}
    night.store.put_model(night.name, first.version, content, reason=str(reason))
    night.store.promote_model(first.version, PROCESS, reason)
    return replace(outcome, version=first.version, promoted=True, reason=reason)


def _same_effects(old: ModelFile, new: ModelFile) -> bool:
    """Return whether two models hold the same effects at about the same size."""
    if {name for name, _ in old.effects} != {name for name, _ in new.effects}:
        return False
    before = dict(old.effects)
    return all(
        abs(estimate.value - before[name][key].value) <= 2.0 * math.hypot(estimate.sd, before[name][key].sd)
        for name, table in new.effects
        for key, estimate in table.items()
        if key in before[name]
    )


def _rolled_back(night: NightBasis, candidate: ModelFile) -> str:
    """Return the version of a model like the candidate that somebody has gone back from, empty where none is."""
    active = night.store.active_model(night.name)
    newer = (
        m for m in night.store.models(press=night.name, limit=200).items if active and m.number > active.number
    )
    same = (
        m.version
        for m in newer
        if m.status is ModelStatus.RETIRED and _same_effects(parse_model(m.model, m.version), candidate)
    )
    return next(same, "")


def _fits_with(night: NightBasis, candidate: ModelFile, runs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Fit the judging runs with a candidate's effects."""
    found = {}
    for run in night.runs(runs):
        with suppress(InputError):
            found[run.name] = fit_one(night.press, run, candidate)
    return found


def _diagnose(night: NightBasis, runs: Sequence[str]) -> tuple[dict[str, Any], ModelFile, list[str]]:
    """Ask what the plain model gets wrong on these runs; a law without a name is reported and not promoted.

    Returns the report, the extended model, and causes it would name that the bets over all nights hold back.
    """
    from softsensor.diagnosis.extended_model import model_of
    from softsensor.diagnosis.verdict import diagnose
    from softsensor.jobs.stored_diagnosis import stored_diagnosis

    found = diagnose(night.press, night.runs(runs))
    in_force = [name for name, _ in night.base.effects] if night.base is not None else []
    unsure = [] if night.sure else unsure_causes(found, in_force)
    found = held_back(found) if unsure else found
    report = stored_diagnosis(night.press, found) | {"predicted_gain_ci95": found.predicted_gain.ci95}
    return report, model_of(found.final), unsure
