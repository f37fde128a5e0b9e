"""Tables as Parquet files that are small, give every bit back, and that any program can read.

Loggers give whole multiples of a step (0.1 K), so a column is kept as decimal numbers, packed as differences.
Where the step is another one the column counts it, `value = (base + step x count) / per`, or times 1 / per where a
driver multiplied, or `first + step x count` of a device with a scale of its own, with these numbers in the file's
metadata. Only what does not fit is kept as plain doubles. Units in the last place, as a sum leaves them, stand in
a column of their own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from daq.files.run_rows import numbers_of
from daq.records import Array

Integers = npt.NDArray[np.int64]
Form = Mapping[str, float]
"""How counts become values; empty for values that are written as they are."""
FORMAT = 2
"""Of the files: a reader refuses a higher one, as of a newer version."""

ARCHIVE = "kerntemp"
"""Key in a file's metadata: a JSON object with its format and how columns count."""
BESIDE = "scan."
"""How columns begin that are the store's own and no channel's."""
TIME_DECIMALS = 6
"""Of an instant in seconds."""
MICRO = 10.0**TIME_DECIMALS
"""Instants are whole microseconds: that is what clocks here give. [1/s]"""
LAST_PLACE = ".last_place"
"""Ending of a column of units in the last place, to be added to the bits of the values beside it."""
_DIGITS = 18
"""Most that Parquet's DECIMAL has in eight bytes, by its definition of logical types."""

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
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """What else stands in the file's metadata, for this program."""
    header: Mapping[str, str] = field(default_factory=dict)
    """Keys of a run's header in the metadata, each with its value as TOML."""

    def __len__(self) -> int:
        return max(map(len, self.arrays.values()), default=0)

    def add_values(self, name: str, values: Array) -> None:
        """Add a column of floats, NaN where there is none."""
        self.forms[name] = _add(self.arrays, name, values)

    def add_decimals(self, name: str, counts: Array, decimals: int) -> None:
        """Add a column of counts / 10^decimals, NaN where there is none."""
        self.arrays[name] = _decimal(counts, decimals)

    def add_counts(self, name: str, counts: Array) -> None:
        """Add a column of whole numbers, NaN where there is none."""
        self.arrays[name] = _nullable(counts, pa.int64())

    def add_plain(self, name: str, values: Array) -> None:
        """Add a column of floats as they are."""
        self.arrays[name] = _nullable(values, pa.float64())

    def add_texts(self, name: str, texts: Any) -> None:
        """Add a column of texts or None."""
        self.arrays[name] = pa.array(texts, pa.string())

    def counts(self, name: str) -> Array:
        """Return a column of whole numbers, or what decimals count, as floats with NaN."""
        return _counts_of(self.arrays[name])

    def plain(self, name: str) -> Array:
        """Return a column of floats that were added as they are."""
        return np.array(numbers_of(self.arrays[name]))

    def values(self, name: str) -> Array:
        """Return a column of floats to the last bit."""
        form = self.forms[name]
        if not form:
            return self.plain(name)
        found = _scaled(form, self.counts(name))
        if name + LAST_PLACE in self.arrays:
            shift = np.nan_to_num(self.counts(name + LAST_PLACE)).astype(np.int64)
            found = np.where(np.isnan(found), np.nan, (_bits(found) + shift).view(float))
        return found

    def texts(self, name: str) -> tuple[str | None, ...]:
        """Return a column of texts."""
        return tuple(self.arrays[name].to_pylist())


class NewerFormat(Exception):
    """A file of a version that is not known yet."""


class FormerColumns(Columns):
    """A table of format 1, where whole numbers are differences, 2 d up and -2 d - 1 down."""

    def counts(self, name: str) -> Array:
        """Return a column of whole numbers, as floats with NaN."""
        folded = _counts_of(self.arrays[name])
        steps = np.nan_to_num(folded).astype(np.int64)
        counts = np.cumsum(np.where(steps % 2, -(steps + 1) // 2, steps // 2))
        return np.where(np.isnan(folded), np.nan, counts)


def write_columns(made: Columns, file: IO[bytes]) -> None:
    """Write a table."""
    metadata = json.dumps(
        {"format": FORMAT, "forms": made.forms, **made.metadata}, ensure_ascii=False, separators=(",", ":")
    )
    table = pa.table(made.arrays)
    kinds = {f.name: f.type for f in table.schema}
    floats = {name for name, kind in kinds.items() if pa.types.is_floating(kind)}
    texts = [name for name, kind in kinds.items() if pa.types.is_string(kind)]
    with pq.ParquetWriter(
        file,
        table.schema,
        compression="zstd",
        compression_level=9,
        use_dictionary=texts,
        column_encoding={
            n: "BYTE_STREAM_SPLIT" if n in floats else "DELTA_BINARY_PACKED" for n in kinds if n not in texts
        },
        write_statistics=False,
        store_decimal_as_integer=True,
        store_schema=False,  # Arrow's own copy of it takes 1 to 2 kB
    ) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({ARCHIVE: metadata, **made.header})


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
    per = form.get("per", form.get("times"))
    if per is not None and form["step"] == 1:
        columns[name] = _decimal(form["base"] + counts, round(math.log10(per)))
        form = {way: number for way, number in form.items() if way in ("per", "times")}
    else:
        columns[name] = _nullable(counts, pa.int64())
    if beside:
        columns[name + LAST_PLACE] = _nullable(np.where(np.isnan(values), np.nan, ulps), pa.int64())
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
    whole = form.get("base", 0) + form.get("step", 1) * counts
    return whole / form["per"] if "per" in form else whole * (1.0 / form["times"])


def _bits(values: Array) -> Integers:
    return np.ascontiguousarray(values, dtype=float).view(np.int64).copy()


def _decimal(counts: Array, decimals: int) -> pa.Array:
    """Return counts / 10^decimals as decimal numbers, missing ones left out."""
    missing = np.isnan(counts)
    low = np.where(missing, 0, counts).astype(np.int64)
    words = np.column_stack([low, np.where(low < 0, -1, 0)])  # 16 bytes each, the lower ones first
    there = pa.array(~missing).buffers()[1] if missing.any() else None
    return pa.Array.from_buffers(pa.decimal128(_DIGITS, decimals), len(low), [there, pa.py_buffer(words)])


def _counts_of(array: pa.Array) -> Array:
    """Return whole numbers, or what decimal numbers count, as floats, NaN for missing ones."""
    if pa.types.is_decimal(array.type):
        whole = np.frombuffer(array.buffers()[1], np.int64)[2 * array.offset :: 2][: len(array)]
    else:
        whole = np.asarray(np.from_dlpack(array.fill_null(0)), np.int64)
    return np.where(np.from_dlpack(array.is_null().cast(pa.int8())) != 0, np.nan, whole.astype(float))


def _nullable(values: Array, kind: pa.DataType) -> pa.Array:
    missing = np.isnan(values)
    return pa.array(np.where(missing, 0, values), mask=missing).cast(kind)


def is_archived(file: pq.ParquetFile) -> bool:
    """Whether `write_columns` made the file."""
    return ARCHIVE.encode() in (file.metadata.metadata or {})


def columns_of(file: pq.ParquetFile) -> Columns:
    """Read what `write_columns` wrote, or its earlier versions.

    Raises
    ------
    NewerFormat
        For a file of a newer version.
    KeyError, TypeError, ValueError
        For a file without what it should hold. (So does `pyarrow.ArrowException`.)
    """
    metadata = json.loads(file.metadata.metadata[ARCHIVE.encode()])
    if metadata["format"] > FORMAT:
        raise NewerFormat
    table = file.read(use_threads=False)
    arrays = {name: table.column(name).combine_chunks() for name in table.column_names}
    return (FormerColumns if metadata["format"] == 1 else Columns)(arrays, metadata["forms"], metadata)
