"""The constants of a run as unknowns of its fit: how far each may be off, and what that does to the readings.

A fit that takes thickness, conductivity and heat capacity for exact calls coefficients sure that are not: contact
and panel act on a face together. So each uncertain constant (`softsensor.signals.doubt`) stands beside the
unknowns with its own prior and its linear sensitivity: the change of the prediction for one standard deviation,
from one more solution. It is held at what is given and its doubt goes into the intervals
(`problem.left_open`). Free, it took upon itself what a hidden cause leaves over: with moisture hidden in twelve
runs the open contact was then 34 % off (rms) instead of 3 to 7 %, and without a cause the core no nearer
(seed 77, 2026-11-22). What the readings say of it all the same, `constants_of` returns.

Density enters a layer's heat balance with its heat capacity alone, so both are one unknown here. What already is a
nuisance of the measuring chain (start temperature) is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.header import panel_of
from daq.press.press_file import Press, Property
from daq.records import Array, InputError, Run
from softsensor.fitting.problem import (
    CONSTANT,
    FitProblem,
    Minimum,
    constants_among,
    covariance_of,
    normal_equations,
)
from softsensor.fitting.unknowns import nuisance
from softsensor.heat.chain import Solution
from softsensor.heat.model_file import ModelFile, Scatter
from softsensor.signals.doubt import PANEL_TO_PANEL, PRODUCT_SD, Doubt, Origin, constant_doubts
from softsensor.signals.instrument import SPREAD_RUNS
from softsensor.signals.pressed import all_products, products
from softsensor.signals.unknown import Unknown

THICKNESS = "panel.thickness_mm"
CAPACITY, DENSITY = "heat_capacity_J_kgK", "density_kg_m3"
LEFT_OUT = ("panel.initial_temperature_C", "panel.moisture_percent")
"""A nuisance of its own, and without effect but for a cause of the catalogue."""


@dataclass(frozen=True)
class ConstantFit:
    """What a run says about one of its constants."""

    given: float
    """In header, press file or table, in the unit of its key."""
    sd: float
    """How far it may be off before the run."""
    source: Origin
    value: float
    """As the run has it."""
    value_sd: float

    def as_json(self) -> dict[str, Any]:
        """Return the constant's entry of ``fit --json``."""
        return {
            "given": self.given,
            "sd": self.sd,
            "source": self.source.value,
            "value": self.value,
            "value_sd": self.value_sd,
        }

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> ConstantFit:
        """Return the constant that `as_json` wrote."""
        return cls(**{**entry, "source": Origin(entry["source"])})


def fit_doubts(run: Run, press: Press, learned: Mapping[str, float] | None = None) -> dict[str, Doubt]:
    """Return the constants a fit leaves open: density joined to heat capacity, as both act together."""
    found = constant_doubts(run.header, press, learned)
    for key in [key for key in found if key.endswith(DENSITY)]:
        density = found.pop(key)
        capacity = key.removesuffix(DENSITY) + CAPACITY
        if (own := found.get(capacity)) is not None:
            sd = abs(own.value) * float(np.hypot(own.relative, density.relative))
            found[capacity] = replace(own, sd=sd)
    return {key: doubt for key, doubt in found.items() if key not in LEFT_OUT}


def constant_unknowns(doubts: Mapping[str, Doubt]) -> list[Unknown]:
    """Return the constants as nuisances held where they are: changes in the unit of their keys."""
    return [nuisance(f"{CONSTANT}:{key}", doubt.sd, 0.0) for key, doubt in doubts.items()]


def with_constants(problem: FitProblem, x: Array) -> FitProblem:
    """Return the problem with what a change of each constant does to the prediction, taken at a point."""
    keys = [u.name.partition(":")[2] for u in problem.unknowns if u.name.startswith(f"{CONSTANT}:")]
    if not keys:
        return problem
    case, values = problem.case, problem.merged(x)
    places = [case.columns.index(p.columns[0]) for p in problem.signals.places]
    before = problem.model.solve(case, values).sensors
    sizes = {u.name.partition(":")[2]: u.unit for u in problem.unknowns}
    constant = {}
    for key in keys:
        change, changed = changed_by(problem, key, sizes[key], values)
        constant[key] = tuple((changed.sensors[:, i] - before[:, i]) / change for i in places)
    return replace(problem, constant=constant)


def changed_by(problem: FitProblem, key: str, size: float, values: Mapping[str, float]) -> tuple[float, Solution]:
    """Return a change of a constant, down or else up, whichever a limit allows, and what is then predicted."""
    case, model = problem.case, problem.model
    try:
        changed = model.prepare(changed_run(case.run, case.press, key, -size), case.moments)
    except InputError:
        size = -size
        changed = model.prepare(changed_run(case.run, case.press, key, -size), case.moments)
    return -size, model.solve(changed, values)


def changed_run(run: Run, press: Press, key: str, change: float) -> Run:
    """Return the run with one constant changed in its header, a table in temperature by one factor."""
    given = run.header.get(key)
    if given is None:
        given = _given_elsewhere(run, press, key)
    return replace(run, header={**run.header, key: _moved(given, change)})


def _given_elsewhere(run: Run, press: Press, key: str) -> Property:
    """Return a constant the header leaves to the material table, the press file or a default."""
    root, _, name = key.partition(".")
    if key == "ambient.temperature_C":
        return run.ambient_temperature
    if root == "panel":
        panel = panel_of(run)
        return {"conductivity_W_mK": panel.conductivity, CAPACITY: panel.heat_capacity}[name]
    found: Any = press
    for step in key.split("."):
        if isinstance(found, tuple):
            found = next((x for x in found if getattr(x, "name", None) == step), None) or found[int(step)]
        else:
            found = getattr(found, step)
    return found  # type: ignore[no-any-return]


def _moved(given: Any, change: float) -> Any:
    if isinstance(given, list | tuple):
        return [[t, value * (1.0 + change / given[0][1])] for t, value in given]
    return float(given) + change


def constants_of(problem: FitProblem, best: Minimum, spread: float) -> dict[str, ConstantFit]:
    """Return what a run says about its constants: one Gauss-Newton step from the end of the search, all free.

    `spread` is how much larger the whitened residuals are than the noise model says: what the readings show
    counts for so much less (squared) beside the priors, for a constant's value as for its standard deviation, or
    the two together would be no one's knowledge and `scatter_of` could not take the prior out again.
    """
    matrix, right = normal_equations(problem, best.evaluation, spread)
    constants = constants_among(problem)
    free = np.logical_not(best.held)
    free[constants] = True
    covariance = covariance_of(matrix, free)
    found = {}
    for i in constants:
        u = problem.unknowns[i]
        d = problem.doubts[u.name.partition(":")[2]]
        step, sd = covariance[i] @ right, float(np.sqrt(covariance[i, i]))
        value = d.value + float(step) * u.unit
        found[u.name.partition(":")[2]] = ConstantFit(d.value, d.sd, d.source, value, u.unit * sd)
    return found


def with_constants_of(model: ModelFile, runs: Sequence[Mapping[str, ConstantFit]]) -> ModelFile:
    """Return a model file with what runs add to it: how constants scatter, and which panels there were."""
    pressed = products(run[THICKNESS].given for run in runs if THICKNESS in run)
    scatter = {**model.scatter, **scatter_of(runs)}
    return replace(model, scatter=scatter, panels=all_products(model.panels, pressed))


LEARNT = (Origin.DATA_SHEET, Origin.MATERIAL_TABLE, Origin.GUESS)


def scatter_of(runs: Iterable[Mapping[str, ConstantFit]]) -> dict[str, Scatter]:
    """Return by key of the panel how far it was from the header's in these runs, as a share.

    A hierarchy: the product is off what is given by a shift (`PRODUCT_SD`; none for other constants), panels
    scatter about the product (`PANEL_TO_PANEL`, which counts for `SPREAD_RUNS`; for other constants what they
    were in doubt by). By expectation-maximisation of the scatter over shift and panels, from each run's estimate
    with its prior taken out (Dempster, Rubin, Tsutakawa, JASA 76:341, 1981). A run that knows nothing of a
    constant leaves both where they were.
    """
    table: dict[str, list[ConstantFit]] = {}
    for run in runs:
        for key, c in run.items():
            if key.startswith("panel.") and c.source in LEARNT:
                table.setdefault(key, []).append(c)
    return {key: _scatter_of(key, fits) for key, fits in table.items()}


def _scatter_of(key: str, fits: Sequence[ConstantFit]) -> Scatter:
    """Return what runs show of one constant; `off` is what a run has it off, times its own precision."""
    prior = np.array([c.sd / abs(c.given) for c in fits])
    sd = np.maximum([c.value_sd / abs(c.given) for c in fits], 1e-9)
    knows = sd < prior * (1.0 - 1e-6)
    precision = np.where(knows, 1.0 / sd**2 - 1.0 / prior**2, 0.0)
    off = np.where(knows, np.array([(c.value - c.given) / abs(c.given) for c in fits]) / sd**2, 0.0)
    size2 = before = PANEL_TO_PANEL.get(key, float(np.sqrt(np.mean(prior**2)))) ** 2
    product2 = PRODUCT_SD.get(key, 0.0) ** 2
    for _ in range(200):
        apart = 1.0 + precision * size2
        shift2 = product2 / (1.0 + product2 * float(np.sum(precision / apart)))
        shift = shift2 * float(np.sum(off / apart))
        variance = size2 / apart
        squares = np.sum(variance**2 * ((off - precision * shift) ** 2 + precision**2 * shift2) + variance)
        new = (float(squares) + SPREAD_RUNS * before) / (len(fits) + SPREAD_RUNS)
        settled, size2 = abs(new - size2) < 1e-9, new
        if settled:
            break
    return Scatter(float(np.sqrt(shift**2 + shift2 + size2)), len(fits), float(np.sqrt(size2)))
