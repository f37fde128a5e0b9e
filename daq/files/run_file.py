"""Run files in and out: CSV or Parquet, one row a scan, header keys in front. Nothing is lost either way.

A text column ``quality`` says what deviates (`daq.files.qualities`); what it calls unusable is read as missing.

Writing goes to a temporary file beside the target and is renamed when it is complete.
"""

from __future__ import annotations

import csv
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date, datetime, time
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from daq.files.parquet_run import ROWS_AT_ONCE, read_parquet
from daq.files.qualities import without_unusable
from daq.files.run_rows import (
    TIME,
    Rows,
    RowText,
    check_names,
    check_rows,
    escaped,
    number_in,
    read_rows,
    unescaped,
    utf8_line,
)
from daq.press.header import check_header, flat_keys, stated_keys
from daq.records import Array, InputError, Run
from daq.tables import LARGEST_BYTES, at, read_toml, reason_of
from daq.words import say, spoken

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


_BYTE_ORDER_MARK = b"\xef\xbb\xbf"

# Numbers without another source were set by hand, 2026-11.

_MOST_BLANKS = 1 << 16
"""A file that begins with more blanks and empty lines than that is empty. [bytes]"""


def read_run(path: Path, temperatures: Sequence[str] = ()) -> Run:
    """Read a run file, CSV or Parquet.

    Parameters
    ----------
    temperatures
        Patterns of columns in which only a temperature can stand.

    Raises
    ------
    InputError
        Naming file, line, column, value and what would be right.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            begin = file.read(_MOST_BLANKS)
            if not begin.strip():
                raise InputError(at(path, say("run-file-empty")))
            if begin.startswith(b"PAR1") or path.suffix.lower() in (".parquet", ".pq"):
                return _run(path, *read_parquet(path, temperatures))
            file.seek(len(_BYTE_ORDER_MARK) if begin.startswith(_BYTE_ORDER_MARK) else 0)
            header, names, rows = _read_header(path, file)
        return _run(path, header, read_rows(rows, names, temperatures))
    except OSError as error:
        problem = say("file-cannot-read", what=say("file-of-run"), reason=reason_of(error))
        raise InputError(at(path, problem)) from error


def write_run(run: Run, path: Path) -> None:
    """Write a run file, Parquet where the suffix says so, else CSV. An existing file is replaced at once.

    Raises
    ------
    InputError
        For a run that no run file can hold: times that do not rise, infinite values, impossible names.
    """
    path = Path(path)
    header = {**run.header, "run": run.name} if str(run.header.get("run", "")) != run.name else dict(run.header)
    names = (TIME, *run.columns)
    columns = [np.asarray(run.time_s, float), *(np.asarray(c, float) for c in run.columns.values())]
    check_names(str(path), [*names, *run.texts])
    if odd := [n for n, c in zip(names, columns, strict=True) if len(c) != len(run.time_s)]:
        raise InputError(at(path, say("run-column-length", column=odd[0])))
    check_rows(str(path), Rows(dict(zip(names, columns, strict=True)), {}))
    if path.suffix.lower() in (".parquet", ".pq"):
        metadata = {key: toml_value(value) for key, value in stated_keys(header)}
        fields = [pa.field(n, pa.float64()) for n in names] + [pa.field(n, pa.string()) for n in run.texts]
        arrays = [pa.array(c, from_pandas=True) for c in columns] + [pa.array(t) for t in run.texts.values()]
        table = pa.table(arrays, schema=pa.schema(fields, metadata=metadata))
        _replace(path, lambda file: pq.write_table(table, file, write_page_checksum=True))
    else:
        pieces = _csv_pieces(header, names, columns, run.texts)
        _replace(path, lambda file: file.writelines(piece.encode() for piece in pieces))


def toml_line(key: str, value: Any) -> str:
    """Write one header key as TOML.

    >>> toml_line("panel.thickness_mm", 16.0)
    'panel.thickness_mm = 16.0'
    """
    parts = [part if _BARE_KEY.fullmatch(part) else _quoted(part) for part in key.split(".")]
    return f"{'.'.join(parts)} = {toml_value(value)}"


def toml_value(value: Any) -> str:
    """Write one header value as TOML; raises `InputError` for what TOML cannot hold."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, Mapping):
        return "{" + ", ".join(toml_line(k, v) for k, v in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    raise InputError(say("header-value-kind", value=repr(value)))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _csv_pieces(
    header: Mapping[str, Any],
    names: Sequence[str],
    columns: Sequence[Array],
    texts: Mapping[str, tuple[str, ...]],
) -> Iterator[str]:
    """Yield the text of a run file, some rows at a time."""
    for key, value in stated_keys(header):
        yield f"# {_AFTER_COMMA.sub(_in_digits, toml_line(key, value))}\n"
    yield ",".join(csv_cell(name) for name in (*names, *texts)) + "\n"
    for start in range(0, len(columns[0]), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        cells = [["" if v != v else repr(v).removesuffix(".0") for v in c[rows].tolist()] for c in columns]
        words = [[csv_cell(text) for text in column[rows]] for column in texts.values()]
        yield "".join(",".join(row) + "\n" for row in zip(*cells, *words, strict=True))


_AFTER_COMMA = re.compile(r"(?<=[,;])[=@+-]")
"""A spreadsheet cuts a header line at its commas, and would compute what then begins like a formula."""


def _in_digits(found: re.Match[str]) -> str:
    """Return a character as TOML writes it within quotes, by its number."""
    return f"\\u{ord(found[0]):04x}"


def csv_cell(text: str) -> str:
    """Return a cell of words: no formula to a spreadsheet (`escaped`), quoted where it needs it."""
    text = escaped(text)
    return '"' + text.replace('"', '""') + '"' if re.search('[,"\r\n]', text) else text


def _replace(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Put what `write` writes at `path` whole or not at all."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(at(path, say("file-cannot-write", reason=reason_of(error)))) from error
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _read_header(path: Path, file: BinaryIO) -> tuple[dict[str, Any], list[str], RowText]:
    """Return the keys, the columns' names, and where the rows begin."""
    header: dict[str, Any] = {}
    line = 1
    while found := file.readline(LARGEST_BYTES):
        raw = found.strip()
        if raw and not raw.startswith(b"#"):
            names = _column_names(path, line, utf8_line(str(path), line, found.removesuffix(b"\n")))
            return header, names, RowText(path, file.tell(), line + 1)
        for key, value in flat_keys(_header_line(path, line, raw)):
            if key in header:
                raise InputError(at(path, say("header-key-twice", key=key), line=line))
            header[key] = value
        line += 1
    raise InputError(at(path, say("run-no-header-row"), line=line))


def _header_line(path: Path, line: int, raw: bytes) -> dict[str, Any]:
    text = utf8_line(str(path), line, raw).removeprefix("#").strip()
    try:
        parsed = read_toml(text)
    except InputError as error:
        problem = say("header-line-no-toml", text=text[:60], reason=spoken(error))
        raise InputError(at(path, problem, line=line)) from error
    if text.startswith("["):
        raise InputError(at(path, say("header-section", text=text[:60]), line=line))
    return parsed


def _column_names(path: Path, line: int, text: str) -> list[str]:
    try:
        names = [unescaped(cell.strip()) for cell in next(csv.reader([text.strip()]))]
    except csv.Error as error:
        raise InputError(at(path, say("run-quotation", reason=reason_of(error)), line=line)) from error
    if len(names) == 1 and any(mark in text for mark in ";\t"):
        raise InputError(at(path, say("run-no-commas"), line=line))
    check_names(say("at-place", place=str(path), what=say("place-line", line=line)), names)
    if all(number_in(name) is not None for name in names):
        raise InputError(at(path, say("run-header-row-numbers"), line=line))
    if TIME not in names:
        raise InputError(at(path, say("run-no-time", found=tuple(names[:8])), line=line))
    return names


def _run(path: Path, header: dict[str, Any], rows: Rows) -> Run:
    table = dict(rows.columns)
    time_s = table.pop(TIME)
    check_header(header, path)
    return without_unusable(Run(str(header.get("run", path.stem)), header, time_s, table, str(path), rows.texts))
