"""Runs that lost their first or last scans: interrupted, they hold those that are there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, exists, select, update

from daq.store.journal import log
from daq.store.records import RunStatus
from daq.store.schema import ARCHIVE, PRESS, RUN, SCAN
from daq.words import say

PROCESS = "backup"
"""Who the journal says found it out: nothing else looks for the scans of every run."""


def changes_of_short(connection: Connection, press_id: int, first: int, last: int) -> dict[str, Any]:
    """Return what changes of an ended run that lacks its first or last scan; nothing where both are there."""
    own = select(SCAN.c.number).where(SCAN.c.press_id == press_id, SCAN.c.number.between(first, last)).limit(1)
    ends = (own.order_by(SCAN.c.number), own.order_by(SCAN.c.number.desc()))
    found, until = (connection.execute(end).scalar() for end in ends)
    if (found, until) == (first, last):
        return {}
    there = {} if found is None else {"first_scan": found, "last_scan": until}
    return {"status": RunStatus.INTERRUPTED.value, **there}


def interrupt_short(connection: Connection, runs: Sequence[str]) -> int:
    """Have those of these closed runs interrupted that lack their first or last scan; return how many do."""
    in_store = (RUN.c.status == RunStatus.CLOSED.value, ~exists().where(ARCHIVE.c.run == RUN.c.run))
    query = select(RUN.c.run, RUN.c.press_id, RUN.c.first_scan, RUN.c.last_scan, PRESS.c.name)
    query = query.join(PRESS, PRESS.c.press_id == RUN.c.press_id).where(RUN.c.run.in_(runs), *in_store)
    short = 0
    for row in connection.execute(query).all():
        if changed := changes_of_short(connection, row.press_id, row.first_scan, row.last_scan):
            connection.execute(update(RUN).where(RUN.c.run == row.run).values(**changed))
            log(connection, "alarm", PROCESS, say("run-short", run=row.run), row.name)
            short += 1
    return short
