"""One recorder a press and one a buffer file: the operating system holds a lock while the process lives.

A second recorder would end the first one's open run as interrupted, take its scan numbers, and empty its buffer.
"""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import IO

from daq.records import InputError
from daq.words import Message

# Numbers without another source were set by hand, 2026-11.

WAIT_S = 5.0
"""A recorder that is just ending, or was just killed, is waited for. [s]"""
AGAIN_S = 0.05
"""What is locked is tried again after this. [s]"""

if sys.platform == "win32":
    import msvcrt

    def _lock(file: IO[bytes]) -> None:
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: IO[bytes]) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def only_user(places: Mapping[Path, Message]) -> Iterator[None]:
    """Hold what must have one user; of each place its file and what to say where another process holds it.

    A place where no file can be made (disk full or read-only) is not held: that must not stop recording.

    Raises
    ------
    InputError
        With the message, after `WAIT_S`.
    """
    with ExitStack() as held:
        for place, complaint in places.items():
            try:
                file = held.enter_context(lock_file(place).open("ab"))
            except OSError:
                continue
            wait_for(partial(_lock, file), complaint)
        yield


@contextmanager
def only_user_of_file(path: Path, presses: Mapping[str, Message]) -> Iterator[None]:
    """Hold a file's presses against users who reach the same file by another name, a hard link; Linux only.

    Raises
    ------
    InputError
        With the message about a press, after `WAIT_S`.
    """
    with ExitStack() as held:
        if sys.platform == "linux":
            with suppress(OSError):
                path.touch()  # a file that is not there yet has no identity to hold
                found = path.stat()
                for press, complaint in presses.items():
                    address = f"\0kerntemp-record-{found.st_dev}-{found.st_ino}-{press}"
                    name = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
                    wait_for(partial(name.bind, address), complaint)
        yield


def lock_file(place: Path) -> Path:
    """Return the hidden file beside a place whose lock stands for it."""
    return place.with_name(f".{place.name}.lock")


def wait_for(lock: Callable[[], None], complaint: Message) -> None:
    """Take a lock that raises `OSError` while another holds it; raises `InputError` after `WAIT_S`."""
    deadline = time.monotonic() + WAIT_S
    while True:
        try:
            lock()
        except OSError as error:
            if time.monotonic() > deadline:
                raise InputError(complaint) from error
            time.sleep(AGAIN_S)
        else:
            return
