"""A local file that keeps write batches while the store is away, durably and in order.

A file that turns out to be damaged or gone is set aside under another name, what can be read of it goes on in a
fresh one, and an alarm says so: the buffer is a help, and must never stop recording to a store that is well.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from daq.store.buffer_file import Row, open_file, opened, sealed
from daq.store.buffer_salvage import salvaged
from daq.store.file_rescue import code_of, files_of, passes
from daq.store.records import StoreUnavailable
from daq.store.write_batch import Entry, WriteBatch, decode_item, encode_item
from daq.tables import reason_of
from daq.words import Message, say, spoken

Result = TypeVar("Result")
_OVERHEAD = 1.3
"""A file and its journal take so many bytes for a byte of content, as measured with 10,000 scans (2026-11)."""

# Numbers without another source were set by hand, 2026-11.

_TYPICAL_BYTES = 700.0
"""What a write batch of some 16 channels takes as JSON, until a larger one is seen."""
_OLDEST = "SELECT number, content FROM parcel WHERE number > ? ORDER BY number LIMIT ?"


class Buffer:
    """Write batches and journal lines on the local disk, oldest first.

    `alarm` is called with what happened to a damaged file, and with why one cannot be used now, a full disk say:
    it is tried again with every use, and what may wait in it is the oldest there is all the same. `alive` is
    called now and then while a damaged file is read: a large one takes minutes.
    """

    def __init__(
        self,
        path: Path,
        alarm: Callable[[Message], None] = lambda message: None,
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        self.path = path
        self._alarm, self._alive = alarm, alive
        self._bytes = _TYPICAL_BYTES
        self._count = self._handled = 0
        self._counted = False  # nobody knows how much is in it: unusable, or damaged before its first count
        self._known: dict[int, dict[str, Any]] = {}
        self._unkept: set[int] = set()
        """Sessions whose notes the file does not have yet."""
        self._offered: dict[int, str] = {}
        """Rows that were read to be written to the store: whatever becomes of the file, they are not lost."""
        self._unreadable: set[int] = set()
        """Rows that were set aside and reported, while they stand in the file."""
        self._held: set[int] = set()
        """Sessions of items that were in the file: a later process finds again what cannot be removed."""
        self.sessions: MutableMapping[int, dict[str, Any]] = _Sessions(self)
        try:
            self._first_count()
        except (sqlite3.Error, OSError) as error:
            self._counted = _holds_nothing(path)
            alarm(say("buffer-unusable", file=str(path), error=reason_of(error)))

    def __len__(self) -> int:
        """How many items wait, as far as is known: one at least in a file that could not be read yet."""
        return self._count if self._counted else max(self._count, 1)

    def _first_count(self) -> None:
        if not self._counted:
            self._count = self._do(_count)
            self._counted = True
            if self._count:
                self._known.update({**self._do(lambda c: dict(_notes(c))), **self._known})
            else:
                with suppress(sqlite3.Error):  # of sessions with nothing left: no harm, and the disk may be full
                    self._do(_forget_notes)

    def append(self, items: Sequence[WriteBatch | Entry]) -> None:
        """Keep items durably, all or none."""
        self._first_count()
        texts = [sealed(encode_item(item)) for item in items]

        def insert(connection: sqlite3.Connection) -> None:
            connection.execute("BEGIN IMMEDIATE")
            try:
                newest = connection.execute("SELECT max(number) FROM parcel").fetchone()[0] or 0
                rows = enumerate(texts, max(newest, self._handled) + 1)  # numbers never come twice
                connection.executemany("INSERT INTO parcel VALUES (?, ?)", rows)
                for session in self._unkept:
                    _note(connection, session, self._known.get(session))
                connection.execute("COMMIT")
            except sqlite3.Error:
                with suppress(sqlite3.Error):
                    connection.execute("ROLLBACK")
                raise

        self._do(insert)
        self._unkept.clear()
        self._held |= _sessions_of(items)
        self._count += len(texts)
        self.expect(max(len(text) for text in texts))

    def oldest(self, limit: int) -> list[tuple[int, WriteBatch | Entry]]:
        """Return the first items with their row numbers; what cannot be read is set aside and reported once."""
        self._first_count()
        while self._count:
            rows: list[Row] = self._do(lambda c: c.execute(_OLDEST, (self._handled, limit)).fetchall())
            self._offered = dict(rows)
            if not rows:
                if self._count:
                    self._alarm(say("buffer-emptied", file=str(self.path), count=self._count))
                self._count = 0
                return []
            if read := self._items(rows):
                self._held |= _sessions_of([item for _, item in read])
                return read
            self.remove(rows[-1][0])
        return []

    def remove(self, last: int) -> None:
        """Forget everything up to a row, for this process also where the disk takes no more changes."""
        self._handled = last
        before, self._offered = self._offered, {n: text for n, text in self._offered.items() if n > last}
        self._count -= len(before) - len(self._offered)
        self._unreadable = {n for n in self._unreadable if n > last}
        with suppress(sqlite3.Error, OSError):
            self._do(lambda c: c.execute("DELETE FROM parcel WHERE number <= ?", (last,)).rowcount)

    def expect(self, batch_bytes: int) -> None:
        """Reckon with write batches of this size from now on."""
        self._bytes = max(self._bytes, float(batch_bytes))

    def hours_left(self, per_second: float) -> float:
        """Return how long the disk takes scans at this rate, 0 where its folder is gone. [h]"""
        return hours_of_room(self.path.parent, per_second, self._bytes)

    def note(self, session: int, content: dict[str, Any] | None) -> None:
        """Keep what is known of a session; None forgets it.

        Where the disk has no room, memory keeps it; that raises where a later process may need it.
        """
        try:
            self._do(lambda c: _note(c, session, content))
        except (sqlite3.Error, OSError) as error:
            if session in self._held:
                raise StoreUnavailable(self.refusal(error)) from error
            self._unkept.add(session)
        else:
            self._unkept.discard(session)
        if content is None:
            self._known.pop(session, None)
        else:
            self._known[session] = content

    def refusal(self, error: Exception) -> Message:
        """Return in words why the file takes nothing."""
        return say("buffer-refuses", file=str(self.path), error=reason_of(error))

    def notes(self) -> Mapping[int, dict[str, Any]]:
        """Return what is known of all sessions."""
        return self._known

    def set_aside(self, text: str, why: str) -> Path:
        """Keep what the store does not take, or what cannot be read, as a line of a file beside the buffer."""
        return set_aside(self.path, text, why)

    def _items(self, rows: Sequence[Row]) -> list[tuple[int, WriteBatch | Entry]]:
        """Return what rows hold; those that cannot be read are set aside, and reported together."""
        items: list[tuple[int, WriteBatch | Entry]] = []
        faults: list[tuple[Path, Message]] = []
        try:
            for number, text in rows:
                try:
                    items.append((number, decode_item(opened(text))))
                except (ValueError, KeyError, TypeError, IndexError) as unread:
                    if number not in self._unreadable:
                        faults.append((self.set_aside(str(text), str(unread)), spoken(unread)))
                        self._unreadable.add(number)
        finally:
            if faults:
                aside, error = faults[0]
                files = {"file": str(self.path), "aside": str(aside)}
                self._alarm(say("buffer-rows-unreadable", count=len(faults), error=error, **files))
        return items

    def _do(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Work with the file; a damaged one is replaced first."""
        try:
            with closing(open_file(self.path)) as connection:
                return work(connection)
        except sqlite3.Error as error:
            if _passes(error, self.path):
                raise
            self._renew(error)
        with closing(open_file(self.path)) as connection:
            return work(connection)

    def _renew(self, error: sqlite3.Error) -> None:
        """Set the file aside and go on with what can be read of it, once a fresh one holds that."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        read, notes = salvaged(self.path, self._alive) if self.path.exists() else ({}, {})
        found = {number: text for number, text in read.items() if number > self._handled}
        rows = sorted({**found, **self._offered}.items())
        fresh = self.path.with_name(f"{self.path.name}.fresh")
        _remove(fresh)
        try:
            with closing(open_file(fresh)) as connection:
                connection.execute("BEGIN IMMEDIATE")
                for row in rows:
                    connection.execute("INSERT INTO parcel VALUES (?, ?)", row)
                    self._alive()
                for session, content in {**notes, **self._known}.items():
                    _note(connection, session, content)
                connection.execute("COMMIT")
        except sqlite3.Error:
            _remove(fresh)
            raise
        aside = _moved_aside(self.path)
        fresh.rename(self.path)
        self._known.update({**notes, **self._known})
        gaps = rows[-1][0] - rows[0][0] + 1 - len(rows) if rows else 0
        lost = max(self._count - len(rows), 0) if self._counted else gaps
        self._count = len(rows)
        if aside.exists():
            files = {"file": str(self.path), "aside": str(aside), "error": reason_of(error)}
            code = "buffer-damaged" if self._counted else "buffer-damaged-uncounted"
            self._alarm(say(code, kept=len(rows), lost=lost, **files))
        else:
            self._alarm(say("buffer-gone", file=str(self.path), error=reason_of(error), lost=lost))


def hours_of_room(folder: Path, per_second: float, batch_bytes: float = _TYPICAL_BYTES) -> float:
    """Return how long the disk of a folder takes scans at this rate, 0 where the folder is gone. [h]"""
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return 0.0
    return free / (_OVERHEAD * batch_bytes * per_second) / 3600.0


def set_aside(beside: Path, text: str, why: str) -> Path:
    """Append a text to the file of what was set aside, durably; returns that file."""
    path = beside.with_name(f"{beside.name}.set-aside.jsonl")
    line = json.dumps({"utc": datetime.now(UTC).isoformat(), "why": why, "content": text})
    with path.open("a", encoding="utf-8") as file:
        file.write(line + "\n")
        file.flush()
        os.fsync(file.fileno())
    return path


def _sessions_of(items: Sequence[WriteBatch | Entry]) -> set[int]:
    return {item.key.press_id for item in items if isinstance(item, WriteBatch)}


def _holds_nothing(path: Path) -> bool:
    """Whether a file that no connection can be made to holds no items for certain: read as it lies there."""
    try:
        if any(one.is_file() and one.stat().st_size for one in files_of(path)[1:]):
            return False
        if not path.is_file() or not path.stat().st_size:
            return True
        as_it_is = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(as_it_is, uri=True)) as connection:
            return _count(connection) == 0
    except (sqlite3.Error, OSError):
        return False


def _count(connection: sqlite3.Connection) -> int:
    return int(connection.execute("SELECT count(*) FROM parcel").fetchone()[0])


def _note(connection: sqlite3.Connection, session: int, content: dict[str, Any] | None) -> None:
    if content is None:
        connection.execute("DELETE FROM session WHERE session = ?", (session,))
    else:
        text = sealed(json.dumps(content))
        connection.execute("INSERT OR REPLACE INTO session VALUES (?, ?)", (session, text))


def _notes(connection: sqlite3.Connection) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield what is known of each session; a session whose note cannot be read begins anew."""
    for session, content in connection.execute("SELECT session, content FROM session"):
        with suppress(ValueError):
            yield session, json.loads(opened(content))


def _forget_notes(connection: sqlite3.Connection) -> dict[int, dict[str, Any]]:
    """Sessions with nothing left are forgotten at the start."""
    connection.execute("DELETE FROM session")
    return {}


def _passes(error: sqlite3.Error, path: Path) -> bool:
    """Whether a file is sound in spite of an error."""
    if code_of(error) == sqlite3.SQLITE_CANTOPEN and path.is_file():  # its log cannot be made: no room
        return os.access(path, os.R_OK | os.W_OK)
    return passes(error)


def _remove(path: Path) -> None:
    for one in files_of(path):
        one.unlink(missing_ok=True)


def _moved_aside(path: Path) -> Path:
    stamp = f"{datetime.now(UTC):%Y%m%dT%H%M%S}"
    tried = (path.with_name(f"{path.name}.damaged-{stamp}{f'-{n}' if n else ''}") for n in range(1000))
    aside = next(one for one in tried if not one.exists())
    for ending in ("", "-wal"):
        with suppress(FileNotFoundError):
            Path(f"{path}{ending}").rename(f"{aside}{ending}")
    with suppress(FileNotFoundError):
        Path(f"{path}-shm").unlink()
    return aside


class _Sessions(MutableMapping[int, dict[str, Any]]):
    """The sessions of a buffer, written through."""

    def __init__(self, buffer: Buffer) -> None:
        self._buffer = buffer

    def __getitem__(self, session: int) -> dict[str, Any]:
        return self._buffer.notes()[session]

    def __setitem__(self, session: int, content: dict[str, Any]) -> None:
        self._buffer.note(session, content)

    def __delitem__(self, session: int) -> None:
        self._buffer.note(session, None)

    def __iter__(self) -> Iterator[int]:
        return iter(self._buffer.notes())

    def __len__(self) -> int:
        return len(self._buffer.notes())
