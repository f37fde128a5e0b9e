"""When a run begins and ends: press events and scans in, runs out. No clock, no store.

A run begins some seconds before the panel's insertion (the scans are stored already, so only their
numbers are noted) and ends some seconds after its removal.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from statistics import median
from typing import Any

from daq.press.detector import HAND_C
from daq.press.moments import BEFORE_S
from daq.records import LONGEST_WAIT_S, PressEvent, PressEventKind, Scan
from daq.store.records import NewRun, RunEnd, RunStatus

# Numbers without another source were set by hand, 2026-11.

_SETTLED_S, _SETTLED_SCANS = 3.0, 3
"""The panel's start temperature is what its sensors showed in the last scans before the insertion."""


_SPARE_S = 60.0
"""Scans are kept for so long beyond a run: what happened is known later, and runs follow each other. [s]"""
UNSEEN_S = LONGEST_WAIT_S + _SETTLED_S
"""A run whose panel no sensor showed coming, since none was read or only the closing showed it, begins this long
before: with the scans before the earliest insertion that can have been. [s]"""


@dataclass(frozen=True)
class RunRules:
    """How runs are cut from the scans of a press; the times are those of its `PressSettings`."""

    press: str
    pre_trigger_s: float
    post_removal_s: float
    longest_run_s: float
    header: Mapping[str, Any] = field(default_factory=dict)
    configuration: str = ""


class RunNames:
    """The names runs would like, ``press-2026-03-04-07``: numbers count up within a UTC day.

    The store gives the next free one where a name is taken: the clock was set back, a run was imported.

    Where nobody knows the next free number (the store is away), runs are named by their time of day:
    ``press-2026-03-04-t071523``.
    """

    def __init__(self, press: str, next_free: str | None) -> None:
        self._press, self._counts = press, next_free is not None
        self._day, _, number = (next_free or f"{press}--0").removeprefix(f"{press}-").rpartition("-")
        self._number = int(number)

    def take(self, started_utc: datetime) -> str:
        """Return the name of a run that starts then."""
        day = f"{started_utc:%Y-%m-%d}"
        if not self._counts:
            return f"{self._press}-{day}-t{started_utc:%H%M%S}"
        if day != self._day:
            self._day, self._number = day, 1
        name = f"{self._press}-{day}-{self._number:02d}"
        self._number += 1
        return name


@dataclass(frozen=True)
class _RecentScan:
    number: int
    monotonic_s: float
    scan: Scan
    panel_celsius: float
    warmest_celsius: float
    """Of the panel's sensors but one, which may be broken."""


Change = tuple[NewRun | None, RunEnd | None]
"""A run that begins, or one that ends."""


class RunKeeper:
    """Follows one press and says when its runs begin and end."""

    def __init__(self, rules: RunRules, names: RunNames, panel_places: Sequence[int]) -> None:
        self.rules = rules
        self.open_run: str | None = None
        self._names = names
        self._places = tuple(panel_places)
        self._recent: deque[_RecentScan] = deque()
        self._zero = 0.0
        self._first = 0
        self._last = -1
        self._removed: float | None = None

    def change(self, rules: RunRules, panel_places: Sequence[int]) -> None:
        """Cut the next runs by other rules, from scans with other columns."""
        self.rules, self._places = rules, tuple(panel_places)

    def take(self, scan: Scan, events: Sequence[PressEvent]) -> list[Change]:
        """Return what begins and ends with this scan, in order."""
        self._remember(scan)
        changes: list[Change] = []
        for event in events:
            if event.kind is PressEventKind.INSERTED:
                begin = self._begin(event, at_closing=any(e.kind is PressEventKind.CLOSED for e in events))
                if begin is None:
                    continue
                if self.open_run is not None:
                    changes.append((None, self._end(begin.first_scan - 1, scan, RunStatus.CLOSED)))
                self.open_run, self._zero, self._removed = begin.run, begin.zero_monotonic_s, None
                self._first = begin.first_scan
                changes.append((begin, None))
            elif event.kind is PressEventKind.REMOVED:
                self._removed = event.monotonic_s
        if self.open_run is not None and self._over(scan):
            last = self._last_of_run(scan)
            changes.append((None, self._end(last.number, last, RunStatus.CLOSED)))
        return changes

    def _last_of_run(self, scan: Scan) -> Scan:
        """Return the last scan before the removal's margin is over: a removal is noticed late."""
        if self._removed is None:
            return scan
        over = self._removed + self.rules.post_removal_s
        return next((s.scan for s in reversed(self._recent) if s.monotonic_s <= over), scan)

    def stop(self) -> RunEnd | None:
        """Return the end of a run that recording leaves unfinished."""
        if self.open_run is None or not self._recent:
            return None
        last = self._recent[-1]
        return self._end(last.number, last.scan, RunStatus.INTERRUPTED)

    def _over(self, scan: Scan) -> bool:
        if self._removed is not None and scan.monotonic_s >= self._removed + self.rules.post_removal_s:
            return True
        return scan.monotonic_s - self._zero > self.rules.longest_run_s

    def _end(self, last_scan: int, scan: Scan, status: RunStatus) -> RunEnd:
        run, self.open_run = self.open_run or "", None
        self._last = max(last_scan, self._first)
        return RunEnd(run, self._last, scan.utc, status, self._first)

    def _begin(self, event: PressEvent, *, at_closing: bool) -> NewRun | None:
        """Return the run an insertion begins; None where no scan is free for it.

        `at_closing` says that the insertion was only concluded from the closing.
        """
        early = event.monotonic_s - self.rules.pre_trigger_s
        before = [s.panel_celsius for s in self._recent if early <= s.monotonic_s < event.monotonic_s - BEFORE_S]
        if at_closing or not any(level == level for level in before):
            early = event.monotonic_s - max(self.rules.pre_trigger_s, UNSEEN_S)
        taken = self._first if self.open_run is not None else self._last
        free = [s for s in self._recent if s.number > taken]
        if not free:
            return None
        first = next((s for s in free if s.monotonic_s >= early), free[-1])
        settled = [
            s
            for s in self._recent
            if event.monotonic_s - _SETTLED_S <= s.monotonic_s < event.monotonic_s - BEFORE_S
            and s.panel_celsius == s.panel_celsius
        ][-_SETTLED_SCANS:]
        lay_there = at_closing and any(s.warmest_celsius > HAND_C for s in settled)  # before recording began
        header = dict(self.rules.header)
        if settled and not lay_there:
            header.setdefault("panel.initial_temperature_C", round(median(s.panel_celsius for s in settled), 2))
        name = self._names.take(first.scan.utc)
        return NewRun(name, first.number, first.scan.utc, first.monotonic_s, header, self.rules.configuration)

    def _remember(self, scan: Scan) -> None:
        usable = sorted(scan.values[i] for i in self._places if scan.qualities[i].usable)
        level, warmest = (median(usable), usable[-2:][0]) if usable else (math.nan, math.nan)
        self._recent.append(_RecentScan(scan.number, scan.monotonic_s, scan, level, warmest))
        keep = max(self.rules.pre_trigger_s, UNSEEN_S) + self.rules.post_removal_s + _SPARE_S
        while self._recent[0].monotonic_s < scan.monotonic_s - keep:
            self._recent.popleft()
