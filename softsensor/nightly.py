"""The nightly job: refit what changed, ask what the model gets wrong, promote a better model or leave it.

Everything it knows is in the store, so it may be killed at any moment: fits are kept one by one, a new
model is a candidate until one transaction promotes it, and the next night begins where this one ended.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import lru_cache
from multiprocessing import get_context
from typing import Any

import numpy as np

from daq.pressfile import Press
from daq.records import InputError, Run
from daq.store import RunRecord, RunStatus, Store, open_store
from softsensor.adequacy import stored_adequacy
from softsensor.modelfile import ModelFile, parse_model
from softsensor.observer import LiveSensor
from softsensor.recent import PRESS_FILE, combined_model, fingerprint
from softsensor.service import fit_one

LOG = logging.getLogger("kerntemp.refit")
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
FEWEST_RUNS = 3
"""Runs a first model needs."""
SCHEDULER_WAIT_S = 10.0
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

    @property
    def line(self) -> str:
        """One line for terminal and journal."""
        what = f"model {self.version} promoted" if self.promoted else f"model {self.version or 'none'} stays"
        return (
            f"{self.press}: {self.fitted} of {self.runs} runs fitted, {self.failed} could not be; "
            f"diagnosis: {self.verdict}; {what}: {self.reason}"
        )


@dataclass(frozen=True)
class Task:
    """One run to fit, in a worker that reads it from the store itself."""

    url: str
    press: Press
    run: str
    model: ModelFile | None


def refit_press(
    store: Store,
    name: str,
    press: Press,
    *,
    workers: int | None = None,
    dask: str = "",
    say: Say = lambda _: None,
) -> Outcome:
    """Run the job for one press.

    Parameters
    ----------
    workers
        Local processes; by default one a core.
    dask
        Address of a Dask scheduler; its workers take the fits instead.
    say
        Told in one line what is being done.
    """
    active = store.active_model(name)
    base = parse_model(active.model, f"model {active.version}") if active is not None else None
    version = base.version if base is not None else PRESS_FILE
    records = _finished_runs(store, name)
    done = _stored_fits(store, records, press, base)
    marks = {r.run: fingerprint(r, press, base) for r in records}
    unfit = {run: mark for run, mark in _unfit(store, name).items() if marks.get(run) == mark and run not in done}
    due = [r.run for r in records if r.run not in done and r.run not in unfit]
    say(f"{name}: {len(due)} of {len(records)} runs to fit")
    known = len(unfit)
    url = store.database.url.render_as_string(hide_password=False)
    tasks = [Task(url, press, run, base) for run in due]
    for run, fit, error in fit_all(tasks, workers, dask):
        if error:
            unfit[run] = marks[run]
            store.log("warning", PROCESS, f"run {run} could not be fitted: {error}", name)
            continue
        done[run] = {**fit, "fingerprint": marks[run]}
        store.put_fit(run, done[run], version)
    new = len(unfit) - known
    outcome = Outcome(
        name,
        len(records),
        len(due) - new,
        len(unfit),
        "not asked",
        base.version if base else "",
        False,
        "nothing changed",
        unfit,
        new,
    )
    if due or base is None or not store.diagnoses(press=name, limit=1).items:
        outcome = _judge(_Night(store, name, press, base, records, done, say), outcome)
    store.log("info", PROCESS, outcome.line, name)
    return outcome


def sign_off(store: Store, outcomes: Sequence[Outcome]) -> None:
    """Leave the job's sign of life: when it last came to its end, and which runs the next one need not try."""
    told = {"state": "done", "message": "; ".join(o.line for o in outcomes)}
    store.beat(PROCESS, {**told, "unfit": {o.press: dict(o.unfit) for o in outcomes}})


def _unfit(store: Store, press: str) -> dict[str, str]:
    """Return the runs that jobs before could not fit, with the fingerprints of what they tried."""
    before = store.statuses().get(PROCESS)
    return {} if before is None else dict(before.status.get("unfit", {}).get(press, {}))


def roll_back(store: Store, press: str, who: str = PROCESS) -> str:
    """Promote the model that was in force before the present one; return its version. Raises InputError."""
    retired = [m for m in store.models(press=press, limit=200).items if m.status == "retired"]
    if not retired:
        raise InputError(f"press {press}: no earlier model to go back to")
    store.promote_model(retired[0].version, who, "rolled back")
    return retired[0].version


# --- fits -------------------------------------------------------------------------------------------


def _finished_runs(store: Store, press: str) -> list[RunRecord]:
    """Return a press's finished runs, oldest first."""
    found: list[RunRecord] = []
    cursor: str | None = None
    while True:
        page = store.runs(press=press, limit=200, cursor=cursor)
        found += [r for r in page.items if r.status is not RunStatus.OPEN]
        cursor = page.next_cursor
        if cursor is None:
            return [r for r in found[::-1] if r.kind == "imported" or math.isfinite(r.moments.closed_s)]


def _stored_fits(
    store: Store, records: Sequence[RunRecord], press: Press, base: ModelFile | None
) -> dict[str, dict[str, Any]]:
    """Return the fits that still stand: same run, same press file, same effects."""
    kept = {}
    for record in records:
        fit = store.fit(record.run)
        if fit is not None and fit.get("fingerprint") == fingerprint(record, press, base):
            kept[record.run] = fit
    return kept


@lru_cache(maxsize=4)
def _store_of(url: str) -> Store:
    return open_store(url, create=False)


def fit_stored(task: Task) -> tuple[str, dict[str, Any], str]:
    """Fit one stored run; return its name, the fit, and why there is none."""
    try:
        return task.run, fit_one(task.press, _store_of(task.url).load_run(task.run), task.model), ""
    except (InputError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return task.run, {}, " ".join(str(error).split()) or type(error).__name__


def fit_all(
    tasks: Sequence[Task], workers: int | None = None, dask: str = ""
) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Yield the results of `fit_stored` as they come: on Dask, on local processes, or here."""
    if dask and tasks:
        yield from _on_dask(tasks, dask)
        return
    workers = max(1, min(workers or os.cpu_count() or 1, len(tasks)))
    if workers == 1 or len(tasks) < 4:
        yield from map(fit_stored, tasks)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(fit_stored, task) for task in tasks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            for future in futures:
                future.cancel()


def _on_dask(tasks: Sequence[Task], address: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    try:
        from dask.distributed import Client
        from dask.distributed import as_completed as completed
    except ImportError as error:
        raise InputError(
            f"Dask scheduler {address}: the package 'distributed' is missing; on a press PC "
            "kerntemp_setup.py complete brings it, elsewhere pip install 'kerntemp[dask]'"
        ) from error
    try:
        client = Client(address, timeout=SCHEDULER_WAIT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"Dask scheduler {address}: no answer in {SCHEDULER_WAIT_S:g} s; check [refit] dask and that it runs"
        ) from error
    with client:
        for future in completed(client.map(fit_stored, tasks, pure=False)):
            yield future.result()


# --- models -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Night:
    """What a night's judgement rests on."""

    store: Store
    name: str
    press: Press
    base: ModelFile | None
    records: Sequence[RunRecord]
    fits: Mapping[str, Mapping[str, Any]]
    say: Say

    def runs(self, names: Sequence[str]) -> list[Run]:
        return [self.store.load_run(name) for name in names]


def _judge(night: _Night, outcome: Outcome) -> Outcome:
    """Diagnose, make a candidate, and promote it if runs that took no part are the better for it."""
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
    if not extended.effects:
        return _keep_or_begin(night, base, outcome)
    if night.base is not None and _same_effects(night.base, extended):
        return replace(outcome, reason="the diagnosis confirms it")
    candidate = replace(extended, version=_next_version(night), press=night.name)
    fits = _fits_with(night, candidate, (held or asked)[-JUDGES:])
    candidate = replace(candidate, adequacy=stored_adequacy(list(fits.values())))
    reason, better = _compare(night, report, candidate, fits)
    night.store.put_model(
        night.name,
        candidate.version,
        candidate.as_json(),
        status="candidate" if better else "rejected",
        reason=reason,
    )
    if not better:
        return _keep_or_begin(night, base, replace(outcome, reason=f"{candidate.version} rejected, {reason}"))
    night.store.promote_model(candidate.version, PROCESS, reason)
    return replace(outcome, version=candidate.version, promoted=True, reason=reason)


def _keep_or_begin(night: _Night, base: ModelFile, outcome: Outcome) -> Outcome:
    """Leave the promoted model; where there is none yet, begin with the runs' coefficients."""
    if night.base is not None:
        return outcome
    first = replace(base, version=_next_version(night), press=night.name)
    met = sum(bool(fit.get("met", True)) for fit in night.fits.values())
    reason = f"first model, coefficients of {met} runs"
    night.store.put_model(night.name, first.version, first.as_json(), reason=reason)
    night.store.promote_model(first.version, PROCESS, reason)
    return replace(outcome, version=first.version, promoted=True, reason=f"{reason}; {outcome.reason}")


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


def _next_version(night: _Night) -> str:
    taken = {m.version for m in night.store.models(press=night.name, limit=200).items}
    day = f"{night.name}-{datetime.now(UTC):%Y-%m-%d}"
    return next(f"{day}-{i}" for i in range(1, 10_000) if f"{day}-{i}" not in taken)


def _fits_with(night: _Night, candidate: ModelFile, runs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Fit the judging runs with a candidate's effects."""
    night.say(f"{night.name}: {candidate.version} judged on {len(runs)} runs")
    found = {}
    for run in runs:
        with suppress(InputError):
            found[run] = fit_one(night.press, night.store.load_run(run), candidate)
    return found


def _compare(
    night: _Night, report: Mapping[str, Any], candidate: ModelFile, fits: Mapping[str, Mapping[str, Any]]
) -> tuple[str, bool]:
    """Say what the candidate gains on the judging runs, and whether that is enough."""
    before = [float(night.fits[run]["rmse_K"]) for run in fits]
    after = [float(fit["rmse_K"]) for fit in fits.values()]
    old, new = np.array(before), np.array(after)
    if len(old) < FEWEST_RUNS:
        return "too few runs to judge by", False
    share = float(1.0 - np.mean(new) / np.mean(old))
    saved = old - new
    certain = float(saved.mean() / max(saved.std(ddof=1) / math.sqrt(len(saved)), 1e-9))
    base_core, new_core = _core_rmse(night, candidate)
    names = " + ".join(name for name, _ in candidate.effects)
    reason = f"{names}: residual {np.mean(old):.3f} -> {np.mean(new):.3f} K on {len(old)} runs"
    if math.isfinite(base_core):
        reason += f", core {base_core:.2f} -> {new_core:.2f} K live"
    held = [float((report.get(k) or {}).get("heldout_rmse_K") or math.nan) for k in ("base", "extended")]
    if held[1] > held[0]:
        return f"{reason}; worse on held-out runs", False
    if share < LEAST_SHARE or certain < 2.0:
        return f"{reason}; the gain is not significant", False
    if math.isfinite(base_core) and new_core > CORE_TOLERANCE * base_core + 0.05:
        return f"{reason}; the core gets worse", False
    return reason, True


def _core_rmse(night: _Night, candidate: ModelFile) -> tuple[float, float]:
    """Replay runs with a core thermocouple through the live sensor with both models."""
    errors: tuple[list[float], list[float]] = ([], [])
    count = 0
    for record in night.records[: -CORE_SEARCHED - 1 : -1]:
        if count >= CORE_RUNS:
            break
        run = night.store.load_run(record.run)
        truth = [c for c in night.press.sensors_of(run, "validation") if np.isfinite(run.columns[c]).any()]
        if not truth:
            continue
        count += 1
        core = np.nanmean(np.stack([run.columns[c] for c in truth]), axis=0)
        for model, found in zip((night.base, candidate), errors, strict=True):
            found += _squares(night.press, run, model, core)
    return tuple(math.sqrt(float(np.mean(e))) if e else math.nan for e in errors)  # type: ignore[return-value]


def _squares(press: Press, run: Run, model: ModelFile | None, core: np.ndarray) -> list[float]:
    sensor = LiveSensor(press, run.header, model)
    names = list(run.columns)
    table = np.stack([run.columns[n] for n in names], axis=1).tolist()
    said = [
        sensor.update(t, dict(zip(names, row, strict=True)))
        for t, row in zip(run.time_s.tolist(), table, strict=True)
    ]
    return [
        (e.core_C - true) ** 2 for e, true in zip(said, core.tolist(), strict=True) if e.valid and true == true
    ]


def _diagnose(night: _Night, runs: Sequence[str]) -> tuple[dict[str, Any], ModelFile]:
    """Ask what the plain model gets wrong on these runs."""
    from softsensor.diagnosis import diagnose

    found = diagnose(night.press, night.runs(runs), progress=lambda what, _: night.say(f"{night.name}: {what}"))
    return found.as_json(), found.model_file()
