"""How a run was recorded, as its file states: header keys ``recorded.*`` and ``remark``.

Export writes them and import takes them back, so a run keeps start, end, moments, life and remark on its way
from one store into another. Files from elsewhere need none of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from daq.records import InputError
from daq.store.records import RunRecord
from daq.words import Message, say

LATEST_UNIX_S = 253402300799.0
"""The last second of the year 9999; no calendar here goes further."""
REMARK = "remark"
STARTED = "recorded.started_utc"
_MOMENTS = ("inserted_s", "closed_s", "opened_s", "removed_s")


def header_for_file(run: RunRecord) -> dict[str, Any]:
    """Return a run's header with what the store knows beside it."""
    header = dict(run.header)
    if run.kind == "recorded":
        header[STARTED] = run.started_utc
        header["recorded.ended_utc"] = run.ended_utc
        header["recorded.status"] = run.status.value
        header |= {f"recorded.{name}": getattr(run.moments, name) for name in _MOMENTS}
        header["recorded.software_version"] = run.software_version
    if run.remark:
        header[REMARK] = run.remark
    return {key: value for key, value in header.items() if value is not None and value == value}


def columns_from_header(header: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the columns of a run's row that its file states.

    Raises
    ------
    InputError
        Naming the key whose value cannot be.
    """
    columns: dict[str, Any] = {}
    for key, (column, taken, wanted) in _KEYS.items():
        if key not in header:
            continue
        columns[column] = taken(header[key])
        if columns[column] is None:
            raise InputError(
                say("store-header-wrong", file=where, key=key, value=repr(header[key]), wanted=wanted)
            )
    return columns


def _unix_s(value: Any) -> float | None:
    if not isinstance(value, datetime) or value.tzinfo is None:
        return None
    return value.timestamp() if 0.0 <= value.timestamp() <= LATEST_UNIX_S else None


def _seconds(value: Any) -> float | None:
    return float(value) if type(value) in (int, float) and math.isfinite(value) else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _life(value: Any) -> str | None:
    """A run that was open when its file was written goes on elsewhere, not here."""
    return _LIVES.get(value) if isinstance(value, str) else None


_LIVES = {"closed": "closed", "interrupted": "interrupted", "open": "interrupted"}
_TIME = say("wanted-time")
_KEYS: Mapping[str, tuple[str, Callable[[Any], Any], Message]] = {
    STARTED: ("started_unix_s", _unix_s, _TIME),
    "recorded.ended_utc": ("ended_unix_s", _unix_s, _TIME),
    "recorded.status": ("status", _life, say("wanted-one-of", names=tuple(_LIVES))),
    **{f"recorded.{name}": (name, _seconds, say("wanted-seconds")) for name in _MOMENTS},
    "recorded.software_version": ("software_version", _text, say("wanted-text")),
    REMARK: (REMARK, _text, say("wanted-text")),
}
