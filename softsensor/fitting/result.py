"""What a fit of one run says: coefficients with intervals, errors in kelvin, residuals, nuisances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from daq.printed import lines_of
from daq.records import Array, Moments
from daq.words import Message, say
from daq.words.message import words
from softsensor.fitting.constants import ConstantFit, constants_of
from softsensor.fitting.problem import Evaluation, FitProblem, Minimum
from softsensor.fitting.remarks import lost_insertion
from softsensor.fitting.unknowns import is_coefficient
from softsensor.signals.student import student
from softsensor.signals.unknown import FAR_LOG

MISFIT_K, MISFIT_SHARE, MISFIT_NOISE, NOISIEST_K = 1.0, 0.04, 5.0, 1.0
"""A model does not describe a run from which it leaves more than each of: so many kelvin, this share of the span
of the readings, and so many times the noise of a channel, which counts up to the last.

Of rows in which nothing is moved (`left_still`). Choice (2026-11-21, then of all rows): a pressing spans 160 K, so
6.4 K. The causes of the catalogue at typical sizes leave 0.3 to
4.0 K, and are for the diagnosis to name; a closing that is missed leaves 9 K.
"""

# Numbers without another source were set by hand, 2026-11.

FREEDOM = (5.0, 100.0)
"""Values behind the size of the slow noise that count as independent, fewest and most: at 5 Student's t is 2.6,
beyond 100 it is normal."""
ASTRAY = 1.5
"""Nor does it where the search ends so many times as far from the readings as it began, and above `MISFIT_K`."""


class Identifiability(StrEnum):
    """How well a coefficient is known from a run."""

    IDENTIFIABLE = "identifiable"
    ONE_SIDED = "one-sided"
    NOT_IDENTIFIABLE = "not identifiable"
    FIXED = "fixed"
    """By the press file."""
    SHARED = "shared"
    """One value in all runs, judged for all of them together."""

    @property
    def message(self) -> Message:
        """The verdict in words."""
        return say(f"fit-verdict-{self.value.replace(' ', '-')}")


@dataclass(frozen=True)
class Coefficient:
    """What a fit says about one coefficient."""

    value: float
    sd: float
    """The logarithm's, times the value. NaN where a limit holds it."""
    ci95: tuple[float, float]
    identifiable: bool
    verdict: Identifiability = Identifiability.IDENTIFIABLE
    reason: Message | None = None
    """Why it is not identifiable, and which measurement would fix it."""

    def __str__(self) -> str:
        """Return value and 95 % interval, or why there is none."""
        if not self.identifiable:
            return f"– {self.reason or self.verdict.message}"
        value, low, high = (rounded(one, self.ci95) for one in (self.value, *self.ci95))
        return f"{value:g}, 95 % {low:g} to {high:g}"


def rounded(value: float, ends: tuple[float, float]) -> float:
    """Return a value to the second digit of half its interval's width (JCGM 100:2008, 7.2.6).

    Examples
    --------
    >>> rounded(643.27, (557.3, 729.2)), rounded(643.27, (600.1, 645.3)), rounded(6.4327, (6.31, 6.55))
    (643.0, 643.0, 6.43)
    >>> rounded(17043.0, (9000.0, 25000.0))
    17000.0
    """
    half = (ends[1] - ends[0]) / 2
    if not (half > 0.0 and np.isfinite(half)):
        return value
    return round(value, 1 - math.floor(math.log10(float(f"{half:.2g}"))))


@dataclass(frozen=True, eq=False)
class RunFit:
    """What a run says about the press."""

    run: str
    """Its name."""
    coefficients: Mapping[str, Coefficient]
    """By name. [W/m²K]"""
    rmse_K: float  # noqa: N815
    """All good channels but validation ones, whole run, each channel's constant offset removed. [K]"""
    rmse_closed_K: float  # noqa: N815
    """The same while the press is closed. [K]"""
    rmse_raw_K: float  # noqa: N815
    """As `rmse_K`, constant offsets left in. [K]"""
    initial_rmse_K: float  # noqa: N815
    """At the press file's guesses. [K]"""
    rmse_still_K: float  # noqa: N815
    """As `rmse_K`, rows left out in which the press or the panel is being moved: a thin face warms by 100 K while
    the press closes, so that one such row, some ms off, may be nine tenths of `rmse_K`. [K]"""
    initial_rmse_still_K: float  # noqa: N815
    """The same at the press file's guesses. [K]"""
    converged: bool
    """Whether the search for the least misfit came to rest."""
    closed_s: float
    """When the press closed, as refined. [s of the run]"""
    opened_s: float
    """When it opened. [s of the run]"""
    warnings: tuple[Message, ...]
    """What is to be known of it."""
    names: tuple[str, ...]
    """Of the unknowns, nuisances included."""
    covariance: Array
    """Of the internal variables: logarithms of coefficients, nuisances over their standard deviation."""
    problem: FitProblem
    """What was asked: signals, unknowns, their priors."""
    minimum: Minimum
    """What the search found."""
    residuals: Mapping[str, Array]
    """Reading minus prediction by channel, its constant offset removed (rows). [K]"""
    offsets: Mapping[str, float]
    """Constant offset of each channel. [K]"""
    spread: float
    """How much larger the whitened residuals are than the noise model says, at least 1."""
    quantile: float
    """Standard deviations to either end of a 95 % interval."""
    constants: Mapping[str, ConstantFit] = field(default_factory=dict)
    """By key of the header, those that are uncertain: what was given, and what the run says."""
    misfit: Message | None = None
    """Why this run says nothing about coefficients: the model does not describe it; None where it does."""
    seconds: float = float("nan")
    """How long the fit took; only who holds a clock knows."""

    def __repr__(self) -> str:
        """Return on one screen what is left of the readings [K], and what the run says of coefficients. [W/m²K]"""
        head = f"Fit of run {self.run}: {self.initial_rmse_K:.2f} K before, {self.rmse_K:.2f} K after"
        lines = [f"{name} = {c}" for name, c in self.coefficients.items()]
        return "\n".join([head, *lines_of(lines), *map(str, () if self.misfit is None else (self.misfit,))])

    @property
    def met(self) -> bool:
        """Whether the model describes the run."""
        return self.misfit is None

    @property
    def rmse_places_K(self) -> dict[str, float]:  # noqa: N802
        """Return `rmse_K` of the channels at each place. [K]"""
        places = self.problem.signals.places
        return {place.label: rms(self.residuals[c] for c in place.columns) for place in places}

    @property
    def values(self) -> dict[str, float]:
        """Every parameter's value, nuisances included."""
        return self.problem.merged(self.minimum.x)

    @property
    def nuisances(self) -> dict[str, float]:
        """Nuisances and their values, channel errors included."""
        pairs = zip(self.problem.unknowns, self.minimum.x, strict=True)
        return {u.name: u.value(x * u.unit) for u, x in pairs if u.name not in self.coefficients}

    @property
    def correlation(self) -> Array:
        """Of the unknowns, in the order of `names` (unknowns, unknowns)."""
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
            inserted_s=case.moments.inserted_s + n.get("inserted_s", 0.0),
        )

    def as_json(self) -> dict[str, Any]:
        """Return the run's entry of ``fit --json`` (NaN as null)."""
        table = {
            name: {
                "value": json_number(c.value),
                "sd": json_number(c.sd),
                "ci95": [json_number(c.ci95[0]), json_number(c.ci95[1])],
                "identifiable": c.identifiable,
                "verdict": c.verdict.value,
                "reason": words(c.reason or ""),
                "reason_said": c.reason and c.reason.to_json(),
            }
            for name, c in self.coefficients.items()
        }
        return {
            "run": self.run,
            "converged": self.converged,
            "met": self.met,
            "coefficients": table,
            "constants": {key: c.as_json() for key, c in self.constants.items()},
            "rmse_K": json_number(self.rmse_K),
            "rmse_closed_K": json_number(self.rmse_closed_K),
            "rmse_raw_K": json_number(self.rmse_raw_K),
            "rmse_places_K": {label: json_number(value) for label, value in self.rmse_places_K.items()},
            "initial_rmse_K": json_number(self.initial_rmse_K),
            "rmse_still_K": json_number(self.rmse_still_K),
            "initial_rmse_still_K": json_number(self.initial_rmse_still_K),
            "seconds": json_number(round(self.seconds, 4)),
            "closed_s": json_number(self.closed_s),
            "opened_s": json_number(self.opened_s),
            "inserted_s": json_number(self.moments.inserted_s),
            "ramp_s": json_number(self.moments.ramp_s),
            "warnings": [words(warning) for warning in self.warnings],
            "warnings_said": [warning.to_json() for warning in self.warnings],
        }


def json_number(value: float) -> float | None:
    """Return a JSON number, None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def run_fit(
    problem: FitProblem,
    best: Minimum,
    initial: Evaluation,
    warnings: Sequence[Message],
) -> RunFit:
    """Put together what a finished search says."""
    residuals, offsets = channel_residuals(problem, best.evaluation)
    closed = best.evaluation.solution.closed_share > 0.5
    spread = _spread(problem, best)
    quantile = student(spread.freedom)
    values, moments = problem.merged(best.x), problem.case.moments
    first, _ = channel_residuals(problem, initial)
    still, still_first = left_still(problem, residuals), left_still(problem, first)
    misfit = misfit_of(problem, still, still_first)
    return RunFit(
        run=problem.case.run.name,
        coefficients=_coefficients(problem, best, spread.factor, quantile),
        rmse_K=rms(residuals.values()),
        rmse_closed_K=rms(r[closed] for r in residuals.values()),
        rmse_raw_K=rms(r + offsets[c] for c, r in residuals.items()),
        initial_rmse_K=rms(first.values()),
        rmse_still_K=still,
        initial_rmse_still_K=still_first,
        converged=best.converged,
        closed_s=moments.closed_s + values.get("closed_s", 0.0),
        opened_s=moments.opened_s + values.get("opened_s", 0.0),
        warnings=(*warnings, *_search_warnings(problem, best, misfit)),
        names=problem.names,
        covariance=best.covariance * spread.factor**2 + best.from_constants,
        problem=problem,
        minimum=best,
        residuals=residuals,
        offsets=offsets,
        spread=spread.factor,
        quantile=quantile,
        constants=constants_of(problem, best, spread.factor),
        misfit=misfit,
    )


def _coefficients(problem: FitProblem, best: Minimum, factor: float, quantile: float) -> dict[str, Coefficient]:
    """Return the parameters, the free ones `factor` times less sure than the curvature says."""
    table = {}
    for i, u in enumerate(problem.unknowns):
        if is_coefficient(u.name):
            sd = float(np.sqrt(best.covariance[i, i] * factor**2 + best.from_constants[i, i]))
            table[u.name] = _coefficient(problem.case.press.coefficient(u.name).limits, best.x[i], sd, quantile)
    for name in problem.case.press.coefficient_names:
        if name not in table:
            v = problem.values[name]
            table[name] = Coefficient(v, 0.0, (v, v), False, Identifiability.FIXED, say("fit-fixed"))
    return table


def _search_warnings(problem: FitProblem, best: Minimum, misfit: Message | None) -> list[Message]:
    found = []
    if problem.signals.dropped:
        found.append(say("fit-cells-dropped", count=problem.signals.dropped))
    if not best.converged:
        found.append(say("fit-not-converged"))
    if misfit is not None:
        found.append(say("fit-not-described-check", misfit=misfit))
    return found


def misfit_of(problem: FitProblem, rmse: float, first: float, share: float = MISFIT_SHARE) -> Message | None:
    """Say why a model does not describe a run, None where it does.

    Where insertion and closing are both lost, moments are found that meet the readings, and coefficients with
    them that are wrong.

    Parameters
    ----------
    rmse, first
        What is left where the search ended, and where it began, by `left_still`. [K]
    share
        Of the readings' span that may be left.
    """
    means = [place.mean[problem.rows > 0] for place in problem.signals.places]
    span = float(np.ptp(np.concatenate([s[np.isfinite(s)] for s in means])))
    noise = float(np.hypot(problem.noise.white_K, problem.noise.fast_K))
    if lost := lost_insertion(problem.case, problem.signals):
        return lost
    if rmse > max(MISFIT_K, share * span, MISFIT_NOISE * min(noise, NOISIEST_K)):
        return say("fit-misfit-span", rmse=rmse, span=span)
    if rmse > max(MISFIT_K, ASTRAY * first):
        return say("fit-misfit-astray", rmse=rmse, first=first)
    return None


def _coefficient(limits: tuple[float, float], x: float, sd: float, quantile: float) -> Coefficient:
    """Return a coefficient from its logarithm and that one's standard deviation."""
    value = float(np.exp(x))
    if sd == 0.0:
        return Coefficient(value, float("nan"), limits, False)
    reach = min(quantile * sd, FAR_LOG)
    interval = (max(float(np.exp(x - reach)), limits[0]), min(float(np.exp(x + reach)), limits[1]))
    return Coefficient(value, float(value * sd), interval, True)


@dataclass(frozen=True)
class _Spread:
    factor: float
    """How much larger the whitened residuals are than their model says, at least 1."""
    freedom: float
    """Independent values behind the size of the slow noise, which decides most intervals."""


def _spread(problem: FitProblem, best: Minimum) -> _Spread:
    z, w = best.evaluation.z, best.evaluation.weight
    used = z != 0
    size = float((w[used] * z[used] ** 2).sum() / max(used.sum() - len(best.x), 1))
    seconds = float(problem.rows.sum()) * problem.signals.period_s
    freedom = len(problem.signals.places) * seconds / problem.noise.slow_s
    return _Spread(max(1.0, float(np.sqrt(size))), float(np.clip(freedom, *FREEDOM)))


def channel_residuals(problem: FitProblem, at: Evaluation) -> tuple[dict[str, Array], dict[str, float]]:
    """Return by channel reading minus prediction with its constant offset removed, and that offset. [K]"""
    residuals, offsets = {}, {}
    present = problem.rows > 0
    for i, place in enumerate(problem.signals.places):
        predicted = problem.predicted(i, at.x, at.solution)
        for column in place.columns:
            difference = np.where(present, problem.signals.cells[column] - predicted, np.nan)
            ok = np.isfinite(difference)
            offsets[column] = float(difference[ok].mean()) if ok.any() else 0.0
            residuals[column] = difference - offsets[column]
    return residuals, offsets


def left_still(problem: FitProblem, residuals: Mapping[str, Array]) -> float:
    """Return the root mean square of channels' residuals while nothing is being moved, their means removed. [K]

    Of all rows where the press or the panel is being moved in each of them.
    """
    still = slice(None) if problem.moving is None else np.logical_not(problem.moving)
    rows = [r[still] for r in residuals.values()]
    known = [r - r[np.isfinite(r)].mean() for r in rows if np.isfinite(r).any()]
    return rms(known or residuals.values())


def left_in(fits: Sequence[Mapping[str, Any]]) -> tuple[str, Array]:
    """Return what stored fits left of their runs, and by which key: still, unless an older version's has none.

    NaN for a fit that says neither. [K]
    """
    old = any(fit.get("rmse_still_K") is None and fit.get("rmse_K") is not None for fit in fits)
    key = "rmse_K" if old else "rmse_still_K"
    return key, np.array([fit.get(key) for fit in fits], float)


def rms(series: Any) -> float:
    """Return the root mean square over the finite values of several arrays, in their unit; NaN where none is."""
    values = np.concatenate([np.asarray(s)[np.isfinite(s)] for s in series])
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
