"""The times of a foreign file's rows: numbers, clocks that pass midnight, local times of a zone; they rise."""

from __future__ import annotations

import math
import re
import statistics
from collections import deque
from collections.abc import Collection
from datetime import UTC, date, datetime, time
from functools import lru_cache
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from daq.files.mapping_tables import FileTable, Mapped, TimeTable
from daq.records import InputError
from daq.tables import at
from daq.words import say

_SECONDS = {"milliseconds": 1e-3, "seconds": 1.0, "minutes": 60.0, "hours": 3600.0}
_DAY_S = 86400.0
"""By definition; a clock that jumps back by more than half of it has passed midnight. [s]"""
_LATE_STEPS = 10
"""What lies further back than so many of a file's own steps is no row that came late: with one a second a pause
is read wrong where it lasts the hour but for 10 s. Its own step is the median of as many. By hand, 2026-11."""
_SOME_DAY, _SOME_OTHER, _NO_DAY = date(2034, 11, 29), date(2033, 10, 27), date(1900, 1, 1)
"""A day whose year, month and day differ in every spelling, one that differs from it in all, weekday and week too,
and Python's where a text gives none."""


class RowTimes:
    """The times of a file's rows, one after the other; they rise by microseconds at least: the store counts those.

    Parameters
    ----------
    path, mapped
        The file, and its mapping.
    """

    def __init__(self, path: Path, mapped: Mapped) -> None:
        self._path, self._mapped = path, mapped
        self._start, self._days, self._before, self._kept = math.nan, 0.0, -math.inf, -math.inf
        self._steps: deque[float] = deque(maxlen=_LATE_STEPS)
        self._daily, self._counted = is_daily(mapped.time.format), mapped.time.format in _SECONDS

    def of(self, line: int, cell: str) -> float | None:
        """Return the time of the next row, None for one that is left out. [s]

        Raises
        ------
        InputError
            Naming line, column and cell of what is no time, or does not rise.
        """
        time_s = _time(self._path, line, cell, self._mapped, self._before, self._steps) + self._days
        if self._daily:
            another_day_s = _of_another_day(time_s, self._before, self._steps)
            self._days, time_s = self._days + max(another_day_s, 0.0), time_s + another_day_s
        if self._start != self._start:
            self._start = time_s if self._mapped.time.from_zero or not self._counted else 0.0
        rounded = round(time_s - self._start, 6)
        if not self._kept < rounded < math.inf:
            if self._mapped.time.repeated == "first":
                return None
            named = " + ".join(self._mapped.time.columns)
            raise InputError(at(self._path, say("foreign-time-falls", cell=repr(cell)), line=line, column=named))
        if self._before > -math.inf:
            self._steps.append(time_s - self._before)
        self._before, self._kept = time_s, rounded
        return rounded


def _of_another_day(time_s: float, before: float, steps: Collection[float]) -> float:
    """Return what a time of day lacks: a day once a clock has passed midnight, less a day for a row of before it.

    Late is what lies back by few of the file's own steps.
    """
    if time_s < before - 0.5 * _DAY_S:
        return _DAY_S
    return -_DAY_S if 0.0 <= before + _DAY_S - time_s <= _few(steps) else 0.0


def _few(steps: Collection[float]) -> float:
    """Return how far back a row may lie that came late. [s]"""
    return _LATE_STEPS * statistics.median(steps) if steps else 0.0


def _time(
    path: Path, line: int, cell: str, mapped: Mapped, before: float = -math.inf, steps: Collection[float] = ()
) -> float:
    layout = mapped.time.format
    try:
        if layout in _SECONDS:
            time_s = float(plain(cell, mapped.file)) * _SECONDS[layout]
        elif not cell.isascii() and any(sign.isdigit() and not sign.isascii() for sign in cell):
            raise ValueError(cell)
        elif layout == "clock":
            time_s = _since_midnight(cell, mapped.file)
        else:
            time_s = _instant(_moment(cell, layout), mapped.time, before, steps)
        if not math.isfinite(time_s):
            raise ValueError(cell)
    except (ValueError, OverflowError) as error:
        named = " + ".join(mapped.time.columns)
        problem = say("foreign-time-format", cell=repr(cell), format=layout)
        if cell.strip() in mapped.file.missing:
            problem = say("foreign-time-missing", cell=repr(cell))
        raise InputError(at(path, problem, line=line, column=named)) from error
    return time_s


def _since_midnight(cell: str, file: FileTable) -> float:
    """Return what a clock shows in seconds; hours may go on past a day. Raises `ValueError`."""
    hours, minutes, seconds = cell.replace("_", "?").split(":")  # Python takes 1_0 for 10
    whole, of_hour, of_minute = int(hours), int(minutes), float(plain(seconds, file))
    in_hours, in_minutes, in_seconds = 3600.0 * whole, 60.0 * of_hour, of_minute
    if whole < 0 or not 0.0 <= in_minutes < _SECONDS["hours"] or not 0.0 <= in_seconds < _SECONDS["minutes"]:
        raise ValueError(cell)
    return in_hours + in_minutes + in_seconds


def _instant(moment: datetime, said: TimeTable, before: float, steps: Collection[float]) -> float:
    """Return an instant in seconds since 1970. Raises `ValueError` for one outside the calendar's years."""
    if moment.tzinfo:
        time_s = moment.timestamp()
    elif said.zone and is_dated(said.format):
        time_s = _local_instant(moment.replace(tzinfo=ZoneInfo(said.zone)), before, steps)
    else:
        return moment.replace(tzinfo=UTC).timestamp()
    return datetime.fromtimestamp(time_s, UTC).timestamp()


def _local_instant(local: datetime, before: float, steps: Collection[float]) -> float:
    """Return the instant of a local time: of one that comes twice the second where it is no row that came late.

    Late is what lies back by few of the file's own steps, and by less than the second lies ahead.
    """
    first_s, again_s = local.timestamp(), local.replace(fold=1).timestamp()
    back_s, ahead_s = before - first_s, again_s - before
    comes_twice = again_s > first_s  # as an hour does when clocks are set back
    if not comes_twice or back_s < 0.0:
        return first_s
    return first_s if back_s <= _few(steps) and back_s < ahead_s else again_s


def _moment(cell: str, layout: str) -> datetime:
    if layout == "iso":
        return datetime.fromisoformat(cell)
    try:
        return datetime.strptime(cell, layout)  # noqa: DTZ007
    except re.error as error:  # of a format that says something twice
        raise ValueError(cell) from error


@lru_cache
def is_dated(layout: str) -> bool:
    """Whether times of this format say their whole date: year, month and day.

    >>> [is_dated(layout) for layout in ("iso", "%d.%m.%y %H:%M", "%d.%m. %H:%M", "%H:%M", "clock", "seconds")]
    [True, True, False, False, False, False]
    """
    return layout == "iso" or _date_read_back(layout) == _SOME_DAY


@lru_cache
def is_daily(layout: str) -> bool:
    """Whether times of this format say the time of day alone.

    >>> [is_daily(layout) for layout in ("iso", "%d.%m. %H:%M", "%a %H:%M", "%H:%M", "clock", "seconds")]
    [False, False, False, True, True, False]
    """
    if layout == "clock":
        return True
    same = "%" in layout and _SOME_DAY.strftime(layout) == _SOME_OTHER.strftime(layout)
    return same and _date_read_back(layout) == _NO_DAY


def _date_read_back(layout: str) -> date | None:
    """Return what a format keeps of a date; None where it is no such format."""
    if "%" not in layout:
        return None
    try:
        return _moment(datetime.combine(_SOME_DAY, time(), UTC).strftime(layout), layout).date()
    except ValueError:
        return None


def start_of(path: Path, line: int, cell: str, mapped: Mapped) -> dict[str, Any]:
    """Return the header key of when the file begins, where it gives a date, and it or the mapping the zone.

    `cell` is the time of its first row, which stands in `line`.
    """
    if not is_dated(mapped.time.format):
        return {}
    if not mapped.time.zone and _moment(cell, mapped.time.format).tzinfo is None:
        return {}
    return {"recorded.started_utc": datetime.fromtimestamp(_time(path, line, cell, mapped), UTC)}


def plain(cell: str, file: FileTable) -> str:
    """Return a number with a decimal point and without thousands marks, its digits 0 to 9."""
    if not cell.isascii() or "_" in cell:
        raise ValueError(cell)
    if file.decimal == ",":
        if "." in cell and "," not in cell:
            raise ValueError(cell)
        return cell.replace(".", "").replace(",", ".")
    return cell
