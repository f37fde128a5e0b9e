"""Tables of the archive as files that are proved when they are written and refused when they have changed."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from daq.files.parquet_columns import Columns, NewerFormat, columns_of, write_columns
from daq.records import InputError
from daq.store.records import ArchiveUnreadable
from daq.tables import reason_of
from daq.words import say

SUM = ".sha256"
"""Ending of the file beside it that holds its sum, for ``sha256sum --check``."""


@dataclass(frozen=True)
class Written:
    """A file that was written, read back and found to hold what it should."""

    sha256: str
    bytes: int


def write_proved(path: Path, made: Columns, same: Callable[[Columns], bool]) -> Written:
    """Write a table, read it back from the disk, have every value compared, then give the file its name and sum.

    What a killed job left half written is removed. Another process at the same file fails then, and loses nothing.

    Raises
    ------
    InputError
        Where a file of that name holds something else, or what is read back is not what was written.
    OSError
        Where the disk refuses.
    """
    if path.exists():
        return _found(path, same)
    path.parent.mkdir(parents=True, exist_ok=True)
    for left in path.parent.glob(f".{path.name}*.part"):
        left.unlink(missing_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.{time.monotonic_ns()}.part")  # nobody else writes into it
    with part.open("xb") as file:
        write_columns(made, file)
        file.flush()
        _to_disk(file.fileno())
    content = part.read_bytes()
    if not same(columns_in(content, path)):
        raise InputError(say("archive-not-as-written", file=str(path)))
    if path.exists():
        return _found(path, same)
    part.replace(path)
    return _with_sum(path, content)


def read_proved(path: Path, sha256: str) -> Columns:
    """Return the table of a file that has this sum.

    Raises
    ------
    ArchiveUnreadable
        For a file that is missing or was changed, with what to do.
    """
    return columns_in(sound_content(path, sha256), path)


def sound_content(path: Path, sha256: str) -> bytes:
    """Return a file's bytes; raises `ArchiveUnreadable` where it is missing or has another sum."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise ArchiveUnreadable(say("archive-file-missing", file=str(path))) from None
    except OSError as error:
        raise ArchiveUnreadable(say("archive-file-unreadable", file=str(path), reason=reason_of(error))) from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ArchiveUnreadable(say("archive-file-damaged", file=str(path)))
    return content


def _found(path: Path, same: Callable[[Columns], bool]) -> Written:
    """Take a file that a killed job left; one that holds something else belongs to another store."""
    content = path.read_bytes()
    try:
        mine = same(columns_in(content, path))
    except (ArchiveUnreadable, KeyError):
        mine = False
    if not mine:
        raise InputError(say("archive-file-taken", file=str(path)))
    return _with_sum(path, content)


def _with_sum(path: Path, content: bytes) -> Written:
    """Put a file's sum beside it, and both their names on the disk."""
    found = hashlib.sha256(content).hexdigest()
    with path.with_name(path.name + SUM).open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{found}  {path.name}\n")
        file.flush()
        os.fsync(file.fileno())
    sync_folder(path.parent)
    return Written(found, len(content))


def _to_disk(descriptor: int) -> None:
    """Write a file through, and let go of the copy in memory, so that reading it back asks the disk."""
    os.fsync(descriptor)
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)


def sync_folder(folder: Path) -> None:
    """Write a folder's names through, where the system can."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def columns_in(content: bytes, path: Path) -> Columns:
    """Read a file's bytes; `path` is for messages about it."""
    try:
        return columns_of(pq.ParquetFile(pa.BufferReader(content)))
    except NewerFormat:
        raise ArchiveUnreadable(say("archive-file-newer", file=str(path))) from None
    except (pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise ArchiveUnreadable(say("archive-file-damaged", file=str(path))) from error
