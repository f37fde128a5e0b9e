"""One run's scans as they are stored, wherever they are kept.

What cannot be read of a run is an error that names run, scan, store and what to do: a fit or a file of the rest
would be taken for the whole. Who follows a press scan by scan (`reading.scans_after`) has no value there instead.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, and_, select

from daq.files.qualities import QUALITY, quality_text
from daq.records import Array, Channel, InputError, Quality, Run
from daq.store.archive_file import StoredScans
from daq.store.archived import archived_layouts, archived_scans
from daq.store.reading import first_layout, layout_channels, run_row
from daq.store.schema import SCAN, SCAN_REMARK
from daq.store.sound_rows import of_run, readings_of, sound, sound_ends, sound_texts, stored_header
from daq.words import say

_USABLE = {q.value for q in Quality if q.usable}

# Numbers without another source were set by hand, 2026-11.

_ROWS = 500
"""Rows held at a time: fewer than set the garbage collector off."""


def load_run(
    connection: Connection,
    run: str,
    columns: Sequence[str] | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    *,
    words: bool = False,
) -> Run:
    """Return a run with its data so far; cells that are not usable are NaN, `texts` says why.

    With `words` it has the text columns too that an imported run came with, its qualities aside.
    """
    row = run_row(connection, run)
    zero = row.zero_monotonic_s
    scans = scans_of(connection, row, from_s, to_s)
    layouts = scans.values or {first_layout(connection, row.press_id): np.empty((0, 0))}
    table: dict[str, Array] = {}
    for layout_id, values in layouts.items():
        channels = layout_channels(connection, layout_id)
        chosen = np.flatnonzero(scans.layout == layout_id)
        usable = usable_values(channels, values, [scans.faults[i] for i in chosen.tolist()])
        for i, channel in enumerate(channels):
            table.setdefault(channel.name, np.full(len(scans), np.nan))[chosen] = (
                usable[:, i] if len(usable) else ()
            )
    if columns is not None:
        if unknown := [c for c in columns if c not in table]:
            raise InputError(say("store-column-missing", run=run, column=unknown[0], columns=tuple(table)))
        table = {name: table[name] for name in columns}
    time_s = np.round(scans.monotonic_s - zero, 6) if zero else scans.monotonic_s
    texts = {} if QUALITY in table else _qualities(scans.faults, columns)
    if words:
        texts |= _text_columns(scans.remarks)
    return Run(run, stored_header(connection, row), time_s, table, "store", texts)


def scans_of(
    connection: Connection, row: Row[Any], from_s: float | None = None, to_s: float | None = None
) -> StoredScans:
    """Return a run's scans, or those of a stretch of it, wherever they are kept. [s of the run]"""
    archived = archived_scans(connection, row.run)
    return (
        _scans_in_table(connection, row, from_s, to_s)
        if archived is None
        else _between(archived, row, from_s, to_s)
    )


def _scans_in_table(
    connection: Connection, row: Row[Any], from_s: float | None, to_s: float | None
) -> StoredScans:
    beside = SCAN.outerjoin(
        SCAN_REMARK,
        and_(SCAN_REMARK.c.press_id == SCAN.c.press_id, SCAN_REMARK.c.number == SCAN.c.number),
    )
    kept = (SCAN.c.number, SCAN.c.unix_s, SCAN.c.monotonic_s, SCAN.c.layout_id, SCAN.c.readings, SCAN.c.faults)
    query = select(*kept, SCAN_REMARK.c.texts_json).select_from(beside).where(*_scans_of(row, from_s, to_s))
    found: tuple[list[Any], ...] = ([], [], [], [], [], [], [])
    whose = of_run(row.run)
    with sound(connection, whose):
        for rows in connection.execute(query.order_by(SCAN.c.number)).partitions(_ROWS):
            for column, cells in zip(found, zip(*rows, strict=True), strict=True):
                column.extend(cells)
        number, unix_s, at, layout_of, texts, faults, remarks = found
        if from_s is None and to_s is None:
            sound_ends(connection, whose, row, number)
        sound_texts(connection, whose, number, faults)
        sound_texts(connection, whose, number, remarks)
        layout = np.array(layout_of, dtype=np.int64)
        values = {}
        for layout_id in dict.fromkeys(layout_of):
            own = [(n, text) for n, text, its in zip(number, texts, layout_of, strict=True) if its == layout_id]
            width = len(layout_channels(connection, layout_id))
            values[layout_id] = readings_of(connection, whose, own, width)
        return StoredScans(
            number=np.array(number, dtype=np.int64),
            unix_s=np.array(unix_s, dtype=float),
            monotonic_s=np.array(at, dtype=float),
            layout=layout,
            values=values,
            faults=tuple(faults),
            remarks=tuple(remarks),
        )


def _between(scans: StoredScans, row: Row[Any], from_s: float | None, to_s: float | None) -> StoredScans:
    """Return the scans of a stretch of a run."""
    zero = row.zero_monotonic_s
    chosen = np.full(len(scans), True)
    if from_s is not None:
        chosen &= scans.monotonic_s >= from_s + zero
    if to_s is not None:
        chosen &= scans.monotonic_s <= to_s + zero
    return scans.at(chosen)


def _scans_of(row: Row[Any], from_s: float | None, to_s: float | None) -> list[ColumnElement[bool]]:
    """Return what picks a run's scans, or those of a stretch of it. [s of the run]"""
    zero = row.zero_monotonic_s
    chosen = [SCAN.c.press_id == row.press_id, SCAN.c.number >= row.first_scan]
    if row.last_scan is not None:
        chosen.append(SCAN.c.number <= row.last_scan)
    if from_s is not None:
        chosen.append(SCAN.c.monotonic_s >= from_s + zero)
    if to_s is not None:
        chosen.append(SCAN.c.monotonic_s <= to_s + zero)
    return chosen


def columns_of(connection: Connection, run: str) -> tuple[str, ...]:
    """Return the names of a run's columns, also where its scans are kept no more."""
    row = run_row(connection, run)
    layouts = _layouts_of(connection, row) or [first_layout(connection, row.press_id)]
    return tuple(dict.fromkeys(c.name for layout in layouts for c in layout_channels(connection, layout)))


def units_of(connection: Connection, run: str) -> dict[str, str]:
    """Return the unit of each column of a run, as far as it is known."""
    layouts = _layouts_of(connection, run_row(connection, run))
    return {c.name: c.unit for layout in layouts for c in layout_channels(connection, layout) if c.unit}


def _layouts_of(connection: Connection, row: Row[Any]) -> Sequence[int]:
    """Return the layouts of a run's scans, wherever they are."""
    archived = archived_layouts(connection, row.run)
    if archived is not None:
        return archived
    own = select(SCAN.c.layout_id).where(*_scans_of(row, None, None))
    return connection.execute(own.distinct()).scalars().all()


def _text_columns(remarks: Sequence[str | None]) -> dict[str, tuple[str, ...]]:
    """Return what stands beside scans as columns; most runs have none."""
    read: dict[str | None, dict[str, str]] = {
        text: {} if text is None else json.loads(text) for text in set(remarks)
    }
    names = dict.fromkeys(name for text in remarks if text is not None for name in read[text])
    return {name: tuple(read[text].get(name, "") for text in remarks) for name in names}


def _qualities(faults: Sequence[str | None], columns: Sequence[str] | None) -> dict[str, tuple[str, ...]]:
    """Return the column of qualities, or none where every value is good."""
    words = {f: "" if f is None else quality_text(json.loads(f), columns) for f in set(faults)}
    return {QUALITY: tuple(words[f] for f in faults)} if any(words.values()) else {}


def usable_values(channels: Sequence[Channel], values: Array, faults: Sequence[str | None]) -> Array:
    """Return scans' values [n, channels] with NaN for those that are not usable."""
    values = values.copy()
    places = {c.name: i for i, c in enumerate(channels)}
    for number, named in enumerate(faults):
        if named is not None:
            for name, quality in json.loads(named).items():
                if quality not in _USABLE and name in places:
                    values[number, places[name]] = np.nan
    return values
