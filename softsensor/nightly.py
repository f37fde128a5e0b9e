"""The nightly job: refit what changed, ask what the model gets wrong, promote a better model or leave it.

Everything it knows is in the store, so it may be killed at any moment: fits are kept one by one, a new
model is a candidate until one transaction promotes it, and the next night begins where this one ended.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from typing import Any

from daq.pressfile import Press
from daq.records import InputError
from daq.store import JournalEntry, RunRecord, RunStatus, Store, every
from softsensor.modelfile import parse_model
from softsensor.nightly_fits import NO_SENSORS, Task, fit_all
from softsensor.nightly_judge import NOTHING_CHANGED, PROCESS, Night, Outcome, Say, judge
from softsensor.recent import PRESS_FILE, fingerprint

ROLLED_BACK = "rolled back"
KEPT = ("unfit", "blind", "basis")
"""What a job that came to its end leaves of each press's `Outcome` for the next one."""


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
    marks = {r.run: fingerprint(r, press, base) for r in records}
    done = _stored_fits(store, marks)
    before = _told_before(store, name)
    unfit, blind = (
        {run: mark for run, mark in before.get(what, {}).items() if marks.get(run) == mark and run not in done}
        for what in ("unfit", "blind")
    )
    due = [r.run for r in records if r.run not in {**done, **unfit, **blind}]
    say(f"{name}: {len(due)} of {len(records)} runs to fit")
    known, fitted = len(unfit), 0
    url = store.database.url.render_as_string(hide_password=False)
    tasks = [Task(url, press, run, base) for run in due]
    for run, fit, error in fit_all(tasks, workers, dask):
        if error == NO_SENSORS:
            blind[run] = marks[run]
            continue
        if error:
            unfit[run] = marks[run]
            store.log("warning", PROCESS, f"run {run} could not be fitted: {error}", name)
            continue
        done[run] = {**fit, "fingerprint": marks[run]}
        store.put_fit(run, done[run], version)
        fitted += 1
    outcome = Outcome(
        name,
        len(records),
        fitted,
        len(unfit),
        "not asked",
        base.version if base else "",
        False,
        NOTHING_CHANGED,
        unfit,
        len(unfit) - known,
        blind,
    )
    basis = sha256(
        repr([(r.run, fingerprint(r, press, None)) for r in records if r.run in done]).encode()
    ).hexdigest()
    if base is None or before.get("basis") != basis:
        outcome = judge(Night(store, name, press, base, records, done, say), outcome)
    outcome = replace(outcome, basis=basis)
    store.log("info", PROCESS, outcome.line, name)
    return outcome


def sign_off(store: Store, outcomes: Sequence[Outcome]) -> None:
    """Leave the job's sign of life: when it last came to its end, what it judged, which runs need no second try.

    A job that is killed leaves none, so the next one judges what this one did not get to.
    """
    told = {"state": "done", "message": "; ".join(o.line for o in outcomes)}
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
        raise InputError(f"press {press}: no earlier model to go back to")
    store.promote_model(before[-1], who, ROLLED_BACK)
    return before[-1]


def _in_force_in_turn(store: Store, press: str) -> list[str]:
    """Return the versions that led to the one in force, oldest first; those gone back from are not among them."""
    turns: list[str] = []
    for entry in _promotions(store, press):
        version = entry.message.removeprefix("model ").removesuffix(" promoted")
        if (entry.detail or {}).get("reason") == ROLLED_BACK and version in turns[:-1]:
            del turns[len(turns) - turns[::-1].index(version) :]
        elif turns[-1:] != [version]:
            turns.append(version)
    return turns


def _promotions(store: Store, press: str) -> list[JournalEntry]:
    """Return what the journal says of promotions, oldest first."""
    entries = every(lambda cursor: store.journal(press=press, level="info", cursor=cursor, limit=200))
    found = [e for e in entries if e.message.startswith("model ") and e.message.endswith(" promoted")]
    return found[::-1]


def _finished_runs(store: Store, press: str) -> list[RunRecord]:
    """Return a press's finished runs, oldest first."""
    records = every(lambda cursor: store.runs(press=press, limit=200, cursor=cursor))
    found = [r for r in records if r.status is not RunStatus.OPEN]
    return [r for r in found[::-1] if r.kind == "imported" or math.isfinite(r.moments.closed_s)]


def _stored_fits(store: Store, marks: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return the fits that still stand, by run: same run, same press file, same effects, as its mark says."""
    found = ((run, mark, store.fit(run)) for run, mark in marks.items())
    return {run: fit for run, mark, fit in found if fit is not None and fit.get("fingerprint") == mark}
