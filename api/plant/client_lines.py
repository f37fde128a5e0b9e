"""Connections of OPC UA clients, held to so much memory: the library takes what a client sends before it looks.

Each line hands the library whole chunks, and reads on once it has worked them off. What a line may hold is two
chunks, one read of the socket, one message in pieces, and answers to the chunks its client does not fetch. There
are only so many lines: one too many takes the place of the oldest that no session has been activated on.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from typing import Any

from asyncua import Server
from asyncua.common.connection import TransportLimits
from asyncua.server.binary_server_asyncio import OPCUAProtocol

from api.plant.client_log import LIBRARY

LOG = logging.getLogger(f"{LIBRARY}.lines")
CHUNK_BYTES = 65535
"""Largest chunk of a message; the library's default."""
HEADER_BYTES = 8
"""Of a chunk: kind, place and size (OPC UA part 6, 7.1.2.2)."""
KINDS = frozenset({b"HEL", b"ACK", b"ERR", b"OPN", b"CLO", b"MSG"})
"""Of chunks (OPC UA part 6, 7.1.2.2 and 6.7.2)."""
MESSAGE_CHUNKS = 4
"""Most chunks of a message: to read 1,200 values by names of 200 bytes, as thirty presses have, takes them all."""
MOST_CLIENTS = 50
"""Lines at a time, as screens in a hall: some tens. Each takes some 0.6 MB at most, all of them 30 MB."""
MOST_CHUNKS_AHEAD = 100
"""Chunks handed over and not worked off yet, small ones: of 500 the library's default ends the line."""
MOST_CHUNKS_BEFORE = 100
"""Chunks without a session: greeting, channel, endpoints, session and user take five, in pieces twenty."""
LOOK_S = 0.005
"""How often it is looked whether the library has worked them off: short beside the time of an answer. [s]"""


def limits() -> TransportLimits:
    """Return the limits that the server agrees on with its clients."""
    return TransportLimits(CHUNK_BYTES, CHUNK_BYTES, MESSAGE_CHUNKS, MESSAGE_CHUNKS * CHUNK_BYTES)


async def listen(server: Server, host: str, port: int) -> asyncio.Server:
    """Listen in the place of a server's own listener, with bounded lines. Raises `OSError` where it cannot.

    The server must have been started at another place, which is given up.
    """
    library = server.bserver
    if library is None or library._server is None:  # noqa: SLF001
        raise AssertionError("the server has not been started")
    library._server.close()  # noqa: SLF001
    lines: set[ClientLine] = set()
    make = library._make_protocol  # noqa: SLF001
    return await asyncio.get_running_loop().create_server(lambda: ClientLine(make(), lines), host, port)


class ClientLine(asyncio.Protocol):
    """One client's connection before the library's own part of it."""

    def __init__(self, library: OPCUAProtocol, lines: set[ClientLine]) -> None:
        self.peer_name: Any = None
        """Whose line it is, where the client log looks for it."""
        self._library, self._lines = library, lines
        self._transport: asyncio.Transport | None = None
        self._received = bytearray()
        self._handed_over: deque[int] = deque(maxlen=MOST_CHUNKS_AHEAD)
        """Sizes of the last chunks."""
        self._before = 0
        """Chunks handed over without a session."""
        self._unfetched = False
        """Whether the client leaves answers lying."""
        self._looking: asyncio.TimerHandle | None = None
        self.since_s = 0.0
        """When the client came, on the loop's clock. [s]"""

    @property
    def active(self) -> bool:
        """Whether a client has shown here who it is."""
        session = self._library.processor.session if self._library.processor is not None else None
        return session is not None and bool(session.is_activated())

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a client in, or send it away where all lines are in use."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("no line of bytes")
        self.peer_name = transport.get_extra_info("peername")
        self.since_s = asyncio.get_running_loop().time()
        if len(self._lines) >= MOST_CLIENTS:
            idle = [line for line in self._lines if not line.active]
            if not idle:
                LOG.warning("%d clients are there: none more is taken", MOST_CLIENTS)
                transport.abort()
                return
            oldest = min(idle, key=lambda line: line.since_s)
            LOG.warning("%d clients are there: the oldest without a session is let go", MOST_CLIENTS)
            oldest.end()
        self._transport = transport
        self._lines.add(self)
        self._library.connection_made(transport)

    def end(self) -> None:
        """End the line at once, whatever waits in it."""
        self._lines.discard(self)
        self._received.clear()
        if self._transport is not None:
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the client."""
        self._lines.discard(self)
        self._received.clear()
        if self._looking is not None:
            self._looking.cancel()
        if self._transport is not None:
            self._library.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Hand whole chunks over, as many as the library is ready for."""
        if self._transport is not None and not self._transport.is_closing():
            self._received += data
            self._hand_over()

    def pause_writing(self) -> None:
        """Take nothing more of a client that leaves its answers lying."""
        self._unfetched = True
        self._wait()

    def resume_writing(self) -> None:
        """Go on with a client that has fetched its answers."""
        self._unfetched = False

    @property
    def _busy(self) -> bool:
        """Whether as much was handed over as one chunk may hold and is not worked off yet."""
        waiting = self._library.messages.qsize()
        newest = list(self._handed_over)[-waiting:] if waiting else []
        return waiting >= MOST_CHUNKS_AHEAD or sum(newest) >= CHUNK_BYTES

    def _hand_over(self) -> None:
        while len(self._received) >= HEADER_BYTES:
            kind, size = bytes(self._received[:3]), int.from_bytes(self._received[4:8], "little")
            if kind not in KINDS or not HEADER_BYTES <= size <= CHUNK_BYTES:
                LOG.warning("no chunk of OPC UA: %r of %d bytes", kind, size)
                self.end()
                return
            if len(self._received) < size:
                return
            if self._unfetched or self._busy:
                self._wait()
                return
            if not self.active:
                self._before += 1
                if self._before > MOST_CHUNKS_BEFORE:
                    LOG.warning("%d chunks and no session", MOST_CHUNKS_BEFORE)
                    self.end()
                    return
            chunk = bytes(self._received[:size])
            del self._received[:size]
            self._handed_over.append(size)
            self._library.data_received(chunk)

    def _wait(self) -> None:
        """Read on later."""
        if self._looking is None and self._transport is not None and not self._transport.is_closing():
            self._transport.pause_reading()
            self._looking = asyncio.get_running_loop().call_later(LOOK_S, self._look)

    def _look(self) -> None:
        self._looking = None
        if self._transport is None or self._transport.is_closing():
            return
        if self._unfetched or self._busy:
            self._wait()
            return
        self._transport.resume_reading()
        self._hand_over()
