"""The store as everybody uses it: one method, one transaction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from socket import gethostname
from types import TracebackType
from typing import Any, Literal

from sqlalchemy import text

from daq.records import Channel, PressEvent, Run, Scan
from daq.store import alarms, cores, journal, next_panel, nights, reading, recording, results, upkeep
from daq.store.convert import known_utc
from daq.store.database import BUSY_S, Database
from daq.store.origin import header_for_file
from daq.store.records import (
    CoefficientRecord,
    Delivery,
    DiagnosisRecord,
    JournalEntry,
    ModelRecord,
    ModelStatus,
    NewRun,
    NextPanel,
    Page,
    PressKey,
    ProcessStatus,
    RunChange,
    RunCore,
    RunEnd,
    RunRecord,
    RunStatus,
    ScanBatch,
    StandingAlarm,
    StoredAlarm,
    StoredEstimate,
    StoredNight,
    StoredPressEvent,
    Thresholds,
)
from daq.store.write_batch import Entry, WriteBatch, in_rows
from daq.words import Message


def open_store(url: str, *, create: bool = True, busy_s: float = BUSY_S, later: bool = False) -> Store:
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

    # --- recorder -----------------------------------------------------------------------------------

    def register_press(self, name: str, channels: Sequence[Channel], press_file: str = "") -> PressKey:
        """Prepare recording of a press with these channels; a recorder calls it once at start."""
        with self.database.writing() as connection:
            return recording.register_press(connection, name, channels, press_file, "recorded")

    def append_scans(
        self,
        key: PressKey,
        scans: Sequence[Scan],
        events: Sequence[PressEvent] = (),
        begin: NewRun | None = None,
        end: RunEnd | None = None,
    ) -> None:
        """Write scans and what they brought about in one commit.

        Writing the same scans again does no harm. A press event sets its moment in the open run.
        """
        with self.database.writing() as connection:
            recording.append(connection, key, scans, events, begin, end)

    def write_batches(self, batches: Sequence[WriteBatch], lines: Sequence[Entry] = ()) -> None:
        """Write several batches of `append_scans` and journal lines in one commit."""
        if not batches and not lines:
            return
        with self.database.writing() as connection:
            for p in in_rows(batches):
                recording.append(connection, p.key, p.scans, p.events, p.begin, p.end)
            for line in lines:
                at = known_utc(line.unix_s)
                journal.log(connection, line.level, line.process, line.message, line.press, line.detail, at)

    def try_to_write(self) -> None:
        """Raise what keeps anything from being written now."""
        with self.database.writing() as connection:
            connection.execute(text("SELECT 1"))

    def layout_of(self, press_id: int, press: str, channels: Sequence[Channel]) -> int:
        """Return the number of a press's layout with these channels, made where it is new."""
        with self.database.writing() as connection:
            return recording.layout_of(connection, press_id, press, channels)

    def interrupt_open_runs(self, press: str) -> list[str]:
        """Mark the runs a crash left open as interrupted; returns their names."""
        with self.database.writing() as connection:
            return recording.interrupt_open_runs(connection, press)

    def unused_run_name(self, press: str, when: datetime) -> str:
        """Return the next free name ``press-2026-03-04-07`` of the day."""
        with self.database.reading() as connection:
            return recording.unused_run_name(connection, press, when)

    def import_run(self, run: Run, press: str, press_file: str = "") -> str:
        """Store a run read from a file; returns its name. Raises `InputError` where the name is taken."""
        with self.database.writing() as connection:
            return recording.import_run(connection, run, press, press_file)

    def import_runs(self, runs: Sequence[Run], press: str, press_file: str = "") -> list[str]:
        """Store several runs, all or none; returns their names."""
        with self.database.writing() as connection:
            return [recording.import_run(connection, run, press, press_file) for run in runs]

    def annotate_run(self, run: str, changes: Mapping[str, Any], who: str) -> None:
        """Change header keys (``panel.density_kg_m3``) or ``remark``; None removes a key. History is kept."""
        with self.database.writing() as connection:
            recording.annotate_run(connection, run, changes, who)

    def next_panel(self, press: str) -> NextPanel | None:
        """Return what is said of the next panel of a press, None where nothing is."""
        with self.database.reading() as connection:
            return next_panel.next_panel(connection, press)

    def put_next_panel(self, press: str, header: Mapping[str, Any], recipe: str, who: str) -> None:
        """Say what the next panels of a press are; nothing, with neither header nor recipe.

        A recipe given with header keys is kept under its name; alone it stands for those kept.
        Raises `InputError`.
        """
        with self.database.writing() as connection:
            next_panel.put_next_panel(connection, press, header, recipe, who)

    def recipes(self) -> dict[str, dict[str, Any]]:
        """Return the header keys of all recipes by name."""
        with self.database.reading() as connection:
            return next_panel.recipes(connection)

    # --- runs and scans -----------------------------------------------------------------------------

    def presses(self) -> dict[str, str]:
        """Return the press file text of each press by name."""
        with self.database.reading() as connection:
            return reading.presses(connection)

    def channels(self, press: str) -> tuple[Channel, ...]:
        """Return the channels a press is recorded with now; empty where it never was."""
        with self.database.reading() as connection:
            return reading.channels(connection, press)

    def runs(
        self,
        *,
        cursor: str | None = None,
        limit: int = 50,
        press: str | None = None,
        status: RunStatus | None = None,
        material: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
    ) -> Page[RunRecord]:
        """Return a page of runs, newest first; `since` and `until` filter by their start."""
        wanted = {"press": press, "status": status, "material": material, "since": since, "until": until}
        with self.database.reading() as connection:
            return reading.runs(connection, cursor, limit, wanted)

    def run_record(self, run: str) -> RunRecord:
        """Return one run's record; raises `InputError` where there is none."""
        with self.database.reading() as connection:
            return reading.run_record(connection, run)

    def run_records(self, runs: Sequence[str]) -> dict[str, RunRecord]:
        """Return the records of these runs by name, all in one query."""
        with self.database.reading() as connection:
            return reading.run_records(connection, runs)

    def run_cores(self, runs: Sequence[str]) -> dict[str, RunCore]:
        """Return core and band at opening and the highest core of each run that has a valid estimate."""
        with self.database.reading() as connection:
            return cores.run_cores(connection, runs)

    def open_run(self, press: str) -> RunRecord | None:
        """Return the run being recorded now, or None."""
        with self.database.reading() as connection:
            return reading.open_run(connection, press)

    def ended_runs_after(self, press: str, number: int, limit: int = 1000) -> list[RunRecord]:
        """Return a press's recorded runs that are over and end after scan `number`, oldest first."""
        with self.database.reading() as connection:
            return reading.ended_runs_after(connection, press, number, limit)

    def load_run(
        self,
        run: str,
        columns: Sequence[str] | None = None,
        from_s: float | None = None,
        to_s: float | None = None,
    ) -> Run:
        """Return a run with its data, of an open run those so far; unusable values are NaN."""
        with self.database.reading() as connection:
            return reading.load_run(connection, run, columns, from_s, to_s)

    def run_for_file(
        self,
        run: str,
        columns: Sequence[str] | None = None,
        from_s: float | None = None,
        to_s: float | None = None,
    ) -> Run:
        """Return a run as `load_run` does, with what a file carries on: start, life, remark, texts."""
        with self.database.reading() as connection:
            loaded = reading.load_run(connection, run, columns, from_s, to_s)
            said = reading.remarks_of(connection, run, from_s, to_s) if columns is None else {}
            header = header_for_file(reading.run_record(connection, run))
            return replace(loaded, header=header, texts={**loaded.texts, **said})

    def units_of(self, run: str) -> dict[str, str]:
        """Return the unit of each column of a run, as far as it is known."""
        with self.database.reading() as connection:
            return reading.units_of(connection, run)

    def run_changes(self, run: str) -> list[RunChange]:
        """Return the edits of a run's metadata, oldest first."""
        with self.database.reading() as connection:
            return [RunChange(*row) for row in recording.run_changes(connection, run)]

    def configuration_of(self, run: str) -> str:
        """Return the settings (TOML text) a run was recorded with; empty where none were kept."""
        with self.database.reading() as connection:
            return reading.configuration_of(connection, run)

    def newest_scan_number(self, press: str) -> int:
        """Return the number of the press's newest scan, -1 where there is none."""
        with self.database.reading() as connection:
            return reading.newest_number(connection, press)

    def scans_after(self, press: str, last_number: int, limit: int = 1000) -> ScanBatch:
        """Return the scans that follow `last_number` (start with -1, go on with the last one's number)."""
        with self.database.reading() as connection:
            return reading.scans_after(connection, press, last_number, limit)

    def press_events(
        self, press: str | None = None, after: int = 0, limit: int = 1000, since_scan: int | None = None
    ) -> list[StoredPressEvent]:
        """Return press events after row `after`, oldest first."""
        with self.database.reading() as connection:
            return reading.press_events(connection, press, after, limit, since_scan)

    # --- live sensor --------------------------------------------------------------------------------

    def append_estimates(self, press: str, estimates: Sequence[StoredEstimate]) -> None:
        """Write what the live sensor said; a second estimate of a scan replaces the first."""
        with self.database.writing() as connection:
            press_id = reading.recorded_id(connection, press)
            if press_id is not None:
                results.append_estimates(connection, press_id, estimates)

    def newest_estimate_number(self, press: str) -> int:
        """Return the scan of the newest estimate, -1 where there is none."""
        with self.database.reading() as connection:
            return results.newest_estimate_number(connection, press)

    def last_scan_followed(self, press: str) -> int:
        """Return up to which scan every run has all its estimates, -1 where there are none."""
        with self.database.reading() as connection:
            return results.last_scan_followed(connection, press)

    def estimates_after(self, press: str, last_number: int, limit: int = 1000) -> tuple[StoredEstimate, ...]:
        """Return the estimates that follow scan `last_number`."""
        with self.database.reading() as connection:
            return results.estimates_after(connection, press, last_number, limit)

    def estimates(self, run: str) -> tuple[tuple[float, StoredEstimate], ...]:
        """Return (time_s in the run, estimate) of a run's scans."""
        with self.database.reading() as connection:
            return results.estimates_of(connection, run)

    # --- fits, models, diagnoses --------------------------------------------------------------------

    def put_fit(self, run: str, fit: Mapping[str, Any], model_version: str = "") -> int:
        """Keep a run's fit: one entry of ``runs`` of ``fit --json``. The newest fit of a run counts."""
        with self.database.writing() as connection:
            return results.put_fit(connection, run, fit, model_version)

    def fit(self, run: str) -> dict[str, Any] | None:
        """Return the newest fit of a run as JSON with ``model_version``, or None."""
        with self.database.reading() as connection:
            return results.fit_of(connection, run)

    def fits(self, runs: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Return the newest fit of each of these runs that has one, all in one query."""
        with self.database.reading() as connection:
            return results.fits_of(connection, runs)

    def fit_errors(self, runs: Sequence[str]) -> dict[str, float | None]:
        """Return ``rmse_K`` of the newest fit of each of these runs that has one."""
        with self.database.reading() as connection:
            return results.fit_errors(connection, runs)

    def coefficient_history(
        self, *, press: str | None = None, cursor: str | None = None, limit: int = 200
    ) -> Page[CoefficientRecord]:
        """Return the coefficients of each run's newest fit, the run pressed last first; `limit` counts runs."""
        with self.database.reading() as connection:
            return results.coefficient_history(connection, press, cursor, limit)

    def newest_fit_number(self, press: str | None = None) -> int:
        """Return the number of the fit stored last, 0 where there is none."""
        with self.database.reading() as connection:
            return results.newest_fit_number(connection, press)

    def fits_after(self, number: int, limit: int = 200) -> tuple[tuple[int, str], ...]:
        """Return number and run of the newest fits stored after fit `number`, oldest first, for followers."""
        with self.database.reading() as connection:
            return results.fits_after(connection, number, limit)

    def put_model(
        self,
        press: str,
        version: str,
        model: Mapping[str, Any],
        *,
        status: ModelStatus = ModelStatus.CANDIDATE,
        reason: str = "",
    ) -> int:
        """Keep a model version (the JSON of the model file); raises `InputError` where it exists."""
        with self.database.writing() as connection:
            return results.put_model(connection, press, version, model, status, reason)

    def promote_model(self, version: str, who: str, reason: Message | str = "") -> None:
        """Make a version the live sensor's; the one before is retired; the journal says who did it."""
        with self.database.writing() as connection:
            results.promote_model(connection, version, who, reason)

    def active_model(self, press: str) -> ModelRecord | None:
        """Return the promoted model of a press, or None."""
        with self.database.reading() as connection:
            return results.active_model(connection, press)

    def model(self, version: str) -> ModelRecord:
        """Return one model version; raises `InputError` where there is none."""
        with self.database.reading() as connection:
            return results.model(connection, version)

    def models(self, *, press: str | None = None, cursor: str | None = None, limit: int = 50) -> Page[ModelRecord]:
        """Return a page of model versions, newest first."""
        with self.database.reading() as connection:
            return results.models(connection, press, cursor, limit)

    def put_diagnosis(self, press: str, diagnosis: Mapping[str, Any]) -> int:
        """Keep a diagnosis as ``diagnose --json`` writes it."""
        with self.database.writing() as connection:
            return results.put_diagnosis(connection, press, diagnosis)

    def diagnoses(
        self, *, press: str | None = None, cursor: str | None = None, limit: int = 50
    ) -> Page[DiagnosisRecord]:
        """Return a page of diagnoses, newest first."""
        with self.database.reading() as connection:
            return results.diagnoses(connection, press, cursor, limit)

    # --- nights -------------------------------------------------------------------------------------

    def put_night(self, night: StoredNight) -> int:
        """Keep what the nightly job did for a press; returns the night's number."""
        with self.database.writing() as connection:
            return nights.put_night(connection, night)

    def nights(self, *, press: str | None = None, cursor: str | None = None, limit: int = 50) -> Page[StoredNight]:
        """Return a page of nights, newest first."""
        with self.database.reading() as connection:
            return nights.nights(connection, press, cursor, limit)

    def newest_nights(self) -> dict[str, StoredNight]:
        """Return the newest night of each press."""
        with self.database.reading() as connection:
            return nights.newest_nights(connection)

    def pressings(
        self, press: str, *, after: int | None = None, below: int | None = None, limit: int = 200
    ) -> list[RunRecord]:
        """Return finished pressings numbered above `after`, oldest first; without it the newest, newest first."""
        with self.database.reading() as connection:
            return nights.pressings(connection, press, after, below, limit)

    def count_pressings(self, press: str, *, below: int | None = None) -> int:
        """Return how many finished pressings of a press there are, or those numbered below `below`."""
        with self.database.reading() as connection:
            return nights.count_pressings(connection, press, below)

    def edited_after(self, press: str, number: int) -> tuple[int, list[str]]:
        """Return the number of the newest edit, and the runs of a press edited after edit `number`."""
        with self.database.reading() as connection:
            return nights.edited_after(connection, press, number)

    def put_unfitted(
        self, run: str, press: str, kind: Literal["unfit", "blind", "killed"], fingerprint: str
    ) -> None:
        """Keep that a run has no fit, until it gets one: nothing to fit, not to be fitted, or workers killed."""
        with self.database.writing() as connection:
            nights.put_unfitted(connection, run, press, kind, fingerprint)

    def unfitted_marks(self, runs: Sequence[str]) -> dict[str, str]:
        """Return with what those of these runs were tried that have no fit."""
        with self.database.reading() as connection:
            return nights.unfitted_marks(connection, runs)

    def killed_runs(self, press: str, limit: int = 200) -> list[str]:
        """Return runs of a press over which workers were killed."""
        with self.database.reading() as connection:
            return nights.killed_runs(connection, press, limit)

    def count_unfitted(self, press: str) -> Mapping[str, int]:
        """Return how many runs of a press have no fit, by kind."""
        with self.database.reading() as connection:
            return nights.count_unfitted(connection, press)

    # --- alarms -------------------------------------------------------------------------------------

    def watch_alarms(self, standing: Sequence[StandingAlarm], ways: Sequence[str], now: datetime) -> int:
        """Take up what stands and the journal's new alarms, each once; return how many are new."""
        with self.database.writing() as connection:
            return alarms.watch(connection, standing, ways, now)

    def alarms(
        self,
        *,
        press: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
        pending: bool = False,
    ) -> Page[StoredAlarm]:
        """Return a page of alarms, newest first; `pending` ones stand, or nobody has acknowledged them."""
        with self.database.reading() as connection:
            return alarms.alarms(connection, press, cursor, limit, pending=pending)

    def acknowledge_alarm(self, number: int, who: str) -> StoredAlarm:
        """Note who has taken an alarm on; the first one counts. Raises `InputError` where there is none."""
        with self.database.writing() as connection:
            return alarms.acknowledge(connection, number, who)

    def take_delivery(self, ways: Sequence[str], now: datetime) -> Delivery | None:
        """Take the delivery that has waited longest in hand, None where none is due."""
        with self.database.writing() as connection:
            return alarms.take_delivery(connection, ways, now)

    def delivered(self, delivery: Delivery, now: datetime) -> None:
        """Note that a receiver has taken an alarm."""
        with self.database.writing() as connection:
            alarms.delivered(connection, delivery, now)

    def put_off(self, delivery: Delivery, why: str, now: datetime) -> None:
        """Note why a receiver has not taken an alarm; it is tried again later."""
        with self.database.writing() as connection:
            alarms.put_off(connection, delivery, why, now)

    def alarm_thresholds(self) -> dict[str, Thresholds]:
        """Return the limits set for each press."""
        with self.database.reading() as connection:
            return alarms.thresholds(connection)

    def put_alarm_thresholds(self, press: str, limits: Mapping[str, Any], who: str) -> None:
        """Replace the limits set for a press."""
        with self.database.writing() as connection:
            alarms.put_thresholds(connection, press, limits, who)

    # --- journal and status -------------------------------------------------------------------------

    def log(
        self,
        level: Literal["info", "warning", "alarm"],
        process: str,
        message: Message | str,
        press: str | None = None,
        detail: Mapping[str, Any] | None = None,
        utc: datetime | None = None,
    ) -> None:
        """Add a line to the journal: changes of state, losses, who did what. `utc`: when, where not now."""
        with self.database.writing() as connection:
            journal.log(connection, level, process, message, press, detail, utc)

    def journal(
        self,
        *,
        press: str | None = None,
        level: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> Page[JournalEntry]:
        """Return a page of the journal, newest first."""
        with self.database.reading() as connection:
            return journal.journal(connection, press, level, cursor, limit)

    def journal_after(self, after: int, limit: int = 1000) -> tuple[JournalEntry, ...]:
        """Return journal lines after row `after`, oldest first, for followers."""
        with self.database.reading() as connection:
            return journal.journal_after(connection, after, limit)

    def beat(self, process: str, status: Mapping[str, Any]) -> None:
        """Write a process's sign of life, about once a second."""
        with self.database.writing() as connection:
            results.beat(connection, process, status)

    def beats_as(self, process: str) -> str:
        """Return the name of a process of this machine; with the host where several machines meet in one store."""
        return process if self.database.path is not None else f"{process}@{gethostname()}"

    def statuses(self) -> dict[str, ProcessStatus]:
        """Return the newest sign of life of each process."""
        with self.database.reading() as connection:
            return results.statuses(connection)

    # --- upkeep -------------------------------------------------------------------------------------

    def back_up(self, target: Path) -> upkeep.Contents:
        """Copy the store into a new, checked SQLite file while others write; `upkeep.restore` reads it."""
        return upkeep.back_up(self.database, target)

    def contents(self) -> upkeep.Contents:
        """Return how many runs, scans, fits and models there are."""
        return upkeep.contents_of(self.database)

    def thin_idle(self, before: datetime, keep_every: int = 100, done: dict[int, int] | None = None) -> int:
        """Delete some idle scans older than `before`, all but every `keep_every`-th; runs stay whole.

        Hand in the same `done` each time: it keeps how far each press is thinned already.
        """
        return upkeep.thin_idle(self.database, before, keep_every, done=done)

    def sizes(self) -> upkeep.Sizes:
        """Return size, cost of a scan and free space."""
        return upkeep.sizes_of(self.database)
