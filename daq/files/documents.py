"""Runs as bluesky event-model documents: start, descriptor, one event a scan, stop.

Laboratories that keep their data in that world read a run with their own tools. Times are UTC seconds; the
run's header goes into the start document, the channels' units into the descriptor. Names have a colon where
a dot or slash is not allowed there.
"""

from __future__ import annotations

import json
import math
import re
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import date, datetime, time
from typing import Any, Literal

from daq.records import Run

_NAMESPACE = uuid.UUID("6d6f7264-6b65-726e-7465-6d7000000001")
"""The same run gives the same identifiers."""

Document = tuple[str, dict[str, Any]]
ExitStatus = Literal["success", "abort"] | None


def documents_of(
    run: Run, started: datetime | None, units: Mapping[str, str] | None = None, ended: ExitStatus = "success"
) -> Iterator[Document]:
    """Yield name and content of each document of a run.

    Parameters
    ----------
    started
        When the run's time was 0. None where it is not known: documents must have a time, so theirs is the run's,
        and the first one says so (``time_unknown``).
    units
        Of the columns, as far as they are known: a wrong unit is worse than none.
    ended
        How: ``abort`` for a run that was interrupted; None for one that goes on, which has no stop document yet.
    """
    start, started_unix_s = _identifier(run.name, "start"), 0.0 if started is None else started.timestamp()
    document = {"uid": start, "time": started_unix_s, "scan_id": 1, "run": run.name, "header": _plain(run.header)}
    yield "start", document | ({"time_unknown": True} if started is None else {})
    yield "descriptor", _descriptor(run, start, started_unix_s, units or {})
    yield from _events(run, started_unix_s)
    if ended is None:
        return
    stop = {
        "uid": _identifier(run.name, "stop"),
        "run_start": start,
        "time": started_unix_s + float(run.time_s[-1]),
        "exit_status": ended,
        "num_events": {"primary": len(run.time_s)},
    }
    yield "stop", stop


def _descriptor(run: Run, start: str, started_unix_s: float, units: Mapping[str, str]) -> dict[str, Any]:
    """Return the document that says what the columns are."""
    keys: dict[str, dict[str, Any]] = {}
    for column, name in zip([*run.columns, *run.texts], _names([*run.columns, *run.texts]), strict=True):
        kind = "number" if column in run.columns else "string"
        keys[name] = {"source": f"kerntemp:{column}", "dtype": kind, "shape": []}
        if column in run.columns and units.get(column):
            keys[name]["units"] = units[column]
    return {
        "uid": _identifier(run.name, "descriptor"),
        "run_start": start,
        "time": started_unix_s,
        "name": "primary",
        "data_keys": keys,
        "configuration": {},
        "object_keys": {},
        "hints": {},
    }


def _events(run: Run, started_unix_s: float) -> Iterator[Document]:
    """Yield one document a scan."""
    columns: dict[str, Sequence[Any]] = {name: values.tolist() for name, values in run.columns.items()}
    columns = dict(zip(_names([*columns, *run.texts]), [*columns.values(), *run.texts.values()], strict=True))
    descriptor = _identifier(run.name, "descriptor")
    for i, time_s in enumerate(run.time_s.tolist()):
        at = started_unix_s + time_s
        event = {
            "uid": _identifier(run.name, f"event {i}"),
            "descriptor": descriptor,
            "time": at,
            "seq_num": i + 1,
            "data": {name: values[i] for name, values in columns.items()},
            "timestamps": dict.fromkeys(columns, at),
            "filled": {},
        }
        yield "event", event


def json_lines(
    run: Run, started: datetime | None, units: Mapping[str, str] | None = None, ended: ExitStatus = "success"
) -> Iterator[str]:
    """Yield one line ``["event", {...}]`` a document; a missing value is null."""
    for name, content in documents_of(run, started, units, ended):
        if name == "event":
            content["data"] = {k: None if v != v else v for k, v in content["data"].items()}
        yield json.dumps([name, content], ensure_ascii=False)


def _identifier(run: str, part: str) -> str:
    return str(uuid.uuid5(_NAMESPACE, f"{run}/{part}"))


def _plain(value: Any) -> Any:
    """Return a header value as JSON knows it: times and infinities as text, the keys of tables as names."""
    if isinstance(value, Mapping):
        return dict(zip(_names(value), map(_plain, value.values()), strict=True))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(each) for each in value]
    if isinstance(value, date | time):
        return value.isoformat()
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


def _names(given: Iterable[str]) -> list[str]:
    """Return each name with a colon for a dot or slash, which are not allowed here, and none of them twice."""
    names: list[str] = []
    for name in given:
        free = re.sub("[./]", ":", name)
        while free in names:
            free += "_"
        names.append(free)
    return names
