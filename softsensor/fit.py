"""Coefficients of one run, with what is known about them.

The default: Levenberg-Marquardt in the logarithm of the coefficients with exact sensitivities, every
sensor with its own offset, nuisances with the priors a real measuring chain deserves (`chain_priors`),
correlated noise whitened, single bad cells and loose channels left out. The paper's own procedures can be
had by name (`softsensor.paper`).

Choices (2026-11-21). Limits come from the press file. A coefficient nobody can know from the run is not
guessed: `softsensor.identifiability` says so from the profile of the likelihood at hand. The residuals'
noise level is estimated from the run itself (restricted likelihood), so intervals widen where the model
fits badly.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import t as student

from daq.pressfile import Press
from daq.records import Array, InputError, Moments, Run
from softsensor.fit_problem import (
    STALLED,
    Evaluation,
    Minimum,
    Problem,
    Unknown,
    grid_correction,
    minimise,
    with_motion,
)
from softsensor.fit_unknowns import chain_priors, is_parameter, neutral_values, parameter_unknown
from softsensor.model import ThermalModel, state_weights
from softsensor.residuals import Noise, channel_noise, collect_signals, whiten

FIRST_NOISE = Noise(slow_K=0.15, slow_s=30.0, fast_K=0.0, fast_s=10.0, white_K=1.0)
"""For the first steps, while the model is still far off."""
BAD_LOSS = 1.0
"""Loss a value after the first search, with 1 K of noise assumed, above which other starts are tried."""
OTHER_STARTS = (float(np.log(3.0)), -float(np.log(3.0)))
"""Shifts of the logarithms for further starts."""
SLOW_PRIOR = ((np.log(0.15), 1.0), (np.log(30.0), 0.7))
"""Log-normal priors of the slow noise's size [K] and correlation time [s]."""


@dataclass(frozen=True)
class Coefficient:
    """What a fit says about one coefficient or effect parameter."""

    value: float
    sd: float
    """Of the value; for a coefficient from the logarithm's, times the value."""
    ci95: tuple[float, float]
    identifiable: bool
    verdict: str = "identifiable"
    """``identifiable``, ``one-sided``, ``not identifiable`` or ``fixed``."""
    reason: str = ""
    """Why not, and which measurement would fix it."""
    log_sd: float = float("nan")
    """Of the logarithm."""


@dataclass(frozen=True)
class RunFit:
    """What a run says about the press."""

    run: str
    coefficients: Mapping[str, Coefficient]
    """Coefficients, and effect parameters that were free."""
    rmse_K: float  # noqa: N815
    """All good channels but validation ones, whole run, each channel's constant offset removed. [K]"""
    rmse_closed_K: float  # noqa: N815
    rmse_raw_K: float  # noqa: N815
    initial_rmse_K: float  # noqa: N815
    """At the press file's guesses. [K]"""
    converged: bool
    seconds: float
    closed_s: float
    opened_s: float
    warnings: tuple[str, ...]
    names: tuple[str, ...]
    """Of the unknowns, nuisances included."""
    covariance: Array
    """Of the internal variables: logarithms of coefficients, effect parameters over their size."""
    problem: Problem
    minimum: Minimum
    residuals: Mapping[str, Array]
    """Reading minus prediction by channel, its constant offset removed (rows). [K]"""
    offsets: Mapping[str, float]
    """Constant offset of each channel. [K]"""
    evaluations: int
    spread: float
    """How much larger the whitened residuals are than the noise model says, at least 1."""
    quantile: float
    """Standard deviations to either end of a 95 % interval."""

    @property
    def values(self) -> dict[str, float]:
        """Every parameter's value, nuisances included."""
        return self.problem.merged(self.minimum.x)

    @property
    def nuisances(self) -> dict[str, float]:
        """Nuisances and their values, channel errors included."""
        pairs = zip(self.problem.unknowns, self.minimum.x, strict=True)
        return {u.name: u.value(x) for u, x in pairs if u.name not in self.coefficients}

    @property
    def correlation(self) -> Array:
        """Of the unknowns, in the order of `names`."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return np.asarray(self.covariance / sd[:, None] / sd[None, :])

    @property
    def moments(self) -> Moments:
        """The run's moments as refined."""
        case, n = self.problem.case, self.nuisances
        return replace(
            case.moments,
            closed_s=self.closed_s,
            opened_s=self.opened_s,
            ramp_s=case.moments.ramp_s + n.get("ramp_s", 0.0),
        )

    def as_json(self) -> dict[str, Any]:
        """Return the run's entry of ``fit --json`` (NaN as null)."""
        table = {
            name: {
                "value": number(c.value),
                "sd": number(c.sd),
                "ci95": [number(c.ci95[0]), number(c.ci95[1])],
                "identifiable": c.identifiable,
                "verdict": c.verdict,
                "reason": c.reason,
            }
            for name, c in self.coefficients.items()
        }
        return {
            "run": self.run,
            "converged": self.converged,
            "coefficients": table,
            "rmse_K": number(self.rmse_K),
            "rmse_closed_K": number(self.rmse_closed_K),
            "rmse_raw_K": number(self.rmse_raw_K),
            "initial_rmse_K": number(self.initial_rmse_K),
            "seconds": round(self.seconds, 4),
            "closed_s": number(self.closed_s),
            "opened_s": number(self.opened_s),
            "warnings": list(self.warnings),
        }


def number(value: float) -> float | None:
    """Return a JSON number, None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def fit_run(
    model: ThermalModel,
    run: Run,
    moments: Moments,
    *,
    start: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    free: Sequence[str] | None = None,
    verdicts: bool = True,
) -> RunFit:
    """Fit one run.

    Parameters
    ----------
    model
        The press and the effects its model takes into account.
    moments
        When the press closed and opened, as detected; the fit refines them.
    start
        Values of parameters: where to start, or for effect parameters that are not `free`, their value.
    priors
        Log-normal priors of coefficients: median and standard deviation of the logarithm; of effect
        parameters: mean and standard deviation.
    free
        Parameters to adjust; by default every coefficient the press file does not fix.
    verdicts
        False skips the profiles, for callers that only want the numbers.

    Raises
    ------
    InputError
        For a run without usable channels.
    """
    begun = time.perf_counter()
    problem = make_problem(model, run, moments, start=start, priors=priors, free=free)
    rough = _settle(problem)
    initial = rough.initial
    problem, best = rough.problem, rough.minimum
    warnings = [f.sentence for f in problem.signals.findings]
    fitted = run_fit(problem, best, initial, warnings, begun, rough.evaluations)
    if not verdicts:
        return fitted
    from softsensor.identifiability import judge

    return replace(judge(fitted), seconds=time.perf_counter() - begun)


def make_problem(
    model: ThermalModel,
    run: Run,
    moments: Moments,
    *,
    start: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    free: Sequence[str] | None = None,
    screen: bool = True,
    fineness: float = 1.0,
) -> Problem:
    """Lay out a run for fitting: channels, unknowns, priors. Raises InputError."""
    case = model.prepare(run, moments, fineness=fineness)
    signals = collect_signals(case.press, run, moments, screen=screen)
    if not signals.places:
        wanted = ", ".join(p for s in case.press.sensor if s.role == "fit" for p in s.columns) or "none named"
        raise InputError(
            f"{run.source or run.name}: no usable sensor column (the press file names {wanted}); a fit needs one"
        )
    names = [n for n in model.press.coefficient_names if not model.press.coefficient(n).fixed]
    names = names if free is None else list(free)
    values = {**neutral_values(model), **(start or {})}
    unknowns = [parameter_unknown(model, n, values[n], (priors or {}).get(n)) for n in names]
    unknowns += chain_priors(case, signals)
    weights, _ = state_weights(case, run.time_s, {})
    rows = (weights[:, 0] < 0.5).astype(float) if case.press.has_states else np.ones(len(run.time_s))
    if not rows.any():
        rows = np.ones(len(run.time_s))
    return Problem(model, case, signals, tuple(unknowns), values, FIRST_NOISE, rows)


@dataclass(frozen=True)
class _Settled:
    problem: Problem
    minimum: Minimum
    initial: Evaluation
    evaluations: int


def _settle(problem: Problem) -> _Settled:
    """Fit in three passes: roughly, with noise and grid corrected, and once more with noise re-estimated."""
    period = problem.signals.period_s
    moving = with_motion(problem, problem.start, 0.05 + timing(problem), min(0.1 + 0.4 * period, 1.0))
    problem = replace(problem, blur=moving.blur)
    initial = problem.evaluate(problem.start)
    rough = _roughly(problem)
    count = rough.evaluations + 1
    problem, x = recentre(problem, rough.x)
    problem = replace(problem, correction=grid_correction(problem, x))
    problem = with_motion(problem, x, timing(problem), 0.1 * period)
    noise = channel_noise(problem.signals, problem.case.moments, problem.noise)
    problem = replace(problem, noise=replace(noise, slow_K=0.2, slow_s=30.0))
    best = minimise(problem, x, max_evaluations=15, decrease=0.05)
    problem = with_motion(problem, best.x, timing(problem), 0.1 * period)
    problem = replace(problem, noise=slow_noise(problem, best.evaluation))
    best = minimise(problem, best.x, max_evaluations=25)
    return _Settled(problem, best, initial, count + best.evaluations)


def _roughly(problem: Problem) -> Minimum:
    """Search from the given start, and from further ones where that ends badly or at a limit."""
    best = minimise(problem, max_evaluations=25, decrease=0.05)
    count = best.evaluations
    logs = np.array([u.scale == "log" for u in problem.unknowns])
    for shift in OTHER_STARTS:
        values = float(np.count_nonzero(best.evaluation.z))
        if best.converged and best.evaluation.loss < BAD_LOSS * values and not best.held[logs].any():
            break
        other = minimise(problem, problem.start + np.where(logs, shift, 0.0), max_evaluations=25, decrease=0.05)
        count += other.evaluations
        if other.evaluation.loss < best.evaluation.loss - STALLED:
            best = other
    return replace(best, evaluations=count)


def timing(problem: Problem) -> float:
    """Return how well row times are known: channels are read one after the other. [s]"""
    return 0.01 + 0.02 * problem.signals.period_s


def recentre(problem: Problem, x: Array) -> tuple[Problem, Array]:
    """Lay the run out again about refined moments, so that fine steps sit where the press switches."""
    values = problem.merged(x)
    case = problem.case
    shifts = {n: values.get(n, 0.0) for n in ("closed_s", "opened_s", "ramp_s", "inserted_s")}
    if all(abs(s) < 0.1 for s in shifts.values()):
        return problem, x
    moments = replace(case.moments, **{n: getattr(case.moments, n) + s for n, s in shifts.items()})
    if moments.inserted_s < float(case.run.time_s[0]):
        return problem, x
    case = problem.model.prepare(case.run, moments)
    unknowns, moved = [], x.copy()
    for i, u in enumerate(problem.unknowns):
        if shift := shifts.get(u.name, 0.0):
            u = replace(
                u,
                start=u.start - shift,
                lower=u.lower - shift,
                upper=u.upper - shift,
                mean=u.mean - shift / u.size,
            )
            moved[i] -= shift / u.size
        unknowns.append(u)
    return replace(problem, case=case, unknowns=tuple(unknowns)), moved


def slow_noise(problem: Problem, at: Evaluation) -> Noise:
    """Return the noise with its slow part by restricted maximum likelihood on rows a second apart."""
    thin = _thin(problem)
    mean, precision = problem.precision
    pull = precision * (mean - at.x)

    def loss(guess: Array) -> float:
        noise = replace(problem.noise, slow_K=float(np.exp(guess[0])), slow_s=float(np.exp(guess[1])))
        matrix, right = np.diag(precision), pull.copy()
        total = 0.0
        for i, place in enumerate(problem.signals.places):
            series = np.column_stack([at.residual[i], at.derivative[i]])[thin]
            white, log_det = whiten(
                problem.signals.time_s[thin], series, problem.variance(i)[thin], noise, len(place.columns)
            )
            total += log_det + float(white[:, 0] @ white[:, 0])
            matrix = matrix + white[:, 1:].T @ white[:, 1:]
            right = right + white[:, 1:].T @ white[:, 0]
        matrix = matrix + 1e-6 * np.eye(len(matrix))
        total += float(np.linalg.slogdet(matrix)[1]) - float(right @ np.linalg.solve(matrix, right))
        total += sum(float((g - m) / s) ** 2 for g, (m, s) in zip(guess, SLOW_PRIOR, strict=True))
        return 0.5 * total

    best = minimize(
        loss,
        [m for m, _ in SLOW_PRIOR],
        method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 0.05, "maxfev": 50},
    ).x
    best = np.clip(best, np.log([1e-3, 2.0]), np.log([50.0, 600.0]))
    return replace(problem.noise, slow_K=float(np.exp(best[0])), slow_s=float(np.exp(best[1])))


def _thin(problem: Problem) -> Array:
    """Rows about a second apart, none near a switch."""
    t, moments = problem.signals.time_s, problem.case.moments
    use = problem.rows > 0
    for moment in (moments.closed_s, moments.opened_s):
        if np.isfinite(moment):
            use &= (t < moment - 1.0) | (t > moment + 1.5)
    rows = np.flatnonzero(use)
    step = max(1, round(1.0 / problem.signals.period_s), len(rows) // 400)
    return np.asarray(rows[::step])


def run_fit(
    problem: Problem, best: Minimum, initial: Evaluation, warnings: Sequence[str], begun: float, evaluations: int
) -> RunFit:
    """Put together what a finished search says."""
    residuals, offsets = channel_residuals(problem, best.evaluation)
    closed = best.evaluation.solution.closed_share > 0.5
    x, covariance = best.x, best.covariance
    spread = _spread(problem, best)
    quantile = float(student.ppf(0.975, spread.freedom))
    table = {}
    for i, u in enumerate(problem.unknowns):
        if not is_parameter(u.name):
            continue
        sd = float(np.sqrt(covariance[i, i])) * spread.factor
        table[u.name] = _coefficient(u, x[i], sd, quantile)
    for name in problem.case.press.coefficient_names:
        if name not in table:
            v = problem.values[name]
            table[name] = Coefficient(v, 0.0, (v, v), False, "fixed", "fixed by the press file", 0.0)
    values = problem.merged(x)
    moments = problem.case.moments
    notes = list(warnings)
    if problem.signals.dropped:
        notes.append(f"{problem.signals.dropped} single cells departed from their face and were left out")
    if not best.converged:
        notes.append("the search did not converge; coefficients are where it stopped")
    return RunFit(
        run=problem.case.run.name,
        coefficients=table,
        rmse_K=rms(residuals.values()),
        rmse_closed_K=rms(r[closed] for r in residuals.values()),
        rmse_raw_K=rms(r + offsets[c] for c, r in residuals.items()),
        initial_rmse_K=rms(channel_residuals(problem, initial)[0].values()),
        converged=best.converged,
        seconds=time.perf_counter() - begun,
        closed_s=moments.closed_s + values.get("closed_s", 0.0),
        opened_s=moments.opened_s + values.get("opened_s", 0.0),
        warnings=tuple(notes),
        names=problem.names,
        covariance=covariance * spread.factor**2,
        problem=problem,
        minimum=best,
        residuals=residuals,
        offsets=offsets,
        evaluations=evaluations,
        spread=spread.factor,
        quantile=quantile,
    )


def _coefficient(u: Unknown, x: float, sd: float, quantile: float) -> Coefficient:
    value = u.value(x)
    low, high = u.value(x - min(quantile * sd, 50.0)), u.value(x + min(quantile * sd, 50.0))
    interval = (max(low, u.lower), min(high, u.upper))
    log_sd = sd if u.scale == "log" else float("nan")
    return Coefficient(value, float(abs(u.slope(x)) * sd), interval, sd > 0, log_sd=log_sd)


@dataclass(frozen=True)
class _Spread:
    factor: float
    """How much larger the whitened residuals are than their model says, at least 1."""
    freedom: float
    """Independent values behind the size of the slow noise, which decides most intervals."""


def _spread(problem: Problem, best: Minimum) -> _Spread:
    z, w = best.evaluation.z, best.evaluation.weight
    used = z != 0
    size = float((w[used] * z[used] ** 2).sum() / max(used.sum() - len(best.x), 1))
    seconds = float(problem.rows.sum()) * problem.signals.period_s
    freedom = len(problem.signals.places) * seconds / problem.noise.slow_s
    return _Spread(max(1.0, float(np.sqrt(size))), float(np.clip(freedom, 5.0, 100.0)))


def channel_residuals(problem: Problem, at: Evaluation) -> tuple[dict[str, Array], dict[str, float]]:
    """Return by channel reading minus prediction with its constant offset removed, and that offset. [K]"""
    residuals, offsets = {}, {}
    present = problem.rows > 0
    for i, place in enumerate(problem.signals.places):
        predicted = at.solution.sensors[:, at.solution.columns.index(place.columns[0])]
        if problem.correction:
            predicted = predicted + problem.correction[i]
        for column in place.columns:
            difference = np.where(present, problem.signals.cells[column] - predicted, np.nan)
            ok = np.isfinite(difference)
            offsets[column] = float(difference[ok].mean()) if ok.any() else 0.0
            residuals[column] = difference - offsets[column]
    return residuals, offsets


def rms(series: Any) -> float:
    """Root mean square over the finite values of several arrays."""
    values = np.concatenate([np.asarray(s)[np.isfinite(s)] for s in series])
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def free_names(press: Press) -> tuple[str, ...]:
    """Coefficients a fit adjusts: all the press file does not fix."""
    return tuple(n for n in press.coefficient_names if not press.coefficient(n).fixed)
