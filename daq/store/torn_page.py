"""Scans beside a page that the disk has torn: SQLite stops at it, who follows a press must not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, Row, Select, func, select
from sqlalchemy.exc import DBAPIError

from daq.store.records import StoreUnavailable
from daq.store.schema import SCAN
from daq.store.sound_rows import is_torn, store_label
from daq.words import say


def scan_rows(
    connection: Connection, press: str, press_id: int, after: int, limit: int
) -> tuple[Sequence[Row[Any]], list[int]]:
    """Return the scans after a number up to a torn page, or where that comes first those behind it, and its first.

    Raises
    ------
    StoreUnavailable
        Where the newest scans lie on such a page. A server's torn page is an error of the engine's.
    """
    own = select(SCAN).where(SCAN.c.press_id == press_id).order_by(SCAN.c.number)
    try:
        return connection.execute(own.where(SCAN.c.number > after).limit(limit)).all(), []
    except DBAPIError as error:
        if connection.dialect.name != "sqlite" or not is_torn(error):
            raise
    rows: list[Row[Any]] = []
    while len(rows) < limit and (row := _sound(connection, own, rows[-1].number + 1 if rows else after + 1)):
        rows.append(row)
    if rows:
        return rows, []
    behind = _behind(connection, own, after + 1, press_id)
    if behind is None:
        damage = say("store-scan-damaged", scan=after + 1, store=store_label(connection.engine.url))
        raise StoreUnavailable(say("of-press", press=press, what=damage))
    return scan_rows(connection, press, press_id, behind - 1, limit)[0], [after + 1]


def _behind(connection: Connection, own: Select[Any], torn: int, press_id: int) -> int | None:
    """Return a number from which on scans can be read again, None where there is none."""
    try:
        newest = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == press_id)).scalar()
    except DBAPIError as error:
        if not is_torn(error):
            raise
        return None
    low, high = torn, int(newest or 0)
    if _sound(connection, own, high) is None:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _sound(connection, own, middle) is not None else (middle, high)
    return high


def _sound(connection: Connection, own: Select[Any], number: int) -> Row[Any] | None:
    """Return the first scan from a number on; None where it lies on a torn page, or there is none."""
    try:
        return connection.execute(own.where(SCAN.c.number >= number).limit(1)).first()
    except DBAPIError as error:
        if not is_torn(error):
            raise
        return None
