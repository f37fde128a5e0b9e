"""What a night does with a press's old scans: into the archive, looked after there, and given up by rule.

Each run is a step of its own that the store proves before it deletes, so a night may end or be killed anywhere.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import chain
from pathlib import Path
from typing import Any

from daq.records import InputError
from daq.store import Store, StoreUnavailable, every
from daq.words import Message, say, spoken
from softsensor.jobs.run_reader import PROCESS

# Numbers without another source were set by hand, 2026-11.

CHECKED_EVERY = timedelta(days=30)
"""How often each file of the archive is read and held against its sum, as far as the nights' time goes."""
CHECKING_SHARE = 0.25
"""Of a night's time for the archive that goes into this at most."""


@dataclass(frozen=True)
class Rules:
    """``archive…`` and ``pressings_only…`` of ``[store]``."""

    folder: Path
    archive_after: timedelta
    pressings_only_after: timedelta | None
    """None: archived scans are kept for good."""
    seconds: float
    """The time a press may take in a night."""
    began: datetime
    """When the night did: the archive is all presses', and a file that is not sound is read once in a night."""


@dataclass(frozen=True)
class OldScans:
    """What became of a press's old scans in a night."""

    archived: int = 0
    """Runs moved into the archive."""
    archived_bytes: int = 0
    """Size of their files."""
    freed_bytes: int = 0
    """Room in the store for new scans; an SQLite file keeps its size and fills it again."""
    pressings_only: int = 0
    """Runs whose archived scans were given up."""
    archive_later: int = 0
    """Runs due that this night had no time for, or that could not be moved."""
    problem: Message | None = None
    """What went wrong last, in the journal too."""

    def summary(self) -> dict[str, Any]:
        """Return it as a night keeps it."""
        return {name: value for name, value in self.__dict__.items() if name != "problem"}

    def line(self, press: str) -> Message | None:
        """Return one line for terminal and journal, None where nothing was done."""
        if not (self.archived or self.pressings_only or self.archive_later):
            return None
        moved = {"archived": self.archived, "freed": self.freed_bytes / 1e6, "written": self.archived_bytes / 1e6}
        return say("night-archive", press=press, **moved, removed=self.pressings_only, later=self.archive_later)


def keep_house(store: Store, press: str, rules: Rules, now: datetime) -> OldScans:
    """Do as the rules say, for as long as they allow; what goes wrong is in the journal and stops nothing else.

    Raises
    ------
    InputError
        Where another job works on the press.
    """
    with store.only_night(press):
        return _keep_house(store, press, rules, now)


def _keep_house(store: Store, press: str, rules: Rules, now: datetime) -> OldScans:
    began = time.monotonic()
    try:
        store.use_archive(rules.folder)
    except InputError as error:
        store.log("alarm", PROCESS, spoken(error), press)
        return OldScans(problem=spoken(error))
    _check(store, press, rules, now, began + CHECKING_SHARE * rules.seconds)
    deadline = began + rules.seconds
    kept = _give_up(store, press, rules, now, deadline)
    kept = _archive(store, press, kept, now - rules.archive_after, deadline)
    line = kept.line(press)
    if line is not None:
        store.log("info", PROCESS, line, press)
    return kept


def _check(store: Store, press: str, rules: Rules, now: datetime, deadline: float) -> None:
    """Read files whose turn it is, first those that were not sound, and none twice; nothing is deleted."""
    store.recheck_unsound(rules.began)
    due = min(now - CHECKED_EVERY, rules.began)
    while time.monotonic() < deadline:
        checked = store.check_archive(due)
        for problem in checked.unsound:
            store.log("warning", PROCESS, problem, press)
        for run in checked.mended:
            store.log("info", PROCESS, say("archive-file-mended", run=run), press)
        if not checked.files:
            return


def _clock_agrees(store: Store, press: str, now: datetime) -> bool:
    """Return whether nights have come as long as files stay unread: what is given up does not come back.

    By a clock that has run ahead, everything is old; until it is believed, somebody has had that long to see it.
    """
    nights = every(lambda cursor: store.nights(press=press, cursor=cursor))
    newest = next(nights, None)
    if newest is None:
        return False
    if newest.ended_utc < now - 2 * CHECKED_EVERY:
        days = (now - newest.ended_utc) / timedelta(days=1)
        store.log("alarm", PROCESS, say("archive-clock-ahead", press=press, days=round(days)), press)
        return False
    past = (night.ended_utc for night in chain([newest], nights))
    before = next((ended for ended in past if ended <= now - CHECKED_EVERY), None)
    return before is not None and before > now - 2 * CHECKED_EVERY


def _give_up(store: Store, press: str, rules: Rules, now: datetime, deadline: float) -> OldScans:
    kept = OldScans()
    if rules.pressings_only_after is None or not _clock_agrees(store, press, now):
        return kept
    while time.monotonic() < deadline:
        runs, _ = store.remove_archived(press, now - rules.pressings_only_after)
        if not runs:
            break
        kept = replace(kept, pressings_only=kept.pressings_only + runs)
    return kept


def _archive(store: Store, press: str, kept: OldScans, before: datetime, deadline: float) -> OldScans:
    due = store.runs_to_archive(press, before)
    for run in due:
        if time.monotonic() > deadline:
            break
        try:
            moved = store.archive_run(run)
        except (InputError, StoreUnavailable) as error:
            kept = replace(kept, problem=spoken(error))
            store.log("alarm", PROCESS, spoken(error), press)
            if isinstance(error, StoreUnavailable):  # a full disk takes the next run no better
                break
            continue
        kept = replace(
            kept,
            archived=kept.archived + 1,
            archived_bytes=kept.archived_bytes + moved.file_bytes,
            freed_bytes=kept.freed_bytes + moved.freed_bytes,
        )
    return replace(kept, archive_later=len(due) - kept.archived)
