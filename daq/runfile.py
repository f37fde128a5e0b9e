"""Run files in and out: CSV or Parquet, one row a scan, header keys in front. Nothing is lost either way.

A text column ``quality`` says what deviates (`daq.qualities`); what it calls unusable is read as missing.

Writing goes to a temporary file beside the target and is renamed when it is complete.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from daq.qualities import without_unusable
from daq.records import Array, InputError, Run
from daq.runrows import CLOSED, TIME, Rows, check_names, check_rows, decoded, number_in, read_rows

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_FOREIGN_METADATA = ("pandas", "huggingface", "geo")
"""Schema metadata that other Parquet writers add, as JSON objects; no header keys."""


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
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read the run file: {error.strerror or error}") from error
    if not content.strip():
        raise InputError(f"{path}: the file is empty; a run file has '# key = value' lines, a header row, rows")
    if content[:4] == b"PAR1" or path.suffix.lower() in (".parquet", ".pq"):
        return _read_parquet(path, content, temperatures)
    return _read_csv(path, content, temperatures)


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
        raise InputError(f"{path}: column {odd[0]!r} has another length than time_s")
    check_rows(str(path), Rows(dict(zip(names, columns, strict=True)), {}))
    if path.suffix.lower() in (".parquet", ".pq"):
        metadata = {key: toml_value(value) for key, value in flat_keys(header)}
        fields = [pa.field(n, pa.float64()) for n in names] + [pa.field(n, pa.string()) for n in run.texts]
        arrays = [pa.array(c, from_pandas=True) for c in columns] + [pa.array(t) for t in run.texts.values()]
        sink = io.BytesIO()
        table = pa.table(arrays, schema=pa.schema(fields, metadata=metadata))
        pq.write_table(table, sink, write_page_checksum=True)
        _replace(path, sink.getvalue())
    else:
        _replace(path, _csv_text(header, names, columns, run.texts).encode())


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
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, Mapping):
        return "{" + ", ".join(toml_line(k, v) for k, v in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    raise InputError(f"header value {value!r}: a run file holds text, numbers, true/false, times and lists")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def flat_keys(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Walk nested tables as dotted keys; None is left out."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from flat_keys(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", value


def _csv_text(
    header: Mapping[str, Any],
    names: Sequence[str],
    columns: Sequence[Array],
    texts: Mapping[str, tuple[str, ...]],
) -> str:
    sink = io.StringIO()
    for key, value in flat_keys(header):
        sink.write(f"# {toml_line(key, value)}\n")
    sink.write(",".join(_csv_cell(name) for name in (*names, *texts)) + "\n")
    cells = [["" if v != v else repr(v).removesuffix(".0") for v in c.tolist()] for c in columns]
    words = [[_csv_cell(text) for text in column] for column in texts.values()]
    sink.writelines(",".join(row) + "\n" for row in zip(*cells, *words, strict=True))
    return sink.getvalue()


def _csv_cell(text: str) -> str:
    """Quote what needs it, line breaks of either kind too."""
    return '"' + text.replace('"', '""') + '"' if re.search('[,"\r\n]', text) else text


def _replace(path: Path, content: bytes) -> None:
    """Put `content` at `path` whole or not at all."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror or error}") from error
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _read_csv(path: Path, content: bytes, temperatures: Sequence[str]) -> Run:
    content = content.removeprefix(b"\xef\xbb\xbf")
    header, start, line = _read_header(path, content)
    head, _, rows = content[start:].partition(b"\n")
    names = _column_names(f"{path}: line {line}", decoded(str(path), line, head))
    return _run(path, header, read_rows(str(path), rows, names, line + 1, temperatures))


def _read_header(path: Path, content: bytes) -> tuple[dict[str, Any], int, int]:
    """Return the keys, the offset of the header row and its line number."""
    header: dict[str, Any] = {}
    position, line = 0, 1
    while position < len(content):
        end = content.find(b"\n", position)
        end = len(content) if end < 0 else end
        raw = content[position:end].strip()
        if raw and not raw.startswith(b"#"):
            return header, position, line
        text = decoded(str(path), line, raw).removeprefix("#").strip()
        try:
            parsed = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise InputError(
                f"{path}: line {line}: '# {text[:60]}' is not 'key = value' in TOML ({error}); "
                "put text in quotes, start a remark with '##'"
            ) from error
        if text.startswith("["):
            raise InputError(
                f"{path}: line {line}: '# {text[:60]}': sections are not read; write '# panel.key = value'"
            )
        for key, value in flat_keys(parsed):
            if key in header:
                raise InputError(f"{path}: line {line}: header key {key} is given twice; keep one")
            header[key] = value
        position, line = end + 1, line + 1
    raise InputError(f"{path}: line {line}: the header row is missing; it starts with time_s, ...")


def _column_names(where: str, text: str) -> list[str]:
    names = [cell.strip() for cell in next(csv.reader([text.strip()]))]
    if len(names) == 1 and any(mark in text for mark in ";\t"):
        raise InputError(
            f"{where}: cells are not separated by commas; use comma and dot, or import with a mapping"
        )
    check_names(where, names)
    if all(number_in(name) is not None for name in names):
        raise InputError(f"{where}: the header row is missing: found numbers; it starts with time_s, ...")
    if TIME not in names:
        raise InputError(f"{where}: column time_s is missing; found {', '.join(names[:8])}")
    return names


def _read_parquet(path: Path, content: bytes, temperatures: Sequence[str]) -> Run:
    try:
        table = pq.read_table(pa.BufferReader(content), page_checksum_verification=True)
    except (pa.ArrowInvalid, OSError) as error:
        reason = str(error).splitlines()[0]
        where = f"{path}: {_damaged_column(content)}"
        raise InputError(f"{where}not a readable Parquet file ({reason}); it is cut short or damaged") from error
    names = list(table.column_names)
    check_names(str(path), names)
    if TIME not in names:
        raise InputError(f"{path}: column time_s is missing; found {', '.join(names[:8])}")
    columns, texts = dict[str, Array](), dict[str, tuple[str, ...]]()
    for name, column in zip(names, table.columns, strict=True):
        if pa.types.is_string(column.type) and name not in (TIME, CLOSED):
            texts[name] = tuple(cell or "" for cell in column.to_pylist())
            continue
        if not (
            pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or column.type == pa.bool_()
        ):
            raise InputError(f"{path}: column {name}: type {column.type} is not a number; store it as float64")
        columns[name] = np.asarray(column.cast(pa.float64()).to_numpy(), float)
    if not len(columns[TIME]):
        raise InputError(f"{path}: the table has no rows; a run needs at least one scan")
    rows = Rows(columns, texts)
    check_rows(str(path), rows, temperatures=temperatures)
    metadata = {k.decode(): v.decode() for k, v in (table.schema.metadata or {}).items()}
    own = {k: v for k, v in metadata.items() if k not in _FOREIGN_METADATA or not v.startswith("{")}
    header = {k: _metadata_value(v) for k, v in own.items()}
    return _run(path, header, rows)


def _damaged_column(content: bytes) -> str:
    """Return which column of a Parquet file cannot be read, to begin a message with; empty where none can be."""
    try:
        file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
    except (pa.ArrowInvalid, OSError):
        return ""
    for name in file.schema_arrow.names:
        try:
            file.read(columns=[name])
        except (pa.ArrowInvalid, OSError):
            return f"column {name}: "
    return ""


def _metadata_value(text: str) -> Any:
    """Read a metadata value: TOML, or the plain text another writer put there."""
    try:
        value = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return value["value"] if len(value) == 1 else text


def _run(path: Path, header: dict[str, Any], rows: Rows) -> Run:
    table = dict(rows.columns)
    time_s = table.pop(TIME)
    return without_unusable(Run(str(header.get("run", path.stem)), header, time_s, table, str(path), rows.texts))
