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
    """Nothing has shown yet whether the press is open or closed."""
    PLATEN_READING_MISSING = "platen reading missing"
    """A measured platen has not been read yet, or for longer than its last reading is held."""
    PLATENS_MISSING_AT_INSERTION = "platen reading missing at insertion"
    """A platen was first read when the panel had lain in the press for some seconds."""
    START_TEMPERATURE_CONTRADICTED = "start temperature contradicted"
    """The colder face, where it was first read, was not at the start temperature that the header gives."""
    START_TEMPERATURE_TOO_HIGH = "start temperature too high"
    """The header gives a start temperature that no fresh panel has."""
    START_NOT_READ = "start not read"
    """The press file has the run begin at its first readings, and there is none yet."""
    BEGINS_CLOSED = "run begins in the closed press"
    """The press had closed by the first scan that shows the platens: how long before, nobody knows."""
    BEGINS_ON_HOT_PLATE = "run begins with the panel on the hot plate"
    """In the first scan the lower face was hot already, and the panel came well before it."""
    CLOSED_AGAIN = "press closed again on the same panel"
    """After opening it closed once more, and without panel sensors nothing shows on which panel."""
    CLOSED_IN_GAP = "press closed during a gap"
    """It closed in a gap between scans so long that the moment is not known well enough."""
    JUMPED_IN_GAP = "faces jumped during a gap"
    """Before the press closed, both faces moved far while they were not read."""
    PANEL_NOT_SEEN = "panel not seen in the open press"
    """The press is open again, and for too long no face has been read: the panel may be gone."""
    OTHER_PANEL = "faces too cold for this panel"
    """After the opening a face reads far less than this panel's would: another one may lie there."""
    READINGS_CONTRADICT_MODEL = "readings contradict the model"
    """The faces are further from what the model expects, or change more across a gap, than its doubts allow."""
    CONSTANTS_UNKNOWN = "constants far from the material"
    """A constant of the panel is known to no better than half of it: the header, its material and the last runs
    differ so much."""
    IMPOSSIBLE_CORE = "core impossible"
    """The core comes out hotter or colder than anything that has touched the panel."""
    CALCULATION_FAILED = "calculation failed"
    """The calculation failed at this scan: it begins anew, or the scan is passed over."""
    LOWER_FACE_SILENT = "no reading of the lower face"
    """Before the pressing the lower face has not been read for too long: a panel may lie there unseen."""
    INSERTION_NOT_SEEN = "insertion not seen"
    """The lower face is hot as under a panel that nobody saw come, or the moment it came is not settled yet."""
    BAND_TOO_WIDE = "band too wide"
    """The band of 95 % is too wide for the core to be of use."""
    ANOTHER_PANEL = "another panel"
    """The band is too wide since an earlier run was of another thickness than the header gives, and either may
    lie there."""
    NO_PANEL = "no panel in the press"
    """Between two pressings: there is no core to be known."""
    RUN_REFUSED = "run refused"
    """The run's header or columns do not fit the press, or its record in the store is damaged."""
    LIVE_SENSOR_SILENT = "live sensor silent"
    """Scans are of now and the newest estimate is not."""
    NO_ESTIMATE_YET = "no estimate yet"
    """The store has no estimate yet, or none of the run that is being pressed."""
    ESTIMATE_BEHIND = "estimate behind the press"
    """The press has moved, and the newest estimate is of the state before."""
    NO_SCANS = "no scans"
    """The newest scan is not of now: nothing is being recorded."""
    CLOCK_AHEAD = "clock ahead"
    """The newest scan is stamped ahead of this computer's clock."""
    STORE_AWAY = "store away"
    """The feed to the plant cannot read the store."""
    NOT_PUBLISHED = "not published"
    """The feed to the plant has ended or lost the broker, which says so in its place."""

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
