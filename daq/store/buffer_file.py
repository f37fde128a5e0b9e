"""The file of a local buffer: its tables, and how a row is written so that a wrong bit in it is noticed."""

from __future__ import annotations

import sqlite3
import zlib
from pathlib import Path

from daq.store.process_lock import WAIT_S
from daq.words import say

TABLES = """
CREATE TABLE IF NOT EXISTS parcel (number INTEGER PRIMARY KEY, content TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS session (session INTEGER PRIMARY KEY, content TEXT NOT NULL);
"""
Row = tuple[int, str]


def open_file(path: Path) -> sqlite3.Connection:
    """Open a buffer's file, with its tables, so that a row written is on the disk. Raises `sqlite3.Error`."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=WAIT_S)
    try:
        connection.execute("PRAGMA locking_mode=EXCLUSIVE")  # else a shared file: no room on a full disk
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("PRAGMA secure_delete=ON")  # else a page that is free still lists what was delivered
        connection.executescript(TABLES)
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def sealed(text: str) -> str:
    """Return a text with its sum before it: SQLite itself does not notice a wrong bit within a value."""
    return f"{zlib.crc32(text.encode()):08x}{text}"


def opened(text: str) -> str:
    """Undo `sealed`; raises `ValueError` where the sum is wrong. Files of older versions carry no sums."""
    if not isinstance(text, str):  # what a damaged page makes of it
        raise ValueError(say("buffer-sum-wrong"))
    if text.startswith("{"):
        return text
    if sealed(text[8:]) != text:
        raise ValueError(say("buffer-sum-wrong"))
    return text[8:]
