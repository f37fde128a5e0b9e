"""Whether a local buffer can be kept where the configuration has it: asked before a recorder needs it."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from daq.records import InputError
from daq.store.buffer import hours_of_room
from daq.store.buffer_file import open_file
from daq.store.file_rescue import remove_trial
from daq.tables import reason_of
from daq.words import say


def try_place(path: Path, per_second: float) -> float:
    """Write a row durably into a buffer of a name of its own in the place of one, and take it away again.

    A recorder may be writing into the buffer itself: that is left alone. Returns how long the disk takes scans at
    this rate [h].

    Raises
    ------
    InputError
        Where a recorder could keep nothing there now, with what to do.
    """
    folder = path.parent
    if not folder.is_dir():
        raise InputError(say("buffer-place-no-folder", file=str(path), folder=str(folder)))
    if path.is_dir():
        raise InputError(say("buffer-place-is-folder", file=str(path)))
    if not os.access(path if path.exists() else folder, os.R_OK | os.W_OK):
        raise InputError(say("buffer-place-refused", file=str(path), reason=say("buffer-place-no-permission")))
    trial = path.with_name(f"{path.name}.check-{os.getpid()}")
    try:
        with closing(open_file(trial)) as connection:
            connection.execute("INSERT INTO parcel VALUES (1, '{}')")
    except (sqlite3.Error, OSError) as error:
        raise InputError(say("buffer-place-refused", file=str(path), reason=reason_of(error))) from error
    finally:
        remove_trial(trial)
    return hours_of_room(folder, per_second)
