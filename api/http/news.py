"""What the store holds beyond a position, as encoded events of the live stream.

The id of each event shows how far the listener has come in every list of the store. It survives a
restart of the server: whoever comes back with Last-Event-ID gets what was stored in between.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any
from urllib.parse import quote, unquote

from api.answers.decimation import number_or_none
from api.answers.present import STATE_AFTER, Present, age_of, as_of_now, is_of_now, present_of, state_of
from api.answers.records import estimate_now, estimate_of, run_of_scan, utc_now
from api.answers.schemas import EstimateNow
from daq.records import Channel, InputError, Quality, Scan
from daq.store.records import RunRecord, RunStatus, ScanBatch, StoredEstimate, StoredPressEvent
from daq.store.store import Store
from daq.words import say

CATCH_UP_SCANS = 2000
"""A listener that missed more gets the newest this many; the rest is in `samples`."""
CATCH_UP_FITS = 20
"""A listener that missed more gets the fits of the newest this many fitted runs; the rest is in `coefficients`."""
Standpoint = tuple[int | None, bool]
"""An estimate by its number, and whether it was valid when it was sent."""
RUNS = 3
"""So many runs of each press are looked through for the one a scan belongs to."""


@dataclass
class Position:
    """How far a listener has come: scan and estimate numbers by press, rows of the other lists."""

    scans: dict[str, int] = field(default_factory=dict)
    estimates: dict[str, int] = field(default_factory=dict)
    press_event: int = 0
    fit: int = 0
    run: str = ""

    def copy(self) -> Position:
        """Return an independent copy."""
        return Position(dict(self.scans), dict(self.estimates), self.press_event, self.fit, self.run)

    def __str__(self) -> str:
        """Return the event id."""
        presses = ";".join(
            f"{quote(name, safe='')}.{number}.{self.estimates.get(name, -1)}"
            for name, number in self.scans.items()
        )
        return f"{self.press_event}/{self.fit}/{quote(self.run, safe='')}/{presses}"

    def check(self) -> None:
        """Raise `ValueError` for numbers no list of the store can reach."""
        numbers = (self.press_event, self.fit, *self.scans.values(), *self.estimates.values())
        if not all(-1 <= number < 2**53 for number in numbers):
            raise ValueError("out of range")

    @classmethod
    def parse(cls, text: str) -> Position:
        """Read an event id. Raises `InputError`."""
        try:
            event, fit, run, presses = text.split("/")
            position = cls(press_event=int(event), fit=int(fit), run=unquote(run))
            for entry in filter(None, presses.split(";")):
                name, scan, estimate = entry.rsplit(".", 2)
                position.scans[unquote(name)] = int(scan)
                position.estimates[unquote(name)] = int(estimate)
            position.check()
        except ValueError as error:
            raise InputError(say("api-last-event-id-unknown", id=text[:80])) from error
        return position


def newest_position(store: Store) -> Position:
    """Return the position that has seen everything stored so far."""
    position = Position()
    for press in store.presses():
        position.scans[press] = store.newest_scan_number(press)
        position.estimates[press] = store.newest_estimate_number(press)
    after = 0
    while events := store.press_events(after=after):
        after = events[-1].number
    position.press_event = after
    position.fit = store.newest_fit_number()
    position.run = _run_state(_newest_runs(store))
    return position


def news(
    store: Store, position: Position, until: Position | None = None, sent: dict[str, Standpoint] | None = None
) -> Iterator[bytes]:
    """Yield what the store holds beyond `position` as encoded events, moving `position` along.

    With `until`, stop where another listener already is. `sent` takes what is sent of each newest estimate.
    """
    for press in store.presses():
        yield from _scans(store, press, position, until, {} if sent is None else sent)
    events = list(_press_events(store, position.press_event))
    runs = _newest_runs(store)  # after what may have begun one
    for event in events:
        if until and event.number > until.press_event:
            break
        position.press_event = event.number
        run = run_of_scan((run for run in runs if run.press == event.press), event.scan_number)
        data = {
            "press": event.press,
            "run": run.run if run else None,
            "event": event.kind,
            "state": STATE_AFTER.get(event.kind, "unknown"),
            "utc": event.utc.isoformat() if event.utc else None,
            "time_s": round(event.monotonic_s - run.zero_monotonic_s, 6) if run else None,
            "source": event.source,
        }
        yield encode_event("press", data, position)
    if _run_state(runs) != position.run:
        position.run = _run_state(runs)
        for record in reversed(runs):
            data = {
                "press": record.press,
                "run": record.run,
                "status": str(record.status),
                "started_utc": record.started_utc.isoformat() if record.started_utc else None,
            }
            yield encode_event("run", data, position)
    yield from _fits(store, position, until)


def _press_events(store: Store, after: int) -> Iterator[StoredPressEvent]:
    while events := store.press_events(after=after):
        yield from events
        after = events[-1].number


def _newest_runs(store: Store) -> tuple[RunRecord, ...]:
    """Return the newest runs of each press; one that is imported meanwhile belongs to none."""
    return tuple(run for press in store.presses() for run in store.runs(press=press, limit=RUNS).items)


def _run_state(runs: tuple[RunRecord, ...]) -> str:
    return ",".join(f"{run.number}{run.status.value[0]}" for run in runs)


def _scans(
    store: Store, press: str, position: Position, until: Position | None, sent: dict[str, Standpoint]
) -> Iterator[bytes]:
    newest = store.newest_scan_number(press)
    last_scan = until.scans.get(press, newest) if until else math.inf
    last_estimate = until.estimates.get(press, newest) if until else math.inf
    after = max(position.scans.get(press, newest), newest - CATCH_UP_SCANS)
    batch = store.scans_after(press, after, CATCH_UP_SCANS)
    behind = max(position.estimates.get(press, newest), newest - CATCH_UP_SCANS)
    estimates = store.estimates_after(press, behind, CATCH_UP_SCANS)
    runs = store.runs(press=press, limit=RUNS).items if batch.scans or estimates else ()  # after what began one
    for scan in batch.scans:
        if scan.number > last_scan:
            break
        position.scans[press] = scan.number
        yield encode_event(
            "scan", scan_event(press, batch.channels, scan, run_of_scan(runs, scan.number)), position
        )
    position.scans.setdefault(press, newest)
    utc = _utc_of_scans(store, press, [estimate.number for estimate in estimates], batch)
    now = utc_now()
    for estimate in estimates:
        if estimate.number > last_estimate:
            break
        position.estimates[press] = estimate.number
        own = utc.get(estimate.number)
        if estimate is estimates[-1] and is_of_now(age_of(own, now)):
            estimate = _standing(store, press, runs, estimate, own, now)
        answer = estimate_now(estimate, run_of_scan(runs, estimate.number), own, now)
        sent[press] = (answer.number, answer.valid)
        yield estimate_event(press, answer, position)
    position.estimates.setdefault(press, behind)


def estimate_event(press: str, estimate: EstimateNow, position: Position) -> bytes:
    """Return an estimate for the stream."""
    return encode_event("estimate", {"press": press, **estimate.model_dump(mode="json")}, position)


def now_of_all(store: Store) -> dict[str, tuple[Present, EstimateNow]]:
    """Return how each press stands that has an estimate."""
    found, now = {}, utc_now()
    for press in store.presses():
        present = present_of(store, press, now)
        shown = present.run or next(iter(store.runs(press=press, limit=1).items), None)
        if (estimate := estimate_of(present, shown, now)) is not None:
            found[press] = (present, estimate)
    return found


def _standing(
    store: Store,
    press: str,
    runs: Sequence[RunRecord],
    estimate: StoredEstimate,
    utc: datetime | None,
    now: datetime,
) -> StoredEstimate:
    """Return the newest estimate as it counts for the press as the recorder sees it."""
    run = next((run for run in runs if run.status is RunStatus.OPEN), None)
    if run is None and runs and runs[0].status is RunStatus.INTERRUPTED:
        return as_of_now(estimate, utc, present_of(store, press, now).state, run, now)
    events = store.press_events(press, since_scan=run.first_scan) if run else ()
    return as_of_now(estimate, utc, state_of(events, run), run, now)


def _utc_of_scans(store: Store, press: str, numbers: list[int], batch: ScanBatch) -> dict[int, datetime]:
    """Return when these scans were taken; those just read need no second look."""
    utc = {scan.number: scan.utc for scan in batch.scans}
    if any(number not in utc for number in numbers):
        earlier = store.scans_after(press, numbers[0] - 1, CATCH_UP_SCANS)
        utc |= {scan.number: scan.utc for scan in earlier.scans}
    return utc


def scan_event(press: str, channels: tuple[Channel, ...], scan: Scan, run: RunRecord | None) -> dict[str, Any]:
    """Return one scan for the stream; qualities are given only where they are not good."""
    names = [channel.name for channel in channels]
    return {
        "press": press,
        "run": run.run if run else None,
        "number": scan.number,
        "utc": scan.utc.isoformat(),
        "time_s": round(scan.monotonic_s - run.zero_monotonic_s, 6) if run else None,
        "temperatures_C": {n: number_or_none(v) for n, v in zip(names, scan.values, strict=True)},
        "qualities": {n: str(q) for n, q in zip(names, scan.qualities, strict=True) if q is not Quality.GOOD},
    }


def _fits(store: Store, position: Position, until: Position | None) -> Iterator[bytes]:
    for number, run in store.fits_after(position.fit, CATCH_UP_FITS):
        if until and number > until.fit:
            break
        fit = store.fit(run) or {}
        position.fit = number
        data = {
            "run": run,
            "press": store.run_records([run])[run].press,
            "coefficients": fit.get("coefficients", {}),
            "rmse_K": fit.get("rmse_K"),
            "initial_rmse_K": fit.get("initial_rmse_K"),
        }
        yield encode_event("fit", data, position)


def encode_event(name: str, data: dict[str, Any], position: Position) -> bytes:
    """Return one Server-Sent Event."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return f"event: {name}\nid: {position}\ndata: {text}\n\n".encode()
