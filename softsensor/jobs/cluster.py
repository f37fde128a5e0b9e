"""Work handed to the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import TypeVar

from daq.records import InputError
from daq.words import say

# Numbers without another source were set by hand, 2026-11.

SCHEDULER_WAIT_S = 10.0
"""Longest wait for a scheduler's answer. [s]"""
WORKERS_WAIT_S = 60.0
"""Longest wait for a scheduler's first worker. [s]"""
Task = TypeVar("Task")
Done = TypeVar("Done")


def on_dask(
    work: Callable[[Task], Done], tasks: Sequence[Task], address: str
) -> Iterator[tuple[Task, Done | None]]:
    """Yield each task with its result as they come, None where several workers were killed over it alone.

    A worker that is killed takes with it what it had in hand, and the scheduler blames whatever waited there too:
    what it gave up is tried again at the end, one task at a time, so that only the one at fault is left without.
    Raises `InputError` where the package, the scheduler or its workers are missing.
    """
    try:
        from dask.distributed import Client, KilledWorker
        from dask.distributed import as_completed as completed
    except ImportError as error:
        raise InputError(say("dask-package-missing", address=address)) from error
    try:
        client = Client(address, timeout=SCHEDULER_WAIT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(say("dask-no-answer", address=address, seconds=SCHEDULER_WAIT_S)) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_WAIT_S)
        except TimeoutError as error:
            raise InputError(say("dask-no-worker", address=address, seconds=WORKERS_WAIT_S)) from error
        suspects = []
        futures = client.map(work, tasks, pure=False)
        given = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        for future in completed(futures):
            try:
                yield given[future.key], future.result()
            except (KilledWorker, CancelledError):
                suspects.append(given[future.key])
        for task in suspects:
            try:
                yield task, client.submit(work, task, pure=False).result()
            except (KilledWorker, CancelledError):
                yield task, None
