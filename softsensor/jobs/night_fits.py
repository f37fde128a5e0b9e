"""Fits of stored runs, each by a worker that reads its run from the store: here, on processes or on Dask."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from daq.address import Address
from daq.press.press_file import Press
from daq.records import InputError
from daq.store import Store, open_store
from daq.words import Message, spoken
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.cluster import on_dask
from softsensor.jobs.fitter import fit_one, has_panel_readings, new_workers


@dataclass(frozen=True)
class FitTask:
    """One run to fit, in a worker that reads it from the store itself."""

    url: str | Address
    press: Press
    run: str
    model: ModelFile | None


@dataclass(frozen=True)
class Done:
    """What became of a run: a fit, why there is none, or neither where it has nothing to fit, as in production."""

    run: str
    fit: dict[str, Any] | None = None
    why: Message | None = None
    killed: bool = False
    """Two workers were killed over it."""


@lru_cache(maxsize=4)
def _store_of(url: str | Address) -> Store:
    return open_store(url, create=False)


def fit_stored(task: FitTask) -> Done:
    """Fit one stored run."""
    try:
        run = _store_of(task.url).load_run(task.run)
        if not has_panel_readings(task.press, run):
            return Done(task.run)
        return Done(task.run, fit_one(task.press, run, task.model))
    except (InputError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Done(task.run, why=spoken(error) if str(error) else spoken(type(error).__name__))


def fit_all(tasks: Sequence[FitTask], workers: int | None = None, dask: str = "") -> Iterator[Done]:
    """Yield the results of `fit_stored` as they come: on Dask, on local processes, or here."""
    if dask and tasks:
        yield from _on_dask(tasks, dask)
        return
    if workers == 1:
        yield from map(fit_stored, tasks)
    elif tasks:
        yield from _on_workers(tasks, min(workers or os.cpu_count() or 1, len(tasks)))


def _on_workers(tasks: Sequence[FitTask], count: int) -> Iterator[Done]:
    """Yield the results of local processes; what they had in hand when one was killed is tried once more."""
    left = deque(tasks)
    while left:
        suspects = yield from _until_killed(left, count)
        yield from map(_alone, suspects)


def _until_killed(left: deque[FitTask], count: int) -> Generator[Done, None, list[FitTask]]:
    """Take tasks until all are done or a worker is killed; return what the workers had in hand then.

    No worker is given more than one run at a time, so that few are under suspicion.
    """
    under_way: dict[Future[Done], FitTask] = {}
    with suppress(BrokenProcessPool), new_workers(count) as pool:
        while left or under_way:
            while left and len(under_way) < count:
                future = pool.submit(fit_stored, left[0])
                under_way[future] = left.popleft()
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                done = future.result()
                del under_way[future]
                yield done
    return list(under_way.values())


def _alone(task: FitTask) -> Done:
    """Fit a run in a new worker of its own."""
    try:
        with new_workers(1) as pool:
            return pool.submit(fit_stored, task).result()
    except BrokenProcessPool:
        return Done(task.run, killed=True)


def _on_dask(tasks: Sequence[FitTask], address: str) -> Iterator[Done]:
    for task, done in on_dask(fit_stored, tasks, address):
        yield Done(task.run, killed=True) if done is None else done
