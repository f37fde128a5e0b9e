"""What of a run is in the archive, for everybody who reads."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from sqlalchemy import Connection, func, select

from daq.records import InputError
from daq.store.archive_file import StoredScans, read_archive
from daq.store.convert import known_utc
from daq.store.records import Archive
from daq.store.schema import ARCHIVE, ARCHIVE_TOTAL
from daq.words import say


def archived_scans(connection: Connection, run: str) -> StoredScans | None:
    """Return a run's scans from the archive, None where they are in the store.

    Raises
    ------
    ArchiveUnreadable
        For a file that is missing or damaged.
    InputError
        Where the scans were given up by rule.
    """
    columns = (ARCHIVE.c.file, ARCHIVE.c.sha256, ARCHIVE.c.removed_unix_s)
    row = connection.execute(select(*columns).where(ARCHIVE.c.run == run)).first()
    if row is None:
        return None
    if row.removed_unix_s is not None:
        when = known_utc(row.removed_unix_s).date().isoformat()
        raise InputError(say("archive-run-removed", run=run, date=when))
    return read_archive(folder_of(connection) / row.file, row.sha256)


def archived_layouts(connection: Connection, run: str) -> Sequence[int] | None:
    """Return the layouts of a run's scans in the archive, None where they are in the store."""
    found = connection.execute(select(ARCHIVE.c.layouts_json).where(ARCHIVE.c.run == run)).scalar()
    return None if found is None else [int(layout) for layout in json.loads(found)]


def folder_of(connection: Connection) -> Path:
    """Return where the archive is."""
    return Path(connection.execute(select(ARCHIVE_TOTAL.c.folder)).scalar_one())


def archive(connection: Connection) -> Archive | None:
    """Return what the archive holds, None where there is none."""
    row = connection.execute(select(ARCHIVE_TOTAL)).first()
    if row is None:
        return None
    unsound = select(func.count()).select_from(ARCHIVE).where(ARCHIVE.c.problem != "")
    return Archive(
        row.folder, row.runs, row.scans, row.bytes, row.removed, int(connection.execute(unsound).scalar_one())
    )
