"""A connection watchdog: no call waits for ever on a PostgreSQL server that has stopped.

Neither ``statement_timeout`` nor ``tcp_user_timeout`` helps there: the one is kept by the server, the other
watches the network, and a stopped server's machine still confirms every packet. So a wait without any sign
from the server ends in a question: does it take another connection? A statement may take its time on a
server that does (2026-11-21).
"""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any, TypeVar

import psycopg

Result = TypeVar("Result")

# Numbers without another source were set by hand, 2026-11.

SILENT_S = 8.0
"""A server that says nothing for so long is asked whether it is there at all. [s]"""
_INTERVAL_S = 0.1
"""How often a waiting call is looked after: `psycopg.Connection.wait`'s own default. [s]"""


class WatchedConnection(psycopg.Connection[Any]):
    """A connection whose calls end with `OperationalError` once the server takes no connections any more.

    That is after `SILENT_S` and the connection timeout, 11 s together.
    """

    how: dict[str, Any]
    """Psycopg's arguments that led here."""

    @classmethod
    def to(cls, *words: Any, **options: Any) -> WatchedConnection:
        """Connect with psycopg's own arguments."""
        made = cls.connect(*words, **options)
        made.how = {"conninfo": words[0] if words else "", **options}
        return made

    def wait(self, gen: Any, interval: float = _INTERVAL_S, *words: Any, **options: Any) -> Any:
        """Wait for the server as psycopg does, but not for a silent one."""
        return super().wait(self._watched(gen), interval, *words, **options)

    def _watched(self, gen: Generator[Any, Any, Result]) -> Generator[Any, Any, Result]:
        """Hand on what `gen` waits for and what became ready; nothing ready for long raises."""
        answered_s = time.monotonic()
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                if ready:
                    answered_s = time.monotonic()
                elif time.monotonic() - answered_s > SILENT_S:
                    self._ask()
                    answered_s = time.monotonic()
                wanted = gen.send(ready)
        except StopIteration as end:
            result: Result = end.value
            return result

    def _ask(self) -> None:
        try:
            psycopg.connect(**self.how).close()
        except psycopg.OperationalError as error:
            self.pgconn.finish()
            raise psycopg.OperationalError(
                f"connection given up: the server has been silent for {SILENT_S:.0f} s and takes no other"
            ) from error
