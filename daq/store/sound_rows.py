"""What rows of the store say, and one error for those that cannot be read any more.

A text that is no JSON any more, a value too few, a page that the disk has torn: each is `ScansUnreadable`, with
the run, the scan where one is known, the store and what to do.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError

from daq.records import Array, InputError
from daq.store.convert import header_of, readings_table
from daq.store.records import RunStatus, ScansUnreadable
from daq.words import Message, say

Whose = Callable[..., Message]
"""Puts the run or the press before a message."""

_TORN = ("XX001", "XX002")
"""What a PostgreSQL server answers where a page of a table or an index is damaged (its manual, appendix A)."""


def of_run(run: str) -> Whose:
    """Return what says whose rows they are."""
    return partial(say, "of-run", run=run)


def of_all(what: Message) -> Message:
    """Say of no run in particular."""
    return what


def store_label(url: URL) -> str:
    """Return a store's path or URL without its password, for messages."""
    if url.get_backend_name() == "sqlite" and url.database:
        return url.database
    return url.set(query={}).render_as_string(hide_password=True)


def readings_of(connection: Connection, whose: Whose, rows: Sequence[tuple[int, str]], width: int) -> Array:
    """Return the values of scans, number and text of each; raises `ScansUnreadable` where one cannot be read."""
    table, unreadable = readings_with_gaps([text for _, text in rows], width)
    if unreadable:
        raise _damaged(connection, whose, rows[unreadable[0]][0])
    return table


def readings_with_gaps(texts: Sequence[str], width: int) -> tuple[Array, list[int]]:
    """Return the values of scans, NaN in those that cannot be read, and which these are."""
    try:
        return readings_table(texts, width), []
    except (ValueError, TypeError, RecursionError):
        table, unreadable = np.full((len(texts), width), np.nan), []
    for i, text in enumerate(texts):
        try:
            table[i] = readings_table([text], width)
        except (ValueError, TypeError, RecursionError):
            unreadable.append(i)
    return table, unreadable


def sound_texts(connection: Connection, whose: Whose, numbers: Sequence[int], texts: Sequence[str | None]) -> None:
    """See that what stands beside scans is JSON objects; raises `ScansUnreadable` where one is not."""
    unsound = {text for text in set(texts) if text is not None and not is_object(text)}
    if unsound:
        raise _damaged(connection, whose, next(n for n, t in zip(numbers, texts, strict=True) if t in unsound))


def sound_ends(connection: Connection, whose: Whose, row: Row[Any], numbers: Sequence[int]) -> None:
    """See that the first and last scan of an ended run are there; raises `ScansUnreadable` where one is not.

    Between them a scan may lack that the store would not take, of which an alarm was given. Of an interrupted run
    nobody knows the last one.
    """
    if row.status != RunStatus.CLOSED.value or row.last_scan < row.first_scan:
        return
    if not numbers or (numbers[0], numbers[-1]) != (row.first_scan, row.last_scan):
        raise ScansUnreadable(whose(what=say("store-scans-missing", store=store_label(connection.engine.url))))


def is_object(text: str) -> bool:
    """Whether a text is a JSON object."""
    try:
        return isinstance(json.loads(text), dict)
    except (ValueError, TypeError, RecursionError):
        return False


def stored_header(connection: Connection, row: Row[Any]) -> dict[str, Any]:
    """Return the header of a run's row; raises `ScansUnreadable` where it or the remark cannot be read."""
    header = sound_header(row.header_toml, row.remark)
    if header is None:
        damage = say("store-header-damaged", store=store_label(connection.engine.url))
        raise ScansUnreadable(of_run(printable(row.run))(what=damage))
    return header


def sound_header(text: str, beside: str) -> dict[str, Any] | None:
    """Return header keys, None where they or the text beside them cannot be read."""
    try:
        return header_of(text) if is_sound(text) and is_sound(beside) else None
    except (TypeError, ValueError, AttributeError, RecursionError):
        return None


def is_sound(text: str) -> bool:
    """Whether no byte of a text was one that no writer writes (`rows_with_damage` keeps it as a surrogate)."""
    return text.isascii() or not any("\udc80" <= letter <= "\udcff" for letter in text)


def printable(text: str) -> str:
    """Return a text as it can be shown and sent, with a mark for each byte that no writer writes."""
    return text.encode(errors="surrogateescape").decode(errors="replace")


def rows_with_damage(connection: Connection, query: Select[Any]) -> Sequence[Row[Any]]:
    """Return the rows of a query, also where a text in one has bytes that are no UTF-8: these are surrogates."""
    try:
        return connection.execute(query).all()
    except DBAPIError as error:
        raw = connection.connection.dbapi_connection
        if not _undecodable(error) or not isinstance(raw, sqlite3.Connection):
            raise
    usual, raw.text_factory = raw.text_factory, lambda text: text.decode(errors="surrogateescape")
    try:
        return connection.execute(query).all()
    finally:
        raw.text_factory = usual


@contextmanager
def sound(connection: Connection, whose: Whose) -> Iterator[None]:
    """Turn what damage to the store's own file, or to numbers in it, raises into `ScansUnreadable`."""
    try:
        yield
    except InputError:
        raise
    except DBAPIError as error:
        if not is_torn(error):
            raise
        raise _all_damaged(connection, whose) from error
    except (TypeError, ValueError) as error:
        raise _all_damaged(connection, whose) from error


def is_torn(error: DBAPIError) -> bool:
    """Whether an engine found what it keeps damaged, and not just out of reach."""
    reason = error.orig
    if isinstance(reason, sqlite3.Error):
        code = getattr(reason, "sqlite_errorcode", None)
        return (code is not None and code & 0xFF == sqlite3.SQLITE_CORRUPT) or _undecodable(error)
    return getattr(reason, "sqlstate", None) in _TORN


def _undecodable(error: DBAPIError) -> bool:
    return "decode to UTF-8" in str(error.orig)


def _damaged(connection: Connection, whose: Whose, scan: int) -> ScansUnreadable:
    damage = say("store-scan-damaged", scan=scan, store=store_label(connection.engine.url))
    return ScansUnreadable(whose(what=damage))


def _all_damaged(connection: Connection, whose: Whose) -> ScansUnreadable:
    return ScansUnreadable(whose(what=say("store-scans-damaged", store=store_label(connection.engine.url))))
