"""Replies that are lines of text: one line answers one query, nothing may follow it."""

from __future__ import annotations

from daq.drivers.bus import TakeReply
from daq.drivers.protocol import BadFrame, Cause
from daq.words import say


def line_reply(end: bytes, *, longest: int = 4096) -> TakeReply:
    """Return a reader of one line, its end removed."""

    def take(buffer: bytearray) -> bytes | None:
        if len(buffer) > longest:
            raise BadFrame(say("reply-endless", bytes=len(buffer)), Cause.GARBAGE)
        text, found, rest = bytes(buffer).partition(end)
        if not found:
            return None
        if rest.strip(b"\r\n"):
            raise BadFrame(say("reply-surplus", bytes=len(rest)), Cause.SURPLUS)
        return text

    return take


def ascii_line(line: bytes) -> str:
    """Return a line as text, or raise BadFrame where a byte is no printable ASCII."""
    if any(not 32 <= byte < 127 for byte in line):
        raise BadFrame(say("reply-no-text", reply=repr(line[:40])), Cause.GARBAGE)
    return line.decode("ascii")
