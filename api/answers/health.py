"""Whether the system does its work: processes by their heartbeats, the store by its size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from api.answers.schemas import ArchiveHealth, Health, ProcessHealth, Said, StoreHealth
from api.answers.thresholds import crossed
from api.answers.words import message_answer
from daq.store.records import Archive, ProcessStatus, StandingAlarm, StoreUnavailable
from daq.store.store import Store
from daq.store.upkeep import Sizes
from daq.supervision import BEAT_S, IN_USE_S
from daq.words import Message, say, spoken

SILENT_S = 10.0 * BEAT_S
"""A process that is silent for this long is taken for dead. Ten signs of life, by hand, 2026-11. [s]"""
KINDS = {"sqlite": "SQLite", "postgresql": "PostgreSQL"}
EXPECTED = ("record", "sense")
"""The processes a working system has beside this one."""
WANTED = ("publish",)
"""Processes a system may do without; one that ran lately and was not stopped in order is missed."""
SEEN_S, SEEN_BYTES = 600.0, 16_000_000
"""How long the disk lasts is given after this much recording: before, the cost of a scan is that of empty tables
and of the write-ahead log (4 MB), and the figure many times too small."""
LONG_S = 7200.0
"""A silence longer than this is counted in hours. [s]"""
MANY_BEHIND = 600
"""Scans without an estimate, a minute of them at 10 Hz: the live sensor does not keep up, or compiles."""
LEAST_FREE_BYTES = 2_000_000_000
"""Some five days at 10 Hz and 400 bytes a scan (the example of `hours_left`): time to act."""
REFIT_OVERDUE_S = 180_000.0
"""Two nights and two hours. [s]"""
ALARM_AGE = timedelta(minutes=10)
"""Alarms of the journal older than this are history."""
NEVER_SEEN = "health-process-never-seen"
"""The message about a process that should run and never gave a sign of life."""


def installed_version() -> str:
    """Return the version of the installed project, ``0`` in a bare source tree."""
    try:
        return version("kerntemp")
    except PackageNotFoundError:
        return "0"


def health_of(store: Store, now: datetime) -> Health:
    """Return the health document; a store that does not answer is part of it, not an error."""
    try:
        statuses = store.statuses()
        alarms = _recent_alarms(store, now)
        processes = [_process(name, statuses.get(name), now) for name in _names(statuses, now)]
        sizes = store.sizes()
        kept = _store_health(store, sizes, _scans_per_s(processes))
        limits = crossed(store, now)
    except StoreUnavailable as error:
        empty = StoreHealth(kind=KINDS[store.database.dialect], size_bytes=None, free_bytes=None, hours_left=None)
        return _health("down", now, empty, [], [spoken(error)])
    conditions = _conditions(store, statuses, processes, sizes.free_bytes, now)
    urgent_first = [*(a.message for a in limits), *alarms, *conditions]
    return _health("degraded" if urgent_first else "ok", now, kept, processes, urgent_first)


def standing_alarms(store: Store, now: datetime) -> list[StandingAlarm]:
    """Return what stands now, as `/health` has it, with what each is about: to be raised once."""
    statuses = store.statuses()
    processes = [_process(name, statuses.get(name), now) for name in _names(statuses, now)]
    conditions = _conditions(store, statuses, processes, store.sizes().free_bytes, now)
    found = [StandingAlarm(_key(m), _press_in(m), m) for m in conditions]
    return [*found, *crossed(store, now)]


def _key(message: Message) -> str:
    """Return what a message is about, without the figures that change while it stands.

    >>> _key(say("health-process-silent", process="sense", seconds=12.5, command="sense"))
    'health-process-silent:sense:sense'
    """
    about = [
        a if isinstance(a, str) else _key(a) for a in message.arguments.values() if isinstance(a, str | Message)
    ]
    return ":".join([message.code.removesuffix("-for-hours"), *about])


def _press_in(message: Message) -> str | None:
    press = message.arguments.get("press")
    return press if isinstance(press, str) else None


def _conditions(
    store: Store,
    statuses: Mapping[str, ProcessStatus],
    processes: list[ProcessHealth],
    free_bytes: int | None,
    now: datetime,
) -> list[Message]:
    """Return what is wrong with processes, disk and nightly job."""
    alarms = _process_alarms(processes)
    if free_bytes is not None and free_bytes < LEAST_FREE_BYTES:
        alarms.append(say("health-disk-nearly-full", gigabytes=LEAST_FREE_BYTES // 10**9))
    if (archive := store.archive()) is not None:
        if archive.runs and not Path(archive.folder).is_dir():
            alarms.append(say("health-archive-away", folder=archive.folder))
        if archive.unsound:
            alarms.append(say("health-archive-unsound", files=archive.unsound, folder=archive.folder))
    if damaged := tuple(record.run for record in store.damaged_runs()):
        alarms.append(say("health-runs-damaged", runs=len(damaged), names=damaged, store=store.label))
    if (age_s := refit_age_s(store, statuses, now)) is not None and age_s > REFIT_OVERDUE_S:
        alarms.append(say("health-nightly-job-overdue", hours=age_s / 3600.0))
    return alarms


def _health(
    status: Literal["ok", "degraded", "down"],
    now: datetime,
    store: StoreHealth,
    processes: list[ProcessHealth],
    alarms: Sequence[Message],
) -> Health:
    messages = {str(alarm): message_answer(alarm) for alarm in alarms}
    return Health(
        status=status,
        version=installed_version(),
        utc=now,
        store=store,
        processes=processes,
        alarms=list(messages),
        alarms_said=list(messages.values()),
    )


def duty_of(process: str) -> str:
    """Return what a process does: its name without the host.

    >>> duty_of("record@press-pc-2")
    'record'
    """
    return process.partition("@")[0]


def _names(statuses: Mapping[str, ProcessStatus], now: datetime) -> list[str]:
    """Return the processes to show: the expected ones of every machine there lately, then the others."""
    names = []
    for expected in EXPECTED:
        known = sorted((n for n in statuses if duty_of(n) == expected), key=lambda n: statuses[n].utc)
        lately = [n for n in known if (now - statuses[n].utc).total_seconds() < IN_USE_S]
        names += sorted(lately) or known[-1:] or [expected]
    return [*names, *(n for n in sorted(statuses) if duty_of(n) not in EXPECTED)]


def _process(name: str, status: ProcessStatus | None, now: datetime) -> ProcessHealth:
    if status is None:
        unseen = say("health-never-seen")
        return ProcessHealth(
            name=name,
            alive=False,
            state="silent",
            message=str(unseen),
            message_said=[message_answer(unseen)],
            utc=None,
            age_s=None,
        )
    age_s = max((now - status.utc).total_seconds(), 0.0)
    beat = status.status
    ended = beat.get("state") in ("stopped", "done")
    return ProcessHealth(
        name=name,
        alive=age_s < SILENT_S and not ended,
        state=str(beat.get("state", "running")),
        message=str(beat.get("message", "")),
        message_said=[Said(**coded) for coded in beat.get("message_codes", ())],
        utc=status.utc,
        age_s=round(age_s, 3),
        details=dict(beat),
    )


def is_missed(process: ProcessHealth) -> bool:
    """Return whether a process that should run gives no sign of life; one of `WANTED` may be switched off."""
    if process.alive or duty_of(process.name) in EXPECTED:
        return not process.alive
    lately = process.age_s is not None and process.age_s < IN_USE_S
    return duty_of(process.name) in WANTED and lately and process.state != "stopped"


def _process_alarms(processes: list[ProcessHealth]) -> list[Message]:
    alarms = []
    for process in processes:
        if is_missed(process):
            alarms.append(_missed(process))
        elif process.alive:
            alarms += _problems(process.details)
        if duty_of(process.name) == "sense":
            alarms += [
                say("health-scans-behind", press=press["press"], scans=behind)
                for press in process.details.get("presses", [])
                if (behind := press.get("behind_scans", 0)) > MANY_BEHIND
            ]
    return alarms


def refit_age_s(store: Store, statuses: Mapping[str, ProcessStatus], now: datetime) -> float | None:
    """Return how long ago the nightly job came to its end or, before it ever did, the journal began. [s]"""
    if "refit" in statuses:
        since = statuses["refit"].utc
    elif first := store.journal_after(0, 1):
        since = first[0].utc
    else:
        return None
    return max((now - since).total_seconds(), 0.0)


def _missed(process: ProcessHealth) -> Message:
    command = duty_of(process.name)
    if process.age_s is None:
        return say(NEVER_SEEN, process=process.name, command=command)
    if process.state == "stopped":
        return say("health-process-stopped", process=process.name, command=command)
    if process.age_s > LONG_S:
        hours = process.age_s / 3600.0
        return say("health-process-silent-for-hours", process=process.name, hours=hours, command=command)
    return say("health-process-silent", process=process.name, seconds=process.age_s, command=command)


def _problems(details: Mapping[str, Any]) -> list[Message]:
    return [Message.from_json(problem) for problem in details.get("problem_codes", ())]


def _recent_alarms(store: Store, now: datetime) -> list[Message]:
    entries = store.journal(level="alarm", limit=10).items
    return [entry.message for entry in entries if now - entry.utc < ALARM_AGE]


def _store_health(store: Store, sizes: Sizes, scans_per_s: float) -> StoreHealth:
    scans = round(sizes.bytes / sizes.bytes_per_scan)  # imported or recorded
    left = None if sizes.free_bytes is None else hours_left(sizes.bytes, sizes.free_bytes, scans, scans_per_s)
    return StoreHealth(
        kind=KINDS[store.database.dialect],
        size_bytes=sizes.bytes,
        free_bytes=sizes.free_bytes,
        hours_left=left,
        archive=_archive_health(store.archive()),
    )


def _scans_per_s(processes: Sequence[ProcessHealth]) -> float:
    """Return how many scans the recorders at work make of all their presses. [1/s]"""
    recorders = [process.details for process in processes if process.alive and duty_of(process.name) == "record"]
    presses = [press for details in recorders for press in details.get("presses", [])]
    return math.fsum(press.get("rate_hz", 0.0) * press.get("speed", 1.0) for press in presses)


def _archive_health(archive: Archive | None) -> ArchiveHealth | None:
    if archive is None:
        return None
    return ArchiveHealth(
        runs=archive.runs, bytes=archive.bytes, unsound=archive.unsound, pressings_only=archive.removed
    )


def hours_left(size_bytes: int, free_bytes: int, scans: int, scans_per_s: float) -> float | None:
    """Return how long the disk lasts, None before enough was recorded. [h]

    Examples
    --------
    >>> hours_left(20_000_000, 1_000_000_000, 50_000, 10.0)
    69.4
    """
    if size_bytes < SEEN_BYTES or scans_per_s == 0.0 or scans / scans_per_s < SEEN_S:
        return None
    return round(free_bytes / (size_bytes / scans * scans_per_s * 3600.0), 1)
