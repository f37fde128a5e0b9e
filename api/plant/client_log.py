"""What clients of the OPC UA server do wrong, logged sparingly: the library logs every fault with a traceback."""

from __future__ import annotations

import inspect
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from daq.words import say

LIBRARY = "asyncua"
QUIET_S = 60.0
"""A line of the same kind about the same address comes no sooner again. Set by hand, 2026-11. [s]"""
MOST_KEPT = 1000
"""Kinds and addresses remembered; beyond, the oldest is forgotten."""
MOST_LETTERS = 200
"""Of what a client has sent no more than this reaches the log."""


class ClientLog(logging.Handler):
    """Takes the library's warnings and passes one a minute on for each address and kind, in one line."""

    def __init__(self, log: logging.Logger, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(logging.WARNING)
        self._log, self._now = log, now
        self._logged_s: dict[tuple[object, ...], float] = {}
        self._left_out: dict[tuple[object, ...], int] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a record on, or count it."""
        error = record.exc_info[1] if record.exc_info else None
        address = _address_of_client()
        kind = (address, record.name, record.lineno, type(error))
        now = self._now()
        if now - self._logged_s.get(kind, -QUIET_S) < QUIET_S:
            self._left_out[kind] = self._left_out.get(kind, 0) + 1
            return
        if len(self._logged_s) >= MOST_KEPT and kind not in self._logged_s:
            oldest = min(self._logged_s, key=self._logged_s.__getitem__)
            del self._logged_s[oldest]
            self._left_out.pop(oldest, None)
        self._logged_s[kind] = now
        why = record.getMessage() + (f" ({type(error).__name__}: {error})" if error is not None else "")
        readable = "".join(letter if letter.isprintable() else " " for letter in why)[:MOST_LETTERS]
        left_out = self._left_out.pop(kind, 0)
        message = say("plant-server-fault", why=readable, left_out=left_out)
        if address:
            message = say("plant-client-fault", address=address, why=readable, left_out=left_out)
        self._log.warning("%s", message)


@contextmanager
def client_log_thinned(log: logging.Logger) -> Iterator[None]:
    """Send the library's warnings through a `ClientLog` instead of to the program's handlers."""
    library, handler = logging.getLogger(LIBRARY), ClientLog(log)
    before = library.propagate
    library.addHandler(handler)
    library.propagate = False
    try:
        yield
    finally:
        library.propagate = before
        library.removeHandler(handler)


def _address_of_client() -> str:
    """Return whose message is being worked on: the library's records do not say, its connection does."""
    frame = inspect.currentframe()
    while frame is not None:
        peer = getattr(frame.f_locals.get("self"), "peer_name", None)
        if peer:
            return str(peer[0])
        frame = frame.f_back
    return ""
