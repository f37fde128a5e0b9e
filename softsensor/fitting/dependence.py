"""How coefficients depend on a press program: platen temperature, pressure, press time.

Log-linear in the settings, every run weighted by what it knows, the scatter between runs as a second
variance, slopes held back by a weak prior so that few runs do not invent a dependence. Predicts the
coefficients of a program never run before, with an interval that widens away from the programs seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.records import Array, Run
from daq.words import Message, say
from daq.words.message import words
from softsensor.fitting.population import Knowledge
from softsensor.fitting.result import RunFit
from softsensor.heat.model_file import FittedValue
from softsensor.signals.instrument import SPREAD_LOG
from softsensor.signals.student import student
from softsensor.signals.unknown import FAR_LOG

SETTINGS: Mapping[str, tuple[str, float]] = {
    "platen_temperature_C": ("°C", 2.0),
    "pressure_N_cm2": ("N/cm²", 5.0),
    "press_time_s": ("s", 2.0),
}
"""Settings looked at, and the least scatter over a campaign worth a slope."""

# Numbers without another source were set by hand, 2026-11.

SLOPE_SD = 0.3
"""Prior of a slope: change of a logarithm over one standard deviation of a setting."""
FEWEST_RUNS = 5
"""Below, a slope beside the scatter is a guess."""
LEFT_LOG, LEFT_RUNS = 0.1, 2.0
"""Scatter left once the settings explain their part, and for how many runs that counts. By hand, 2026-11."""


@dataclass(frozen=True)
class Program:
    """A press program never run, and the coefficients predicted for it."""

    settings: Mapping[str, float]
    coefficients: Mapping[str, FittedValue]
    """``sd`` is what a run of it may differ by."""
    intervals: Mapping[str, tuple[float, float]]
    """Where 95 % of its runs should lie."""
    remarks: tuple[Message, ...] = ()

    def within(self, limits: Mapping[str, tuple[float, float]]) -> Program:
        """Return it kept to what coefficients can be, with a remark where the trend leads out of that.

        Parameters
        ----------
        limits
            Of the press file, by coefficient. [W/m²K]
        """
        coefficients, intervals, remarks = dict(self.coefficients), dict(self.intervals), list(self.remarks)
        for name, e in self.coefficients.items():
            lower, upper = limits[name]
            value = min(max(e.value, lower), upper)
            low, high = (min(max(end, lower), upper) for end in self.intervals[name])
            coefficients[name], intervals[name] = FittedValue(value, e.sd * value / e.value), (low, high)
            if value != e.value:
                remarks.append(say("fit-program-beyond-limit", name=name, value=e.value, limit=value))
        return replace(self, coefficients=coefficients, intervals=intervals, remarks=tuple(remarks))

    def holding(self, known: Mapping[str, tuple[FittedValue, tuple[float, float]]]) -> Program:
        """Return it with coefficients that no program changes: value and 95 % interval by name."""
        own = {name: estimate for name, (estimate, _) in known.items()}
        spans = {name: ends for name, (_, ends) in known.items()}
        return replace(self, coefficients={**self.coefficients, **own}, intervals={**self.intervals, **spans})

    @property
    def title(self) -> Message:
        """What is predicted."""
        settings = tuple(f"{k} = {v:g} {SETTINGS[k][0]}" for k, v in self.settings.items())
        return say("fit-program", settings=settings)

    @property
    def lines(self) -> list[Message]:
        """The prediction line by line."""
        rows = [self.title]
        for name, e in self.coefficients.items():
            low, high = self.intervals[name]
            rows.append(say("fit-program-coefficient", name=name, value=e.value, low=low, high=high))
        return rows + [say("fit-program-remark", remark=r) for r in self.remarks]

    def as_json(self) -> dict[str, Any]:
        """Return the prediction's entry in ``fit --json``."""
        table = {
            name: {"value": e.value, "sd": e.sd, "ci95": list(self.intervals[name])}
            for name, e in self.coefficients.items()
        }
        remarks = {
            "remarks": [words(r) for r in self.remarks],
            "remarks_said": [r.to_json() for r in self.remarks],
        }
        return {"settings": dict(self.settings), "coefficients": table, **remarks}


@dataclass(frozen=True)
class Dependence:
    """Regression of the logarithms of the coefficients on the settings."""

    names: tuple[str, ...]
    settings: tuple[str, ...]
    centre: Array
    scale: Array
    beta: Array
    """Intercept and slopes by coefficient (coefficients, 1 + settings)."""
    covariance: Array
    """Of each coefficient's row (coefficients, 1 + settings, 1 + settings)."""
    spread: Array
    """What is left from run to run (coefficients)."""
    lowest: Array
    highest: Array
    runs: int

    @property
    def quantile(self) -> float:
        """Standard deviations to either end of a 95 % interval: Student's t, the scatter is estimated too."""
        return student(max(self.runs - 1 - len(self.settings), 1))

    def program(self, settings: Mapping[str, float]) -> Program:
        """Return what a program never run would be like, with a remark where it lies outside those seen."""
        remarks = []
        for name, low, high in zip(self.settings, self.lowest, self.highest, strict=True):
            if name in settings and not low <= settings[name] <= high:
                known = {"name": name, "unit": SETTINGS[name][0]}
                limits = {"value": settings[name], "low": float(low), "high": float(high)}
                remarks.append(say("fit-program-outside", **known, **limits))
        coefficients = self.predict(settings)
        intervals = {}
        for name, e in coefficients.items():
            reach = float(np.exp(min(self.quantile * e.sd / e.value, FAR_LOG)))
            intervals[name] = (e.value / reach, e.value * reach)
        return Program(dict(settings), coefficients, intervals, tuple(remarks))

    def predict(self, program: Mapping[str, float]) -> dict[str, FittedValue]:
        """Return the coefficients of a program; ``sd`` is what a run of it may differ by.

        Settings the program leaves out are taken at the campaign's mean.
        """
        x = np.array([1.0, *self._scaled(program)])
        found = {}
        for i, name in enumerate(self.names):
            value = float(np.exp(x @ self.beta[i]))
            sd = float(np.sqrt(x @ self.covariance[i] @ x + self.spread[i] ** 2))
            found[name] = FittedValue(value, value * sd)
        return found

    def _scaled(self, program: Mapping[str, float]) -> list[float]:
        given = [program.get(s, c) for s, c in zip(self.settings, self.centre, strict=True)]
        return [(v - c) / k for v, c, k in zip(given, self.centre, self.scale, strict=True)]

    def as_json(self) -> dict[str, Any]:
        """Return slopes in percent per unit of the setting, with 95 % intervals."""
        table: dict[str, Any] = {}
        for i, name in enumerate(self.names):
            table[name] = {"spread": float(self.spread[i])}
            for j, setting in enumerate(self.settings):
                slope = self.beta[i, j + 1] / self.scale[j]
                half = self.quantile * np.sqrt(self.covariance[i, j + 1, j + 1]) / self.scale[j]
                table[name][setting] = {
                    "log_slope": float(slope),
                    "ci95": [float(slope - half), float(slope + half)],
                }
        span = {s: [float(a), float(b)] for s, a, b in zip(self.settings, self.lowest, self.highest, strict=True)}
        return {"settings": span, "coefficients": table}


def fit_dependence(
    names: Sequence[str], runs: Sequence[Run], fits: Sequence[RunFit], knowledge: Sequence[Knowledge]
) -> Dependence | None:
    """Return the regression, or None where settings are missing, do not vary, or runs are few."""
    if len(runs) <= FEWEST_RUNS or not names:
        return None
    table = {s: [_setting(run, s, f) for run, f in zip(runs, fits, strict=True)] for s in SETTINGS}
    used = [s for s, v in table.items() if None not in v and float(np.std(np.array(v, float))) >= SETTINGS[s][1]]
    if len(runs) < FEWEST_RUNS + len(used) or not used:
        return None
    raw = np.array([table[s] for s in used], dtype=float).T
    centre, scale = raw.mean(axis=0), raw.std(axis=0)
    x = np.column_stack([np.ones(len(runs)), (raw - centre) / scale])
    betas, covariances, spreads = [], [], []
    for i in range(len(names)):
        precision = np.array([_own_precision(k.precision, i) for k in knowledge])
        y = np.array([k.start[i] for k in knowledge])
        beta, covariance, spread = _regress(x, y, precision)
        betas.append(beta)
        covariances.append(covariance)
        spreads.append(spread)
    return Dependence(
        tuple(names),
        tuple(used),
        centre,
        scale,
        np.array(betas),
        np.array(covariances),
        np.array(spreads),
        raw.min(axis=0),
        raw.max(axis=0),
        len(runs),
    )


def _setting(run: Run, name: str, fitted: RunFit) -> float | None:
    """Return a setting from the header; the press time also from the moments."""
    value = run.setting(name)
    if value is None and name == "press_time_s" and np.isfinite(fitted.opened_s - fitted.closed_s):
        return fitted.opened_s - fitted.closed_s
    return value


def _own_precision(precision: Array, i: int) -> float:
    """Precision of one logarithm with the others unknown."""
    rest = [j for j in range(len(precision)) if j != i]
    if not rest:
        return float(precision[i, i])
    inner = precision[np.ix_(rest, rest)] + 1e-6 * np.eye(len(rest))
    cross = precision[i, rest]
    return float(max(precision[i, i] - cross @ np.linalg.solve(inner, cross), 0.0))


def _regress(x: Array, y: Array, precision: Array) -> tuple[Array, Array, float]:
    """Weighted regression with an extra variance between runs, found by iteration."""
    variance = 1.0 / np.maximum(precision, 1e-6)
    prior = np.diag([1e-6, *np.full(x.shape[1] - 1, SLOPE_SD**-2)])
    spread2 = SPREAD_LOG**2
    beta: Array = np.zeros(x.shape[1])
    covariance: Array = np.eye(x.shape[1])
    for _ in range(50):
        weight = 1.0 / (variance + spread2)
        covariance = np.asarray(np.linalg.inv((x * weight[:, None]).T @ x + prior))
        beta = np.asarray(covariance @ (x * weight[:, None]).T @ y)
        residual = y - x @ beta
        leverage = np.einsum("ij,jk,ik->i", x, covariance, x)
        share = spread2 / (variance + spread2)
        posterior = (share * residual) ** 2 + spread2 * (1.0 - share) + share**2 * leverage
        new = float((posterior.sum() + LEFT_RUNS * LEFT_LOG**2) / (len(y) + LEFT_RUNS))
        if abs(new - spread2) < 1e-7:
            break
        spread2 = new
    return beta, covariance, float(np.sqrt(spread2))
