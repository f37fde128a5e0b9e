"""The live sensor's estimates of one run as a file of the archive: the table's rows, value by value."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq.files.parquet_columns import Columns
from daq.store.proved_file import Written, read_proved, write_proved

ENDING = ".estimates.parquet"
"""In place of the ``.parquet`` of the run's scans."""


class EstimateRow(NamedTuple):
    """A row of the table of estimates, without its press."""

    number: int
    monotonic_s: float
    state: str
    core_celsius: float | None
    core_sd_kelvin: float | None
    core_low_celsius: float | None
    core_high_celsius: float | None
    valid: int
    reason: str
    model_version: str
    detail_json: str | None


_TEXTS = ("state", "reason", "model_version", "detail_json")
_COUNTS = ("number", "valid")


def beside(scans_file: Path) -> Path:
    """Return the file of the estimates of a run whose scans are in that file."""
    return scans_file.with_name(scans_file.name.removesuffix(".parquet") + ENDING)


def write_estimates(path: Path, rows: Sequence[EstimateRow]) -> Written:
    """Write rows as `write_proved` does."""
    made = Columns()
    for name, cells in zip(EstimateRow._fields, zip(*rows, strict=True), strict=True):
        if name in _TEXTS:
            made.add_texts(name, cells)
        elif name in _COUNTS:
            made.add_counts(name, np.array(cells, dtype=float))
        else:
            made.add_values(name, np.array(cells, dtype=float))
    return write_proved(path, made, lambda columns: _rows_of(columns) == list(rows))


def read_estimates(path: Path, sha256: str) -> list[EstimateRow]:
    """Return the rows of a file that has this sum; raises `ArchiveUnreadable` where it is missing or changed."""
    return _rows_of(read_proved(path, sha256))


def _rows_of(columns: Columns) -> list[EstimateRow]:
    found = []
    for name in EstimateRow._fields:
        if name in _TEXTS:
            found.append(columns.texts(name))
        elif name in _COUNTS:
            found.append(tuple(columns.counts(name).astype(int).tolist()))
        else:
            found.append(tuple(None if v != v else v for v in columns.values(name).tolist()))
    return [EstimateRow(*cells) for cells in zip(*found, strict=True)]
