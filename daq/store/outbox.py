"""From the recorder into the store: in order, durably, while the store may be away.

The recorder only ever puts; a thread of its own writes. One transaction takes what has gathered. While
the store refuses (locked, full, server away), what is put waits: in a local buffer file where one is
given (durable: it counts as acknowledged), else in memory. Afterwards everything is written in the order
it was put; what a lost acknowledgement may have written already is not written twice.
"""

from __future__ import annotations

import queue
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from daq.records import Channel, Quality, Scan
from daq.store.admission import Admission, Notes, session_key
from daq.store.buffer import Buffer
from daq.store.convert import known_utc
from daq.store.parcels import Entry, Parcel, encode
from daq.store.records import PressKey, StoreUnavailable
from daq.store.store import Store

Level = Literal["info", "warning", "alarm"]
_FIRST_RETRY_S, _LONGEST_RETRY_S = 1.0, 10.0
_MOST_WAITING = 200_000
"""Parcels kept in memory while the store is away and there is no buffer: 5 h at 10 Hz and one press."""
_BATCH = 500


class Outbox:
    """Writes parcels and journal lines in the order they were put."""

    def __init__(
        self,
        store: Store,
        *,
        buffer: Path | None = None,
        per_second: float = 10.0,
        gather_s: float = 0.0,
        acknowledged: Callable[[Parcel], None] | None = None,
        say: Callable[[Level, str], None] | None = None,
    ) -> None:
        self.trouble = ""
        """Why the store refuses now; empty while it does not."""
        self.lost = 0
        self.written = 0
        self._store = store
        self._buffer = None if buffer is None else Buffer(buffer)
        self._notes: Notes = {} if self._buffer is None else self._buffer.sessions
        self._admission = Admission(store, self._notes)
        self._per_second = per_second
        self._gather_s = gather_s
        self._acknowledged = acknowledged or (lambda parcel: None)
        self._say = say or (lambda level, sentence: None)
        self._queue: queue.Queue[Parcel | Entry | None] = queue.Queue()
        self._beat: tuple[str, Mapping[str, Any]] | None = None
        self._waiting: list[Parcel | Entry] = []
        self._retry_s, self._retry_at = _FIRST_RETRY_S, 0.0
        self._buffer_trouble = ""
        self._thread = threading.Thread(target=self._work, name="outbox", daemon=True)
        self._closed = False

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put(self, item: Parcel | Entry) -> None:
        """Hand something over; returns at once."""
        self._queue.put(item)

    def beat(self, process: str, status: Mapping[str, Any]) -> None:
        """Hand over a sign of life; only the newest is written."""
        self._beat = (process, status)

    def later_key(self, press: str, channels: Sequence[Channel], press_file: str) -> PressKey:
        """Return a key to record with before the store can give one; the store's is found when it is due."""
        return session_key(self._notes, press, channels, press_file)

    @property
    def waiting(self) -> int:
        """How many items are not written yet."""
        return len(self._waiting) + self._queue.qsize() + (len(self._buffer) if self._buffer else 0)

    @property
    def behind(self) -> bool:
        """Whether the buffer holds what must be written before anything new."""
        return self._buffer is not None and len(self._buffer) > 0

    @property
    def capacity(self) -> str:
        """Where scans wait while the store is away, and how long there is room."""
        if self._buffer is None or self._buffer_trouble:
            return f"memory, enough for {self.hours_left:.1f} h"
        return f"{self._buffer.path}, enough for {self.hours_left:.0f} h"

    @property
    def hours_left(self) -> float:
        """How long scans can wait from now on, at the pace of all presses. [h]"""
        if self._buffer is not None and not self._buffer_trouble:
            return self._buffer.hours_left(self._per_second)
        return max(0, _MOST_WAITING - self.waiting) / self._per_second / 3600.0

    def expect(self, channels: Sequence[Channel]) -> None:
        """Reckon with scans of so many channels before the first one waits."""
        if self._buffer is not None:
            self._buffer.expect(len(encode(_example(channels))))

    def close(self, longest_s: float = 10.0) -> None:
        """Write what is left, or give up after `longest_s`."""
        self._closed = True
        self._queue.put(None)
        self._thread.join(longest_s)

    def _work(self) -> None:
        ended = False
        while not ended:
            ended = self._fetch()
            if not ended and self.trouble and time.monotonic() < self._retry_at:
                self._keep()
            elif self._waiting or self._beat or self.behind:
                self._deliver()
            if self.trouble and not ended and self._closed:
                ended = self._queue.empty()

    def _fetch(self) -> bool:
        """Wait for something to be put and move it to the waiting list; True at the end."""
        try:
            first = self._queue.get(timeout=0.25)
        except queue.Empty:
            return False
        if self._gather_s and first is not None and not self._closed:
            time.sleep(self._gather_s)
        return first is None or self._take(first)

    def _take(self, first: Parcel | Entry | None = None) -> bool:
        """Move all that was put to the waiting list; True at the end."""
        if first is not None:
            self._waiting.append(first)
        with suppress(queue.Empty):
            while (item := self._queue.get_nowait()) is not None:
                self._waiting.append(item)
            return True
        if len(self._waiting) > _MOST_WAITING:
            surplus = len(self._waiting) - _MOST_WAITING
            del self._waiting[:surplus]
            self.lost += surplus
        return False

    def _deliver(self) -> None:
        try:
            self._drain()
            while self._waiting:
                batch = self._waiting[:_BATCH]
                self._write(batch)
                del self._waiting[: len(batch)]
                self._acknowledge(batch)
                self._show()
        except Exception as error:  # noqa: BLE001 - the thread must outlive whatever the engine raises
            self._refused(error)
        else:
            self._retry_s = _FIRST_RETRY_S
            if self.trouble:
                self.trouble = ""
                self._say("info", f"store {self._store.label} takes data again; everything kept is written")
        if not self.trouble:
            self._show()

    def _show(self) -> None:
        """Write the newest sign of life, also among much that waits: who is busy must not be taken for dead."""
        if self._beat is not None:
            beat, self._beat = self._beat, None
            with suppress(StoreUnavailable):
                self._store.beat(*beat)

    def _refused(self, error: Exception) -> None:
        reason = str(error)
        if not isinstance(error, StoreUnavailable):
            reason = f"{type(error).__name__}: {error}"
        if not self.trouble:
            self._say("alarm", f"{reason}; scans wait in {self.capacity}")
        self.trouble = reason
        self._retry_at = time.monotonic() + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, _LONGEST_RETRY_S)
        self._keep()

    def _write(self, batch: Sequence[Parcel | Entry]) -> None:
        ready: list[Parcel] = []
        for parcel in (item for item in batch if isinstance(item, Parcel)):
            if self._admission.waits_for_place(parcel):
                self._store.write_parcels(ready)
                ready = []
                for run in self._admission.place(parcel.key).interrupted:
                    said = f"run {run} was interrupted; its data are kept"
                    self._store.log("warning", "record", said, parcel.key.name)
            ready.append(self._admission.moved(parcel))
        self._store.write_parcels(ready)
        for entry in (item for item in batch if isinstance(item, Entry)):
            at = known_utc(entry.unix_s)
            self._store.log(entry.level, entry.process, entry.message, entry.press, entry.detail, at)

    def _acknowledge(self, batch: Sequence[Parcel | Entry]) -> None:
        for parcel in batch:
            if isinstance(parcel, Parcel):
                self.written += len(parcel.scans)
                self._acknowledged(parcel)

    def _keep(self) -> None:
        """Move what waits from memory to the buffer."""
        if self._buffer is None or not self._waiting:
            return
        try:
            self._buffer.append(self._waiting)
        except sqlite3.Error as error:
            if not self._buffer_trouble:
                self._buffer_trouble = f"buffer {self._buffer.path}: {error}"
                self._say(
                    "alarm", f"{self._buffer_trouble}; free space on its disk; scans wait in {self.capacity}"
                )
            return
        self._buffer_trouble = ""
        kept, self._waiting = self._waiting, []
        self._acknowledge(kept)

    def _drain(self) -> None:
        """Write the buffer's content; what is put meanwhile goes behind it, durably."""
        while self._buffer is not None and (rows := self._buffer.oldest(_BATCH)):
            self._write([item for _, item in rows])
            self._buffer.remove(rows[-1][0])
            self._show()
            if self._take():
                self._queue.put(None)
            self._keep()


def _example(channels: Sequence[Channel]) -> Parcel:
    """Return a parcel as large as they come."""
    key = PressKey(1, "press-name", 1, tuple(channels), 10**8)
    now = known_utc(time.time())
    scan = Scan(10**8, now, 1e6 / 7.0, (1e3 / 7.0,) * len(channels), (Quality.GOOD,) * len(channels))
    return Parcel(key, (scan,))
