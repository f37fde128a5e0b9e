"""The paper's procedures by name, and why its gradient least squares got stuck.

The paper fitted averages of upper and lower sensors with an adaptive ODE solver and finite differences, found
gradient least squares stuck, and went on with Nelder-Mead followed by weighted least squares. Its procedures are
here on our solver. `reproduce` runs the four combinations of {adaptive, exact} solver and {finite differences,
exact sensitivities} on one virtual campaign: adaptive steps change with the coefficients, so the cost has
steps of its own, and differences over a millionth of a coefficient measure those steps and not the slope.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.optimize import least_squares, minimize

from daq.printed import on_screen
from daq.records import Array, InputError, Moments, Run
from daq.words import Message, say
from softsensor.fitting.paper.ode import Lines, lines_of
from softsensor.fitting.problem import rows_with_panel
from softsensor.heat.case import Case
from softsensor.heat.model import ThermalModel
from softsensor.signals.instrument import LOGGER_STEP_K
from softsensor.signals.places import collect_signals
from softsensor.signals.robust import channel_scatter

METHODS = ("least_squares", "nelder_mead", "nelder_mead_then_least_squares")
STOP = 1e-4
"""The paper stops when the coefficients change by less than this."""

# Numbers without another source were set by hand, 2026-11.

LEAST_SCATTER_K = LOGGER_STEP_K
"""Sensors that happen to agree better than they can read get no more weight. [K]"""
STOP_COST = 1e-3
"""And the simplex when the cost does by less than this."""
SEARCHED = (np.log(0.01), np.log(1e6))
"""Logarithms of the coefficients that solvers are asked for: none to a perfect contact. [W/m²K]"""
AS_GOOD = 1.02
"""A search found the minimum where its cost is at most so many times the lowest that any found."""
ALONG = 0.02
"""How far to either side of the minimum the cost is drawn."""
EVERY_RUN_SHOWS = ("h_pp_o", "h_pp_c", "h_wa")
"""Coefficients whose error against the truth counts: the faces of any run that was pressed show these."""


class Solver(StrEnum):
    """Solvers that `reproduce` compares."""

    ADAPTIVE = "adaptive"
    EXACT = "exact"


class Slopes(StrEnum):
    """Where least squares takes its derivatives from."""

    DIFFERENCES = "finite differences"
    EXACT = "exact sensitivities"


@dataclass(frozen=True)
class PaperFit:
    """What one of the paper's procedures found in a run."""

    values: Mapping[str, float]
    converged: bool

    __repr__ = on_screen


@dataclass(frozen=True)
class _Fit:
    """Residuals of a run as the paper forms them."""

    model: ThermalModel
    case: Case
    names: tuple[str, ...]
    labels: tuple[str, ...]
    columns: tuple[str, ...]
    """One channel of each place, to find it in a solution."""
    readings: tuple[Array, ...]
    """By place, averages or every sensor (rows, series). [°C]"""
    weights: tuple[Array, ...]
    """By place: one over the sensors' scatter, 0 where nothing counts (rows, series). [1/K]"""
    own_offsets: bool
    """Whether each series has an offset of its own."""

    @property
    def limits(self) -> tuple[Array, Array]:
        """The press file's limits, as logarithms."""
        tables = [self.case.press.coefficient(n) for n in self.names]
        return np.log([t.lower for t in tables]) - 1e-9, np.log([t.upper for t in tables]) + 1e-9

    def solution(self, x: Array, *, derive: bool) -> tuple[Array, Array]:
        """Temperature of each place (rows, places), and its derivatives by ln h."""
        press = self.case.press
        values = {n: press.coefficient(n).guess for n in press.coefficient_names}
        values |= {n: float(np.exp(v)) for n, v in zip(self.names, x, strict=True)}
        found = self.model.solve(self.case, values, self.names if derive else ())
        columns = [found.columns.index(c) for c in self.columns]
        slopes = [found.d_sensors[n][:, columns] * values[n] for n in self.names] if derive else []
        return found.sensors[:, columns], np.stack(slopes, axis=-1) if derive else np.zeros(0)

    def residuals(self, predicted: Array) -> Array:
        """Weighted residuals, one long row (readings)."""
        parts = []
        for i, (read, weight) in enumerate(zip(self.readings, self.weights, strict=True)):
            parts.append((weight * self._centred(read - predicted[:, [i]], weight)).ravel())
        return np.concatenate(parts)

    def jacobian(self, slopes: Array) -> Array:
        """Derivatives of `residuals` (readings, coefficients)."""
        parts = []
        for i, weight in enumerate(self.weights):
            derived = [
                weight * self._centred(np.broadcast_to(d[:, None], weight.shape), weight) for d in slopes[:, i].T
            ]
            parts.append(-np.stack([d.ravel() for d in derived], axis=-1))
        return np.concatenate(parts)

    def _centred(self, series: Array, weight: Array) -> Array:
        """Take each series' weighted mean away where it has an offset of its own."""
        if not self.own_offsets:
            return series
        square = weight * weight
        return np.asarray(series - (square * series).sum(axis=0) / np.maximum(square.sum(axis=0), 1e-12))


def fit_as_paper(
    model: ThermalModel,
    run: Run,
    moments: Moments,
    method: str = "nelder_mead_then_least_squares",
    *,
    every: bool = False,
    start: Mapping[str, float] | None = None,
) -> PaperFit:
    """Fit a run by one of the paper's procedures.

    Parameters
    ----------
    method
        ``least_squares`` (gradient alone), ``nelder_mead`` alone, or Nelder-Mead and then least squares.
    every
        Every sensor with its own offset instead of top and bottom averages.
    """
    if method not in METHODS:
        raise InputError(say("fit-no-such-method", method=method, methods=tuple(METHODS)))
    problem = _prepare(model, run, moments, every)
    guesses = {**replace(model, press=problem.case.press).guesses, **(start or {})}
    low, high = problem.limits
    x = np.clip(np.log([guesses[n] for n in problem.names]), low, high)
    converged = True
    if method != "least_squares":
        rough = minimize(
            lambda v: float(np.sum(problem.residuals(problem.solution(v, derive=False)[0]) ** 2)),
            x, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
            options={"xatol": STOP, "fatol": STOP_COST, "maxfev": 1200},
        )  # fmt: skip
        x, converged = rough.x, bool(rough.success)
    if method != "nelder_mead":
        polished = least_squares(
            lambda v: problem.residuals(problem.solution(v, derive=False)[0]),
            x,
            jac=lambda v: problem.jacobian(problem.solution(v, derive=True)[1]),
            bounds=(low, high),
            xtol=STOP,
        )
        x, converged = polished.x, bool(polished.success)
    values = {n: float(np.exp(v)) for n, v in zip(problem.names, x, strict=True)}
    return PaperFit(values, converged)


def _prepare(model: ThermalModel, run: Run, moments: Moments, every: bool) -> _Fit:
    case = model.prepare(run, moments)
    press = case.press
    names = tuple(n for n in press.coefficient_names if not press.coefficient(n).fixed)
    signals = collect_signals(press, run, moments)
    if not names or not signals.places:
        raise InputError(say("fit-nothing-to-fit", run=run.source or run.name))
    counted = rows_with_panel(case)[:, None] > 0
    readings, weights = [], []
    for place in signals.places:
        cells = np.stack([signals.cells[c] for c in place.columns], axis=1)
        series = cells if every else place.mean[:, None]
        used = counted & np.isfinite(series)
        readings.append(np.where(used, series, 0.0))
        spread = np.maximum(channel_scatter(cells, own_offsets=every), LEAST_SCATTER_K)
        weights.append(used / spread[:, None])
    labels = tuple(p.label for p in signals.places)
    columns = tuple(p.columns[0] for p in signals.places)
    return _Fit(model, case, names, labels, columns, tuple(readings), tuple(weights), every)


@dataclass(frozen=True)
class Combination:
    """One row of the table: a solver and a way to get slopes, over all measurements."""

    solver: str
    """By its name."""
    slopes: str
    """How derivatives were found."""
    converged: int
    """Measurements in which it reached the lowest cost any combination found (within 2 %)."""
    runs: int
    """How many measurements there were."""
    seconds: float
    """Mean time a measurement. [s]"""
    evaluations: float
    """Mean solves a measurement, differences counted."""
    error: float
    """Median over measurements of the largest |ln h / h_true| of the coefficients a run shows."""

    __repr__ = on_screen


@dataclass(frozen=True, eq=False)
class SolverComparison:
    """The table, and the cost along one coefficient for either solver."""

    table: tuple[Combination, ...]
    """One entry for each pair of solver and slopes."""
    coefficient: str
    """Name of the one along which the cost is drawn."""
    relative: Array
    """Where it is drawn: the coefficient over its value at the minimum (n). [-]"""
    adaptive: Array
    """By how much the cost exceeds its least with the adaptive solver, per residual (n). [-]"""
    exact: Array
    """The same with the exact solver (n). [-]"""

    @property
    def slope_changes(self) -> tuple[int, int]:
        """How often the cost's slope changes sign along the coefficient: adaptive solver, exact solver."""
        rough, smooth = (int(np.sum(np.diff(np.sign(np.diff(y))) != 0)) for y in (self.adaptive, self.exact))
        return rough, smooth

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``fit --reproduce-paper --json``."""
        return {
            "table": [
                {
                    "solver": c.solver,
                    "slopes": c.slopes,
                    "converged": c.converged,
                    "runs": c.runs,
                    "seconds": c.seconds,
                    "solves": c.evaluations,
                    "error": float(np.exp(c.error) - 1.0),
                }
                for c in self.table
            ],
            "cost_along": {
                "coefficient": self.coefficient,
                "relative": self.relative.tolist(),
                "adaptive": self.adaptive.tolist(),
                "exact": self.exact.tolist(),
                "slope_changes": {"adaptive": self.slope_changes[0], "exact": self.slope_changes[1]},
            },
        }

    @property
    def message(self) -> Message:
        """What the two curves show."""
        adaptive, exact = self.slope_changes
        span = 100 * float(self.relative[-1] - 1.0)
        return say("paper-slope-changes", name=self.coefficient, span=span, adaptive=adaptive, exact=exact)

    @property
    def rows(self) -> list[dict[str, Message]]:
        """The table, cell by cell in the order of its columns."""
        return [
            {
                "solver": Message(f"paper-{c.solver}"),
                "slopes": Message(f"paper-{c.slopes.replace(' ', '-')}"),
                "converged": say("report-count-of", count=c.converged, total=c.runs),
                "time": say("report-hundredths", value=c.seconds),
                "solves": say("report-number-3", value=c.evaluations),
                "error": say("report-percent", percent=100 * (float(np.exp(c.error)) - 1)),
            }
            for c in self.table
        ]


def reproduce(
    measurements: Sequence[tuple[Run, Moments, Mapping[str, float]]],
    model: ThermalModel,
    *,
    judged: Sequence[str] = EVERY_RUN_SHOWS,
    seed: int = 1,
    clock: Callable[[], float],
    progress: Callable[[int], None] | None = None,
) -> SolverComparison:
    """Run the four combinations; arguments as `softsensor.reproduce` explains them."""
    rng = np.random.default_rng(seed)
    results: dict[tuple[Solver, Slopes], list[_Outcome]] = {}
    for number, (run, moments, truth) in enumerate(measurements, start=1):
        problem = _prepare(model, run, moments, every=False)
        start = np.log([truth[n] for n in problem.names]) + rng.uniform(-np.log(3), np.log(3), len(problem.names))
        lines = lines_of(model, problem.case, problem.names, problem.labels)
        for solver in Solver:
            for slopes in Slopes:
                begun = clock()
                outcome = _search(problem, lines if solver is Solver.ADAPTIVE else None, slopes, start)
                outcome = replace(outcome, seconds=clock() - begun)
                results.setdefault((solver, slopes), []).append(outcome)
        if progress is not None:
            progress(number)
    table = _table(results, [truth for _, _, truth in measurements], problem.names, judged)
    return SolverComparison(table, *_cost_along(problem, lines, results[Solver.EXACT, Slopes.EXACT][-1].x))


@dataclass(frozen=True)
class _Outcome:
    x: Array
    cost: float
    """By the exact solver, so that all are measured alike."""
    solves: int
    seconds: float = float("nan")


def _search(problem: _Fit, lines: Lines | None, slopes: Slopes, start: Array) -> _Outcome:
    """Run scipy's least squares at its defaults with one solver and one kind of slopes."""
    count = [0]

    def solve(x: Array, derive: bool) -> tuple[Array, Array]:
        count[0] += 1
        x = np.clip(x, *SEARCHED)
        return (
            problem.solution(x, derive=derive) if lines is None else lines.solve(np.exp(x), sensitivities=derive)
        )

    exact = slopes is Slopes.EXACT
    memory: dict[bytes, tuple[Array, Array]] = {}

    def both(x: Array) -> tuple[Array, Array]:
        if x.tobytes() not in memory:
            memory.clear()
            memory[x.tobytes()] = solve(x, True)
        return memory[x.tobytes()]

    def value(x: Array) -> Array:
        return problem.residuals(both(x)[0] if exact else solve(x, False)[0])

    jacobian = (lambda x: problem.jacobian(both(x)[1])) if exact else "2-point"
    found = least_squares(value, start, jac=jacobian, max_nfev=60)
    final = problem.residuals(problem.solution(np.clip(found.x, *SEARCHED), derive=False)[0])
    return _Outcome(np.asarray(found.x), float(final @ final), count[0])


def _table(
    results: Mapping[tuple[Solver, Slopes], Sequence[_Outcome]],
    truths: Sequence[Mapping[str, float]],
    names: Sequence[str],
    judged: Sequence[str],
) -> tuple[Combination, ...]:
    best = [min(outcomes[r].cost for outcomes in results.values()) for r in range(len(truths))]
    index = [names.index(n) for n in judged if n in names]
    rows = []
    for (solver, slopes), outcomes in results.items():
        errors = [
            max(abs(o.x[i] - np.log(truth[names[i]])) for i in index)
            for o, truth in zip(outcomes, truths, strict=True)
        ]
        rows.append(
            Combination(
                solver,
                slopes,
                sum(o.cost <= AS_GOOD * lowest for o, lowest in zip(outcomes, best, strict=True)),
                len(outcomes),
                float(np.mean([o.seconds for o in outcomes])),
                float(np.mean([o.solves for o in outcomes])),
                float(np.median(errors)),
            )
        )
    return tuple(rows)


def _cost_along(problem: _Fit, lines: Lines, x: Array, points: int = 81) -> tuple[str, Array, Array, Array]:
    """Cost along the last but one coefficient that closes the press, to either side of the minimum."""
    i = next((problem.names.index(n) for n in ("h_pp_c",) if n in problem.names), 0)
    relative = np.linspace(1.0 - ALONG, 1.0 + ALONG, points)
    adaptive, exact = np.empty(points), np.empty(points)
    for k, factor in enumerate(relative):
        at = x.copy()
        at[i] += np.log(factor)
        for costs, predicted in (
            (adaptive, lines.solve(np.exp(at), sensitivities=False)[0]),
            (exact, problem.solution(at, derive=False)[0]),
        ):
            residual = problem.residuals(predicted)
            costs[k] = float(residual @ residual) / len(residual)
    return problem.names[i], relative, adaptive - adaptive.min(), exact - exact.min()
