"""Opening a store that may not be there yet."""

from __future__ import annotations

import logging
import threading

from daq.store.records import StoreUnavailable
from daq.store.store import Store, open_store

RETRY_S = 2.0


def open_when_ready(url: str, stop: threading.Event, log: logging.Logger) -> Store | None:
    """Open a store, trying again while it is away; None once `stop` is set. What keeps it away is told once."""
    said = False
    while not stop.is_set():
        try:
            return open_store(url)
        except StoreUnavailable as error:
            if not said:
                log.warning("%s; trying again", error)
                said = True
        stop.wait(RETRY_S)
    return None
