"""Runs read for a night's judgement: one that cannot be read, or is there twice, is left out with an alarm."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from daq.files.legible import new_readings
from daq.records import InputError, Run
from daq.store import RunRecord, Store
from daq.words import Message, say, spoken

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
    """Their names by `new_readings`."""

    def read(self, run: str) -> Run | None:
        """Return a run, None where it cannot be read or holds the readings of one that is kept."""
        if run in self.left_out:
            return None
        if run in self._kept:
            return self._kept[run]
        try:
            found = self.store.load_run(run)
            new_readings(found, self._held)
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
        sound: list[RunRecord] = []
        for record in reversed(list(records)):
            if len(self._kept) < wanted:
                run = self.read(record.run)
                if run is None:
                    continue
                self._kept[record.run], self._held[new_readings(run, self._held)] = run, record.run
            sound.append(record)
        return sound[::-1]
