"""The store as everybody uses it: one method, one transaction."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import datetime
from functools import wraps
from pathlib import Path
from socket import gethostname
from types import TracebackType
from typing import Concatenate, ParamSpec, TypeVar

from sqlalchemy import Connection

from daq.address import Address
from daq.records import Run
from daq.store import (
    alarms,
    archive,
    archived,
    cores,
    envelope,
    imports,
    journal,
    next_panel,
    night_lock,
    nights,
    press_layouts,
    reading,
    recording,
    results,
    run_headers,
    run_scans,
    standing,
    upkeep,
)
from daq.store.archive import Checked
from daq.store.database import BUSY_S, Database
from daq.store.last_written import LastWritten
from daq.store.origin import header_for_file
from daq.store.records import Moved
from daq.store.write_batch import Entry, WriteBatch, in_rows

P = ParamSpec("P")
T = TypeVar("T")


def open_store(url: str | Address, *, create: bool = True, busy_s: float = BUSY_S, later: bool = False) -> Store:
    """Open a store by file path, ``sqlite:///path`` or ``postgresql://user@host/name``; make it if needed.

    Any number of processes and threads may have it open. `busy_s` is the longest wait for another
    process's transaction. With `later` a store that is away now is opened by the first call that succeeds.

    Raises
    ------
    InputError
        For a wrong URL or path, or a store made by a newer version.
    StoreUnavailable
        Where the disk or the server refuses.
    """
    return Store(Database(url, create=create, busy_s=busy_s, later=later))


def _reads(ask: Callable[Concatenate[Connection, P], T]) -> Callable[Concatenate[Store, P], T]:
    """Make a method of a function that reads within one transaction."""

    @wraps(ask)
    def method(store: Store, /, *given: P.args, **named: P.kwargs) -> T:
        with store.database.reading() as connection:
            return ask(connection, *given, **named)

    return method


def _writes(do: Callable[Concatenate[Connection, P], T]) -> Callable[Concatenate[Store, P], T]:
    """Make a method of a function that writes within one transaction."""

    @wraps(do)
    def method(store: Store, /, *given: P.args, **named: P.kwargs) -> T:
        with store.database.writing() as connection:
            return do(connection, *given, **named)

    return method


class Store:
    """Scans, runs, estimates, fits, models, diagnoses, journal and status of all presses.

    Every method may raise `StoreUnavailable` (try again later; the text says what to do). A method that
    writes has written durably when it returns, and nothing when it raises.
    """

    def __init__(self, database: Database) -> None:
        self.database = database

    @property
    def label(self) -> str:
        """The store's path or URL without its password, for messages."""
        return self.database.label

    def close(self) -> None:
        """Release all connections. A second call does no harm."""
        self.database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # A method called as the module of its function comes last in its part: it hides the module from there on.

    # --- recorder -----------------------------------------------------------------------------------

    register_press = _writes(press_layouts.register_press)
    append_scans = _writes(recording.append)
    append_remarks = _writes(imports.append_remarks)
    interrupt_open_runs = _writes(recording.interrupt_open_runs)
    unused_run_name = _reads(recording.unused_run_name)
    import_run = _writes(imports.import_run)
    annotate_run = _writes(run_headers.annotate_run)
    put_next_panel = _writes(next_panel.put_next_panel)
    recipes = _reads(next_panel.recipes)
    next_panel = _reads(next_panel.next_panel)

    def write_batches(
        self,
        batches: Sequence[WriteBatch],
        lines: Sequence[Entry] = (),
        so_far: Mapping[str, LastWritten] | None = None,
    ) -> dict[str, int]:
        """Write several batches of `append_scans` and journal lines in one commit.

        In a store that lacks what was written `so_far`, runs that are open without being the one under way are
        over. Returns by press what `press_layouts.newest_of` gave before. Raises `PressGone` where another store
        is there.
        """
        if not batches and not lines:
            return {}
        with self.database.writing() as connection:
            self.database.check_whole(connection)
            newest = press_layouts.newest_of(connection, (p.key for p in batches), self.label)
            recording.end_runs_left_open(connection, newest, so_far or {})
            keys = press_layouts.with_layouts(connection, (p.key for p in batches))
            for p in in_rows(batches):
                recording.append(connection, keys[p.key], p.scans, p.events, p.begin, p.end)
            journal.write_new(connection, lines)
        return newest

    def try_to_write(self) -> None:
        """Raise what keeps anything from being written now."""
        with self.database.writing() as connection:
            self.database.check_whole(connection)

    def import_runs(self, runs: Sequence[Run], press: str, press_file: str = "") -> list[str]:
        """Store several runs, all or none; returns their names."""
        with self.database.writing() as connection:
            return [imports.import_run(connection, run, press, press_file) for run in runs]

    # --- runs and scans -----------------------------------------------------------------------------

    presses = _reads(reading.presses)
    channels = _reads(reading.channels)
    runs = _reads(reading.runs)
    run_record = _reads(reading.run_record)
    run_records = _reads(reading.run_records)
    has_run = _reads(reading.has_run)
    damaged_runs = _reads(reading.damaged_runs)
    run_changes = _reads(run_headers.run_changes)
    run_cores = _reads(cores.run_cores)
    open_run = _reads(reading.open_run)
    ended_runs_after = _reads(reading.ended_runs_after)
    load_run = _reads(run_scans.load_run)
    columns_of = _reads(run_scans.columns_of)
    units_of = _reads(run_scans.units_of)
    configuration_of = _reads(reading.configuration_of)
    newest_scan_number = _reads(reading.newest_number)
    scans_after = _reads(reading.scans_after)
    press_events = _reads(reading.press_events)
    standing = _reads(standing.standing)
    envelope = _reads(envelope.envelope)

    def run_for_file(
        self,
        run: str,
        columns: Sequence[str] | None = None,
        from_s: float | None = None,
        to_s: float | None = None,
    ) -> Run:
        """Return a run as `load_run` does, with what a file carries on: start, life, remark, texts."""
        with self.database.reading() as connection:
            loaded = run_scans.load_run(connection, run, columns, from_s, to_s, words=columns is None)
            return replace(loaded, header=header_for_file(reading.run_record(connection, run)))

    # --- live sensor --------------------------------------------------------------------------------

    append_estimates = _writes(results.append_estimates)
    newest_estimate_number = _reads(results.newest_estimate_number)
    last_scan_followed = _reads(results.last_scan_followed)
    estimates_after = _reads(results.estimates_after)
    estimates = _reads(results.estimates_of)

    # --- fits, models, diagnoses --------------------------------------------------------------------

    put_fit = _writes(results.put_fit)
    fit = _reads(results.fit_of)
    fits = _reads(results.fits_of)
    fit_errors = _reads(results.fit_errors)
    coefficient_history = _reads(results.coefficient_history)
    newest_fit_number = _reads(results.newest_fit_number)
    fits_after = _reads(results.fits_after)
    put_model = _writes(results.put_model)
    promote_model = _writes(results.promote_model)
    active_model = _reads(results.active_model)
    model = _reads(results.model)
    models = _reads(results.models)
    put_diagnosis = _writes(results.put_diagnosis)
    diagnoses = _reads(results.diagnoses)

    # --- nights -------------------------------------------------------------------------------------

    def only_night(self, press: str) -> AbstractContextManager[None]:
        """Hold a press's nights against other jobs; raises `InputError` where another one works on it."""
        return night_lock.only_night(self.database, press)

    put_night = _writes(nights.put_night)
    newest_nights = _reads(nights.newest_nights)
    pressings = _reads(nights.pressings)
    count_pressings = _reads(nights.count_pressings)
    edited_after = _reads(nights.edited_after)
    put_unfitted = _writes(nights.put_unfitted)
    unfitted_marks = _reads(nights.unfitted_marks)
    killed_runs = _reads(nights.killed_runs)
    earlier_alike = _reads(nights.earlier_alike)
    count_unfitted = _reads(nights.count_unfitted)
    nights = _reads(nights.nights)

    # --- alarms -------------------------------------------------------------------------------------

    alarm_clock = _reads(alarms.shared_clock)
    watch_alarms = _writes(alarms.watch)
    acknowledge_alarm = _writes(alarms.acknowledge)
    take_delivery = _writes(alarms.take_delivery)
    delivered = _writes(alarms.delivered)
    put_off = _writes(alarms.put_off)
    alarm_thresholds = _reads(alarms.thresholds)
    put_alarm_thresholds = _writes(alarms.put_thresholds)
    alarms = _reads(alarms.alarms)

    # --- journal and status -------------------------------------------------------------------------

    log = _writes(journal.log)
    note = _writes(journal.note)
    press_journal = _reads(reading.press_journal)
    journal_after = _reads(journal.journal_after)
    beat = _writes(results.beat)
    statuses = _reads(results.statuses)
    journal = _reads(journal.journal)

    def beats_as(self, process: str) -> str:
        """Return the name of a process of this machine; with the host where several machines meet in one store."""
        return process if self.database.path is not None else f"{process}@{gethostname()}"

    # --- archive ------------------------------------------------------------------------------------

    runs_to_archive = _reads(archive.runs_to_archive)

    def use_archive(self, folder: Path) -> None:
        """Make a folder the store's archive, or see that it still is; raises `InputError` where it cannot be."""
        archive.use_archive(self.database, folder)

    def archive_run(self, run: str) -> Moved:
        """Move a run's scans into a file of the archive, proved before they are deleted."""
        return archive.archive_run(self.database, run)

    def check_archive(self, before: datetime, limit: int = 100) -> Checked:
        """Hold the sums of files that were not read since an instant against them; nothing is deleted."""
        return archive.check_archive(self.database, before, limit)

    def recheck_unsound(self, before: datetime) -> None:
        """Let files that were found unsound, and not read since an instant, come first at the next look."""
        archive.recheck_unsound(self.database, before)

    def remove_archived(self, press: str, before: datetime, limit: int = 50) -> tuple[int, int]:
        """Give up archived scans of runs that old; their pressings stay. Returns runs and bytes."""
        return archive.remove_archived(self.database, press, before, limit)

    without_scans = _reads(archive.without_scans)
    archive = _reads(archived.archive)

    # --- upkeep -------------------------------------------------------------------------------------

    def back_up(self, target: Path) -> upkeep.Contents:
        """Copy the store into a new, checked SQLite file while others write; `upkeep.restore` reads it."""
        return upkeep.back_up(self.database, target)

    def contents(self) -> upkeep.Contents:
        """Return how many runs, scans, fits and models there are."""
        return upkeep.contents_of(self.database)

    def thin_idle(self, before: datetime, keep_every: int = 100) -> Iterator[int]:
        """Delete idle scans older than `before`, all but every `keep_every`-th; runs stay whole.

        Yields how many went with each piece; what is thinned already is not gone through again.
        """
        return upkeep.thin_idle(self.database, before, keep_every)

    def sizes(self) -> upkeep.Sizes:
        """Return size, cost of a scan and free space."""
        return upkeep.sizes_of(self.database)
