"""One wire and its manners: one request at a time, and silence after anything went wrong.

Serial protocols carry no transaction number: a reply that comes late would be taken for the reply
to the next request, with another request's channels in it. So after a timeout or a bad frame the
bus listens, and throws away, until it has received nothing for at least the device's worst response
time; only then does the next request leave. Bytes found waiting before a request make the line
suspect in the same way.

A reply later than timeout and drain together would still be taken for the next one of the same
module, with the right channels but an older moment; where a device reads the same registers by two
functions (``block.alternate``) even that is refused. On TCP replies carry the transaction number,
and a stream out of step is closed and opened anew; there, too, what waits before a request is thrown away, since
a reply that came first may carry the very number that is next.

Decided 2026-11-21, against pymodbus and minimalmodbus, which hand out the late reply
(``tests/daq/test_faults_libraries.py`` shows it).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from daq.drivers.link import Link, LinkLost, Place
from daq.drivers.protocol import BadFrame, Cause, NoReply, ReadFailure
from daq.records import InputError
from daq.words import Message, say, spoken

TakeReply = Callable[[bytearray], bytes | None]
"""Looks at what has arrived: the payload when complete, None to wait for more, BadFrame otherwise.

May remove from the front what is known to belong to an older request.
"""

_SILENCES_BEFORE_RECONNECT = {True: 2, False: 5}
"""Unanswered requests after which a socket, or a serial port, is opened anew. Set by hand, 2026-11."""

# Numbers without another source were set by hand, 2026-11.

_LONGEST_DRAIN = 8
"""A line that will not fall silent within so many drain times is babbling."""


_REST_OF_FRAME_S = 0.02
"""Segments of one frame follow one another on a network within this: one turn of a plant's network is some ms,
Nagle's and delayed acknowledgements aside. Set by hand, 2026-11. [s]"""


@dataclass(frozen=True)
class Exchange:
    """A reply and the two moments that bound when it was measured."""

    payload: bytes
    requested_s: float
    received_s: float


@dataclass(frozen=True)
class LineTiming:
    """How long one station may take, and the silence it needs around its frames."""

    timeout_s: float
    drain_s: float
    turnaround_s: float = 0.0


class Bus:
    """A link with its lock. Loggers on one wire share one."""

    def __init__(self, place: Place, *, numbered: bool) -> None:
        self.place = place
        self.numbered = numbered
        """Whether replies carry a transaction number (Modbus TCP)."""
        self.generation = 0
        """Counts openings of the link: devices are set up again after each."""
        self.lock = threading.RLock()
        """Hold it over exchanges that belong together."""
        self._link: Link | None = None
        self._quiet_until = 0.0
        self._drain_s = 0.0
        self._last_byte_s = 0.0
        self._silences = 0
        self._transaction = 0

    def next_transaction(self) -> int:
        """Return a number no reply still under way can carry."""
        with self.lock:
            self._transaction = self._transaction % 0xFFFF + 1
            return self._transaction

    def exchange(self, request: bytes, take: TakeReply, timing: LineTiming) -> Exchange:
        """Send one request and return its reply, or raise NoReply or BadFrame."""
        with self.lock:
            link = self._opened(timing)
            try:
                self._settle(link, timing)
                requested_s = time.monotonic()  # before it: the device may convert at once
                link.write(request)
                result = self._await(link, take, timing, requested_s)
            except LinkLost as error:
                self._drop()
                raise NoReply(self._with_place(error), Cause.PORT_LOST) from error
            except ReadFailure as failure:
                self._suspect(failure, timing)
                raise
            self._silences = 0
            return result

    def send(self, data: bytes, timing: LineTiming) -> None:
        """Send a command that has no reply."""
        with self.lock:
            link = self._opened(timing)
            try:
                self._settle(link, timing)
                link.write(data)
            except LinkLost as error:
                self._drop()
                raise NoReply(self._with_place(error), Cause.PORT_LOST) from error
            self._last_byte_s = time.monotonic()

    def open(self, timing: LineTiming) -> int:
        """Open the link if it is not, and return its generation."""
        with self.lock:
            self._opened(timing)
            return self.generation

    def reconnect(self) -> None:
        """Close the link; the next exchange opens it anew."""
        with self.lock:
            self._drop()

    def close(self) -> None:
        """Release the port."""
        self.reconnect()

    def _opened(self, timing: LineTiming) -> Link:
        if self._link is None:
            try:
                self._link = self.place.open()
            except LinkLost as error:
                raise NoReply(spoken(error), error.cause) from error
            self.generation += 1
            self._silences = 0
            if not self.numbered:
                self._owe(timing)
        return self._link

    def _drop(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def _owe(self, timing: LineTiming) -> None:
        self._drain_s = max(self._drain_s, timing.drain_s)
        self._quiet_until = max(self._quiet_until, time.monotonic() + self._drain_s)

    def _suspect(self, failure: ReadFailure, timing: LineTiming) -> None:
        if isinstance(failure, NoReply) and failure.cause is Cause.SILENT:
            self._silences += 1
        in_step = failure.cause in (Cause.BUSY, Cause.REFUSED)
        if in_step:
            return
        if not self.numbered:
            self._owe(timing)
        lost_step = self.numbered and isinstance(failure, BadFrame)
        if lost_step or self._silences >= _SILENCES_BEFORE_RECONNECT[self.place.is_socket]:
            self._drop()

    def _settle(self, link: Link, timing: LineTiming) -> None:
        """Listen until the line owes no more silence: what waits before a request answers an older one."""
        data = link.read(0.0)
        if data:
            self._owe(timing if not self.numbered else replace(timing, drain_s=_REST_OF_FRAME_S))
        give_up = time.monotonic() + _LONGEST_DRAIN * max(self._drain_s, timing.drain_s)
        while (now := time.monotonic()) < self._quiet_until or data:  # a busy machine may oversleep a silence
            if now > give_up:
                raise BadFrame(say("line-babbles", place=str(self.place)), Cause.BABBLE)
            data = link.read(max(self._quiet_until - now, 0.0))
            if data:
                self._quiet_until = time.monotonic() + self._drain_s
        self._drain_s = 0.0
        if self.numbered:
            return
        rest = self._last_byte_s + timing.turnaround_s - time.monotonic()
        if rest > 0 and link.read(rest):
            self._owe(timing)
            self._settle(link, timing)

    def _await(self, link: Link, take: TakeReply, timing: LineTiming, requested_s: float) -> Exchange:
        buffer = bytearray()
        deadline = time.monotonic() + timing.timeout_s
        while (left := deadline - time.monotonic()) > 0:
            data = link.read(left)
            if not data:
                continue
            self._last_byte_s = time.monotonic()
            buffer += data
            payload = take(buffer)
            if payload is not None:
                return Exchange(payload, requested_s, self._last_byte_s)
        if buffer:
            raise BadFrame(say("reply-truncated", place=str(self.place), bytes=len(buffer)), Cause.TRUNCATED)
        if self._last_byte_s > requested_s:
            raise BadFrame(say("reply-to-others", place=str(self.place)), Cause.WRONG_ID)
        raise NoReply(say("logger-no-reply", place=str(self.place), timeout_s=timing.timeout_s), Cause.SILENT)

    def _with_place(self, lost: LinkLost) -> Message:
        return say("at-place", place=str(self.place), what=spoken(lost))


_SHARED: dict[str, tuple[Bus, int]] = {}
_SHARED_LOCK = threading.Lock()


def share_bus(place: Place, *, numbered: bool) -> Bus:
    """Return the process's bus at this place, opened for the first who asks."""
    with _SHARED_LOCK:
        bus, users = _SHARED.get(place.key, (Bus(place, numbered=numbered), 0))
        if bus.place != place or bus.numbered != numbered:
            raise InputError(say("port-two-settings", port=place.key, first=repr(bus.place), second=repr(place)))
        _SHARED[place.key] = (bus, users + 1)
        return bus


def release_bus(bus: Bus) -> None:
    """Give a shared bus back; the last user closes it."""
    with _SHARED_LOCK:
        _, users = _SHARED.get(bus.place.key, (bus, 0))
        if users > 1:
            _SHARED[bus.place.key] = (bus, users - 1)
            return
        _SHARED.pop(bus.place.key, None)
    bus.close()
