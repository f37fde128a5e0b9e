"""The beginning and the end of a process over a store: one that may not be there yet, and what nobody foresaw."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

from daq.address import Address
from daq.records import InputError
from daq.store.records import StoreUnavailable
from daq.store.store import Store, open_store
from daq.supervision import unexpected
from daq.words import say, spoken

RETRY_S = 2.0
"""How often a store that is away is tried. Set by hand, 2026-11. [s]"""


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
    """Journal an end of a process that nobody foresaw as an alarm; the service manager begins it anew."""
    try:
        yield
    except (InputError, StoreUnavailable):
        raise
    except Exception as error:
        with suppress(Exception):  # the error itself is raised whatever the journal takes
            store.log("alarm", process, say("process-failed", process=process, why=unexpected(error)))
        raise
