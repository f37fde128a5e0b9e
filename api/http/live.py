"""Live events: one follower of the store for all listeners, and what a listener missed.

An `estimate` holds the live sensor's answer at its scan; whether it is of now is held against the clock when it is
sent. Where the newest one has ceased to be so (recorder or live sensor are silent, the press has gone on without
it), it comes once more, not valid, with the reason.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from api.http.news import Position, Standpoint, estimate_event, newest_position, news, now_of_all
from daq.store.records import StoreUnavailable
from daq.store.store import Store
from daq.supervision import RESTART_S, Faults, StandstillAlarm, Steps
from daq.words import Message

POLL_S = 0.05
"""How often the store is asked for news; well below a scan period. [s]"""
PING_S = 10.0
"""A comment this often shows proxies and browsers that the stream lives. [s]"""
LOOK_S = 0.5
"""How often it is looked whether what was sent is still so. [s]"""
QUEUE_EVENTS = 2000
"""A listener that lags this far behind is let go; it comes back with Last-Event-ID."""
MAX_LISTENERS = 200
"""Each holds a connection and its place in the queue; a hall has some tens of screens."""
LOG = logging.getLogger("kerntemp.serve")


class Hub:
    """Follows the store while somebody listens, and hands every event to every listener."""

    def __init__(self, store: Store, max_listeners: int = MAX_LISTENERS) -> None:
        self._store = store
        self._max_listeners = max_listeners
        self._queues: set[asyncio.Queue[bytes | None]] = set()
        self._position: Position | None = None
        self._sent: dict[str, Standpoint] = {}
        """What was sent last of each press's newest estimate."""
        self._looked_s = -math.inf
        self._task: asyncio.Task[None] | None = None
        self._steps = Steps("live events")
        self._faults = Faults(self._steps.name, self._journal)
        self._standstill = StandstillAlarm(self._steps, self._journal)
        self._lock = asyncio.Lock()
        self._closed = False

    @property
    def full(self) -> bool:
        """Whether no further listener is taken."""
        return self._closed or len(self._queues) >= self._max_listeners

    def stalled(self) -> Message | None:
        """Return why nobody gets events now; None while they come, or the store is away."""
        why = self._standstill.stalled()
        return self._faults.newest or why

    async def join(self, last_event_id: str) -> Listener | None:
        """Take a listener in: what was missed, then everything stored from now on. None where it is full."""
        queue: asyncio.Queue[bytes | None] = asyncio.Queue(QUEUE_EVENTS)
        missed: list[bytes] = []
        async with self._lock:
            if self.full:  # those that came at the same moment have been counted only now
                return None
            with self._steps.step():
                if self._task is None or self._position is None:  # nobody followed: an earlier one is of before
                    self._position = await asyncio.to_thread(self._begin)
                if last_event_id:
                    behind, here = Position.parse(last_event_id), self._position
                    missed = await asyncio.to_thread(self._missed, behind, here)
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
                        self._task, self._position, self._faults.newest = None, None, None
                        return
                    with self._steps.step():
                        self._hand_out(await asyncio.to_thread(self._read))
                if self._faults.newest is not None:
                    await asyncio.to_thread(self._faults.worked)
            except StoreUnavailable as error:
                LOG.warning("%s", error)
                self._faults.newest = None  # the store's absence is reported by others
                await asyncio.sleep(RESTART_S)
            except Exception as error:  # noqa: BLE001 - whatever it is, those who listen must get what comes next
                with suppress(Exception):  # as without memory: the next fault is reported
                    await asyncio.to_thread(self._faults.failed, error)
                await asyncio.sleep(RESTART_S)
            await asyncio.sleep(POLL_S)

    def _begin(self) -> Position:
        self._sent = {
            press: (estimate.number, estimate.valid) for press, (_, estimate) in now_of_all(self._store).items()
        }
        return newest_position(self._store)

    def _missed(self, behind: Position, here: Position) -> list[bytes]:
        """Return what was stored in between and, where the last of it is no longer so, that."""
        events = list(news(self._store, behind, here))
        for press, (present, estimate) in now_of_all(self._store).items():
            if present.silent and estimate.number == here.estimates.get(press):
                events.append(estimate_event(press, estimate, here))
        return events

    def _read(self) -> list[bytes]:
        """Return what is new and go on behind it; after a fault the next look has all of it."""
        if self._position is None:
            return []
        position, sent = self._position.copy(), dict(self._sent)
        events = [*news(self._store, position, sent=sent), *self._changed(position, sent)]
        self._position, self._sent = position, sent
        return events

    def _changed(self, position: Position, sent: dict[str, Standpoint]) -> list[bytes]:
        """Return the newest estimates that were sent as valid and no longer are."""
        if time.monotonic() - self._looked_s < LOOK_S:
            return []
        self._looked_s = time.monotonic()
        events = []
        for press, (_, estimate) in now_of_all(self._store).items():
            if sent.get(press) == (estimate.number, True) and not estimate.valid:
                sent[press] = (estimate.number, False)
                events.append(estimate_event(press, estimate, position))
        return events

    def _hand_out(self, events: list[bytes]) -> None:
        for queue in list(self._queues):
            for event in events:
                if queue.full():
                    self._queues.discard(queue)
                    queue.get_nowait()
                    queue.put_nowait(None)
                    break
                queue.put_nowait(event)

    def _journal(self, fault: Message) -> None:
        self._store.log("alarm", "serve", fault)

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
