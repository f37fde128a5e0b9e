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
    """No sensor and no wire shows what the press does."""
    PLATEN_READING_MISSING = "platen reading missing"
    """A platen has not been read for too long."""
    PLATENS_MISSING_AT_INSERTION = "platen reading missing at insertion"
    """A platen was not read when the panel came."""
    START_TEMPERATURE_CONTRADICTED = "start temperature contradicted"
    """The faces began at another temperature than the header says."""
    START_TEMPERATURE_TOO_HIGH = "start temperature too high"
    """The header's start temperature is none of a panel that waits."""
    BEGINS_CLOSED = "run begins in the closed press"
    """What was before the first scan is not known."""
    BEGINS_ON_HOT_PLATE = "run begins with the panel on the hot plate"
    """The panel has lain on the hot plate for an unknown time."""
    CLOSED_AGAIN = "press closed again on the same panel"
    """Without panel sensors nothing shows whether another panel is in the press."""
    CLOSED_IN_GAP = "press closed during a gap"
    """When the press closed is not known well enough."""
    JUMPED_IN_GAP = "faces jumped during a gap"
    """Both faces moved far while they were not read."""
    PANEL_NOT_SEEN = "panel not seen in the open press"
    """No face has been read since the press opened."""
    OTHER_PANEL = "faces too cold for this panel"
    """The faces are colder than this panel's can be."""
    READINGS_CONTRADICT_MODEL = "readings contradict the model"
    """The model misses the faces by more than it can."""
    CONSTANTS_UNKNOWN = "constants far from the material"
    """A constant of the header is too far from its material's."""
    IMPOSSIBLE_CORE = "core impossible"
    """The core would be hotter or colder than anything that touched it."""
    CALCULATION_FAILED = "calculation failed"
    """The numbers left what can be computed."""
    LOWER_FACE_SILENT = "no reading of the lower face"
    """A panel may lie in the press unseen."""
    INSERTION_NOT_SEEN = "insertion not seen"
    """When the panel came is not known."""
    BAND_TOO_WIDE = "band too wide"
    """The core is known too badly to be of use."""
    ANOTHER_PANEL = "another panel"
    """A panel of another thickness may lie there, with another core."""
    NO_PANEL = "no panel in the press"
    """There is no core to be known."""
    RUN_REFUSED = "run refused"
    """The run's header or columns do not fit the press."""
    LIVE_SENSOR_SILENT = "live sensor silent"
    """The process that estimates gives no sign of life."""
    NO_ESTIMATE_YET = "no estimate yet"
    """The first scans of a run have come, their estimate has not."""
    NO_SCANS = "no scans"
    """Nothing is recorded."""
    CLOCK_AHEAD = "clock ahead"
    """What was stored last is of a time to come."""
    STORE_AWAY = "store away"
    """The store cannot be read."""
    NOT_PUBLISHED = "not published"
    """The feed to the plant stands still."""

    @property
    def code(self) -> str:
        """Return the name of its words in the catalogues."""
        return f"reason-{self.value.replace(' ', '-')}"


@dataclass(frozen=True)
class Invalid:
    """A reason with its arguments; their names end in their units."""

    reason: InvalidReason
    """Which of the set."""
    arguments: Mapping[str, float | Message] = field(default_factory=dict)
    """Its numbers by name."""

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
