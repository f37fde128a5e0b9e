"""A night's judgement: what the runs say is missing, a candidate with it, and whether it is better.

Nothing is promoted that has not been held against the model in force on the same runs and, where there is a core
thermocouple, on the same scans of the core.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from scipy.stats import t as student

from daq.pressfile import Press
from daq.records import Array, InputError, Run
from daq.store import RunRecord, Store
from softsensor.adequacy import stored_adequacy
from softsensor.modelfile import ModelFile, parse_model
from softsensor.observer import LiveSensor
from softsensor.recent import combined_model
from softsensor.service import fit_one

PROCESS = "refit"
DIAGNOSED_RUNS = 24
"""The newest runs a diagnosis looks at."""
SPLIT_FROM = 18
"""From this many runs on, the newest third takes no part in diagnosis and judges the result."""
JUDGES = 12
CORE_RUNS, CORE_SEARCHED = 6, 100
"""Runs with a core thermocouple that are replayed through the live sensor with both models; looked for among the
newest."""
LEAST_SHARE = 0.02
"""Of the held-out residual, which an extended model must save."""
CORE_TOLERANCE = 1.02
LEAST_VALID = 0.9
"""Of the scans with a core thermocouple that the model in force predicts: a candidate must dare as many."""
NOTHING_CHANGED = "nothing changed"
FEWEST_RUNS = 3
"""Runs a first model needs."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What the job did for one press."""

    press: str
    runs: int
    fitted: int
    failed: int
    verdict: str
    """Of the diagnosis, or why there was none."""
    version: str
    """The model in force afterwards, empty where there is none."""
    promoted: bool
    reason: str
    unfit: Mapping[str, str] = field(default_factory=dict)
    """Runs that cannot be fitted, by name, with the fingerprint of what was tried: not tried again as they are."""
    newly_unfit: int = 0
    """How many of them were tried in this job."""
    blind: Mapping[str, str] = field(default_factory=dict)
    """Runs without panel sensors, likewise: in production that is how it is meant, so nothing has failed."""
    basis: str = ""
    """Fingerprint of the runs that were judged: the next job judges again as soon as there are others."""

    @property
    def fits_line(self) -> str:
        """What became of the runs, in words."""
        unseen = f", {len(self.blind)} have no panel sensors" if self.blind else ""
        return f"{self.fitted} of {self.runs} runs fitted, {self.failed} could not be{unseen}"

    @property
    def line(self) -> str:
        """One line for terminal and journal."""
        what = f"model {self.version} promoted" if self.promoted else f"model {self.version or 'none'} stays"
        return f"{self.press}: {self.fits_line}; diagnosis: {self.verdict}; {what}: {self.reason}"


@dataclass(frozen=True)
class Night:
    """What a night's judgement rests on."""

    store: Store
    name: str
    press: Press
    base: ModelFile | None
    records: Sequence[RunRecord]
    fits: Mapping[str, Mapping[str, Any]]
    say: Say

    def runs(self, names: Sequence[str]) -> list[Run]:
        """Return stored runs by name."""
        return [self.store.load_run(name) for name in names]


def judge(night: Night, outcome: Outcome) -> Outcome:
    """Diagnose, make a candidate, and promote it if runs that took no part are the better for it.

    A candidate with fewer effects than the model in force, where the diagnosis no longer finds them, need not
    be better: it is promoted unless those effects still help.
    """
    good = [r.run for r in night.records if r.run in night.fits]
    if len(good) < FEWEST_RUNS:
        return replace(
            outcome, verdict="too_few_runs", reason=f"{len(good)} runs fitted, {FEWEST_RUNS} are needed"
        )
    held = good[-min(JUDGES, len(good) // 3) :] if len(good) >= SPLIT_FROM else []
    asked = [run for run in good if run not in held][-DIAGNOSED_RUNS:]
    base = combined_model(night.press, night.base, [night.fits[run] for run in good])
    report, extended = _diagnose(night, asked)
    night.store.put_diagnosis(night.name, {**report, "runs": asked})
    outcome = replace(outcome, verdict=str(report["verdict"]))
    fewer = _leaves_out(night.base, extended) if outcome.verdict in ("no_effect", "named") else ()
    if not extended.effects and not fewer:
        return _keep_or_begin(night, base, outcome)
    if night.base is not None and _same_effects(night.base, extended):
        return replace(outcome, reason="the diagnosis confirms it")
    candidate = replace(extended, version=_next_version(night), press=night.name)
    fits = _fits_with(night, candidate, (held or asked)[-JUDGES:])
    candidate = replace(candidate, adequacy=stored_adequacy(list(fits.values())))
    found = _compare(night, report, candidate, fits, apart=bool(held), fewer=fewer)
    better = found.better
    unwanted = _rolled_back(night, candidate) if better else ""
    reason = f"{found.reason}; like {unwanted}, which was rolled back" if unwanted else found.reason
    night.store.put_model(
        night.name,
        candidate.version,
        {**candidate.as_json(), "basis": {"diagnosed_runs": asked, **found.figures}},
        status="candidate" if better else "rejected",
        reason=reason,
    )
    if not better:
        return _keep_or_begin(night, base, replace(outcome, reason=f"{candidate.version} rejected, {reason}"))
    if unwanted:
        return replace(outcome, reason=f"{candidate.version} is left to you, {reason}")
    night.store.promote_model(candidate.version, PROCESS, reason)
    return replace(outcome, version=candidate.version, promoted=True, reason=reason)


def _leaves_out(old: ModelFile | None, new: ModelFile) -> tuple[str, ...]:
    """Return the effects of the model in force that a new one does without, none where it has others instead."""
    before = {name for name, _ in old.effects} if old is not None else set()
    after = {name for name, _ in new.effects}
    return tuple(sorted(before - after)) if after < before else ()


def _keep_or_begin(night: Night, base: ModelFile, outcome: Outcome) -> Outcome:
    """Leave the promoted model; where there is none yet, begin with the runs' coefficients."""
    if night.base is not None:
        return outcome
    first = replace(base, version=_next_version(night), press=night.name)
    met = sum(bool(fit.get("met", True)) for fit in night.fits.values())
    reason = f"first model, coefficients of {met} runs"
    if outcome.reason != NOTHING_CHANGED:
        reason += f"; {outcome.reason}"
    content = {**first.as_json(), "basis": {"fitted_runs": list(night.fits)}}
    night.store.put_model(night.name, first.version, content, reason=reason)
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


def _rolled_back(night: Night, candidate: ModelFile) -> str:
    """Return the version of a model like the candidate that somebody has gone back from, empty where none is."""
    active = night.store.active_model(night.name)
    newer = (
        m for m in night.store.models(press=night.name, limit=200).items if active and m.number > active.number
    )
    same = (
        m.version
        for m in newer
        if m.status == "retired" and _same_effects(parse_model(m.model, m.version), candidate)
    )
    return next(same, "")


def _next_version(night: Night) -> str:
    taken = {m.version for m in night.store.models(press=night.name, limit=200).items}
    day = f"{night.name}-{datetime.now(UTC):%Y-%m-%d}"
    return next(f"{day}-{i}" for i in range(1, 10_000) if f"{day}-{i}" not in taken)


def _fits_with(night: Night, candidate: ModelFile, runs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Fit the judging runs with a candidate's effects."""
    night.say(f"{night.name}: {candidate.version} judged on {len(runs)} runs")
    found = {}
    for run in runs:
        with suppress(InputError):
            found[run] = fit_one(night.press, night.store.load_run(run), candidate)
    return found


@dataclass(frozen=True)
class _Comparison:
    """A candidate against the model in force."""

    reason: str
    better: bool
    figures: Mapping[str, Any]
    """What the version says of itself: runs it was judged on and residuals with the model before and with it."""


def _compare(
    night: Night,
    report: Mapping[str, Any],
    candidate: ModelFile,
    fits: Mapping[str, Mapping[str, Any]],
    *,
    apart: bool,
    fewer: Sequence[str] = (),
) -> _Comparison:
    """Say what the candidate gains on the judging runs, and whether that is enough.

    Where there are too few runs to keep the judging ones apart from the diagnosis, that is said, and what the
    diagnosis gained on runs it left out in turn. `fewer` effects than before need no gain, only no loss.
    """
    old, new = (np.array([float(f[run]["rmse_K"]) for run in fits]) for f in (night.fits, fits))
    left_out = [float((report.get(k) or {}).get("heldout_rmse_K") or math.nan) for k in ("base", "extended")]
    figures: dict[str, Any] = {
        "judged_runs": list(fits),
        "judged_runs_took_part": not apart,
        "rmse_K": {"before": _mean(old), "after": _mean(new)},
    }
    if math.isfinite(left_out[0]) and not fewer:
        figures["heldout_rmse_K"] = {"before": left_out[0], "after": left_out[1]}
    if len(old) < FEWEST_RUNS:
        return _Comparison("too few runs to judge by", False, figures)
    core = _core_rmse(night, candidate)
    names = " + ".join(name for name, _ in candidate.effects)
    without = f"without {' + '.join(fewer)}" if fewer else ""
    which = f"{len(old)} runs that took no part" if apart else f"{len(old)} runs of the diagnosis"
    reason = (
        f"{' '.join(filter(None, (names, without)))}: residual {_mean(old):.3f} -> {_mean(new):.3f} K on {which}"
    )
    if not apart and "heldout_rmse_K" in figures:
        reason += f", {left_out[0]:.3f} -> {left_out[1]:.3f} K on runs left out in turn"
    if core is not None:
        figures["core_rmse_K"] = {"before": core.before_K, "after": core.after_K}
        reason += f", core {core.before_K:.2f} -> {core.after_K:.2f} K live"

    def verdict(against: str = "") -> _Comparison:
        return _Comparison(f"{reason}; {against}" if against else reason, not against, figures)

    share = float(1.0 - np.mean(new) / np.mean(old))
    if fewer:
        if share < -LEAST_SHARE and surely_less(new, old):
            return verdict("what it leaves out still helps")
    elif left_out[1] > left_out[0]:
        return verdict("worse on held-out runs")
    elif share < LEAST_SHARE or not surely_less(old, new):
        return verdict("the gain is not significant")
    if core is not None and core.silenced:
        return verdict("the core is valid in fewer scans")
    if core is not None and not core.after_K <= CORE_TOLERANCE * core.before_K + 0.05:
        return verdict("the core gets worse")
    return verdict()


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def surely_less(old: Array, new: Array) -> bool:
    """Return whether residuals of the same runs have fallen: Student's one-sided test of their ratio, at 5 %. [K]

    Of the ratio, since one run that leaves much over would else decide alone how certain the rest is.
    """
    fell = np.log(np.maximum(old, 1e-9)) - np.log(np.maximum(new, 1e-9))
    error = max(float(fell.std(ddof=1)) / math.sqrt(len(fell)), 1e-9)
    return float(fell.mean()) / error > float(student.ppf(0.95, len(fell) - 1))


@dataclass(frozen=True)
class _Core:
    """Root mean square error of the core before and with the candidate, where both are valid. [K]"""

    before_K: float  # noqa: N815
    after_K: float  # noqa: N815
    silenced: bool
    """The candidate calls many scans not valid that the model before predicts."""


def _core_rmse(night: Night, candidate: ModelFile) -> _Core | None:
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


def _core_errors(night: Night, candidate: ModelFile) -> Iterator[tuple[Array, Array]]:
    """Yield both models' errors of the core scan by scan, NaN where there is no truth or no valid core. [K]"""
    count = 0
    for record in night.records[: -CORE_SEARCHED - 1 : -1]:
        if count >= CORE_RUNS:
            break
        run = night.store.load_run(record.run)
        truth = [c for c in night.press.sensors_of(run, "validation") if np.isfinite(run.columns[c]).any()]
        if not truth:
            continue
        count += 1
        columns = np.ma.masked_invalid(np.stack([run.columns[c] for c in truth]))
        core = columns.mean(axis=0).filled(np.nan)
        yield tuple(_errors(night.press, run, model, core) for model in (night.base, candidate))  # type: ignore[misc]


def _errors(press: Press, run: Run, model: ModelFile | None, core: Array) -> Array:
    sensor = LiveSensor(press, run.header, model)
    names = list(run.columns)
    table = np.stack([run.columns[n] for n in names], axis=1).tolist()
    said = (
        sensor.update(t, dict(zip(names, row, strict=True)))
        for t, row in zip(run.time_s.tolist(), table, strict=True)
    )
    predicted: Array = np.array([e.core_C if e.valid else math.nan for e in said])
    return predicted - core


def _diagnose(night: Night, runs: Sequence[str]) -> tuple[dict[str, Any], ModelFile]:
    """Ask what the plain model gets wrong on these runs."""
    from softsensor.diagnosis import diagnose
    from softsensor.diagnosis_words import as_stored

    found = diagnose(night.press, night.runs(runs), progress=lambda what, _: night.say(f"{night.name}: {what}"))
    return as_stored(found), found.model_file()
