"""Coefficients of a campaign: mean and spread over its runs, jointly estimated, and what they depend on.

Two answers stand side by side. The paper's: mean, standard deviation and 95 % interval of the mean over the runs
in which a coefficient is identifiable (Student's t, and a bootstrap over runs). And the joint one: every
run's coefficients are drawn from one log-normal population whose median and spread are estimated together
with them, so that a run which hardly shows a coefficient borrows it from the others. The joint one is what a
model file holds. A run that the model does not describe (`RunFit.misfit`) is reported and takes no part in either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import Press, press_for_run
from daq.printed import lines_of
from daq.records import Array, InputError, Run
from daq.words import Message, say
from softsensor.fitting.constants import with_constants_of
from softsensor.fitting.dependence import Dependence, Program, fit_dependence
from softsensor.fitting.experiment_advice import Company
from softsensor.fitting.identifiability import WIDE, LikelihoodProfile, is_verdict_on
from softsensor.fitting.joint import fit_together
from softsensor.fitting.population import Population, information
from softsensor.fitting.result import Coefficient, Identifiability, RunFit, json_number, rounded
from softsensor.fitting.unknowns import known_before
from softsensor.heat.batch import Each
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.signals.doubt import ALLOWED
from softsensor.signals.instrument import SPREAD_RUNS
from softsensor.signals.student import student
from softsensor.signals.unknown import BAND, CENTRAL, FAR_LOG

# Numbers without another source were set by hand, 2026-11.

LIMITS_SD, LEAST_PRIOR = 2.0 * ALLOWED, 1e-3
"""A coefficient's limits lie so many standard deviations apart, their 95 %; of its logarithm one is at least so
much."""
BOOTSTRAPS = 4000
"""Resamplings: ends of a 95 % interval then vary by some 2 % of it."""
NAMED_RUNS = 5
"""Runs a finding names; more are counted."""


@dataclass(frozen=True)
class CampaignCoefficient:
    """One coefficient over a campaign."""

    mean: float
    """Over the runs in which it is identifiable; the population's median where there are none."""
    sd: float
    """From run to run, estimation error included; NaN below two runs, 0 where all share one value."""
    ci95: tuple[float, float]
    """Of the mean, by Student's t."""
    bootstrap95: tuple[float, float]
    """Of the mean, by a bootstrap over runs."""
    runs: int
    """In which it is identifiable; where all share one value, all or none of those the model describes."""
    median: float
    """Of the population the runs are drawn from, estimated jointly."""
    median_ci95: tuple[float, float]
    spread: float
    """Of the logarithm from run to run, estimation error taken out."""

    def __str__(self) -> str:
        """Return mean and scatter, and how many runs know it."""
        scatter = f", sd {self.sd:.2g}" if np.isfinite(self.sd) else ""
        return f"{rounded(self.mean, self.ci95):g}{scatter}, known from {self.runs}" if self.runs else "–"


@dataclass(frozen=True, eq=False)
class CampaignFit:
    """What a campaign says about a press."""

    press: Press
    """The press, as its file has it."""
    model: ThermalModel
    """What the runs were fitted with."""
    runs: tuple[RunFit, ...]
    """Each run's fit, in the order given."""
    coefficients: Mapping[str, CampaignCoefficient]
    """What the described runs say of each coefficient together."""
    population: Population
    """How coefficients scatter from run to run."""
    borrowed: Mapping[str, Mapping[str, FittedValue]]
    """By run and coefficient: the run's value with what it borrows from the others; only runs that are met."""
    dependence: Dependence | None
    """On platen temperature, pressure and press time, where they vary."""
    shared: tuple[str, ...] = ()
    """Coefficients with one value in all runs."""
    profiles: tuple[Mapping[str, LikelihoodProfile], ...] = ()
    """By run and coefficient; of runs for which they were not asked empty."""
    method: str = "default"
    """By which rule the runs were fitted."""

    def __repr__(self) -> str:
        """Return on one screen how many runs there are, and what they say of each coefficient. [W/m²K]"""
        head = f"Campaign on press {self.press.name}: {len(self.runs)} runs, {len(self.met)} of them described"
        lines = [f"{name} = {c}" for name, c in self.coefficients.items()]
        return "\n".join([head, *lines_of(lines)])

    @property
    def met(self) -> tuple[RunFit, ...]:
        """The runs that the model describes; all statements on the campaign rest on them."""
        return tuple(f for f in self.runs if f.met)

    @property
    def shortfall(self) -> Message | None:
        """What has to be reported first: which runs the model does not describe; None where it does all."""
        left = [(f.run, f.misfit) for f in self.runs if f.misfit is not None]
        if not left:
            return None
        if len(self.runs) == 1:
            return say("fit-shortfall-one", misfit=left[0][1])
        named = tuple(say("fit-shortfall-run", run=run, misfit=why) for run, why in left[:NAMED_RUNS])
        more = len(left) - len(named)
        if not self.met:
            return say("fit-shortfall-all", runs=named, more=more)
        return say("fit-shortfall-some", count=len(left), total=len(self.runs), runs=named, more=more)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``fit --json``."""
        campaign = {
            name: {
                "mean": json_number(c.mean),
                "sd": json_number(c.sd),
                "ci95": [json_number(v) for v in c.ci95],
                "bootstrap95": [json_number(v) for v in c.bootstrap95],
                "runs": c.runs,
                "median": json_number(c.median),
                "median_ci95": [json_number(v) for v in c.median_ci95],
                "spread": json_number(c.spread),
                "shared": name in self.shared,
            }
            for name, c in self.coefficients.items()
        }
        runs = [f.as_json() for f in self.runs]
        for entry, fitted, shapes in zip(runs, self.runs, self.profiles, strict=True):
            for name, (e, ends) in self.joint(fitted.run).items():
                entry["coefficients"][name]["joint"] = {"value": e.value, "sd": e.sd, "ci95": list(ends)}
            entry["correlation"] = {
                "names": list(fitted.names),
                "matrix": [[json_number(v) for v in row] for row in np.round(fitted.correlation, 4)],
            }
            if shapes:
                entry["profiles"] = {name: shape.as_json() for name, shape in shapes.items()}
        depends = None if self.dependence is None else self.dependence.as_json()
        return {"runs": runs, "campaign": campaign, "dependence": depends}

    def joint(self, run: str) -> dict[str, tuple[FittedValue, tuple[float, float]]]:
        """Return a run's coefficients as all runs together know them, with 95 % intervals; empty if not met."""
        return {
            name: (e, self.coefficients[name].median_ci95 if name in self.shared else joint_interval(e))
            for name, e in self.borrowed.get(run, {}).items()
        }

    def program(self, settings: Mapping[str, float]) -> Program | None:
        """Return what a press program never run would be like, None where the runs cannot show it."""
        if self.dependence is None:
            return None
        tables = {n: self.press.coefficient(n) for n in self.coefficients}
        limits = {n: (table.lower, table.upper) for n, table in tables.items()}
        held = {n: (shared_estimate(c), c.median_ci95) for n, c in self.coefficients.items() if n in self.shared}
        return self.dependence.program(settings).within(limits).holding(held)

    def model_file(self, version: str = "fit") -> ModelFile:
        """Return the model file of a typical run: medians, and what a run may differ by.

        A spread taken from few runs is itself in doubt: it counts by Student's 95 %, with what was known of it
        before (`signals.instrument.SPREAD_RUNS`) among its degrees of freedom.
        """
        p = self.population
        wider = student(max(len(self.met), 1) - 1.0 + SPREAD_RUNS) / BAND
        total = p.mean_covariance + np.diag((wider * p.spread) ** 2)
        table: dict[str, FittedValue] = {}
        shrink = np.ones(len(p.names))
        for i, name in enumerate(p.names):
            middle, sd = _anchored(self.press, name, float(p.mean[i]), float(np.sqrt(total[i, i])))
            shrink[i] = sd / float(np.sqrt(total[i, i]))
            table[name] = FittedValue(float(np.exp(middle)), float(np.exp(middle)) * sd)
        total = total * np.outer(shrink, shrink)
        for name in self.press.coefficient_names:
            if name not in table:
                table[name] = FittedValue(self.press.coefficient(name).guess, 0.0)
        ordered = {n: table[n] for n in self.press.coefficient_names}
        found = ModelFile(version, self.press.name, ordered, (), p.names, total)
        return with_constants_of(found, [f.constants for f in self.met])


def joint_interval(estimate: FittedValue) -> tuple[float, float]:
    """Return the 95 % interval of a run's value as the joint fit knows it."""
    reach = float(np.exp(min(BAND * estimate.sd / estimate.value, FAR_LOG)))
    return estimate.value / reach, estimate.value * reach


def company_of(press: Press, runs: Sequence[Run], shared: Sequence[str] = ()) -> Company:
    """Return what runs fitted together know of one another.

    Parameters
    ----------
    shared
        Coefficients with one value in all runs; of no consequence for one run.

    Raises
    ------
    InputError
        Without a run, for a run whose header leaves a coefficient without use, or a shared name that is no free
        coefficient.
    """
    if not runs:
        raise InputError(say("fit-no-run"))
    names = press.free_coefficients
    if wrong := [n for n in shared if n not in names]:
        raise InputError(say("fit-no-such-shared", name=wrong[0], names=names))
    for run in runs:
        if gone := [n for n in names if n not in press_for_run(press, run).coefficient_names]:
            raise InputError(say("fit-coefficient-unused", run=run.source or run.name, name=gone[0]))
    return Company(len(runs), tuple(shared) if len(runs) > 1 else ())


def campaign_fit_of(
    model: ThermalModel, fits: Sequence[RunFit], shared: tuple[str, ...] = (), each: Each = map
) -> CampaignFit:
    """Take runs, each fitted alone, together as draws from one population.

    Parameters
    ----------
    shared
        Coefficients with one value in all runs.
    each
        Does some work for each of several things, as `map` does; a pool's does it on several cores.
    """
    press, names = model.press, model.press.free_coefficients
    met = [f for f in fits if f.met]
    people = fit_together(met, names, shared=shared, known=known_before(press), each=each)
    coefficients = {n: _summary(press, n, i, met, people, n in shared) for i, n in enumerate(names)}
    same = {n: coefficients[n] for n in names if n in shared}
    borrowed = {}
    for f, (mean, covariance) in zip(met, people.members, strict=True):
        sd = np.sqrt(np.diag(covariance))
        values = np.exp(mean)
        borrowed[f.run] = {n: FittedValue(float(values[i]), float(values[i] * sd[i])) for i, n in enumerate(names)}
        borrowed[f.run] |= {n: shared_estimate(c) for n, c in same.items()}
    varying = [n for n in names if n not in shared]
    alone = [information(f.problem, f.minimum.evaluation, f.spread, varying) for f in met]
    dependence = fit_dependence(varying, [f.problem.case.run for f in met], met, alone)
    runs = tuple(_with_shared(f, same) for f in fits)
    unasked: tuple[Mapping[str, LikelihoodProfile], ...] = ({},) * len(fits)
    return CampaignFit(press, model, runs, coefficients, people, borrowed, dependence, shared, unasked)


def shared_estimate(c: CampaignCoefficient) -> FittedValue:
    """Return a coefficient with one value in all runs: that value, and how well it is known."""
    return FittedValue(c.median, c.median * float(np.log(c.median_ci95[1] / c.median_ci95[0])) / (2.0 * BAND))


def _with_shared(fitted: RunFit, same: Mapping[str, CampaignCoefficient]) -> RunFit:
    """Return a run's fit with the one value of each coefficient that all runs share, where it is described."""
    if not fitted.met or not same:
        return fitted
    shared = {}
    for name, c in same.items():
        e = shared_estimate(c)
        reason = say("fit-shared" if c.runs else "fit-shared-unknown")
        shared[name] = Coefficient(e.value, e.sd, c.median_ci95, c.runs > 0, Identifiability.SHARED, reason)
    notes = tuple(w for w in fitted.warnings if not is_verdict_on(w, same))
    return replace(fitted, coefficients={**fitted.coefficients, **shared}, warnings=notes)


def _anchored(press: Press, name: str, middle: float, sd: float) -> tuple[float, float]:
    """Return the logarithm of a coefficient and its error, joined with what the press file allows.

    The limits count as 95 % of a log-normal about the guess: no more than a hint where runs speak, and
    all there is where none does.
    """
    table = press.coefficient(name)
    prior = max(float(np.log(table.upper / table.lower)) / LIMITS_SD, LEAST_PRIOR)
    weight = prior**2 / (prior**2 + sd**2)
    joined = weight * middle + (1.0 - weight) * float(np.log(table.guess))
    limited = float(np.clip(joined, np.log(table.lower), np.log(table.upper)))
    return limited, sd * float(np.sqrt(weight))


def _summary(
    press: Press, name: str, i: int, fits: Sequence[RunFit], people: Population, shared: bool
) -> CampaignCoefficient:
    values = np.array([f.coefficients[name].value for f in fits if f.coefficients[name].identifiable])
    n = len(values)
    table = press.coefficient(name)
    middle, error = _anchored(press, name, float(people.mean[i]), float(np.sqrt(people.mean_covariance[i, i])))
    median = float(np.exp(middle))
    quantile = student(max(len(fits) - 1, 1))
    if shared and fits:  # no scatter between runs is estimated: the runs' own noise decides
        quantile = max(f.quantile for f in fits)
    reach = min(quantile * error, FAR_LOG)
    interval = (max(median * float(np.exp(-reach)), table.lower), min(median * float(np.exp(reach)), table.upper))
    if shared:
        inside = interval[0] > table.lower and interval[1] < table.upper
        known = inside and float(np.log(interval[1] / interval[0])) < WIDE
        runs = len(fits) if known else 0
        return CampaignCoefficient(median, 0.0, interval, interval, runs, median, interval, 0.0)
    if n >= 2:
        mean, sd = float(values.mean()), float(values.std(ddof=1))
        half = student(n - 1) * sd / np.sqrt(n)
        ci = (max(mean - half, min(table.lower, values.min())), min(mean + half, max(table.upper, values.max())))
        bootstrap = _bootstrap(values)
    else:
        mean, sd = (float(values[0]) if n else median), float("nan")
        single = next((f.coefficients[name].ci95 for f in fits if f.coefficients[name].identifiable), interval)
        ci = bootstrap = single
    spread = float(people.spread[i])
    return CampaignCoefficient(mean, sd, ci, bootstrap, n, median, interval, spread)


def _bootstrap(values: Array) -> tuple[float, float]:
    """Percentile interval of the mean over resampled runs; the same runs give the same interval."""
    rng = np.random.default_rng(20261121)
    means = values[rng.integers(0, len(values), (BOOTSTRAPS, len(values)))].mean(axis=1)
    low, high = np.quantile(means, CENTRAL)
    return float(low), float(high)
