"""How a press stands in the store: all of it from one transaction, so that no part is of another moment."""

from __future__ import annotations

from typing import NamedTuple

from sqlalchemy import Connection

from daq.records import Channel, Scan
from daq.store.reading import newest_number, open_run, press_events, runs, scans_after
from daq.store.records import RunRecord, StoredEstimate, StoredPressEvent
from daq.store.results import estimates_after, newest_estimate_number


class Standing(NamedTuple):
    """The newest of everything about a press."""

    run: RunRecord | None
    """The newest, open or over."""
    events: tuple[StoredPressEvent, ...]
    """Of that run while it is open."""
    channels: tuple[Channel, ...]
    scan: Scan | None
    estimate: StoredEstimate | None
    estimated: Scan | None
    """The scan that the estimate is of; None where it is not there any more."""


def standing(connection: Connection, press: str) -> Standing:
    """Return how a press stands. Raises `StoreUnavailable` where its newest scans cannot be read."""
    being_recorded = open_run(connection, press)
    events = press_events(connection, press, since_scan=being_recorded.first_scan) if being_recorded else ()
    run = being_recorded or next(iter(runs(connection, press=press, limit=1).items), None)
    batch = scans_after(connection, press, newest_number(connection, press) - 1, 1)
    scan = batch.scans[-1] if batch.scans else None
    number = newest_estimate_number(connection, press)
    estimate = next(iter(estimates_after(connection, press, number - 1, 1)), None)
    if estimate is None or (scan is not None and scan.number == number):
        return Standing(run, tuple(events), batch.channels, scan, estimate, None if estimate is None else scan)
    own = (s for s in scans_after(connection, press, number - 1, 1).scans if s.number == number)
    return Standing(run, tuple(events), batch.channels, scan, estimate, next(own, None))
