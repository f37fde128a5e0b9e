"""Between rows and records: times, JSON, header keys. Pure functions."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from daq.files.run_file import toml_line
from daq.press.header import flat_keys, stated_keys
from daq.records import Array, Channel, Quality

# Numbers without another source were set by hand, 2026-11.

MANY = 100
"""From so many scans on their values are parsed column by column, seven times faster than as JSON."""


def unix_of(moment: datetime) -> float:
    """Return seconds since 1970 of an aware datetime."""
    return moment.timestamp()


def utc_of(unix_s: float | None) -> datetime | None:
    """Return the aware datetime, or None."""
    return None if unix_s is None else datetime.fromtimestamp(unix_s, UTC)


def known_utc(unix_s: float) -> datetime:
    """Return the aware datetime of a column that is never empty."""
    return datetime.fromtimestamp(unix_s, UTC)


def null(value: float | None) -> float | None:
    """Return None for NaN."""
    return None if value is None or value != value else float(value)


def nan(value: float | None) -> float:
    """Return NaN for None."""
    return math.nan if value is None else float(value)


def to_json(value: Any) -> str:
    """Write JSON; NaN becomes null."""
    return json.dumps(_finite(value), ensure_ascii=False, separators=(",", ":"), default=_plain)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _finite(value.tolist())
    if isinstance(value, np.generic):
        return _finite(value.item())
    if isinstance(value, datetime):
        return value.isoformat()
    return str(value)


def readings_json(values: Sequence[float]) -> str:
    """Write one scan's values; every float comes back to the last bit."""
    return json.dumps([None if v != v else v for v in values], separators=(",", ":"))


def readings_table(texts: Sequence[str], width: int) -> Array:
    """Parse the values of many scans at once; raises `ValueError` or `TypeError` where one cannot be read."""
    if not texts or not width:
        return np.empty((len(texts), width))
    if len(texts) < MANY:
        return _of_width(np.array(json.loads(f"[{','.join(texts)}]"), dtype=float), len(texts), width)
    bare = [text[1:-1] for text in texts]
    names = [str(i) for i in range(width)]
    table = pacsv.read_csv(
        pa.py_buffer("\n".join(bare).encode()),
        pacsv.ReadOptions(column_names=names, use_threads=False, block_size=1 << 28),
        pacsv.ParseOptions(quote_char=False, ignore_empty_lines=False),
        pacsv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=["null"]),
    )
    return _of_width(np.array([column.to_numpy() for column in table.columns]).T, len(texts), width)


def _of_width(table: Array, scans: int, width: int) -> Array:
    if table.shape != (scans, width):
        raise ValueError(f"{table.shape} is not {(scans, width)}")
    return table


def faults_json(channels: Sequence[Channel], qualities: Sequence[Quality]) -> str | None:
    """Write the qualities that are not good, or None; ``*`` stands for every channel not named."""
    rest = Quality.SIMULATED if Quality.SIMULATED in qualities else Quality.GOOD
    faults = {c.name: q.value for c, q in zip(channels, qualities, strict=True) if q is not rest}
    if rest is Quality.SIMULATED:
        faults = {"*": rest.value, **faults}
    return json.dumps(faults, separators=(",", ":")) if faults else None


def channel_qualities(channels: Sequence[Channel], faults: str | None) -> tuple[Quality, ...]:
    """Return the quality of each channel."""
    if faults is None:
        return (Quality.GOOD,) * len(channels)
    named = json.loads(faults)
    rest = named.get("*", Quality.GOOD.value)
    return tuple(Quality(named.get(c.name, rest)) for c in channels)


def header_text(header: Mapping[str, Any]) -> str:
    """Write header keys, one TOML line each."""
    return "".join(toml_line(key, value) + "\n" for key, value in stated_keys(header))


def header_of(text: str) -> dict[str, Any]:
    """Read header keys written by `header_text`."""
    header: dict[str, Any] = {}
    for line in text.split("\n"):
        header.update(flat_keys(tomllib.loads(line)))
    return header
