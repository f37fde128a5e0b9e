"""What a press recorded between two instants, thinned for a chart: each step's lowest and highest values.

Scans are read in pieces and folded at once, so that a day takes the memory of some thousand scans. Those of
archived runs come from their files; where such a file cannot be read, its run is named. A scan that is damaged in
the store has no value here. Time goes by the scans' own clock: where it was set back, scans are found as far as
their numbers lie between the instants asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from sqlalchemy import Connection, func, select

from daq.records import Array, InputError
from daq.store.archived import archived_scans
from daq.store.reading import first_number_from, layout_channels, recorded_id
from daq.store.records import SCANS_AT_ONCE
from daq.store.run_scans import usable_values
from daq.store.schema import ARCHIVE, RUN, SCAN
from daq.store.sound_rows import is_object, readings_with_gaps
from daq.words import Message
from daq.words.message import spoken

# Numbers without another source were set by hand, 2026-11.


@dataclass
class Envelope:
    """Scans of some steps of time, [steps] of each array."""

    since_s: float
    step_s: float
    scans: Array
    """How many there are: fewer where idle scans were thinned, none where nothing was recorded."""
    low: dict[str, Array] = field(default_factory=dict)
    """By channel, NaN where no value can be used."""
    high: dict[str, Array] = field(default_factory=dict)
    unread: list[tuple[str, Message]] = field(default_factory=list)
    """Archived runs whose scans cannot be read, and why."""

    def add(self, unix_s: Array, values: dict[str, Array]) -> None:
        """Fold scans in, [n] of each; those outside are left out."""
        step = np.floor((unix_s - self.since_s) / self.step_s)
        chosen = np.flatnonzero((step >= 0) & (step < len(self.scans)))
        if not len(chosen):
            return
        chosen = chosen[np.argsort(step[chosen], kind="stable")]
        at, first, count = np.unique(step[chosen].astype(int), return_index=True, return_counts=True)
        self.scans[at] += count
        for name, column in values.items():
            for kept, smaller in ((self.low, np.fmin), (self.high, np.fmax)):
                whole = kept.setdefault(name, np.full(len(self.scans), np.nan))
                whole[at] = smaller(whole[at], smaller.reduceat(column[chosen], first))


def envelope(connection: Connection, press: str, since: datetime, until: datetime, steps: int) -> Envelope:
    """Return what a press recorded from `since` to before `until`, in so many steps of equal length."""
    begin, end = since.timestamp(), until.timestamp()
    found = Envelope(begin, (until - since).total_seconds() / steps, np.zeros(steps))
    press_id = recorded_id(connection, press)
    if press_id is None:
        return found
    first, last = (first_number_from(connection, press_id, at) for at in (begin, end))
    for unix_s, values in _in_table(connection, press_id, first, last):
        found.add(unix_s, values)
    for run in _archived_runs(connection, press_id, first, begin, end):
        try:
            scans = archived_scans(connection, run)
        except InputError as error:
            found.unread.append((run, spoken(error)))
            continue
        if scans is None:  # brought back since
            continue
        for layout, table in scans.values.items():
            own = scans.layout == layout
            faults = [text for text, its in zip(scans.faults, own, strict=True) if its]
            found.add(scans.unix_s[own], _columns(connection, layout, table, faults))
    return found


def _in_table(
    connection: Connection, press_id: int, first: int, last: int
) -> Iterator[tuple[Array, dict[str, Array]]]:
    kept = select(SCAN.c.unix_s, SCAN.c.layout_id, SCAN.c.readings, SCAN.c.faults)
    query = kept.where(SCAN.c.press_id == press_id, SCAN.c.number >= first, SCAN.c.number < last)
    streamed = connection.execute(query.order_by(SCAN.c.number), execution_options={"yield_per": SCANS_AT_ONCE})
    for rows in streamed.partitions(SCANS_AT_ONCE):
        for layout in dict.fromkeys(row.layout_id for row in rows):
            own = [
                row for row in rows if row.layout_id == layout and (row.faults is None or is_object(row.faults))
            ]
            width = len(layout_channels(connection, layout))
            table, _ = readings_with_gaps([row.readings for row in own], width)
            columns = _columns(connection, layout, table, [row.faults for row in own])
            yield np.array([row.unix_s for row in own]), columns


def _columns(connection: Connection, layout: int, table: Array, faults: list[str | None]) -> dict[str, Array]:
    channels = layout_channels(connection, layout)
    usable = usable_values(channels, table, faults)
    return {channel.name: usable[:, i] for i, channel in enumerate(channels)}


def _archived_runs(connection: Connection, press_id: int, first: int, begin: float, end: float) -> list[str]:
    """Return the archived runs of a press that were being recorded in a time, oldest first."""
    own = RUN.c.press_id == press_id
    begun = select(func.coalesce(func.max(RUN.c.first_scan), 0)).where(own, RUN.c.first_scan <= first)
    query = select(RUN.c.run).join(ARCHIVE, ARCHIVE.c.run == RUN.c.run)
    within = (RUN.c.started_unix_s < end, func.coalesce(RUN.c.ended_unix_s, end) >= begin)
    query = query.where(own, RUN.c.first_scan >= begun.scalar_subquery(), *within)
    return list(connection.execute(query.order_by(RUN.c.first_scan)).scalars())
