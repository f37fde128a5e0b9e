"""The nightly job: refit what changed, ask what the model gets wrong, promote a better model or leave it.

Everything it knows is in the store, so it may be killed at any moment: fits are kept one by one, a new
model is a candidate until one transaction promotes it, and the next night begins where this one ended.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

from daq.address import Address
from daq.press.press_file import Press
from daq.records import InputError
from daq.store import JournalEntry, RunRecord, RunStatus, Store, every
from daq.words import say
from softsensor.heat.model_file import parse_model
from softsensor.jobs.model_in_force import PRESS_FILE, fingerprint
from softsensor.jobs.night_fits import Done, Task, fit_all
from softsensor.jobs.night_judgement import PROCESS, Night, Outcome, judge

ROLLED_BACK = "model-rolled-back"
KEPT = ("unfit", "blind", "basis")
"""What a job that came to its end leaves of each press's `Outcome` for the next one."""


def refit_press(
    store: Store,
    name: str,
    press: Press,
    *,
    workers: int | None = None,
    dask: str = "",
) -> Outcome:
    """Run the job for one press.

    Parameters
    ----------
    workers
        Local processes; by default one a core.
    dask
        Address of a Dask scheduler; its workers take the fits instead.
    """
    active = store.active_model(name)
    base = parse_model(active.model, f"model {active.version}") if active is not None else None
    records = _finished_runs(store, name)
    marks = {r.run: fingerprint(r, press, base) for r in records}
    before = _told_before(store, name)
    fits = _known_fits(store, marks, before)
    url = Address(store.database.url.render_as_string(hide_password=False))
    due = [Task(url, press, run, base) for run in marks if run not in {**fits.done, **fits.unfit, **fits.blind}]
    for one in fit_all(due, workers, dask):
        _keep(store, name, base.version if base is not None else PRESS_FILE, fits, one, marks[one.run])
    outcome = Outcome(
        press=name,
        runs=len(records),
        fitted=fits.fitted,
        failed=len(fits.unfit) + fits.killed,
        version=base.version if base else "",
        unfit=fits.unfit,
        newly_unfit=fits.newly_unfit,
        blind=fits.blind,
    )
    basis = _basis(press, [r for r in records if r.run in fits.done])
    if base is None or before.get("basis") != basis:
        outcome = judge(Night(store, name, press, base, records, fits.done), outcome)
    outcome = replace(outcome, basis=basis)
    store.log("info", PROCESS, outcome.line, name)
    return outcome


@dataclass
class _Fits:
    """What is known of a press's runs, by name; fingerprints stand for what was tried and need not be again."""

    done: dict[str, dict[str, Any]]
    unfit: dict[str, str]
    blind: dict[str, str]
    fitted: int = 0
    newly_unfit: int = 0
    killed: int = 0
    """Runs over which workers were killed: tried again the next night, when memory may be free."""


def _known_fits(store: Store, marks: Mapping[str, str], before: Mapping[str, Any]) -> _Fits:
    """Return what earlier jobs have left that still stands."""
    done = _stored_fits(store, marks)
    unfit, blind = (
        {run: mark for run, mark in before.get(what, {}).items() if marks.get(run) == mark and run not in done}
        for what in ("unfit", "blind")
    )
    return _Fits(done, unfit, blind)


def _keep(store: Store, name: str, version: str, fits: _Fits, one: Done, mark: str) -> None:
    """Keep what became of a run, made with the effects of a model version."""
    if one.killed:
        fits.killed += 1
        fits.newly_unfit += 1
        store.log("alarm", PROCESS, say("run-fit-killed", run=one.run), name)
    elif one.why is not None:
        fits.unfit[one.run] = mark
        fits.newly_unfit += 1
        store.log("warning", PROCESS, say("run-not-fitted", run=one.run, why=one.why), name)
    elif one.fit is None:
        fits.blind[one.run] = mark
    else:
        fits.done[one.run] = {**one.fit, "fingerprint": mark}
        store.put_fit(one.run, fits.done[one.run], version)
        fits.fitted += 1


def _basis(press: Press, records: Sequence[RunRecord]) -> str:
    """Return what a judgement rests on, as a text that changes when any of these runs does."""
    return sha256(repr([(r.run, fingerprint(r, press, None)) for r in records]).encode()).hexdigest()


def sign_off(store: Store, outcomes: Sequence[Outcome]) -> None:
    """Leave the job's sign of life: when it last came to its end, what it judged, which runs need no second try.

    A job that is killed leaves none, so the next one judges what this one did not get to.
    """
    lines = [o.line for o in outcomes]
    told = {
        "state": "done",
        "message": "; ".join(map(str, lines)),
        "message_codes": [line.to_json() for line in lines],
    }
    kept = {what: {o.press: getattr(o, what) for o in outcomes} for what in KEPT}
    store.beat(PROCESS, {**told, **kept})


def _told_before(store: Store, press: str) -> dict[str, Any]:
    """Return what the last job that came to its end left about a press."""
    before = store.statuses().get(PROCESS)
    told = before.status if before is not None else {}
    return {what: told[what][press] for what in KEPT if press in told.get(what, {})}


def roll_back(store: Store, press: str, who: str = PROCESS) -> str:
    """Promote the model that was in force before the present one came; return its version. Raises InputError."""
    before = _in_force_in_turn(store, press)[:-1]
    if not before:
        raise InputError(say("model-none-before", press=press))
    store.promote_model(before[-1], who, say("model-rolled-back"))
    return before[-1]


def _in_force_in_turn(store: Store, press: str) -> list[str]:
    """Return the versions that led to the one in force, oldest first; those gone back from are not among them."""
    turns: list[str] = []
    for entry in _promotions(store, press):
        version = str(entry.message.arguments["version"])
        if _rolled_back(entry.detail or {}) and version in turns[:-1]:
            del turns[len(turns) - turns[::-1].index(version) :]
        elif turns[-1:] != [version]:
            turns.append(version)
    return turns


def _rolled_back(detail: Mapping[str, Any]) -> bool:
    """Return whether a promotion went back; a store of a version before 2026-11-22 has only the text of why."""
    said = detail.get("reason_said")
    return said["code"] == ROLLED_BACK if said else detail.get("reason") == "rolled back"


def _promotions(store: Store, press: str) -> list[JournalEntry]:
    """Return what the journal says of promotions, oldest first."""
    entries = every(lambda cursor: store.journal(press=press, level="info", cursor=cursor, limit=200))
    return [e for e in entries if e.message.code == "model-promoted"][::-1]


def _finished_runs(store: Store, press: str) -> list[RunRecord]:
    """Return a press's finished runs, oldest first."""
    records = every(lambda cursor: store.runs(press=press, limit=200, cursor=cursor))
    found = [r for r in records if r.status is not RunStatus.OPEN]
    return [r for r in found[::-1] if r.kind == "imported" or math.isfinite(r.moments.closed_s)]


def _stored_fits(store: Store, marks: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return the fits that still stand, by run: same run, same press file, same effects, as its mark says."""
    found = ((run, mark, store.fit(run)) for run, mark in marks.items())
    return {run: fit for run, mark, fit in found if fit is not None and fit.get("fingerprint") == mark}
