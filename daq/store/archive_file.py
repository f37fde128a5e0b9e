"""One run's scans as a Parquet file: small, sound or refused, every value back to the last bit.

Loggers give whole multiples of a step (0.1 K), so a column is kept as whole numbers with that step, and only what
does not fit as plain doubles (2026-11-24). `value = (base + step x count) / per`, or times 1 / per where a driver
multiplied, or `first + step x count` of a device with a scale of its own; units in the last place, as a sum leaves
them, stand in a column of their own. Counts are written as differences from scan to scan, even numbers up and odd
ones down, byte by byte apart: half a byte each.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from daq.records import Array, InputError
from daq.store.records import ArchiveUnreadable
from daq.words import say

Integers = npt.NDArray[np.int64]
Form = Mapping[str, float]
"""How counts become values; empty for values that are written as they are."""
FORMAT = 1
SUM = ".sha256"
"""Ending of the file beside it that holds its sum, for ``sha256sum --check``."""
MICRO = 1e6
"""Instants are whole microseconds: that is what clocks here give. [1/s]"""

_OWN = "scan."
_ULPS = ".last_place"
_KEY = b"kerntemp"

# Numbers without another source were set by hand, 2026-11.

_MOST_DECIMALS = 6
_MOST_PARTS = 3
_MOST_ULPS = 1 << 15
"""Units in the last place by which a value may lie beside its step: a sum leaves hundreds near 0 °C."""
_MOST_COUNT = float(1 << 53)
"""Whole numbers up to here are exact as doubles. (IEEE 754)"""


@dataclass(frozen=True)
class StoredScans:
    """Scans as the store keeps them, [n] of each; qualities and remarks are the store's own JSON."""

    number: Integers
    unix_s: Array
    """NaN where nobody said when a run was."""
    monotonic_s: Array
    layout: Integers
    values: Mapping[int, Array]
    """By layout: its scans in order, by its channels."""
    faults: Sequence[str | None]
    remarks: Sequence[str | None]

    def __len__(self) -> int:
        return len(self.number)

    def at(self, chosen: npt.NDArray[np.bool_]) -> StoredScans:
        """Return the scans that are chosen, [n]."""
        values = {key: values[chosen[self.layout == key]] for key, values in self.values.items()}
        return StoredScans(
            self.number[chosen],
            self.unix_s[chosen],
            self.monotonic_s[chosen],
            self.layout[chosen],
            {key: own for key, own in values.items() if len(own)},
            *(tuple(itertools.compress(texts, chosen)) for texts in (self.faults, self.remarks)),
        )

    def same_as(self, other: StoredScans) -> bool:
        """Whether all of it is the same, floats to the last bit."""
        mine, its = (
            [x.number, x.unix_s, x.monotonic_s, x.layout, *(x.values[key] for key in sorted(x.values))]
            for x in (self, other)
        )
        return (
            sorted(self.values) == sorted(other.values)
            and all(a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(mine, its, strict=True))
            and (*self.faults, *self.remarks) == (*other.faults, *other.remarks)
        )


@dataclass(frozen=True)
class Written:
    """A file that was written, read back and found to hold what it should."""

    sha256: str
    bytes: int


def write_archive(
    path: Path, scans: StoredScans, channels: Mapping[int, Sequence[str]], about: Mapping[str, Any]
) -> Written:
    """Write scans, read them back from the disk, compare every value, then give the file its name and sum.

    Parameters
    ----------
    channels
        Names by layout, in the order of the values.
    about
        Goes into the file's metadata, for people: which run this is.

    Raises
    ------
    InputError
        Where a file of that name holds something else, or what is read back is not what was written.
    OSError
        Where the disk refuses.
    """
    if path.exists():
        return _found(path, scans)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    table = _table(scans, channels, about)
    numbers = [f.name for f in table.schema if not pa.types.is_string(f.type)]
    with part.open("wb") as file:
        pq.write_table(
            table,
            file,
            compression="zstd",
            compression_level=9,
            use_dictionary=[f.name for f in table.schema if pa.types.is_string(f.type)],
            column_encoding=dict.fromkeys(numbers, "BYTE_STREAM_SPLIT"),
            write_statistics=False,
        )
        _to_disk(file.fileno())
    content = part.read_bytes()
    if not _scans_in(content, path).same_as(scans):
        raise InputError(say("archive-not-as-written", file=str(path)))
    part.replace(path)
    return _with_sum(path, content)


def read_archive(path: Path, sha256: str) -> StoredScans:
    """Return the scans of a file that has this sum.

    Raises
    ------
    ArchiveUnreadable
        For a file that is missing or was changed, with what to do.
    """
    return _scans_in(sound_content(path, sha256), path)


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


def _found(path: Path, scans: StoredScans) -> Written:
    """Take a file that a killed job left; one that holds something else belongs to another store."""
    content = path.read_bytes()
    try:
        same = _scans_in(content, path).same_as(scans)
    except ArchiveUnreadable:
        same = False
    if not same:
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


def _table(scans: StoredScans, channels: Mapping[int, Sequence[str]], about: Mapping[str, Any]) -> pa.Table:
    """Return the columns as they are written, with what reads them in the metadata."""
    columns: dict[str, pa.Array] = {}
    forms: dict[str, Form] = {}
    seconds = np.rint(scans.monotonic_s * MICRO)
    for name, values in (("monotonic", scans.monotonic_s), *_by_channel(scans, channels)):
        forms[name] = _add(columns, name, values)
    beside = np.rint(scans.unix_s * MICRO) - seconds
    exact = np.array_equal((beside + seconds) / MICRO, scans.unix_s, equal_nan=True)
    columns[_OWN + "unix"] = _differences(beside) if exact else _nullable(scans.unix_s, pa.float64())
    columns[_OWN + "number"] = _differences(scans.number.astype(float))
    columns[_OWN + "layout"] = _differences(scans.layout.astype(float))
    columns[_OWN + "faults"] = pa.array(scans.faults, pa.string())
    columns[_OWN + "remarks"] = pa.array(scans.remarks, pa.string())
    layouts = {str(key): list(channels[key]) for key in scans.values}
    told = {"format": FORMAT, "about": dict(about), "layouts": layouts, "forms": forms}
    return pa.table(columns).replace_schema_metadata({_KEY: json.dumps(told, ensure_ascii=False)})


def _by_channel(scans: StoredScans, channels: Mapping[int, Sequence[str]]) -> Iterator[tuple[str, Array]]:
    """Yield each channel's values, NaN in scans of layouts without it."""
    whole: dict[str, Array] = {}
    for key, values in scans.values.items():
        for i, name in enumerate(channels[key]):
            whole.setdefault("=" + name, np.full(len(scans), np.nan))[scans.layout == key] = values[:, i]
    yield from whole.items()


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
    if (
        len(levels) < 2
        or not (width := levels[-1] - levels[0]) / np.diff(levels).min() < _MOST_COUNT / _MOST_PARTS
    ):
        return
    for parts in range(1, _MOST_PARTS + 1):
        step = width / np.rint(width / np.diff(levels).min() * parts)
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


def _undone(column: pa.ChunkedArray) -> Array:
    """Return what `_differences` was given."""
    folded = column.combine_chunks()
    steps = folded.fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
    counts = np.cumsum(np.where(steps % 2, -(steps + 1) // 2, steps // 2)).astype(float)
    counts[folded.is_null().to_numpy(zero_copy_only=False)] = np.nan
    return counts


def _nullable(values: Array, kind: pa.DataType) -> pa.Array:
    missing = np.isnan(values)
    return pa.array(np.where(missing, 0, values), mask=missing).cast(kind)


def _scans_in(content: bytes, path: Path) -> StoredScans:
    """Read a file's bytes; `path` is for what is said of it."""
    try:
        file = pq.ParquetFile(pa.BufferReader(content))
        told = json.loads(file.metadata.metadata[_KEY])
        if told["format"] > FORMAT:
            raise ArchiveUnreadable(say("archive-file-newer", file=str(path)))
        return _scans_of(file.read(use_threads=False), told)
    except (pa.ArrowException, KeyError, TypeError, ValueError) as error:
        if isinstance(error, ArchiveUnreadable):
            raise
        raise ArchiveUnreadable(say("archive-file-damaged", file=str(path))) from error


def _scans_of(table: pa.Table, told: Mapping[str, Any]) -> StoredScans:
    def counts(name: str) -> Array:
        return _undone(table.column(name))

    def plain(name: str) -> Array:
        column = table.column(name).combine_chunks()
        return np.array(column.to_numpy(zero_copy_only=False), dtype=float)

    def values(name: str) -> Array:
        form = told["forms"][name]
        if not form:
            return plain(name)
        found = _scaled(form, counts(name))
        if name + _ULPS in table.column_names:
            shift = np.nan_to_num(counts(name + _ULPS)).astype(np.int64)
            found = np.where(np.isnan(found), np.nan, (_bits(found) + shift).view(float))
        return found

    monotonic_s = values("monotonic")
    if pa.types.is_integer(table.schema.field(_OWN + "unix").type):
        unix_s = (counts(_OWN + "unix") + np.rint(monotonic_s * MICRO)) / MICRO
    else:
        unix_s = plain(_OWN + "unix")
    layout = counts(_OWN + "layout").astype(np.int64)
    found = {}
    for key, names in told["layouts"].items():
        chosen = layout == int(key)
        columns = [values("=" + name)[chosen] for name in names]
        found[int(key)] = np.array(columns).T if columns else np.empty((int(chosen.sum()), 0))
    return StoredScans(
        number=counts(_OWN + "number").astype(np.int64),
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        layout=layout,
        values=found,
        faults=tuple(table.column(_OWN + "faults").to_pylist()),
        remarks=tuple(table.column(_OWN + "remarks").to_pylist()),
    )
