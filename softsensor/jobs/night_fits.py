"""Fits of stored runs, each by a worker that reads its run from the store: here, on processes or on Dask."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from daq.address import Address
from daq.press.press_file import Press
from daq.records import InputError
from daq.store import Store, StoreUnavailable, open_store
from daq.store.records import ScansUnreadable
from daq.supervision import unexpected
from daq.words import Message, spoken
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.cluster import handed_out
from softsensor.jobs.fitter import fit_one, has_panel_readings


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
    damaged: bool = False
    """What is stored of it cannot be read any more."""


@lru_cache(maxsize=4)
def _store_of(url: str | Address) -> Store:
    return open_store(url, create=False)


def fit_stored(task: FitTask) -> Done:
    """Fit one stored run; whatever is wrong with it costs its own fit alone.

    Raises
    ------
    StoreUnavailable
        Where the store does not give the run: that is no fault of the run's.
    """
    try:
        run = _store_of(task.url).load_run(task.run)
        if not has_panel_readings(task.press, run):
            return Done(task.run)
        return Done(task.run, fit_one(task.press, run, task.model))
    except StoreUnavailable:
        raise
    except InputError as error:
        return Done(task.run, why=spoken(error), damaged=isinstance(error, ScansUnreadable))
    except Exception as error:  # noqa: BLE001 - the other runs' fits must not end with this one
        return Done(task.run, why=unexpected(error))


def fit_all(tasks: Sequence[FitTask], workers: int | None = None, dask: str = "") -> Iterator[Done]:
    """Yield the results of `fit_stored` as they come: on Dask, on local processes, or here."""
    for task, done in handed_out(fit_stored, tasks, workers, dask):
        yield Done(task.run, killed=True) if done is None else done
