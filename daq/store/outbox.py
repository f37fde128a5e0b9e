"""From the recorder into the store: in order, durably, while the store may be away.

The recorder only ever puts; a thread of its own writes. One transaction takes what has gathered. While
the store refuses (locked, full, server away), what is put waits: in a local buffer file where one is
given (durable: it counts as acknowledged), else in memory. Afterwards everything is written in the order
it was put; what a lost acknowledgement may have written already is not written twice.
"""

from __future__ import annotations

import queue
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from daq.store.parcels import Entry, Parcel, decode, encode
from daq.store.records import StoreUnavailable
from daq.store.store import Store

_RETRY_S = 1.0
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
        gather_s: float = 0.0,
        acknowledged: Callable[[Parcel], None] | None = None,
        say: Callable[[str, str], None] | None = None,
    ) -> None:
        self.trouble = ""
        """Why the store refuses now; empty while it does not."""
        self.lost = 0
        self.written = 0
        self._store = store
        self._buffer = None if buffer is None else Buffer(buffer)
        self._gather_s = gather_s
        self._acknowledged = acknowledged or (lambda parcel: None)
        self._say = say or (lambda level, sentence: None)
        self._queue: queue.Queue[Parcel | Entry | None] = queue.Queue()
        self._beat: tuple[str, Mapping[str, Any]] | None = None
        self._waiting: list[Parcel | Entry] = []
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

    @property
    def waiting(self) -> int:
        """How many items are not written yet."""
        return len(self._waiting) + self._queue.qsize() + (len(self._buffer) if self._buffer else 0)

    def close(self, longest_s: float = 10.0) -> None:
        """Write what is left, or give up after `longest_s`."""
        self._closed = True
        self._queue.put(None)
        self._thread.join(longest_s)

    def _work(self) -> None:
        ended = False
        while not ended:
            ended = self._fetch()
            if self._waiting or self._beat or (self._buffer is not None and len(self._buffer)):
                self._deliver()
            if self.trouble and not ended and self._closed:
                ended = self._queue.empty()

    def _fetch(self) -> bool:
        """Move what was put to the waiting list; True at the end."""
        try:
            item = self._queue.get(timeout=_RETRY_S if self.trouble else 0.25)
        except queue.Empty:
            return False
        if self._gather_s and item is not None and not self._closed:
            time.sleep(self._gather_s)
        while True:
            if item is None:
                return True
            self._waiting.append(item)
            try:
                item = self._queue.get_nowait()
            except queue.Empty:
                break
        if len(self._waiting) > _MOST_WAITING:
            surplus = len(self._waiting) - _MOST_WAITING
            del self._waiting[:surplus]
            self.lost += surplus
        return False

    def _deliver(self) -> None:
        try:
            if self._buffer is not None:
                self._drain(self._buffer)
            while self._waiting:
                batch = self._waiting[:_BATCH]
                self._write(batch)
                del self._waiting[: len(batch)]
                self._acknowledge(batch)
        except Exception as error:  # noqa: BLE001 - the thread must outlive whatever the engine raises
            self._refused(error)
        else:
            if self.trouble:
                self.trouble = ""
                self._say("info", f"store {self._store.label} takes data again; everything kept is written")
        if self._beat is not None:
            beat, self._beat = self._beat, None
            with suppress(StoreUnavailable):
                self._store.beat(*beat)

    def _refused(self, error: Exception) -> None:
        reason = str(error) if isinstance(error, StoreUnavailable) else f"{type(error).__name__}: {error}"
        if not self.trouble:
            self._say("alarm", f"{reason}; {self._meanwhile}")
        self.trouble = reason
        if self._buffer is not None and self._waiting:
            self._keep(self._buffer)

    @property
    def _meanwhile(self) -> str:
        if self._buffer is None:
            return "scans wait in memory"
        return f"scans go to {self._buffer.path}, enough for {self._buffer.hours_left():.0f} h"

    def _write(self, batch: Sequence[Parcel | Entry]) -> None:
        self._store.write_parcels([p for p in batch if isinstance(p, Parcel)])
        for entry in batch:
            if isinstance(entry, Entry):
                self._store.log(entry.level, entry.process, entry.message, entry.press, entry.detail)

    def _acknowledge(self, batch: Sequence[Parcel | Entry]) -> None:
        for parcel in batch:
            if isinstance(parcel, Parcel):
                self.written += len(parcel.scans)
                self._acknowledged(parcel)

    def _keep(self, buffer: Buffer) -> None:
        try:
            buffer.append(self._waiting)
        except sqlite3.Error as error:
            self._say("alarm", f"buffer {buffer.path}: {error}; scans wait in memory")
            return
        kept, self._waiting = self._waiting, []
        self._acknowledge(kept)

    def _drain(self, buffer: Buffer) -> None:
        while rows := buffer.oldest(_BATCH):
            self._write([item for _, item in rows])
            buffer.remove(rows[-1][0])


class Buffer:
    """A local file that keeps parcels while the store is away."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._count = 0
        self._bytes = 400.0
        with closing(self._open()) as connection:
            self._count = connection.execute("SELECT count(*) FROM parcel").fetchone()[0]

    def __len__(self) -> int:
        return self._count

    def _open(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, isolation_level=None, timeout=5.0)
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("CREATE TABLE IF NOT EXISTS parcel (number INTEGER PRIMARY KEY, content TEXT NOT NULL)")
        return connection

    def append(self, items: Sequence[Parcel | Entry]) -> None:
        """Keep items durably, all or none."""
        texts = [(encode(item),) for item in items]
        with closing(self._open()) as connection:
            connection.execute("BEGIN IMMEDIATE")
            try:
                connection.executemany("INSERT INTO parcel (content) VALUES (?)", texts)
                connection.execute("COMMIT")
            except sqlite3.Error:
                with suppress(sqlite3.Error):
                    connection.execute("ROLLBACK")
                raise
        self._count += len(texts)
        self._bytes = sum(len(t) for (t,) in texts) / len(texts)

    def oldest(self, limit: int) -> list[tuple[int, Parcel | Entry]]:
        """Return the first items with their row numbers."""
        if not self._count:
            return []
        with closing(self._open()) as connection:
            rows = connection.execute("SELECT number, content FROM parcel ORDER BY number LIMIT ?", (limit,))
            return [(number, decode(content)) for number, content in rows]

    def remove(self, last: int) -> None:
        """Forget everything up to a row."""
        with closing(self._open()) as connection:
            self._count -= connection.execute("DELETE FROM parcel WHERE number <= ?", (last,)).rowcount

    def hours_left(self, per_second: float = 10.0) -> float:
        """Return how long the disk takes scans at this rate. [h]"""
        return shutil.disk_usage(self.path.parent).free / (1.3 * self._bytes * per_second) / 3600.0
