"""What the recorder writes: scans, press events, runs. Each function works in one transaction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, and_, func, insert, select, true, update
from sqlalchemy.exc import IntegrityError

from daq.address import masked
from daq.press.header import new_doubts
from daq.records import PressEvent, Scan
from daq.store.convert import faults_json, readings_json, unix_of
from daq.store.journal import log
from daq.store.last_written import LastWritten
from daq.store.next_panel import take_next_panel
from daq.store.press_layouts import inserted
from daq.store.reading import has_run
from daq.store.records import NewRun, NumbersTaken, PressKey, RunEnd, RunStatus, ScansUnreadable
from daq.store.run_ends import changes_of_short
from daq.store.run_headers import header_columns
from daq.store.schema import CONFIGURATION, PRESS, PRESS_EVENT, RUN, SCAN
from daq.store.sound_rows import rows_with_damage, stored_header
from daq.words import say

PROCESS = "record"
"""Who the journal says found out what a write brings to light."""


def end_runs_left_open(
    connection: Connection, newest: Mapping[str, int], so_far: Mapping[str, LastWritten]
) -> None:
    """Have runs interrupted that an older state of the store shows open, but for the one under way.

    Their ends are lost, and what moves the press now belongs to another panel.
    """
    for press, number in newest.items():
        last = so_far.get(press)
        if last is not None and last.scan > number:
            for run in interrupt_open_runs(connection, press, under_way=last.run):
                log(connection, "warning", PROCESS, say("run-interrupted", run=run), press, None)


def append(
    connection: Connection,
    key: PressKey,
    scans: Sequence[Scan],
    events: Sequence[PressEvent] = (),
    begin: NewRun | None = None,
    end: RunEnd | None = None,
) -> None:
    """Write scans, then what they brought about: a run's begin, press events, a run's end.

    Writing the same scans again does no harm. A press event sets its moment in the open run.
    """
    _append_scans(connection, key, scans)
    if begin is not None:
        _begin_run(connection, key, begin, unix_of(scans[-1].utc if scans else begin.started_utc))
    for event in events:
        _append_event(connection, key, event, scans[-1].number if scans else key.next_number)
    if end is not None:
        _end_run(connection, key, end)


def _append_scans(connection: Connection, key: PressKey, scans: Sequence[Scan]) -> None:
    if not scans:
        return
    rows = [
        {
            "press_id": key.press_id,
            "number": scan.number,
            "unix_s": unix_of(scan.utc),
            "monotonic_s": scan.monotonic_s,
            "layout_id": key.layout_id,
            "readings": readings_json(scan.values),
            "faults": faults_json(key.channels, scan.qualities),
        }
        for scan in scans
    ]
    try:
        with connection.begin_nested():
            connection.execute(insert(SCAN), rows)
    except IntegrityError:
        _append_unless_there(connection, key, rows)


def _append_unless_there(connection: Connection, key: PressKey, rows: list[dict[str, Any]]) -> None:
    """Write again what a lost acknowledgement may have written already; refuse a second recorder's numbers."""
    for row in rows:
        same = select(SCAN).where(SCAN.c.press_id == key.press_id, SCAN.c.number == row["number"])
        there = connection.execute(same).mappings().first()
        if there is None:
            connection.execute(insert(SCAN), row)
        elif there["monotonic_s"] != row["monotonic_s"] or there["readings"] != row["readings"]:
            newest = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == key.press_id))
            taken = say("store-scan-taken", press=key.name, scan=row["number"])
            raise NumbersTaken(taken, key, int(newest.scalar_one()))


def _begin_run(connection: Connection, key: PressKey, new: NewRun, noticed_unix_s: float) -> None:
    """Open a run, under the next free name where its own is taken; one that is there already stays as it is."""
    same = (
        RUN.c.press_id == key.press_id,
        RUN.c.first_scan >= new.first_scan,  # later where its first scans were lost
        RUN.c.zero_monotonic_s == new.zero_monotonic_s,
    )
    if connection.execute(select(RUN.c.run).where(*same)).first():
        return
    name = _free_name(connection, new.run)
    if name != new.run:
        log(connection, "warning", PROCESS, say("run-renamed", run=new.run, name=name), key.name, None)
    for run in interrupt_open_runs(connection, key.name, before=new.first_scan):
        log(connection, "warning", PROCESS, say("run-interrupted", run=run), key.name, None)
    header = {**new.header, **take_next_panel(connection, key.name, noticed_unix_s), "run": name}
    _journal_doubts(connection, key, name, header)
    connection.execute(
        insert(RUN),
        {
            "run": name,
            "press_id": key.press_id,
            "status": RunStatus.OPEN.value,
            "started_unix_s": unix_of(new.started_utc),
            "zero_monotonic_s": new.zero_monotonic_s,
            "first_scan": new.first_scan,
            "configuration_id": _configuration(connection, new.configuration),
            **header_columns(header),
        },
    )


def _journal_doubts(connection: Connection, key: PressKey, run: str, header: Mapping[str, Any]) -> None:
    """Journal what is doubtful in the header of a run that begins, and was not in that of the run before."""
    mine = select(RUN.c.run, RUN.c.header_toml, RUN.c.remark).where(RUN.c.press_id == key.press_id)
    before: Mapping[str, Any] = {}
    with suppress(ScansUnreadable):  # the run before is damaged: this one begins all the same
        for row in rows_with_damage(connection, mine.order_by(RUN.c.run_number.desc()).limit(1)):
            before = stored_header(connection, row)
    for doubt in new_doubts(header, before):
        log(connection, "warning", PROCESS, say("of-run", run=run, what=doubt), key.name, None)


def _free_name(connection: Connection, name: str) -> str:
    """Return a run's name or, where it is taken, one that is free."""
    while has_run(connection, name):
        prefix, dash, number = name.rpartition("-")
        if not (dash and number.isdecimal()):
            prefix, number = name, "1"
        name = f"{prefix}-{_next_free(connection, prefix + '-', int(number)):02d}"
    return name


def _next_free(connection: Connection, prefix: str, number: int) -> int:
    """Return a number above `number` and above all that runs of this prefix have."""
    own = select(RUN.c.run).where(RUN.c.run.startswith(prefix, autoescape=True))
    endings = [row.run.removeprefix(prefix) for row in rows_with_damage(connection, own)]
    return max([number, *(int(ending) for ending in endings if ending.isdecimal())]) + 1


def _end_run(connection: Connection, key: PressKey, end: RunEnd) -> None:
    """Close a run, also one taken for interrupted meanwhile; an end without its run is an alarm.

    One that lacks its first or last scan is interrupted: others were lost, and reported then.
    """
    which = RUN.c.run == end.run
    if end.first_scan is not None:
        which = and_(RUN.c.press_id == key.press_id, RUN.c.first_scan.between(end.first_scan, end.last_scan))
    newest = select(RUN.c.run, RUN.c.status, RUN.c.first_scan).where(which).order_by(RUN.c.run_number.desc())
    row = connection.execute(newest).first()
    if row is None:
        log(
            connection,
            "alarm",
            PROCESS,
            say("run-end-without-run", run=end.run, scan=end.last_scan),
            key.name,
            None,
        )
        return
    if row.status == RunStatus.CLOSED.value:
        return
    ended: dict[str, Any] = {
        "status": end.status.value,
        "last_scan": end.last_scan,
        "ended_unix_s": unix_of(end.ended_utc),
    }
    ended |= changes_of_short(connection, key.press_id, row.first_scan, end.last_scan)
    connection.execute(update(RUN).where(RUN.c.run == row.run).values(**ended))


def _configuration(connection: Connection, content: str) -> int | None:
    if not content:
        return None
    content = masked(content)  # a password does not belong into every backup: the text may come from elsewhere
    found = connection.execute(
        select(CONFIGURATION.c.configuration_id).where(CONFIGURATION.c.text == content)
    ).scalar()
    if found is not None:
        return int(found)
    return inserted(connection, CONFIGURATION, text=content, created_unix_s=unix_of(datetime.now(UTC)))


def _append_event(connection: Connection, key: PressKey, event: PressEvent, number: int) -> None:
    there = select(PRESS_EVENT.c.monotonic_s).where(
        PRESS_EVENT.c.press_id == key.press_id,
        PRESS_EVENT.c.scan_number == number,
        PRESS_EVENT.c.kind == event.kind.value,
    )
    if (same := connection.execute(there).first()) is not None:
        if same.monotonic_s != event.monotonic_s:
            message = say("event-twice", kind=event.kind.value, scan=number, press=key.name)
            log(connection, "alarm", PROCESS, message, key.name, {"monotonic_s": event.monotonic_s})
        return
    before = (
        select(SCAN.c.unix_s)
        .where(
            SCAN.c.press_id == key.press_id,
            SCAN.c.number <= number,
            SCAN.c.number > number - 1000,
            SCAN.c.monotonic_s <= event.monotonic_s,
        )
        .order_by(SCAN.c.number.desc())
        .limit(1)
    )
    connection.execute(
        insert(PRESS_EVENT),
        {
            "press_id": key.press_id,
            "kind": event.kind.value,
            "unix_s": connection.execute(before).scalar(),
            "monotonic_s": event.monotonic_s,
            "noticed_monotonic_s": event.noticed_s,
            "scan_number": number,
            "source": event.source,
        },
    )
    moment = RUN.c[f"{event.kind.value}_s"]
    connection.execute(
        update(RUN)
        .where(RUN.c.press_id == key.press_id, RUN.c.status == RunStatus.OPEN.value, moment.is_(None))
        .values({moment: event.monotonic_s - RUN.c.zero_monotonic_s})
    )


def interrupt_open_runs(
    connection: Connection, press: str, before: int | None = None, under_way: int | None = None
) -> list[str]:
    """Mark runs that a crash, or an older state of the store, left open; their data stay. Returns their names.

    `before` is the first scan that is not theirs; None: all are. The run that begins with the scan `under_way`
    stays as it is.
    """
    is_open = (
        select(RUN.c.run, RUN.c.press_id, RUN.c.first_scan)
        .join(PRESS, PRESS.c.press_id == RUN.c.press_id)
        .where(PRESS.c.name == press, RUN.c.status == RunStatus.OPEN.value)
        .where(true() if under_way is None else RUN.c.first_scan != under_way)
    )
    theirs = SCAN.c.number < before if before is not None else true()
    names = []
    for run, press_id, first_scan in connection.execute(is_open).all():
        last = connection.execute(
            select(SCAN.c.number, SCAN.c.unix_s)
            .where(SCAN.c.press_id == press_id, SCAN.c.number >= first_scan, theirs)
            .order_by(SCAN.c.number.desc())
            .limit(1)
        ).first()
        connection.execute(
            update(RUN)
            .where(RUN.c.run == run)
            .values(
                status=RunStatus.INTERRUPTED.value,
                last_scan=last.number if last else first_scan,
                ended_unix_s=last.unix_s if last else None,
            )
        )
        names.append(str(run))
    return names


def unused_run_name(connection: Connection, press: str, when: datetime) -> str:
    """Return ``press-date-NN`` with the next free number of the day."""
    prefix = f"{press}-{when:%Y-%m-%d}-"
    return f"{prefix}{_next_free(connection, prefix, 0):02d}"
