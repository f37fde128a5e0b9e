"""An SQLite file or its log deleted, moved or exchanged under a running recorder: all goes into a sound file.

Whoever has the file open still reaches all of it, whatever became of its name. So a connection that never closes
holds on to it, and its content is copied to where the store belongs. What goes on under the old connections would
be written to a file nobody finds (2026-11-22: 116 acknowledged scans). The same holds of the log beside it, which
has the newest commits, and of the log's index: deleted alone, or left behind where a link stands in for the moved
file, whoever opens the store sees none of them (2026-11-24: 687 acknowledged scans). What a log held that was
emptied in its place is nowhere any more: the file is copied without it, and who wrote last writes that again.

After a rescue the held connection stays open for the life of the process: the last connection to leave a file in
WAL mode deletes ``-wal`` and ``-shm`` by name, and these names belong to the new file by then. Whoever closes a
store whose file is still in its place closes it too (`Database.close`).
"""

from __future__ import annotations

import ctypes
import os
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path

Identity = tuple[str, int, int]
_PAGES_AT_ONCE, _STEPS_AT_ONCE = 10_000, 10_000_000
"""Copied, and checked, between two signs of life: less than a second each. Set by hand, 2026-11."""
_PASSING = {
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_PROTOCOL,
    sqlite3.SQLITE_READONLY,
}
"""Errors that pass by themselves or by a person's doing, the file is sound: on a full disk SQLite has several."""
_UNREADABLE = {
    sqlite3.SQLITE_IOERR_CORRUPTFS,
    sqlite3.SQLITE_IOERR_DATA,
    sqlite3.SQLITE_IOERR_READ,
    sqlite3.SQLITE_IOERR_SHORT_READ,
}
"""Errors among them that do not."""
_BEGINS = (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83")
"""What a log begins with. https://www.sqlite.org/fileformat2.html#walformat"""
_LOG_HEADER, _PAGE_HEADER = 32, 24
"""Bytes before the log's first page, and before each. Same source."""
_PRESSES = "SELECT count(*) FROM press"
LOGS = ("-wal", "-shm")
"""What SQLite keeps beside a file, by that file's own name: the newest commits, and where they stand in there."""


def code_of(error: sqlite3.Error) -> int:
    """Return SQLite's number of an error; one without a number is about what stands in the file."""
    return int(getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT))


def passes(error: sqlite3.Error) -> bool:
    """Whether an error leaves a file that can be opened sound."""
    return code_of(error) & 0xFF in _PASSING and code_of(error) not in _UNREADABLE


def _says_nothing(error: sqlite3.Error) -> bool:
    """Whether an error came before the file was looked into."""
    return passes(error) or code_of(error) & 0xFF == sqlite3.SQLITE_CANTOPEN


def files_of(path: Path) -> list[Path]:
    """Return a file and what SQLite may keep beside it."""
    return [path, *(Path(f"{path}{ending}") for ending in LOGS)]


def remove_trial(path: Path) -> None:
    """Remove a file that was made for a while, and what SQLite keeps beside it; what cannot be removed stays."""
    for one in files_of(path):
        with suppress(OSError):
            one.unlink(missing_ok=True)


def identity_of(path: Path) -> Identity | None:
    """Return which file a name stands for, and by which path; None where there is none, or an empty one."""
    try:
        found = path.stat()
    except OSError:
        return None
    return (os.path.realpath(path), found.st_dev, found.st_ino) if found.st_size else None


def logs_of(path: Path) -> tuple[tuple[int, int] | None, ...]:
    """Return which files hold the log of an SQLite file and its index; they stay while somebody has it open."""
    return tuple(_number_of(f"{os.path.realpath(path)}{ending}") for ending in LOGS)


def log_cut(path: Path, size_before: int) -> tuple[bool, int]:
    """Return whether a log that was seen so long was emptied or cut short in its place, and how long it is now.

    A log only grows, but for a checkpoint that empties it; its index lists no page after that. [bytes] A log that
    is not there counts as whole.
    """
    try:
        with Path(f"{os.path.realpath(path)}{LOGS[0]}").open("rb") as log:
            begins, size = log.read(len(_BEGINS[0])), log.seek(0, os.SEEK_END)
    except OSError:
        return False, size_before
    if begins and begins not in _BEGINS:  # somebody has written behind the hole
        return True, size_before
    if size >= size_before:
        return False, size
    try:
        with closing(sqlite3.connect(path)) as connection:
            pages = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()[1]
            page_size = connection.execute("PRAGMA page_size").fetchone()[0]
    except sqlite3.Error as error:
        return not _says_nothing(error), size_before
    cut = pages > 0 and size < _LOG_HEADER + pages * (_PAGE_HEADER + page_size)
    return cut, size_before if cut else size


def _number_of(file: str) -> tuple[int, int] | None:
    try:
        found = Path(file).stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


class HeldFile:
    """An SQLite file kept reachable whatever becomes of its name, with what shows that it, or its log, is another.

    `settle` counts in the file's user version, which never goes back: SQLite's own count of changes stands still
    while one connection alone writes into a log. It is read by SQLite, past the log: whoever closes a descriptor
    of his own on the file ends all locks that the process has on it, those of other connections too.
    https://www.sqlite.org/howtocorrupt.html (2.2)
    """

    def __init__(self, path: Path) -> None:
        self.connection = _hold(path)
        self.logs = logs_of(path)
        self._path, self._count = path, 0

    def settle(self) -> bool:
        """Bring the log into the file, and count; return whether all is there: a reader may be in the way."""
        (count,) = self.connection.execute("PRAGMA user_version").fetchone()
        self.connection.execute(f"PRAGMA user_version = {count + 1}")
        busy, listed, settled = self.connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        return not busy and listed == settled

    def went_back(self) -> bool:
        """Whether an older state lies in the file's place."""
        before = self._count  # asked before the file: another thread may see a later count
        try:
            with closing(_without_log(self._path)) as connection:
                (now,) = connection.execute("PRAGMA user_version").fetchone()
        except sqlite3.Error:
            return False
        self._count = max(before, now)
        return bool(now < before)

    def close(self) -> None:
        """Let go, once this process works with the file no more."""
        self.connection.close()


def _without_log(path: Path) -> sqlite3.Connection:
    """Open a file as its last checkpoint left it; none is made where there is none."""
    as_it_is = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    return sqlite3.connect(as_it_is, uri=True, isolation_level=None)


def _hold(path: Path) -> sqlite3.Connection:
    """Return a connection that keeps a file reachable; the interpreter's end does not close it."""
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.Error:
        connection.close()  # else it keeps the file busy for as long as somebody keeps the error
        raise
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(connection))
    return connection


def rescue(
    held: sqlite3.Connection, path: Path, alive: Callable[[], None] = lambda: None, *, without_log: bool = False
) -> Path | None:
    """Copy all a held connection reaches to `path`; returns where another store found there was put aside.

    `alive` is called now and then: a large store takes minutes. `without_log`: the file alone is copied, as its
    last checkpoint left it. Raises `sqlite3.Error` or `OSError` where the disk does not take it or what can be
    reached is no sound store; nothing is changed then.
    """
    source = held
    if without_log:
        source = _without_log(path)
    else:
        with suppress(sqlite3.Error):
            held.execute("PRAGMA wal_checkpoint(TRUNCATE)")  # a file that was moved is whole without its log
    part = path.with_name(f".{path.name}.rescued")
    part.unlink(missing_ok=True)
    with closing(sqlite3.connect(part)) as copy:
        _copy(source, copy, alive)
    if without_log:
        source.close()
    with part.open("rb") as file:
        os.fsync(file.fileno())
    aside = None
    if path.exists() and _holds_presses(path):
        aside = path.with_name(f"{path.name}.found-{datetime.now(UTC):%Y%m%dT%H%M%S}")
        path.rename(aside)
    for ending in LOGS:
        Path(f"{path}{ending}").unlink(missing_ok=True)
    part.replace(path)
    return aside


def _copy(held: sqlite3.Connection, copy: sqlite3.Connection, alive: Callable[[], None]) -> None:
    held.execute("BEGIN")  # one state: else a commit of another process begins the copy anew
    try:
        held.execute("SELECT count(*) FROM sqlite_master").fetchone()
        held.backup(copy, pages=_PAGES_AT_ONCE, progress=lambda *_: alive())
    finally:
        held.execute("ROLLBACK")
    copy.execute("PRAGMA journal_mode=DELETE")
    copy.set_progress_handler(alive, _STEPS_AT_ONCE)  # returns None, which lets it go on
    if (found := copy.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
        raise sqlite3.DatabaseError(found)
    copy.execute(_PRESSES)  # what an emptied file leaves is sound, and nothing


def is_exchanged(held: sqlite3.Connection, path: Path) -> bool:
    """Whether a held connection reaches no store any more, and a sound one lies at its path: a backup, say."""
    try:
        held.execute(_PRESSES)
    except sqlite3.Error as error:
        if passes(error):
            return False
    else:
        return False
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
            return bool(connection.execute(_PRESSES).fetchone()[0]) and not damage_of(path)
    except sqlite3.Error:
        return False


def _holds_presses(path: Path) -> bool:
    """Whether a file is more than the empty one that opening a missing store leaves."""
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as connection:
            return bool(connection.execute(_PRESSES).fetchone()[0])
    except sqlite3.Error:
        return path.stat().st_size > 0


def damage_of(path: Path) -> str:
    """Return what is wrong with the pages of an SQLite file; nothing where they are sound or cannot be read now.

    A wrong bit within a value that leaves the pages sound is not seen: SQLite keeps no sums.
    """
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
            found = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    except sqlite3.DatabaseError as error:
        return "" if _says_nothing(error) else str(error)
    return "" if found == "ok" else found.replace("\n", " ")
