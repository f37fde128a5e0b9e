"""Work handed to worker processes, of this machine or of a Dask scheduler.

Both ways give the same: each task with its result as they come, None where workers were killed over it alone.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TypeVar

from daq.records import InputError
from daq.words import say
from softsensor.jobs.fitter import new_workers

if TYPE_CHECKING:
    from dask.distributed import Client

# Numbers without another source were set by hand, 2026-11.

SCHEDULER_WAIT_S = 10.0
"""Longest wait for a scheduler's answer. [s]"""
WORKERS_WAIT_S = 60.0
"""Longest wait for a scheduler's first worker. [s]"""


LOOK_S = 2.0
"""How often it is looked whether anybody still works. [s]"""


class NoWorkers(InputError):
    """The package, the scheduler or its workers are missing: nothing has been begun."""


class WorkersLost(InputError):
    """The scheduler, or the last of its workers, went away over the work; what was yielded before is done."""


Task = TypeVar("Task")
Done = TypeVar("Done")


def handed_out(
    work: Callable[[Task], Done], tasks: Sequence[Task], workers: int | None = None, dask: str = ""
) -> Iterator[tuple[Task, Done | None]]:
    """Yield each task with its result as they come: by Dask, by local processes, or by this one.

    `workers`: local processes, by default one a core; with one the work is done here, in the tasks' order.
    """
    if dask and tasks:
        yield from on_dask(work, tasks, dask)
    elif workers == 1:
        yield from ((task, work(task)) for task in tasks)
    elif tasks:
        yield from _on_workers(work, tasks, min(workers or os.cpu_count() or 1, len(tasks)))


def _on_workers(
    work: Callable[[Task], Done], tasks: Sequence[Task], count: int
) -> Iterator[tuple[Task, Done | None]]:
    """Yield the results of local processes; what they had in hand when one was killed is tried once more."""
    left = deque(tasks)
    while left:
        suspects = yield from _until_killed(work, left, count)
        yield from ((task, _alone(work, task)) for task in suspects)


def _until_killed(
    work: Callable[[Task], Done], left: deque[Task], count: int
) -> Generator[tuple[Task, Done], None, list[Task]]:
    """Take tasks until all are done or a worker is killed; return what the workers had in hand then.

    No worker is given more than one task at a time, so that few are under suspicion.
    """
    under_way: dict[Future[Done], Task] = {}
    with suppress(BrokenProcessPool), new_workers(count) as pool:
        while left or under_way:
            while left and len(under_way) < count:
                future = pool.submit(work, left[0])
                under_way[future] = left.popleft()
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                done = future.result()
                yield under_way.pop(future), done
    return list(under_way.values())


def _alone(work: Callable[[Task], Done], task: Task) -> Done | None:
    """Do a task in a new worker of its own."""
    try:
        with new_workers(1) as pool:
            return pool.submit(work, task).result()
    except BrokenProcessPool:
        return None


def on_dask(
    work: Callable[[Task], Done], tasks: Sequence[Task], address: str
) -> Iterator[tuple[Task, Done | None]]:
    """Yield each task with its result as they come, None where several workers were killed over it alone.

    A worker that is killed takes with it what it had in hand, and the scheduler blames whatever waited there too:
    what it gave up is tried again at the end, one task at a time, so that only the one at fault is left without.

    Raises
    ------
    NoWorkers
        Where the package, the scheduler or its workers are missing.
    WorkersLost
        Where the scheduler goes away, or has no worker for `WORKERS_WAIT_S`.
    """
    with _client(address) as client:
        suspects = []
        for task, done in _tried(client, work, tasks):
            if done is None:
                suspects.append(task)
            else:
                yield task, done
        for task in suspects:
            yield from _tried(client, work, [task])


@contextmanager
def _client(address: str) -> Iterator[Client]:
    """Connect to a scheduler that has workers. Raises `NoWorkers`."""
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise NoWorkers(say("dask-package-missing", address=address)) from error
    try:
        client = Client(address, timeout=SCHEDULER_WAIT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise NoWorkers(say("dask-no-answer", address=address, seconds=SCHEDULER_WAIT_S)) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_WAIT_S)
        except TimeoutError as error:
            raise NoWorkers(say("dask-no-worker", address=address, seconds=WORKERS_WAIT_S)) from error
        yield client


def _tried(
    client: Client, work: Callable[[Task], Done], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Done | None]]:
    """Yield each task with its result as they come, None where the scheduler gave it up. Raises `WorkersLost`."""
    from dask.distributed import KilledWorker

    left = dict(zip(client.map(work, tasks, pure=False), tasks, strict=True))
    while left:
        for future in _ended(client, list(left)):
            task = left.pop(future)
            try:
                yield task, future.result()
            except (KilledWorker, CancelledError):
                yield task, None


def _ended(client: Client, futures: Sequence[Any]) -> Collection[Any]:
    """Wait until some of Dask's futures end; return these. Raises `WorkersLost`."""
    from dask.distributed import wait as wait_for

    working_s = time.monotonic()
    while client.status == "running":
        try:
            return list(wait_for(futures, timeout=LOOK_S, return_when="FIRST_COMPLETED").done)
        except CancelledError:
            if ended := [future for future in futures if future.status == "cancelled"]:
                return ended
        except TimeoutError:
            silent_s = time.monotonic() - working_s
            if client.status == "running" and _has_workers(client):
                working_s = time.monotonic()
            elif silent_s > WORKERS_WAIT_S:
                problem = say("dask-workers-lost", address=client.scheduler.address, seconds=silent_s)
                raise WorkersLost(problem) from None
    raise WorkersLost(say("dask-scheduler-lost", address=client.scheduler.address))


def _has_workers(client: Client) -> bool:
    """Return whether a scheduler says that it has workers; one that stands still says nothing."""
    try:
        return bool(client.sync(client.scheduler.ncores, callback_timeout=SCHEDULER_WAIT_S))
    except (OSError, TimeoutError):
        return False
