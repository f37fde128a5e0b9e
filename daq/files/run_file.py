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
from contextlib import suppress
from datetime import date, datetime, time
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from daq.files.instants import from_json, seconds_of
from daq.files.parquet_columns import ARCHIVE, BESIDE, MICRO, NewerFormat, columns_of, is_archived
from daq.files.qualities import without_unusable
from daq.files.run_rows import (
    CLOSED,
    TIME,
    Rows,
    RowText,
    check_names,
    check_rows,
    escaped,
    number_in,
    numbers_of,
    read_rows,
    row_place,
    unescaped,
    utf8_line,
)
from daq.press.header import check_header, flat_attrs, flat_header, flat_keys, stated_keys
from daq.records import Array, InputError, Run
from daq.tables import LARGEST_BYTES, at, read_toml, reason_of
from daq.words import say, spoken

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_PANDAS = "pandas"
_FOREIGN_METADATA = (_PANDAS, "huggingface", "geo")
"""Schema metadata that other Parquet writers add, as JSON objects; no header keys."""
_PANDAS_ATTRS = "PANDAS_ATTRS"
"""Where `pandas.DataFrame.to_parquet` puts a table's ``attrs``, which are the header: one JSON object."""


_UNREADABLE = (pa.ArrowException, OSError, ValueError, MemoryError)
"""What a damaged Parquet file raises: the last two where a name is no text any more, or a count no count."""
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"

# Numbers without another source were set by hand, 2026-11.

_MOST_BLANKS = 1 << 16
"""A file that begins with more blanks and empty lines than that is empty. [bytes]"""
_ROWS_AT_ONCE = 1 << 16
"""Rows written, or read from Parquet, in one piece."""


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
                return _read_parquet(path, temperatures)
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
    for start in range(0, len(columns[0]), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
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


def _read_parquet(path: Path, temperatures: Sequence[str]) -> Run:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            if is_archived(file):
                return _read_archived(path, file)
            header = _parquet_header(path, file.schema_arrow)
            time = _time_column(path, file.schema_arrow)
            names = _parquet_channels(path, file.schema_arrow, time)
            if not file.metadata.num_rows:
                raise InputError(at(path, say("run-table-empty")))
            rows = _parquet_rows(path, file, names)
            if time not in rows.columns:
                instants = file.read(columns=[time])[time]
                _check_count(path, file, len(instants))
                times = _parquet_times(path, instants, header)
                rows = Rows({TIME: times, **rows.columns}, rows.texts)
    except InputError:
        raise
    except _UNREADABLE as error:
        problem = say("run-no-parquet", reason=reason_of(error))
        raise InputError(at(path, problem, column=_damaged_column(path))) from error
    check_rows(str(path), rows, temperatures=temperatures)
    return _run(path, header, rows)


def _read_archived(path: Path, file: pq.ParquetFile) -> Run:
    """Read a run of the archive as the store gives it out as a file."""
    try:
        columns = columns_of(file)
    except NewerFormat:
        raise InputError(at(path, say("run-archive-newer"))) from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(at(path, say("run-no-parquet", reason=reason_of(error)))) from error
    if TIME not in columns.arrays:
        raise InputError(at(path, say("run-archive-former")))
    header = {k.decode(): _metadata_value(v.decode()) for k, v in file.metadata.metadata.items()}
    header.pop(ARCHIVE)
    table = {name: columns.values(name) for name in columns.forms}
    timed = pa.types.is_decimal(columns.arrays[TIME].type)
    table[TIME] = columns.counts(TIME) / MICRO if timed else columns.plain(TIME)
    texts = {
        name: tuple(text or "" for text in columns.texts(name))
        for name, array in columns.arrays.items()
        if _is_text(array.type) and not name.startswith(BESIDE)
    }
    return _run(path, header, Rows(table, texts))


def _parquet_header(path: Path, schema: pa.Schema) -> dict[str, Any]:
    metadata = {k.decode(): v.decode() for k, v in (schema.metadata or {}).items()}
    attrs = _json_object(metadata.pop(_PANDAS_ATTRS, ""))
    own = {k: v for k, v in metadata.items() if k not in _FOREIGN_METADATA or not v.startswith("{")}
    header = {k: _metadata_value(v) for k, v in own.items()}
    return from_json(flat_attrs(attrs, path)) | flat_header(header, path)


def _time_column(path: Path, schema: pa.Schema) -> str:
    """Return the column of times: `time_s`, else the instants that were a pandas table's index."""
    if TIME in schema.names:
        return TIME
    index = _json_object((schema.metadata or {}).get(_PANDAS.encode(), b"").decode()).get("index_columns", ())
    for name in index:
        if name in schema.names and pa.types.is_timestamp(schema.field(name).type):
            return str(name)
    raise InputError(at(path, say("run-no-time", found=tuple(schema.names[:8]))))


def _parquet_times(path: Path, column: pa.ChunkedArray, header: dict[str, Any]) -> Array:
    """Return instants or durations in seconds; the header gets the start of instants that know their zone."""
    if column.null_count:
        missing = row_place(column.is_null().index(True).as_py())
        raise InputError(at(path, say("at-place", place=missing, what=say("run-time-missing"))))
    if pa.types.is_duration(column.type):
        return np.asarray(column.cast(pa.duration("ns")).cast(pa.int64()).to_numpy() / 1e9, float)
    zone = column.type.tz
    return seconds_of(column.cast(pa.timestamp("ns", zone)).cast(pa.int64()).to_numpy(), header, zoned=bool(zone))


def _json_object(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _parquet_channels(path: Path, schema: pa.Schema, time: str) -> list[str]:
    """Return the columns of a table but for instants or durations that count its rows. Raises `InputError`."""
    check_names(str(path), schema.names)
    kind = schema.field(time).type
    apart = pa.types.is_timestamp(kind) or pa.types.is_duration(kind)
    return [name for name in schema.names if not (apart and name == time)]


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or kind == pa.bool_())


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _parquet_rows(path: Path, file: pq.ParquetFile, names: Sequence[str]) -> Rows:
    """Read the rows, numbers and texts piece by piece, what is neither (dates, categories) as a table has it."""
    kinds = dict(zip(file.schema_arrow.names, file.schema_arrow.types, strict=True))
    columns = {name: np.empty(file.metadata.num_rows) for name in names if _is_number(kinds[name])}
    texts: dict[str, list[str]] = {name: [] for name in names if _is_text(kinds[name])}
    if columns or texts:
        _fill(path, file, columns, texts)
    found = Rows(columns, {name: tuple(kept) for name, kept in texts.items()})
    if others := [name for name in names if name not in columns and name not in texts]:
        from daq.files.table_columns import rows_in  # pandas, which nothing else here needs

        others_read = rows_in(str(path), file.read(columns=others).to_pandas(ignore_metadata=True))
        found = Rows({**columns, **others_read.columns}, {**found.texts, **others_read.texts})
    if odd := next((name for name in (TIME, CLOSED) if name in found.texts), None):
        raise InputError(at(path, say("run-column-type", type=str(kinds[odd])), column=odd))
    return found


def _fill(path: Path, file: pq.ParquetFile, columns: dict[str, Array], texts: dict[str, list[str]]) -> None:
    """Read into columns as long as the file says it is; one that holds more or fewer rows is damaged."""
    known: dict[str, str] = {}
    rows, stated = 0, file.metadata.num_rows
    for piece in file.iter_batches(_ROWS_AT_ONCE, columns=[*columns, *texts]):
        begin, rows = rows, rows + len(piece)
        if rows > stated:
            break
        for name, column in columns.items():
            column[begin:rows] = numbers_of(piece[name].cast(pa.float64(), safe=False))
        for name, kept in texts.items():
            kept += [known.setdefault(cell or "", cell or "") for cell in piece[name].to_pylist()]
    _check_count(path, file, rows)


def _check_count(path: Path, file: pq.ParquetFile, rows: int) -> None:
    if rows != (stated := file.metadata.num_rows):
        reason = say("run-parquet-rows", rows=rows, stated=stated)
        raise InputError(at(path, say("run-no-parquet", reason=reason)))


def _damaged_column(path: Path) -> str | None:
    """Return which column of a Parquet file cannot be read; None where that is not known."""
    name: str | None = None
    with suppress(*_UNREADABLE), pq.ParquetFile(path, page_checksum_verification=True) as file:
        for name in file.schema_arrow.names:
            file.read(columns=[name])
        return None
    return name


def _metadata_value(text: str) -> Any:
    """Read a metadata value: TOML, or the plain text another writer put there."""
    try:
        value = read_toml(f"value = {text}")
    except InputError:
        return text
    return value["value"] if len(value) == 1 else text


def _run(path: Path, header: dict[str, Any], rows: Rows) -> Run:
    table = dict(rows.columns)
    time_s = table.pop(TIME)
    check_header(header, path)
    return without_unusable(Run(str(header.get("run", path.stem)), header, time_s, table, str(path), rows.texts))
