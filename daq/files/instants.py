"""Instants of tables: counted in seconds from a start that the header keeps, and as ISO text for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, date, datetime, time, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.records import Array

STARTED = "recorded.started_utc"
"""Header key of the instant at which `time_s` is 0."""
_RECORDED = "recorded."
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def seconds_of(unix_ns: NDArray[np.int64], keys: dict[str, Any], *, zoned: bool) -> Array:
    """Return instants in seconds since the start in a header's keys, or since the first of them.

    Parameters
    ----------
    keys
        Gets the first instant, down to its microsecond, where it has no start before it.
    zoned
        Whether they know their zone; without one they are counted from the first, and no key says when that was.
    """
    start = int(unix_ns[0])
    if zoned:
        given = keys.get(STARTED)
        known = isinstance(given, datetime) and given.tzinfo is not None and _unix_us(given) * 1000 <= start
        microseconds = _unix_us(given) if known else start // 1000
        keys[STARTED], start = _EPOCH + timedelta(microseconds=microseconds), microseconds * 1000
    return np.asarray((unix_ns - start) / 1e9, float)


def _unix_us(instant: datetime | Any) -> int:
    return int((instant - _EPOCH) // timedelta(microseconds=1))


def for_json(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return a header's keys with instants, dates and times of day as ISO text, and numbers as Python's own."""
    return {key: _plain(value) for key, value in header.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, date | time):
        return value.isoformat()
    return value.item() if isinstance(value, np.generic) else value


def from_json(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return a header's keys with a recorder's instants read from their ISO text, and numbers as Python's own."""
    numbers = {key: value.item() if isinstance(value, np.generic) else value for key, value in header.items()}
    return {key: _instant(value) if key.startswith(_RECORDED) else value for key, value in numbers.items()}


def _instant(value: Any) -> Any:
    try:
        found = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        return value
    return value if found.tzinfo is None else found
