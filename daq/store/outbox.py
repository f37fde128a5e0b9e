"""From the recorder into the store: in order, durably, while the store may be away.

The recorder only ever puts; a thread of its own writes. One transaction takes what has gathered. While
the store refuses (locked, full, server away), what is put waits: in a local buffer file where one is
given (durable: it counts as acknowledged), else in memory. Afterwards everything is written in the order
it was put; what a lost acknowledgement may have written already is not written twice.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from daq.records import Channel, InputError, Quality, Scan
from daq.store.buffer import Buffer, set_aside
from daq.store.convert import known_utc
from daq.store.last_written import WrittenSoFar
from daq.store.records import AT_ONCE, NumbersTaken, PressGone, PressKey, StoreUnavailable
from daq.store.session_placement import Notes, SessionPlacement, session_key
from daq.store.store import Store
from daq.store.write_batch import Entry, Level, WriteBatch, encode_item, in_parts, item_in_words
from daq.supervision import BEAT_S, CALM_S, ENDS_S, RESTART_S, STALLED_S, Pending, SupervisedThread, unexpected
from daq.words import Message, say, spoken

_FIRST_RETRY_S, _LONGEST_RETRY_S = RESTART_S, 10.0
"""A store that refuses is tried again after this, doubled each time up to the second. Set by hand, 2026-11. [s]"""

# Numbers without another source were set by hand, 2026-11.

_MOST_WAITING = 200_000
"""Write batches kept in memory while the store is away and there is no buffer: 5 h at 10 Hz and one press."""
_IDLE_S = 0.25
"""How often the writer looks whether it is to go on. [s]"""


class Outbox:
    """Writes batches and journal lines in the order they were put."""

    def __init__(
        self,
        store: Store,
        *,
        buffer: Path | None = None,
        per_second: float = 10.0,
        gather_s: float = 0.0,
        acknowledged: Callable[[WriteBatch], None] | None = None,
        journal: Callable[[Level, Message], None] | None = None,
    ) -> None:
        self.trouble: Message | None = None
        """Why the store refuses now; None while it does not."""
        self.lost = 0
        self.written = 0
        self._store = store
        self._journal = journal or (lambda level, message: None)
        self._pending = Pending(partial(self._journal, "alarm"))
        """Alarms of the buffer, journalled by the thread."""
        self._buffer = None if buffer is None else Buffer(buffer, self._pending.add, self._moves)
        self._aside = buffer or store.database.path
        self._notes: Notes = {} if self._buffer is None else self._buffer.sessions
        self._placement = SessionPlacement(store, self._notes)
        kept = None if buffer is None else buffer.with_name(f"{buffer.name}.written.json")
        self._so_far = WrittenSoFar(kept, store.label)
        self._others: dict[str, tuple[int, float]] = {}
        """By press the newest scan of another recorder that is in the way, and since when it has been that one."""
        self._per_second = per_second
        self._gather_s = gather_s
        self._acknowledged = acknowledged or (lambda batch: None)
        self._inbox: deque[WriteBatch | Entry] = deque()
        self._news = threading.Event()
        self._beat: tuple[str, Mapping[str, Any]] | None = None
        self._silent = False
        """Whether it is reported that the store takes no sign of life, though it takes all else."""
        self._waiting: list[WriteBatch | Entry] = []
        self._unsettled: deque[WriteBatch | Entry] = deque(maxlen=_MOST_WAITING)
        """Written, but perhaps only in the log of an SQLite store so far."""
        self._again: list[WriteBatch | Entry] = []
        """What a log that was cut short held, to be written again."""
        self._settle_at = time.monotonic() + BEAT_S
        self._retry_s, self._retry_at = _FIRST_RETRY_S, 0.0
        self._buffer_trouble = False
        self._moved_s = time.monotonic()
        self._thread = SupervisedThread("writer", self._work, lambda fault: self._journal("alarm", fault))
        self._closed = self._thinned = False

    def start(self) -> None:
        """Begin to write."""
        self._moved_s = time.monotonic()
        self._thread.start()

    def put(self, item: WriteBatch | Entry) -> None:
        """Hand something over; returns at once."""
        self._inbox.append(item)
        self._news.set()

    def beat(self, process: str, status: Mapping[str, Any]) -> None:
        """Hand over a sign of life; only the newest is written."""
        self._beat = (process, status)

    def stalled(self) -> Message | None:
        """Return why the writer must not count as alive; None while it works or waits for a store that is away."""
        if self._thread.fault is not None or not self._thread.alive:
            return self._thread.fault or say("writer-dead")
        still_s = time.monotonic() - self._moved_s
        return say("writer-stalled", seconds=still_s) if still_s > STALLED_S else None

    def later_key(self, press: str, channels: Sequence[Channel], press_file: str) -> PressKey:
        """Return a key to record with before the store can give one; the store's is found when it is due."""
        return session_key(self._notes, press, channels, press_file)

    @property
    def waiting(self) -> int:
        """How many items are not written yet."""
        return len(self._waiting) + len(self._inbox) + (len(self._buffer) if self._buffer else 0)

    @property
    def behind(self) -> bool:
        """Whether the buffer holds what must be written before anything new."""
        return self._buffer is not None and len(self._buffer) > 0

    @property
    def capacity(self) -> Message:
        """Where scans wait while the store is away, and how long there is room."""
        if self._buffer is None or self._buffer_trouble:
            return say("waits-in-memory", hours=self.hours_left)
        return say("waits-in-buffer", file=str(self._buffer.path), hours=self.hours_left)

    @property
    def hours_left(self) -> float:
        """How long scans can wait from now on, at the pace of all presses. [h]"""
        if self._buffer is not None and not self._buffer_trouble:
            return self._buffer.hours_left(self._per_second)
        return max(0, _MOST_WAITING - self.waiting) / self._per_second / 3600.0

    def expect(self, channels: Sequence[Channel], press: str = "", press_file: str = "") -> None:
        """Reckon with scans of so many channels before the first one waits; keep what their press is."""
        self._placement.press_files[press] = press_file
        if self._buffer is not None:
            self._buffer.expect(len(encode_item(_example(channels))))

    def close(self, longest_s: float = ENDS_S) -> None:
        """Write what is left, or give up after `longest_s`: what is not written then is reported."""
        self._closed = True
        self._news.set()
        self._thread.join(longest_s)
        if left := len(self._waiting) + len(self._inbox):
            self._journal("alarm", say("left-unwritten", count=left, store=self._store.label))

    def _work(self) -> None:
        ended = False
        while not ended or self._inbox:  # which the last writing may bring: that the store takes data again
            self._news.wait(_IDLE_S)
            self._news.clear()
            ended = self._closed  # what was put before closing is taken below
            if self._gather_s and not ended:
                time.sleep(self._gather_s)
            self._moved_s = time.monotonic()
            self._take()
            if self.trouble and not ended and time.monotonic() < self._retry_at:
                self._keep()
            elif self._waiting or self._beat or self.behind:
                self._deliver()
        self._so_far.keep_last()

    def _take(self) -> None:
        """Move all that was put to the waiting list, and report what the buffer went through."""
        while self._inbox:
            self._waiting.append(self._inbox[0])
            self._inbox.popleft()
        self._pending.hand_over()
        if len(self._waiting) > _MOST_WAITING:
            self._thin_out()

    def _thin_out(self) -> None:
        """Give up the oldest scans beyond the room in memory; runs, events and journal lines stay."""
        surplus, kept = len(self._waiting) - _MOST_WAITING, []
        for item in self._waiting[:surplus]:
            if isinstance(item, WriteBatch):
                self.lost += len(item.scans)
                item = replace(item, scans=())
            if isinstance(item, Entry) or item.begin or item.end:
                kept.append(item)
            elif item.events:
                self._journal("alarm", say("events-lost", press=item.key.name, count=len(item.events)))
        if not self._thinned:
            self._journal("alarm", say("scans-given-up", where=self.capacity))
        self._thinned = True
        self._waiting[:surplus] = kept

    def _watch_file(self) -> None:
        """Bring a file that was deleted, moved or exchanged back to its place, with all it holds."""
        database = self._store.database
        if database.moved and database.held and database.let_go():
            self._journal("alarm", say("store-taken-over", store=self._store.label))
        elif database.moved and database.held:
            beside = "store-rescued-log" if database.log_gone else "store-rescued-beside"
            if cut := database.log_cut or database.overwritten:
                beside = "store-overwritten" if database.overwritten else "store-rescued-cut"
            aside = database.rescue(self._moves)
            if cut:
                self._write_again()
            details: dict[str, Any] = {"store": self._store.label, "aside": str(aside), "count": len(self._again)}
            self._journal("alarm", Message(beside if aside else "store-rescued", details))
        if database.path is not None and not database.held:
            database.hold_on()

    def _write_again(self) -> None:
        """Have all written again that perhaps only the log held; the store should have all that was before it."""
        self._again, self._unsettled = [*self._again, *self._unsettled], deque(maxlen=_MOST_WAITING)
        for item in reversed(self._again):
            if isinstance(item, WriteBatch) and item.scans:
                self._so_far.ends_before(self._placement.moved(item))

    def _settle(self) -> None:
        """Bring what the log holds into the file with every sign of life, and forget what is there for certain.

        What a server has is there, and is kept for a later process now and then.
        """
        on_disk = self._store.database.path is not None
        if not on_disk:
            self._unsettled.clear()
        if time.monotonic() >= self._settle_at:
            self._settle_at = time.monotonic() + (BEAT_S if on_disk else CALM_S)
            self._so_far.keep()
            if on_disk and self._store.database.settle():
                self._unsettled.clear()

    def _moves(self) -> None:
        """Note that the writer is at work."""
        self._moved_s = time.monotonic()

    def _deliver(self) -> None:
        try:
            self._watch_file()
            while self._again:
                self._write(self._again[:AT_ONCE])
                del self._again[:AT_ONCE]
                self._show()
            self._drain()
            while self._waiting:
                items = self._waiting[:AT_ONCE]
                self._write(items)
                del self._waiting[: len(items)]
                self._acknowledge(items)
                self._show()
        except Exception as error:  # noqa: BLE001 - the thread must outlive whatever the engine raises
            self._refused(error)
        else:
            self._retry_s, self._thinned = _FIRST_RETRY_S, False
            self._thread.worked()
            self._settle()
            if self.trouble:
                self.trouble = None
                self._journal("info", say("store-back", store=self._store.label))
        if not self.trouble:
            self._show()

    def _show(self) -> None:
        """Write the newest sign of life, also among much that waits: who is busy must not be taken for dead."""
        self._moved_s = time.monotonic()
        if self._beat is not None:
            beat, self._beat = self._beat, None
            try:
                self._store.beat(*beat)
            except StoreUnavailable as error:
                self._beat_refused(error)
            else:
                self._silent = False

    def _beat_refused(self, error: StoreUnavailable) -> None:
        """Report once that the store takes no sign of life, unless it takes nothing now: the scans report that."""
        with suppress(StoreUnavailable):
            self._store.try_to_write()
            if not self._silent:
                self._journal("alarm", say("sign-of-life-refused", why=spoken(error)))
            self._silent = True

    def _refused(self, error: Exception) -> None:
        foreseen = isinstance(error, StoreUnavailable | InputError | sqlite3.Error | OSError)
        reason = spoken(error) if foreseen else unexpected(error)
        if not foreseen:
            self._thread.failed(error)
        if not self.trouble and not isinstance(error, PressGone):  # which is journalled already
            self._journal("alarm", say("scans-wait", why=reason, where=self.capacity))
        self.trouble = reason
        self._retry_at = time.monotonic() + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, _LONGEST_RETRY_S)
        self._keep()

    def _write(self, items: Sequence[WriteBatch | Entry]) -> None:
        """Write all of it; what the store does not take, though it takes other things, is set aside."""
        try:
            self._write_together(items)
        except StoreUnavailable:
            raise
        except Exception as error:  # noqa: BLE001 - whatever the engine has against one of them
            self._store.try_to_write()
            parts = [p for x in items for p in (in_parts(x) if isinstance(x, WriteBatch) else ((x,),))]
            if sum(self._write_one_of(tries) for tries in parts) == 0:
                self._thread.failed(error)  # it was none of them
        self._unsettled += items

    def _write_one_of(self, tries: Sequence[WriteBatch | Entry]) -> int:
        """Write the first of these that the store takes; return how many before it were set aside and reported."""
        for refused, item in enumerate(tries):
            try:
                self._write_together([item])
            except StoreUnavailable:
                raise
            except Exception as error:  # noqa: BLE001
                self._store.try_to_write()
                self._put_aside(item, error)
            else:
                return refused
        return len(tries)

    def _put_aside(self, item: WriteBatch | Entry, error: Exception) -> None:
        if self._aside is None:
            raise error
        why = spoken(error) if isinstance(error, InputError) else unexpected(error)
        aside = set_aside(self._aside, item_in_words(item), str(why))
        if isinstance(item, Entry):
            if item.message.code != "line-set-aside":  # or one that reports itself would never end
                details = say("line-set-aside", aside=str(aside))
                self.put(Entry("alarm", item.process, details, unix_s=item.unix_s))
            return
        what = say("set-aside-begin", run=item.begin.run) if item.begin else say("set-aside-scans")
        self._journal("alarm", say("item-set-aside", press=item.key.name, what=what, why=why, aside=str(aside)))

    def _write_together(self, items: Sequence[WriteBatch | Entry]) -> None:
        ready: list[WriteBatch] = []
        for batch in (item for item in items if isinstance(item, WriteBatch)):
            if self._placement.waits_for_place(batch):
                self._write_placed(ready)
                ready = []
                for run in self._placement.place(batch.key).interrupted:
                    self._store.log("warning", "record", say("run-interrupted", run=run), batch.key.name)
            ready.append(self._placement.moved(batch))
        self._write_placed(ready, [item for item in items if isinstance(item, Entry)])

    def _write_placed(self, batches: Sequence[WriteBatch], lines: Sequence[Entry] = ()) -> None:
        """Write, and report where the store lacks what it had: an older state of it, or another one, is there."""
        try:
            there = self._store.write_batches(batches, lines, self._so_far)
        except PressGone as gone:
            for key in gone.keys:
                self._forget(key)
                self._journal("alarm", say("store-press-gone", store=self._store.label, press=key.name))
            raise
        except NumbersTaken as taken:
            self._step_behind(taken)
            raise
        for press, lost in self._so_far.lacking(there):
            numbers = {"first": lost[0], "last": lost[-1]}
            self._journal("alarm", say("store-went-back", store=self._store.label, press=press, **numbers))
        self._so_far.add(batches)

    def _forget(self, key: PressKey) -> None:
        """Have what belongs to a press placed again: where it was is no place for it any more."""
        self._placement.forget(key)
        self._so_far.forget(key.name)

    def _step_behind(self, taken: NumbersTaken) -> None:
        """Have what waits placed behind another recorder's scans, once that one has written none for a while."""
        now_s, press = time.monotonic(), taken.key.name
        newest, since_s = self._others.get(press, (-1, now_s))
        if taken.newest != newest:
            self._others[press] = taken.newest, now_s
        elif now_s - since_s > STALLED_S:
            del self._others[press]
            self._forget(taken.key)
            self._journal("warning", say("scans-behind-others", press=press, seconds=now_s - since_s))

    def _acknowledge(self, items: Sequence[WriteBatch | Entry]) -> None:
        for item in items:
            if isinstance(item, WriteBatch):
                self.written += len(item.scans)
                self._acknowledged(item)

    def _keep(self) -> None:
        """Move what waits from memory to the buffer."""
        if self._buffer is None or not self._waiting:
            return
        self._so_far.keep()  # what is kept from now on was not written
        try:
            self._buffer.append(self._waiting)
        except (sqlite3.Error, OSError, ValueError, TypeError) as error:  # the last two: no text stands for it
            self._journal_buffer(error)
            return
        self._buffer_trouble = False
        kept, self._waiting = self._waiting, []
        self._acknowledge(kept)

    def _journal_buffer(self, error: Exception) -> None:
        if not self._buffer_trouble and self._buffer is not None:
            self._buffer_trouble = True
            self._journal("alarm", say("scans-wait", why=self._buffer.refusal(error), where=self.capacity))

    def _drain(self) -> None:
        """Write the buffer's content; what is put meanwhile goes behind it, durably."""
        while self._buffer is not None and self.behind:
            try:
                rows = self._buffer.oldest(AT_ONCE)
            except (sqlite3.Error, OSError) as error:  # a store that is well does not wait for its buffer
                if any(isinstance(x, WriteBatch) and self._placement.waits_for_place(x) for x in self._waiting):
                    # the place of what waits here is behind what is in there
                    raise StoreUnavailable(self._buffer.refusal(error)) from error
                self._journal_buffer(error)
                return
            if not rows:
                return
            self._write([item for _, item in rows])
            self._buffer.remove(rows[-1][0])
            self._show()
            self._take()
            self._keep()


def _example(channels: Sequence[Channel]) -> WriteBatch:
    """Return a write batch as large as they come."""
    key = PressKey(1, "press-name", 1, tuple(channels), 10**8)
    now = known_utc(time.time())
    scan = Scan(10**8, now, 10**6 / 7, (10**3 / 7,) * len(channels), (Quality.GOOD,) * len(channels))
    return WriteBatch(key, (scan,))
