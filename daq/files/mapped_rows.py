"""The rows of a foreign file, many at once: cells by column, and a clear error for a line that has too few.

Numbers go through pyarrow's parser; where that objects, or a cell is quoted, rows are cut one by one.
"""

from __future__ import annotations

import codecs
import csv
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from daq.files.mapping_tables import FileTable
from daq.files.run_rows import number_in, numbers_of
from daq.records import Array, InputError
from daq.tables import at, reason_of
from daq.words import say

_DELIMITERS = {"tab": "\t", "space": " "}
_QUOTED, _MARKED = '"', "("
"""A quoted cell may hold delimiters and several lines; pyarrow takes nan(1) for a number."""
_ROWS_AT_ONCE = 1 << 12
"""Parsed together. A quarter and sixteen times as many take a quarter longer, four times as many as long: of a
file of 16 columns and 200,000 rows, processor time (2026-11-30)."""

Line: TypeAlias = tuple[int, str]
"""Its number and its text, with the break."""


class Row(NamedTuple):
    """A line of the file, cut into cells."""

    line: int
    cells: Sequence[str]


class Cells(NamedTuple):
    """Some rows."""

    lines: Sequence[int]
    moments: Sequence[str]
    """What their time columns hold, joined by blanks."""
    by_place: Mapping[int, Sequence[str] | Array]
    """What stands in columns of values: texts, or numbers already, NaN for a missing one."""


class ForeignRows:
    """The rows of a foreign file, below the row of names.

    Parameters
    ----------
    path, file
        The file, and how its text is laid out.

    Raises
    ------
    InputError
        Naming file and line of what the layout does not explain; also while rows are read.
    """

    def __init__(self, path: Path, file: FileTable) -> None:
        self._path, self._file = path, file
        self._delimiter = _DELIMITERS.get(file.delimiter, file.delimiter)
        self._blanks = file.delimiter == "space"  # any number of them, also at the ends
        self._lines = _lines(path, file)
        self.names = next(self._rows(self._lines))

    def taken(self, times: Sequence[int], values: Collection[int]) -> Iterator[Cells]:
        """Yield the rows, many at once: what stands in the columns of times and of values, by their places."""
        while some := list(itertools.islice(self._lines, _ROWS_AT_ONCE)):
            whole = "".join([text for _, text in some])
            if _QUOTED in whole:
                rows = self._rows(itertools.chain(some, self._lines))
                while several := list(itertools.islice(rows, _ROWS_AT_ONCE)):
                    yield _cut(several, times, values)
                return
            careful = self._blanks or _MARKED in whole
            found = None if careful else self._parsed(some, whole, times, values)
            yield found or _cut(list(self._rows(some)), times, values)

    def _rows(self, lines: Iterable[Line]) -> Iterator[Row]:
        """Yield rows, cut one by one, each read when it is asked for."""
        read: list[int] = []

        def texts() -> Iterator[str]:
            for number, text in lines:
                read.append(number)
                yield text

        reader = csv.reader(texts(), delimiter=self._delimiter, skipinitialspace=self._blanks, strict=True)
        while True:
            read.clear()  # a quoted cell may hold several lines
            try:
                cells = list(map(str.strip, next(reader)))
            except StopIteration:
                return
            except csv.Error as error:
                raise InputError(
                    at(self._path, say("run-quotation", reason=reason_of(error)), line=read[0])
                ) from error
            yield self._complete(Row(read[0], [cell for cell in cells if cell] if self._blanks else cells))

    def _complete(self, row: Row) -> Row:
        """Return the row; refuse one that has too few cells for the names."""
        names = getattr(self, "names", row)
        if len(row.cells) < len(names.cells) and any(names.cells[len(row.cells) :]):
            problem = say("foreign-cell-count", cells=len(row.cells), line=names.line, columns=len(names.cells))
            raise InputError(at(self._path, problem, line=row.line))
        return row

    def _parsed(
        self, lines: Sequence[Line], whole: str, times: Sequence[int], values: Collection[int]
    ) -> Cells | None:
        """Return the rows as pyarrow reads them, None where a closer look is due."""
        wanted = {str(place): pa.float64() for place in values} | {str(place): pa.string() for place in times}
        try:
            table = pacsv.read_csv(
                pa.BufferReader(whole.encode()),
                read_options=pacsv.ReadOptions(
                    column_names=[str(place) for place in range(len(self.names.cells))], use_threads=False
                ),
                parse_options=pacsv.ParseOptions(
                    delimiter=self._delimiter, quote_char=False, escape_char=False, ignore_empty_lines=False
                ),
                convert_options=pacsv.ConvertOptions(
                    column_types=wanted, include_columns=list(wanted), decimal_point=self._file.decimal,
                    null_values=list(self._file.missing),
                ),
            )  # fmt: skip
        except pa.ArrowInvalid:
            return None
        texts = {place: list(map(str.strip, table[str(place)].to_pylist())) for place in times}
        found = {place: texts[place] if place in texts else _numbers(table[str(place)]) for place in values}
        missing = [value for value in map(number_in, self._file.missing) if value is not None]
        if missing and any(np.isin(column, missing).any() for column in found.values()):
            return None  # with a blank beside it, it is not seen as missing
        moments = map(" ".join, zip(*texts.values(), strict=True))
        return Cells([number for number, _ in lines], list(moments), found)


def _numbers(column: pa.ChunkedArray) -> Array:
    return numbers_of(column.combine_chunks())


def _cut(rows: Sequence[Row], times: Sequence[int], values: Collection[int]) -> Cells:
    moments = [" ".join([row.cells[place] for place in times]) for row in rows]
    by_place = {place: [row.cells[place] for row in rows] for place in values}
    return Cells([row.line for row in rows], moments, by_place)


def _lines(path: Path, file: FileTable) -> Iterator[Line]:
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
