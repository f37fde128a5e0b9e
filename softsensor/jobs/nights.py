"""The nightly job of several presses: fits, diagnosis and judgement of each are one task for one worker.

The worker writes what it finds itself, each result in one transaction of its own (2026-11-25): a night is made to
be killed anywhere and taken up again, so a worker that is killed costs what it had in hand, and nothing has to be
carried back. SQLite lets one writer in at a time, workers wait for each other as they do for the recorder. A press
whose workers are killed again and again is worked on here, each of its fits by a worker of its own, which finds
the run at fault. Old scans are moved before, by this process: a worker elsewhere need not reach the archive.

Whatever goes wrong in a press's night, foreseen or not, ends that one alone: the worker gives back why, and
its press signs off with it. Where the workers themselves are lost, presses that are left are worked on here.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from daq.address import Address
from daq.press.press_file import Press
from daq.store import Store, open_store
from daq.words import Message, say
from softsensor.jobs.cluster import NoWorkers, handed_out
from softsensor.jobs.night import failed_night, reason_of, refit_press
from softsensor.jobs.night_basis import NightOutcome
from softsensor.jobs.retention import OldScans, Rules, keep_house
from softsensor.jobs.run_reader import PROCESS
from softsensor.jobs.sisters import begin_with_sisters


@dataclass(frozen=True)
class PressTask:
    """One press's night, for a worker that opens the store itself."""

    store: Address
    name: str
    press: Press
    kept: OldScans
    workers: int
    """Processes of its own for its fits."""


Ended = NightOutcome | Message
"""A press's night, or what kept it from its end."""


def refit_stored(task: PressTask) -> Ended:
    """Run the job for one press of a store."""
    try:
        with open_store(task.store, create=False) as store:
            return refit_press(store, task.name, task.press, workers=task.workers, kept=task.kept)
    except Exception as error:  # noqa: BLE001 - the other presses' nights must not end with this one
        return reason_of(error)


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

    Raises
    ------
    NoWorkers
        Where that scheduler is not there.
    """
    began = datetime.now(UTC)
    for name in learning:  # before any night: what they begin with must not depend on which one ends first
        _begin_with_sisters(store, name, presses[name])
    kept = {name: OldScans() if rules is None else _keep_house(store, name, rules) for name in presses}
    share = 1 if dask else max((workers or os.cpu_count() or 1) // max(len(presses), 1), 1)
    tasks = [PressTask(store.database.address, name, press, kept[name], share) for name, press in presses.items()]
    for task, ended in _worked_off(store, tasks, workers, dask):
        yield failed_night(store, task.name, began, ended) if isinstance(ended, Message) else ended


def _begin_with_sisters(store: Store, name: str, press: Press) -> None:
    try:
        begin_with_sisters(store, name, press, PROCESS)
    except Exception as error:  # noqa: BLE001 - it begins without them
        store.log("alarm", PROCESS, say("night-without-sisters", press=name, why=reason_of(error)), name)


def _keep_house(store: Store, name: str, rules: Rules) -> OldScans:
    try:
        return keep_house(store, name, rules, datetime.now(UTC))
    except Exception as error:  # noqa: BLE001 - its fits do not need it
        problem = say("press-problem", press=name, problem=reason_of(error))
        store.log("alarm", PROCESS, problem, name)
        return OldScans(problem=problem)


def _worked_off(
    store: Store, tasks: Sequence[PressTask], workers: int | None, dask: str
) -> Iterator[tuple[PressTask, Ended]]:
    """Yield every press with how its night ended: by workers, and here what they leave, or one press alone."""
    left = {task.name: task for task in tasks}
    if len(tasks) > 1:
        try:
            for task, ended in handed_out(refit_stored, tasks, workers, dask):
                if ended is not None:
                    del left[task.name]
                    yield task, ended
        except NoWorkers:
            raise
        except Exception as error:  # noqa: BLE001 - of the workers themselves, or of the way to them
            dask = ""
            store.log("warning", PROCESS, say("night-workers-lost", why=reason_of(error)))
        for name in left:
            store.log("warning", PROCESS, say("night-workers-killed", press=name), name)
    for task in left.values():
        yield task, _refit(store, task, workers, dask)


def _refit(store: Store, task: PressTask, workers: int | None, dask: str) -> Ended:
    """Run the job for one press here, its fits shared out."""
    try:
        return refit_press(store, task.name, task.press, workers=workers, dask=dask, kept=task.kept)
    except NoWorkers:
        raise
    except Exception as error:  # noqa: BLE001 - as by a worker
        return reason_of(error)
