"""Numbers of a verdict: errors before and after, parameters with their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from daq.records import Array
from softsensor.diagnosis.extension import RunState, SharedFit
from softsensor.diagnosis.extension_unknowns import is_shape
from softsensor.diagnosis.search import SettledModel
from softsensor.effects import Effect, Need
from softsensor.signals.digest import Digest
from softsensor.signals.faces import place_scatter

MODEL_ERROR = 0.03
"""Laws are simpler than nature: no standard deviation below this share of the size, or of a shape's range.
Set by hand, 2026-11: with it 21 of 22 true parameters lay in their 95 % interval (confusion benchmark)."""
CLOCK_ERROR_S = 0.04
"""What no campaign can tell from a clock: skew within a scan, and where in its ramp a switch trips. By hand,
2026-11. [s]"""


@dataclass(frozen=True)
class Interval:
    """A parameter and where it lies with 95 %."""

    value: Any
    ci95: tuple[float, float] | None

    def as_json(self) -> dict[str, Any]:
        """Return value and ci95."""
        value = list(self.value) if isinstance(self.value, tuple) else self.value
        return {"value": value, "ci95": None if self.ci95 is None else list(self.ci95)}


@dataclass(frozen=True)
class Errors:
    """How far a model is from the readings. [K]"""

    rmse_K: float  # noqa: N815
    rmse_raw_K: float  # noqa: N815
    heldout_rmse_K: float  # noqa: N815
    core_rmse_K: float | None  # noqa: N815
    noise_K: float  # noqa: N815

    def as_json(self) -> dict[str, Any]:
        """Return the contract's table."""
        return {
            "rmse_K": _short(self.rmse_K),
            "heldout_rmse_K": _short(self.heldout_rmse_K),
            "core_rmse_K": None if self.core_rmse_K is None else _short(self.core_rmse_K),
            "rmse_raw_K": _short(self.rmse_raw_K),
        }


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def intervals(fit: SharedFit, effect: Effect) -> dict[str, Interval]:
    """Return the effect's parameters; the wider of curvature and run-to-run scatter gives the interval."""
    names = [s.name for s in fit.layout.shared]
    covariance = fit.covariance
    runs = len(fit.runs)
    centred = [g - np.mean(fit.gradients, axis=0) for g in fit.gradients]
    meat = sum((np.outer(g, g) for g in centred), np.zeros_like(covariance)) * runs / max(runs - 1, 1)
    robust = covariance @ meat @ covariance
    quantile = float(student.ppf(0.975, max(runs - 1, 1)))
    found = {}
    for p in effect.parameters:
        i = names.index(effect.key(p.name))
        value = float(fit.theta[i])
        law = MODEL_ERROR * (p.upper - p.lower if is_shape(p) else value - p.neutral)
        law = max(law, CLOCK_ERROR_S) if effect.needs == Need.SWITCH else law
        sd = np.sqrt(max(covariance[i, i], robust[i, i]) + law**2)
        half = quantile * float(sd)
        low, high = max(value - half, p.lower), min(value + half, p.upper)
        found[p.name] = Interval(_short(value), (_short(low), _short(high)))
    return found


def measure_errors(stage: SettledModel, others: Sequence[RunState]) -> Errors:
    """Return errors of a stage: of the fit, and of each run by numbers from the others.

    A channel's error is made of what its place's mean is off and its own scatter about that mean; both
    are weighted by time. Offsets are constant, so they come out of the first and stay in `raw`. The moment of the
    insertion is fitted as those of closing and opening are, so what it shifts is no error.
    """
    squares: list[tuple[float, float, float, float]] = []
    cores: list[Array] = []
    for run, other, white in zip(stage.fit.runs, others, stage.data, strict=True):
        d = white.digest
        own = _squares(d, run.misfit + run.offsets[: len(d.signals)])
        held = _squares(d, other.misfit)
        squares.append((*own, held[0], _scatter(d)))
        cores += _core_errors(d, run)
    table = np.array([s[:4] for s in squares])
    fit, raw, held_fit, scatter = table.mean(axis=0)
    core = float(np.sqrt(np.mean(np.concatenate(cores) ** 2))) if cores else None
    noise = float(np.sqrt(scatter + stage.noise.slow**2 + stage.noise.fast**2))
    return Errors(
        float(np.sqrt(fit + scatter)),
        float(np.sqrt(raw + scatter)),
        float(np.sqrt(held_fit + scatter)),
        core,
        noise,
    )


def _squares(digest: Digest, misfit: Array) -> tuple[float, float]:
    """Time-weighted mean squares of the places' misfit, without its mean and with it."""
    without, with_mean, total = 0.0, 0.0, 0.0
    for i, signal in enumerate(digest.signals):
        good = digest.valid[:, i]
        weight, values = digest.width[good], misfit[good, i]
        mean = float(np.average(values, weights=weight))
        count = len(digest.channels[signal])
        without += count * float(np.average((values - mean) ** 2, weights=weight))
        with_mean += count * float(np.average(values**2, weights=weight))
        total += count
    return without / total, with_mean / total


def _scatter(digest: Digest) -> float:
    rows = (digest.run.time_s >= digest.time[0]) & (digest.run.time_s <= digest.time[-1])
    values = [place_scatter(digest.run, c, rows) ** 2 for c in digest.channels.values() if len(c) > 1]
    return float(np.mean(values)) if values else 0.0


def _core_errors(digest: Digest, run: RunState) -> list[Array]:
    found = []
    for column, values in digest.cores.items():
        good = np.isfinite(values)
        if good.any():
            found.append(values[good] - run.validation[column][good])
    return found
