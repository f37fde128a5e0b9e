"""Fits of single runs in a worker process, as the live sensor wants them after each pressing."""

from __future__ import annotations

import logging
import os
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context, parent_process
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.records import Run
from daq.supervision import BEHIND_S
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.first_start import WorkKind, compile_for, kept

LOG = logging.getLogger("kerntemp.sense")

# Numbers without another source were set by hand, 2026-11.

TRIES = 2
"""Workers a fit is given: one may be killed for what others use of the memory, two hardly."""
LONGEST_S = 1800.0
"""A worker that does not answer for so long stands still: a fit takes seconds, compiling before the first minutes,
on a slow machine a quarter of an hour. [s]"""


class Fitter:
    """Fits runs in a worker process, one after the other; one that is killed or stands still is replaced."""

    def __init__(self) -> None:
        # The worker is given one fit at a time: those that wait are not lost with the one that kills it.
        self._queue = ThreadPoolExecutor(1, thread_name_prefix="fits")
        self.replaced: set[str] = set()
        """Runs whose worker was lost and that another one fits, until who asked for the fit has reported it."""
        self._closed = False
        self._pool = new_workers(1)
        self._later = threading.Timer(BEHIND_S, self._begin_warming_up)
        self._later.daemon = True

    def help_compiling(self) -> None:
        """Compile in the worker, beside the live sensor, what that needs; where all is kept, none is started."""
        if not kept(WorkKind.LIVE):
            self._pool.submit(compile_for, WorkKind.LIVE)

    def warm_up(self) -> Future[None]:
        """Compile what fits need and load the solver, once the live sensor has what it needs."""
        try:
            return self._pool.submit(_warm_up)
        except BrokenProcessPool:  # killed while it helped
            self._replace_worker()
            return self._pool.submit(_warm_up)

    def warm_up_behind(self) -> None:
        """Do so in a while, where that takes no longer than loading what is compiled already.

        Nobody needs it before a press opens, and it takes most of a second of a core (2026-11-30), from the first
        core of a start.
        """
        if kept(WorkKind.FIT):
            self._later.start()
        else:
            self.warm_up()

    def _begin_warming_up(self) -> None:
        with suppress(RuntimeError):  # closed meanwhile
            self._queue.submit(self.warm_up)  # where fits are sent, so that a lost worker is replaced once

    def __enter__(self) -> Fitter:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed = True
        self._later.cancel()
        self._queue.shutdown(wait=False, cancel_futures=True)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def submit(self, press: Press, run: Run, model: ModelFile | None) -> Future[dict[str, Any]]:
        """Fit a run with the effects of a model; the result is an entry of ``fit --json``.

        The future raises `BrokenProcessPool` where the fit's worker was lost, and the next one's too.
        """
        return self._queue.submit(self._fit, press, run, model)

    def _fit(self, press: Press, run: Run, model: ModelFile | None) -> dict[str, Any]:
        tries = 0
        while True:
            tries += 1
            try:
                return self._pool.submit(fit_one, press, run, model).result(LONGEST_S)
            except (BrokenProcessPool, TimeoutError) as error:
                if self._closed:
                    raise
                self._replace_worker()
                if tries == TRIES:
                    raise BrokenProcessPool from error
                self.replaced.add(run.name)

    def _replace_worker(self) -> None:
        workers = self._pool._processes or {}  # noqa: SLF001 - a pool has no other way to end one that stands still
        for worker in list(workers.values()):
            worker.kill()
        self._pool.shutdown(wait=False)
        self._pool = new_workers(1)


def new_workers(count: int) -> ProcessPoolExecutor:
    """Return worker processes that end with this one."""
    return ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_end_with_parent)


def _end_with_parent() -> None:
    """End this worker when the process that started it is gone, also where that was killed."""

    def watch() -> None:
        if parent := parent_process():
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _warm_up() -> None:
    compile_for(WorkKind.FIT)
    from softsensor.fitting import campaign

    LOG.debug("fitter ready: %s", campaign.__name__)


def has_panel_readings(press: Press, run: Run) -> bool:
    """Whether any panel sensor of a run has a value: without one, as in production, nothing can be fitted."""
    return any(bool(np.isfinite(run.columns[name]).any()) for name in press.sensors_of(run))


def fit_one(press: Press, run: Run, model: ModelFile | None) -> dict[str, Any]:
    """Fit one run as the live sensor does after a pressing, with what it says about causes left out.

    Raises InputError.
    """
    from softsensor.diagnosis.missing_causes import run_evidence
    from softsensor.fitting.one_run import fit_run
    from softsensor.heat.model import ThermalModel
    from softsensor.signals.moments import moments_of

    thermal = model.model(press) if model is not None else ThermalModel(press)
    start = dict(model.values) if model is not None else None
    begun = time.perf_counter()
    fitted = fit_run(thermal, run, moments_of(run, press), start=start)
    fitted = replace(fitted, seconds=time.perf_counter() - begun)
    evidence = run_evidence(fitted.problem, fitted.minimum.evaluation)
    return fitted.as_json() | {"evidence": {name: e.as_json() for name, e in evidence.items()}}
