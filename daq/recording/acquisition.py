"""Scans from loggers: one thread a logger, one schedule that does not drift, and no logger waits for another.

Every logger is asked at every tick. A scan takes what has arrived by then; a logger that has not answered
leaves its channels empty with the reason as their quality: what its last failure was, or ``late``. An answer
that comes after its tick's scan is used in the next scan, once, while it is younger than one and a half periods.

A scan's `utc` is when the replies came; its `monotonic_s` is when the values were converted on average, which
is up to half a second earlier in modules that convert one input after the other (`profile.Timing.age_s`).
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from daq.drivers import DataLogger, ReadFailure
from daq.records import Quality, Reading, Scan
from daq.supervision import SupervisedThread, unexpected
from daq.words import Message, say, spoken

Journal = Callable[[Literal["info", "warning", "alarm"], Message, Mapping[str, Any]], None]
"""Level, message, detail: for state changes only."""
_OLDEST_PERIODS = 1.5
"""A reading older than so many scan periods is not in a scan: a whole one, and half for a logger's own jitter.
By hand, 2026-11."""

# Numbers without another source were set by hand, 2026-11.

_FIRST_TICK_S = 0.05
"""The first tick lies so far ahead, for the loggers' threads to be there. [s]"""
_WAIT_PERIODS = 0.85
"""Answers are awaited for so many scan periods; the rest is for writing them. [periods]"""
_APART_S = 1e-4
"""Scans are at least so far apart, whatever the clock showed meanwhile: no two have one time. [s]"""
_LOST_AFTER_S = 3.0
"""A logger without an answer this long is called lost. [s]"""


def nine_digits(value: float) -> float:
    """Return a value to the nine digits that distinguish every 32-bit float (IEEE 754), more than a logger counts.

    A device's 363 tenths are 36.3 then and not the 36.300000000000004 of a product, which the store would keep.

    >>> nine_digits(363 * 0.1), nine_digits(363 * 0.1 - 0.42)
    (36.3, 35.88)
    """
    return float(f"{value:.9g}")


class LoggerThread:
    """Asks one logger at every tick and keeps its newest answer."""

    def __init__(self, name: str, logger: DataLogger, journal: Journal) -> None:
        self.name = name
        self.channels = logger.channels
        self.counters: Counter[str] = Counter()
        self.last_good_utc: datetime | None = None
        self.lost = False
        self.trouble: Message | None = None
        """Why the newest reading did not come about."""
        self._logger = logger
        self._journal = journal
        self._retired = False
        self._answer: tuple[int, Reading] | None = None
        self._failure = Quality.LATE
        self._good_s = time.monotonic()
        self.returned_s = time.monotonic()
        """When the driver last came back from its device, with an answer or the reason for none. [s]"""
        self._arrived: Callable[[], None] = lambda: None
        self._thread: SupervisedThread | None = None

    def start(
        self, ticks: Callable[[], Ticks], arrived: Callable[[], None], stop: threading.Event
    ) -> SupervisedThread:
        """Read in a thread of its own, by the schedule in force, until `stop`."""
        self._arrived = arrived

        def alarm(fault: Message) -> None:
            self._journal("alarm", fault, {"logger": self.name})

        self._thread = SupervisedThread(f"logger {self.name}", lambda: self._work(ticks, stop), alarm)
        self._thread.start()
        return self._thread

    @property
    def fault(self) -> Message | None:
        """What ended this logger's thread, until it reads again."""
        return None if self._thread is None else self._thread.fault

    def retire(self) -> None:
        """Read no more; the port is released by the next tick at the latest."""
        self._retired = True

    def _work(self, ticks: Callable[[], Ticks], stop: threading.Event) -> None:
        number = ticks().next_number()
        while not stop.wait(ticks().until(number)) and not self._retired:
            self._read(number)
            self._arrived()
            number = max(number + 1, ticks().next_number())
            if self._thread is not None:
                self._thread.worked()
        self._logger.close()

    def _read(self, number: int) -> None:
        try:
            reading = self._logger.read()
        except ReadFailure as failure:
            self._failed(spoken(failure), failure.cause, failure.quality)
        except Exception as error:  # noqa: BLE001 - a fault in one driver must not end its thread
            self._failed(unexpected(error), "driver fault", Quality.MISSING)
            return  # a broken driver has not come back: the watchdog may start the service anew
        else:
            self._answer = (number, reading)
            self._failure = Quality.LATE
            self.counters["good"] += 1
            self.last_good_utc = datetime.now(UTC)
            self._good_s = time.monotonic()
            self.trouble = None
            if self.lost:
                self.lost = False
                self._journal("info", say("logger-back", logger=self.name), {"logger": self.name})
        self.returned_s = time.monotonic()

    def _failed(self, why: Message, cause: str, quality: Quality) -> None:
        self.counters[cause] += 1
        self.trouble, self._failure = why, quality
        if not self.lost and time.monotonic() - self._good_s > _LOST_AFTER_S:
            self.lost = True
            self._journal(
                "warning",
                say("logger-lost", logger=self.name, why=why),
                {"logger": self.name, "cause": cause},
            )

    def has(self, tick: int) -> bool:
        """Whether the answer to this tick is there."""
        return self._answer is not None and self._answer[0] >= tick

    def take(self, not_before_s: float) -> tuple[Reading | None, Quality]:
        """Return the unused answer, or none and why."""
        answer, self._answer = self._answer, None
        if answer is None or answer[1].received_s < not_before_s:
            return None, self._failure
        return answer[1], Quality.GOOD

    def report(self) -> dict[str, Any]:
        """Return what the heartbeat says about this logger."""
        return {
            "name": self.name,
            "channels": [c.name for c in self.channels],
            "state": "lost" if self.lost else "answers",
            "message": str(self.trouble or ""),
            "message_code": None if self.trouble is None else self.trouble.to_json(),
            "last_good_utc": None if self.last_good_utc is None else self.last_good_utc.isoformat(),
            "counters": dict(self.counters),
        }


@dataclass(frozen=True)
class Ticks:
    """Moments of the monotonic clock, evenly spaced for ever."""

    start_s: float
    period_s: float
    first: int = 0
    """The number of the tick at `start_s`."""

    def at(self, number: int) -> float:
        """Return the moment of a tick. [s]"""
        return self.start_s + (number - self.first) * self.period_s

    def until(self, number: int) -> float:
        """Return how long a tick is away, 0 where it is past. [s]"""
        return max(0.0, self.at(number) - time.monotonic())

    def next_number(self) -> int:
        """Return the first tick that is still to come."""
        return self.first + max(0, math.ceil((time.monotonic() - self.start_s) / self.period_s))


class ClockWatch:
    """Notices when somebody sets the wall clock: it then runs away from the monotonic one."""

    def __init__(self, speed: float = 1.0, least_s: float = 0.5) -> None:
        self._speed, self._least_s = speed, least_s
        self._offset_s: float | None = None

    def step(self, scan: Scan) -> float | None:
        """Return by how much the clock was set since the scan before, None where it was not. [s]"""
        offset_s = scan.utc.timestamp() - scan.monotonic_s / self._speed
        before, self._offset_s = self._offset_s, offset_s
        if before is None or abs(offset_s - before) < self._least_s:
            return None
        return offset_s - before


class Scanner:
    """All loggers of one press: `scan` gives one scan a tick."""

    def __init__(self, loggers: Sequence[LoggerThread], period_s: float, speed: float, first_number: int) -> None:
        self.loggers = tuple(loggers)
        self.missed_ticks = 0
        self.left_out = 0
        """Ticks that went by without a scan right before the newest one: this machine was too busy."""
        self._skipped = 0
        self._ticks = Ticks(time.monotonic() + _FIRST_TICK_S, period_s)
        self._speed = speed
        self._number = first_number
        self._tick = 0
        self._last_s = -math.inf
        self._last_scan_s = -math.inf
        self._arrived = threading.Condition()
        self._threads: list[SupervisedThread] = []

    def start(self, stop: threading.Event) -> None:
        """Start the loggers' threads."""
        self._threads = [x.start(lambda: self._ticks, self._notify, stop) for x in self.loggers]

    def change(self, loggers: Sequence[LoggerThread], period_s: float, stop: threading.Event) -> None:
        """Go on from the next tick with other loggers or another period; loggers kept are not disturbed.

        Call it between two scans, from the thread that scans.
        """
        self._ticks = Ticks(self._ticks.at(self._tick), period_s, self._tick)
        before, self.loggers = self.loggers, tuple(loggers)
        for logger in before:
            if logger not in loggers:
                logger.retire()
        self._threads = [t for t in self._threads if t.alive] + [
            x.start(lambda: self._ticks, self._notify, stop) for x in loggers if x not in before
        ]

    def join(self, longest_s: float) -> None:
        """Wait for the loggers' threads to end."""
        deadline = time.monotonic() + longest_s
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _notify(self) -> None:
        with self._arrived:
            self._arrived.notify_all()

    def scan(self, stop: threading.Event) -> Scan | None:
        """Wait for the next tick and its answers; None when stopped."""
        if stop.wait(self._ticks.until(self._tick)):
            return None
        period = self._ticks.period_s
        end = self._ticks.at(self._tick) + _WAIT_PERIODS * period
        with self._arrived:
            self._arrived.wait_for(
                lambda: stop.is_set() or all(x.has(self._tick) or x.lost for x in self.loggers),
                max(0.0, end - time.monotonic()),
            )
        scan = self._assemble(self._ticks.at(self._tick) - _OLDEST_PERIODS * period)
        self._number += 1
        following = max(self._tick + 1, self._ticks.next_number())
        self.left_out, self._skipped = self._skipped, following - self._tick - 1
        self.missed_ticks += self._skipped
        self._tick = following
        return scan

    def _assemble(self, not_before_s: float) -> Scan:
        values: list[float] = []
        qualities: list[Quality] = []
        middles: list[float] = []
        for logger in self.loggers:
            reading, why = logger.take(not_before_s)
            if reading is None:
                values += [math.nan] * len(logger.channels)
                qualities += [why] * len(logger.channels)
            else:
                values += map(nine_digits, reading.values)
                qualities += reading.qualities
                middles.append(0.5 * (reading.requested_s + reading.received_s))
        now_s, utc = time.monotonic(), datetime.now(UTC)
        measured_s = sum(middles) / len(middles) if middles else self._ticks.at(self._tick)
        at_s = max(min(measured_s, now_s), self._last_s + _APART_S)
        self._last_s = at_s
        utc = datetime.fromtimestamp(utc.timestamp() - (now_s - at_s), UTC)
        converted_s = max(at_s * self._speed - self._age_s, self._last_scan_s + _APART_S)
        self._last_scan_s = converted_s
        return Scan(self._number, utc, round(converted_s, 6), tuple(values), tuple(qualities))

    @property
    def period_s(self) -> float:
        """The time from tick to tick. [s]"""
        return self._ticks.period_s

    @property
    def _age_s(self) -> float:
        """How old values are at the reply; the same whether or not a logger answers, so that time goes evenly."""
        ages = [c.age_s for logger in self.loggers for c in logger.channels]
        return sum(ages) / len(ages) if ages else 0.0
