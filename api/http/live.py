"""Live events: one follower of the store for all listeners, and what a listener missed.

The id of each event tells how far the listener has come in every list of the store. It survives a
restart of the server: whoever comes back with Last-Event-ID gets what was stored in between.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any
from urllib.parse import quote, unquote

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from api.answers.decimation import number_or_none
from api.answers.present import STATE_AFTER
from api.answers.records import estimate_now, run_of_scan, utc_now
from daq.records import Channel, InputError, Quality, Scan
from daq.store.records import RunRecord, ScanBatch, StoredPressEvent, StoreUnavailable
from daq.store.store import Store
from daq.words import say

POLL_S = 0.05
"""How often the store is asked for news; well below a scan period. [s]"""
PING_S = 10.0
"""A comment this often tells proxies and browsers that the stream lives. [s]"""
CATCH_UP_SCANS = 2000
"""A listener that missed more gets the newest this many; the rest is in `samples`."""
CATCH_UP_FITS = 20
"""A listener that missed more gets the fits of the newest this many fitted runs; the rest is in `coefficients`."""
RUNS = 3
"""So many runs of each press are looked through for the one a scan belongs to."""
QUEUE_EVENTS = 2000
"""A listener that lags this far behind is let go; it comes back with Last-Event-ID."""
MAX_LISTENERS = 200
LOG = logging.getLogger("kerntemp.serve")


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


def news(store: Store, position: Position, until: Position | None = None) -> Iterator[bytes]:
    """Yield what the store holds beyond `position` as encoded events, moving `position` along.

    With `until`, stop where another listener already is.
    """
    runs = _newest_runs(store)
    for press in store.presses():
        yield from _scans(store, press, runs, position, until)
    for event in _press_events(store, position.press_event):
        if until and event.number > until.press_event:
            break
        position.press_event = event.number
        run = run_of_scan(runs, event.scan_number)
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
    store: Store, press: str, runs: tuple[RunRecord, ...], position: Position, until: Position | None
) -> Iterator[bytes]:
    newest = store.newest_scan_number(press)
    last_scan = until.scans.get(press, newest) if until else math.inf
    last_estimate = until.estimates.get(press, newest) if until else math.inf
    after = max(position.scans.get(press, newest), newest - CATCH_UP_SCANS)
    batch = store.scans_after(press, after, CATCH_UP_SCANS)
    runs = tuple(run for run in runs if run.press == press)
    for scan in batch.scans:
        if scan.number > last_scan:
            break
        position.scans[press] = scan.number
        yield encode_event(
            "scan", scan_event(press, batch.channels, scan, run_of_scan(runs, scan.number)), position
        )
    position.scans.setdefault(press, newest)
    after = max(position.estimates.get(press, newest), newest - CATCH_UP_SCANS)
    estimates = store.estimates_after(press, after, CATCH_UP_SCANS)
    utc = _utc_of_scans(store, press, [estimate.number for estimate in estimates], batch)
    now = utc_now()
    for estimate in estimates:
        if estimate.number > last_estimate:
            break
        position.estimates[press] = estimate.number
        told = estimate_now(estimate, run_of_scan(runs, estimate.number), utc.get(estimate.number), now)
        yield encode_event("estimate", {"press": press, **told.model_dump(mode="json")}, position)
    position.estimates.setdefault(press, after)


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
            "press": store.run_record(run).press,
            "coefficients": fit.get("coefficients", {}),
            "rmse_K": fit.get("rmse_K"),
            "initial_rmse_K": fit.get("initial_rmse_K"),
        }
        yield encode_event("fit", data, position)


def encode_event(name: str, data: dict[str, Any], position: Position) -> bytes:
    """Return one Server-Sent Event."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return f"event: {name}\nid: {position}\ndata: {text}\n\n".encode()


class Hub:
    """Follows the store while somebody listens, and hands every event to every listener."""

    def __init__(self, store: Store, max_listeners: int = MAX_LISTENERS) -> None:
        self._store = store
        self._max_listeners = max_listeners
        self._queues: set[asyncio.Queue[bytes | None]] = set()
        self._position: Position | None = None
        self._task: asyncio.Task[None] | None = None
        self._lock = asyncio.Lock()
        self._closed = False

    @property
    def full(self) -> bool:
        """Whether no further listener is taken."""
        return self._closed or len(self._queues) >= self._max_listeners

    async def join(self, last_event_id: str) -> Listener | None:
        """Take a listener in: what was missed, then everything stored from now on. None where it is full."""
        queue: asyncio.Queue[bytes | None] = asyncio.Queue(QUEUE_EVENTS)
        missed: list[bytes] = []
        async with self._lock:
            if self.full:  # those that came at the same moment have been counted only now
                return None
            if self._position is None:
                self._position = await asyncio.to_thread(newest_position, self._store)
            if last_event_id:
                behind, here = Position.parse(last_event_id), self._position
                missed = await asyncio.to_thread(lambda: list(news(self._store, behind, here)))
            self._queues.add(queue)
        if self._task is None:
            self._task = asyncio.create_task(self._follow())
        return Listener(missed, queue)

    def leave(self, listener: Listener) -> None:
        """Let a listener go. A second call does no harm."""
        self._queues.discard(listener.queue)

    async def _follow(self) -> None:
        while True:
            try:
                async with self._lock:  # who joins holds it too: nobody is forgotten at the end
                    if self._closed or not self._queues:
                        self._task, self._position = None, None
                        return
                    self._hand_out(await asyncio.to_thread(self._read))
            except StoreUnavailable as error:
                LOG.warning("%s", error)
                await asyncio.sleep(1.0)
            except Exception:
                LOG.exception("a fault while following the store; going on")
                await asyncio.sleep(1.0)
            await asyncio.sleep(POLL_S)

    def _read(self) -> list[bytes]:
        return list(news(self._store, self._position)) if self._position else []

    def _hand_out(self, events: list[bytes]) -> None:
        for queue in list(self._queues):
            for event in events:
                if queue.full():
                    self._queues.discard(queue)
                    queue.get_nowait()
                    queue.put_nowait(None)
                    break
                queue.put_nowait(event)

    def close(self) -> None:
        """End all streams, for the server's end."""
        self._closed = True
        for queue in self._queues:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(None)


@dataclass(frozen=True)
class Listener:
    """One stream: what it missed, and what comes."""

    missed: list[bytes]
    queue: asyncio.Queue[bytes | None]

    async def events(self) -> AsyncIterator[bytes]:
        """Yield encoded events, and a comment now and then, until the hub ends the stream."""
        yield b": kerntemp\nretry: 1000\n\n"
        for missed in self.missed:
            yield missed
        while True:
            try:
                async with asyncio.timeout(PING_S):
                    event = await self.queue.get()
            except TimeoutError:
                yield b": ping\n\n"
                continue
            if event is None:
                return
            yield event


class EventStream(StreamingResponse):
    """A stream of a hub's events; the listener leaves however the stream ends."""

    media_type = "text/event-stream"

    def __init__(self, hub: Hub, listener: Listener) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(listener.events(), headers=headers)
        self._hub, self._listener = hub, listener

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._hub.leave(self._listener)
