"""A local file that keeps parcels while the store is away, durably and in order."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from daq.records import InputError
from daq.store.parcels import Entry, Parcel, decode, encode

_OVERHEAD = 1.3
"""A file and its journal take so many bytes for a byte of content."""
_TABLES = """
CREATE TABLE IF NOT EXISTS parcel (number INTEGER PRIMARY KEY, content TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS session (session INTEGER PRIMARY KEY, content TEXT NOT NULL);
"""


class Buffer:
    """Parcels and journal lines on the local disk, oldest first.

    Raises
    ------
    InputError
        Where the file cannot be made or is none of ours.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._bytes = 700.0
        try:
            with closing(self._open()) as connection:
                connection.executescript(_TABLES)
                self._count = int(connection.execute("SELECT count(*) FROM parcel").fetchone()[0])
        except sqlite3.Error as error:
            raise InputError(
                f"buffer {path}: {error}; check its folder, or give another file as buffer of [store]"
            ) from error
        self.sessions: MutableMapping[int, dict[str, Any]] = _Sessions(self)

    def __len__(self) -> int:
        return self._count

    def _open(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, isolation_level=None, timeout=5.0)
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
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
        self.expect(max(len(t) for (t,) in texts))

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

    def expect(self, parcel_bytes: int) -> None:
        """Reckon with parcels of this size from now on."""
        self._bytes = max(self._bytes, float(parcel_bytes))

    def hours_left(self, per_second: float) -> float:
        """Return how long the disk takes scans at this rate. [h]"""
        return shutil.disk_usage(self.path.parent).free / (_OVERHEAD * self._bytes * per_second) / 3600.0

    def note(self, session: int, content: dict[str, Any] | None) -> None:
        """Keep what is known of a session; None forgets it."""
        with closing(self._open()) as connection:
            if content is None:
                connection.execute("DELETE FROM session WHERE session = ?", (session,))
            else:
                row = (session, json.dumps(content))
                connection.execute("INSERT OR REPLACE INTO session VALUES (?, ?)", row)

    def notes(self) -> dict[int, dict[str, Any]]:
        """Return what is known of all sessions."""
        with closing(self._open()) as connection:
            return {key: json.loads(content) for key, content in connection.execute("SELECT * FROM session")}


class _Sessions(MutableMapping[int, dict[str, Any]]):
    """The sessions of a buffer: read once, written through. Those with nothing left are forgotten at the start."""

    def __init__(self, buffer: Buffer) -> None:
        self._buffer = buffer
        if not len(buffer):
            for session in buffer.notes():
                buffer.note(session, None)
        self._known = buffer.notes()

    def __getitem__(self, session: int) -> dict[str, Any]:
        return self._known[session]

    def __setitem__(self, session: int, content: dict[str, Any]) -> None:
        self._buffer.note(session, content)
        self._known[session] = content

    def __delitem__(self, session: int) -> None:
        self._buffer.note(session, None)
        del self._known[session]

    def __iter__(self) -> Iterator[int]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)
