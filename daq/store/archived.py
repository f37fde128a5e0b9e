"""What of a run is in the archive, for everybody who reads."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Row, func, select

from daq.records import InputError
from daq.store.archive_file import StoredScans, read_archive
from daq.store.convert import known_utc, nan
from daq.store.estimate_file import EstimateRow, beside, read_estimates
from daq.store.records import Archive, RunCore
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
    row = _kept(connection, run)
    return None if row is None else read_archive(folder_of(connection) / row.file, row.sha256)


def archived_estimates(connection: Connection, run: str) -> list[EstimateRow] | None:
    """Return the live sensor's estimates of a run as `archived_scans` returns its scans."""
    row = _kept(connection, run)
    if row is None or row.estimates_sha256 is None:  # version 9 of the schema left them in the store
        return None
    if not row.estimates_sha256:
        return []
    return read_estimates(beside(folder_of(connection) / row.file), row.estimates_sha256)


def _kept(connection: Connection, run: str) -> Row[Any] | None:
    """Return a run's row of the archive; raises `InputError` where its scans were given up."""
    row: Row[Any] | None = connection.execute(select(ARCHIVE).where(ARCHIVE.c.run == run)).first()
    if row is not None and row.removed_unix_s is not None:
        when = known_utc(row.removed_unix_s).date().isoformat()
        raise InputError(say("archive-run-removed", run=run, date=when))
    return row


def archived_cores(connection: Connection, runs: Sequence[str]) -> dict[str, RunCore]:
    """Return the core of those of these runs that are archived and had a valid estimate."""
    own = (ARCHIVE.c.run.in_(runs), ARCHIVE.c.core_highest_celsius.is_not(None))
    return {
        row.run: RunCore(nan(row.core_at_opening_celsius), nan(row.core_band_kelvin), row.core_highest_celsius)
        for row in connection.execute(select(ARCHIVE).where(*own)).all()
    }


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
