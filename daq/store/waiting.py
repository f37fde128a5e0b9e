"""The beginning and the end of a process over a store: one that may not be there yet, and what nobody foresaw."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime

from daq.address import Address
from daq.records import InputError
from daq.store.alarms import NOTED_S
from daq.store.records import StoreUnavailable
from daq.store.store import Store, open_store
from daq.supervision import unexpected
from daq.words import Message, say, spoken

RETRY_S = 2.0
"""How often a store that is away is tried. Set by hand, 2026-11. [s]"""
REPEATED_S = NOTED_S
"""A process that ends in the same way within this time of its last alarm gives none: begun again every 5 s, it
would send twelve mails a minute. Set by hand, 2026-11. [s]"""


def open_when_ready(url: str | Address, stop: threading.Event, log: logging.Logger) -> Store | None:
    """Open a store, trying again while it is away; None once `stop` is set. What keeps it away is logged once."""
    logged = False
    with ExitStack() as unless_ready:
        store = unless_ready.enter_context(open_store(url, later=True))
        while not stop.is_set():
            try:
                store.database.prepare()
            except StoreUnavailable as error:
                if not logged:
                    log.warning("%s", say("store-trying-again", why=spoken(error)))
                    logged = True
                stop.wait(RETRY_S)
            else:
                unless_ready.pop_all()
                return store
    return None


@contextmanager
def ending_reported(store: Store, process: str) -> Iterator[None]:
    """Journal an end of a process that nobody foresaw as an alarm; the service manager begins it anew.

    One that was journalled within `REPEATED_S` is not again. A reader of the output who has gone is foreseen.
    """
    try:
        yield
    except (InputError, StoreUnavailable, BrokenPipeError):
        raise
    except Exception as error:
        with suppress(Exception):  # the error itself is raised whatever the journal takes
            fault = say("process-failed", process=process, why=unexpected(error))
            if not _journalled_lately(store, process, fault):
                store.log("alarm", process, fault)
        raise


def _journalled_lately(store: Store, process: str, fault: Message) -> bool:
    """Whether a message is among the newest alarms of a process."""
    now = datetime.now(UTC)
    newest = store.journal(level="alarm", process=process).items
    return any(one.message == fault and abs((now - one.utc).total_seconds()) < REPEATED_S for one in newest)
