"""An SQLite file deleted, moved or exchanged under a running recorder: all of it goes into a sound file.

Whoever has the file open still reaches all of it, whatever became of its name. So a connection that never closes
holds on to it, and its content is copied to where the store belongs. What goes on under the old connections would
be written to a file nobody finds (2026-11-22: 116 acknowledged scans).

After a rescue the held connection stays open for the life of the process: the last connection to leave a file in
WAL mode deletes ``-wal`` and ``-shm`` by name, and these names belong to the new file by then. Whoever closes a
store whose file is still in its place closes it too (`Database.close`).
"""

from __future__ import annotations

import ctypes
import os
import sqlite3
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path

Identity = tuple[int, int]


def identity_of(path: Path) -> Identity | None:
    """Return which file a name stands for; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def hold(path: Path) -> sqlite3.Connection:
    """Return a connection that keeps a file reachable; the interpreter's end does not close it."""
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.Error:
        connection.close()  # else it keeps the file busy for as long as somebody keeps the error
        raise
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(connection))
    return connection


def rescue(held: sqlite3.Connection, path: Path) -> Path | None:
    """Copy all a held connection reaches to `path`; returns where another store found there was put aside.

    Raises `sqlite3.Error` or `OSError` where the disk does not take it; nothing is changed then.
    """
    with suppress(sqlite3.Error):
        held.execute("PRAGMA wal_checkpoint(TRUNCATE)")  # a file that was moved is whole without its log
    part = path.with_name(f".{path.name}.rescued")
    part.unlink(missing_ok=True)
    with closing(sqlite3.connect(part)) as copy:
        held.backup(copy)
        copy.execute("PRAGMA journal_mode=DELETE")
    with part.open("rb") as file:
        os.fsync(file.fileno())
    aside = None
    if path.exists() and _holds_presses(path):
        aside = path.with_name(f"{path.name}.found-{datetime.now(UTC):%Y%m%dT%H%M%S}")
        path.rename(aside)
    for ending in ("-wal", "-shm"):
        Path(f"{path}{ending}").unlink(missing_ok=True)
    part.replace(path)
    return aside


def _holds_presses(path: Path) -> bool:
    """Whether a file is more than the empty one that opening a missing store leaves."""
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as connection:
            return bool(connection.execute("SELECT count(*) FROM press").fetchone()[0])
    except sqlite3.Error:
        return path.stat().st_size > 0


def damage_of(path: Path) -> str:
    """Return what is wrong with the pages of an SQLite file; nothing where they are sound or cannot be read now.

    A wrong bit within a value that leaves the pages sound is not seen: SQLite keeps no sums.
    """
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
            found = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    except sqlite3.OperationalError:
        return ""
    except sqlite3.DatabaseError as error:
        return str(error)
    return "" if found == "ok" else found.replace("\n", " ")
