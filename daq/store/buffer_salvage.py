"""What can be read of a buffer's file that is damaged: each of its pages by itself.

What says where a table begins and which pages it has may be gone, as with the first page. So a copy of the file
gets a sound first page, and one page after another is put where the table begins: SQLite reads it as all there is,
with what a row has on further pages, where they are (2026-11). What a log held is in the file by then: SQLite
brings it in as the connection closes that found the damage. SQLite's own ``.recover`` is a program beside the
library, which Python's does not have.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, Any

from daq.store.buffer_file import TABLES, Row, opened
from daq.store.file_rescue import remove_trial

_LISTS_ROWS = 13
"""What a page of a table's rows begins with. https://www.sqlite.org/fileformat2.html#b_tree_pages"""
_CHANGES, _PAGES, _CHANGES_THEN = slice(24, 28), slice(28, 32), slice(92, 96)
"""Where the first page has the count of changes, the number of pages, and at which count of changes that was so.
https://www.sqlite.org/fileformat2.html#the_database_header"""


def salvaged(path: Path, alive: Callable[[], None]) -> tuple[dict[int, str], dict[int, dict[str, Any]]]:
    """Return the rows of a damaged file that can be read, and its sessions; a row's sum may be wrong.

    `alive` is called with each page. Raises `sqlite3.Error` or `OSError` where the disk has no room for a copy.
    """
    sound: dict[int, str] = {}
    unsound: dict[int, str] = {}
    notes: dict[int, dict[str, Any]] = {}
    copy = path.with_name(f"{path.name}.pages")
    remove_trial(copy)
    try:
        for number, text in _rows(path, copy, alive):
            try:
                content = json.loads(opened(text))
            except (ValueError, RecursionError):
                unsound[number] = text
            else:
                if isinstance(content, dict) and "channels" in content:
                    notes[number] = content
                else:
                    sound[number] = text
    finally:
        remove_trial(copy)
    return {**unsound, **sound}, notes


def _rows(path: Path, copy: Path, alive: Callable[[], None]) -> Iterator[Row]:
    """Yield what the pages of a file list, by means of a copy."""
    with closing(sqlite3.connect(":memory:")) as made:
        made.executescript(TABLES)
        (root,) = made.execute("SELECT rootpage FROM sqlite_master WHERE name = 'parcel'").fetchone()
        (size,) = made.execute("PRAGMA page_size").fetchone()
        first = bytearray(made.serialize()[:size])
    with copy.open("w+b", buffering=0) as file:
        for number, page in enumerate(_pages(path, size), 1):
            file.write(first if number == 1 else page)
            alive()
    with copy.open("r+b", buffering=0) as file, closing(sqlite3.connect(copy, isolation_level=None)) as connection:
        pages = file.seek(0, 2) // size
        first[_PAGES] = pages.to_bytes(4, "big")
        for number in range(2, pages + 1):
            file.seek((number - 1) * size)
            page = file.read(size)
            if page[0] == _LISTS_ROWS:
                first[_CHANGES] = first[_CHANGES_THEN] = number.to_bytes(4, "big")
                _put(file, 1, first)
                _put(file, root, page)
                yield from _listed(connection)
            alive()


def _pages(path: Path, size: int) -> Iterator[bytes]:
    """Yield the pages of a file [bytes]; one that the disk does not give is empty."""
    try:
        file = path.open("rb", buffering=0)
    except OSError:
        return
    with file:
        for at in range(0, file.seek(0, 2), size):
            page = b""
            with suppress(OSError):
                file.seek(at)
                page = file.read(size)
            yield page.ljust(size, b"\0")


def _put(file: IO[bytes], number: int, page: bytes | bytearray) -> None:
    file.seek((number - 1) * len(page))
    file.write(page)


def _listed(connection: sqlite3.Connection) -> Iterator[Row]:
    """Yield the rows of a table of one page, from both ends: a place that cannot be read stops SQLite."""
    numbers: set[int] = set()
    for order in ("ASC", "DESC"):
        with suppress(sqlite3.Error):
            for (number,) in connection.execute(f"SELECT number FROM parcel ORDER BY number {order}"):
                numbers.add(number)
    for number in sorted(numbers):
        with suppress(sqlite3.Error, UnicodeDecodeError):
            found = connection.execute("SELECT content FROM parcel WHERE number = ?", (number,)).fetchone()
            if found and isinstance(found[0], str):
                yield number, found[0]
