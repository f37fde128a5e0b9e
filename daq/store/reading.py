"""What everybody reads: lists of runs, the newest scans, events; one run's data are in `run_scans`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, Table, and_, case, func, literal_column, or_, select

from daq.records import Channel, InputError, Moments, Quality, Scan
from daq.store.convert import channel_qualities, known_utc, nan, utc_of
from daq.store.records import (
    Page,
    RunRecord,
    RunStatus,
    ScanBatch,
    ScansUnreadable,
    StoredPressEvent,
)
from daq.store.schema import CONFIGURATION, LAYOUT, PRESS, PRESS_EVENT, RUN, SCAN
from daq.store.sound_rows import (
    is_object,
    of_all,
    printable,
    readings_with_gaps,
    rows_with_damage,
    sound,
    stored_header,
)
from daq.store.torn_page import scan_rows
from daq.words import Message, say, spoken

# Numbers without another source were set by hand, 2026-11.

_FEW = 2000
"""Runs that an index is asked for in a millisecond, and that are walked through in one or two."""
_NEWEST = 2**62
"""Above every number of a row."""


def runs(
    connection: Connection,
    *,
    cursor: str | None = None,
    limit: int = 50,
    press: str | None = None,
    status: RunStatus | None = None,
    material: str | None = None,
    since: datetime | None = None,
    until: datetime | None = None,
) -> Page[RunRecord]:
    """Return a page of runs, newest first; `since` and `until` filter by their start.

    A run whose header is damaged stands in the list, and says so.
    """
    wanted = {RUN.c.panel_material: material, RUN.c.status: status and str(status)}
    query = runs_query().where(*(column == value for column, value in wanted.items() if value is not None))
    if cursor is not None:
        query = query.where(RUN.c.run_number < cursor_number(cursor))
    if since is not None or until is not None:
        query = query.where(*_begun_between(since, until))
    rows = _newest(connection, query.limit(limit + 1), press)[: limit + 1]
    items = tuple(run_record_of(connection, row) for row in rows[:limit])
    return Page(items, str(items[-1].number) if len(rows) > limit else None)


def _newest(connection: Connection, query: Select[Any], press: str | None) -> list[Row[Any]]:
    """Return the rows of `query`, newest first; of a press by its number, as the index goes."""
    if press is None:
        return list(rows_with_damage(connection, query.order_by(RUN.c.run_number.desc())))
    return of_press_by_number(connection, query, press)


def of_press_by_number(
    connection: Connection, query: Select[Any], press: str, *, newest_first: bool = True
) -> list[Row[Any]]:
    """Return the rows of a query for runs that are a press's, by number, as the index goes."""
    number = RUN.c.run_number.desc() if newest_first else RUN.c.run_number.asc()
    query = query.order_by(number)
    return of_press(
        connection, query, RUN.c.press_id, press, lambda row: row.run_number, newest_first=newest_first
    )


def of_press(
    connection: Connection,
    query: Select[Any],
    press_id: ColumnElement[int],
    press: str,
    by: Callable[[Row[Any]], Any],
    *,
    newest_first: bool = True,
) -> list[Row[Any]]:
    """Return the rows of a query that are a press's, in its order, which `by` gives for rows.

    What is recorded and what was imported under one name are two presses to the store: each is asked by itself,
    as indexes go, so that a limit of the query holds for each.
    """
    ids = connection.execute(select(PRESS.c.press_id).where(PRESS.c.name == press)).scalars().all()
    rows = [row for one in ids for row in rows_with_damage(connection, query.where(press_id == one))]
    return sorted(rows, key=by, reverse=newest_first)


def cursor_number(cursor: str) -> int:
    """Return the row number a cursor stands for."""
    try:
        return int(cursor)
    except ValueError as error:
        raise InputError(say("store-cursor", cursor=cursor)) from error


def runs_query() -> Select[Any]:
    """Return the query for runs with their press, to be narrowed."""
    return select(RUN, PRESS.c.name.label("press"), PRESS.c.kind).join(PRESS, PRESS.c.press_id == RUN.c.press_id)


def _begun_between(since: datetime | None, until: datetime | None) -> list[ColumnElement[bool]]:
    """Return the conditions for runs that began in a time.

    Pages go by number. Where many runs are newer than the time, or few as new, the index by start says at which
    number to begin or to end, so that nobody walks through all that lie beside it.
    """
    start = func.coalesce(RUN.c.started_unix_s, literal_column("-1.0"))  # as in the index run_by_start
    number = (RUN.c.run_number + 0).label("number")  # an expression: else an engine may walk along the numbers
    found, within = [], []
    if since is not None:
        found.append(RUN.c.started_unix_s >= since.timestamp())
        within.append(start >= since.timestamp())
    if until is not None:
        found.append(RUN.c.started_unix_s < until.timestamp())
        within.append(start < until.timestamp())
        newer = select(number).where(start >= until.timestamp()).limit(_FEW).subquery()
        many = select(func.count()).select_from(newer).scalar_subquery() == _FEW
        last = select(func.max(number)).where(*within).scalar_subquery()
        found.append(RUN.c.run_number <= select(case((many, last), else_=_NEWEST)).scalar_subquery())
    few = select(number).where(*within).limit(_FEW).subquery()
    first = select(case((func.count() < _FEW, func.min(few.c.number)), else_=0)).select_from(few)
    return [*found, RUN.c.run_number >= first.scalar_subquery()]


def run_row(connection: Connection, run: str) -> Row[Any]:
    """Return a run's row with its press; raises `InputError` where there is none."""
    rows = rows_with_damage(connection, runs_query().where(RUN.c.run == run))
    if not rows:
        raise InputError(say("store-run-missing", run=run))
    return rows[0]


def has_run(connection: Connection, run: str) -> bool:
    """Whether a run is stored, readable or not."""
    return connection.execute(select(RUN.c.run_number).where(RUN.c.run == run)).first() is not None


def run_record(connection: Connection, run: str) -> RunRecord:
    """Return one run's record; raises `InputError` where there is none, `ScansUnreadable` where it is damaged."""
    record = run_record_of(connection, run_row(connection, run))
    if record.damage is not None:
        raise ScansUnreadable(record.damage)
    return record


def run_records(connection: Connection, runs: Sequence[str]) -> dict[str, RunRecord]:
    """Return the records of these runs by name, all in one query; a damaged one says so."""
    rows = rows_with_damage(connection, runs_query().where(RUN.c.run.in_(runs)))
    return {row.run: run_record_of(connection, row) for row in rows}


def damaged_runs(connection: Connection, limit: int = 50) -> list[RunRecord]:
    """Return those of the newest runs, as many as a page has, whose header cannot be read any more."""
    rows = rows_with_damage(connection, runs_query().order_by(RUN.c.run_number.desc()).limit(limit))
    return [record for record in (run_record_of(connection, row) for row in rows) if record.damage is not None]


def open_run(connection: Connection, press: str) -> RunRecord | None:
    """Return the run being recorded, or None."""
    query = (
        runs_query()
        .where(RUN.c.status == RunStatus.OPEN.value, PRESS.c.name == press)
        .order_by(RUN.c.run_number.desc())
        .limit(1)
    )
    rows = rows_with_damage(connection, query)
    return run_record_of(connection, rows[0]) if rows else None


def ended_runs_after(connection: Connection, press: str, number: int, limit: int = 1000) -> list[RunRecord]:
    """Return the recorded runs that are over and end after scan `number`, oldest first."""
    press_id = recorded_id(connection, press)
    own = RUN.c.press_id == press_id
    begun = select(func.coalesce(func.max(RUN.c.first_scan), 0)).where(own, RUN.c.first_scan <= number)
    query = (
        runs_query()
        .where(own, RUN.c.first_scan >= begun.scalar_subquery(), RUN.c.last_scan > number)
        .order_by(RUN.c.first_scan)
        .limit(limit)
    )
    return [run_record_of(connection, row) for row in rows_with_damage(connection, query)]


def run_record_of(connection: Connection, row: Row[Any]) -> RunRecord:
    """Return the record of a row of `runs_query`."""
    header, remark, damage = _header_and_damage(connection, row)
    return RunRecord(
        number=row.run_number,
        run=printable(row.run),
        press=row.press,
        kind=row.kind,
        status=RunStatus(row.status),
        started_utc=utc_of(row.started_unix_s),
        ended_utc=utc_of(row.ended_unix_s),
        first_scan=row.first_scan,
        last_scan=row.last_scan,
        zero_monotonic_s=row.zero_monotonic_s,
        moments=Moments(nan(row.inserted_s), nan(row.closed_s), nan(row.opened_s), nan(row.removed_s)),
        header=header,
        remark=remark,
        software_version=row.software_version,
        damage=damage,
    )


def _header_and_damage(connection: Connection, row: Row[Any]) -> tuple[dict[str, Any], str, Message | None]:
    """Return header and remark of a run, or empty ones and why they cannot be read."""
    try:
        return stored_header(connection, row), row.remark, None
    except ScansUnreadable as error:
        return {}, "", spoken(error)


def first_layout(connection: Connection, press_id: int) -> int:
    """Return the layout a press was registered with last."""
    newest = select(func.max(LAYOUT.c.layout_id)).where(LAYOUT.c.press_id == press_id)
    return int(connection.execute(newest).scalar_one())


def layout_channels(connection: Connection, layout_id: int) -> tuple[Channel, ...]:
    """Return the channels of a layout in the order of a scan's readings."""
    columns = connection.execute(select(LAYOUT.c.columns_json).where(LAYOUT.c.layout_id == layout_id)).scalar_one()
    with sound(connection, of_all):
        return tuple(Channel(name, unit) for name, unit in json.loads(columns))


def recorded_id(connection: Connection, press: str) -> int | None:
    """Return the row number of a press that is recorded here, or None."""
    found = connection.execute(
        select(PRESS.c.press_id).where(PRESS.c.name == press, PRESS.c.kind == "recorded")
    ).scalar()
    return None if found is None else int(found)


def channels(connection: Connection, press: str) -> tuple[Channel, ...]:
    """Return the channels a press is recorded with now; empty where it never was."""
    press_id = recorded_id(connection, press)
    if press_id is None:
        return ()
    newest = select(SCAN.c.layout_id).where(SCAN.c.press_id == press_id).order_by(SCAN.c.number.desc()).limit(1)
    layout = connection.execute(newest).scalar()
    return layout_channels(connection, first_layout(connection, press_id) if layout is None else layout)


def newest_number(connection: Connection, press: str) -> int:
    """Return the number of the newest scan, -1 where there is none."""
    press_id = recorded_id(connection, press)
    number = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == press_id)).scalar()
    return -1 if number is None else int(number)


def first_number_from(connection: Connection, press_id: int, unix_s: float) -> int:
    """Return a number below which all scans are older than an instant, by halving: no index goes by time."""
    own = SCAN.c.press_id == press_id
    newest = connection.execute(select(func.max(SCAN.c.number)).where(own)).scalar()
    low, high = 0, -1 if newest is None else int(newest) + 1  # from 0 on: the oldest may be archived
    while low < high:
        middle = (low + high) // 2
        query = select(SCAN.c.number, SCAN.c.unix_s).where(own, SCAN.c.number >= middle)
        number, at = connection.execute(query.order_by(SCAN.c.number).limit(1)).one()
        low, high = (number + 1, high) if at < unix_s else (low, middle)
    return int(low)


def scans_after(connection: Connection, press: str, last_number: int, limit: int = 1000) -> ScanBatch:
    """Return the scans, all of one layout, that follow `last_number`: start with -1, go on with the last one's.

    A scan that cannot be read any more has no value, and those on a page that is torn are passed over: who follows
    a press must not stop at them. Raises `StoreUnavailable` where the newest lie on such a page.
    """
    press_id = recorded_id(connection, press)
    if press_id is None:
        return ScanBatch((), ())
    rows, passed_over = scan_rows(connection, press, press_id, last_number, limit)
    if not rows:
        return ScanBatch((), ())
    same = [row for row in rows if row.layout_id == rows[0].layout_id]
    named = layout_channels(connection, rows[0].layout_id)
    table, damaged = readings_with_gaps([row.readings for row in same], len(named))
    damaged += [i for i, row in enumerate(same) if row.faults is not None and not is_object(row.faults)]
    bad = (Quality.BAD_FRAME,) * len(named)
    scans = tuple(
        Scan(
            row.number,
            known_utc(row.unix_s),
            row.monotonic_s,
            tuple(table[i].tolist()),
            bad if i in damaged else channel_qualities(named, row.faults),
        )
        for i, row in enumerate(same)
    )
    return ScanBatch(named, scans, (*passed_over, *sorted(same[i].number for i in damaged)))


def press_events(
    connection: Connection,
    press: str | None = None,
    after: int = 0,
    limit: int = 1000,
    since_scan: int | None = None,
) -> list[StoredPressEvent]:
    """Return press events after row `after`, oldest first."""
    query = (
        select(PRESS_EVENT, PRESS.c.name.label("press"))
        .join(PRESS, PRESS.c.press_id == PRESS_EVENT.c.press_id)
        .where(PRESS_EVENT.c.press_event_id > after)
        .order_by(PRESS_EVENT.c.press_event_id)
        .limit(limit)
    )
    if press is not None:
        query = query.where(PRESS.c.name == press)
    if since_scan is not None:
        query = query.where(PRESS_EVENT.c.scan_number >= since_scan)
    return [_press_event(r) for r in connection.execute(query).all()]


def press_journal(
    connection: Connection, press: str | None = None, cursor: str | None = None, limit: int = 50
) -> Page[tuple[StoredPressEvent, str | None]]:
    """Return a page of press events, newest first, each with the run it belongs to."""
    number = PRESS_EVENT.c.press_event_id
    begun = (RUN.c.press_id == PRESS_EVENT.c.press_id, RUN.c.first_scan <= PRESS_EVENT.c.scan_number)
    newest = select(RUN.c.run).where(*begun).order_by(RUN.c.first_scan.desc()).limit(1).scalar_subquery()
    owner = RUN.alias()
    within = or_(owner.c.last_scan.is_(None), owner.c.last_scan >= PRESS_EVENT.c.scan_number)
    query = select(PRESS_EVENT, PRESS.c.name.label("press"), owner.c.run.label("run"))
    query = query.join(PRESS, PRESS.c.press_id == PRESS_EVENT.c.press_id)
    query = query.outerjoin(owner, and_(owner.c.run == newest, within)).order_by(number.desc()).limit(limit + 1)
    if cursor is not None:
        query = query.where(number < cursor_number(cursor))
    if press is None:
        rows = list(connection.execute(query).all())
    else:
        rows = of_press(connection, query, PRESS_EVENT.c.press_id, press, lambda row: row.press_event_id)
        rows = rows[: limit + 1]
    following = str(rows[limit - 1].press_event_id) if len(rows) > limit else None
    return Page(tuple((_press_event(r), r.run) for r in rows[:limit]), following)


def _press_event(r: Row[Any]) -> StoredPressEvent:
    return StoredPressEvent(
        r.press_event_id,
        r.press,
        r.kind,
        utc_of(r.unix_s),
        r.monotonic_s,
        r.noticed_monotonic_s,
        r.scan_number,
        r.source,
    )


def presses(connection: Connection) -> dict[str, str]:
    """Return the press file text of each press by name."""
    rows = connection.execute(
        select(PRESS.c.name, PRESS.c.press_file).order_by(PRESS.c.kind, PRESS.c.press_id.desc())
    ).all()
    return {row.name: row.press_file for row in reversed(rows)}


def configuration_of(connection: Connection, run: str) -> str:
    """Return the settings text a run was recorded with; empty where none was kept."""
    query = (
        select(CONFIGURATION.c.text)
        .join(RUN, RUN.c.configuration_id == CONFIGURATION.c.configuration_id)
        .where(RUN.c.run == run)
    )
    return str(connection.execute(query).scalar() or "")


def newest_first(
    connection: Connection,
    table: Table,
    press: str | None,
    cursor: str | None,
    limit: int,
    until: datetime | None = None,
    **only: str | None,
) -> tuple[list[Row[Any]], str | None]:
    """Return a page of a table's rows, newest first, and the next cursor; `only` chooses by other columns.

    With `until` those written before that time.
    """
    (column,) = table.primary_key
    query = select(table, column.label("row_number")).order_by(column.desc()).limit(limit + 1)
    for name, wanted in {"press": press, **only}.items():
        if wanted is not None:
            query = query.where(table.c[name] == wanted)
    if cursor is not None:
        query = query.where(column < cursor_number(cursor))
    if until is not None:
        written = table.c.unix_s if "unix_s" in table.c else table.c.created_unix_s
        query = query.where(written < until.timestamp())
    rows = list(connection.execute(query).all())
    return rows[:limit], str(rows[limit - 1].row_number) if len(rows) > limit else None
