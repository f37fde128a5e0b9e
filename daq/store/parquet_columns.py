"""Tables as Parquet files that are small, proved when they are written and refused when they have changed.

Loggers give whole multiples of a step (0.1 K), so a column is kept as whole numbers with that step, and only what
does not fit as plain doubles (2026-11-24). `value = (base + step x count) / per`, or times 1 / per where a driver
multiplied, or `first + step x count` of a device with a scale of its own; units in the last place, as a sum leaves
them, stand in a column of their own. Counts are written as differences from row to row, even numbers up and odd
ones down, byte by byte apart: half a byte each.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from daq.files.run_rows import numbers_of
from daq.records import Array, InputError
from daq.store.records import ArchiveUnreadable
from daq.words import say

Integers = npt.NDArray[np.int64]
Form = Mapping[str, float]
"""How counts become values; empty for values that are written as they are."""
FORMAT = 1
"""Of the files: a reader refuses a higher one, as of a newer version."""
SUM = ".sha256"
"""Ending of the file beside it that holds its sum, for ``sha256sum --check``."""

_ULPS = ".last_place"
_KEY = b"kerntemp"

# Numbers without another source were set by hand, 2026-11.

_MOST_DECIMALS = 6
"""Of a value that counts in decimal steps: no logger of the profiles prints more."""
_MOST_PARTS = 3
"""The smallest distance of two values may be so many steps, where steps between were never read."""
_MOST_ULPS = 1 << 15
"""Units in the last place by which a value may lie beside its step: a sum leaves hundreds near 0 °C."""
_MOST_COUNT = float(1 << 53)
"""Whole numbers up to here are exact as doubles. (IEEE 754)"""


@dataclass
class Columns:
    """A table that is made, or that was read."""

    arrays: dict[str, pa.Array] = field(default_factory=dict)
    forms: dict[str, Form] = field(default_factory=dict)
    told: Mapping[str, Any] = field(default_factory=dict)
    """What else stands in the file's metadata."""

    def add_values(self, name: str, values: Array) -> None:
        """Add a column of floats, NaN where there is none."""
        self.forms[name] = _add(self.arrays, name, values)

    def add_counts(self, name: str, counts: Array) -> None:
        """Add a column of whole numbers, NaN where there is none."""
        self.arrays[name] = _differences(counts)

    def add_plain(self, name: str, values: Array) -> None:
        """Add a column of floats as they are."""
        self.arrays[name] = _nullable(values, pa.float64())

    def add_texts(self, name: str, texts: Any) -> None:
        """Add a column of texts or None."""
        self.arrays[name] = pa.array(texts, pa.string())

    def counts(self, name: str) -> Array:
        """Return a column of whole numbers, as floats with NaN."""
        return _undone(self.arrays[name])

    def plain(self, name: str) -> Array:
        """Return a column of floats that were added as they are."""
        return np.array(numbers_of(self.arrays[name]))

    def values(self, name: str) -> Array:
        """Return a column of floats to the last bit."""
        form = self.forms[name]
        if not form:
            return self.plain(name)
        found = _scaled(form, self.counts(name))
        if name + _ULPS in self.arrays:
            shift = np.nan_to_num(self.counts(name + _ULPS)).astype(np.int64)
            found = np.where(np.isnan(found), np.nan, (_bits(found) + shift).view(float))
        return found

    def texts(self, name: str) -> tuple[str | None, ...]:
        """Return a column of texts."""
        return tuple(self.arrays[name].to_pylist())


@dataclass(frozen=True)
class Written:
    """A file that was written, read back and found to hold what it should."""

    sha256: str
    bytes: int


def write_proved(path: Path, made: Columns, same: Callable[[Columns], bool]) -> Written:
    """Write a table, read it back from the disk, have every value compared, then give the file its name and sum.

    Raises
    ------
    InputError
        Where a file of that name holds something else, or what is read back is not what was written.
    OSError
        Where the disk refuses.
    """
    if path.exists():
        return _found(path, same)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    told = json.dumps({"format": FORMAT, "forms": made.forms, **made.told}, ensure_ascii=False)
    table = pa.table(made.arrays).replace_schema_metadata({_KEY: told})
    texts = [f.name for f in table.schema if pa.types.is_string(f.type)]
    with part.open("wb") as file:
        pq.write_table(
            table,
            file,
            compression="zstd",
            compression_level=9,
            use_dictionary=texts,
            column_encoding={n: "BYTE_STREAM_SPLIT" for n in table.column_names if n not in texts},
            write_statistics=False,
        )
        file.flush()
        _to_disk(file.fileno())
    content = part.read_bytes()
    if not same(columns_in(content, path)):
        raise InputError(say("archive-not-as-written", file=str(path)))
    part.replace(path)
    return _with_sum(path, content)


def read_proved(path: Path, sha256: str) -> Columns:
    """Return the table of a file that has this sum.

    Raises
    ------
    ArchiveUnreadable
        For a file that is missing or was changed, with what to do.
    """
    return columns_in(sound_content(path, sha256), path)


def sound_content(path: Path, sha256: str) -> bytes:
    """Return a file's bytes; raises `ArchiveUnreadable` where it is missing or has another sum."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise ArchiveUnreadable(say("archive-file-missing", file=str(path))) from None
    except OSError as error:
        raise ArchiveUnreadable(say("archive-file-unreadable", file=str(path), reason=str(error))) from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ArchiveUnreadable(say("archive-file-damaged", file=str(path)))
    return content


def _found(path: Path, same: Callable[[Columns], bool]) -> Written:
    """Take a file that a killed job left; one that holds something else belongs to another store."""
    content = path.read_bytes()
    try:
        mine = same(columns_in(content, path))
    except (ArchiveUnreadable, KeyError):
        mine = False
    if not mine:
        raise InputError(say("archive-file-taken", file=str(path)))
    return _with_sum(path, content)


def _with_sum(path: Path, content: bytes) -> Written:
    """Put a file's sum beside it, and both their names on the disk."""
    found = hashlib.sha256(content).hexdigest()
    with path.with_name(path.name + SUM).open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{found}  {path.name}\n")
        file.flush()
        os.fsync(file.fileno())
    sync_folder(path.parent)
    return Written(found, len(content))


def _to_disk(descriptor: int) -> None:
    """Write a file through, and let go of the copy in memory, so that reading it back asks the disk."""
    os.fsync(descriptor)
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)


def sync_folder(folder: Path) -> None:
    """Write a folder's names through, where the system can."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _add(columns: dict[str, pa.Array], name: str, values: Array) -> Form:
    """Add a column's values, as counts where that gives every bit back; returns how to read them."""
    best: tuple[int, Form, Array, Integers] | None = None
    for form, counts in _counted(values):
        ulps = _bits(values) - _bits(_scaled(form, counts))
        ulps[np.isnan(values)] = 0
        beside = int(np.count_nonzero(ulps))
        if ((ulps >= -_MOST_ULPS) & (ulps <= _MOST_ULPS)).all() and (best is None or beside < best[0]):
            best = beside, form, counts, ulps
        if best is not None and best[0] == 0:
            break
    if best is None:
        columns[name] = _nullable(values, pa.float64())
        return {}
    beside, form, counts, ulps = best
    columns[name] = _differences(counts)
    if beside:
        columns[name + _ULPS] = _differences(np.where(np.isnan(values), np.nan, ulps))
    return form


def _counted(values: Array) -> Iterator[tuple[Form, Array]]:
    """Yield ways to write values as whole numbers; which of them gives the values back is for the caller to see.

    Decimals, divided or multiplied by the inverse (the two differ in the last place), then any step at all, as of
    a device whose full scale is some temperature.
    """
    there = values[~np.isnan(values)]
    if np.isinf(values).any():
        return
    for per in (10**decimals for decimals in range(_MOST_DECIMALS + 1)):
        counted = np.rint(values * per)
        if not (np.abs(there * per) < _MOST_COUNT).all():
            return
        base = int(np.rint(there * per).min()) if len(there) else 0
        apart = (np.rint(there * per) - base).astype(np.int64)
        step = int(np.gcd.reduce(apart)) or 1 if len(apart) else 1
        for way in ("per", "times"):
            yield {"base": base, "step": step, way: per}, (counted - base) / step
    yield from _of_own_step(values, np.unique(there))


def _of_own_step(values: Array, levels: Array) -> Iterator[tuple[Form, Array]]:
    """Yield counts of the smallest difference between levels, and of parts of it: one step may never occur."""
    if len(levels) < 2:
        return
    with np.errstate(over="ignore"):  # more steps than a number can hold are too many as well
        width = levels[-1] - levels[0]
        steps = width / np.diff(levels).min()
    if not steps < _MOST_COUNT / _MOST_PARTS:
        return
    for parts in range(1, _MOST_PARTS + 1):
        step = width / np.rint(steps * parts)
        yield {"first": float(levels[0]), "step": float(step)}, np.rint((values - levels[0]) / step)


def _scaled(form: Form, counts: Array) -> Array:
    """Return the values that counts stand for."""
    if "first" in form:
        return form["first"] + form["step"] * counts
    whole = form["base"] + form["step"] * counts
    return whole / form["per"] if "per" in form else whole * (1.0 / form["times"])


def _bits(values: Array) -> Integers:
    return np.ascontiguousarray(values, dtype=float).view(np.int64).copy()


def _differences(counts: Array) -> pa.Array:
    """Return whole numbers as differences, 2 d up and -2 d - 1 down; a missing one stays as it was before."""
    there = ~np.isnan(counts)
    last = np.maximum.accumulate(np.where(there, np.arange(len(counts)), 0))
    filled = np.nan_to_num(counts)[last].astype(np.int64)
    steps = np.diff(filled, prepend=0)
    folded = np.where(steps < 0, -2 * steps - 1, 2 * steps)
    kind = pa.int32() if folded.max(initial=0) < 1 << 31 else pa.int64()
    return pa.array(folded, mask=~there).cast(kind)


def _undone(folded: pa.Array) -> Array:
    """Return what `_differences` was given."""
    steps = np.from_dlpack(folded.fill_null(0)).astype(np.int64)  # as in `numbers_of`: without pandas
    counts = np.cumsum(np.where(steps % 2, -(steps + 1) // 2, steps // 2)).astype(float)
    counts[np.from_dlpack(folded.is_null().cast(pa.int8())) != 0] = np.nan
    return counts


def _nullable(values: Array, kind: pa.DataType) -> pa.Array:
    missing = np.isnan(values)
    return pa.array(np.where(missing, 0, values), mask=missing).cast(kind)


def columns_in(content: bytes, path: Path) -> Columns:
    """Read a file's bytes; `path` is for what is said of it."""
    try:
        file = pq.ParquetFile(pa.BufferReader(content))
        told = json.loads(file.metadata.metadata[_KEY])
        if told["format"] > FORMAT:
            raise ArchiveUnreadable(say("archive-file-newer", file=str(path)))
        table = file.read(use_threads=False)
        arrays = {name: table.column(name).combine_chunks() for name in table.column_names}
        return Columns(arrays, told["forms"], told)
    except (pa.ArrowException, KeyError, TypeError, ValueError) as error:
        if isinstance(error, ArchiveUnreadable):
            raise
        raise ArchiveUnreadable(say("archive-file-damaged", file=str(path))) from error
