"""What every logger is to the recorder: one protocol and the two ways a reading can fail."""

from __future__ import annotations

from enum import StrEnum
from typing import ClassVar, Protocol

from daq.records import Channel, Quality, Reading
from daq.words import Message, say


class DataLogger(Protocol):
    """A thermocouple logger. Calls block; give each logger its own thread."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The inputs in use, in the order `read` reports them."""

    def read(self) -> Reading:
        """Wait for the next reading.

        Raises NoReply (silence: try again) or BadFrame (noise: drop it).
        """

    def close(self) -> None:
        """Release the port. A second call does no harm."""


class Cause(StrEnum):
    """Why a reading did not come about: what the bus acts upon, what is counted, and what a gap keeps."""

    SILENT = "silent"
    BUSY = "busy"
    """The device answers that it has no data now."""
    REFUSED = "refused"
    """The device answers, and is not what the settings say it is."""
    CLOSED = "closed"
    """The logger was closed by us."""
    PORT_LOST = "port lost"
    """An open port or connection broke."""
    CONNECTION_REFUSED = "connection refused"
    UNREACHABLE = "unreachable"
    NO_PORT = "no port"
    NO_PERMISSION = "no permission"
    IN_USE = "port in use"
    BABBLE = "babble"
    """The line never falls silent."""
    TRUNCATED = "truncated"
    GARBAGE = "garbage"
    SURPLUS = "surplus"
    """Bytes after the end of the reply."""
    WRONG_ID = "wrong id"
    """Another station's reply, or another request's."""
    WRONG_SHAPE = "wrong shape"
    CRC = "crc"
    ECHO = "echo"
    """The local echo differs from what was sent."""
    OUT_OF_STEP = "out of step"

    @property
    def message(self) -> Message:
        """The cause in words."""
        return say(f"cause-{self.value.replace(' ', '-')}")


class ReadFailure(Exception):
    """A reading that did not come about; the recorder stores a gap with this cause."""

    quality: ClassVar[Quality]

    def __init__(self, message: Message | str, cause: Cause | str) -> None:
        super().__init__(message)
        self.cause = Cause(cause)


class NoReply(ReadFailure):
    """Nothing usable came in time: silence, a busy device, a lost port. Try again."""

    quality = Quality.MISSING


class BadFrame(ReadFailure):
    """Something came that is not the reply to our request. Drop it."""

    quality = Quality.BAD_FRAME
