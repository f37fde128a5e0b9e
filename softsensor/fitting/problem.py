"""Least squares between a model and measured runs: unknowns, priors, whitened residuals, derivatives.

What a fit adjusts are `Unknown`s, each in its `unit`: coefficients in the logarithm, and nuisances (moments, start
temperature, boundary and channel errors) that carry priors. A `FitProblem` is a run; `minimise` finds its unknowns
by Levenberg-Marquardt with exact sensitivities, Huber weights and limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from daq.compiled import compiled
from daq.press.press_file import SD
from daq.printed import on_screen
from daq.records import Array
from softsensor.effects import clock_offset
from softsensor.heat.case import Case
from softsensor.heat.chain import Solution
from softsensor.heat.model import ThermalModel
from softsensor.heat.timing import HANDLING_RAMP_S, OPENING_RAMP_S
from softsensor.signals.doubt import Doubt, Origin
from softsensor.signals.instrument import RAMPS_S
from softsensor.signals.places import Noise, Signals, whiten
from softsensor.signals.robust import Flags
from softsensor.signals.unknown import Unknown

# Numbers without another source were set by hand, 2026-11. Where one has "x up, y down", a fit of sample run 7
# moves by so many of its standard deviations at most when that is half as large again, and a third smaller
# (`tests.calibration.set_by_hand fit`, seed 2026, 2026-11-29).

HUBER = 3.0
"""Whitened residuals beyond this count in proportion, not squared, once a search is near its end: three standard
deviations. 0.69 up, 0.13 down."""
SWITCH_TIMING_S = 0.025
"""How well the press's motion is described by straight ramps: as a delay, while it closes or opens. 0.19 up, 0.06
down. [s]"""
SWITCH_EDGE_S = 0.2
"""Rows this close to a ramp count as part of it. 0.55 up, 0.12 down. [s]"""
STALLED = 0.05
"""A search that stalls this close to the minimum, in loss, has found it: 0.3 standard deviations if the loss is a
parabola. 0 up, 0.51 down: where it is none, a search may end half a standard deviation off."""
EVERYWHERE = "all"
"""In place of a place: the unknown is common to all channels."""
CONSTANT = "constant"
"""Kind of the unknowns that are constants of panel, layers and surroundings, by their keys in the header."""
MAX_MOVE = 2.0
"""Largest change of a logarithm or of a scaled parameter in one step."""


class PlaceUnknown(StrEnum):
    """What a fit adjusts of the channels at a place."""

    OFFSET = "offset"
    GAIN = "gain"
    SKEW = "skew"
    """How late they are read."""

    def at(self, place: str) -> str:
        """Return the unknown's name."""
        return f"{self}:{place}"


@dataclass(frozen=True)
class Evaluation:
    """Whitened residuals and their derivatives at one point."""

    x: Array
    z: Array
    """Whitened residuals (rows of all places)."""
    jacobian: Array
    """Whitened derivatives of the prediction (rows, unknowns)."""
    weight: Array
    """Huber weights (rows)."""
    loss: float
    """Half of minus two log likelihood, priors included, up to a constant."""
    solution: Solution
    residual: tuple[Array, ...]
    """By place: mean of the channels minus prediction, nuisances applied (rows). [K]"""
    derivative: tuple[Array, ...]
    """By place: of the prediction by the internal variables (rows, unknowns). [K]"""

    __repr__ = on_screen


@dataclass(frozen=True)
class FitProblem:
    """One run to be fitted."""

    model: ThermalModel
    case: Case
    signals: Signals
    unknowns: tuple[Unknown, ...]
    """Coefficients, nuisances of the model, ``offset|gain|skew:PLACE``, ``constant:KEY``."""
    values: Mapping[str, float]
    """Every coefficient and effect parameter; the unknowns among them are overridden."""
    noise: Noise
    rows: Array
    """1 where a row counts: a panel is in the press."""
    correction: tuple[Array, ...] = ()
    """By place: prediction on a finer grid minus this grid's, worked out once (rows). [K]"""
    slope: tuple[Array, ...] = ()
    """By place: how fast the prediction rises, taken once near the solution (rows). [K/s]"""
    doubts: Mapping[str, Doubt] = field(default_factory=dict)
    """Of the constants among the unknowns, by key."""
    blur: tuple[Array, ...] = ()
    """By place: what timing leaves unknown of each row (rows). [K]"""
    moving: Flags | None = None
    """Rows in which the press opens or closes or a panel is put in: their moment decides what is left of them, not
    the model (rows)."""
    huber: float = HUBER
    """Whitened residuals beyond this count in proportion; infinite: all are squared."""
    constant: Mapping[str, tuple[Array, ...]] = field(default_factory=dict)
    """By key and place: the prediction's derivative by a constant, taken once near the solution (rows).
    [K per unit of the key]"""

    __repr__ = on_screen

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(u.name for u in self.unknowns)

    @property
    def start(self) -> Array:
        """Internal variables where the search begins (unknowns)."""
        return np.array([u.begin / u.unit for u in self.unknowns])

    @property
    def limits(self) -> tuple[Array, Array]:
        """Limits of the internal variables (unknowns), (unknowns)."""
        return (
            np.array([u.lower / u.unit for u in self.unknowns]),
            np.array([u.upper / u.unit for u in self.unknowns]),
        )

    @property
    def precision(self) -> tuple[Array, Array]:
        """Means of the priors and their inverse variances, 0 where there is none (unknowns), (unknowns)."""
        at = [(u.centre / u.unit, (u.unit / u.sd) ** 2) for u in self.unknowns]
        return np.array([mean for mean, _ in at]), np.array([precision for _, precision in at])

    def merged(self, x: Array) -> dict[str, float]:
        """Return every parameter's value at a point."""
        own = {u.name: u.value(v * u.unit) for u, v in zip(self.unknowns, x, strict=True) if ":" not in u.name}
        return {**self.values, **own}

    def predict(self, x: Array) -> Solution:
        """Solve the model at a point, with the derivatives by its unknowns but those that are held."""
        wanted = [u.name for u in self.unknowns if ":" not in u.name and u.lower < u.upper]
        return self.model.solve(self.case, self.merged(x), wanted)

    def evaluate(self, x: Array) -> Evaluation:
        """Return residuals, derivatives and loss at a point."""
        solution = self.predict(x)
        z, jacobian, residuals, derivatives = [], [], [], []
        for i in range(len(self.signals.places)):
            residual, derivative = self._place(i, x, solution)
            white = self._whitened(i, residual, derivative)
            z.append(white[:, 0])
            jacobian.append(white[:, 1:])
            residuals.append(residual)
            derivatives.append(derivative)
        stacked = np.concatenate(z)
        far = np.abs(stacked)
        near = np.minimum(far, self.huber)
        mean, precision = self.precision
        pull = x - mean
        loss = 0.5 * float((near * (2.0 * far - near)).sum() + pull @ (precision * pull))
        return Evaluation(
            x=x,
            z=stacked,
            jacobian=np.concatenate(jacobian),
            weight=near / np.maximum(far, 1e-300),
            loss=loss,
            solution=solution,
            residual=tuple(residuals),
            derivative=tuple(derivatives),
        )

    def variance(self, i: int) -> Array:
        """Return the white part of a place's variance (rows). [K²]"""
        place = self.signals.places[i]
        variance = self.noise.white_K**2 / np.maximum(place.count, 1.0)
        if self.blur:
            variance = variance + self.blur[i] ** 2
        return np.asarray(variance)

    def whiten(self, i: int, series: Array) -> Array:
        """Whiten series of a place's mean as this problem's residuals are (rows, columns)."""
        place = self.signals.places[i]
        counted = np.where((self.rows > 0) & np.isfinite(place.mean), series[:, 0], np.nan)
        series = np.nan_to_num(series)
        series[:, 0] = counted
        return whiten(self.signals.time_s, series, self.variance(i), self.noise, len(place.columns))[0]

    def _whitened(self, i: int, residual: Array, derivative: Array) -> Array:
        return self.whiten(i, np.column_stack([residual, derivative]))

    def predicted(self, i: int, x: Array, solution: Solution) -> Array:
        """Return what the body has at a place: grid and constants corrected, the channels' errors aside (rows)."""
        column = solution.columns.index(self.signals.places[i].columns[0])
        predicted = solution.sensors[:, column]
        if self.correction:
            predicted = predicted + self.correction[i]
        for j, u in enumerate(self.unknowns):
            if (moved := self.constant.get(u.name.removeprefix(f"{CONSTANT}:"))) is not None:
                predicted = predicted + moved[i] * (x[j] * u.unit)
        return predicted

    def _place(self, i: int, x: Array, solution: Solution) -> tuple[Array, Array]:
        """Residual of a place's mean and the prediction's derivatives by the internal variables."""
        place = self.signals.places[i]
        column = solution.columns.index(place.columns[0])
        predicted = self.predicted(i, x, solution)
        derivative = np.zeros((len(predicted), len(self.unknowns)))
        added = np.zeros(len(predicted))
        for j, u in enumerate(self.unknowns):
            kind, named, label = u.name.partition(":")
            if not named:
                if u.name in solution.d_sensors:
                    derivative[:, j] = solution.d_sensors[u.name][:, column] * (u.slope(x[j] * u.unit) * u.unit)
            elif kind == CONSTANT:
                if label in self.constant:
                    derivative[:, j] = self.constant[label][i] * u.unit
            elif label in (place.label, EVERYWHERE):
                derivative[:, j] = self._channel_error(i, kind, predicted) * u.unit
                added += derivative[:, j] * x[j]
        return place.mean - predicted - added, derivative

    def _channel_error(self, i: int, kind: str, predicted: Array) -> Array | float:
        """Return what the channels of a place read more by one unit of an error of theirs (rows). [K]"""
        if kind == PlaceUnknown.OFFSET:
            return 1.0
        if kind == PlaceUnknown.GAIN:
            return predicted - self.case.ambient
        return -self.slope[i] if self.slope else 0.0


def rows_with_panel(case: Case) -> Array:
    """Return 1 for each row with a panel in the press, all ones where there is none or nothing opens (rows)."""
    if not case.press.has_states:
        return np.ones(len(case.run.time_s))
    idle = case.row_clock.shares({})[0][:, 0]
    rows = (idle < 0.5).astype(float)
    return rows if rows.any() else np.ones(len(rows))


def with_clock(model: ThermalModel) -> ThermalModel:
    """Return the model with a clock offset of 0 in it, whose derivative is the readings' slope."""
    if any(e.name == clock_offset.EFFECT.name for e in model.effects):
        return model
    return model.extended(clock_offset.EFFECT)


def with_motion(problem: FitProblem, x: Array, timing_s: float, reach_s: float = 0.0) -> FitProblem:
    """Return the problem with slopes and blur taken at a point.

    Rows are blurred by their slope times `timing_s`; while the press moves, when straight ramps stand for
    whatever it really does, by `SWITCH_TIMING_S` of the whole change across the ramp; `reach_s` is how far
    the moment may still wander.
    """
    t, moments = problem.signals.time_s, problem.case.moments
    values = problem.merged(x)
    solution = with_clock(problem.model).solve(problem.case, values, (clock_offset.SECONDS,))
    closing = (moments.closed_s + values.get("closed_s", 0.0), moments.ramp_s + values.get("ramp_s", 0.0))
    opening = (moments.opened_s + values.get("opened_s", 0.0), OPENING_RAMP_S)
    inserting = (moments.inserted_s + values.get("inserted_s", 0.0), HANDLING_RAMP_S)
    moves = []
    for moment, ramp in (inserting, closing, opening) if problem.case.press.has_states else ():
        edge = ramp / 2 + SWITCH_EDGE_S + reach_s
        if (rows := np.abs(t - moment) < edge).any():
            moves.append((rows, np.abs(t - moment) < edge + max(1.0, 1.1 * problem.signals.period_s), ramp))
    slope, blur = [], []
    for place in problem.signals.places:
        column = problem.case.columns.index(place.columns[0])
        slope.append(-solution.d_sensors[clock_offset.SECONDS][:, column])
        own = np.abs(slope[-1]) * timing_s
        for rows, around, ramp in moves:
            steepest = float(np.ptp(solution.sensors[around, column])) / max(ramp, RAMPS_S[0])
            own = np.where(rows, np.maximum(own, SWITCH_TIMING_S * steepest), own)
        blur.append(own)
    moving = np.any([np.zeros(len(t), bool), *(rows for rows, _, _ in moves)], axis=0)
    moving[0] = False  # what the first row reads is no matter of timing: nothing was seen to move before it
    return replace(problem, slope=tuple(slope), blur=tuple(blur), moving=moving)


def grid_correction(problem: FitProblem, x: Array) -> tuple[Array, ...]:
    """Return what a finer grid adds to the prediction at a point (rows). [K]

    The grid's error hardly depends on the unknowns, so one fine solution corrects all coarse ones.
    """
    case, values = problem.case, problem.merged(x)
    fine = problem.model.prepare(case.run, case.moments, fineness=2.0)
    difference = problem.model.solve(fine, values).sensors - problem.model.solve(case, values).sensors
    return tuple(difference[:, case.columns.index(p.columns[0])] for p in problem.signals.places)


@dataclass(frozen=True)
class Minimum:
    """Where a search ended."""

    evaluation: Evaluation
    converged: bool
    covariance: Array
    """Of the internal variables, priors included, zero where a limit holds one; constants taken for right."""
    from_constants: Array
    """What their doubt adds (unknowns, unknowns); it does not grow with the residuals, as the other does."""
    held: Array
    """Which unknowns a limit holds (unknowns)."""

    __repr__ = on_screen

    @property
    def x(self) -> Array:
        """Internal variables (unknowns)."""
        return self.evaluation.x


def normal_equations(problem: FitProblem, at: Evaluation, spread: float = 1.0) -> tuple[Array, Array]:
    """Return the Gauss-Newton matrix (unknowns, unknowns) and the right-hand side (unknowns), priors included.

    `spread` is the standard deviation of the readings in units of what the noise model says.
    """
    mean, precision = problem.precision
    matrix, right = _gram(at.jacobian, at.weight, at.z)
    return matrix / spread**2 + np.diag(precision), right / spread**2 - precision * (at.x - mean)


def _gram_of(jacobian: Array, weight: Array, z: Array) -> tuple[Array, Array]:
    """Return J'WJ and J'Wz, in one pass and one thread (a threaded BLAS loses to its own overhead here)."""
    rows, p = jacobian.shape
    matrix, right = np.zeros((p, p)), np.zeros(p)
    for k in range(rows):
        if z[k] == 0.0:
            continue
        for i in range(p):
            w = weight[k] * jacobian[k, i]
            right[i] += w * z[k]
            for j in range(i + 1):
                matrix[i, j] += w * jacobian[k, j]
    for i in range(p):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return matrix, right


_gram: Callable[..., tuple[Array, Array]] = compiled(nogil=True, fastmath=True)(_gram_of)


def minimise(
    problem: FitProblem, x: Array | None = None, *, max_evaluations: int = 40, decrease: float = 5e-3
) -> Minimum:
    """Find a run's unknowns; stop when the next step promises less than `decrease` of loss."""
    lower, upper = problem.limits
    at = problem.evaluate(np.clip(problem.start if x is None else x, lower, upper))
    damping, count, converged = 1e-3, 1, False
    trace = [at.loss]
    while count < max_evaluations:
        matrix, right = normal_equations(problem, at)
        free = free_of(at.x, right, lower, upper)
        step, promise = damped_step(matrix, right, free, damping)
        if promise < decrease:
            converged = True
            break
        trial = np.clip(at.x + step, lower, upper)
        new = problem.evaluate(trial)
        count += 1
        if np.isfinite(new.loss) and new.loss < at.loss:
            damping = max(damping * 0.2, 1e-9)
            at = new
            trace.append(at.loss)
        else:
            damping *= 8.0
        if promise < STALLED and (damping > 1e4 or (len(trace) > 4 and trace[-4] - trace[-1] < STALLED)):
            converged = True
            break
    matrix, right = normal_equations(problem, at)
    free = free_of(at.x, right, lower, upper)
    alone = covariance_of(matrix, free)
    return Minimum(at, converged, alone, left_open(problem, matrix, alone), np.logical_not(free))


def free_of(x: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Return which unknowns no limit holds against the descent direction (unknowns)."""
    edge = 1e-9
    held = ((x <= lower + edge) & (right <= 0)) | ((x >= upper - edge) & (right >= 0))
    return np.logical_not(held)


def damped_step(matrix: Array, right: Array, free: Array, damping: float) -> tuple[Array, float]:
    """Return a damped step and the decrease of loss an undamped one promises."""
    step = np.zeros(len(right))
    index = np.flatnonzero(free)
    if not len(index):
        return step, 0.0
    inner = matrix[np.ix_(index, index)]
    diagonal = np.maximum(np.diag(inner), 1e-12)
    full = solve_scaled(inner, right[index])
    damped = full if damping < 1e-8 else solve_scaled(inner + np.diag(damping * diagonal), right[index])
    step[index] = np.clip(damped, -MAX_MOVE, MAX_MOVE)
    return step, 0.5 * float(right[index] @ full)


def solve_scaled(matrix: Array, right: Array) -> Array:
    """Solve for a positive matrix (n, n) whose rows may be of very different size; as `right` (n)."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-12))
    scaled = matrix * scale[:, None] * scale[None, :] + 1e-12 * np.eye(len(matrix))
    return np.asarray(scale * np.linalg.solve(scaled, scale * right))


def covariance_of(matrix: Array, free: Array) -> Array:
    """Invert over the unknowns that no limit holds, zero for the others (unknowns, unknowns)."""
    covariance = np.zeros_like(matrix)
    index = np.flatnonzero(free)
    if len(index):
        covariance[np.ix_(index, index)] = inverse(matrix[np.ix_(index, index)])
    return covariance


def constants_among(problem: FitProblem) -> list[int]:
    """Return the positions of the constants among the unknowns."""
    return [i for i, u in enumerate(problem.unknowns) if u.name.startswith(f"{CONSTANT}:")]


def carried_among(problem: FitProblem) -> list[int]:
    """Return the positions of the constants whose doubt intervals carry: the panel's, and all that are stated.

    No two panels are alike, so every run's coefficients answer for what its own panel is off. Constants of the
    press are the same in all its runs: unless header or press file state their doubt, coefficients are what they
    are beside these plates (5 % of a plate's conductivity would drown the rig's contact, 2,600 to 13,500 W/m²K).
    """
    return [i for i in constants_among(problem) if _carried(problem, _key(problem, i))]


def _carried(problem: FitProblem, key: str) -> bool:
    stated = problem.doubts[key].source is Origin.STATED or f"{key}{SD}" in problem.case.run.header
    return stated or key.startswith("panel.")


def _key(problem: FitProblem, i: int) -> str:
    return problem.unknowns[i].name.partition(":")[2]


def left_open(problem: FitProblem, matrix: Array, covariance: Array) -> Array:
    """Return what the doubt of held constants adds to the covariance of all unknowns.

    Schmidt's consider covariance (Bierman, Factorization Methods, 1977, chapter VIII): the estimate leans on a
    constant by ``-P M_xc``, and its variance follows by the constant's own.
    """
    at, carried = constants_among(problem), carried_among(problem)
    lean = -covariance @ matrix[:, at] * np.isin(at, carried)
    lean[at, range(len(at))] = 1.0
    return np.asarray(lean @ lean.T)  # a constant counts in its standard deviation


def inverse(matrix: Array) -> Array:
    """Invert a positive matrix (n, n), scaled so that units do not matter; flat directions get a huge variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-12))
    scaled = matrix * scale[:, None] * scale[None, :]
    values, vectors = np.linalg.eigh(scaled)
    inverted = (vectors / np.maximum(values, 1e-10)) @ vectors.T
    return np.asarray(inverted * scale[:, None] * scale[None, :])
