"""ADAM and DCON modules speaking ASCII: ``#AA`` fetches all inputs, ``$AAB`` proves we are in step.

The reply to ``#AA`` names no module. The reply to ``$AAB`` does, so a scan counts only when the
status line that belongs to it follows: a late or doubled ``#AA`` reply of any module pushes itself
into that place and is refused.
"""

from __future__ import annotations

import math
import re

from daq.drivers.bus import Bus, LineTiming
from daq.drivers.decode import Sample, limited, out_of_range
from daq.drivers.lines import ascii_line, line_reply
from daq.drivers.profile import Ascii, Profile
from daq.drivers.protocol import BadFrame, Cause, NoReply
from daq.records import InputError, Quality
from daq.words import Message, say

_CODES = {
    Quality.OPEN: re.compile(r"\+888888"),
    Quality.OVER: re.compile(r"\+9{4}\.?9*"),
    Quality.UNDER: re.compile(r"-0{4}\.?0*|-9{4}\.?9*"),
}
_NUMBER = re.compile(r"[+-]\d+\.\d*")
_CHECKSUM_BIT = 0x40
"""Bit 6 of the last byte that $AA2 answers: checksums are on. (ICP DAS, DCON protocol)"""


def checksum(text: str) -> str:
    """Return two hexadecimal digits, the low byte of the sum of the characters.

    >>> checksum("#01")
    '84'
    """
    return f"{sum(text.encode('ascii')) & 0xFF:02X}"


def values_of(payload: str, inputs: int, width: int) -> list[tuple[float, Quality]]:
    """Return value and quality of every input from what follows ``>``, or raise BadFrame.

    A code may stand without its blanks. Where nothing is missing, every value has its place by counting;
    else by its sign. A text that is neither value nor code spoils them all: nobody knows what else is wrong.

    >>> values_of("+0025.1+888888       ", 3, 7)[0]
    (25.1, <Quality.GOOD: 'good'>)
    """
    if len(payload) == inputs * width:
        cells = [payload[k : k + width] for k in range(0, len(payload), width)]
    else:
        cells = re.findall(rf" {{{width}}}|[+-][0-9.]+", payload)
    if "".join(cells) != payload or len(cells) != inputs:
        raise BadFrame(say("reply-value-count", reply=repr(payload[:70]), values=inputs), Cause.WRONG_SHAPE)
    return [_value(cell, width) for cell in cells]


def _value(cell: str, width: int) -> tuple[float, Quality]:
    if not cell.strip():
        return math.nan, Quality.MISSING
    for quality, code in _CODES.items():
        if code.fullmatch(cell.strip()):
            return math.nan, quality
    if len(cell) != width or not _NUMBER.fullmatch(cell):
        raise BadFrame(say("reply-no-value", reply=repr(cell)), Cause.WRONG_SHAPE)
    return float(cell), Quality.GOOD


class DconDevice:
    """One module at its two-digit address."""

    def __init__(
        self, bus: Bus, profile: Profile, *, station: int, timing: LineTiming, with_checksum: bool
    ) -> None:
        if profile.ascii is None:
            raise InputError(say("profile-table-missing", profile=profile.name, table="ascii"))
        self.bus = bus
        self.timing = timing
        self._profile = profile
        self._ascii: Ascii = profile.ascii
        self._at = f"{station:02X}"
        self._with_checksum = with_checksum

    def set_up(self) -> None:
        """Make sure the module writes engineering units, with the checksum as set here."""
        answer, _, _ = self._ask(f"${self._at}2", f"!{self._at}")
        if not re.fullmatch(r"[0-9A-F]{6}", answer):
            raise BadFrame(say("reply-no-configuration", reply=repr(answer)), Cause.WRONG_SHAPE)
        flags = int(answer[4:], 16)
        if bool(flags & _CHECKSUM_BIT) != self._with_checksum:
            raise self._refused(say("module-checksum", is_on="on" if flags & _CHECKSUM_BIT else "off"))
        if flags & 0x03:
            raise self._refused(say("module-format"))
        if self._ascii.name:
            name, _, _ = self._ask(f"${self._at}M", f"!{self._at}")
            if self._ascii.name not in name:
                raise self._refused(say("module-name", found=repr(name), expected=self._ascii.name))

    def sample(self) -> Sample:
        """Fetch all inputs, then the status that belongs to them."""
        with self.bus.lock:
            payload, requested_s, received_s = self._ask(f"#{self._at}", ">")
            flags = self._flags()
        pairs = values_of(payload, self._profile.inputs, self._ascii.width)
        profile = self._profile
        judged = [
            limited(profile, value, out_of_range(profile, value) if flag and quality is Quality.GOOD else quality)
            for (value, quality), flag in zip(pairs, flags, strict=True)
        ]
        return Sample(tuple(v for v, _ in judged), tuple(q for _, q in judged), requested_s, received_s)

    def _flags(self) -> list[bool]:
        inputs = self._profile.inputs
        if self._ascii.status is None:
            self._ask(f"${self._at}M", f"!{self._at}")
            return [False] * inputs
        answer, _, _ = self._ask(f"${self._at}B", f"!{self._at}")
        if not re.fullmatch(rf"[0-9A-F]{{1,{math.ceil(inputs / 4)}}}", answer):
            raise BadFrame(say("reply-no-status", reply=repr(answer)), Cause.WRONG_SHAPE)
        return [bool(int(answer, 16) >> k & 1) for k in range(inputs)]

    def _ask(self, command: str, lead: str) -> tuple[str, float, float]:
        guard = checksum(command) if self._with_checksum else ""
        take = line_reply(b"\r")

        def checked(buffer: bytearray) -> bytes | None:
            line = take(buffer)
            return None if line is None else self._checked(line, command, lead)

        reply = self.bus.exchange(f"{command}{guard}\r".encode("ascii"), checked, self.timing)
        return reply.payload.decode("ascii"), reply.requested_s, reply.received_s

    def _checked(self, line: bytes, command: str, lead: str) -> bytes:
        text = ascii_line(line)
        if self._with_checksum:
            text, guard = text[:-2], text[-2:]
            if checksum(text) != guard:
                raise BadFrame(say("reply-checksum"), Cause.CRC)
        if text.startswith("?"):
            raise self._refused(say("module-unknown-command", command=command))
        if not text.startswith(lead):
            raise BadFrame(
                say("reply-other-lead", reply=repr(text[:20]), command=command, lead=repr(lead)), Cause.WRONG_SHAPE
            )
        return text.removeprefix(lead).encode("ascii")

    def _refused(self, why: Message) -> NoReply:
        problem = say("module-refused", place=str(self.bus.place), address=self._at, why=why)
        return NoReply(problem, Cause.REFUSED)
