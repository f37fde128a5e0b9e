"""Run files in and out: CSV or Parquet, one row a scan, header keys in front. Nothing is lost either way.

A text column ``quality`` says what deviates (`daq.qualities`); what it calls unusable is read as missing.

Reading goes through pyarrow's parser; only where that objects does a slow pass look for the line and
column to name. Writing goes to a temporary file beside the target and is renamed when it is complete.
"""

from __future__ import annotations

import csv
import io
import json
import math
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
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from daq.qualities import QUALITY, faults_of, without_unusable
from daq.records import Array, BrokenTime, InputError, Run

TIME = "time_s"
CLOSED = "closed"
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_FOREIGN_METADATA = ("pandas", "huggingface", "geo")
"""Schema metadata that other Parquet writers add, as JSON objects; no header keys."""
_MISSING = ("", "nan", "NaN", "NAN")


def read_run(path: Path) -> Run:
    """Read a run file, CSV or Parquet.

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
        return _read_parquet(path, content)
    return _read_csv(path, content)


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
    _check_names([*names, *run.texts], str(path))
    if odd := [n for n, c in zip(names, columns, strict=True) if len(c) != len(run.time_s)]:
        raise InputError(f"{path}: column {odd[0]!r} has another length than time_s")
    _check_table(str(path), names, columns, first_line=1, unit="row")
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
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow([*names, *texts])
    cells = [["" if v != v else repr(v).removesuffix(".0") for v in c.tolist()] for c in columns]
    if texts:
        writer.writerows(zip(*cells, *texts.values(), strict=True))
    else:
        sink.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))
    return sink.getvalue()


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


def _read_csv(path: Path, content: bytes) -> Run:
    header, start, line = _read_header(path, content.removeprefix(b"\xef\xbb\xbf"))
    body = content.removeprefix(b"\xef\xbb\xbf")[start:]
    head, _, rows = body.partition(b"\n")
    names = _column_names(f"{path}: line {line}", _decoded(path, line, head))
    fast = _fast_rows(rows, names)
    if fast is None:
        texts = _text_columns(rows, names)
        fast = _slow_rows(path, rows, names, line + 1, texts), texts
    columns, texts = fast
    names = [name for name in names if name not in texts]
    if len(columns[0]) == 0:
        raise InputError(f"{path}: line {line}: no rows follow the header row; a run needs at least one scan")
    try:
        _check_table(str(path), names, columns, first_line=line + 1, unit="line")
    except InputError:
        _slow_rows(path, rows, [*names, *texts], line + 1, texts)  # names the line, empty lines counted
        raise
    return _run(path, header, names, columns, texts)


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
        text = _decoded(path, line, raw).removeprefix("#").strip()
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


def _decoded(path: Path, line: int, raw: bytes) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: line {line}: not UTF-8 text; save the file as UTF-8") from error


def _column_names(where: str, text: str) -> list[str]:
    names = [cell.strip() for cell in next(csv.reader([text.strip()]))]
    if len(names) == 1 and any(mark in text for mark in ";\t"):
        raise InputError(
            f"{where}: cells are not separated by commas; use comma and dot, or import with a mapping"
        )
    _check_names(names, where)
    if all(_number(name) is not None for name in names):
        raise InputError(f"{where}: the header row is missing: found numbers; it starts with time_s, ...")
    if TIME not in names:
        raise InputError(f"{where}: column time_s is missing; found {', '.join(names[:8])}")
    return names


def _check_names(names: Sequence[str], where: str) -> None:
    for number, name in enumerate(names, start=1):
        if not name or name != name.strip() or "\n" in name or "\r" in name or name.startswith(("#", "\ufeff")):
            raise InputError(f"{where}: column {number} has no usable name ({name!r}); give every column a name")
        if name in names[: number - 1]:
            first = names.index(name) + 1
            raise InputError(f"{where}: column {name!r} occurs twice (columns {first} and {number}); rename one")


def _fast_rows(rows: bytes, names: list[str]) -> tuple[list[Array], dict[str, tuple[str, ...]]] | None:
    """Parse all rows at once, numbers and the text of qualities, or return None where a closer look is due."""
    if not rows.strip():
        return [np.empty(0) for _ in names], {}
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
    columns = [np.asarray(table[n].to_numpy(), float) for n in names if n not in texts]
    return None if any(np.isinf(c).any() for c in columns) else (columns, texts)


def _number(cell: str) -> float | None:
    """Return what a cell says, NaN for a missing value, None for text and infinities."""
    cell = cell.strip()
    if cell in _MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in cell else None


def _text_columns(rows: bytes, names: list[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns of remarks: every cell that is not empty holds text."""
    try:
        table = [row for row in csv.reader(io.StringIO(rows.decode())) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error):
        return {}
    if any(len(row) != len(names) for row in table):
        return {}
    texts = {}
    for name, cells in zip(names, zip(*table, strict=True), strict=True):
        filled = [cell for cell in cells if cell.strip()]
        worded = name == QUALITY or all(re.match("[^0-9.+-]", cell.strip()) for cell in filled)
        if name not in (TIME, CLOSED) and filled and worded:
            texts[name] = tuple(cells)
    return {name: cells for name, cells in texts.items() if all(_number(cell) is None for cell in cells if cell)}


def _slow_rows(
    path: Path, rows: bytes, names: list[str], first_line: int, texts: Mapping[str, tuple[str, ...]]
) -> list[Array]:
    """Parse line by line; raise at the first that is wrong."""
    table: list[list[float]] = []
    last_time, last_line = -math.inf, 0
    for line, raw in enumerate(rows.split(b"\n"), start=first_line):
        text = _decoded(path, line, raw).strip("\r")
        if not text.strip():
            continue
        cells = next(csv.reader([text]))
        if len(cells) != len(names):
            raise InputError(
                f"{path}: line {line}: {len(cells)} cells, but the header row has {len(names)} columns; "
                "leave a missing value as an empty cell"
            )
        where = f"{path}: line {line}"
        values = [_cell(where, n, cell) for n, cell in zip(names, cells, strict=True) if n not in texts]
        now = values[[n for n in names if n not in texts].index(TIME)]
        if now <= last_time:
            raise BrokenTime(
                f"{path}: line {line}: time_s = {now!r} does not rise (line {last_line}: {last_time!r}); "
                "sort the rows, remove doubled ones"
            )
        last_time, last_line = now, line
        table.append(values)
    return [np.array(column) for column in zip(*table, strict=True)] if table else [np.empty(0) for _ in names]


def _cell(where: str, name: str, cell: str) -> float:
    value = _number(cell)
    if value is None:
        raise InputError(f"{where}: column {name}: {cell.strip()!r} is not a number; leave a missing value empty")
    if name == TIME and value != value:
        raise BrokenTime(f"{where}: column time_s: the time is missing; every row needs one")
    if name == CLOSED and value not in (0.0, 1.0) and value == value:
        raise InputError(f"{where}: column closed: {cell.strip()!r} must be 0 (open) or 1 (closed)")
    return value


def _check_table(
    where: str, names: Sequence[str], columns: Sequence[Array], *, first_line: int, unit: str
) -> None:
    """Check a parsed table as a whole; lines count from `first_line`."""
    for name, column in zip(names, columns, strict=True):
        if len(bad := np.flatnonzero(np.isinf(column))):
            raise InputError(f"{where}: {unit} {first_line + bad[0]}: column {name}: infinite; must be a number")
        if name == CLOSED and len(bad := np.flatnonzero(~np.isin(column, (0.0, 1.0)) & ~np.isnan(column))):
            value = column[bad[0]]
            row = first_line + bad[0]
            raise InputError(f"{where}: {unit} {row}: column closed: {value:g} must be 0 (open) or 1 (closed)")
        if name != TIME:
            continue
        if len(bad := np.flatnonzero(np.isnan(column))):
            raise BrokenTime(f"{where}: {unit} {first_line + bad[0]}: column time_s: the time is missing")
        if len(bad := np.flatnonzero(np.diff(column) <= 0)):
            i = int(bad[0]) + 1
            raise BrokenTime(
                f"{where}: {unit} {first_line + i}: time_s = {float(column[i])!r} does not rise "
                f"({unit} {first_line + i - 1}: {float(column[i - 1])!r}); sort the rows, remove doubled ones"
            )


def _read_parquet(path: Path, content: bytes) -> Run:
    try:
        table = pq.read_table(pa.BufferReader(content), page_checksum_verification=True)
    except (pa.ArrowInvalid, OSError) as error:
        reason = str(error).splitlines()[0]
        where = f"{path}: {_damaged_column(content)}"
        raise InputError(f"{where}not a readable Parquet file ({reason}); it is cut short or damaged") from error
    names = list(table.column_names)
    _check_names(names, str(path))
    if TIME not in names:
        raise InputError(f"{path}: column time_s is missing; found {', '.join(names[:8])}")
    columns, texts = [], dict[str, tuple[str, ...]]()
    for name, column in zip(names, table.columns, strict=True):
        if pa.types.is_string(column.type) and name not in (TIME, CLOSED):
            texts[name] = tuple(cell or "" for cell in column.to_pylist())
            continue
        if not (
            pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or column.type == pa.bool_()
        ):
            raise InputError(f"{path}: column {name}: type {column.type} is not a number; store it as float64")
        columns.append(np.asarray(column.cast(pa.float64()).to_numpy(), float))
    names = [name for name in names if name not in texts]
    if not len(columns[0]):
        raise InputError(f"{path}: the table has no rows; a run needs at least one scan")
    _check_table(str(path), names, columns, first_line=1, unit="row")
    metadata = {k.decode(): v.decode() for k, v in (table.schema.metadata or {}).items()}
    own = {k: v for k, v in metadata.items() if k not in _FOREIGN_METADATA or not v.startswith("{")}
    header = {k: _metadata_value(v) for k, v in own.items()}
    return _run(path, header, names, columns, texts)


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


def _run(
    path: Path,
    header: dict[str, Any],
    names: list[str],
    columns: list[Array],
    texts: Mapping[str, tuple[str, ...]],
) -> Run:
    table = dict(zip(names, columns, strict=True))
    time_s = table.pop(TIME)
    return without_unusable(Run(str(header.get("run", path.stem)), header, time_s, table, str(path), texts))
