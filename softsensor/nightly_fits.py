"""Fits of stored runs, each by a worker that reads its run from the store: here, on processes or on Dask."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from typing import Any

import numpy as np

from daq.pressfile import Press
from daq.records import InputError
from daq.store import Store, open_store
from softsensor.modelfile import ModelFile
from softsensor.service import fit_one, heard

NO_SENSORS = "no panel sensors"
"""What stands for an error where a run has nothing to fit, as in production."""
SCHEDULER_WAIT_S = 10.0
WORKERS_WAIT_S = 60.0
"""Longest wait for a scheduler's first worker. [s]"""


@dataclass(frozen=True)
class Task:
    """One run to fit, in a worker that reads it from the store itself."""

    url: str
    press: Press
    run: str
    model: ModelFile | None


@lru_cache(maxsize=4)
def _store_of(url: str) -> Store:
    return open_store(url, create=False)


def fit_stored(task: Task) -> tuple[str, dict[str, Any], str]:
    """Fit one stored run; return its name, the fit, and why there is none."""
    try:
        run = _store_of(task.url).load_run(task.run)
        if not heard(task.press, run):
            return task.run, {}, NO_SENSORS
        return task.run, fit_one(task.press, run, task.model), ""
    except (InputError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return task.run, {}, " ".join(str(error).split()) or type(error).__name__


def fit_all(
    tasks: Sequence[Task], workers: int | None = None, dask: str = ""
) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Yield the results of `fit_stored` as they come: on Dask, on local processes, or here."""
    if dask and tasks:
        yield from _on_dask(tasks, dask)
        return
    workers = max(1, min(workers or os.cpu_count() or 1, len(tasks)))
    if workers == 1 or len(tasks) < 4:
        yield from map(fit_stored, tasks)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(fit_stored, task) for task in tasks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            for future in futures:
                future.cancel()


def _on_dask(tasks: Sequence[Task], address: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    try:
        from dask.distributed import Client
        from dask.distributed import as_completed as completed
    except ImportError as error:
        raise InputError(
            f"Dask scheduler {address}: the package 'distributed' is missing; on a press PC "
            "kerntemp_setup.py complete brings it, elsewhere pip install 'kerntemp[dask]'"
        ) from error
    try:
        client = Client(address, timeout=SCHEDULER_WAIT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"Dask scheduler {address}: no answer in {SCHEDULER_WAIT_S:g} s; check [refit] dask and that it runs"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_WAIT_S)
        except TimeoutError as error:
            raise InputError(
                f"Dask scheduler {address}: no worker in {WORKERS_WAIT_S:g} s; start dask worker {address}"
            ) from error
        for future in completed(client.map(fit_stored, tasks, pure=False)):
            yield future.result()
