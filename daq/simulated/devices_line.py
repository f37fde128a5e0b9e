"""The wire of a simulated logger: a pseudo-terminal or a loopback socket with a server behind it.

Where there are no pseudo-terminals (Windows) a serial line is served as a socket, and `port` is a
``socket://`` URL that the drivers open in the same way.
"""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol

try:
    import pty
    import tty
except ImportError:  # Windows
    pty = tty = None  # type: ignore[assignment]

HAS_PSEUDO_TERMINALS = pty is not None
_POLL_S = 0.03
"""A thread that waits for bytes looks this often whether it shall end. [s]"""


class Station(Protocol):
    """A simulated device on a line."""

    think_s: float
    """Time between request and reply; longer where a channel changes or a scan runs. [s]"""

    def split(self, buffer: bytearray) -> bytes | None:
        """Take one complete request off the front of the buffer, or return None."""

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply, or None for silence."""


class Server:
    """A running simulated line. Leave its ``with`` block to stop it."""

    def __init__(self, place: dict[str, Any]) -> None:
        self.place = place
        """``{"port": ...}`` or ``{"host": ..., "tcp_port": ...}``: keys of LoggerSettings."""
        self._stopped = threading.Event()
        self._threads: list[threading.Thread] = []
        self._closers: list[Callable[[], None]] = []

    @property
    def port(self) -> str:
        """What a driver for serial lines opens."""
        if "port" in self.place:
            return str(self.place["port"])
        return f"socket://{self.place['host']}:{self.place['tcp_port']}"

    def start(self, work: Callable[[threading.Event], None]) -> None:
        """Run `work` in a thread until stopped."""
        thread = threading.Thread(target=work, args=(self._stopped,), daemon=True)
        self._threads.append(thread)
        thread.start()

    def on_close(self, close: Callable[[], None]) -> None:
        """Call `close` at the end."""
        self._closers.append(close)

    def close(self) -> None:
        """Stop the server and release its line."""
        self._stopped.set()
        for thread in list(self._threads):
            if thread is not threading.current_thread():
                thread.join(timeout=5)
        while self._closers:
            self._closers.pop()()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


Read = Callable[[float], bytes | None]
"""Bytes that arrived within a time; None when the other side is gone."""
Send = Callable[[bytes], None]


def serve_serial(*stations: Station) -> Server:
    """Put devices on one serial line: a pseudo-terminal, or a socket on Windows."""
    if not HAS_PSEUDO_TERMINALS:
        server = serve_tcp(*stations)
        server.place = {"port": server.port}
        return server
    master, slave = pty.openpty()
    tty.setraw(slave)
    server = Server({"port": os.ttyname(slave)})
    server.on_close(lambda: os.close(master))
    server.on_close(lambda: os.close(slave))
    read, send = file_channel(master)
    server.start(lambda stopped: converse(stations, read, send, stopped))
    return server


def serve_tcp(*stations: Station, tcp_port: int = 0) -> Server:
    """Put devices on a loopback socket; several clients may connect."""
    listener = socket.create_server(("127.0.0.1", tcp_port))
    server = Server({"host": "127.0.0.1", "tcp_port": listener.getsockname()[1]})
    server.on_close(listener.close)

    def accept(stopped: threading.Event) -> None:
        while not stopped.is_set():
            ready, _, _ = select.select([listener], [], [], _POLL_S)
            if ready:
                connection, _ = listener.accept()
                server.start(lambda stopped, c=connection: _attend(c, stations, stopped))  # type: ignore[misc]

    server.start(accept)
    return server


def _attend(connection: socket.socket, stations: tuple[Station, ...], stopped: threading.Event) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection:
        converse(stations, *socket_channel(connection), stopped)


def converse(stations: tuple[Station, ...], read: Read, send: Send, stopped: threading.Event) -> None:
    """Answer requests until the other side goes or we are stopped."""
    buffer = bytearray()
    while not stopped.is_set():
        data = read(_POLL_S)
        if data is None:
            return
        buffer += data
        while (request := stations[0].split(buffer)) is not None:
            for station in stations:
                reply = station.answer(request)
                if reply is not None and not stopped.wait(station.think_s):
                    with suppress(OSError):
                        send(reply)


def socket_channel(connection: socket.socket) -> tuple[Read, Send]:
    """Return how to read from and send to a connected socket."""

    def read(wait_s: float) -> bytes | None:
        try:
            ready, _, _ = select.select([connection], [], [], wait_s)
            return (connection.recv(4096) or None) if ready else b""
        except (OSError, ValueError):
            return None

    return read, connection.sendall


def file_channel(descriptor: int) -> tuple[Read, Send]:
    """Return how to read from and send to an open terminal."""

    def read(wait_s: float) -> bytes | None:
        try:
            ready, _, _ = select.select([descriptor], [], [], wait_s)
            return os.read(descriptor, 4096) if ready else b""
        except (OSError, ValueError):
            return None

    def send(data: bytes) -> None:
        while data:
            data = data[os.write(descriptor, data) :]

    return read, send


@contextmanager
def both(*servers: Server) -> Iterator[tuple[Server, ...]]:
    """Hold several servers open together."""
    try:
        yield servers
    finally:
        for server in servers:
            server.close()
