"""Runs read for a night's judgement: one that cannot be read any more is left out, and an alarm says why."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

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
    """Runs that could not be read, and what is said of each."""

    def read(self, run: str) -> Run | None:
        """Return a run, None where it cannot be read."""
        if run in self.left_out:
            return None
        try:
            return self.store.load_run(run)
        except InputError as error:
            self.left_out[run] = say("run-not-judged", run=run, why=spoken(error))
            self.store.log("alarm", PROCESS, self.left_out[run], self.press)
            return None

    def newest(self, records: Iterable[RunRecord], wanted: int) -> list[RunRecord]:
        """Return runs, oldest first as given, without those of the newest that cannot be read.

        They are read from the newest on until so many as are wanted could be; whoever reads older ones must see
        for himself.
        """
        kept: list[RunRecord] = []
        sound = 0
        for record in reversed(list(records)):
            if sound < wanted and self.read(record.run) is None:
                continue
            sound += 1
            kept.append(record)
        return kept[::-1]
