"""Why there is no valid core: a reason of a fixed set and its numbers. The catalogues hold the words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from daq.printed import on_screen
from daq.words import Message


class InvalidReason(StrEnum):
    """What keeps the core from being known. The values are what CSV, store and REST carry."""

    PRESS_STATE_UNKNOWN = "press state unknown"
    PLATEN_READING_MISSING = "platen reading missing"
    PLATENS_MISSING_AT_INSERTION = "platen reading missing at insertion"
    START_TEMPERATURE_CONTRADICTED = "start temperature contradicted"
    START_TEMPERATURE_TOO_HIGH = "start temperature too high"
    BEGINS_CLOSED = "run begins in the closed press"
    BEGINS_ON_HOT_PLATE = "run begins with the panel on the hot plate"
    CLOSED_AGAIN = "press closed again on the same panel"
    CLOSED_IN_GAP = "press closed during a gap"
    JUMPED_IN_GAP = "faces jumped during a gap"
    PANEL_NOT_SEEN = "panel not seen in the open press"
    OTHER_PANEL = "faces too cold for this panel"
    READINGS_CONTRADICT_MODEL = "readings contradict the model"
    CONSTANTS_UNKNOWN = "constants far from the material"
    IMPOSSIBLE_CORE = "core impossible"
    CALCULATION_FAILED = "calculation failed"
    LOWER_FACE_SILENT = "no reading of the lower face"
    INSERTION_NOT_SEEN = "insertion not seen"
    BAND_TOO_WIDE = "band too wide"
    ANOTHER_PANEL = "another panel"
    NO_PANEL = "no panel in the press"
    RUN_REFUSED = "run refused"
    LIVE_SENSOR_SILENT = "live sensor silent"
    NO_ESTIMATE_YET = "no estimate yet"
    NO_SCANS = "no scans"
    CLOCK_AHEAD = "clock ahead"
    STORE_AWAY = "store away"
    NOT_PUBLISHED = "not published"

    @property
    def code(self) -> str:
        """Return the name of its words in the catalogues."""
        return f"reason-{self.value.replace(' ', '-')}"


@dataclass(frozen=True)
class Invalid:
    """A reason with its arguments; their names end in their units."""

    reason: InvalidReason
    arguments: Mapping[str, float | Message] = field(default_factory=dict)

    __repr__ = on_screen

    @property
    def line(self) -> str:
        """Return it as a cell of a table holds it.

        Examples
        --------
        >>> Invalid(InvalidReason.START_TEMPERATURE_CONTRADICTED, {"measured_C": 31.2, "header_C": 20.8}).line
        'start temperature contradicted; measured_C=31.2; header_C=20.8'
        """
        shown = (f"{n}={v:g}" if isinstance(v, float | int) else f"{n}={v}" for n, v in self.arguments.items())
        return "; ".join([self.reason.value, *shown])

    @property
    def message(self) -> Message:
        """Return it as a message for people."""
        return Message(self.reason.code, self.arguments)

    @property
    def stored(self) -> dict[str, Any]:
        """Return its arguments as JSON carries them."""
        arguments: dict[str, Any] = self.message.to_json()["arguments"]
        return arguments


def reason_message(reason: str, arguments: Mapping[str, Any] | None = None) -> Message:
    """Return what a stored reason says; a sentence of an older version stays as it is."""
    if reason not in set(InvalidReason):
        return Message("plain-text", {"text": reason})
    return Message.from_json({"code": InvalidReason(reason).code, "arguments": arguments or {}})
