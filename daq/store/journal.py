"""The journal: alarms, losses, changes of state, who did what. Each function works in one transaction."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, Row, insert, select

from daq.store.convert import header_text, known_utc, to_json, unix_of
from daq.store.reading import newest_first, open_run, recorded_id
from daq.store.records import JournalEntry, Page
from daq.store.schema import EVENT, RUN_CHANGE, SCAN
from daq.store.write_batch import Entry, Level
from daq.words import Message, say, spoken


def log(
    connection: Connection,
    level: Level,
    process: str,
    message: Message | str,
    press: str | None = None,
    detail: Mapping[str, Any] | None = None,
) -> int:
    """Add a line of now to the journal; return its number."""
    return write_line(connection, Entry(level, process, spoken(message), press, detail))


def write_line(connection: Connection, line: Entry) -> int:
    """Add a line to the journal, at its own moment; return its number."""
    row = {
        "unix_s": unix_of(known_utc(line.unix_s)),
        "level": line.level,
        "process": line.process,
        "press": line.press,
        "message": str(line.message),
        "message_json": to_json(line.message.to_json()),
        "detail_json": None if line.detail is None else to_json(line.detail),
    }
    key = connection.execute(insert(EVENT), row).inserted_primary_key
    return int(key[0]) if key is not None else 0


def write_new(connection: Connection, lines: Sequence[Entry]) -> None:
    """Add lines but for those that are there: a lost acknowledgement, or a full disk, has them written again."""
    if not lines:
        return
    times = [unix_of(known_utc(line.unix_s)) for line in lines]
    columns = (EVENT.c.unix_s, EVENT.c.process, EVENT.c.message_json)
    there = {tuple(row) for row in connection.execute(select(*columns).where(EVENT.c.unix_s.in_(times)))}
    for unix_s, line in zip(times, lines, strict=True):
        if (unix_s, line.process, to_json(line.message.to_json())) not in there:
            write_line(connection, line)


def note(connection: Connection, press: str, text: str, who: str) -> JournalEntry:
    """Add what somebody noticed, and return its line; of an open run it is a change, too, at the newest scan."""
    run = open_run(connection, press)
    detail = None if run is None else {"run": run.run}
    number = log(connection, "info", who, say("journal-note", text=text), press, detail)
    line = _entry(connection.execute(select(EVENT).where(EVENT.c.event_id == number)).one())
    if run is None:
        return line
    own = SCAN.c.press_id == recorded_id(connection, press)
    newest = connection.execute(select(SCAN.c.monotonic_s).where(own).order_by(SCAN.c.number.desc()).limit(1))
    at_s = max((newest.scalar() or 0.0) - run.zero_monotonic_s, 0.0)
    row = {"run": run.run, "unix_s": unix_of(datetime.now(UTC)), "who": who, "field": f"note {at_s:.1f} s"}
    connection.execute(
        insert(RUN_CHANGE), {**row, "before_toml": None, "after_toml": header_text({"value": text})}
    )
    return line


def journal(
    connection: Connection,
    *,
    press: str | None = None,
    level: str | None = None,
    process: str | None = None,
    cursor: str | None = None,
    limit: int = 50,
    until: datetime | None = None,
) -> Page[JournalEntry]:
    """Return a page of the journal, newest first; with `until` of what was written before."""
    rows, following = newest_first(connection, EVENT, press, cursor, limit, until, level=level, process=process)
    return Page(tuple(_entry(r) for r in rows), following)


def journal_after(connection: Connection, after: int, limit: int = 1000) -> tuple[JournalEntry, ...]:
    """Return the journal lines that follow row `after`, oldest first."""
    query = select(EVENT).where(EVENT.c.event_id > after).order_by(EVENT.c.event_id).limit(limit)
    return tuple(_entry(r) for r in connection.execute(query).all())


def _entry(r: Row[Any]) -> JournalEntry:
    detail = None if r.detail_json is None else json.loads(r.detail_json)
    message = spoken(r.message) if r.message_json is None else Message.from_json(json.loads(r.message_json))
    return JournalEntry(r.event_id, known_utc(r.unix_s), r.level, r.process, r.press, message, detail)
