"""Which way a cause would move what a fit leaves of each run, all that makes up for it following."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from daq.printed import on_screen
from daq.records import Array
from softsensor.diagnosis.extension import SharedFit
from softsensor.diagnosis.extension_unknowns import run_values
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import Whitened


@dataclass(frozen=True)
class Direction:
    """What an effect of one finite size would do to the whitened, projected data of each run."""

    score: Array
    """Direction times residual (runs)."""
    power: Array
    """Direction squared (runs)."""
    rows: tuple[Array, ...]
    """Projected directions."""
    own: tuple[Array, ...]
    """What the run's own numbers do to make up for a unit of the direction (eta)."""

    __repr__ = on_screen

    @property
    def scores(self) -> Array:
        """Each run's score in units of its own standard deviation (runs)."""
        return np.asarray(self.score / np.sqrt(self.power + 1e-3 * self.power.mean() + 1e-12))

    @property
    def amplitude(self) -> float:
        """Least-squares amplitude in units of the size."""
        return float(self.score.sum() / max(self.power.sum(), 1e-12))

    @property
    def gain(self) -> float:
        """Sum of squares this amplitude would save."""
        return float(self.score.sum() ** 2 / max(self.power.sum(), 1e-12))


def direction(
    fit: SharedFit, data: Sequence[Whitened], model: ThermalModel, values: Mapping[str, float]
) -> Direction:
    """Return the direction of an extended model with the given effect parameters, seen from a fit."""
    score, power, rows, own = [], [], [], []
    for r, (run, d) in enumerate(zip(fit.runs, data, strict=True)):
        base = run_values(fit.layout, r, fit.theta, run.eta)
        moved = d.digest.observed(d.digest.solve(model, base | dict(values))) - run.model
        row = np.zeros(len(run.residual))
        white = d(moved)
        row[: len(white)] = white
        q, triangle = np.linalg.qr(run.jacobian)
        along = q.T @ row
        row = row - q @ along
        own.append(-solve_triangular(triangle, along)[: len(run.eta)])
        score.append(float(row @ run.residual))
        power.append(float(row @ row))
        rows.append(row)
    return Direction(np.array(score), np.array(power), tuple(rows), tuple(own))
