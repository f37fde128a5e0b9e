"""A store from Python: its runs, scans, estimates, coefficients and events as pandas tables.

Nothing but `play` writes.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
import types
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from daq.files.frames import frame_of, run_of
from daq.files.instants import STARTED
from daq.files.qualities import OTHERS, row_faults
from daq.files.run_file import read_run
from daq.files.run_rows import check_no_words
from daq.given import number_of, path_of, refused
from daq.press.detector import PressEventDetector
from daq.press.events import find_moments as find_run_moments
from daq.press.faces import columns_of
from daq.press.press_file import Press, overridden, read_press
from daq.press.wires import Wires
from daq.printed import in_short
from daq.records import Channel, InputError, Moments, Quality, Run, Scan
from daq.store.imports import remarks_in
from daq.store.records import NewRun, RunEnd, every
from daq.store.store import Store
from daq.store.store import open_store as open_database
from daq.words import say

LONG_ROWS = 20_000
"""From so many rows on press events are looked for in the table as a whole: scan by scan a row takes 25 us, while
loading what is compiled for it takes 0.5 s (2026-11-30; ``tests/benchmarks/test_find_events.py``)."""

# Numbers without another source were set by hand, 2026-11.

AnyRun: TypeAlias = Run | pd.DataFrame | Path | str

HISTORY_ROWS = 200
"""Rows asked of the store at a time."""

RUN = ("press", "status", "started_utc", "closed_s", "opened_s", "remark")
ESTIMATE = ("state", "core_C", "core_sd_K", "core_low_C", "core_high_C", "valid", "reason", "model_version")
COEFFICIENT = ("started_utc", "coefficient", "value", "sd", "low", "high", "identifiable", "model_version")
ENTRY = ("level", "process", "press", "code", "message")
EVENT = ("event", "noticed_s", "source")
"""Columns of the tables, beside their index."""


@dataclass(frozen=True)
class StoreTables:
    """An open store. Close it, or use it in a ``with`` statement; closed, it is refused (`InputError`)."""

    store: Store
    """What the tables are read from."""
    _closed: threading.Event = field(default_factory=threading.Event, init=False, repr=False, compare=False)

    def __repr__(self) -> str:
        """Return which store it is."""
        return f"StoreTables {self.store.label}"

    def runs(self, press: str | None = None) -> pd.DataFrame:
        """Return one row a run, newest first, with the keys of its header.

        A run that is damaged in the store has none, and says why in the column ``damage``, there only then.
        """
        found = every(lambda cursor: self._opened().runs(press=press, cursor=cursor, limit=HISTORY_ROWS))
        rows = [
            {"run": r.run, "press": r.press, "status": str(r.status), "started_utc": r.started_utc}
            | {"closed_s": r.moments.closed_s, "opened_s": r.moments.opened_s, "remark": r.remark}
            | {key: value for key, value in r.header.items() if key != "run"}
            | ({} if r.damage is None else {"damage": str(r.damage)})
            for r in found
        ]
        return _table(rows, "run", RUN)

    def samples(self, run: str, *, utc: bool = False) -> pd.DataFrame:
        """Return a run's scans by ``time_s`` or by instants in UTC, header in ``attrs``. Raises `InputError`.

        The header is that of an exported file: it also knows when the run began, and what the store knows of it.
        """
        self._check_known(run)
        return frame_of(self._opened().run_for_file(run), utc=utc)

    def estimates(self, run: str) -> pd.DataFrame:
        """Return the live sensor's estimates of a run, indexed by ``time_s``. Raises `InputError`."""
        self._check_known(run)
        rows = [
            {"time_s": time_s, "state": str(e.state), "core_C": e.core_celsius, "core_sd_K": e.core_sd_kelvin}
            | {"core_low_C": e.core_low_celsius, "core_high_C": e.core_high_celsius}
            | {"valid": e.valid, "reason": e.reason, "model_version": e.model_version}
            for time_s, e in self._opened().estimates(run)
        ]
        return _table(rows, "time_s", ESTIMATE)

    def coefficients(self, press: str | None = None) -> pd.DataFrame:
        """Return one row a run and coefficient of its newest fit: value, sd, 95 % interval. [W/m²K]"""
        found = every(lambda at: self._opened().coefficient_history(press=press, cursor=at, limit=HISTORY_ROWS))
        rows = [
            {"run": c.run, "started_utc": c.started_utc, "coefficient": c.name, "value": c.value, "sd": c.sd}
            | {"low": c.low, "high": c.high, "identifiable": c.identifiable, "model_version": c.model_version}
            for c in found
        ]
        return _table(rows, "run", COEFFICIENT)

    def events(self, press: str | None = None) -> pd.DataFrame:
        """Return the journal, newest first: what was lost, changed, promoted, alarmed."""
        found = every(lambda cursor: self._opened().journal(press=press, cursor=cursor, limit=HISTORY_ROWS))
        rows = [
            {"utc": e.utc, "level": e.level, "process": e.process, "press": e.press}
            | {"code": e.message.code, "message": str(e.message)}
            for e in found
        ]
        return _table(rows, "utc", ENTRY)

    def close(self) -> None:
        """Let go of the database. A second call does no harm."""
        self._closed.set()
        self.store.close()

    def _check_known(self, run: str) -> None:
        """Refuse a run that the store does not have. Raises `InputError`."""
        if not self._opened().has_run(str(run)):
            raise InputError(say("store-run-missing-here", run=str(run), store=self.store.label))

    def _opened(self) -> Store:
        """Return the store. Raises `InputError` once it is closed."""
        if self._closed.is_set():
            raise InputError(say("store-is-closed", store=self.store.label))
        return self.store

    def __enter__(self) -> StoreTables:
        """Enter a ``with`` statement."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: types.TracebackType | None
    ) -> None:
        """Close it."""
        self.close()


def open_store(url: str | Path) -> StoreTables:
    """Open a store that there is, by its file or its ``postgresql://`` address.

    Raises
    ------
    InputError
        For a wrong address, a file that is not there or is no store, or a store made by a newer version.
    StoreUnavailable
        Where the disk or the server refuses now.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from daq import shared_files
    >>> with TemporaryDirectory() as folder:
    ...     play(shared_files() / "samples" / "2026-03-04-07.csv", f"{folder}/runs.sqlite", "lab", scans=200)
    ...     with open_store(f"{folder}/runs.sqlite") as store:
    ...         store.runs()["status"].to_dict(), store.samples("2026-03-04-07")["platen_top"].size
    ({'2026-03-04-07': 'closed'}, 127)
    """
    return StoreTables(open_database(_address(url), create=False))


def play(run: AnyRun, store: Path | str, press: str, *, scans: int = 1, pause_s: float = 0.0) -> None:
    """Write a run into a store as a recorder does while it is pressed, to try without a press what reads along.

    Qualities and the texts of its rows go with it, and the remark in its header.

    Parameters
    ----------
    store
        Its file, which is made if it is not there, or its ``postgresql://`` address.
    press
        The name under which the store knows the press.
    scans, pause_s
        So many at once, and how long to wait after them. [s]

    Raises
    ------
    InputError
        For a wrong address or name of a press, a run whose name the store has already, and less than one scan at
        once or a pause below nothing.
    StoreUnavailable
        Where the disk or the server refuses now.
    """
    if not isinstance(press, str) or not press:
        raise refused(press, "given-no-press-name")
    if isinstance(scans, bool) or not isinstance(scans, int) or scans < 1:
        raise InputError(say("play-scans", value=in_short(scans)))
    if not 0.0 <= number_of(pause_s) < math.inf:
        raise InputError(say("play-pause", value=in_short(pause_s)))
    played = _run(run)
    started = played.header.get(STARTED)
    began = started if isinstance(started, datetime) and started.tzinfo else datetime.now(UTC)
    with open_database(_address(store)) as opened:
        if opened.has_run(played.name):
            raise InputError(say("store-run-taken", file=played.source or played.name, run=played.name))
        key = opened.register_press(press, [Channel(name) for name in played.columns])
        rows = _scans_of(played, began, key.next_number)
        remarks = {key.next_number + i: texts for i, texts in remarks_in(played)}
        begin: NewRun | None = NewRun(played.name, key.next_number, began, 0.0, played.header)
        for first in range(0, len(rows), scans):
            newest = rows[first : first + scans]
            opened.append_scans(key, newest, begin=begin)
            if texts := [(scan.number, remarks[scan.number]) for scan in newest if scan.number in remarks]:
                opened.append_remarks(key, texts)
            begin = None
            time.sleep(pause_s)
        opened.append_scans(key, [], end=RunEnd(played.name, rows[-1].number, rows[-1].utc))


def _scans_of(run: Run, began: datetime, first: int) -> list[Scan]:
    """Return a run's rows as scans from number `first` on; a value missing without a quality is ``missing``."""
    columns, faults, scans = [values.tolist() for values in run.columns.values()], row_faults(run), []
    for i, time_s in enumerate(run.time_s.tolist()):
        values, named = tuple(column[i] for column in columns), faults[i] if faults else {}
        qualities = tuple(
            named.get(name, named.get(OTHERS, Quality.MISSING if math.isnan(value) else Quality.GOOD))
            for name, value in zip(run.columns, values, strict=True)
        )
        scans.append(Scan(first + i, began + timedelta(seconds=time_s), time_s, values, qualities))
    return scans


def find_moments(run: AnyRun, press: Press | Path | str) -> Moments:
    """Return when the press closed and opened in a run, and when the panel came and went. [s of the run]

    Raises
    ------
    InputError
        For a run without any column of the press's faces or wires, and words in one of these.

    Examples
    --------
    >>> from daq import shared_files
    >>> run, press = shared_files() / "samples" / "2026-03-04-07.csv", shared_files() / "presses" / "lab.toml"
    >>> moments = find_moments(run, press)
    >>> round(moments.opened_s - moments.closed_s), str(moments.source)
    (31, 'temperatures')
    """
    found, own, _ = _showing(_run(run), _press(press))
    return find_run_moments(found, own)


def find_events(table: AnyRun, press: Press | Path | str) -> pd.DataFrame:
    """Find every press event of a table, which may hold many pressings: one row an event, by ``time_s``.

    Causal, as the recorder finds them: an event rests on the rows up to ``noticed_s``. Columns are ``event``
    (inserted, closed, opened, removed), ``noticed_s`` and ``source``; where the run's header knows its start,
    ``utc`` too. For one pressing `find_moments` places the moments better, with both sides of each known.

    Raises
    ------
    InputError
        For a table without any column of the press's faces or wires, and words in one of these.

    Examples
    --------
    >>> from daq import shared_files
    >>> run, press = shared_files() / "samples" / "2026-03-04-07.csv", shared_files() / "presses" / "lab.toml"
    >>> find_events(run, press)["event"].tolist()
    ['inserted', 'closed', 'opened']
    """
    run, own, detector = _showing(_run(table), _press(press))
    names = detector.looks_at(tuple(run.columns))
    found = []
    whole = len(run.time_s) >= LONG_ROWS and bool((np.diff(run.time_s) >= 0.0).all())  # no clock was set back
    if whole and set(detector.wires.columns).isdisjoint(names):
        from daq.press.table_events import table_events  # loads slowly, and is worth it for a long table alone

        found = table_events(run.time_s, {name: run.columns[name] for name in names}, own)
    else:
        readings = (
            zip(*(run.columns[name].tolist() for name in names), strict=True) if names else itertools.repeat(())
        )
        for time_s, row in zip(run.time_s.tolist(), readings, strict=False):
            found += detector.update(time_s, dict(zip(names, row, strict=True)))
    rows = [
        {"time_s": e.monotonic_s, "event": str(e.kind), "noticed_s": e.noticed_s, "source": str(e.source)}
        for e in found
    ]
    events = _table(rows, "time_s", EVENT)
    if rows and isinstance(started := run.header.get(STARTED), datetime):
        events["utc"] = pd.Timestamp(started) + pd.to_timedelta(events.index, unit="s")
    return events


def _showing(run: Run, press: Press) -> tuple[Run, Press, PressEventDetector]:
    """Return a run, its press as the run's header has it, and what finds that press's events.

    Raises `InputError` for a run in which the press cannot be seen, and for words where it is looked for.
    """
    own = overridden(press, run.header, run.source or run.name)
    detector, names = PressEventDetector(own), tuple(run.columns)
    for column in detector.looks_at(tuple(run.texts)):
        check_no_words(run.source or run.name, column, run.texts[column])
    seen = {*itertools.chain(*columns_of(own).of_face(names)), *Wires(own.press).columns}
    if own.has_states and seen.isdisjoint(names):
        raise InputError(say("run-press-state-unknown", run=run.source or run.name))
    return run, own, detector


def _run(given: AnyRun) -> Run:
    if isinstance(given, pd.DataFrame):
        return run_of(given)
    return given if isinstance(given, Run) else read_run(path_of(given, "given-no-run"))


def _address(given: object) -> str:
    if not isinstance(given, str | Path):
        raise refused(given, "given-no-store")
    path_of(given, "given-no-store")
    return str(given)


def _press(given: Press | Path | str) -> Press:
    return given if isinstance(given, Press) else read_press(path_of(given, "given-no-press"))


def _table(rows: list[dict[str, Any]], index: str, columns: tuple[str, ...]) -> pd.DataFrame:
    """Return rows as a table that has its columns even where it has no row."""
    return pd.DataFrame(rows, columns=None if rows else [index, *columns]).set_index(index)
