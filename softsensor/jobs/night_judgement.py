"""A night's judgement: what the runs say is missing, a candidate with it, and whether it is better.

Nothing is promoted that has not been held against the model in force on the same runs and, where there is a core
thermocouple, on the same scans of the core. There are two residuals: with a run's own contacts fitted to it,
and of a run predicted from its header, its moments and its platens alone. The prediction has a veto and, where it
is surely better, suffices. A test asked every night names something sooner or later: what a diagnosis would name
is only suspected until the bets over all nights (`bets`) are sure that something is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, InputError, Moments, Run
from daq.store import RunRecord, Store
from daq.store.records import ModelStatus
from daq.words import Message, say
from softsensor.diagnosis.decision import Verdict
from softsensor.effects.vocabulary import called
from softsensor.fitting.result import left_in
from softsensor.fitting.simulated_run import simulate_run
from softsensor.heat.model_file import ModelFile
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.fitter import fit_one
from softsensor.jobs.model_in_force import combined_model, next_version, with_stored_fits
from softsensor.jobs.night_progress import nights_for
from softsensor.jobs.night_sure import held_back, unsure_causes
from softsensor.jobs.run_reader import PROCESS, RunReader
from softsensor.live.replay import replay
from softsensor.signals.faces import measured_core
from softsensor.signals.moments import moments_of
from softsensor.signals.student import student
from softsensor.signals.unknown import ALPHA

# Numbers without another source were set by hand, 2026-11.

DIAGNOSED_RUNS = 24
"""The newest runs a diagnosis looks at."""
SPLIT_FROM = 18
"""From this many runs on, the newest third takes no part in diagnosis and judges the result."""
JUDGES = 12
"""Runs at most that judge a candidate: each costs a fit. Set by hand, 2026-11."""
CORE_RUNS, CORE_SEARCHED = 6, 100
"""Runs with a core thermocouple that are replayed through the live sensor with both models; looked for among the
newest."""
LEAST_SHARE = 0.02
"""Of the residual with own contacts, which a model must save whose predictions are not surely better."""
CORE_TOLERANCE, CORE_SLACK_K = 1.02, 0.05
"""Factor by which a candidate may let the error of the live core grow, and how much more.
Set by hand, 2026-11. [-, K]"""
LEAST_VALID = 0.9
"""Of the scans with a core thermocouple that the model in force predicts: a candidate must dare as many."""
NOTHING_CHANGED = say("night-nothing-changed")
NOT_ASKED = "not_asked"
"""Instead of a verdict, where the runs are those of the night before."""
FAILED = "failed"
"""Instead of a verdict, where the press's night could not be gone through."""
ONE_SIDED = 1.0 - ALPHA
"""Of Student's t where only one side counts."""
FEWEST_RUNS = 3
"""Runs a first model needs."""


@dataclass(frozen=True)
class NightOutcome:
    """What the job did for one press."""

    press: str
    runs: int
    fitted: int
    failed: int
    version: str
    """The model in force afterwards, empty where there is none."""
    verdict: str = NOT_ASKED
    """Of the diagnosis, or why there was none; with `FAILED` the reason says what kept the night from its end."""
    promoted: bool = False
    reason: Message = NOTHING_CHANGED
    newly_unfit: int = 0
    """How many of the failed ones were tried in this job."""
    blind: int = 0
    """Runs without panel sensors: in production that is how it is meant, so nothing has failed."""
    new: int = 0
    """Runs that came since the night before."""
    later: int = 0
    """Older runs whose fits rest on a press file or effects of before: their turn comes in nights to come."""
    left_out: tuple[tuple[str, Message], ...] = ()
    """Runs of this night that could not be fitted or read, and why; the first `SHOWN_LEFT_OUT`."""
    unread: tuple[Message, ...] = ()
    """Of runs that had a fit and could not be read for the judgement, why."""
    drifts: tuple[tuple[str, Message], ...] = ()
    """Coefficients that have left what is usual, and the message about each."""
    named: tuple[str, ...] = ()
    """Effects the diagnosis named."""
    refused: str = ""
    """A candidate that was made and not promoted."""
    archive: Message | None = None
    """What became of old scans, None where nothing did."""
    archive_problem: Message | None = None
    """Why some of them could not be moved or read."""

    @property
    def fits_line(self) -> Message:
        """What became of the runs."""
        kept = self.runs - self.fitted - self.failed - self.blind - self.later
        counts = {"fitted": self.fitted, "runs": self.runs, "kept": max(kept, 0)}
        fits = say("night-fits", **counts, failed=self.failed, blind=self.blind)
        if not self.later:
            return fits
        return say("night-fits-later", fits=fits, later=self.later, nights=nights_for(self.later))

    @property
    def line(self) -> Message:
        """One line for terminal and journal."""
        if self.verdict == FAILED:
            return say("night-failed", press=self.press, why=self.reason)
        return say(
            "night-outcome",
            press=self.press,
            fits=self.fits_line,
            verdict=self.verdict,
            model="promoted" if self.promoted else "stays" if self.version else "none",
            version=self.version,
            reason=self.reason,
        )


@dataclass(frozen=True)
class NightBasis:
    """What a night's judgement rests on."""

    store: Store
    name: str
    press: Press
    base: ModelFile | None
    records: Sequence[RunRecord]
    """The newest runs, oldest first."""
    fits: Mapping[str, Mapping[str, Any]]
    """Of these, as far as they stand."""
    sure: str = ""
    """The run since which it is sure that the model in force leaves something out, empty where it is not."""
    reader: RunReader | None = None
    """What reads the runs; None: one of its own."""

    @property
    def of_sisters(self) -> bool:
        """Whether the model in force is what presses of the same kind know."""
        return self.base is not None and self.base.sisters is not None

    def run(self, name: str) -> Run | None:
        """Return a stored run, None where it cannot be read any more."""
        return (self.reader or RunReader(self.store, self.name)).read(name)

    def runs(self, names: Sequence[str]) -> list[Run]:
        """Return stored runs by name, those that can be read."""
        return [run for name in names if (run := self.run(name)) is not None]


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
    found = _compare(night, report, candidate, fits, apart=bool(held), fewer=fewer)
    found = replace(found, figures={"diagnosed_runs": diagnosed, **found.figures})
    outcome = _promote_or_leave(night, candidate, found, outcome)
    return outcome if found.better else _keep_or_begin(night, base, outcome)


def _promote_or_leave(
    night: NightBasis, candidate: ModelFile, found: _Comparison, outcome: NightOutcome
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


@dataclass(frozen=True)
class _Comparison:
    """A candidate against the model in force."""

    reason: Message
    better: bool
    figures: Mapping[str, Any]
    """What the version says of itself: runs it was judged on and residuals with the model before and with it."""


def _compare(
    night: NightBasis,
    report: Mapping[str, Any],
    candidate: ModelFile,
    fits: Mapping[str, Mapping[str, Any]],
    *,
    apart: bool,
    fewer: Sequence[str] = (),
) -> _Comparison:
    """Say what the candidate gains on the judging runs, and whether that is enough.

    Where there are too few runs to keep the judging ones apart from the diagnosis, that is noted, and predictions
    are those of the diagnosis, each run by the others. `fewer` effects than before need no gain, only no loss,
    and neither does the first model of its own runs after one of its sisters'.
    """
    key, left = left_in([f[run] for f in (night.fits, fits) for run in fits])
    both = np.reshape(left, (2, -1))
    old, new = both[:, np.isfinite(both).all(axis=0)]
    ahead = _predictions(night, report, candidate, list(fits), apart=apart or bool(fewer))
    figures: dict[str, Any] = {
        "judged_runs": list(fits),
        "judged_runs_took_part": not apart,
        key: {"before": _mean(old), "after": _mean(new)},
    }
    if ahead is not None:
        figures["predicted_rmse_K"] = {"before": ahead.before_K, "after": ahead.after_K}
    if len(old) < FEWEST_RUNS:
        return _Comparison(say("night-too-few-to-judge"), False, figures)
    core = _core_rmse(night, candidate)
    if core is not None:
        figures["core_rmse_K"] = {"before": core.before_K, "after": core.after_K}
    against = _against(old, new, ahead, core, fewer=bool(fewer) or night.of_sisters)
    reason = say(
        "night-compared",
        effects=tuple(called(name) for name, _ in candidate.effects),
        without=tuple(map(called, fewer)),
        kind="both" if candidate.effects and fewer else "without" if fewer else "with",
        before=_mean(old),
        after=_mean(new),
        runs=len(old),
        still="yes" if key == "rmse_still_K" else "no",
        apart="yes" if apart else "no",
        predicted=_change("night-compared-predicted", ahead.before_K, ahead.after_K) if ahead is not None else "",
        core=_change("night-compared-core", core.before_K, core.after_K) if core is not None else "",
        against="" if against is None else say("night-compared-against", what=Message(f"night-against-{against}")),
    )
    return _Comparison(reason, against is None, figures)


class Against(StrEnum):
    """What speaks against a candidate."""

    STILL_HELPS = "still-helps"
    PREDICTS_WORSE = "predicts-worse"
    NOT_SIGNIFICANT = "not-significant"
    CORE_SILENCED = "core-silenced"
    CORE_WORSE = "core-worse"


def _against(
    old: Array, new: Array, ahead: _Predictions | None, core: _Core | None, *, fewer: bool
) -> Against | None:
    """Return what speaks against a candidate, None where nothing does: the first that applies.

    Residuals of the judging runs with the model before and with the candidate, own contacts fitted [K], and what
    both predict.
    """
    share = float(1.0 - np.mean(new) / np.mean(old))
    if fewer:
        if share < -LEAST_SHARE and surely_less(new, old):
            return Against.STILL_HELPS
    elif ahead is not None and ahead.after_K > ahead.before_K:
        return Against.PREDICTS_WORSE
    elif not (ahead is not None and ahead.surely) and (share < LEAST_SHARE or not surely_less(old, new)):
        return Against.NOT_SIGNIFICANT
    if core is not None and core.silenced:
        return Against.CORE_SILENCED
    if core is not None and not core.after_K <= CORE_TOLERANCE * core.before_K + CORE_SLACK_K:
        return Against.CORE_WORSE
    return None


def _change(code: str, before: float, after: float) -> Message:
    return Message(code, {"before": before, "after": after})


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def surely_less(old: Array, new: Array) -> bool:
    """Return whether residuals of the same runs have fallen: Student's one-sided test of their ratio, at 5 %. [K]

    Of the ratio, since one run that leaves much over would else decide alone how certain the rest is.
    """
    if len(old) < 2:  # one run has no scatter
        return False
    fell = np.log(np.maximum(old, 1e-9)) - np.log(np.maximum(new, 1e-9))
    error = max(float(fell.std(ddof=1)) / math.sqrt(len(fell)), 1e-9)
    return float(fell.mean()) / error > student(len(fell) - 1, ONE_SIDED)


@dataclass(frozen=True)
class _Predictions:
    """Root mean square error of runs predicted without their panel sensors, before and with the candidate. [K]"""

    before_K: float  # noqa: N815
    after_K: float  # noqa: N815
    surely: bool
    """Less in the runs beyond chance."""


def _predictions(
    night: NightBasis, report: Mapping[str, Any], candidate: ModelFile, runs: Sequence[str], *, apart: bool
) -> _Predictions | None:
    """Predict the judging runs with both models; where they took part, what the diagnosis predicted in turn."""
    if not apart:
        before, after = ((report.get(k) or {}).get("predicted_rmse_K") for k in ("base", "extended"))
        low = (report.get("predicted_gain_ci95") or (0.0,))[0]
        return None if before is None or after is None else _Predictions(float(before), float(after), low > 0.0)
    models = (night.base or combined_model(night.press, None, list(night.fits.values())), candidate)
    errors = np.array([_prediction_errors(night, run, models) for run in night.runs(runs)])
    errors = errors[np.isfinite(errors).all(axis=1)]
    if len(errors) < 2:
        return None
    old, new = errors.T
    before_K, after_K = (math.sqrt(_mean(values**2)) for values in (old, new))
    return _Predictions(before_K, after_K, surely_less(old, new))


def _prediction_errors(night: NightBasis, run: Run, models: Sequence[ModelFile]) -> list[float]:
    """Return by model how far a simulated run is from its panel sensors; NaN where it cannot be simulated. [K]"""
    try:
        moments = moments_of(run, night.press)
    except InputError:
        return [math.nan] * len(models)
    return [_prediction_error(night, run, moments, model) for model in models]


def _prediction_error(night: NightBasis, run: Run, moments: Moments, model: ModelFile) -> float:
    try:
        out = simulate_run(run, night.press, model.model(night.press), model.values, known=moments)
    except InputError:
        return math.nan
    squares = [(out.measured[place] - values) ** 2 for place, values in out.places.items()]
    finite = [s[np.isfinite(s)] for s in squares]
    return math.sqrt(_mean(np.concatenate(finite))) if any(len(s) for s in finite) else math.nan


@dataclass(frozen=True)
class _Core:
    """Root mean square error of the core before and with the candidate, where both are valid. [K]"""

    before_K: float  # noqa: N815
    after_K: float  # noqa: N815
    silenced: bool
    """The candidate calls many scans not valid that the model before predicts."""


def _core_rmse(night: NightBasis, candidate: ModelFile) -> _Core | None:
    """Replay runs with a core thermocouple through the live sensor with both models; None where there is none."""
    errors = list(_core_errors(night, candidate))
    if not errors:
        return None
    before, after = (np.concatenate(runs) for runs in zip(*errors, strict=True))
    both = np.isfinite(before) & np.isfinite(after)
    if not np.isfinite(before).any():
        return None
    silenced = int(both.sum()) < LEAST_VALID * int(np.isfinite(before).sum())
    old, new = (math.sqrt(_mean(errors[both] ** 2)) if both.any() else math.nan for errors in (before, after))
    return _Core(old, new, silenced)


def _core_errors(night: NightBasis, candidate: ModelFile) -> Iterator[tuple[Array, Array]]:
    """Yield both models' errors of the core scan by scan, NaN where there is no truth or no valid core. [K]"""
    count = 0
    for record in night.records[: -CORE_SEARCHED - 1 : -1]:
        if count >= CORE_RUNS:
            break
        run = night.run(record.run)
        if run is None:
            continue
        core = measured_core(night.press, run)
        if not np.isfinite(core).any():
            continue
        count += 1
        with suppress(InputError):  # a run without platens shows no core, whatever the model
            before, after = (_errors(night.press, run, model, core) for model in (night.base, candidate))
            yield before, after


def _errors(press: Press, run: Run, model: ModelFile | None, core: Array) -> Array:
    estimates = replay(press, run, model).estimates
    predicted: Array = np.array([e.core_C if e.valid else math.nan for e in estimates])
    return predicted - core


def _diagnose(night: NightBasis, runs: Sequence[str]) -> tuple[dict[str, Any], ModelFile, list[str]]:
    """Ask what the plain model gets wrong on these runs; a law without a name is reported and not promoted.

    Returns the report, the extended model, and causes it would name that the bets over all nights hold back.
    """
    from softsensor.diagnosis.extended_model import model_of
    from softsensor.diagnosis.summary import as_stored
    from softsensor.diagnosis.verdict import diagnose

    found = diagnose(night.press, night.runs(runs))
    in_force = [name for name, _ in night.base.effects] if night.base is not None else []
    unsure = [] if night.sure else unsure_causes(found, in_force)
    found = held_back(found) if unsure else found
    return {**as_stored(found), "predicted_gain_ci95": found.predicted_gain.ci95}, model_of(found.final), unsure
