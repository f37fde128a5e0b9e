"""Runs from elsewhere, stored whole, and the remarks beside their rows."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, insert

from daq.files.qualities import QUALITY, row_faults
from daq.records import Channel, InputError, Quality, Run
from daq.store.convert import readings_json
from daq.store.origin import LATEST_UNIX_S, columns_from_header
from daq.store.press_layouts import register_press
from daq.store.reading import has_run
from daq.store.records import PressKey, RunStatus
from daq.store.run_headers import header_columns
from daq.store.schema import RUN, SCAN, SCAN_REMARK
from daq.tables import unseen
from daq.words import say

_NAME = re.compile(r"(?!\.{1,2}$)[^\x00-\x1f\x7f-\x9f/\\]+")
"""A run's name is a file's name on export, part of a URL, and a cell of a list."""

# Numbers without another source were set by hand, 2026-11.

_LONGEST_RUN_NAME = 200
"""A file system takes 255, an ending and a draft's sign among them. [bytes]"""
_ROWS_AT_ONCE = 1 << 13
"""Rows of a run imported in one statement: a long run never stands in memory twice."""


def import_run(connection: Connection, run: Run, press: str, press_file: str = "") -> str:
    """Store a run from elsewhere whole; raises `InputError` where its name is taken or no name.

    When it was stays unknown where the file does not say.
    """
    _check_name(run)
    if has_run(connection, run.name):
        raise InputError(say("store-run-taken", file=run.source or run.name, run=run.name))
    origin = columns_from_header(run.header, run.source or run.name)
    channels = tuple(Channel(name, _unit(name)) for name in run.columns)
    key = register_press(connection, press, channels, press_file, "imported")
    number = key.next_number
    count, faults = len(run.time_s), row_faults(run)
    for first in range(0, count, _ROWS_AT_ONCE):
        connection.execute(insert(SCAN), list(_imported_scans(run, first, faults, key)))
    append_remarks(connection, key, ((number + i, texts) for i, texts in remarks_in(run)))
    started = origin.get("started_unix_s")
    lasted_s = float(run.time_s[-1] - run.time_s[0]) if count else 0.0
    connection.execute(
        insert(RUN),
        {
            "run": run.name,
            "press_id": key.press_id,
            "status": RunStatus.CLOSED.value,
            "started_unix_s": started,
            "ended_unix_s": None if started is None else min(started + lasted_s, LATEST_UNIX_S),
            "zero_monotonic_s": 0.0,
            "first_scan": number,
            "last_scan": number + count - 1,
            **header_columns({**run.header, "run": run.name}),
            **origin,
        },
    )
    return run.name


def _imported_scans(
    run: Run, first: int, faults: Sequence[Mapping[str, Quality]] | None, key: PressKey
) -> Iterator[dict[str, Any]]:
    """Yield a piece of a run, from a row on, as rows of the table of scans."""
    part = slice(first, first + _ROWS_AT_ONCE)
    times = run.time_s[part].tolist()
    cells = (
        zip(*(c[part].tolist() for c in run.columns.values()), strict=True)
        if run.columns
        else itertools.repeat(())
    )
    named_in = faults[part] if faults else itertools.repeat({})
    rows = zip(times, cells, named_in, strict=False)  # what repeats has no end
    for i, (time_s, values, named) in enumerate(rows, key.next_number + first):
        yield {
            "press_id": key.press_id,
            "number": i,
            "unix_s": None,
            "monotonic_s": time_s,
            "layout_id": key.layout_id,
            "readings": readings_json(values),
            "faults": json.dumps(named, separators=(",", ":")) if named else None,
        }


def remarks_in(run: Run) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield by row what a run's text columns say, but for qualities that are kept as such."""
    columns = {n: texts for n, texts in run.texts.items() if n != QUALITY or row_faults(run) is None}
    for i, row in enumerate(zip(*columns.values(), strict=True)):
        if texts := {name: text for name, text in zip(columns, row, strict=True) if text}:
            yield i, texts


def append_remarks(
    connection: Connection, key: PressKey, remarks: Iterable[tuple[int, Mapping[str, str]]]
) -> None:
    """Write beside scans, by their number, what text columns say of them."""
    rows = (
        {"press_id": key.press_id, "number": number, "texts_json": json.dumps(texts, ensure_ascii=False)}
        for number, texts in remarks
    )
    while rows_at := list(itertools.islice(rows, _ROWS_AT_ONCE)):
        connection.execute(insert(SCAN_REMARK), rows_at)


def _check_name(run: Run) -> None:
    given = run.header.get("run", run.name)
    fits = _NAME.fullmatch(run.name) and len(run.name.encode("utf-8", "replace")) <= _LONGEST_RUN_NAME
    if isinstance(given, list | bool) or not fits or unseen(run.name) or run.name != run.name.strip():
        raise InputError(say("store-run-name", file=run.source or "run", name=repr(given)))


def _unit(column: str) -> str:
    return "C" if column.partition("_")[0] in ("platen", "top", "bottom", "core", "T") else ""
