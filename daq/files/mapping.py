"""Run files from foreign loggers: a mapping (TOML) says what their columns, units and times mean.

::

    [file]
    delimiter = ";"                  # "," ";" "tab" "space"
    decimal = ","                    # "." or ","
    header_line = 1                  # the line that names the columns
    units_lines = 1                  # lines after it to skip
    missing = ["", "---"]

    [time]
    column = "Zeit"                  # or ["Datum", "Uhrzeit"]: read as one text with a blank between
    format = "%d.%m.%Y %H:%M:%S"     # or "seconds", "minutes", "hours", "milliseconds", "clock" (hh:mm:ss)
    zone = "Europe/Berlin"           # of times that do not say theirs: keeps the start and the hour set back
    from_zero = true
    repeated = "first"               # rows whose time does not rise: "refuse" or keep the "first"

    [[column]]
    from = "TC back 2 (K)"
    to = "bottom_1"
    unit = "K"                       # "C", "K", "F", or "" for anything else
    scale = 1.0                      # value * scale + offset, before the unit
    lower = 250.0                    # readings outside lower..upper count as missing
    upper = 1500.0

    [header]                         # keys of the run file
    "panel.material" = "pine"
    [header_from."panel.initial_temperature_C"]     # a key from a column's first value
    column = "bottom_1"
    [[variant]]                      # more keys where the file's name matches
    match = "*_40kW_*"
    header = { "boundary.top.incident_W_m2" = 40000.0 }
"""

from __future__ import annotations

import csv
import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from daq.press.header import check_header
from daq.records import COLDEST_C, HOTTEST_C, Array, InputError, Run
from daq.tables import at, explained, load_toml, reason_of
from daq.words import say

_DELIMITERS = {"tab": "\t", "space": " "}
_SECONDS = {"milliseconds": 1e-3, "seconds": 1.0, "minutes": 60.0, "hours": 3600.0}
_DAY_S = 86400.0


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FileTable(_Table):
    """``[file]``: how the text is laid out."""

    encoding: str = "utf-8-sig"
    delimiter: Literal[",", ";", "|", "tab", "space"] = ","
    decimal: Literal[".", ","] = "."
    header_line: int = Field(default=1, ge=1)
    units_lines: int = Field(default=0, ge=0)
    comment: str = "#"
    missing: tuple[str, ...] = ("", "NaN", "nan", "NA", "---")


class TimeTable(_Table):
    """``[time]``: what the time column holds."""

    column: str | tuple[str, ...]
    format: str = "seconds"
    zone: str = ""
    """Of dates and times that do not tell their own; without, they are only counted from the first row."""
    from_zero: bool = True
    """Count from the first row; instants always do."""
    repeated: Literal["refuse", "first"] = "refuse"

    @field_validator("zone")
    @classmethod
    def _known_zone(cls, zone: str) -> str:
        try:
            return zone and ZoneInfo(zone).key
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:
            raise ValueError(say("mapping-no-zone")) from error

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns whose cells, joined by blanks, tell the time."""
        return (self.column,) if isinstance(self.column, str) else self.column


class ColumnTable(_Table):
    """``[[column]]``: one column of the run file."""

    source: str = Field(alias="from")
    to: str = Field(min_length=1)
    unit: Literal["C", "K", "F", ""] = "C"
    scale: float = 1.0
    offset: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    optional: bool = False
    """The file may lack it."""


class HeaderFrom(_Table):
    """``[header_from.KEY]``: a header key from the first value of a mapped column."""

    column: str
    scale: float = 1.0
    digits: int = 3


class Variant(_Table):
    """``[[variant]]``: header keys for files whose name matches."""

    match: str
    header: Mapping[str, Any]


class Mapped(_Table):
    """The whole mapping."""

    file: FileTable = FileTable()
    time: TimeTable
    column: tuple[ColumnTable, ...] = Field(min_length=1)
    header: Mapping[str, Any] = Field(default_factory=dict)
    header_from: Mapping[str, HeaderFrom] = Field(default_factory=dict)
    variant: tuple[Variant, ...] = ()


def read_mapping(path: Path) -> Mapped:
    """Read and check a mapping. Raises `InputError` naming key, value and what is allowed."""
    path = Path(path)
    try:
        mapped = Mapped.model_validate(load_toml(path, say("file-of-mapping")))
    except ValidationError as error:
        raise InputError(at(path, explained(error, Mapped))) from error
    targets = [c.to for c in mapped.column]
    if twice := next((t for t in targets if targets.count(t) > 1), None):
        raise InputError(at(path, say("mapping-target-twice", column=twice)))
    for key, source in mapped.header_from.items():
        if source.column not in targets:
            raise InputError(at(path, say("mapping-header-source", key=key, column=source.column)))
    return mapped


def read_foreign(path: Path, mapped: Mapped, temperatures: Sequence[str] = ()) -> Run:
    """Read a foreign file as a run; in columns that match `temperatures` only a temperature can stand.

    Raises
    ------
    InputError
        Naming file, line, column and value of what the mapping does not explain.
    """
    path = Path(path)
    lines = _lines(path, mapped.file)
    names, rows = _cells(path, lines, mapped.file)
    places = _places(path, names, mapped)
    keep = _rows_in_order(path, rows, names, mapped)
    columns: dict[str, Array] = {}
    for column in (c for c in mapped.column if c.to in places):
        values = np.array([_value(path, row, places[column.to], column, mapped.file) for row, _ in keep])
        if any(fnmatch.fnmatchcase(column.to, pattern) for pattern in temperatures):
            _refuse_impossible(path, column, values, [row.line for row, _ in keep])
        columns[column.to] = values
    header: dict[str, Any] = {"run": path.stem, **_start(path, keep[0][0], names, mapped), **mapped.header}
    for variant in mapped.variant:
        if fnmatch.fnmatchcase(path.name, variant.match):
            header |= variant.header
    for key, source in mapped.header_from.items():
        header.setdefault(key, _first(path, key, columns.get(source.column, np.empty(0)), source))
    check_header(header, path)
    times = np.array([time_s for _, time_s in keep])
    return Run(str(header["run"]), header, times, columns, str(path))


@dataclass(frozen=True)
class _Row:
    line: int
    cells: Sequence[str]


def _lines(path: Path, file: FileTable) -> list[tuple[int, str]]:
    try:
        text = path.read_text(encoding=file.encoding)
    except LookupError as error:
        raise InputError(at(path, say("foreign-encoding-unknown", encoding=file.encoding))) from error
    except UnicodeDecodeError as error:
        said = say("foreign-encoding-wrong", encoding=file.encoding, byte=error.start)
        raise InputError(at(path, said)) from error
    except OSError as error:
        raise InputError(
            at(path, say("file-cannot-read", what=say("file-of-run"), reason=reason_of(error)))
        ) from error
    numbered = list(enumerate(text.split("\n"), start=1))
    if len(numbered) < file.header_line:
        raise InputError(at(path, say("foreign-too-short", lines=len(numbered), header_line=file.header_line)))
    first = file.header_line + file.units_lines
    kept = [(n, t) for n, t in numbered[first:] if t.strip() and not (file.comment and t.startswith(file.comment))]
    return [numbered[file.header_line - 1], *kept]


def _cells(path: Path, lines: list[tuple[int, str]], file: FileTable) -> tuple[list[str], list[_Row]]:
    delimiter = _DELIMITERS.get(file.delimiter, file.delimiter)
    texts = (f"{text}\n" for _, text in lines)  # a quoted cell may hold several lines
    reader = csv.reader(texts, delimiter=delimiter, skipinitialspace=delimiter == " ", strict=True)
    table: list[_Row] = []
    while (done := reader.line_num) < len(lines):
        try:
            cells = [cell.strip() for cell in next(reader)]
        except csv.Error as error:
            raise InputError(at(path, say("run-quotation", reason=str(error)), line=lines[done][0])) from error
        table.append(_Row(lines[done][0], [cell for cell in cells if cell] if delimiter == " " else cells))
    names, rows = list(table[0].cells), table[1:]
    for row in rows:
        if len(row.cells) < len(names) and not all(not c for c in names[len(row.cells) :]):
            said = say("foreign-cell-count", cells=len(row.cells), line=lines[0][0], columns=len(names))
            raise InputError(at(path, said, line=row.line))
    if not rows:
        raise InputError(at(path, say("foreign-no-rows", line=lines[0][0])))
    return names, rows


def _places(path: Path, names: list[str], mapped: Mapped) -> dict[str, int]:
    wanted = {c.to: c for c in mapped.column}
    missing = [c for c in mapped.time.columns if c not in names]
    missing += [c.source for c in wanted.values() if c.source not in names and not c.optional]
    used = (*mapped.time.columns, *(c.source for c in wanted.values()))
    if twice := next((name for name in used if names.count(name) > 1), None):
        raise InputError(at(path, say("foreign-column-twice", column=twice)))
    if missing:
        raise InputError(at(path, say("foreign-column-missing", column=missing[0], found=tuple(names))))
    return {to: names.index(c.source) for to, c in wanted.items() if c.source in names}


def _rows_in_order(path: Path, rows: list[_Row], names: list[str], mapped: Mapped) -> list[tuple[_Row, float]]:
    """Return the rows with their times, which rise."""
    places = [names.index(column) for column in mapped.time.columns]
    kept: list[tuple[_Row, float]] = []
    start, days, before = math.nan, 0.0, -math.inf
    clock = mapped.time.format == "clock"
    for row in rows:
        cell = " ".join(row.cells[place] for place in places)
        time_s = _time(path, row, cell, mapped, before)
        if clock and time_s + days < before - 0.5 * _DAY_S:
            days += _DAY_S
        time_s += days
        if time_s <= before:
            if mapped.time.repeated == "first":
                continue
            named = " + ".join(mapped.time.columns)
            raise InputError(at(path, say("foreign-time-falls", cell=repr(cell)), line=row.line, column=named))
        before = time_s
        instants = mapped.time.format not in _SECONDS
        if start != start:
            start = time_s if mapped.time.from_zero or instants else 0.0
        kept.append((row, round(time_s - start, 6)))
    return kept


def _time(path: Path, row: _Row, cell: str, mapped: Mapped, before: float = -math.inf) -> float:
    layout = mapped.time.format
    try:
        if layout in _SECONDS:
            return float(_plain(cell, mapped.file)) * _SECONDS[layout]
        if any(sign.isdigit() and not sign.isascii() for sign in cell):
            raise ValueError(cell)
        if layout == "clock":
            hours, minutes, seconds = cell.split(":")
            return 3600.0 * int(hours) + 60.0 * int(minutes) + float(_plain(seconds, mapped.file))
        moment = _moment(cell, layout)
    except ValueError as error:
        named = " + ".join(mapped.time.columns)
        said = say("foreign-time-format", cell=repr(cell), format=layout)
        raise InputError(at(path, said, line=row.line, column=named)) from error
    if moment.tzinfo:
        return moment.timestamp()
    local = moment.replace(tzinfo=ZoneInfo(mapped.time.zone) if mapped.time.zone else UTC)
    again = local.replace(fold=1)  # the hour that comes twice when clocks are set back
    return (again if local.timestamp() <= before else local).timestamp()


def _moment(cell: str, layout: str) -> datetime:
    return datetime.fromisoformat(cell) if layout == "iso" else datetime.strptime(cell, layout)  # noqa: DTZ007


def _start(path: Path, row: _Row, names: list[str], mapped: Mapped) -> dict[str, Any]:
    """Return the header key of when the file begins, where the file or the mapping tells the zone."""
    if mapped.time.format in _SECONDS or mapped.time.format == "clock":
        return {}
    cell = " ".join(row.cells[names.index(column)] for column in mapped.time.columns)
    if not mapped.time.zone and _moment(cell, mapped.time.format).tzinfo is None:
        return {}
    return {"recorded.started_utc": datetime.fromtimestamp(_time(path, row, cell, mapped), UTC)}


def _plain(cell: str, file: FileTable) -> str:
    """Return a number with a decimal point and without thousands marks, its digits 0 to 9."""
    if not cell.isascii():
        raise ValueError(cell)
    if file.decimal == ",":
        if "." in cell and "," not in cell:
            raise ValueError(cell)
        return cell.replace(".", "").replace(",", ".")
    return cell


def _value(path: Path, row: _Row, place: int, column: ColumnTable, file: FileTable) -> float:
    cell = row.cells[place] if place < len(row.cells) else ""
    if cell in file.missing:
        return math.nan
    try:
        value = float(_plain(cell, file)) * column.scale + column.offset
    except ValueError as error:
        said = say("foreign-no-number", cell=repr(cell), decimal=file.decimal)
        raise InputError(at(path, said, line=row.line, column=column.source)) from error
    if not column.lower <= value <= column.upper or not math.isfinite(value):
        return math.nan
    if column.unit == "K":
        return round(value - 273.15, 9)
    if column.unit == "F":
        return round((value - 32.0) / 1.8, 9)
    return value


def _refuse_impossible(path: Path, column: ColumnTable, values: Array, lines: Sequence[int]) -> None:
    bad = np.flatnonzero((values <= COLDEST_C) | (values >= HOTTEST_C))
    if len(bad):
        found = f"{values[bad[0]]:g}"
        said = say("foreign-no-temperature", value=found, coldest=COLDEST_C, hottest=HOTTEST_C)
        raise InputError(at(path, said, line=lines[bad[0]], column=column.source))


def _first(path: Path, key: str, values: Array, source: HeaderFrom) -> float:
    good = values[np.isfinite(values)]
    if not len(good):
        raise InputError(at(path, say("foreign-header-empty", key=key, column=source.column)))
    return round(float(good[0]) * source.scale, source.digits)
