"""Which runs a night looks at: what is new since the one before, not what is stored.

All new and edited runs, the newest ones, those over which workers were killed, and, after a promotion or a change
of the press file, a further share of the older ones every night until all rest on what is in force.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from typing import Any

from daq.press.press_file import Press
from daq.store import RunRecord, RunStatus, Store
from daq.store.records import AT_ONCE
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.bets import Bets
from softsensor.jobs.drift import CHARTED_RUNS
from softsensor.jobs.model_in_force import fingerprint

WINDOW = CHARTED_RUNS
"""The newest runs: refitted in the night after a promotion, and what a judgement rests on."""

# Numbers without another source were set by hand, 2026-11.

SHARE = 200
"""Older runs refitted in each night after that."""


@dataclass(frozen=True)
class Progress:
    """How far a press's runs are worked off, by their numbers in the store."""

    seen: int = 0
    """Up to this run all were looked at."""
    edits: int = 0
    """Up to this edit of a header likewise."""
    behind: int = 0
    """Fits of runs below this one may rest on a press file or effects of before; 0: none do."""
    rests_on: str = ""
    """Fingerprint of press file and effects."""
    basis: str = ""
    """Fingerprint of the runs that were judged: the next night judges again as soon as there are others."""
    bets: Bets = field(default_factory=Bets)
    """On whether the model in force leaves something out; kept with the night, so that a run has its turn once."""

    @classmethod
    def of(cls, store: Store, press: str) -> Progress:
        """Return where the last night that came to its end left off."""
        found = store.nights(press=press, limit=1).items
        if not found:
            return cls()
        content = found[0].progress
        return cls(**{**content, "bets": Bets.stored(content.get("bets", {}))})

    def as_json(self) -> dict[str, Any]:
        """Return it as the store keeps it."""
        return asdict(self)


@dataclass(frozen=True)
class Agenda:
    """What a night has to do for a press."""

    due: dict[str, str]
    """Runs to fit, by name with their fingerprints, in the order of being fitted."""
    runs: int
    """All up to the newest that was looked at; what comes later is the next night's."""
    new: int
    """Runs that came since the night before."""
    window: tuple[RunRecord, ...]
    """The newest runs, oldest first."""
    progress: Progress
    """Once all that is due is done."""


def agenda_of(store: Store, name: str, press: Press, base: ModelFile | None) -> Agenda:
    """Return what there is to do for a press, in as many queries as there are bunches of new runs."""
    before = Progress.of(store, name)
    rests_on = rests_on_of(press, base)
    if before.rests_on != rests_on:
        before = replace(before, rests_on=rests_on, behind=before.seen + 1 if before.seen else 0)
    mark = _Marking(store, press, base)
    window = tuple(store.pressings(name, limit=WINDOW)[::-1])
    mark.look(window)
    seen, new, running = before.seen, 0, store.open_run(name)
    for bunch in _new(store, name, before.seen):
        mark.look(bunch)
        new += len(bunch)
        over = [r.number for r in bunch if running is None or r.number < running.number]
        seen = max([seen, *over])
    edits, edited = store.edited_after(name, before.edits)
    for names in _bunches([*edited, *store.killed_runs(name)]):
        mark.look([r for r in store.run_records(names).values() if _is_pressing(r)])
    older = _older(store, name, window, before.behind)
    mark.look(older)
    behind = older[-1].number if len(older) == SHARE else 0
    runs = store.count_pressings(name, below=max(mark.looked, default=0) + 1)
    return Agenda(mark.due, runs, new, window, replace(before, seen=seen, edits=edits, behind=behind))


def nights_for(later: int) -> int:
    """Return how many nights older runs take, a share of them in each."""
    return math.ceil(later / SHARE)


def rests_on_of(press: Press, model: ModelFile | None) -> str:
    """Return what all fits of a press rest on, as a text that changes with press file and effects."""
    effects = model.as_json()["effects"] if model is not None else []
    return sha256(repr([press.model_dump(mode="json"), effects]).encode()).hexdigest()[:16]


@dataclass
class _Marking:
    """Finds out which of the runs it is shown are due."""

    store: Store
    press: Press
    base: ModelFile | None
    due: dict[str, str] = field(default_factory=dict)
    looked: set[int] = field(default_factory=set)

    def look(self, records: Sequence[RunRecord]) -> None:
        """Take in what of these runs is due, each once."""
        fresh = [r for r in records if r.number not in self.looked]
        self.looked.update(r.number for r in fresh)
        gone = self.store.without_scans([r.run for r in fresh])
        fresh = [r for r in fresh if r.run not in gone]
        names = [r.run for r in fresh]
        fits, tried = self.store.fits(names), self.store.unfitted_marks(names)
        for record in fresh:
            mark = fingerprint(record, self.press, self.base)
            if mark not in (fits.get(record.run, {}).get("fingerprint"), tried.get(record.run)):
                self.due[record.run] = mark


def _is_pressing(run: RunRecord) -> bool:
    """Return whether a run is over and, where it was recorded, the press has closed in it."""
    pressed = run.kind == "imported" or math.isfinite(run.moments.closed_s)
    return pressed and run.status is not RunStatus.OPEN


def _new(store: Store, name: str, seen: int) -> Iterator[Sequence[RunRecord]]:
    """Yield the runs numbered above the last one seen, oldest first, in bunches."""
    while bunch := store.pressings(name, after=seen, limit=AT_ONCE):
        yield bunch
        seen = bunch[-1].number


def _older(store: Store, name: str, window: Sequence[RunRecord], behind: int) -> Sequence[RunRecord]:
    """Return the next share of runs before the window whose fits may rest on something of before."""
    below = min(behind, window[0].number) if window else 0
    return store.pressings(name, below=below, limit=SHARE) if below else ()


def _bunches(names: Sequence[str]) -> Iterator[Sequence[str]]:
    return (names[i : i + AT_ONCE] for i in range(0, len(names), AT_ONCE))
