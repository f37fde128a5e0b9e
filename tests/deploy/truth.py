"""What was done to an endurance run's plant, how long each may explain what is missing, and the plant itself.

It is kept beside the store, so that the balance of a finished run can be taken again.
"""

from __future__ import annotations

import bisect
import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from daq.drivers.polled import FOUND_AGAIN_S
from daq.records import Moments
from daq.simulated.press import VirtualPress, VirtualPressSettings
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
    temperatures: Callable[[float], Mapping[str, float]]
    """What the thermocouples gave at a moment of the plant's clock; asked for in the order of time. [s -> °C]"""
    core: Callable[[float], float]
    """The panel's core temperature at the moment asked for last, NaN without a panel. [s -> °C]"""

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


@dataclass(frozen=True)
class Record:
    """An endurance run's truth as it is kept in a file."""

    seed: int
    mornings: Sequence[tuple[float, int]]
    """As `PacedPress` has them."""
    knots: Sequence[tuple[float, float, float]]
    """As `PlantClock` has them."""
    shifts: Sequence[Shift]
    faults: Sequence[Fault]
    clock_steps: int
    ended_s: float
    """When the recorder was last asked to end, on the machine's monotonic clock. [s]"""

    def write(self, file: Path) -> None:
        """Keep it."""
        file.write_text(json.dumps(asdict(self)))

    @classmethod
    def read(cls, file: Path) -> Record:
        """Return what was kept."""
        kept = json.loads(file.read_text())
        shifts = [Shift(**shift) for shift in kept.pop("shifts")]
        faults = [Fault(**fault) for fault in kept.pop("faults")]
        return cls(**kept, shifts=shifts, faults=faults)

    def truth(self) -> Truth:
        """Press it all once more, without recording."""
        clock, press, again = PlantClock(self.knots), *(PacedPress(self.seed, self.mornings) for _ in range(2))
        ended_s = clock.at(self.ended_s)
        press.temperatures(ended_s)
        pressings = {n: true for n, true in press.pressed.items() if true.removed_s < ended_s - _LAST_S}
        return Truth(
            "lab",
            self.shifts,
            clock.at,
            self.faults,
            pressings,
            self.clock_steps,
            self.ended_s,
            again.temperatures,
            again.core,
        )


_LAST_S = 30.0
"""A pressing that ended so shortly before the recorder did need not be a finished run. [s of the press]"""


class PlantClock:
    """The press's time over the machine's monotonic clock: 0 until begun, at a changing pace, without a jump."""

    def __init__(self, knots: Sequence[tuple[float, float, float]] = ()) -> None:
        self.knots = list(knots)
        """Moments of the monotonic clock, the press's time there, and its pace from there on. [s, s, 1]"""

    def __call__(self) -> float:
        """Return the press's time now. [s]"""
        return self.at(time.monotonic())

    def at(self, real_s: float) -> float:
        """Return the press's time at a moment of the monotonic clock. [s]"""
        knots = self.knots
        i = bisect.bisect(knots, real_s, key=lambda knot: knot[0]) - 1
        if i < 0:
            return 0.0 if not knots else (real_s - knots[0][0]) * knots[0][2]
        since_s, then_s, speed = knots[i]
        return then_s + (real_s - since_s) * speed

    def run(self, speed: float) -> None:
        """Go on at this many times real speed."""
        now_s = time.monotonic()
        self.knots = [*self.knots, (now_s, self.at(now_s) if self.knots else 0.0, speed)]


class PacedPress:
    """The virtual press over the plant's clock: so many pressings, then idle until told to go on.

    Given the mornings of another one of the same seed, it presses the same again; ask it in the order of time.
    """

    def __init__(self, seed: int, mornings: Sequence[tuple[float, int]] = ()) -> None:
        self.mornings: list[tuple[float, int]] = []
        """When it was told to go on, and for how many pressings. [s]"""
        self._to_come = list(mornings)
        self._press = VirtualPress(VirtualPressSettings(between_s=(12.0, 16.0), keep=8), seed)
        self.ambient = self._press.ambient
        self.pressed: dict[int, Moments] = {}
        """Each pressing's true moments on the plant's clock. [s]"""
        self._lock = threading.Lock()
        self._newest = self._press.cycle(0.0)
        self._late_s = 0.0
        """Plant's clock minus the press's own."""
        self._last = 0
        self._held_s: float | None = 0.0

    @property
    def idle(self) -> bool:
        """Whether all pressings asked for are over."""
        return self._held_s is not None

    def go_on(self, at_s: float, pressings: int) -> None:
        """Press so many more panels from a moment of the plant's clock on."""
        with self._lock:
            self.mornings.append((at_s, pressings))
            self._late_s, self._held_s = at_s - self._own(at_s), None
            self._last = self._newest.number + pressings - 1
            self._keep()

    def temperatures(self, at_s: float) -> dict[str, float]:
        """Return what the thermocouples give. [°C]"""
        while self._to_come and at_s >= self._to_come[0][0]:
            self.go_on(*self._to_come.pop(0))
        with self._lock:
            return self._press.temperatures(self._own(at_s))

    def core(self, at_s: float) -> float:
        """Return the panel's core temperature, NaN without one. [°C]"""
        with self._lock:
            return self._press.core(self._own(at_s))

    def _own(self, at_s: float) -> float:
        own_s = max(at_s - self._late_s, 0.0)
        while self._held_s is None and own_s >= self._newest.end:
            self._newest = self._press.cycle(self._newest.end)
            if self._newest.number > self._last:
                self._held_s = 0.5 * (self._newest.start + self._newest.moments.inserted_s)
            else:
                self._keep()
        if self._held_s is None or own_s < self._held_s:
            return own_s
        # sensors hang free: this stretch of the press's time goes slowly to and fro
        aside = (own_s - self._held_s) / _SLOWED % (2.0 * _TO_AND_FRO_S)
        return self._held_s + _TO_AND_FRO_S - abs(aside - _TO_AND_FRO_S)

    def _keep(self) -> None:
        true, by_s = self._newest.moments, self._late_s
        self.pressed[self._newest.number] = replace(
            true,
            inserted_s=true.inserted_s + by_s,
            closed_s=true.closed_s + by_s,
            opened_s=true.opened_s + by_s,
            removed_s=true.removed_s + by_s,
        )


_TO_AND_FRO_S, _SLOWED = 0.3, 100.0
