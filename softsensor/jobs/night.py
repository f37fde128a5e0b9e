"""The nightly job: refit what changed, ask what the model gets wrong, promote a better model or leave it.

Everything it knows is in the store, so it may be killed at any moment: fits are kept one by one, so is what cannot
be fitted, a new model is a candidate until one transaction promotes it, and each press signs off by itself. The
next night begins where this one ended.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import sha256
from typing import Any, Literal

from daq.press.press_file import Press
from daq.records import InputError
from daq.store import JournalEntry, ModelRecord, RunRecord, Store, StoredNight, StoreUnavailable, every
from daq.supervision import unexpected
from daq.words import Message, say, spoken
from softsensor.heat.model_file import ModelFile
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.bets import Bets
from softsensor.jobs.drift import alarms_of
from softsensor.jobs.model_in_force import PRESS_FILE, fingerprint, standing_fits
from softsensor.jobs.night_basis import FAILED, FEWEST_RUNS, NightBasis, NightOutcome
from softsensor.jobs.night_fits import Done, FitTask, fit_all
from softsensor.jobs.night_judgement import DIAGNOSED_RUNS, JUDGES, judge_night
from softsensor.jobs.night_progress import Agenda, agenda_of
from softsensor.jobs.night_sure import settled
from softsensor.jobs.retention import OldScans
from softsensor.jobs.run_reader import PROCESS, RunReader

LOG = logging.getLogger("kerntemp.refit")
ROLLED_BACK = "model-rolled-back"
Level = Literal["warning", "alarm"]
NOTHING_KEPT = OldScans()

# Numbers without another source were set by hand, 2026-11.

SHOWN_LEFT_OUT = 50
"""Runs left out that a night names; the journal has all."""


def refit_press(
    store: Store,
    name: str,
    press: Press,
    *,
    workers: int | None = None,
    dask: str = "",
    kept: OldScans = NOTHING_KEPT,
) -> NightOutcome:
    """Run the job for one press, and sign off for it.

    Parameters
    ----------
    workers
        Local processes; by default one a core.
    dask
        Address of a Dask scheduler; its workers take the fits instead.
    kept
        What became of its old scans before.

    Raises
    ------
    InputError
        Where another job works on the press.
    """
    with store.only_night(name):
        return _refit_press(store, name, press, workers, dask, kept)


def _refit_press(
    store: Store, name: str, press: Press, workers: int | None, dask: str, kept: OldScans
) -> NightOutcome:
    started, begun = datetime.now(UTC), time.perf_counter()
    active = store.active_model(name)
    base = parse_model(active.model, f"model {active.version}") if active is not None else None
    agenda = agenda_of(store, name, press, base)
    tally = _Tally(store, name, base.version if base is not None else PRESS_FILE)
    for one in fit_all([FitTask(store.database.address, press, run, base) for run in agenda.due], workers, dask):
        tally.keep(one, agenda.due[one.run])
    outcome = _worked_off(store, name, agenda, tally, base)
    fits = standing_fits(store, agenda.window, press, base)
    good = [r for r in agenda.window if r.run in fits]
    progress = replace(agenda.progress, basis=_basis(press, good))
    if base is None or agenda.progress.basis != progress.basis:
        reader = RunReader(store, name)
        good = reader.newest(good, DIAGNOSED_RUNS + JUDGES)
        progress = replace(progress, bets=_bets(reader, press, base, agenda, good[-DIAGNOSED_RUNS:]))
        fits = {r.run: fits[r.run] for r in good}
        night = NightBasis(store, name, press, base, agenda.window, fits, progress.bets.sure, reader)
        outcome = judge_night(night, outcome)
        left_out = (*outcome.left_out, *reader.left_out.items())
        outcome = replace(outcome, left_out=left_out[:SHOWN_LEFT_OUT], unread=tuple(reader.left_out.values()))
    if active is not None and not outcome.promoted and _came_from_sisters(store, active):
        reason = Message.from_json(active.model["basis"]["reason"])
        outcome = replace(outcome, promoted=True, reason=reason)
    outcome = replace(outcome, drifts=tuple((a.coefficient, a.message) for a in alarms_of(store, name)))
    outcome = replace(outcome, archive=kept.line(name), archive_problem=kept.problem)
    summary = _summary(outcome, time.perf_counter() - begun) | kept.summary()
    store.put_night(StoredNight(name, started, datetime.now(UTC), summary, progress.as_json()))
    store.log("info", PROCESS, outcome.line, name)
    return outcome


def _came_from_sisters(store: Store, active: ModelRecord) -> bool:
    """Return whether a model was learned from sisters since the night before: this night reports it."""
    before = store.nights(press=active.press, limit=1).items
    return "sisters" in active.model and (not before or before[0].ended_utc < active.created_utc)


def failed_night(store: Store, name: str, began: datetime, why: Message) -> NightOutcome:
    """Sign off for a press whose night did not come to its end: an alarm names it, the next begins where it did.

    What the store holds of it may be the very fault, or the store away: what is returned says it all the same.
    """
    outcome = NightOutcome(name, runs=0, fitted=0, failed=0, version="", verdict=FAILED, reason=why)
    with suppress(Exception):
        store.log("alarm", PROCESS, outcome.line, name)
    with suppress(Exception):
        without = store.count_unfitted(name)
        failed = without.get("unfit", 0) + without.get("killed", 0)
        runs, blind = store.count_pressings(name), without.get("blind", 0)
        outcome = replace(outcome, runs=runs, failed=failed, blind=blind)
        before = store.nights(press=name, limit=1).items
        summary, progress = _summary(outcome, 0.0), before[0].progress if before else {}
        store.put_night(StoredNight(name, began, datetime.now(UTC), summary, progress))
    return outcome


def reason_of(error: Exception) -> Message:
    """Return what an error says; one that nobody foresaw leaves its trace in the log."""
    if isinstance(error, InputError | StoreUnavailable):
        return spoken(error)
    LOG.error("%s", unexpected(error), exc_info=error)
    return unexpected(error)


@dataclass
class _Tally:
    """Keeps what becomes of a press's runs, each at once, made with the effects of a model version."""

    store: Store
    press: str
    version: str
    fitted: int = 0
    newly_unfit: int = 0
    left_out: list[tuple[str, Message]] = field(default_factory=list)

    def keep(self, one: Done, mark: str) -> None:
        """Keep what became of a run."""
        if one.fit is not None:
            self.store.put_fit(one.run, {**one.fit, "fingerprint": mark}, self.version)
            self.fitted += 1
        elif one.killed:  # tried again the next night, when memory may be free: no mark keeps it from that
            self._leave_out("alarm", one.run, say("run-fit-killed", run=one.run))
            self.store.put_unfitted(one.run, self.press, "killed", "")
        elif one.why is not None:
            level: Level = "alarm" if one.damaged else "warning"
            self._leave_out(level, one.run, say("run-not-fitted", run=one.run, why=one.why))
            self.store.put_unfitted(one.run, self.press, "unfit", mark)
        else:
            self.store.put_unfitted(one.run, self.press, "blind", mark)

    def _leave_out(self, level: Level, run: str, why: Message) -> None:
        self.newly_unfit += 1
        self.left_out.append((run, why))
        self.store.log(level, PROCESS, why, self.press)


def _worked_off(store: Store, name: str, agenda: Agenda, tally: _Tally, base: ModelFile | None) -> NightOutcome:
    """Return what became of a press's runs, before anything is judged."""
    without = store.count_unfitted(name)
    behind = agenda.progress.behind
    return NightOutcome(
        press=name,
        runs=agenda.runs,
        fitted=tally.fitted,
        failed=without.get("unfit", 0) + without.get("killed", 0),
        version=base.version if base is not None else "",
        newly_unfit=tally.newly_unfit,
        blind=without.get("blind", 0),
        new=agenda.new,
        later=store.count_pressings(name, below=behind) if behind else 0,
        left_out=tuple(tally.left_out[:SHOWN_LEFT_OUT]),
    )


def _bets(
    reader: RunReader, press: Press, base: ModelFile | None, agenda: Agenda, good: Sequence[RunRecord]
) -> Bets:
    """Return the bets on whether the model in force leaves something out, with those of new runs settled."""
    may_have_made_it = agenda.window if base is not None and base.effects else ()
    made_of = max((r.number for r in may_have_made_it), default=0)
    bets = agenda.progress.bets.facing(agenda.progress.rests_on, made_of)
    return settled(bets, reader, press, base, good) if len(good) >= FEWEST_RUNS else bets


def _basis(press: Press, records: Sequence[RunRecord]) -> str:
    """Return what a judgement rests on, as a text that changes when any of these runs does."""
    return sha256(repr([(r.run, fingerprint(r, press, None)) for r in records]).encode()).hexdigest()


def _summary(outcome: NightOutcome, seconds: float) -> dict[str, Any]:
    """Return a night as lists of nights show it."""
    return {
        "runs": outcome.runs,
        "new": outcome.new,
        "fitted": outcome.fitted,
        "not_fitted": outcome.failed,
        "blind": outcome.blind,
        "later": outcome.later,
        "left_out": [{"run": run, "why": why.to_json()} for run, why in outcome.left_out],
        "seconds": round(seconds, 3),
        "memory_bytes": most_memory_bytes(),
        "verdict": outcome.verdict,
        "named": list(outcome.named),
        "promoted": outcome.version if outcome.promoted else "",
        "refused": outcome.refused,
        "version": outcome.version,
        "reason": outcome.reason.to_json(),
        "drifts": [{"coefficient": name, "said": message.to_json()} for name, message in outcome.drifts],
    }


def most_memory_bytes() -> int | None:
    """Return the most memory the job or the largest of its workers that have ended held; None where not known."""
    if sys.platform == "win32":
        return None
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return unit * max(
        resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )


def sign_off(store: Store, outcomes: Sequence[NightOutcome]) -> None:
    """Leave the whole job's sign of life: when it last came to its end, and its outcome."""
    lines = [o.line for o in outcomes]
    status = {
        "state": "done",
        "message": "; ".join(map(str, lines)),
        "message_codes": [line.to_json() for line in lines],
    }
    store.beat(PROCESS, status)


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
    """Return whether a promotion went back to an earlier version."""
    return (detail.get("reason_said") or {}).get("code") == ROLLED_BACK


def _promotions(store: Store, press: str) -> list[JournalEntry]:
    """Return what the journal says of promotions, oldest first."""
    entries = every(lambda cursor: store.journal(press=press, level="info", cursor=cursor, limit=200))
    return [e for e in entries if e.message.code == "model-promoted"][::-1]
