"""Modbus requests and the only replies that answer them: RTU, and TCP with its transaction number.

Every reply is held against its request: station, function, byte count and checksum (RTU) or
transaction number (TCP). What does not match is refused, never interpreted.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from daq.drivers.bus import TakeReply
from daq.drivers.protocol import BadFrame, Cause, NoReply
from daq.words import say

BUSY = (4, 5, 6, 10, 11)
"""Exception codes of a device that may have data later; the others mean that the request does not fit it.

Source: MODBUS Application Protocol Specification V1.1b3, section 7."""


def crc16(data: bytes | bytearray) -> int:
    """Return the Modbus RTU checksum, sent low byte first.

    >>> hex(crc16(bytes.fromhex("010300000008")))
    '0xc44'
    """
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


@dataclass(frozen=True)
class Request:
    """What is asked, without the framing."""

    function: int
    address: int
    """Zero-based, as on the wire."""
    count: int = 1
    """Registers or bits."""
    data: bytes = b""
    """What is written, for functions 5, 6 and 16."""

    @property
    def pdu(self) -> bytes:
        """The request as the device sees it."""
        if self.function in (5, 6):
            return struct.pack(">BH", self.function, self.address) + self.data
        head = struct.pack(">BHH", self.function, self.address, self.count)
        return head + bytes([len(self.data)]) + self.data if self.data else head

    @property
    def reply_head(self) -> bytes:
        """How a good reply begins: function and byte count, or the echo of a write."""
        if self.function in (1, 2):
            return bytes([self.function, (self.count + 7) // 8])
        if self.function in (3, 4):
            return bytes([self.function, 2 * self.count])
        if self.function in (5, 6):
            return self.pdu
        return struct.pack(">BHH", self.function, self.address, self.count)

    @property
    def reply_size(self) -> int:
        """Bytes of a good reply from its function code on."""
        return len(self.reply_head) + (self.reply_head[1] if self.function <= 4 else 0)


def _payload(pdu: bytes, request: Request) -> bytes:
    """Return the data of a complete reply, its head already known to fit."""
    return pdu[len(request.reply_head) :]


def _raise_exception(code: int) -> None:
    if code in BUSY:
        raise NoReply(say("modbus-busy", exception=code), Cause.BUSY)
    raise NoReply(say("modbus-refused", exception=code), Cause.REFUSED)


def rtu_frame(station: int, request: Request) -> bytes:
    """Return the request as it goes on the wire."""
    body = bytes([station]) + request.pdu
    return body + struct.pack("<H", crc16(body))


def rtu_reply(station: int, request: Request, *, local_echo: bool = False) -> TakeReply:
    """Return a reader of the one RTU frame that answers `request`.

    A sound frame of another station on the wire is passed over: its own driver gave it up.
    """
    echo = rtu_frame(station, request) if local_echo else b""

    def take(buffer: bytearray) -> bytes | None:
        nonlocal echo
        if not echo.startswith(bytes(buffer[: len(echo)])):
            raise BadFrame(say("reply-echo"), Cause.ECHO)
        if len(buffer) < len(echo):
            return None
        del buffer[: len(echo)]
        echo = b""
        while (size := _foreign_size(buffer, station)) and len(buffer) >= size:
            del buffer[:size]
        return _take_rtu(bytes(buffer), station, request)

    return take


def _foreign_size(frame: bytearray, station: int) -> int:
    """Return the size of another station's frame at the front; 0 where there is none in sight."""
    if len(frame) < 5 or frame[0] == station:
        return 0
    if frame[1] & 0x80:
        size = 5
    elif frame[1] in (1, 2, 3, 4):
        size = 5 + frame[2]
    else:
        return 0
    complete = len(frame) >= size
    return 0 if complete and crc16(frame[: size - 2]) != int.from_bytes(frame[size - 2 : size], "little") else size


def _take_rtu(frame: bytes, station: int, request: Request) -> bytes | None:
    if len(frame) < 5 or _foreign_size(bytearray(frame), station):
        return None
    if frame[0] != station:
        raise BadFrame(say("reply-other-station", found=frame[0], asked=station), Cause.WRONG_ID)
    is_exception = frame[1] == request.function | 0x80
    size = 5 if is_exception else 1 + request.reply_size + 2
    if not is_exception and not frame[1:].startswith(request.reply_head[: len(frame) - 1]):
        raise _other_head(frame[1:3], request)
    if len(frame) < size:
        return None
    if len(frame) > size:
        raise BadFrame(say("reply-surplus", bytes=len(frame) - size), Cause.SURPLUS)
    if crc16(frame[:-2]) != struct.unpack("<H", frame[-2:])[0]:
        raise BadFrame(say("reply-checksum"), Cause.CRC)
    if is_exception:
        _raise_exception(frame[2])
    return _payload(frame[1:-2], request)


def tcp_frame(transaction: int, station: int, request: Request) -> bytes:
    """Return the request with its MBAP header."""
    return struct.pack(">HHHB", transaction, 0, len(request.pdu) + 1, station) + request.pdu


def tcp_reply(transaction: int, station: int, request: Request) -> TakeReply:
    """Return a reader that waits for this transaction's reply and drops those of older ones."""

    def take(buffer: bytearray) -> bytes | None:
        while len(buffer) >= 8:
            number, protocol, length = struct.unpack(">HHH", buffer[:6])
            if protocol != 0 or not 3 <= length <= 254:
                raise BadFrame(say("reply-no-modbus"), Cause.GARBAGE)
            if len(buffer) < 6 + length:
                return None
            frame = bytes(buffer[: 6 + length])
            if number == transaction:
                if len(buffer) > len(frame):
                    raise BadFrame(say("reply-surplus", bytes=len(buffer) - len(frame)), Cause.SURPLUS)
                return _check_tcp(frame, station, request)
            del buffer[: 6 + length]
        return None

    return take


def _check_tcp(frame: bytes, station: int, request: Request) -> bytes:
    pdu = frame[7:]
    if frame[6] != station:
        raise BadFrame(say("reply-other-station", found=frame[6], asked=station), Cause.WRONG_ID)
    if pdu[0] == request.function | 0x80 and len(pdu) == 2:
        _raise_exception(pdu[1])
    if len(pdu) != request.reply_size or not pdu.startswith(request.reply_head):
        raise _other_head(pdu[:2], request)
    return _payload(pdu, request)


def _other_head(found: bytes, request: Request) -> BadFrame:
    expected = request.reply_head.hex(" ")
    return BadFrame(say("reply-other-head", found=found.hex(" "), expected=expected), Cause.WRONG_SHAPE)


def registers(payload: bytes) -> tuple[int, ...]:
    """Return 16-bit registers, unsigned."""
    return struct.unpack(f">{len(payload) // 2}H", payload)


def bits(payload: bytes, count: int) -> tuple[bool, ...]:
    """Return the first `count` bits, lowest first."""
    return tuple(bool(payload[i // 8] >> (i % 8) & 1) for i in range(count))
