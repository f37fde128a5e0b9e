"""The fits of one press's runs: due, under way, stored, and what the control charts say of them."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

from daq.press.press_file import Press
from daq.records import InputError
from daq.store import RunRecord, RunStatus, Store, StoreUnavailable
from daq.store.records import AT_ONCE
from daq.supervision import unexpected
from daq.words import Message, say, spoken
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.drift import alarms_of
from softsensor.jobs.fitter import Fitter, has_panel_readings
from softsensor.jobs.model_in_force import fingerprint

LOG = logging.getLogger("kerntemp.sense")
PROCESS = "sense"

# Numbers without another source were set by hand, 2026-11.

LEFT_RUNS = 200
"""Newest runs that are looked through for a fit a killed process has left."""
NO_FIT = ("run-not-fitted", "run-nothing-to-fit", "run-fit-killed")
"""What the journal says of a run that has no fit."""


def write_journal(
    store: Store,
    level: Literal["info", "warning", "alarm"],
    message: Message,
    press: str | None = None,
    **detail: Any,
) -> None:
    """Write a line to the journal and to the log."""
    LOG.log(logging.INFO if level == "info" else logging.WARNING, "%s", message)
    store.log(level, PROCESS, message, press, detail or None)


@dataclass(frozen=True)
class _UnderWay:
    """A fit that is being made."""

    future: Future[dict[str, Any]]
    record: RunRecord
    """The run as it stood when it was read."""


@dataclass
class RunFits:
    """Fits of one press's runs. A fit that the store refuses is kept until it takes it."""

    store: Store
    name: str
    """The press."""
    press: Press
    fitter: Fitter
    _under_way: dict[str, _UnderWay] = field(default_factory=dict)
    _due: set[str] = field(default_factory=set)
    _alarmed: set[tuple[str, str]] = field(default_factory=set)
    _unwatched: bool = False
    """Whether a fit was stored since the control charts were looked at."""

    def take_up_what_was_left(self, last: int, model: ModelFile | None) -> None:
        """Fit those of the newest runs up to a scan that a process killed before this one has left."""
        records = self.store.runs(press=self.name, limit=LEFT_RUNS).items
        fits = self.store.fits([r.run for r in records])
        lines = [entry.message for entry in self.store.journal(limit=AT_ONCE).items]
        given_up = {line.arguments["run"] for line in lines if line.code in NO_FIT}
        for record in reversed(records):
            followed = record.last_scan is not None and record.last_scan <= last
            handled = record.run in given_up or record.run in self._under_way or record.run in self._due
            if followed and not handled and "fingerprint" not in fits.get(record.run, {}):
                self.submit_whole(record, model)

    def submit_ended(self, run: str, model: ModelFile | None) -> None:
        """Fit a run that has just ended, if the press has closed in it."""
        with self._giving_up(run):
            self.submit_whole(self.store.run_record(run), model)

    def submit_whole(self, record: RunRecord, model: ModelFile | None) -> None:
        """Fit a run that is over, if the press has closed in it."""
        if record.status is not RunStatus.OPEN and record.moments.closed_s == record.moments.closed_s:
            self.submit(record.run, model)

    def submit(self, run: str, model: ModelFile | None) -> None:
        """Fit a run as soon as no fit of it is under way."""
        self._due.add(run)
        if run in self._under_way:
            return
        with self._giving_up(run):
            record, loaded = self.store.run_record(run), self.store.load_run(run)
            if has_panel_readings(self.press, loaded):
                self._under_way[run] = _UnderWay(self.fitter.submit(self.press, loaded, model), record)
            elif self.store.run_record(run).status is not RunStatus.OPEN:
                write_journal(self.store, "info", say("run-nothing-to-fit", run=run), self.name)
            self._due.discard(run)

    def collect(self, version: str, model: ModelFile | None) -> bool:
        """Store finished fits, made with a model's effects, and look at the control charts; return whether any."""
        stored = False
        self._journal_replaced()
        for run in [run for run, fit in self._under_way.items() if fit.future.done()]:
            with self._giving_up(run):
                stored = self._store(run, version, model) or stored
                del self._under_way[run]  # now, not before: the store may refuse
        if self._unwatched:
            self._watch()
        for run in tuple(self._due):
            self.submit(run, model)
        return stored

    def _store(self, run: str, version: str, model: ModelFile | None) -> bool:
        """Store a finished fit, or journal why there is none; return whether there is one."""
        future, record = self._under_way[run].future, self._under_way[run].record
        error = future.exception()
        if isinstance(error, BrokenProcessPool):
            write_journal(self.store, "alarm", say("run-fit-killed", run=run), self.name)
        elif error is not None:
            write_journal(self.store, "warning", say("run-not-fitted", run=run, why=spoken(error)), self.name)
        else:
            self.store.put_fit(run, self._marked(record, future.result(), model), version)
            self._unwatched = True
        return error is None

    @contextmanager
    def _giving_up(self, run: str) -> Iterator[None]:
        """Journal an exception that nobody foresaw and leave this run without a fit: all else goes on."""
        try:
            yield
        except StoreUnavailable:
            raise
        except InputError as error:  # it cannot be read any more, say
            self._without(run, spoken(error))
        except Exception as error:  # the live sensor must not end, nor begin again, for one run's fit
            LOG.exception("fit of %s", run)
            self._without(run, unexpected(error))

    def _without(self, run: str, why: Message) -> None:
        write_journal(self.store, "alarm", say("run-not-fitted", run=run, why=why), self.name)
        self._under_way.pop(run, None)
        self._due.discard(run)

    def _journal_replaced(self) -> None:
        """Journal the fits whose worker was killed and replaced: once each, and again where the store refused."""
        for run in self.fitter.replaced & set(self._under_way):
            write_journal(self.store, "warning", say("run-fit-again", run=run), self.name)
            self.fitter.replaced.discard(run)

    def _marked(self, record: RunRecord, fit: dict[str, Any], model: ModelFile | None) -> dict[str, Any]:
        """Return a fit of a run that was over with what it rests on: the nightly job need not repeat it."""
        if record.status is RunStatus.OPEN or record.run in self._due:
            return fit
        return fit | {"fingerprint": fingerprint(record, self.press, model)}

    def _watch(self) -> None:
        """Write an alarm once for each coefficient that has left what is usual."""
        self._unwatched = False
        try:
            for alarm in alarms_of(self.store, self.name):
                if (alarm.coefficient, alarm.run) not in self._alarmed:
                    write_journal(self.store, "warning", alarm.message, self.name, **alarm.__dict__)
                    self._alarmed.add((alarm.coefficient, alarm.run))
        except StoreUnavailable:
            self._unwatched = True
            raise
