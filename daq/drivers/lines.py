"""Replies that are lines of text: one line answers one query, nothing may follow it."""

from __future__ import annotations

from daq.drivers.bus import TakeReply
from daq.drivers.protocol import BadFrame


def line_reply(end: bytes, *, longest: int = 4096) -> TakeReply:
    """Return a reader of one line, its end removed."""

    def take(buffer: bytearray) -> bytes | None:
        if len(buffer) > longest:
            raise BadFrame(f"no end of line in {len(buffer)} bytes", "garbage")
        text, found, rest = bytes(buffer).partition(end)
        if not found:
            return None
        if rest.strip(b"\r\n"):
            raise BadFrame(f"{len(rest)} bytes after the end of the reply", "surplus")
        return text

    return take


def decoded(line: bytes) -> str:
    """Return a line as text, or raise BadFrame where a byte is no printable ASCII."""
    if any(not 32 <= byte < 127 for byte in line):
        raise BadFrame(f"reply {line[:40]!r} holds bytes that are no text", "garbage")
    return line.decode("ascii")
