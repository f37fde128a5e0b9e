"""A run out of a Parquet file: header and rows, of our own files, of the archive's and of other writers'."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from daq.files.instants import from_json, seconds_of
from daq.files.parquet_columns import ARCHIVE, BESIDE, MICRO, NewerFormat, columns_of, is_archived
from daq.files.run_rows import (
    CLOSED,
    TIME,
    Rows,
    check_names,
    check_rows,
    numbers_of,
    row_place,
)
from daq.press.header import flat_attrs, flat_header
from daq.records import Array, InputError
from daq.tables import at, read_toml, reason_of
from daq.words import say

ROWS_AT_ONCE = 1 << 16
"""Rows written, or read from Parquet, in one piece. By hand, 2026-11."""
_PANDAS = "pandas"
_FOREIGN_METADATA = (_PANDAS, "huggingface", "geo")
"""Schema metadata that other Parquet writers add, as JSON objects; no header keys."""
_PANDAS_ATTRS = "PANDAS_ATTRS"
"""Where `pandas.DataFrame.to_parquet` puts a table's ``attrs``, which are the header: one JSON object."""
_UNREADABLE = (pa.ArrowException, OSError, ValueError, MemoryError)
"""What a damaged Parquet file raises: the last two where a name is no text any more, or a count no count."""


def read_parquet(path: Path, temperatures: Sequence[str]) -> tuple[dict[str, Any], Rows]:
    """Return header and rows. Raises `InputError` naming file, column and what is wrong."""
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
    return header, rows


def _read_archived(path: Path, file: pq.ParquetFile) -> tuple[dict[str, Any], Rows]:
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
    return header, Rows(table, texts)


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
    for piece in file.iter_batches(ROWS_AT_ONCE, columns=[*columns, *texts]):
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
