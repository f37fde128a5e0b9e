"""One nightly job a press: what two would do at once, both would do, each without what the other has found.

A lock of the operating system beside a store's file, or of the server's session, so that it ends with its process.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from urllib.parse import quote

from sqlalchemy import Connection, text

from daq.store.database import Database
from daq.store.process_lock import only_user, wait_for
from daq.words import say

_NIGHT = 7305161
"""Tells the server's locks of nights from those of others; the second number is the press's."""


@contextmanager
def only_night(database: Database, press: str) -> Iterator[None]:
    """Hold a press's nights against other jobs.

    Raises
    ------
    InputError
        Where another nightly job works on the press, after `process_lock.WAIT_S`.
    StoreUnavailable
        Where the server is away.
    """
    complaint = say("night-at-work-already", press=press, store=database.label)
    if database.path is not None:
        path = database.path.resolve()
        with only_user({path.with_name(f"{path.name}.night-{quote(press, safe='')}"): complaint}):
            yield
        return
    with database.translated():
        session = database.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        session.detach()  # closed with the block, and the lock with it
    with session:
        with database.translated():
            wait_for(partial(_lock, session, press), complaint)
        yield


def _lock(session: Connection, press: str) -> None:
    ask = text("SELECT pg_try_advisory_lock(:night, hashtext(:press))")
    if not session.execute(ask, {"night": _NIGHT, "press": press}).scalar():
        raise BlockingIOError
