"""The nightly job of several presses: fits, diagnosis and judgement of each are one task for one worker.

The worker writes what it finds itself, each result in one transaction of its own (2026-11-25): a night is made to
be killed anywhere and taken up again, so a worker that is killed costs what it had in hand, and nothing has to be
carried back. SQLite lets one writer in at a time, workers wait for each other as they do for the recorder. A press
whose workers are killed again and again is worked on here, each of its fits by a worker of its own, which finds
the run at fault. Old scans are moved before, by this process: a worker elsewhere need not reach the archive.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from daq.address import Address
from daq.press.press_file import Press
from daq.store import Store, open_store
from daq.words import say
from softsensor.jobs.cluster import handed_out
from softsensor.jobs.night import refit_press
from softsensor.jobs.night_judgement import PROCESS, NightOutcome
from softsensor.jobs.retention import Kept, Rules, keep_house
from softsensor.jobs.sisters import begin_with_sisters


@dataclass(frozen=True)
class PressTask:
    """One press's night, for a worker that opens the store itself."""

    store: Address
    name: str
    press: Press
    kept: Kept
    workers: int
    """Processes of its own for its fits."""


def refit_stored(task: PressTask) -> NightOutcome:
    """Run the job for one press of a store."""
    with open_store(task.store, create=False) as store:
        return refit_press(store, task.name, task.press, workers=task.workers, kept=task.kept)


def refit_presses(
    store: Store,
    presses: Mapping[str, Press],
    *,
    workers: int | None = None,
    dask: str = "",
    rules: Rules | None = None,
    learning: Collection[str] = (),
) -> Iterator[NightOutcome]:
    """Run the job for every press, and yield what it did as they end; one press alone has its fits shared out.

    Parameters
    ----------
    workers
        Local processes; by default one a core.
    dask
        Address of a Dask scheduler whose workers take the presses instead, or one press's fits.
    rules
        What becomes of old scans; None: they stay in the store.
    learning
        Presses that begin with what their sisters know, where they have no model.
    """
    for name in learning:  # before any night: what they begin with must not depend on which one ends first
        begin_with_sisters(store, name, presses[name], PROCESS)
    kept = {n: keep_house(store, n, rules, datetime.now(UTC)) if rules is not None else Kept() for n in presses}
    if len(presses) == 1:
        for name, press in presses.items():
            yield refit_press(store, name, press, workers=workers, dask=dask, kept=kept[name])
        return
    share = 1 if dask else max((workers or os.cpu_count() or 1) // max(len(presses), 1), 1)
    tasks = [PressTask(store.database.address, name, press, kept[name], share) for name, press in presses.items()]
    for task, outcome in handed_out(refit_stored, tasks, workers, dask):
        if outcome is not None:
            yield outcome
            continue
        store.log("warning", PROCESS, say("night-workers-killed", press=task.name), task.name)
        yield refit_press(store, task.name, task.press, workers=workers, dask=dask, kept=task.kept)
