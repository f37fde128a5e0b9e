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
    from = "TC back 2 (K)"           # or ["TC back 2 (K)", "TC 2 (K)"]: the first of them that the file has
    to = "bottom_1"
    unit = "K"                       # "C", "K", "F", or "" for anything else
    scale = 1.0                      # value * scale + offset, before the unit
    lower = 250.0                    # readings outside lower..upper count as missing
    upper = 1500.0

    [[computed]]                     # a column that the file lacks, as a sum of mapped ones
    to = "bottom_2"
    terms = { edge_1 = 0.5, edge_2 = 0.5 }

    [header]                         # keys of the run file
    "panel.material" = "pine"
    [header_from."panel.initial_temperature_C"]     # a key from a column's first or last value
    column = "bottom_1"
    row = "first"
    [[variant]]                      # more keys where the file's name matches
    of = "flux"                      # one question, one answer: several variants of it never match one file
    match = "*_40kW_*"
    header = { "boundary.top.incident_W_m2" = 40000.0 }
    required_variants = ["flux"]     # at the top: a file that matches none of these is refused
"""

from __future__ import annotations

import codecs
import csv
import fnmatch
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pydantic import ValidationError

from daq.files.mapped_times import Row, plain, rows_in_order, start_of
from daq.files.mapping_tables import ColumnTable, ComputedTable, FileTable, HeaderFrom, Mapped
from daq.press.header import check_header
from daq.press.press_file import SD
from daq.records import COLDEST_C, HOTTEST_C, Array, InputError, Run, matches
from daq.tables import at, explained, load_toml, reason_of
from daq.thermocouple import celsius_of
from daq.words import Message, say

_DELIMITERS = {"tab": "\t", "space": " "}
_ROWS_AT_ONCE = 1 << 8
"""Parsed together; four and sixteen times as many took longer in tests/benchmarks/test_tables.py (2026-11)."""


def read_mapping(path: Path) -> Mapped:
    """Read and check a mapping. Raises `InputError` naming key, value and what is allowed."""
    path = Path(path)
    try:
        mapped = Mapped.model_validate(load_toml(path, say("file-of-mapping")))
    except ValidationError as error:
        raise InputError(at(path, explained(error, Mapped))) from error
    for problem in _contradictions(mapped):
        raise InputError(at(path, problem))
    for header in (mapped.header, *(variant.header for variant in mapped.variant)):
        check_header(header, path)
    check_header({key.removesuffix(SD): None for key in mapped.header_from}, path)
    return mapped


def _contradictions(mapped: Mapped) -> Iterator[Message]:
    """Yield what names a column, or a variant, that is not there or there twice."""
    sources = [c.to for c in mapped.column]
    targets = [*sources, *(c.to for c in mapped.computed)]
    yield from (say("mapping-target-twice", column=t) for t in targets if targets.count(t) > 1)
    terms = [(computed.to, name) for computed in mapped.computed for name in computed.terms]
    yield from (say("mapping-term-unknown", to=to, column=name) for to, name in terms if name not in sources)
    taken = [(key, source.column) for key, source in mapped.header_from.items()]
    yield from (say("mapping-header-source", key=k, column=name) for k, name in taken if name not in targets)
    known = {variant.of for variant in mapped.variant}
    yield from (say("mapping-variant-of-nothing", of=of) for of in mapped.required_variants if of not in known)


def read_foreign(path: Path, mapped: Mapped, temperatures: Sequence[str] = ()) -> Run:
    """Read a foreign file as a run.

    Only a temperature can stand in columns that match `temperatures`, and in those whose unit is stated as one's.

    Raises
    ------
    InputError
        Naming file, line, column and value of what the mapping does not explain.
    """
    path = Path(path)
    rows = _rows(path, mapped.file)
    names = next(rows)
    places = _places(path, names.cells, mapped)
    kept = [(places[c.to], c, _is_temperature(c, temperatures)) for c in mapped.column if c.to in places]
    found = {column.to: array("d") for _, column, _ in kept}
    times, first = array("d"), None
    for piece in _pieces(rows_in_order(path, rows, names, mapped)):
        first = first or piece[0][0]
        times.extend([time_s for _, time_s in piece])
        for name, values in _values(path, [row for row, _ in piece], kept, mapped.file).items():
            found[name].extend(values)
    if first is None:
        raise InputError(at(path, say("foreign-no-rows", line=names.line)))
    columns = {name: np.frombuffer(values) for name, values in found.items()}
    columns |= _computed(columns, mapped.computed)
    header: dict[str, Any] = {"run": path.stem, **start_of(path, first, names.cells, mapped), **mapped.header}
    header |= _variants(path, mapped)
    for key, source in mapped.header_from.items():
        if key not in header:
            header[key] = _value_at(path, key, columns.get(source.column, np.empty(0)), source)
    check_header(header, path)
    return Run(str(header["run"]), header, np.frombuffer(times), columns, str(path))


def _is_temperature(column: ColumnTable, patterns: Sequence[str]) -> bool:
    return matches(column.to, patterns) or (bool(column.unit) and "unit" in column.model_fields_set)


def _computed(columns: Mapping[str, Array], tables: Iterable[ComputedTable]) -> dict[str, Array]:
    """Return the columns that are sums of those there are."""
    return {
        one.to: one.offset + np.sum([weight * columns[name] for name, weight in one.terms.items()], axis=0)
        for one in tables
        if all(name in columns for name in one.terms)
    }


def _variants(path: Path, mapped: Mapped) -> dict[str, Any]:
    """Return the header keys that the file's name adds; refuse one that leaves a required question open."""
    header: dict[str, Any] = {}
    answered: dict[str, str] = {}
    for variant in mapped.variant:
        if not fnmatch.fnmatchcase(path.name, variant.match):
            continue
        if variant.of and variant.of in answered:
            first = answered[variant.of]
            raise InputError(
                at(path, say("foreign-variant-twice", of=variant.of, first=first, second=variant.match))
            )
        answered[variant.of] = variant.match
        header |= variant.header
    if unknown := next((of for of in mapped.required_variants if of not in answered), None):
        known = tuple(variant.match for variant in mapped.variant if variant.of == unknown)
        raise InputError(at(path, say("foreign-variant-unknown", of=unknown, known=known)))
    return header


def _rows(path: Path, file: FileTable) -> Iterator[Row]:
    """Yield the row of names, then the others, each read when it is asked for."""
    delimiter = _DELIMITERS.get(file.delimiter, file.delimiter)
    read: list[int] = []

    def texts() -> Iterator[str]:
        for number, text in _lines(path, file):
            read.append(number)
            yield text

    reader = csv.reader(texts(), delimiter=delimiter, skipinitialspace=delimiter == " ", strict=True)
    names: Row | None = None
    while True:
        read.clear()  # a quoted cell may hold several lines
        try:
            cells = list(map(str.strip, next(reader)))
        except StopIteration:
            return
        except csv.Error as error:
            raise InputError(at(path, say("run-quotation", reason=reason_of(error)), line=read[0])) from error
        row = Row(read[0], [cell for cell in cells if cell] if delimiter == " " else cells)
        names = names or row
        if len(row.cells) < len(names.cells) and any(names.cells[len(row.cells) :]):
            problem = say("foreign-cell-count", cells=len(row.cells), line=names.line, columns=len(names.cells))
            raise InputError(at(path, problem, line=row.line))
        yield row


def _lines(path: Path, file: FileTable) -> Iterator[tuple[int, str]]:
    """Yield the line of names, then those that hold rows, with their numbers."""
    number = 0
    try:
        with path.open(encoding=file.encoding) as opened:
            for number, text in enumerate(opened, start=1):
                comment = file.comment and text.startswith(file.comment)
                below = number > file.header_line + file.units_lines and text.strip() and not comment
                if number == file.header_line or below:
                    yield number, text.removesuffix("\n") + "\n"
    except LookupError as error:
        raise InputError(at(path, say("foreign-encoding-unknown", encoding=file.encoding))) from error
    except UnicodeDecodeError as error:
        problem = say("foreign-encoding-wrong", encoding=file.encoding, byte=_undecodable(path, file.encoding))
        raise InputError(at(path, problem)) from error
    except OSError as error:
        raise InputError(
            at(path, say("file-cannot-read", what=say("file-of-run"), reason=reason_of(error)))
        ) from error
    if number < file.header_line:
        raise InputError(at(path, say("foreign-too-short", lines=number, header_line=file.header_line)))


def _undecodable(path: Path, encoding: str) -> int:
    """Return which byte of a file an encoding does not know."""
    decoder, begun = codecs.getincrementaldecoder(encoding)(), 0
    with path.open("rb") as file:
        while True:
            piece = file.read(1 << 20)
            pending = len(decoder.getstate()[0])
            try:
                decoder.decode(piece, final=not piece)
            except UnicodeDecodeError as error:
                return begun - pending + error.start
            begun += len(piece)


def _places(path: Path, names: Sequence[str], mapped: Mapped) -> dict[str, int]:
    found = {c.to: c.found(names) for c in mapped.column}
    missing = [c for c in mapped.time.columns if c not in names]
    missing += [c.sources[0] for c in mapped.column if found[c.to] is None and not c.optional]
    used = (*mapped.time.columns, *(source for source in found.values() if source))
    if twice := next((name for name in used if names.count(name) > 1), None):
        raise InputError(at(path, say("foreign-column-twice", column=twice)))
    if missing:
        raise InputError(at(path, say("foreign-column-missing", column=missing[0], found=tuple(names))))
    return {to: names.index(source) for to, source in found.items() if source}


_Kept: TypeAlias = tuple[int, ColumnTable, bool]
"""A column of the file: its place there, what is said of it, and whether only a temperature can stand in it."""


def _pieces(rows: Iterator[tuple[Row, float]]) -> Iterator[list[tuple[Row, float]]]:
    """Yield rows with their times, many at once; before a row's time is refused, those above it."""
    piece: list[tuple[Row, float]] = []
    try:
        for row in rows:
            piece.append(row)
            if len(piece) == _ROWS_AT_ONCE:
                yield piece
                piece = []
    except InputError:
        if piece:
            yield piece
        raise
    if piece:
        yield piece


def _values(path: Path, rows: Sequence[Row], kept: Sequence[_Kept], file: FileTable) -> dict[str, list[float]]:
    """Return what the columns hold in some rows: column by column, and only where that fails cell by cell."""
    try:
        return {
            one.to: _column([row.cells[place] for row in rows], one, file, temperature=temperature)
            for place, one, temperature in kept
        }
    except ValueError:
        found = [[_value(path, row, one, file) for one in kept] for row in rows]
        return {column.to: [row[i] for row in found] for i, (_, column, _) in enumerate(kept)}


def _column(cells: Sequence[str], column: ColumnTable, file: FileTable, *, temperature: bool) -> list[float]:
    """Return a column's numbers. Raises `ValueError` where a cell is none, or no temperature where one is due."""
    if not (missing := frozenset(file.missing)).isdisjoint(cells):
        cells = ["nan" if cell in missing else cell for cell in cells]
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.array(_numbers(cells, file)) * column.scale + column.offset
    values[~((values >= column.lower) & (values <= column.upper) & np.isfinite(values))] = np.nan
    if column.unit in ("K", "F"):
        values = np.array([round(celsius_of(value, column.unit), 9) for value in values.tolist()])
    if temperature and ((values <= COLDEST_C) | (values >= HOTTEST_C)).any():
        raise ValueError(column.to)
    found: list[float] = values.tolist()
    return found


def _numbers(cells: Sequence[str], file: FileTable) -> list[float]:
    """Return cells as numbers; `plain` looks at each only where there is a mark that not every number has."""
    joined = " ".join(cells)
    if not joined.isascii() or "_" in joined or (file.decimal == "," and "." in joined):
        return [float(plain(cell, file)) for cell in cells]
    return [float(cell.replace(",", ".")) for cell in cells] if file.decimal == "," else list(map(float, cells))


def _value(path: Path, row: Row, kept: _Kept, file: FileTable) -> float:
    place, column, temperature = kept
    cell = row.cells[place]
    try:
        value = _column([cell], column, file, temperature=False)[0]
    except ValueError as error:
        problem = say("foreign-no-number", cell=repr(cell), decimal=file.decimal)
        raise InputError(at(path, problem, line=row.line, column=" | ".join(column.sources))) from error
    if temperature and (value <= COLDEST_C or value >= HOTTEST_C):
        problem = say("foreign-no-temperature", value=f"{value:g}", coldest=COLDEST_C, hottest=HOTTEST_C)
        raise InputError(at(path, problem, line=row.line, column=" | ".join(column.sources)))
    return value


def _value_at(path: Path, key: str, values: Array, source: HeaderFrom) -> float:
    good = values[np.isfinite(values)]
    if not len(good):
        raise InputError(at(path, say("foreign-header-empty", key=key, column=source.column)))
    return round(float(good[0 if source.row == "first" else -1]) * source.scale, source.digits)
