"""A campaign fitted on all cores, with a clock, and a word on how far it is."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from daq.press.press_file import Press
from daq.records import Moments, Run
from softsensor.diagnosis.missing_causes import held_against
from softsensor.fitting.campaign import CampaignFit, campaign_fit_of, company_of
from softsensor.fitting.identifiability import profiles_of
from softsensor.fitting.one_run import fit_run, make_problem
from softsensor.fitting.problem import minimise
from softsensor.fitting.result import RunFit
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.first_start import WorkKind, compile_for
from softsensor.signals.moments import moments_of

if TYPE_CHECKING:
    from softsensor.diagnosis.finding import Diagnosis

# Numbers without another source were set by hand, 2026-11.

PROCESSES_FROM = 40
"""Runs from which worker processes pay for their start; below that, threads (the kernels run without the GIL)."""


def fit_campaign(
    press: Press,
    runs: Sequence[Run],
    *,
    shared: Sequence[str] = (),
    profiles: bool = False,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> CampaignFit:
    """Fit a campaign: every run, then all together as draws from one population.

    Parameters
    ----------
    shared
        Coefficients with one value in all runs; of no consequence for one run.
    profiles
        Whether to work out the profile of every coefficient in every run, for a report.
    progress
        Called with a run's name when it is done.
    options
        Of `fit_run`.

    Raises
    ------
    InputError
        As `fit_run` and `company_of`.
    """
    model, company = ThermalModel(press), company_of(press, runs, shared)
    fits = fit_runs(model, runs, workers=workers, progress=progress, company=company, **options)
    with ThreadPoolExecutor(_cores(workers, runs)) as threads:
        found = campaign_fit_of(model, fits, company.shared, threads.map)
        shapes = tuple(threads.map(profiles_of, fits)) if profiles else found.profiles
    return replace(found, profiles=shapes, method=options.get("method", "default"))


def fit_runs(
    model: ThermalModel,
    runs: Sequence[Run],
    *,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> list[RunFit]:
    """Fit every run on all cores, in order; `options` are those of `fit_run`."""
    workers, fit = _cores(workers, runs), partial(_fit, model, options)
    compile_for(WorkKind.FIT)
    # compiled before the first run, whose time would otherwise hold that
    moments = [moments_of(run, model.press) for run in runs]
    minimise(make_problem(model, runs[0], moments[0], options.get("start")), max_evaluations=1)
    if workers == 1:
        return _collect(map(fit, runs, moments), progress)
    if len(runs) < PROCESSES_FROM:
        with ThreadPoolExecutor(workers) as threads:
            return _collect(threads.map(fit, runs, moments), progress)
    with ProcessPoolExecutor(workers) as processes:
        return _collect(processes.map(fit, runs, moments, chunksize=4), progress)


def diagnosed_model(found: Diagnosis) -> ModelFile:
    """Return a diagnosis' extended model, and what its runs say when they are fitted with it.

    What it may leave out, how constants scatter, which panels there were.
    """
    extended, plain = found.model_file(), found.stages[0]
    model = extended.model(plain.fit.layout.model.press)
    fits = fit_runs(model, [d.digest.run for d in plain.data], start=extended.values, company=None)
    return held_against(extended, fits)


def _cores(workers: int | None, runs: Sequence[Run]) -> int:
    return max(1, min(workers or os.cpu_count() or 1, len(runs)))


def _fit(model: ThermalModel, options: dict[str, Any], run: Run, moments: Moments) -> RunFit:
    begun = time.perf_counter()
    fitted = fit_run(model, run, moments, **options)
    return replace(fitted, seconds=time.perf_counter() - begun)


def _collect(fits: Iterable[RunFit], progress: Callable[[str], None] | None) -> list[RunFit]:
    done = []
    for fitted in fits:
        done.append(fitted)
        if progress is not None:
            progress(fitted.run)
    return done
