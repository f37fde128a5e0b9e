"""The rows of a run file: numbers, columns of words, and what is wrong with them by line and column.

Reading goes through pyarrow's parser; only where that objects does a slow pass look for the line and
column to name.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from daq.files.qualities import QUALITY, faults_of, wrong_quality
from daq.records import COLDEST_C, HOTTEST_C, Array, BrokenTime, InputError, matches
from daq.tables import at, reason_of
from daq.words import Message, say

TIME = "time_s"
CLOSED = "closed"
_MISSING = ("", "nan", "NaN", "NAN")
_WORDS = re.compile(r"[^\d.+-]|\d+:\d|\d{4}-\d\d-\d\d|-?\d+ days? ")
"""How a cell of words begins, or a clock's time, a date, a duration. Else what begins with a digit is a number."""
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""How a cell begins that a spreadsheet would compute, behind any apostrophes of ours. (OWASP: CSV Injection)"""

# Numbers without another source were set by hand, 2026-11.

_PIECE_BYTES = 1 << 22
"""Of a file, read at once: large enough to be quick, small beside what the columns take."""
_NAN = pa.Array.from_buffers(pa.float64(), 1, [None, pa.py_buffer(np.array([np.nan]))])[0]
"""As pyarrow's scalar; made of a number it would import pandas."""


@dataclass(frozen=True)
class Rows:
    """What a table holds: columns of numbers, `time_s` among them, and columns of words."""

    columns: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class RowText:
    """The rows of a CSV file, below its header row: opened anew for each look, so that none holds them all."""

    path: Path
    start: int
    """Byte at which the first of them begins."""
    line: int
    """Its number."""

    def open(self) -> BinaryIO:
        """Open the file at the first row."""
        file = self.path.open("rb")
        file.seek(self.start)
        return file


def read_rows(text: RowText, names: Sequence[str], temperatures: Sequence[str]) -> Rows:
    """Read the rows of a CSV file piece by piece, and check them.

    Parameters
    ----------
    temperatures
        Patterns of columns in which only a temperature can stand.

    Raises
    ------
    InputError
        Naming line, column and value.
    """
    where = str(text.path)
    found = _fast_rows(text, names) or _slow_rows(text, names)
    if not len(found.columns[TIME]):
        raise InputError(at(where, say("run-no-rows"), line=text.line - 1))

    def place(row: int) -> Message:
        return say("place-line", line=next(itertools.islice(_records(text), int(row), None))[0])

    check_rows(where, found, place, temperatures)
    return found


def check_names(where: Message | str, names: Sequence[str]) -> None:
    """Refuse columns without a name, and names that come twice."""
    for number, name in enumerate(names, start=1):
        if not name or name != name.strip() or "\n" in name or "\r" in name or name.startswith(("#", "\ufeff")):
            raise InputError(at(where, say("run-column-unnamed", number=number, name=repr(name))))
        if name in names[: number - 1]:
            first = names.index(name) + 1
            problem = say("run-column-twice", column=name, first=first, second=number)
            raise InputError(at(where, problem))


def number_in(cell: str) -> float | None:
    """Return what a cell says, NaN for a missing value, None for text and infinities."""
    cell = cell.strip()
    if cell in _MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in cell and cell.isascii() else None


def row_place(row: int) -> Message:
    """Say where a row of a table without lines is."""
    return say("place-row", row=int(row) + 1)


def _in_row(where: str, place: Message, what: Message, column: str | None = None) -> Message:
    return at(where, say("at-place", place=place, what=what if column is None else at_column(column, what)))


def at_column(column: str, what: Message) -> Message:
    """Return a message with the column it is about."""
    return say("at-column", column=column, what=what)


def check_no_words(where: str, column: str, cells: Sequence[str]) -> None:
    """Refuse a column of words where numbers are due, naming its first word; one of empty cells is missing."""
    filled = [(row, cell) for row, cell in enumerate(cells) if cell.strip()]
    worded = [(row, cell) for row, cell in filled if number_in(cell) is None]
    for row, cell in worded[:1]:
        raise InputError(_in_row(where, row_place(row), say("run-no-number", cell=repr(cell.strip())), column))
    for row, cell in filled[:1]:
        raise InputError(_in_row(where, row_place(row), say("run-number-as-text", cell=repr(cell)), column))


def check_rows(
    where: str, rows: Rows, place: Callable[[int], Message] = row_place, temperatures: Sequence[str] = ()
) -> None:
    """Refuse times that do not rise and values that cannot be; `place` says where a row is."""
    for name, column in rows.columns.items():
        if name == TIME:
            _check_times(where, column, place)
        if len(bad := np.flatnonzero(np.isinf(column))):
            raise InputError(_in_row(where, place(bad[0]), say("run-value-infinite"), name))
        if name == CLOSED and len(bad := np.flatnonzero(~np.isin(column, (0.0, 1.0)) & ~np.isnan(column))):
            problem = say("run-closed-value", value=float(column[bad[0]]))
            raise InputError(_in_row(where, place(bad[0]), problem, name))
        if matches(name, temperatures):
            bad = np.flatnonzero((column <= COLDEST_C) | (column >= HOTTEST_C))
            if len(bad):
                found = f"{column[bad[0]]:g}"
                problem = say("run-no-temperature", value=found, coldest=COLDEST_C, hottest=HOTTEST_C)
                raise InputError(_in_row(where, place(bad[0]), problem, name))
    if wrong := wrong_quality(rows.texts.get(QUALITY, ()), {*rows.columns, *rows.texts}):
        raise InputError(_in_row(where, place(wrong[0]), wrong[1], QUALITY))


def _check_times(where: str, times: Array, place: Callable[[int], Message]) -> None:
    """Refuse the first time that is missing, infinite, or does not rise."""
    fine = np.isfinite(times)
    fine[1:] &= times[1:] > times[:-1]
    if fine.all():
        return
    i = int(np.argmin(fine))
    if np.isnan(times[i]):
        raise BrokenTime(_in_row(where, place(i), say("run-time-missing"), TIME))
    if np.isfinite(times[i]):
        found, before = repr(float(times[i])), repr(float(times[i - 1]))
        problem = say("run-time-falls", time=found, place=place(i - 1), before=before)
        raise BrokenTime(_in_row(where, place(i), problem))


def _fast_rows(text: RowText, names: Sequence[str]) -> Rows | None:
    """Parse numbers and the text of qualities in pieces, or return None where a closer look is due."""
    most = _line_count(text)
    columns = {name: np.empty(most) for name in names if name != QUALITY}
    texts: list[str] = []
    rows = 0
    known: dict[str, str] = {}
    try:
        with (
            text.open() as file,
            pacsv.open_csv(
                pa.PythonFile(file, mode="r"),
                read_options=pacsv.ReadOptions(column_names=names, use_threads=False, block_size=_PIECE_BYTES),
                convert_options=pacsv.ConvertOptions(
                    column_types={n: pa.string() if n == QUALITY else pa.float64() for n in names},
                    null_values=list(_MISSING),
                    strings_can_be_null=True,
                ),
            ) as reader,
        ):
            for piece in reader:
                for name, column in columns.items():
                    values = column[rows : rows + len(piece)]
                    values[:] = numbers_of(piece[name])
                    if np.isinf(values).any():
                        return None
                rows += len(piece)
                cells = piece[QUALITY].to_pylist() if QUALITY in names else []
                texts += [known.setdefault(cell or "", unescaped(cell or "")) for cell in cells]
    except pa.ArrowInvalid:
        return None
    if QUALITY in names and (not any(known) or any(faults_of(cell) is None for cell in known.values())):
        return None
    texts_by_name = {QUALITY: tuple(texts)} if QUALITY in names else {}
    return Rows({name: column[:rows] for name, column in columns.items()}, texts_by_name)


def numbers_of(column: pa.Array) -> Array:
    """Return a column of float64, NaN where it holds nothing; its own memory where it lacks nothing.

    Through DLPack: pyarrow's own way into numpy imports pandas, for 0.3 s of a start.
    """
    return np.asarray(np.from_dlpack(column.fill_null(_NAN) if column.null_count else column), float)


def _line_count(text: RowText) -> int:
    """Return how many lines follow, each a row at most."""
    with text.open() as file:
        return 1 + sum(piece.count(b"\n") for piece in iter(lambda: file.read(_PIECE_BYTES), b""))


def _slow_rows(text: RowText, names: Sequence[str]) -> Rows:
    """Parse row by row; raise at the first that is wrong."""
    where, words = str(text.path), _text_columns(text, names)
    numbers = {place: array("d") for place, name in enumerate(names) if name not in words}
    texts: dict[int, list[str]] = {place: [] for place, name in enumerate(names) if name in words}
    known: dict[str, str] = {}
    for number, cells in _records(text):
        if len(cells) != len(names):
            problem = say("run-cell-count", cells=len(cells), columns=len(names))
            raise InputError(at(where, problem, line=number))
        for place, values in numbers.items():
            values.append(_cell(where, number, names[place], cells[place]))
        for place, kept in texts.items():
            cell = unescaped(cells[place])
            kept.append(known.setdefault(cell, cell))
    columns = {names[place]: np.frombuffer(values) if values else np.empty(0) for place, values in numbers.items()}
    return Rows(columns, {names[place]: tuple(kept) for place, kept in texts.items()})


def _records(text: RowText) -> Iterator[tuple[int, list[str]]]:
    """Yield the line of each row and its cells; empty lines are left out, a quoted cell may hold several."""
    with text.open() as file:
        reader = csv.reader(_lines(text, file), strict=True)
        while True:
            number = text.line + reader.line_num
            try:
                cells = next(reader)
            except StopIteration:
                return
            except csv.Error as error:
                problem = say("run-quotation", reason=reason_of(error))
                raise InputError(at(text.path, problem, line=number)) from error
            if len(cells) > 1 or (cells and cells[0].strip()):
                yield number, cells


def _lines(text: RowText, file: BinaryIO) -> Iterator[str]:
    for number, raw in enumerate(file, start=text.line):
        yield utf8_line(str(text.path), number, raw.removesuffix(b"\n")) + "\n"


def utf8_line(where: str, line: int, raw: bytes) -> str:
    """Return a line's text; raises `InputError` naming the line that is not UTF-8."""
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise InputError(at(where, say("run-not-utf8"), line=line)) from error


def _text_columns(text: RowText, names: Sequence[str]) -> frozenset[str]:
    """Return the columns of remarks: every cell that is not empty holds words."""
    worded = {place: name for place, name in enumerate(names) if name not in (TIME, CLOSED)}
    filled: set[int] = set()
    for _, cells in _records(text):
        if len(cells) != len(names):
            continue  # refused by line in a moment
        for place, name in tuple(worded.items()):
            cell = cells[place].strip()
            if cell:
                filled.add(place)
            if cell and (number_in(cell) is not None or not (name == QUALITY or _WORDS.match(cell))):
                del worded[place]
    return frozenset(name for place, name in worded.items() if place in filled)


def escaped(text: str) -> str:
    """Return a text so that no spreadsheet takes it for a formula: with an apostrophe in front, as they write it.

    >>> escaped("=2+3"), escaped("'=2"), escaped("steady")
    ("'=2+3", "''=2", 'steady')
    """
    return f"'{text}" if _FORMULA.match(text) else text


def unescaped(cell: str) -> str:
    """Undo `escaped`.

    >>> unescaped("'=2+3"), unescaped("'tis")
    ('=2+3', "'tis")
    """
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _cell(where: str, line: int, name: str, cell: str) -> float:
    value = number_in(cell)
    if value is None:
        raise InputError(at(where, say("run-no-number", cell=repr(cell.strip())), line=line, column=name))
    return value
