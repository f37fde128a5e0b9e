"""Runs read for a night's judgement: one that cannot be read, or is there twice, is left out with an alarm.

Of a pressing that is stored twice the run that came first counts: it may have had its turn, and a copy that comes
later must not have it again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from daq.files.legible import new_readings, readings_digest
from daq.records import InputError, Run
from daq.store import RunRecord, Store
from daq.words import Message, say, spoken
from softsensor.jobs.drift import CHARTED_RUNS

PROCESS = "refit"


@dataclass(frozen=True)
class RunReader:
    """Reads stored runs of a press."""

    store: Store
    press: str
    left_out: dict[str, Message] = field(default_factory=dict)
    """Runs that could not be read or hold another's readings, and the reason of each."""
    _kept: dict[str, Run] = field(default_factory=dict)
    """The newest, which every step of a judgement asks for."""
    _held: dict[bytes, str] = field(default_factory=dict)
    """Names of runs by their readings: of these, and of earlier ones that were asked for to know them by."""
    _alike: dict[str, Sequence[str]] = field(default_factory=dict)
    """Of the newest, the runs stored before that may hold the same readings."""

    def read(self, run: str) -> Run | None:
        """Return a run, None where it cannot be read or holds the readings of one that is kept."""
        if run in self.left_out:
            return None
        if run in self._kept:
            return self._kept[run]
        try:
            found = self.store.load_run(run)
            self._check_first(found)
        except InputError as error:
            self.left_out[run] = say("run-not-judged", run=run, why=spoken(error))
            self.store.log("alarm", PROCESS, self.left_out[run], self.press)
            return None
        return found

    def newest(self, records: Iterable[RunRecord], wanted: int) -> list[RunRecord]:
        """Return runs, oldest first as given, without those of the newest that cannot be read.

        They are read from the newest on until so many as are wanted could be; whoever reads older ones must see
        for himself.
        """
        given = list(records)
        self._alike.update(self.store.earlier_alike([record.run for record in given], CHARTED_RUNS))
        sound: list[RunRecord] = []
        for record in reversed(given):
            if len(self._kept) < wanted:
                run = self.read(record.run)
                if run is None:
                    continue
                self._kept[record.run], self._held[readings_digest(run)] = run, record.run
            sound.append(record)
        return sound[::-1]

    def _check_first(self, run: Run) -> None:
        """Raise `InputError` where a run that counts, or one that was stored before, holds a run's readings."""
        digest = readings_digest(run)
        held = set(self._held.values())
        for name in self._alike.get(run.name, ()):
            if digest in self._held:
                break
            if name in held:
                continue
            with suppress(InputError):  # one that cannot be read any more is no run's other
                self._held.setdefault(readings_digest(self.store.load_run(name)), name)
        new_readings(run, {known: name for known, name in self._held.items() if name != run.name})
