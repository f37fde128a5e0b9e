"""A wire that misbehaves: stands between a driver and a simulated device and spoils replies.

Bytes from the driver go on untouched; each reply may come late, in slices, twice, cut short, with
noise, behind an echo, damaged, from another station, or not at all. The wire itself can vanish and
return, or stay connected and dead. What a busy machine keeps it from sending in time, it drops: how late
a reply may come is part of the fault, not of the machine.
"""

from __future__ import annotations

import heapq
import itertools
import math
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from daq.simulated.devices_line import HAS_PSEUDO_TERMINALS, Read, Send, Server, file_channel, socket_channel
from daq.simulated.modbus import checksum

if HAS_PSEUDO_TERMINALS:
    import pty
    import tty

_POLL_S = 0.03
"""A thread that waits for bytes looks this often whether it shall end. [s]"""
_MORE_S = 0.002
"""A reply is complete when nothing follows for so long: the device writes it in one go."""
_SLICE_S = 0.016
"""USB adapters hand bytes over in slices of 16 ms."""
_COPY_S = 0.01
"""What comes twice comes no later than this after its time: half the silence that a driver without channels in its
replies keeps between reply and query (profile sr630), which hears a copy by nothing else."""
_LOST_S = 5.0
"""A request this much older than its reply may be never gets one: two that a busy machine let run together are no
request to the device, which answers a sound one within milliseconds. [s]"""


class Fault(StrEnum):
    """What happens to one reply."""

    NONE = "none"
    LATE = "late"
    SPLIT = "split"
    DUPLICATED = "duplicated"
    TRUNCATED = "truncated"
    GARBAGE = "garbage"
    ECHOED = "echoed"
    DAMAGED = "damaged"
    WRONG_ID = "wrong id"
    BUSY = "busy"
    SILENT = "silent"


@dataclass(frozen=True)
class Spoiler:
    """How one protocol's frames are damaged so that they stay plausible; None: not possible."""

    damage: Callable[[bytes, np.random.Generator], bytes | None]
    """A frame that its checksum or header must betray."""
    wrong_id: Callable[[bytes], bytes | None]
    """A sound frame from another station or transaction."""
    busy: Callable[[bytes], bytes | None]
    """What the device says when it is busy."""
    numbered: bool = False
    """Whether replies carry a transaction number, so that even an old one can be told."""
    asks: Callable[[bytes], int] = lambda data: 1
    """How many replies what the driver sends at once asks for."""
    parts: Callable[[bytes], list[bytes]] = lambda data: [data]
    """Replies in what the device sends at once."""


_Arrival = tuple[float, list[bytes]]
"""When a frame begins to arrive, and the slices it comes in. [s]"""

Plan = Callable[[bytes, bytes], Fault]
"""Request and reply to the fault this reply suffers."""


class FaultProxy:
    """One wire between drivers and a running simulated line.

    Serial lines appear as a pseudo-terminal behind a link in a directory, so that the port can
    vanish and return under the same name.
    """

    def __init__(
        self,
        upstream: Server,
        spoiler: Spoiler,
        plan: Plan,
        *,
        seed: int,
        late_s: tuple[float, float],
        again_s: tuple[float, ...] = (0.0, 0.003),
        in_time_s: Callable[[bytes], float] = lambda request: math.inf,
        port_link: Path | None = None,
        greeting: bytes = b"",
    ) -> None:
        self.faults: dict[Fault, int] = dict.fromkeys(Fault, 0)
        """Replies that suffered each fault."""
        self._upstream = upstream
        self._spoiler = spoiler
        self._plan = plan
        self._rng = np.random.default_rng(seed)
        self._late_s = late_s
        self._again_s = again_s
        self._in_time_s = in_time_s
        self._greeting = greeting
        self._port_link = port_link
        self._asked: deque[tuple[bytes, float]] = deque()
        """Requests that wait for their reply, and until when. [-, s]"""
        self._dead = False
        self._stopped = threading.Event()
        self._wire: Server | None = None
        self._outbox = _Outbox()
        self._tcp_port = 0
        self.appear()

    @property
    def place(self) -> dict[str, object]:
        """Where the driver finds the wire: keys of LoggerSettings."""
        if self._port_link is not None:
            return {"port": str(self._port_link)}
        return {"host": "127.0.0.1", "tcp_port": self._tcp_port}

    def appear(self) -> None:
        """Plug the wire in."""
        self._dead = False
        if self._port_link is not None:
            self._appear_as_terminal(self._port_link)
        else:
            self._appear_as_socket()

    def vanish(self) -> None:
        """Pull the wire out: the port is gone, connections break."""
        if self._wire is not None:
            if self._port_link is not None:
                self._port_link.unlink(missing_ok=True)
            self._wire.close()
            self._wire = None

    def go_dead(self) -> None:
        """Keep present connections open, but let nothing through them any more."""
        self._dead = True

    def revive(self) -> None:
        """Let bytes through again, on connections made from now on."""
        self._dead = False

    def close(self) -> None:
        """Remove the wire for good."""
        self.vanish()
        self._stopped.set()
        self._outbox.close()

    def __enter__(self) -> FaultProxy:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _appear_as_terminal(self, link: Path) -> None:
        master, slave = pty.openpty()
        tty.setraw(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        wire = Server({"port": str(link)})
        wire.on_close(lambda: os.close(master))
        wire.on_close(lambda: os.close(slave))
        read, send = file_channel(master)
        wire.start(lambda stopped: self._carry(read, send, stopped))
        self._wire = wire

    def _appear_as_socket(self) -> None:
        listener = socket.create_server(("127.0.0.1", self._tcp_port))
        self._tcp_port = listener.getsockname()[1]
        wire = Server({"host": "127.0.0.1", "tcp_port": self._tcp_port})
        wire.on_close(listener.close)

        def accept(stopped: threading.Event) -> None:
            while not stopped.is_set():
                ready, _, _ = select.select([listener], [], [], _POLL_S)
                if ready:
                    connection, _ = listener.accept()
                    wire.start(lambda stopped, c=connection: self._serve(c, stopped))  # type: ignore[misc]

        wire.start(accept)
        self._wire = wire

    def _serve(self, connection: socket.socket, stopped: threading.Event) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with connection:
            self._carry(*socket_channel(connection), stopped)

    def _carry(self, read: Read, send: Send, stopped: threading.Event) -> None:
        """Carry bytes both ways for one connection; adapters may begin with noise."""
        self._outbox.send(send, [self._greeting], 0.0)
        with _Upstream(self._upstream) as (device_read, device_send):
            killed = threading.Event()
            back = threading.Thread(
                target=self._carry_back, args=(device_read, send, stopped, killed), daemon=True
            )
            back.start()
            self._asked.clear()
            empty_s = time.monotonic()
            while not stopped.is_set():
                looked_s = time.monotonic()
                data = read(0.0)
                if data == b"":
                    empty_s = looked_s
                    data = read(_POLL_S)
                if data is None:
                    break
                if self._dead:
                    killed.set()
                if data and not killed.is_set():
                    due_s = empty_s + self._in_time_s(data)  # a busy machine may have let it lie since
                    self._asked.extend([(data, due_s)] * self._spoiler.asks(data))
                    with suppress(OSError):
                        device_send(data)
            killed.set()
            self._outbox.forget(send)
            back.join(timeout=240)

    def _carry_back(self, read: Read, send: Send, stopped: threading.Event, killed: threading.Event) -> None:
        while not (stopped.is_set() or killed.is_set()):
            reply = read(_POLL_S)
            if reply is None:
                return
            if not reply:
                continue
            while more := read(_MORE_S):
                reply += more
            for part in self._spoiler.parts(reply):
                self._pass_on(part, send)

    def _pass_on(self, reply: bytes, send: Send) -> None:
        """Send a reply, spoiled, to the driver that waits for it."""
        while self._asked and time.monotonic() > self._asked[0][1] + _LOST_S:
            self._asked.popleft()  # else every later reply would be taken for that of the request before it
        if not self._asked:  # left over from a connection before
            return
        request, due_s = self._asked.popleft()
        if self._dead or time.monotonic() > due_s:  # the driver has given it up
            return
        for copy, (delay_s, slices) in enumerate(self._spoiled(request, reply)):
            until_s = time.monotonic() + delay_s + _COPY_S if copy else math.inf
            self._outbox.send(send, slices, delay_s, min(due_s, until_s))

    def _spoiled(self, request: bytes, reply: bytes) -> list[_Arrival]:
        """Return what arrives in place of a reply."""
        fault = self._plan(request, reply)
        pieces = self._pieces(fault, request, reply)
        if pieces is None:
            fault, pieces = Fault.NONE, [(0.0, [reply])]
        self.faults[fault] += 1
        return pieces

    def _pieces(self, fault: Fault, request: bytes, reply: bytes) -> list[_Arrival] | None:
        rng = self._rng
        cut = int(rng.integers(1, max(len(reply), 2)))
        noise = bytes(rng.integers(0x80, 0x100, size=int(rng.integers(1, 12)), dtype=np.uint8))
        changed = {
            Fault.DAMAGED: lambda: self._spoiler.damage(reply, rng),
            Fault.WRONG_ID: lambda: self._spoiler.wrong_id(reply),
            Fault.BUSY: lambda: self._spoiler.busy(reply),
        }
        if fault in changed:
            frame = changed[fault]()
            return None if frame is None else [(0.0, [frame])]
        noisy = (noise + reply, reply + noise, noise)[int(rng.integers(3))]
        again_s = float(rng.choice(self._again_s))
        return {
            Fault.NONE: [(0.0, [reply])],
            Fault.LATE: [(float(rng.uniform(*self._late_s)), [reply])],
            Fault.SPLIT: [(0.0, _slices(reply, len(reply) // int(rng.integers(2, 7)) + 1))],
            Fault.DUPLICATED: [(0.0, [reply]), (again_s, [reply])],
            Fault.TRUNCATED: [(0.0, [reply[:cut]])],
            Fault.GARBAGE: [(0.0, [noisy])],
            Fault.ECHOED: [(0.0, [request + reply])],
            Fault.SILENT: [],
        }[fault]


def _slices(data: bytes, size: int) -> list[bytes]:
    return [data[i : i + size] for i in range(0, len(data), size)]


class _Upstream:
    """Our own connection to the device behind the proxy."""

    def __init__(self, server: Server) -> None:
        self._server = server

    def __enter__(self) -> tuple[Read, Send]:
        place = self._server.place
        if "port" in place:
            self._file = os.open(str(place["port"]), os.O_RDWR | os.O_NOCTTY)
            tty.setraw(self._file)
            return file_channel(self._file)
        self._socket = socket.create_connection((str(place["host"]), int(place["tcp_port"])))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return socket_channel(self._socket)

    def __exit__(self, *_: object) -> None:
        if "port" in self._server.place:
            os.close(self._file)
        else:
            self._socket.close()


class _Outbox:
    """Sends frames at their time, one after the other: a wire never mixes two frames."""

    def __init__(self) -> None:
        self._due: list[tuple[float, int, float, Send, list[bytes]]] = []
        self._count = itertools.count()
        self._wake = threading.Condition()
        self._open = True
        self._last_due = 0.0
        threading.Thread(target=self._work, daemon=True).start()

    def send(self, send: Send, slices: list[bytes], delay_s: float, until_s: float = math.inf) -> None:
        """Send after a delay, but never before what a slow device still owes, and nothing after a time."""
        with self._wake:
            self._last_due = max(self._last_due, time.monotonic() + delay_s)
            heapq.heappush(self._due, (self._last_due, next(self._count), until_s, send, slices))
            self._wake.notify()

    def forget(self, send: Send) -> None:
        """Drop what was still to go to a connection that is gone."""
        with self._wake:
            self._due = [entry for entry in self._due if entry[3] is not send]
            heapq.heapify(self._due)

    def close(self) -> None:
        """Send no more; what is still due is dropped."""
        with self._wake:
            self._open = False
            self._wake.notify()

    def _work(self) -> None:
        while (entry := self._next()) is not None:
            until_s, send, slices = entry
            for number, part in enumerate(slices):
                if number:
                    time.sleep(_SLICE_S)
                if time.monotonic() <= until_s:
                    with suppress(OSError):
                        send(part)

    def _next(self) -> tuple[float, Send, list[bytes]] | None:
        """Wait for the next frame that is due; None at the end."""
        with self._wake:
            while self._open:
                left = self._due[0][0] - time.monotonic() if self._due else None
                if left is not None and left <= 0:
                    _, _, until_s, send, slices = heapq.heappop(self._due)
                    return until_s, send, slices
                self._wake.wait(left)
        return None


def rtu_spoiler() -> Spoiler:
    """Modbus RTU: any flipped bit must be betrayed by the checksum."""

    def resealed(body: bytes) -> bytes:
        return body + checksum(body)

    return Spoiler(
        damage=_flipped_bit,
        wrong_id=lambda reply: resealed(bytes([reply[0] % 247 + 1]) + reply[1:-2]),
        busy=lambda reply: resealed(bytes([reply[0], reply[1] | 0x80, 6])),
    )


def tcp_spoiler() -> Spoiler:
    """Modbus TCP: the network guards the bits, so transaction, length or byte count are wrong."""

    def damage(reply: bytes, rng: np.random.Generator) -> bytes:
        place = int(rng.choice([2, 3, 5, 7, 8]))
        return reply[:place] + bytes([reply[place] ^ (1 << int(rng.integers(1, 7)))]) + reply[place + 1 :]

    return Spoiler(
        damage=damage,
        wrong_id=lambda reply: reply[:1] + bytes([reply[1] ^ 0x55]) + reply[2:],
        busy=lambda reply: reply[:4] + b"\x00\x03" + reply[6:7] + bytes([reply[7] | 0x80, 6]),
        numbered=True,
    )


def guarded_text_spoiler() -> Spoiler:
    """ADAM and DCON with checksum: any flipped bit must be betrayed by it."""
    return Spoiler(
        damage=_flipped_bit,
        wrong_id=_other_module,
        busy=lambda reply: _sealed(b"?" + reply[1:3]) if reply[:1] == b"!" else None,
    )


def bare_text_spoiler() -> Spoiler:
    """SCPI and SR630 have no checksum: what is damaged must at least stop being text."""

    def damage(reply: bytes, rng: np.random.Generator) -> bytes:
        place = int(rng.integers(len(reply)))
        return reply[:place] + bytes([reply[place] | 0x80]) + reply[place + 1 :]

    def queries(data: bytes) -> int:
        return data.count(b"?")  # a command asks for nothing

    def lines(data: bytes) -> list[bytes]:
        return data.splitlines(keepends=True)

    return Spoiler(damage, wrong_id=lambda reply: None, busy=lambda reply: None, asks=queries, parts=lines)


def _flipped_bit(reply: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(reply)))
    return reply[:place] + bytes([reply[place] ^ (1 << int(rng.integers(8)))]) + reply[place + 1 :]


def _sealed(text: bytes) -> bytes:
    return text + f"{sum(text) % 256:02X}\r".encode("ascii")


def _other_module(reply: bytes) -> bytes | None:
    if reply[:1] != b"!":
        return None
    other = f"{(int(reply[1:3], 16) + 1) % 256:02X}".encode("ascii")
    return _sealed(reply[:1] + other + reply[3:-3])
