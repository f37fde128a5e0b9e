"""The steps by which scans leave the store: into a file of the archive, and years later for good.

A step is proved before anything is deleted: a file is written through, read back from the disk and compared value
by value; then its sum goes into the store and its scans out of it in one transaction. Killed anywhere, the next
night finds either the scans in the store, and takes a finished file as it is, or the file with its row.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Table,
    Text,
    and_,
    delete,
    exists,
    func,
    insert,
    literal_column,
    or_,
    select,
    update,
)

from daq.records import InputError
from daq.store.archive_file import StoredScans, write_archive
from daq.store.archived import folder_of
from daq.store.convert import known_utc, null, unix_of
from daq.store.cores import run_cores
from daq.store.database import Database
from daq.store.estimate_file import EstimateRow, beside, write_estimates
from daq.store.origin import header_for_file
from daq.store.proved_file import SUM, Written, sound_content
from daq.store.reading import layout_channels, run_record, run_row
from daq.store.records import ArchiveUnreadable, Moved, RunCore, RunStatus, StoreUnavailable
from daq.store.run_scans import scans_of
from daq.store.schema import ARCHIVE, ARCHIVE_TOTAL, ESTIMATE, FIT, PRESS, RUN, SCAN, SCAN_REMARK, UNFITTED
from daq.tables import reason_of
from daq.words import Message, say, spoken

_NUMBER_BYTES = 8
"""Of a number in a row; an engine may take less."""
_NAME_LENGTH = 80
"""Signs of a run's name in its file's name, which is made distinct by the run's number. (By hand, 2026-11)"""


@dataclass(frozen=True)
class Checked:
    """What a look at files of the archive found."""

    files: int
    unsound: tuple[Message, ...]
    """Of those that were sound before."""
    mended: tuple[str, ...]
    """Runs whose file is sound again."""


def use_archive(database: Database, folder: Path) -> None:
    """Make a folder the store's archive, or see that it is still the one: it holds some of what was archived.

    A file that is lost does not keep the others from being looked after.

    Raises
    ------
    InputError
        For a folder that is not there or lacks what was archived: nothing is changed then.
    """
    with database.reading() as connection:
        before = connection.execute(select(ARCHIVE_TOTAL.c.folder)).scalar()
        lacking = _lacking(connection, folder)
    if lacking is not None:
        raise InputError(say("archive-folder-lacks", folder=str(folder), file=lacking, before=before or ""))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(say("archive-folder-refused", folder=str(folder), reason=reason_of(error))) from error
    with database.writing() as connection:
        there = connection.execute(select(ARCHIVE_TOTAL)).first()
        if there is None:
            none = {"runs": 0, "scans": 0, "bytes": 0, "removed": 0}
            connection.execute(insert(ARCHIVE_TOTAL), {"place": 1, "folder": str(folder), **none})
        elif there.folder != str(folder):
            connection.execute(update(ARCHIVE_TOTAL).values(folder=str(folder)))


def _lacking(connection: Connection, folder: Path) -> str | None:
    """Return the newest archived file where a folder holds none of them, None where it holds one or none is."""
    newest = select(ARCHIVE.c.file).where(ARCHIVE.c.file != "").order_by(ARCHIVE.c.archived_unix_s.desc())
    file: str | None = connection.execute(newest.limit(1)).scalar()
    if file is None or (folder / file).is_file():
        return None
    if not folder.is_dir() or not any(folder.iterdir()):  # as where a disk is not mounted
        return file
    return None if any((folder / other).is_file() for other in connection.execute(newest).scalars()) else file


def runs_to_archive(connection: Connection, press: str, before: datetime) -> list[str]:
    """Return the runs of a press that were over before an instant and have their scans in the store, oldest first.

    A run without a known time has no age and stays, and so does the newest one that a press recorded:
    the live sensor sees by it how far it has come.
    """
    own = RUN.alias()
    newest = select(func.max(own.c.run_number)).where(own.c.press_id == PRESS.c.press_id).scalar_subquery()
    query = (
        select(RUN.c.run)
        .join(PRESS, PRESS.c.press_id == RUN.c.press_id)
        .where(PRESS.c.name == press, *_over(before), RUN.c.last_scan >= RUN.c.first_scan)
        .where(~exists().where(ARCHIVE.c.run == RUN.c.run))
        .where(or_(PRESS.c.kind == "imported", RUN.c.run_number < newest))
        .order_by(RUN.c.run_number)
    )
    return list(connection.execute(query).scalars())


def _over(before: datetime) -> list[ColumnElement[bool]]:
    start = func.coalesce(RUN.c.started_unix_s, literal_column("-1.0"))  # as in the index run_by_start
    ended = func.coalesce(RUN.c.ended_unix_s, RUN.c.started_unix_s)
    return [RUN.c.status != RunStatus.OPEN.value, start < unix_of(before), ended < unix_of(before)]


def archive_run(database: Database, run: str) -> Moved:
    """Move a run's scans into a file of the archive.

    Raises
    ------
    InputError
        Where file and scans differ, or the file's place is taken: nothing is deleted.
    StoreUnavailable
        Where store or disk refuse.
    """
    with database.reading() as connection:
        row = run_row(connection, run)
        scans = scans_of(connection, row)
        channels = {key: [c.name for c in layout_channels(connection, key)] for key in scans.values}
        estimates = _estimates(connection, row)
        core = run_cores(connection, [run]).get(run)
        folder, header = folder_of(connection), header_for_file(run_record(connection, run))
    file = _file_of(row)
    about = {"press": row.press, "zero_s": row.zero_monotonic_s, "started_unix_s": row.started_unix_s}
    try:
        written = write_archive(folder / file, scans, channels, header, about)
        beside_it = write_estimates(beside(folder / file), estimates) if estimates else None
    except OSError as error:
        refused = say("archive-not-written", file=str(folder / file), reason=reason_of(error))
        raise StoreUnavailable(refused) from error
    with database.writing() as connection:
        return _exchange(connection, row, _Taken(file, scans, written, estimates, beside_it, core))


def _file_of(row: Row[Any]) -> str:
    month = "undated" if row.started_unix_s is None else f"{known_utc(row.started_unix_s):%Y/%m}"
    name = re.sub(r"[^A-Za-z0-9._-]", "_", row.run)[:_NAME_LENGTH]
    return f"{month}/{row.run_number:08d}-{name}.parquet"


def _estimates(connection: Connection, row: Row[Any]) -> list[EstimateRow]:
    columns = [ESTIMATE.c[name] for name in EstimateRow._fields]
    query = select(*columns).where(*_in_run(ESTIMATE, row)).order_by(ESTIMATE.c.number)
    return [EstimateRow(*found) for found in connection.execute(query).all()]


def _in_run(table: Table, row: Row[Any]) -> tuple[ColumnElement[bool], ...]:
    return table.c.press_id == row.press_id, table.c.number.between(row.first_scan, row.last_scan)


@dataclass(frozen=True)
class _Taken:
    """What of a run is in files now."""

    file: str
    scans: StoredScans
    written: Written
    estimates: Sequence[EstimateRow]
    beside_it: Written | None
    core: RunCore | None

    @property
    def columns(self) -> dict[str, Any]:
        """Return the run's row of the archive."""
        now = unix_of(datetime.now(UTC))
        kept: dict[str, Any] = {
            "file": self.file,
            "sha256": self.written.sha256,
            "bytes": self.bytes,
            "problem": "",
        }
        kept |= {"scans": len(self.scans), "layouts_json": json.dumps(sorted(self.scans.values))}
        kept |= {"archived_unix_s": now, "checked_unix_s": now}
        kept["estimates_sha256"] = "" if self.beside_it is None else self.beside_it.sha256
        if self.core is not None:
            kept["core_at_opening_celsius"] = null(self.core.at_opening_celsius)
            kept["core_band_kelvin"] = null(self.core.band_at_opening_kelvin)
            kept["core_highest_celsius"] = null(self.core.highest_celsius)
        return kept

    @property
    def bytes(self) -> int:
        """Return the size of the files."""
        return self.written.bytes + (0 if self.beside_it is None else self.beside_it.bytes)


def _exchange(connection: Connection, row: Row[Any], taken: _Taken) -> Moved:
    """Take the files' row in and their content out; raises where the store holds something else than they do."""
    freed = _size_of(connection, SCAN, row) + _size_of(connection, ESTIMATE, row)
    connection.execute(insert(ARCHIVE), {"run": row.run, **taken.columns})
    _count(connection, runs=1, scans=len(taken.scans), bytes=taken.bytes)
    connection.execute(delete(SCAN_REMARK).where(*_in_run(SCAN_REMARK, row)))
    for table, rows in ((SCAN, len(taken.scans)), (ESTIMATE, len(taken.estimates))):
        if connection.execute(delete(table).where(*_in_run(table, row))).rowcount != rows:
            raise StoreUnavailable(say("archive-run-changed", run=row.run))
    return Moved(len(taken.scans), taken.bytes, freed)


def _size_of(connection: Connection, table: Table, row: Row[Any]) -> int:
    """Return the bytes of a run's rows: texts by their length, numbers by eight."""
    of_row: Any = _NUMBER_BYTES * sum(not isinstance(c.type, Text) for c in table.columns)
    for column in table.columns:
        if isinstance(column.type, Text):
            of_row = of_row + func.coalesce(func.length(column), 0)
    found = connection.execute(select(func.coalesce(func.sum(of_row), 0)).where(*_in_run(table, row)))
    return int(found.scalar_one())


def _count(connection: Connection, **more: int) -> None:
    totals = {name: ARCHIVE_TOTAL.c[name] + count for name, count in more.items()}
    connection.execute(update(ARCHIVE_TOTAL).values(totals))


def check_archive(database: Database, before: datetime, limit: int = 100) -> Checked:
    """Read files that were not since an instant, those read longest ago first, and hold their sums against them.

    Nothing is deleted. Files come back whole from a backup of the archive, and are sound at the next look.
    """
    old = and_(ARCHIVE.c.checked_unix_s < unix_of(before), ARCHIVE.c.removed_unix_s.is_(None))
    query = select(ARCHIVE).where(old).order_by(ARCHIVE.c.checked_unix_s).limit(limit)
    with database.reading() as connection:
        folder = folder_of(connection)
        rows = connection.execute(query).all()
    problems = {row.run: _problem_of(folder, row) for row in rows}
    now = unix_of(datetime.now(UTC))
    with database.writing() as connection:
        for run, problem in problems.items():
            found = {"problem": "" if problem is None else problem.code, "checked_unix_s": now}
            connection.execute(update(ARCHIVE).where(ARCHIVE.c.run == run).values(found))
        mended = [row.run for row in rows if problems[row.run] is None and row.problem]
        tried_in_vain = (UNFITTED.c.run.in_(mended), UNFITTED.c.kind == "unfit")
        connection.execute(delete(UNFITTED).where(*tried_in_vain))
    fresh = [problem for row in rows if (problem := problems[row.run]) is not None and not row.problem]
    return Checked(len(rows), tuple(fresh), tuple(mended))


def recheck_unsound(database: Database, before: datetime) -> None:
    """Let files that were found unsound, and not read since an instant, come first at the next look."""
    due = (ARCHIVE.c.problem != "", ARCHIVE.c.checked_unix_s < unix_of(before))
    with database.writing() as connection:
        connection.execute(update(ARCHIVE).where(*due).values(checked_unix_s=0.0))


def _problem_of(folder: Path, row: Row[Any]) -> Message | None:
    try:
        sound_content(folder / row.file, row.sha256)
        if row.estimates_sha256:
            sound_content(beside(folder / row.file), row.estimates_sha256)
    except ArchiveUnreadable as error:
        return spoken(error)
    return None


def remove_archived(database: Database, press: str, before: datetime, limit: int = 50) -> tuple[int, int]:
    """Give up archived scans of runs that were over before an instant; the pressings stay. Returns runs and bytes.

    A pressing that no night has worked off yet keeps its scans, and so does one whose file is not sound.
    """
    worked_off = or_(exists().where(FIT.c.run == RUN.c.run), exists().where(UNFITTED.c.run == RUN.c.run))
    no_pressing = and_(PRESS.c.kind == "recorded", RUN.c.closed_s.is_(None))
    query = (
        select(ARCHIVE)
        .join(RUN, RUN.c.run == ARCHIVE.c.run)
        .join(PRESS, PRESS.c.press_id == RUN.c.press_id)
        .where(PRESS.c.name == press, ARCHIVE.c.removed_unix_s.is_(None), ARCHIVE.c.problem == "", *_over(before))
        .where(or_(worked_off, no_pressing))
        .order_by(RUN.c.run_number)
        .limit(limit)
    )
    with database.reading() as connection:
        folder = folder_of(connection)
        rows = connection.execute(query).all()
    problems = {row.run: _problem_of(folder, row) for row in rows}
    sound = [row for row in rows if problems[row.run] is None]
    now = unix_of(datetime.now(UTC))
    with database.writing() as connection:
        for run, problem in problems.items():
            found = {"removed_unix_s": now} if problem is None else {"problem": problem.code}
            connection.execute(update(ARCHIVE).where(ARCHIVE.c.run == run).values(found))
        gone = sum(row.bytes for row in sound)
        _count(connection, runs=-len(sound), bytes=-gone, removed=len(sound))
    _delete_files(database, folder)
    return len(sound), gone


def _delete_files(database: Database, folder: Path) -> None:
    """Delete the files of runs given up, also those that a killed job has left."""
    with database.reading() as connection:
        left = select(ARCHIVE.c.run, ARCHIVE.c.file).where(
            ARCHIVE.c.removed_unix_s.is_not(None), ARCHIVE.c.file != ""
        )
        rows = connection.execute(left).all()
    for path in _with_sums(path for row in rows for path in (folder / row.file, beside(folder / row.file))):
        with suppress(FileNotFoundError):
            path.unlink()
    with database.writing() as connection:
        _files_gone(connection, [row.run for row in rows])


def _files_gone(connection: Connection, runs: Sequence[str]) -> None:
    connection.execute(update(ARCHIVE).where(ARCHIVE.c.run.in_(runs)).values(file=""))


def _with_sums(files: Iterator[Path]) -> Iterator[Path]:
    for path in files:
        yield path
        yield path.with_name(path.name + SUM)


def without_scans(connection: Connection, runs: Sequence[str]) -> set[str]:
    """Return those of these runs whose scans were given up."""
    gone = select(ARCHIVE.c.run).where(ARCHIVE.c.run.in_(runs), ARCHIVE.c.removed_unix_s.is_not(None))
    return set(connection.execute(gone).scalars())
