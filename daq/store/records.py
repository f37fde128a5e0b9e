"""What the store hands out and takes in, beyond the shared vocabulary. Frozen data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Generic, Literal, TypeVar

from daq.records import Channel, InputError, Moments, PressState, Scan
from daq.words import Message

T = TypeVar("T")
AT_ONCE = 500
"""Rows that one query asks for, one transaction writes or one page holds: some 0.1 s, so that others wait no
longer. By hand, 2026-11."""
SCANS_AT_ONCE = 2000
"""Scans held at a time: some megabytes of 16 channels. By hand, 2026-11."""


class StoreUnavailable(RuntimeError):
    """The store cannot do it now: locked, full, read-only, unreachable. The text says what to do."""


class NotAStore(StoreUnavailable):
    """The file is no store, or its first page is destroyed. The text says what to do."""


class PressGone(StoreUnavailable):
    """The store is another one than was written to before: it does not have the presses. The text names one."""

    def __init__(self, what: Message, keys: Sequence[PressKey]) -> None:
        super().__init__(what)
        self.keys = keys


class NumbersTaken(StoreUnavailable):
    """Another recorder has written other scans of a press under the same numbers. The text says so."""

    def __init__(self, what: Message, key: PressKey, newest: int) -> None:
        super().__init__(what)
        self.key = key
        self.newest = newest
        """The newest scan of the press in the store."""


class ScansUnreadable(InputError):
    """What is stored of a run cannot be read any more. The text says of which, where, and what to do."""


class ArchiveUnreadable(ScansUnreadable):
    """A file of the archive is missing or is not what was written. The text says which and what to do."""


class RunStatus(StrEnum):
    """The life of a run."""

    OPEN = "open"
    CLOSED = "closed"
    INTERRUPTED = "interrupted"


class ModelStatus(StrEnum):
    """What has become of a model version."""

    CANDIDATE = "candidate"
    PROMOTED = "promoted"
    RETIRED = "retired"
    REJECTED = "rejected"


@dataclass(frozen=True)
class PressKey:
    """A registered press: what a recorder needs to append to it."""

    press_id: int
    name: str
    layout_id: int
    channels: tuple[Channel, ...]
    next_number: int
    """The number the next scan gets; numbers go on over restarts."""


@dataclass(frozen=True)
class NewRun:
    """A run to open: its first scan may lie back in time (pre-trigger)."""

    run: str
    """The name it would like; the store gives the next free one where that is taken."""
    first_scan: int
    started_utc: datetime
    zero_monotonic_s: float
    header: Mapping[str, Any] = field(default_factory=dict)
    configuration: str = ""
    """The settings in force, as text."""


@dataclass(frozen=True)
class RunEnd:
    """A run to close."""

    run: str
    last_scan: int
    ended_utc: datetime
    status: RunStatus = RunStatus.CLOSED
    first_scan: int | None = None
    """What a run of a press is known by, whatever its name; None: its name is the one it has in the store."""


@dataclass(frozen=True)
class RunRecord:
    """One run as lists show it; `Store.load_run` gives its data."""

    number: int
    run: str
    press: str
    kind: Literal["recorded", "imported"]
    status: RunStatus
    started_utc: datetime | None
    """None where it is not known."""
    ended_utc: datetime | None
    first_scan: int
    last_scan: int | None
    """None while the run is open."""
    zero_monotonic_s: float
    moments: Moments
    """As the recorder found them live; NaN where not (yet) known."""
    header: Mapping[str, Any]
    remark: str
    software_version: str
    damage: Message | None = None
    """Why header and remark, empty then, cannot be read any more, and what to do; lists show the run."""


@dataclass(frozen=True)
class RunChange:
    """One edit of a run's metadata."""

    utc: datetime
    who: str
    field: str
    before: Any
    after: Any


@dataclass(frozen=True)
class ScanBatch:
    """Consecutive scans that share their channels; empty when there is nothing new."""

    channels: tuple[Channel, ...]
    scans: tuple[Scan, ...]
    damaged: tuple[int, ...] = ()
    """Numbers of those that cannot be read any more, and have no value here."""


@dataclass(frozen=True)
class StoredEstimate:
    """The live sensor's estimate at one scan."""

    number: int
    """The scan it belongs to."""
    monotonic_s: float
    state: PressState | Literal["unknown"]
    core_celsius: float
    core_sd_kelvin: float
    core_low_celsius: float
    core_high_celsius: float
    valid: bool
    reason: str = ""
    model_version: str = ""
    detail: Mapping[str, Any] | None = None
    """Anything else worth keeping, as JSON: innovations, predicted surfaces."""


@dataclass(frozen=True)
class StoredPressEvent:
    """A press event with its row number, for followers."""

    number: int
    press: str
    kind: str
    utc: datetime | None
    monotonic_s: float
    noticed_s: float
    scan_number: int
    source: str


@dataclass(frozen=True)
class CoefficientRecord:
    """One coefficient of one fit."""

    fit_number: int
    run: str
    started_utc: datetime | None
    name: str
    value: float
    sd: float
    low: float
    high: float
    identifiable: bool
    model_version: str


@dataclass(frozen=True)
class ModelRecord:
    """One model version: the JSON of the model file and what became of it."""

    number: int
    version: str
    press: str
    created_utc: datetime
    status: ModelStatus
    reason: str
    model: Mapping[str, Any]


@dataclass(frozen=True)
class StoredDiagnosis:
    """One diagnosis as `kerntemp diagnose --json` writes it."""

    number: int
    press: str
    created_utc: datetime
    verdict: str
    diagnosis: Mapping[str, Any]


@dataclass(frozen=True)
class StoredNight:
    """What the nightly job did for one press, as JSON, and what the next one goes on from."""

    press: str
    started_utc: datetime
    ended_utc: datetime
    night: Mapping[str, Any]
    progress: Mapping[str, Any]
    number: int = 0
    """Given by the store."""


@dataclass(frozen=True)
class Archive:
    """The folder that old runs' scans are moved to, and what it holds."""

    folder: str
    runs: int
    """Whose scans are there."""
    scans: int
    """Ever moved there."""
    bytes: int
    removed: int
    """Runs whose scans are no longer kept: their pressings are."""
    unsound: int
    """Files found missing or damaged."""


@dataclass(frozen=True)
class Moved:
    """A run whose scans went into the archive."""

    scans: int
    file_bytes: int
    freed_bytes: int
    """Of what the store held of them, without its pages' own needs."""


@dataclass(frozen=True)
class StandingAlarm:
    """A condition somebody should know of, as it is found now."""

    key: str
    """What it is about, the same as long as it stands: no figures that change."""
    press: str | None
    message: Message


@dataclass(frozen=True)
class StoredAlarm:
    """An alarm as it was raised, and what became of it."""

    number: int
    press: str | None
    message: Message
    raised_utc: datetime
    ended_utc: datetime | None
    """None while it stands, and for a minute of calm after it."""
    acknowledged_utc: datetime | None
    acknowledged_by: str | None
    key: str
    """What it is about, the same as long as it stands."""
    seen_utc: datetime
    """When it was last found to stand."""


@dataclass(frozen=True)
class Delivery:
    """An alarm on its way to somebody, in the hands of this process."""

    alarm: StoredAlarm
    way: str
    tries: int
    """With this one."""


@dataclass(frozen=True)
class Thresholds:
    """The limits an engineer has set for a press."""

    press: str
    utc: datetime
    who: str
    limits: Mapping[str, Any]


@dataclass(frozen=True)
class JournalEntry:
    """One line of the journal: an alarm, a loss, a change of state, who did what."""

    number: int
    utc: datetime
    level: Literal["info", "warning", "alarm"]
    process: str
    press: str | None
    message: Message
    """Lines of older versions are `plain-text`."""
    detail: Mapping[str, Any] | None


@dataclass(frozen=True)
class RunCore:
    """The live sensor's estimate of a run's core in three numbers; NaN where none was valid."""

    at_opening_celsius: float
    band_at_opening_kelvin: float
    """Width of the 95 % band."""
    highest_celsius: float


@dataclass(frozen=True)
class NextPanel:
    """What is stated of the panels to come at a press."""

    press: str
    utc: datetime
    who: str
    recipe: str
    """Empty without one."""
    header: Mapping[str, Any]


@dataclass(frozen=True)
class ProcessStatus:
    """The newest sign of life of a process."""

    process: str
    utc: datetime
    status: Mapping[str, Any]


def in_status(problems: Sequence[Message], else_: Message) -> dict[str, Any]:
    """Return how a sign of life says what is wrong, or else how it goes: in English, and as codes for the faces.

    ``message`` and ``problems`` are texts; ``message_codes`` and ``problem_codes`` hold `Message.to_json` of each.
    """
    messages = problems or [else_]
    return {
        "message": "; ".join(map(str, messages)),
        "message_codes": [one.to_json() for one in messages],
        "problems": [str(one) for one in problems],
        "problem_codes": [one.to_json() for one in problems],
    }


@dataclass(frozen=True)
class Page(Generic[T]):
    """Part of a list, newest first, and where the next part begins."""

    items: tuple[T, ...]
    next_cursor: str | None


def every(page_at: Callable[[str | None], Page[T]]) -> Iterator[T]:
    """Yield a whole list, page by page.

    Parameters
    ----------
    page_at
        Returns the page at a cursor, None for the first.
    """
    cursor: str | None = None
    while True:
        page = page_at(cursor)
        yield from page.items
        cursor = page.next_cursor
        if cursor is None:
            return
