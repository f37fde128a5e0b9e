"""`kerntemp serve`: the web server, safe by default."""

from __future__ import annotations

import gc
import logging
import math
import socket
import ssl
import sys
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import uvicorn

from api.http.app import create_app
from api.http.binding import UNREAD_S, take_port
from api.http.gate import is_loopback
from api.http.tokens import ATTEMPT_WINDOW_S, TokenFile
from daq.process.config import PORT
from daq.process.notify import Notifier
from daq.records import InputError
from daq.store.store import Store
from daq.tables import reason_of
from daq.words import Message, say

GRACE_S = 3
"""Requests still running at the end get this long. [s]"""
IDLE_S = 20.0
"""A connection that asks nothing, or only begins to ask, is closed after this time. [s]"""
MAX_CONNECTIONS = 2000
"""Ten times the listeners (`api.http.live.MAX_LISTENERS`), and a quarter of `FILES`."""
FILES = 8192
"""Open files to ask the system for: connections, more that are being refused, and the store's own."""


ALIVE_TICKS = 50
"""The server looks up ten times a second; at every so many-th time it gives a sign of life."""


@dataclass(frozen=True)
class Listening:
    """Where and how to listen."""

    host: str = "127.0.0.1"
    port: int = PORT
    certificate: Path | None = None
    """TLS certificate chain, PEM."""
    key: Path | None = None
    idle_s: float = IDLE_S
    unread_s: float = UNREAD_S

    def check(self, tokens: TokenFile) -> None:
        """Refuse what would not be safe or cannot work. Raises `InputError`."""
        if not is_loopback(self.host) and not tokens.tokens():
            raise InputError(say("api-tokens-needed", host=self.host))
        if (self.certificate is None) != (self.key is None):
            raise InputError(say("api-certificate-needs-key"))
        for path in (self.certificate, self.key):
            if path is not None and not path.is_file():
                raise InputError(say("api-certificate-missing", path=str(path)))
        if self.certificate is not None and self.key is not None:
            try:
                ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(
                    self.certificate, self.key, password=lambda: ""
                )
            except (ssl.SSLError, OSError) as error:
                given = {"certificate": str(self.certificate), "key": str(self.key)}
                raise InputError(say("api-certificate-unusable", why=reason_of(error), **given)) from error

    def bind(self) -> socket.socket:
        """Take the port now, so that a taken one is reported in one line. Raises `InputError`."""
        return take_port(self.host, self.port, self.unread_s)


@dataclass
class ConnectionWatchdog:
    """Closes connections that ask nothing for too long, or at once the oldest of them where there are too many."""

    idle_s: float = IDLE_S
    most: int = MAX_CONNECTIONS
    now: Callable[[], float] = time.monotonic
    _waiting: dict[Any, tuple[object, float]] = field(default_factory=dict)

    def look(self, connections: Collection[Any]) -> None:
        """Look at the server's connections, about once a second."""
        waiting = {}
        for connection in connections:
            request = connection.cycle
            if request is not None and not request.response_complete:
                continue
            before, since = self._waiting.get(connection, (request, self.now()))
            if before is not request:
                since = self.now()
            waiting[connection] = (request, since)
        self._waiting = waiting
        too_many = len(connections) - self.most
        for place, connection in enumerate(sorted(waiting, key=lambda c: waiting[c][1])):
            if place < too_many or self.now() - waiting[connection][1] > self.idle_s:
                connection.transport.abort()


class _Server(uvicorn.Server):
    """Lets idle connections go, and ends the live streams before it waits for requests to finish."""

    def __init__(
        self, config: uvicorn.Config, watchdog: ConnectionWatchdog, stalled: Callable[[], Message | None]
    ) -> None:
        super().__init__(config)
        self._watchdog, self._stalled = watchdog, stalled
        self._notifier = Notifier()

    async def on_tick(self, counter: int) -> bool:
        """Look after connections once a second, one call of ten, and give the service manager a sign of life."""
        if counter % 10 == 0:
            self._watchdog.look(list(self.server_state.connections))
        if counter % ALIVE_TICKS == 0:
            self._give_sign_of_life()
        return await super().on_tick(counter)

    def _give_sign_of_life(self) -> None:
        """Feed the watchdog, unless what works beside the server stands still, or nobody gets live events."""
        beside, live = self._stalled(), self.config.app.state.hub.stalled()  # type: ignore[union-attr]
        if why := beside or live:  # both were asked: each reports what it finds
            self._notifier.status(str(why))
        else:
            self._notifier.alive(f"{len(self.server_state.connections)} connections")

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Inform the service manager once connections are taken."""
        await super().startup(sockets)
        self._notifier.ready("serving")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the live streams, then wait for requests."""
        self._notifier.stopping()
        self.config.app.state.hub.close()  # type: ignore[union-attr]
        await super().shutdown(sockets)


class SparingLog(logging.Filter):
    """Lets a library's warning about what clients do through once a minute, with how many there were before it."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now = now
        self._logged_s: dict[tuple[str, int], float] = {}
        self._left_out: Counter[tuple[str, int]] = Counter()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log it; faults of our own are logged each time."""
        if record.levelno != logging.WARNING:
            return True
        kind = record.name, record.lineno
        if self._now() - self._logged_s.get(kind, -math.inf) < ATTEMPT_WINDOW_S:
            self._left_out[kind] += 1
            return False
        self._logged_s[kind] = self._now()
        if left_out := self._left_out.pop(kind, 0):
            record.msg, record.args = f"{record.getMessage()} (+{left_out})", ()
        return True


@contextmanager
def sparing_log() -> Iterator[None]:
    """Thin what the libraries log of requests that are none and of connections that are gone."""
    sparing = SparingLog()
    loggers = [logging.getLogger(name) for name in ("uvicorn.error", "asyncio")]
    for logger in loggers:
        logger.addFilter(sparing)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(sparing)


def allow_many_files() -> None:
    """Raise the process's limit of open files, which is 1024 by default on most systems."""
    if sys.platform == "win32":
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = FILES if hard == resource.RLIM_INFINITY else min(FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < enough:
        resource.setrlimit(resource.RLIMIT_NOFILE, (enough, hard))


def settle_memory() -> None:
    """Take what the program is made of out of the garbage collector's passes: one over all of it costs 50 ms."""
    gc.collect()
    gc.freeze()


def address_of(bound: socket.socket, *, tls: bool) -> str:
    """Return the address a person can open."""
    host, port = bound.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if tls else 'http'}://{shown}:{port}/"


def make_server(
    store: Store,
    tokens: TokenFile,
    listening: Listening,
    resins: Mapping[str, Path] = MappingProxyType({}),
    headers: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    stalled: Callable[[], Message | None] = lambda: None,
) -> uvicorn.Server:
    """Return a server over `store`; its ``run`` takes the sockets that `Listening.bind` made.

    `resins`, `headers`: by press, as of `create_app`. `stalled`: why the process must not count as alive, or None.
    """
    config = uvicorn.Config(
        create_app(store, tokens, resins=resins, headers=headers),
        host=listening.host,
        port=listening.port,
        log_level="warning",
        access_log=False,
        server_header=False,
        http="h11",
        timeout_graceful_shutdown=GRACE_S,
        timeout_keep_alive=20,
        limit_concurrency=MAX_CONNECTIONS,
        h11_max_incomplete_event_size=32 * 1024,
        ssl_certfile=str(listening.certificate) if listening.certificate else None,
        ssl_keyfile=str(listening.key) if listening.key else None,
    )
    return _Server(config, ConnectionWatchdog(listening.idle_s), stalled)


def run_server(server: uvicorn.Server, bound: socket.socket) -> None:
    """Serve until interrupted or terminated."""
    logging.getLogger("uvicorn.access").disabled = True
    allow_many_files()
    settle_memory()
    with sparing_log():
        server.run(sockets=[bound])
