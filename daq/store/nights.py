"""What the nightly job reads and leaves: its nights, and which runs of a press are new. One transaction each.

Everything is asked for by number from where the night before ended, never run by run: a night costs what is new.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    and_,
    delete,
    exists,
    func,
    insert,
    literal_column,
    or_,
    select,
)

from daq.files.parquet_columns import MICRO
from daq.store.convert import known_utc, to_json, unix_of
from daq.store.reading import newest_first, of_press_by_number, run_record_of, runs_query
from daq.store.records import Page, RunRecord, RunStatus, StoredNight
from daq.store.schema import ARCHIVE, NIGHT, PRESS, RUN, RUN_CHANGE, SCAN, UNFITTED


def put_night(connection: Connection, night: StoredNight) -> int:
    """Keep a night; the newest of a press says where the next one begins. Returns its number."""
    row = {
        "press": night.press,
        "started_unix_s": unix_of(night.started_utc),
        "ended_unix_s": unix_of(night.ended_utc),
        "night_json": to_json(night.night),
        "progress_json": to_json(night.progress),
    }
    key = connection.execute(insert(NIGHT), row).inserted_primary_key
    return int(key[0]) if key is not None else 0


def nights(
    connection: Connection, *, press: str | None = None, cursor: str | None = None, limit: int = 50
) -> Page[StoredNight]:
    """Return a page of nights, newest first."""
    rows, following = newest_first(connection, NIGHT, press, cursor, limit)
    return Page(tuple(_night(row) for row in rows), following)


def newest_nights(connection: Connection) -> dict[str, StoredNight]:
    """Return the newest night of each press."""
    newest = select(func.max(NIGHT.c.night_id)).group_by(NIGHT.c.press)
    rows = connection.execute(select(NIGHT).where(NIGHT.c.night_id.in_(newest)).order_by(NIGHT.c.press)).all()
    return {row.press: _night(row) for row in rows}


def _night(r: Row[Any]) -> StoredNight:
    began, ended = known_utc(r.started_unix_s), known_utc(r.ended_unix_s)
    return StoredNight(r.press, began, ended, json.loads(r.night_json), json.loads(r.progress_json), r.night_id)


def pressings(
    connection: Connection, press: str, *, after: int | None = None, below: int | None = None, limit: int = 200
) -> list[RunRecord]:
    """Return finished pressings: those numbered above `after`, oldest first, else the newest, newest first.

    Without those whose scans are kept no more or are in a file of the archive that is not sound.
    """
    unread = or_(ARCHIVE.c.removed_unix_s.is_not(None), ARCHIVE.c.problem != "")
    query = runs_query().where(*_finished(press), ~exists().where(ARCHIVE.c.run == RUN.c.run, unread)).limit(limit)
    if below is not None:
        query = query.where(RUN.c.run_number < below)
    if after is not None:
        query = query.where(RUN.c.run_number > after)
    rows = of_press_by_number(connection, query, press, newest_first=after is None)
    return [run_record_of(connection, row) for row in rows[:limit]]


def count_pressings(connection: Connection, press: str, *, below: int | None = None) -> int:
    """Return how many finished pressings there are, or those numbered below `below`."""
    query = select(func.count()).select_from(RUN).join(PRESS, PRESS.c.press_id == RUN.c.press_id)
    query = query.where(*_finished(press))
    if below is not None:
        query = query.where(RUN.c.run_number < below)
    return int(connection.execute(query).scalar_one())


def earlier_alike(connection: Connection, runs: Sequence[str], back: int) -> dict[str, list[str]]:
    """Return the runs that may hold the readings of these: stored before, of as many scans, begun at one instant.

    Instants are as files round them, to microseconds. Of runs whose time is not known the first scan decides
    instead, among `back` stored before each: nothing leads to others, and they are never archived.
    """
    own, other = RUN.alias("own_run"), RUN.alias("other_run")
    press, its_press = PRESS.alias("own_press"), PRESS.alias("other_press")  # recorded and imported are two
    first, its_first = SCAN.alias("own_scan"), SCAN.alias("other_scan")
    start, its_start = (func.coalesce(r.c.started_unix_s, literal_column("-1.0")) for r in (own, other))
    firsts = [s.c.press_id == r.c.press_id for s, r in ((first, own), (its_first, other))]
    firsts += [s.c.number == r.c.first_scan for s, r in ((first, own), (its_first, other))]
    known = (own.c.started_unix_s.is_not(None), its_start.between(start - 1 / MICRO, start + 1 / MICRO))
    unknown = (
        own.c.started_unix_s.is_(None),
        other.c.started_unix_s.is_(None),
        other.c.run_number >= own.c.run_number - back,
        exists().where(*firsts, first.c.readings == its_first.c.readings),
    )
    query = (
        select(own.c.run, other.c.run.label("before"))
        .join(press, press.c.press_id == own.c.press_id)
        .join(its_press, its_press.c.name == press.c.name)
        .join(other, other.c.press_id == its_press.c.press_id)
        .where(own.c.run.in_(runs), other.c.run_number < own.c.run_number)
        .where(other.c.last_scan - other.c.first_scan == own.c.last_scan - own.c.first_scan)
        .order_by(other.c.run_number)
    )
    found: dict[str, list[str]] = {}
    for alike in (known, unknown):  # each as its index goes
        for row in connection.execute(query.where(*alike)):
            found.setdefault(row.run, []).append(row.before)
    return found


def _finished(press: str) -> list[ColumnElement[bool]]:
    """Return what picks a press's runs that are over and, where they were recorded, in which it has closed."""
    pressed = or_(PRESS.c.kind == "imported", RUN.c.closed_s.is_not(None))
    return [and_(PRESS.c.name == press, RUN.c.status != RunStatus.OPEN.value), pressed]


def edited_after(connection: Connection, press: str, number: int) -> tuple[int, list[str]]:
    """Return the number of the newest edit of any run, and the press's runs edited after edit `number`."""
    newest = connection.execute(select(func.max(RUN_CHANGE.c.run_change_id))).scalar()
    edited = (
        select(RUN_CHANGE.c.run)
        .join(RUN, RUN.c.run == RUN_CHANGE.c.run)
        .join(PRESS, PRESS.c.press_id == RUN.c.press_id)
        .where(PRESS.c.name == press, RUN_CHANGE.c.run_change_id > number)
        .distinct()
    )
    return int(newest or 0), list(connection.execute(edited).scalars())


def put_unfitted(
    connection: Connection, run: str, press: str, kind: Literal["unfit", "blind", "killed"], fingerprint: str
) -> None:
    """Keep that a run has no fit, until it gets one: nothing to fit, not to be fitted, or workers killed."""
    forget_unfitted(connection, run)
    connection.execute(insert(UNFITTED), {"run": run, "press": press, "kind": kind, "fingerprint": fingerprint})


def forget_unfitted(connection: Connection, run: str) -> None:
    """Forget that a run had no fit."""
    connection.execute(delete(UNFITTED).where(UNFITTED.c.run == run))


def unfitted_marks(connection: Connection, runs: Sequence[str]) -> dict[str, str]:
    """Return with what each of these runs was tried that has no fit."""
    rows = connection.execute(select(UNFITTED.c.run, UNFITTED.c.fingerprint).where(UNFITTED.c.run.in_(runs)))
    return {row.run: row.fingerprint for row in rows}


def killed_runs(connection: Connection, press: str, limit: int = 200) -> list[str]:
    """Return runs over which workers were killed."""
    own = (UNFITTED.c.press == press, UNFITTED.c.kind == "killed")
    return list(connection.execute(select(UNFITTED.c.run).where(*own).limit(limit)).scalars())


def count_unfitted(connection: Connection, press: str) -> Mapping[str, int]:
    """Return how many runs of a press have no fit, by kind."""
    query = select(UNFITTED.c.kind, func.count()).where(UNFITTED.c.press == press).group_by(UNFITTED.c.kind)
    return {kind: int(count) for kind, count in connection.execute(query).all()}
