"""Looking after a store: backup while recording, verified restore, thinning of idle scans, sizes.

A backup is always one SQLite file, also of a PostgreSQL store: it opens anywhere, and restoring it into
either engine is the same copy. It is checked before it gets its name, so a file that is there is whole; its sum
goes into ``SHA256SUMS`` beside it, since SQLite itself does not notice a wrong bit within a value.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sqlalchemy import Connection, Table, delete, func, insert, select, text
from sqlalchemy.exc import ProgrammingError

from daq.address import Address
from daq.files.manifest import check_listed, update_manifest
from daq.records import InputError
from daq.store.database import Database, migrations
from daq.store.records import StoreUnavailable
from daq.store.schema import ARCHIVE_TOTAL, ESTIMATE, FIT, METADATA, MODEL, PRESS, RUN, SCAN
from daq.words import say

_BATCH = 20_000
"""Rows copied in one statement. By hand, 2026-11."""
Progress = Callable[[int], None]


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
    """None for a server elsewhere, or one that does not tell this user where its data are."""


def back_up(database: Database, target: Path) -> Contents:
    """Copy a store into a new SQLite file while others write, check the copy, then give it its name.

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
        if database.path is not None:
            _copy_file(database.path, part)
        else:
            with closing(Database(str(part))) as copy, database.reading() as source:
                if database.dialect == "postgresql":
                    source.execute(text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ, READ ONLY"))
                _copy_tables(source, copy)
            _make_single_file(part)
        contents = verify(part)
        part.replace(target)
        update_manifest(target.parent, [target])
    except (sqlite3.Error, OSError) as error:
        raise StoreUnavailable(say("backup-failed", file=str(target), error=str(error))) from error
    finally:
        for leftover in (part, part.with_name(part.name + "-wal"), part.with_name(part.name + "-shm")):
            with suppress(OSError):
                leftover.unlink(missing_ok=True)
    return contents


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
            short = connection.execute(_RUNS_WITHOUT_ENDS.format(own=own)).fetchone()
    except sqlite3.Error as error:
        raise InputError(say("backup-unsound", file=str(path), error=str(error))) from error
    if schema > (known := max(migrations())):
        raise InputError(say("backup-newer", file=str(path), schema=schema, known=known))
    if short is not None:
        raise InputError(say("backup-run-short", file=str(path), run=short[0]))
    check_listed(path)
    return Contents(schema, *counts)


_WITH_ARCHIVE = 9
"""The schema from which on scans of runs may be in the archive."""
_NOT_ARCHIVED = "NOT EXISTS (SELECT 1 FROM archive WHERE archive.run = run.run) AND "
_RUNS_WITHOUT_ENDS = """
SELECT run.run FROM run WHERE run.last_scan >= run.first_scan AND run.status = 'closed' AND {own}(
    NOT EXISTS (SELECT 1 FROM scan WHERE scan.press_id = run.press_id AND scan.number = run.first_scan)
    OR NOT EXISTS (SELECT 1 FROM scan WHERE scan.press_id = run.press_id AND scan.number = run.last_scan)
) LIMIT 1
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


def thin_idle(
    database: Database,
    before: datetime,
    keep_every: int,
    most_rows: int = 20_000,
    done: dict[int, int] | None = None,
) -> int:
    """Delete idle scans older than `before` but every `keep_every`-th; scans of runs are never touched.

    Returns how many went; at most `most_rows` at a time, so that recording never waits long. `done` keeps, by
    press, up to which scan everything is thinned: hand it in again, and old runs are not gone through anew.
    """
    gone, done = 0, {} if done is None else done
    for press_id, first, last in _idle_stretches(database):
        start = max(first, done.get(press_id, -1) + 1)
        while start <= last:
            numbers = _old_surplus(database, press_id, start, last, before, keep_every)
            if not numbers:
                break
            with database.writing() as connection:
                for table in (SCAN, ESTIMATE):
                    connection.execute(
                        delete(table).where(table.c.press_id == press_id, table.c.number.in_(numbers))
                    )
            gone += len(numbers)
            start = numbers[-1] + 1
            done[press_id] = numbers[-1]
            if gone >= most_rows:
                return gone
        if _all_older(database, press_id, last, before):
            done[press_id] = max(last, done.get(press_id, -1))
    return gone


def _old_surplus(
    database: Database, press_id: int, first: int, last: int, before: datetime, keep_every: int
) -> list[int]:
    query = (
        select(SCAN.c.number)
        .where(
            SCAN.c.press_id == press_id,
            SCAN.c.number.between(first, last),
            SCAN.c.number % keep_every != 0,
            SCAN.c.unix_s < before.timestamp(),
        )
        .order_by(SCAN.c.number)
        .limit(1000)
    )
    with database.reading() as connection:
        return list(connection.execute(query).scalars())


def _all_older(database: Database, press_id: int, last: int, before: datetime) -> bool:
    """Whether the scan after a stretch, so the whole stretch, is older than `before`."""
    query = select(SCAN.c.unix_s).where(SCAN.c.press_id == press_id, SCAN.c.number == last + 1)
    archived = select(RUN.c.started_unix_s).where(RUN.c.press_id == press_id, RUN.c.first_scan == last + 1)
    with database.reading() as connection:
        unix_s = connection.execute(query).scalar() or connection.execute(archived).scalar()
    return unix_s is not None and unix_s < before.timestamp()


def _idle_stretches(database: Database) -> Iterator[tuple[int, int, int]]:
    """Yield press, first and last number of every stretch of scans outside all runs, oldest first."""
    with database.reading() as connection:
        presses = list(connection.execute(select(PRESS.c.press_id).where(PRESS.c.kind == "recorded")).scalars())
        stretches = []
        for press_id in presses:
            runs = connection.execute(
                select(RUN.c.first_scan, RUN.c.last_scan)
                .where(RUN.c.press_id == press_id)
                .order_by(RUN.c.first_scan)
            ).all()
            first = 0
            for run in runs:
                if run.first_scan > first:
                    stretches.append((press_id, first, run.first_scan - 1))
                if run.last_scan is None:
                    break
                first = max(first, run.last_scan + 1)
            else:
                newest = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == press_id))
                stretches.append((press_id, first, int(newest.scalar() or 0)))
    yield from (s for s in stretches if s[2] >= s[1])


def sizes_of(database: Database) -> Sizes:
    """Return how large the store is and what a scan costs."""
    with database.reading() as connection:
        presses = connection.execute(select(PRESS.c.press_id)).scalars().all()
        newest = [select(func.max(SCAN.c.number)).where(SCAN.c.press_id == key) for key in presses]
        scans = sum(int(connection.execute(query).scalar() or 0) + 1 for query in newest)
        scans -= int(connection.execute(select(func.sum(ARCHIVE_TOTAL.c.scans))).scalar() or 0)
        if database.path is None:
            size = int(connection.execute(text("SELECT pg_database_size(current_database())")).scalar_one())
            return Sizes(size, size / max(scans, 1), _free_of_server(database, connection))
    beside = [database.path, *(database.path.with_name(database.path.name + s) for s in ("-wal", "-shm"))]
    size = sum(p.stat().st_size for p in beside if p.exists())
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
