"""The core as a run's fit has it, and how far off it may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor.fitting.constants import changed_by
from softsensor.fitting.problem import CONSTANT, carried_among
from softsensor.fitting.result import RunFit
from softsensor.signals.faces import measured_core
from softsensor.signals.instrument import PLATEN_TOTAL_K, START_TOTAL_K


@dataclass(frozen=True)
class FittedCore:
    """Middle of the panel through a run."""

    core: Array
    """By the fitted model (rows). [°C]"""
    low: Array
    high: Array
    """The 95 % band: what coefficients, moments, measuring chain and the panel's constants leave open, as far as
    the model holds; nothing inside is colder than all that the panel has touched, nor hotter (rows). [°C]"""
    measured: Array
    """Mean of the thermocouples there, which no fit sees; NaN where none reads (rows). [°C]"""

    @property
    def error_K(self) -> float:  # noqa: N802
        """Root mean square of measured minus fitted, NaN without a measured core. [K]"""
        off = (self.measured - self.core)[np.isfinite(self.measured)]
        return float(np.sqrt(np.mean(off**2))) if len(off) else float("nan")


def fitted_core(fitted: RunFit) -> FittedCore | None:
    """Return the core of a run that the model describes; None for another, and for a rig without a panel."""
    problem = fitted.problem
    if not (fitted.met and problem.case.press.panel_layers):
        return None
    present = np.where(problem.rows > 0, 1.0, np.nan)
    measured = measured_core(problem.case.press, problem.case.run)
    solution = fitted.minimum.evaluation.solution
    slopes = _derivative(fitted)
    variance = np.einsum("ri,ij,rj->r", slopes, fitted.covariance, slopes)
    half = fitted.quantile * np.sqrt(np.maximum(variance, 0.0))
    coldest, hottest = _ends(fitted)
    low = np.minimum(np.maximum(solution.core - half, coldest), solution.core)
    high = np.maximum(np.minimum(solution.core + half, hottest), solution.core)
    return FittedCore(solution.core * present, low * present, high * present, measured * present)


def _ends(fitted: RunFit) -> tuple[float, float]:
    """Return the coldest and the hottest that a run's panel may have touched. [°C]"""
    case = fitted.problem.case
    start = case.ambient if case.panel is None else case.panel.initial_temperature
    known = np.concatenate([[case.ambient, start], *(case.run.columns[c] for c in case.press.platens)])
    return float(np.nanmin(known)) - 2.0 * START_TOTAL_K, float(np.nanmax(known)) + 2.0 * PLATEN_TOTAL_K


def _derivative(fitted: RunFit) -> Array:
    """Return the core's derivatives by the internal variables (rows, unknowns)."""
    problem, at = fitted.problem, fitted.minimum
    solution, carried = at.evaluation.solution, carried_among(problem)
    found = np.zeros((len(solution.core), len(problem.unknowns)))
    for i, u in enumerate(problem.unknowns):
        if u.name in solution.d_core:
            found[:, i] = solution.d_core[u.name] * (u.slope(at.x[i] * u.unit) * u.unit)
        elif i in carried:
            change, moved = changed_by(problem, u.name.removeprefix(f"{CONSTANT}:"), u.unit, fitted.values)
            found[:, i] = (moved.core - solution.core) * (u.unit / change)
    return found
