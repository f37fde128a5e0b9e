"""Bytes in, bytes out: a serial port or a TCP socket behind one small protocol.

The only module that touches ports. It knows nothing of frames.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from dataclasses import dataclass
from typing import Any, Protocol

import serial

from daq.drivers.protocol import Cause
from daq.records import InputError
from daq.tables import reason_of
from daq.words import Message, say

# Numbers without another source were set by hand, 2026-11.

CONNECT_TIMEOUT_S = 1.5
"""Longest wait for a TCP connection: short enough that rest, connect and set-up stay below `FOUND_AGAIN_S`."""
_SERIAL_POLL_S, _SERIAL_STEP_S = 0.02, 0.001
"""How long one read waits for a byte, and the pause between looks when less is left. Set by hand, 2026-11. [s]"""
_HELD_S, _HELD_STEP_S = 0.5, 0.02
"""A held port is tried so long: a program that ends, or a child just forked, lets go of it soon. [s]"""


class LinkLost(Exception):
    """The port or the connection is gone; open it anew."""

    def __init__(self, message: Message, cause: Cause = Cause.PORT_LOST) -> None:
        super().__init__(message)
        self.cause = cause


class Link(Protocol):
    """An open byte stream."""

    def write(self, data: bytes) -> None:
        """Send all of it."""

    def read(self, wait_s: float) -> bytes:
        """Return what has arrived, after at most `wait_s` for the first byte; ``b""`` if nothing."""

    def close(self) -> None:
        """Release it. A second call does no harm."""


@dataclass(frozen=True)
class SerialPlace:
    """Where and how to open a serial port."""

    port: str
    baud: int
    parity: str = "N"
    stop_bits: int = 1
    data_bits: int = 8
    xonxoff: bool = False

    def open(self) -> Link:
        """Open the port for us alone."""
        deadline = time.monotonic() + _HELD_S
        while True:
            try:
                return _SerialLink(self)
            except (OSError, ValueError) as error:
                lost = _not_opened(say("port-cannot-open", place=self.port), error)
                if lost.cause is not Cause.IN_USE or time.monotonic() > deadline:
                    raise lost from error
            time.sleep(_HELD_STEP_S)

    @property
    def key(self) -> str:
        """What two loggers on the same wire share."""
        return self.port

    @property
    def is_socket(self) -> bool:
        """Whether reconnecting is cheap and clears what was in flight."""
        return False

    def __str__(self) -> str:
        return self.port


@dataclass(frozen=True)
class SocketPlace:
    """Where to find a TCP device or gateway."""

    host: str
    tcp_port: int

    def open(self) -> Link:
        """Connect."""
        try:
            return _SocketLink(socket.create_connection((self.host, self.tcp_port), CONNECT_TIMEOUT_S))
        except OSError as error:
            raise _not_opened(say("port-cannot-connect", place=str(self)), error) from error

    @property
    def key(self) -> str:
        """What two loggers behind one gateway share."""
        return str(self)

    @property
    def is_socket(self) -> bool:
        """Always: see `SerialPlace.is_socket`."""
        return True

    def __str__(self) -> str:
        return f"{self.host}:{self.tcp_port}"


Place = SerialPlace | SocketPlace

NEVER_OPENED = (Cause.IN_USE, Cause.NO_PORT, Cause.NO_PERMISSION)
"""The port itself does not open: asking another device on it is of no use."""
_WHY_NOT: dict[int | None, Cause] = {
    errno.ECONNREFUSED: Cause.CONNECTION_REFUSED,
    **dict.fromkeys((errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT), Cause.UNREACHABLE),
    **dict.fromkeys((errno.ENOENT, errno.ENXIO, errno.ENODEV), Cause.NO_PORT),
    **dict.fromkeys((errno.EACCES, errno.EPERM), Cause.NO_PERMISSION),
    **dict.fromkeys((errno.EBUSY, errno.EAGAIN), Cause.IN_USE),
}


def _not_opened(what: Message, error: OSError | ValueError) -> LinkLost:
    """Return why a place does not open, each cause by its own name, with what to do."""
    number = error.errno if isinstance(error, OSError) else None
    cause = _WHY_NOT.get(errno.ETIMEDOUT if isinstance(error, TimeoutError) else number)
    if cause is None:
        return LinkLost(say("at-place", place=what, what=reason_of(error)))
    remedy = say(f"port-remedy-{cause.value.replace(' ', '-')}")
    return LinkLost(say("port-not-opened", what=what, cause=cause.message, remedy=remedy), cause)


def socket_of(port: str) -> SocketPlace | None:
    """Return the socket a port written as ``socket://host:port`` means; None for a real port.

    >>> socket_of("socket://gateway:4001"), socket_of("COM5")
    (SocketPlace(host='gateway', tcp_port=4001), None)
    """
    if not port.startswith("socket://"):
        return None
    host, _, number = port.removeprefix("socket://").rpartition(":")
    if not host or not (number.isascii() and number.isdigit()):
        raise InputError(say("port-no-socket", port=repr(port)))
    return SocketPlace(host, int(number))


class _SocketLink:
    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(CONNECT_TIMEOUT_S)

    def write(self, data: bytes) -> None:
        """Send the bytes. Raises LinkLost."""
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkLost(say("connection-lost", reason=reason_of(error))) from error

    def read(self, wait_s: float) -> bytes:
        """Return what has come within so many seconds, nothing where nothing has. Raises LinkLost."""
        try:
            ready, _, _ = select.select([self._socket], [], [], max(wait_s, 0.0))
            if not ready:
                return b""
            data = self._socket.recv(4096)
        except (OSError, ValueError) as error:
            raise LinkLost(say("connection-lost", reason=reason_of(error))) from error
        if not data:
            raise LinkLost(say("connection-closed"))
        return data

    def close(self) -> None:
        """Release it. A second call does no harm."""
        self._socket.close()


class _SerialLink:
    def __init__(self, place: SerialPlace) -> None:
        options: dict[str, Any] = {"exclusive": True} if os.name == "posix" and "://" not in place.port else {}
        self._port = serial.serial_for_url(
            place.port,
            baudrate=place.baud,
            parity=place.parity,
            stopbits=place.stop_bits,
            bytesize=place.data_bits,
            xonxoff=place.xonxoff,
            timeout=_SERIAL_POLL_S,
            write_timeout=CONNECT_TIMEOUT_S,
            **options,
        )

    def write(self, data: bytes) -> None:
        """Send the bytes. Raises LinkLost."""
        try:
            self._port.write(data)
            self._port.flush()
        except (OSError, TypeError, ValueError) as error:
            raise LinkLost(say("port-lost", reason=reason_of(error))) from error

    def read(self, wait_s: float) -> bytes:
        """Return what has come within so many seconds, nothing where nothing has. Raises LinkLost."""
        deadline = time.monotonic() + wait_s
        try:
            while True:
                waiting = self._port.in_waiting
                if waiting:
                    return bytes(self._port.read(waiting))
                left = deadline - time.monotonic()
                if left <= 0:
                    return b""
                if left < _SERIAL_POLL_S:
                    time.sleep(min(left, _SERIAL_STEP_S))
                elif first := self._port.read(1):
                    return bytes(first) + bytes(self._port.read(self._port.in_waiting))
        except (OSError, TypeError, ValueError) as error:
            raise LinkLost(say("port-lost", reason=reason_of(error))) from error

    def close(self) -> None:
        """Release it. A second call does no harm."""
        self._port.close()
