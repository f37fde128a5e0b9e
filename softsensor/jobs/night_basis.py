"""What a night of one press rests on, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from daq.press.press_file import Press
from daq.records import Run
from daq.store import RunRecord, Store
from daq.words import Message, say
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.night_progress import nights_for
from softsensor.jobs.run_reader import RunReader

# Numbers without another source were set by hand, 2026-11.

NOTHING_CHANGED = say("night-nothing-changed")
NOT_ASKED = "not_asked"
"""Instead of a verdict, where the runs are those of the night before."""
FAILED = "failed"
"""Instead of a verdict, where the press's night could not be gone through."""
FEWEST_RUNS = 3
"""Runs a first model needs."""


@dataclass(frozen=True)
class NightOutcome:
    """What the job did for one press."""

    press: str
    runs: int
    fitted: int
    failed: int
    version: str
    """The model in force afterwards, empty where there is none."""
    verdict: str = NOT_ASKED
    """Of the diagnosis, or why there was none; with `FAILED` the reason says what kept the night from its end."""
    promoted: bool = False
    reason: Message = NOTHING_CHANGED
    newly_unfit: int = 0
    """How many of the failed ones were tried in this job."""
    blind: int = 0
    """Runs without panel sensors: in production that is how it is meant, so nothing has failed."""
    new: int = 0
    """Runs that came since the night before."""
    later: int = 0
    """Older runs whose fits rest on a press file or effects of before: their turn comes in nights to come."""
    left_out: tuple[tuple[str, Message], ...] = ()
    """Runs of this night that could not be fitted or read, and why; the first `SHOWN_LEFT_OUT`."""
    unread: tuple[Message, ...] = ()
    """Of runs that had a fit and could not be read for the judgement, why."""
    drifts: tuple[tuple[str, Message], ...] = ()
    """Coefficients that have left what is usual, and the message about each."""
    named: tuple[str, ...] = ()
    """Effects the diagnosis named."""
    refused: str = ""
    """A candidate that was made and not promoted."""
    archive: Message | None = None
    """What became of old scans, None where nothing did."""
    archive_problem: Message | None = None
    """Why some of them could not be moved or read."""

    @property
    def fits_line(self) -> Message:
        """What became of the runs."""
        kept = self.runs - self.fitted - self.failed - self.blind - self.later
        counts = {"fitted": self.fitted, "runs": self.runs, "kept": max(kept, 0)}
        fits = say("night-fits", **counts, failed=self.failed, blind=self.blind)
        if not self.later:
            return fits
        return say("night-fits-later", fits=fits, later=self.later, nights=nights_for(self.later))

    @property
    def line(self) -> Message:
        """One line for terminal and journal."""
        if self.verdict == FAILED:
            return say("night-failed", press=self.press, why=self.reason)
        return say(
            "night-outcome",
            press=self.press,
            fits=self.fits_line,
            verdict=self.verdict,
            model="promoted" if self.promoted else "stays" if self.version else "none",
            version=self.version,
            reason=self.reason,
        )


@dataclass(frozen=True)
class NightBasis:
    """What a night's judgement rests on."""

    store: Store
    name: str
    press: Press
    base: ModelFile | None
    records: Sequence[RunRecord]
    """The newest runs, oldest first."""
    fits: Mapping[str, Mapping[str, Any]]
    """Of these, as far as they stand."""
    sure: str = ""
    """The run since which it is sure that the model in force leaves something out, empty where it is not."""
    reader: RunReader | None = None
    """What reads the runs; None: one of its own."""

    @property
    def of_sisters(self) -> bool:
        """Whether the model in force is what presses of the same kind know."""
        return self.base is not None and self.base.sisters is not None

    def run(self, name: str) -> Run | None:
        """Return a stored run, None where it cannot be read any more."""
        return (self.reader or RunReader(self.store, self.name)).read(name)

    def runs(self, names: Sequence[str]) -> list[Run]:
        """Return stored runs by name, those that can be read."""
        return [run for name in names if (run := self.run(name)) is not None]
