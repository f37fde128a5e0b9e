"""One run's scans as a file of the archive: a run file, from which every value comes back to the last bit.

Its header stands in the metadata, `time_s` and the channels are columns, and what only the store knows begins with
``scan.`` and is there only where it differs from scan to scan.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from daq.files.parquet_columns import BESIDE, LAST_PLACE, MICRO, TIME_DECIMALS, Columns, FormerColumns, Integers
from daq.files.qualities import QUALITY, quality_text
from daq.files.run_file import toml_value
from daq.files.run_rows import TIME
from daq.press.header import stated_keys
from daq.records import Array
from daq.store.proved_file import Written, read_proved, write_proved

_MONOTONIC, _SINCE, _UNIX = BESIDE + "monotonic_s", BESIDE + "unix_less_monotonic_us", BESIDE + "unix_s"
_NUMBER, _LAYOUT, _FAULTS, _REMARKS = (BESIDE + name for name in ("number", "layout", "faults", "remarks"))


@dataclass(frozen=True)
class StoredScans:
    """Scans as the store keeps them, [n] of each; qualities and remarks are the store's own JSON."""

    number: Integers
    unix_s: Array
    """NaN where a run's time is not known."""
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
    path: Path,
    scans: StoredScans,
    channels: Mapping[int, Sequence[str]],
    header: Mapping[str, Any],
    about: Mapping[str, Any],
) -> Written:
    """Write scans as `write_proved` does.

    Parameters
    ----------
    channels
        Names by layout, in the order of the values.
    header
        Of the run, as its file has it.
    about
        Goes into the metadata; ``zero_s`` is the monotonic time of the run's time 0. [s]
    """
    made = _columns_of(scans, channels, header, about)
    return write_proved(path, made, lambda columns: _scans_of(columns).same_as(scans))


def read_archive(path: Path, sha256: str) -> StoredScans:
    """Return the scans of a file that has this sum; raises `ArchiveUnreadable` where it is missing or changed."""
    return _scans_of(read_proved(path, sha256))


def _columns_of(
    scans: StoredScans,
    channels: Mapping[int, Sequence[str]],
    header: Mapping[str, Any],
    about: Mapping[str, Any],
) -> Columns:
    """Return the columns as they are written, with what reads them in the metadata."""
    layouts = {str(key): list(channels[key]) for key in scans.values}
    metadata = {
        "about": dict(about),
        "layouts": layouts,
        "number": int(scans.number[0]) if len(scans) else 0,
        "layout": int(scans.layout[0]) if len(scans) else 0,
        "zero_us": round(MICRO * about.get("zero_s", 0.0)),
    }
    made = Columns(metadata=metadata, header={key: toml_value(value) for key, value in stated_keys(header)})
    _add_times(made, scans)
    for name, values in _by_channel(scans, channels):
        made.add_values(name, values)
    _add_the_rest(made, scans)
    return made


def _add_times(made: Columns, scans: StoredScans) -> None:
    seconds = np.rint(scans.monotonic_s * MICRO)
    zero = made.metadata["zero_us"]
    if np.array_equal(seconds / MICRO, scans.monotonic_s):
        made.add_decimals(TIME, seconds - zero, TIME_DECIMALS)
    else:
        made.add_plain(TIME, scans.monotonic_s - zero / MICRO)
        made.add_plain(_MONOTONIC, scans.monotonic_s)
    since = np.rint(scans.unix_s * MICRO) - seconds
    if np.array_equal((since + seconds) / MICRO, scans.unix_s, equal_nan=True):
        made.add_counts(_SINCE, since)
    else:
        made.add_plain(_UNIX, scans.unix_s)


def _by_channel(scans: StoredScans, channels: Mapping[int, Sequence[str]]) -> Iterator[tuple[str, Array]]:
    """Yield each channel's values, NaN in scans of layouts without it."""
    whole: dict[str, Array] = {}
    for key, values in scans.values.items():
        for i, name in enumerate(channels[key]):
            whole.setdefault(_column(name), np.full(len(scans), np.nan))[scans.layout == key] = values[:, i]
    yield from whole.items()


def _column(channel: str) -> str:
    """Return the name of a channel's column: its own, but for one that means something else in the file."""
    taken = channel in (TIME, QUALITY) or channel.startswith((BESIDE, "=")) or channel.endswith(LAST_PLACE)
    return "=" + channel if taken else channel


def _add_the_rest(made: Columns, scans: StoredScans) -> None:
    """Add numbers, layouts and texts, where they are not what the metadata says of all scans."""
    if not np.array_equal(scans.number, made.metadata["number"] + np.arange(len(scans))):
        made.add_counts(_NUMBER, scans.number.astype(float))
    if (scans.layout != made.metadata["layout"]).any():
        made.add_counts(_LAYOUT, scans.layout.astype(float))
    faults, remarks = (
        [json.loads(text or "{}") for text in texts] if any(text is not None for text in texts) else []
        for texts in (scans.faults, scans.remarks)
    )
    if faults:
        made.add_texts(_FAULTS, scans.faults)
        made.add_texts(QUALITY, [quality_text(row) or None for row in faults])
    if remarks:
        made.add_texts(_REMARKS, scans.remarks)
        for name in dict.fromkeys(_column(name) for row in remarks for name in row):
            if name not in made.arrays:
                made.add_texts(name, [row.get(name) for row in remarks])


def _scans_of(columns: Columns) -> StoredScans:
    if isinstance(columns, FormerColumns):
        return _former_scans(columns)
    metadata, count = columns.metadata, len(columns)
    there = columns.arrays
    if _MONOTONIC in there:
        monotonic_s = columns.plain(_MONOTONIC)
    else:
        monotonic_s = (columns.counts(TIME) + metadata["zero_us"]) / MICRO
    if _SINCE in there:
        unix_s = (columns.counts(_SINCE) + np.rint(monotonic_s * MICRO)) / MICRO
    else:
        unix_s = columns.plain(_UNIX)
    number = (
        columns.counts(_NUMBER).astype(np.int64) if _NUMBER in there else metadata["number"] + np.arange(count)
    )
    layout = columns.counts(_LAYOUT).astype(np.int64) if _LAYOUT in there else np.full(count, metadata["layout"])
    faults, remarks = (columns.texts(name) if name in there else (None,) * count for name in (_FAULTS, _REMARKS))
    values = _by_layout(columns, layout, _column)
    return StoredScans(number, unix_s, monotonic_s, layout, values, faults, remarks)


def _by_layout(columns: Columns, layout: Integers, column: Callable[[str], str]) -> dict[int, Array]:
    """Return the values of each layout's scans by its channels."""
    found = {}
    for key, names in columns.metadata["layouts"].items():
        chosen = layout == int(key)
        own = [columns.values(column(name))[chosen] for name in names]
        found[int(key)] = np.array(own).T if own else np.empty((int(chosen.sum()), 0))
    return found


def _former_scans(columns: FormerColumns) -> StoredScans:
    """Return the scans of a file of format 1, where every column was there and channels began with ``=``."""
    monotonic_s = columns.values("monotonic")
    unix = BESIDE + "unix"
    if pa.types.is_integer(columns.arrays[unix].type):
        unix_s = (columns.counts(unix) + np.rint(monotonic_s * MICRO)) / MICRO
    else:
        unix_s = columns.plain(unix)
    layout = columns.counts(_LAYOUT).astype(np.int64)
    return StoredScans(
        number=columns.counts(_NUMBER).astype(np.int64),
        unix_s=unix_s,
        monotonic_s=monotonic_s,
        layout=layout,
        values=_by_layout(columns, layout, "=".__add__),
        faults=columns.texts(_FAULTS),
        remarks=columns.texts(_REMARKS),
    )
