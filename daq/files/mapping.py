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

import fnmatch
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from pydantic import ValidationError

from daq.files.mapped_rows import Cells, ForeignRows
from daq.files.mapped_times import RowTimes, plain, start_of
from daq.files.mapping_tables import ColumnTable, ComputedTable, FileTable, HeaderFrom, Mapped
from daq.press.header import check_header
from daq.press.press_file import SD
from daq.records import COLDEST_C, HOTTEST_C, Array, InputError, Run, matches
from daq.tables import at, explained, load_toml
from daq.thermocouple import celsius_of
from daq.words import Message, say


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
    rows = ForeignRows(path, mapped.file)
    names = rows.names.cells
    places = _places(path, names, mapped)
    kept = [(places[c.to], c, _is_temperature(c, temperatures)) for c in mapped.column if c.to in places]
    found: dict[str, list[Array]] = {column.to: [] for _, column, _ in kept}
    clock, times, first = RowTimes(path, mapped), array("d"), None
    moments = [names.index(column) for column in mapped.time.columns]
    for cells in rows.taken(moments, {place for place, _, _ in kept}):
        first = first or (cells.lines[0], cells.moments[0])
        timed = _timed(clock, cells)
        times.extend(timed.times)
        for name, values in _values(path, timed.cells, kept, mapped.file).items():
            found[name].append(values)
        if timed.refused is not None:  # not before values above it
            raise timed.refused
    if first is None:
        raise InputError(at(path, say("foreign-no-rows", line=rows.names.line)))
    columns = {name: np.concatenate(values) for name, values in found.items()}
    columns |= _computed(columns, mapped.computed)
    header: dict[str, Any] = {"run": path.stem, **start_of(path, *first, mapped), **mapped.header}
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


_DECIMALS = 9
"""Of a temperature made of another unit: what that arithmetic leaves lies below. By definition."""
_Kept: TypeAlias = tuple[int, ColumnTable, bool]
"""A column of the file: its place there, what is said of it, and whether only a temperature can stand in it."""


class _Timed(NamedTuple):
    """Rows that stay, their times, and why the one after them is refused."""

    cells: Cells
    times: Sequence[float]
    refused: InputError | None = None


def _timed(clock: RowTimes, cells: Cells) -> _Timed:
    """Give rows their times: those up to the first that is refused, without those that are left out."""
    stay, times, refused = [], [], None
    for row, (line, moment) in enumerate(zip(cells.lines, cells.moments, strict=True)):
        try:
            time_s = clock.of(line, moment)
        except InputError as error:
            refused = error
            break
        if time_s is not None:
            stay.append(row)
            times.append(time_s)
    if len(stay) < len(cells.lines):
        by_place = {place: _chosen(column, stay) for place, column in cells.by_place.items()}
        cells = Cells(_chosen(cells.lines, stay), _chosen(cells.moments, stay), by_place)
    return _Timed(cells, times, refused)


def _chosen(column: Any, rows: Sequence[int]) -> Any:
    return column[np.array(rows, int)] if isinstance(column, np.ndarray) else [column[row] for row in rows]


def _values(path: Path, cells: Cells, kept: Sequence[_Kept], file: FileTable) -> dict[str, Array]:
    """Return what the columns hold in some rows: column by column, and only where that fails cell by cell."""
    try:
        return {one.to: _column(cells.by_place[place], one, file, temperature=hot) for place, one, hot in kept}
    except ValueError:
        found = [[_value(path, cells, row, one, file) for one in kept] for row in range(len(cells.lines))]
        return {column.to: np.array([row[i] for row in found]) for i, (_, column, _) in enumerate(kept)}


def _column(cells: Sequence[str] | Array, column: ColumnTable, file: FileTable, *, temperature: bool) -> Array:
    """Return a column's numbers. Raises `ValueError` where a cell is none, or no temperature where one is due."""
    with np.errstate(over="ignore", invalid="ignore"):
        values = _numbers(cells, file) * column.scale + column.offset
    values[~((values >= column.lower) & (values <= column.upper) & np.isfinite(values))] = np.nan
    if column.unit in ("K", "F"):
        values = _rounded(celsius_of(values, column.unit))
    if temperature and ((values <= COLDEST_C) | (values >= HOTTEST_C)).any():
        raise ValueError(column.to)
    return values


def _rounded(values: Array) -> Array:
    """Return values to nine decimals, each as `round` gives it.

    A product is off by half a unit in its last place at most, and a whole number over a power of ten is the number
    nearest to that decimal: only what lies so near to a half is asked for one by one.
    """
    per = float(10**_DECIMALS)
    scaled = values * per
    found = np.rint(scaled) / per
    unsure = ~(np.abs(scaled - np.floor(scaled) - 0.5) > np.abs(scaled) * np.finfo(float).eps)
    found[unsure] = [round(value, _DECIMALS) for value in values[unsure].tolist()]
    return found


def _numbers(cells: Sequence[str] | Array, file: FileTable) -> Array:
    """Return cells as numbers; `plain` looks at each only where there is a mark that not every number has."""
    if isinstance(cells, np.ndarray):
        return cells
    if not (missing := frozenset(file.missing)).isdisjoint(cells):
        cells = ["nan" if cell in missing else cell for cell in cells]
    joined = " ".join(cells)
    if not joined.isascii() or "_" in joined or (file.decimal == "," and "." in joined):
        return np.array([float(plain(cell, file)) for cell in cells])
    return np.array([float(cell.replace(",", ".")) if file.decimal == "," else float(cell) for cell in cells])


def _value(path: Path, cells: Cells, row: int, kept: _Kept, file: FileTable) -> float:
    place, column, temperature = kept
    cell, line, named = cells.by_place[place][row], cells.lines[row], " | ".join(column.sources)
    try:
        value = float(_column(cells.by_place[place][row : row + 1], column, file, temperature=False)[0])
    except ValueError as error:
        problem = say("foreign-no-number", cell=repr(cell), decimal=file.decimal)
        raise InputError(at(path, problem, line=line, column=named)) from error
    if temperature and (value <= COLDEST_C or value >= HOTTEST_C):
        problem = say("foreign-no-temperature", value=f"{value:g}", coldest=COLDEST_C, hottest=HOTTEST_C)
        raise InputError(at(path, problem, line=line, column=named))
    return value


def _value_at(path: Path, key: str, values: Array, source: HeaderFrom) -> float:
    good = values[np.isfinite(values)]
    if not len(good):
        raise InputError(at(path, say("foreign-header-empty", key=key, column=source.column)))
    return round(float(good[0 if source.row == "first" else -1]) * source.scale, source.digits)
