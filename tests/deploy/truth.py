"""What was done to an endurance run's plant, and how long each of it may explain what is missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from daq.drivers.polled import FOUND_AGAIN_S
from daq.records import Moments
from daq.store.outbox import _LONGEST_RETRY_S

RESTARTED = "recorder ended in order"
KILLED = "recorder killed"
UNWRITTEN_S = 2.0
"""So shortly before a kill a scan may still be on its way to the store; longer where that was away. [s]"""
STAMP_S = 0.25
"""How far the newest stamp of a recorder at work may lie back on a busy machine. [s]"""


@dataclass(frozen=True)
class Fault:
    """One fault, on the machine's monotonic clock. [s]"""

    kind: str
    begin_s: float
    """Of a logger: its last sound answer before."""
    end_s: float
    """Of a lost logger: from here on it would answer; of a dead sensor: first sound answers of its logger."""
    columns: tuple[str, ...] = ()
    """What it spoils."""


@dataclass(frozen=True)
class Shift:
    """Scans of one pace, from one number on."""

    first_scan: int
    speed: float
    rate_hz: float


@dataclass(frozen=True)
class Truth:
    """What truly happened; pressings on the plant's clock. [s of the press]"""

    press: str
    shifts: Sequence[Shift]
    plant_s: Callable[[float], float]
    """The plant's clock at a moment of the machine's monotonic one."""
    faults: Sequence[Fault]
    pressings: Mapping[int, Moments]
    clock_steps: int
    ended_s: float
    """When the recorder was last asked to end, on the machine's monotonic clock. [s]"""

    def during(self, kind: str, begin_s: float, end_s: float, column: str = "") -> bool:
        """Whether a fault of a kind lies over a stretch of the machine's monotonic clock, and spoils a column."""
        return any(
            f.kind == kind and f.begin_s <= end_s and begin_s <= f.end_s and (not column or column in f.columns)
            for f in self.faults
        )

    def wrote_until(self, begin_s: float, end_s: float) -> tuple[str, float] | None:
        """Return how the recorder ended in a stretch, and up to when all of its scans must be in the store. [s]"""
        ends = [
            f for f in self.faults if f.kind in (KILLED, RESTARTED) and f.begin_s <= end_s and begin_s <= f.end_s
        ]
        if not ends:
            return None
        end = min(ends, key=lambda f: f.begin_s)
        if end.kind == RESTARTED:
            return RESTARTED, end.begin_s - STAMP_S
        away = [
            f.begin_s
            for f in self.faults
            if f.kind == "store away" and f.begin_s <= end.begin_s <= f.end_s + _LONGEST_RETRY_S + UNWRITTEN_S
        ]
        return KILLED, min([end.begin_s, *away]) - UNWRITTEN_S

    def finding_again(self, column: str, at_s: float, good_s: float) -> bool:
        """Whether the driver may still be looking for a lost logger that is back, no value good since. [s]"""
        return any(
            f.kind == "logger lost"
            and column in f.columns
            and good_s <= f.end_s <= at_s <= f.end_s + FOUND_AGAIN_S
            for f in self.faults
        )
