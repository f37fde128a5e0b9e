"""What every logger is to the recorder: one protocol and the two ways a reading can fail."""

from __future__ import annotations

from typing import ClassVar, Protocol

from daq.records import Channel, Quality, Reading


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


class ReadFailure(Exception):
    """A reading that did not come about; the recorder stores a gap with this cause."""

    quality: ClassVar[Quality]

    def __init__(self, message: str, cause: str) -> None:
        super().__init__(message)
        self.cause = cause
        """One or two words for counting and for the gap: ``silent``, ``busy``, ``crc`` ..."""


class NoReply(ReadFailure):
    """Nothing usable came in time: silence, a busy device, a lost port. Try again."""

    quality = Quality.MISSING


class BadFrame(ReadFailure):
    """Something came that is not the reply to our request. Drop it."""

    quality = Quality.BAD_FRAME
