"""One run's scans as a file of the archive, every value back to the last bit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from daq.records import Array
from daq.store.parquet_columns import Columns, Integers, Written, read_proved, write_proved

MICRO = 1e6
"""Instants are whole microseconds: that is what clocks here give. [1/s]"""
_OWN = "scan."


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


def write_archive(
    path: Path, scans: StoredScans, channels: Mapping[int, Sequence[str]], about: Mapping[str, Any]
) -> Written:
    """Write scans as `write_proved` does.

    Parameters
    ----------
    channels
        Names by layout, in the order of the values.
    about
        Goes into the file's metadata, for people: which run this is.
    """
    made = _columns_of(scans, channels, about)
    return write_proved(path, made, lambda columns: _scans_of(columns).same_as(scans))


def read_archive(path: Path, sha256: str) -> StoredScans:
    """Return the scans of a file that has this sum; raises `ArchiveUnreadable` where it is missing or changed."""
    return _scans_of(read_proved(path, sha256))


def _columns_of(scans: StoredScans, channels: Mapping[int, Sequence[str]], about: Mapping[str, Any]) -> Columns:
    """Return the columns as they are written, with what reads them in the metadata."""
    layouts = {str(key): list(channels[key]) for key in scans.values}
    made = Columns(told={"about": dict(about), "layouts": layouts})
    for name, values in (("monotonic", scans.monotonic_s), *_by_channel(scans, channels)):
        made.add_values(name, values)
    seconds = np.rint(scans.monotonic_s * MICRO)
    beside = np.rint(scans.unix_s * MICRO) - seconds
    if np.array_equal((beside + seconds) / MICRO, scans.unix_s, equal_nan=True):
        made.add_counts(_OWN + "unix", beside)
    else:
        made.add_plain(_OWN + "unix", scans.unix_s)
    made.add_counts(_OWN + "number", scans.number.astype(float))
    made.add_counts(_OWN + "layout", scans.layout.astype(float))
    made.add_texts(_OWN + "faults", scans.faults)
    made.add_texts(_OWN + "remarks", scans.remarks)
    return made


def _by_channel(scans: StoredScans, channels: Mapping[int, Sequence[str]]) -> Iterator[tuple[str, Array]]:
    """Yield each channel's values, NaN in scans of layouts without it."""
    whole: dict[str, Array] = {}
    for key, values in scans.values.items():
        for i, name in enumerate(channels[key]):
            whole.setdefault("=" + name, np.full(len(scans), np.nan))[scans.layout == key] = values[:, i]
    yield from whole.items()


def _scans_of(columns: Columns) -> StoredScans:
    monotonic_s = columns.values("monotonic")
    if pa.types.is_integer(columns.arrays[_OWN + "unix"].type):
        unix_s = (columns.counts(_OWN + "unix") + np.rint(monotonic_s * MICRO)) / MICRO
    else:
        unix_s = columns.plain(_OWN + "unix")
    layout = columns.counts(_OWN + "layout").astype(np.int64)
    found = {}
    for key, names in columns.told["layouts"].items():
        chosen = layout == int(key)
        own = [columns.values("=" + name)[chosen] for name in names]
        found[int(key)] = np.array(own).T if own else np.empty((int(chosen.sum()), 0))
    return StoredScans(
        number=columns.counts(_OWN + "number").astype(np.int64),
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        layout=layout,
        values=found,
        faults=columns.texts(_OWN + "faults"),
        remarks=columns.texts(_OWN + "remarks"),
    )
