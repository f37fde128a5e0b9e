"""Looking after a store: backup while recording, verified restore, thinning of idle scans, sizes.

A backup is always one SQLite file, also of a PostgreSQL store: it opens anywhere, and restoring it into
either engine is the same copy. It is checked before it gets its name, so a file that is there is whole; its sum
goes into ``SHA256SUMS`` beside it, since SQLite itself does not notice a wrong bit within a value.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sqlalchemy import Connection, Table, delete, func, insert, select, text
from sqlalchemy.exc import ProgrammingError

from daq.address import Address
from daq.files.manifest import check_listed, update_manifest
from daq.records import InputError
from daq.store.database import Database, migrations
from daq.store.file_rescue import files_of, remove_trial
from daq.store.reading import first_number_from
from daq.store.records import RunStatus, StoreUnavailable
from daq.store.run_ends import interrupt_short
from daq.store.schema import ARCHIVE_TOTAL, ESTIMATE, FIT, IDLE_THINNED, METADATA, MODEL, PRESS, RUN, SCAN
from daq.store.upsert import put
from daq.tables import reason_of
from daq.words import Message, say

_BATCH = 20_000
"""Rows copied in one statement. By hand, 2026-11."""
_PIECE = 998
"""Idle scans deleted in one transaction: with their press as many values as a statement of any SQLite takes, by
default 999 before version 3.32 (https://www.sqlite.org/limits.html)."""
Progress = Callable[[int], None]


class RunsShort(InputError):
    """Closed runs of a store lack their first or last scan. The text names one."""

    def __init__(self, what: Message, runs: Sequence[str]) -> None:
        super().__init__(what)
        self.runs = runs


@dataclass(frozen=True)
class Contents:
    """What a store holds, for comparing a backup with its origin."""

    schema: int
    runs: int
    scans: int
    fits: int
    models: int


@dataclass(frozen=True)
class Sizes:
    """How large a store is and how long the disk lasts."""

    bytes: int
    bytes_per_scan: float
    free_bytes: int | None
    """None for a server elsewhere, or one that does not show this user where its data are."""


def back_up(database: Database, target: Path) -> Contents:
    """Copy a store into a new SQLite file while others write, check the copy, then give it its name.

    Closed runs that lack their first or last scan in the store itself are interrupted there, each with an alarm,
    and it is copied once more: no later backup can have what is lost.

    Raises
    ------
    InputError
        Where the target exists or its folder does not.
    StoreUnavailable
        Where store or disk refuse; no file is left behind.
    """
    _check_target(target)
    part = target.with_name(f".{target.name}.part")
    part.unlink(missing_ok=True)
    try:
        try:
            contents = _copied(database, part)
        except RunsShort as short:
            with database.writing() as connection:
                if not interrupt_short(connection, short.runs):
                    raise
            part.unlink()
            contents = _copied(database, part)
        part.replace(target)
        update_manifest(target.parent, [target])
    except (sqlite3.Error, OSError) as error:
        raise StoreUnavailable(say("backup-failed", file=str(target), error=reason_of(error))) from error
    finally:
        remove_trial(part)
    return contents


def _copied(database: Database, part: Path) -> Contents:
    if database.path is not None:
        _copy_file(database.path, part)
    else:
        with closing(Database(str(part))) as copy, database.reading() as source:
            _copy_tables(source, copy)
        _make_single_file(part)
    return verify(part)


def _check_target(target: Path) -> None:
    if target.exists():
        raise InputError(say("backup-exists", file=str(target)))
    if not target.parent.is_dir():
        raise InputError(say("backup-no-folder", file=str(target), folder=str(target.parent)))


def _copy_file(source: Path, target: Path) -> None:
    """Copy by SQLite's own online backup, one consistent state."""
    with closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(target)) as new:
        old.backup(new)
    _make_single_file(target)


def _make_single_file(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode=DELETE")


def _copy_tables(source: Connection, target: Database) -> None:
    with target.writing() as connection:
        for table in METADATA.tables.values():
            rows = source.execution_options(stream_results=True).execute(select(table)).mappings()
            for batch in rows.partitions(_BATCH):
                connection.execute(insert(table), [dict(row) for row in batch])
        if target.dialect == "postgresql":
            for table in METADATA.tables.values():
                _continue_numbers(connection, table)
    if target.path is not None:
        with target.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")


def _continue_numbers(connection: Connection, table: Table) -> None:
    """Let a server's row numbers go on after the copied ones."""
    key = next(iter(table.primary_key)).name
    identity = text("SELECT pg_get_serial_sequence(:table, :key)")
    sequence = connection.execute(identity, {"table": table.name, "key": key}).scalar()
    if sequence is not None:
        newest = connection.execute(select(func.max(table.c[key]))).scalar() or 0
        connection.execute(text("SELECT setval(:sequence, :value)"), {"sequence": sequence, "value": newest + 1})


def verify(path: Path) -> Contents:
    """Check a store file: the sum it was written with, sound pages and references, closed runs with both ends.

    Raises
    ------
    InputError
        For a file that is damaged, no store, or made by a newer version.
    """
    if not path.is_file():
        raise InputError(say("backup-missing", file=str(path)))
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
            if (sound := connection.execute("PRAGMA integrity_check(1)").fetchone()[0]) != "ok":
                raise InputError(say("backup-damaged", file=str(path), error=sound))
            if connection.execute("PRAGMA foreign_key_check").fetchone() is not None:
                raise InputError(say("backup-rows-missing", file=str(path)))
            schema = connection.execute("SELECT version FROM schema_version").fetchone()[0]
            counts = [
                connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
                for table in ("run", "scan", "fit", "model")
            ]
            own = _NOT_ARCHIVED if schema >= _WITH_ARCHIVE else ""
            short = [row[0] for row in connection.execute(_RUNS_WITHOUT_ENDS.format(own=own))]
    except sqlite3.Error as error:
        raise InputError(say("backup-unsound", file=str(path), error=reason_of(error))) from error
    if schema > (known := max(migrations())):
        raise InputError(say("backup-newer", file=str(path), schema=schema, known=known))
    if short:
        raise RunsShort(say("backup-run-short", file=str(path), run=short[0]), short)
    check_listed(path)
    return Contents(schema, *counts)


_WITH_ARCHIVE = 9
"""The schema from which on scans of runs may be in the archive."""
_NOT_ARCHIVED = "NOT EXISTS (SELECT 1 FROM archive WHERE archive.run = run.run) AND "
_RUNS_WITHOUT_ENDS = """
SELECT run.run FROM run WHERE run.last_scan >= run.first_scan AND run.status = 'closed' AND {own}(
    NOT EXISTS (SELECT 1 FROM scan WHERE scan.press_id = run.press_id AND scan.number = run.first_scan)
    OR NOT EXISTS (SELECT 1 FROM scan WHERE scan.press_id = run.press_id AND scan.number = run.last_scan)
)
"""


def restore(backup: Path, url: str | Address) -> Contents:
    """Make a store from a backup at a place where none is, and compare the two.

    Raises
    ------
    InputError
        For a damaged backup, or a place that holds data.
    """
    verify(backup)
    with closing(Database(url)) as target, tempfile.TemporaryDirectory(prefix="kerntemp-restore-") as folder:
        with target.reading() as connection:
            if connection.execute(select(func.count()).select_from(PRESS)).scalar():
                raise InputError(say("store-not-empty", store=target.label))
        working = Path(folder) / "backup.sqlite"  # opening a store writes beside it; the backup stays untouched
        shutil.copyfile(backup, working)
        with closing(Database(str(working))) as source:  # an older backup comes up to date here
            with source.reading() as rows:
                _copy_tables(rows, target)
            expected, found = _rows_of(source), _rows_of(target)
        if found != expected:
            raise StoreUnavailable(
                say("restore-differs", store=target.label, found=str(found), expected=str(expected))
            )
        return contents_of(target)


def _rows_of(database: Database) -> dict[str, int]:
    """Return how many rows each table has."""
    with database.reading() as connection:
        return {
            name: int(connection.execute(select(func.count()).select_from(table)).scalar_one())
            for name, table in METADATA.tables.items()
        }


def contents_of(database: Database) -> Contents:
    """Return what a store holds."""
    with database.reading() as connection:
        counts = [
            int(connection.execute(select(func.count()).select_from(table)).scalar_one())
            for table in (RUN, SCAN, FIT, MODEL)
        ]
        schema = connection.execute(text("SELECT version FROM schema_version")).scalar_one()
    return Contents(int(schema), *counts)


def thin_idle(database: Database, before: datetime, keep_every: int) -> Iterator[int]:
    """Delete idle scans older than `before` but every `keep_every`-th; scans of runs are never touched.

    Piece by piece, each in a transaction of its own: yields how many went, and others come in between.
    The store keeps how far each press is thinned, and a piece asks for what follows alone.
    """
    for press_id, thinned in _thinned(database).items():
        with database.reading() as connection:
            end = _end_of_old(connection, press_id, before)
        while thinned < end - 1:
            with database.writing() as connection:
                gone, thinned = _thin_piece(connection, press_id, range(thinned + 1, end), before, keep_every)
                put(connection, IDLE_THINNED, [{"press_id": press_id, "number": thinned}])
            yield gone


def _thinned(database: Database) -> dict[int, int]:
    """Return up to which scan each recorded press is thinned."""
    query = select(PRESS.c.press_id, func.coalesce(IDLE_THINNED.c.number, -1)).where(PRESS.c.kind == "recorded")
    with database.reading() as connection:
        found = connection.execute(query.outerjoin(IDLE_THINNED, IDLE_THINNED.c.press_id == PRESS.c.press_id))
        return {press_id: number for press_id, number in found}


def _end_of_old(connection: Connection, press_id: int, before: datetime) -> int:
    """Return the scan before which a press may be thinned: one not so old, the first of an open run, the newest.

    The newest stays at any age, as numbers go on from it.
    """
    is_open = (RUN.c.press_id == press_id, RUN.c.status == RunStatus.OPEN.value)
    limits = (
        select(func.min(RUN.c.first_scan)).where(*is_open),
        select(func.max(SCAN.c.number)).where(SCAN.c.press_id == press_id),
    )
    found = [connection.execute(limit).scalar() for limit in limits]
    first = first_number_from(connection, press_id, before.timestamp())
    return min([first, *(int(number) for number in found if number is not None)])


def _thin_piece(
    connection: Connection, press_id: int, scans: range, before: datetime, keep_every: int
) -> tuple[int, int]:
    """Thin what of these scans lies before the next run, as far as one piece goes.

    Returns how many went, and up to where all is thinned: the run after a stretch that is through goes with it.
    """
    run = _next_run(connection, press_id, scans.start)
    idle, beyond = scans, scans.stop - 1
    if run is not None and run[0] < scans.stop:
        idle, beyond = range(scans.start, run[0]), run[1]
    numbers = _old_surplus(connection, press_id, idle, before, keep_every)
    for table in (SCAN, ESTIMATE):
        connection.execute(delete(table).where(table.c.press_id == press_id, table.c.number.in_(numbers)))
    return len(numbers), numbers[-1] if len(numbers) == _PIECE else beyond


def _next_run(connection: Connection, press_id: int, number: int) -> tuple[int, int] | None:
    """Return first and last scan of the run that holds a scan, or of the next one after it."""
    own = RUN.c.press_id == press_id
    begun = select(func.coalesce(func.max(RUN.c.first_scan), 0)).where(own, RUN.c.first_scan <= number)
    query = select(RUN.c.first_scan, RUN.c.last_scan).where(
        own, RUN.c.first_scan >= begun.scalar_subquery(), RUN.c.last_scan >= number
    )
    row = connection.execute(query.order_by(RUN.c.first_scan).limit(1)).first()
    return None if row is None else (row.first_scan, row.last_scan)


def _old_surplus(
    connection: Connection, press_id: int, idle: range, before: datetime, keep_every: int
) -> list[int]:
    query = (
        select(SCAN.c.number)
        .where(
            SCAN.c.press_id == press_id,
            SCAN.c.number >= idle.start,
            SCAN.c.number < idle.stop,
            SCAN.c.number % keep_every != 0,
            SCAN.c.unix_s < before.timestamp(),
        )
        .order_by(SCAN.c.number)
        .limit(_PIECE)
    )
    return list(connection.execute(query).scalars())


def sizes_of(database: Database) -> Sizes:
    """Return how large the store is and what a scan costs."""
    with database.reading() as connection:
        newest = select(func.max(SCAN.c.number) + 1).where(SCAN.c.press_id == PRESS.c.press_id).scalar_subquery()
        numbered = select(func.sum(func.coalesce(newest, 1))).select_from(PRESS)
        scans = int(connection.execute(numbered).scalar() or 0)
        scans -= int(connection.execute(select(func.sum(ARCHIVE_TOTAL.c.scans))).scalar() or 0)
        if database.path is None:
            size = int(connection.execute(text("SELECT pg_database_size(current_database())")).scalar_one())
            return Sizes(size, size / max(scans, 1), _free_of_server(database, connection))
    size = sum(p.stat().st_size for p in files_of(database.path) if p.exists())
    return Sizes(size, size / max(scans, 1), shutil.disk_usage(database.path.parent).free)


def _free_of_server(database: Database, connection: Connection) -> int | None:
    """Return what is free where a server on this machine keeps its data."""
    host = database.url.host or ""
    if host not in ("", "localhost", "127.0.0.1", "::1"):
        return None
    try:
        with connection.begin_nested():
            folder = connection.execute(text("SHOW data_directory")).scalar_one()
        return shutil.disk_usage(folder).free
    except (ProgrammingError, OSError):
        return None
