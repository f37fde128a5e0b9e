"""Runs as bluesky event-model documents: start, descriptor, one event a scan, stop.

Laboratories that keep their data in that world read a run with their own tools. Times are UTC seconds; the
run's header goes into the start document as it is, the channels' units into the descriptor.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, time
from typing import Any, Literal

from daq.records import Run

_NAMESPACE = uuid.UUID("6d6f7264-6b65-726e-7465-6d7000000001")
"""The same run gives the same identifiers."""

Document = tuple[str, dict[str, Any]]
ExitStatus = Literal["success", "abort"] | None


def documents_of(
    run: Run, started_unix_s: float, units: Mapping[str, str] | None = None, ended: ExitStatus = "success"
) -> Iterator[Document]:
    """Yield name and content of each document of a run.

    Parameters
    ----------
    started_unix_s
        When the run's time was 0. [s since 1970]
    units
        Of the columns, as far as they are known: a wrong unit is worse than none.
    ended
        How: ``abort`` for a run that was interrupted; None for one that goes on, which has no stop document yet.
    """
    units = units or {}
    start = _identifier(run.name, "start")
    descriptor = _identifier(run.name, "descriptor")
    yield "start", {"uid": start, "time": started_unix_s, "scan_id": 1, "run": run.name, "header": _plain(run)}
    keys = {
        name: {
            "source": f"kerntemp:{name}",
            "dtype": "number",
            "shape": [],
            **({"units": units[name]} if units.get(name) else {}),
        }
        for name in run.columns
    }
    remarks = {name: {"source": f"kerntemp:{name}", "dtype": "string", "shape": []} for name in run.texts}
    yield (
        "descriptor",
        {
            "uid": descriptor,
            "run_start": start,
            "time": started_unix_s,
            "name": "primary",
            "data_keys": {**keys, **remarks},
            "configuration": {},
            "object_keys": {},
            "hints": {},
        },
    )
    columns: dict[str, Sequence[Any]] = {name: values.tolist() for name, values in run.columns.items()}
    columns |= run.texts
    for i, time_s in enumerate(run.time_s.tolist()):
        at = started_unix_s + time_s
        yield (
            "event",
            {
                "uid": _identifier(run.name, f"event {i}"),
                "descriptor": descriptor,
                "time": at,
                "seq_num": i + 1,
                "data": {name: values[i] for name, values in columns.items()},
                "timestamps": dict.fromkeys(columns, at),
                "filled": {},
            },
        )
    if ended is None:
        return
    yield (
        "stop",
        {
            "uid": _identifier(run.name, "stop"),
            "run_start": start,
            "time": started_unix_s + float(run.time_s[-1]),
            "exit_status": ended,
            "num_events": {"primary": len(run.time_s)},
        },
    )


def json_lines(
    run: Run, started_unix_s: float, units: Mapping[str, str] | None = None, ended: ExitStatus = "success"
) -> Iterator[str]:
    """Yield one line ``["event", {...}]`` a document; a missing value is null."""
    for name, content in documents_of(run, started_unix_s, units, ended):
        if name == "event":
            content["data"] = {k: None if v != v else v for k, v in content["data"].items()}
        yield json.dumps([name, content], ensure_ascii=False)


def _identifier(run: str, part: str) -> str:
    return str(uuid.uuid5(_NAMESPACE, f"{run}/{part}"))


def _plain(run: Run) -> dict[str, Any]:
    """Return the header with times as text; a dot in a key is a colon here, where dots are not allowed."""
    return {
        key.replace(".", ":"): value.isoformat() if isinstance(value, date | time) else value
        for key, value in run.header.items()
    }
