"""The rows of a run file: numbers, columns of words, and what is wrong with them by line and column.

Reading goes through pyarrow's parser; only where that objects does a slow pass look for the line and
column to name.
"""

from __future__ import annotations

import csv
import fnmatch
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from daq.qualities import QUALITY, faults_of, wrong_quality
from daq.records import COLDEST_C, HOTTEST_C, Array, BrokenTime, InputError

TIME = "time_s"
CLOSED = "closed"
_MISSING = ("", "nan", "NaN", "NAN")
_WORDS = re.compile(r"[^0-9.+-]|\d+:\d|\d{4}-\d\d-\d\d")
"""How a cell of words begins, a clock's time or a date too; what begins like a number must be one."""


@dataclass(frozen=True)
class Rows:
    """What a table holds: columns of numbers, `time_s` among them, and columns of words."""

    columns: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]]


def read_rows(where: str, rows: bytes, names: Sequence[str], line: int, temperatures: Sequence[str]) -> Rows:
    """Read the rows of a CSV file, the first of them in `line`, and check them.

    Parameters
    ----------
    temperatures
        Patterns of columns in which only a temperature can stand.

    Raises
    ------
    InputError
        Naming line, column and value.
    """
    found = _fast_rows(rows, names) or _slow_rows(where, rows, names, line)
    if not len(found.columns[TIME]):
        raise InputError(f"{where}: line {line - 1}: no rows follow the header row; a run needs at least one scan")

    def place(row: int) -> str:
        return f"line {[number for number, _ in _records(where, rows, line)][row]}"

    check_rows(where, found, place, temperatures)
    return found


def check_names(where: str, names: Sequence[str]) -> None:
    """Refuse columns without a name, and names that come twice."""
    for number, name in enumerate(names, start=1):
        if not name or name != name.strip() or "\n" in name or "\r" in name or name.startswith(("#", "\ufeff")):
            raise InputError(f"{where}: column {number} has no usable name ({name!r}); give every column a name")
        if name in names[: number - 1]:
            first = names.index(name) + 1
            raise InputError(f"{where}: column {name!r} occurs twice (columns {first} and {number}); rename one")


def number_in(cell: str) -> float | None:
    """Return what a cell says, NaN for a missing value, None for text and infinities."""
    cell = cell.strip()
    if cell in _MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in cell else None


def row_place(row: int) -> str:
    """Say where a row of a table without lines is."""
    return f"row {row + 1}"


def check_rows(
    where: str, rows: Rows, place: Callable[[int], str] = row_place, temperatures: Sequence[str] = ()
) -> None:
    """Refuse times that do not rise and values that cannot be; `place` says where a row is."""
    for name, column in rows.columns.items():
        if name == TIME:
            _check_times(where, column, place)
        if len(bad := np.flatnonzero(np.isinf(column))):
            raise InputError(f"{where}: {place(bad[0])}: column {name}: infinite; must be a number")
        if name == CLOSED and len(bad := np.flatnonzero(~np.isin(column, (0.0, 1.0)) & ~np.isnan(column))):
            value = column[bad[0]]
            raise InputError(f"{where}: {place(bad[0])}: column closed: {value:g} must be 0 (open) or 1 (closed)")
        if any(fnmatch.fnmatchcase(name, pattern) for pattern in temperatures):
            bad = np.flatnonzero((column <= COLDEST_C) | (column >= HOTTEST_C))
            if len(bad):
                raise InputError(
                    f"{where}: {place(bad[0])}: column {name}: {column[bad[0]]:g} is no temperature; must lie "
                    f"between {COLDEST_C:g} and {HOTTEST_C:g} C; leave a missing value empty"
                )
    if wrong := wrong_quality(rows.texts.get(QUALITY, ()), {*rows.columns, *rows.texts}):
        raise InputError(f"{where}: {place(wrong[0])}: column {QUALITY}: {wrong[1]}")


def _check_times(where: str, times: Array, place: Callable[[int], str]) -> None:
    """Refuse the first time that is missing, infinite, or does not rise."""
    fine = np.isfinite(times)
    fine[1:] &= times[1:] > times[:-1]
    if fine.all():
        return
    i = int(np.argmin(fine))
    if np.isnan(times[i]):
        raise BrokenTime(f"{where}: {place(i)}: column time_s: the time is missing; every row needs one")
    if np.isfinite(times[i]):
        raise BrokenTime(
            f"{where}: {place(i)}: time_s = {float(times[i])!r} does not rise ({place(i - 1)}: "
            f"{float(times[i - 1])!r}); sort the rows, remove doubled ones"
        )


def _fast_rows(rows: bytes, names: Sequence[str]) -> Rows | None:
    """Parse all rows at once, numbers and the text of qualities, or return None where a closer look is due."""
    if not rows.strip():
        return Rows({name: np.empty(0) for name in names}, {})
    try:
        table = pacsv.read_csv(
            pa.BufferReader(rows),
            read_options=pacsv.ReadOptions(column_names=names, use_threads=False, block_size=1 << 26),
            convert_options=pacsv.ConvertOptions(
                column_types={n: pa.string() if n == QUALITY else pa.float64() for n in names},
                null_values=list(_MISSING),
                strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid:
        return None
    texts = {n: tuple(t or "" for t in table[n].to_pylist()) for n in names if n == QUALITY}
    if any(not any(cells) or faults_of(cell) is None for cells in texts.values() for cell in cells):
        return None
    columns = {n: np.asarray(table[n].to_numpy(), float) for n in names if n not in texts}
    return None if any(np.isinf(column).any() for column in columns.values()) else Rows(columns, texts)


def _slow_rows(where: str, rows: bytes, names: Sequence[str], line: int) -> Rows:
    """Parse row by row; raise at the first that is wrong."""
    table = list(_records(where, rows, line))
    whole = [cells for _, cells in table if len(cells) == len(names)]
    texts = _text_columns(names, whole)
    numbers = [(place, name) for place, name in enumerate(names) if name not in texts]
    values: list[list[float]] = []
    for at, cells in table:
        if len(cells) != len(names):
            raise InputError(
                f"{where}: line {at}: {len(cells)} cells, but the header row has {len(names)} columns; "
                "leave a missing value as an empty cell"
            )
        values.append([_cell(f"{where}: line {at}", name, cells[place]) for place, name in numbers])
    columns = np.array(values, float).reshape(len(values), len(numbers)).T
    return Rows({name: column.copy() for (_, name), column in zip(numbers, columns, strict=True)}, texts)


def _records(where: str, rows: bytes, line: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the line of each row and its cells; empty lines are left out, a quoted cell may hold several."""
    reader = csv.reader(_lines(where, rows, line), strict=True)
    while True:
        at = line + reader.line_num
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise InputError(f"{where}: line {at}: {error}; check its quotation marks and line ends") from error
        if len(cells) > 1 or (cells and cells[0].strip()):
            yield at, cells


def _lines(where: str, rows: bytes, line: int) -> Iterator[str]:
    for number, raw in enumerate(rows.split(b"\n"), start=line):
        yield decoded(where, number, raw) + "\n"


def decoded(where: str, line: int, raw: bytes) -> str:
    """Return a line's text; raises `InputError` naming the line that is not UTF-8."""
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: line {line}: not UTF-8 text; save the file as UTF-8") from error


def _text_columns(names: Sequence[str], table: Sequence[Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Return the columns of remarks: every cell that is not empty holds words."""
    texts = {}
    for name, cells in zip(names, zip(*table, strict=True), strict=True) if table else ():
        filled = [cell.strip() for cell in cells if cell.strip()]
        worded = name == QUALITY or all(_WORDS.match(cell) for cell in filled)
        if name not in (TIME, CLOSED) and filled and worded and all(number_in(cell) is None for cell in filled):
            texts[name] = tuple(cells)
    return texts


def _cell(where: str, name: str, cell: str) -> float:
    value = number_in(cell)
    if value is None:
        raise InputError(f"{where}: column {name}: {cell.strip()!r} is not a number; leave a missing value empty")
    return value
