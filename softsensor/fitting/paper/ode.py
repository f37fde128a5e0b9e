"""The press as an ordinary differential equation for an adaptive solver: how the paper solved it.

Method of lines on a case's mesh, optionally with the sensitivities integrated beside the temperatures by
the same solver. Only `softsensor.fitting.paper.procedures` uses it, to show what adaptive steps do to a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from daq.compiled import compiled
from daq.records import Array
from softsensor.heat.case import Case
from softsensor.heat.model import ThermalModel
from softsensor.heat.timing import OPENING_RAMP_S

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Lines:
    """A run's semi-discrete equations, ready to integrate."""

    model: ThermalModel
    case: Case
    names: tuple[str, ...]
    dx: Array
    conductivity: Array
    capacity: Array
    spots: Integers
    """Interface, state, kind (0 coupling, 1 lower face to air, 2 upper) and coefficient of each entry."""
    places: Array
    """Weights that read the sensors' places (places, n)."""
    boundary: Array
    """Measured boundary temperatures (rows, 2). [°C]"""
    switches: Array
    """Insertion, closing, opening, closing ramp, opening ramp. [s]"""

    def solve(self, h: Array, *, sensitivities: bool, method: str = "LSODA") -> tuple[Array, Array]:
        """Integrate with the solver's default tolerances; places (rows, places) and derivatives by ln h."""
        n, p = len(self.dx), len(h) if sensitivities else 0
        names = self.names if sensitivities else ()
        state = self.model.build(self.case, dict(zip(self.names, h, strict=True)), names).start
        start = np.column_stack([state.t, state.s[:p].T * h[:p]])
        t = self.case.run.time_s
        band = 2 * (1 + p)
        options: dict[str, Any] = {"lband": band, "uband": band} if method == "LSODA" else {}

        def right(at: float, y: Array) -> Array:
            return _right(
                at, y.reshape(n, 1 + p), h, self.dx, self.conductivity, self.capacity, self.spots, t,
                self.boundary, self.switches, self.case.ambient,
            )  # fmt: skip

        found = solve_ivp(right, (t[0], t[-1]), start.ravel(), method=method, t_eval=t, **options)
        states = found.y.T.reshape(len(found.t), n, 1 + p)
        values = np.einsum("mn,tnq->tmq", self.places, states)
        if len(values) < len(t):
            values = np.concatenate([values, np.repeat(values[-1:], len(t) - len(values), axis=0)])
        return values[:, :, 0], values[:, :, 1:]


def lines_of(model: ThermalModel, case: Case, names: tuple[str, ...], labels: tuple[str, ...]) -> Lines:
    """Return the equations of a case whose boundaries are measured and whose properties are constant."""
    probe = {n: 1.0 + i for i, n in enumerate(case.press.coefficient_names)}
    stack = model.build(case, probe).stack
    spots = []
    for m, interface in enumerate(stack.interface):
        for state in range(3):
            for kind in range(3):
                value = stack.contact[m, state, kind]
                if value > 0:
                    spots.append((int(interface), state, kind, names.index(_name_of(probe, value))))
    run, moments = case.run, case.moments
    ends = (case.press.boundary.bottom, case.press.boundary.top)
    boundary = np.stack([_filled(run.time_s, run.columns[b.column or ""]) for b in ends], axis=1)
    switches = np.array(
        [moments.inserted_s, moments.closed_s, moments.opened_s, max(moments.ramp_s, 0.05), OPENING_RAMP_S]
    )
    places = np.stack([case.places[case.labels.index(label)] for label in labels])
    return Lines(
        model, case, names, stack.dx, np.asarray(stack.k), np.asarray(stack.c), np.array(spots, dtype=np.int64),
        places, boundary, switches,
    )  # fmt: skip


def _name_of(probe: Mapping[str, float], value: float) -> str:
    return next(n for n, v in probe.items() if abs(v - value) < 1e-9)


def _filled(t: Array, values: Array) -> Array:
    good = np.isfinite(values)
    return np.interp(t, t[good], values[good])


def _share(at: float, middle: float, length: float) -> float:
    return float(min(max((at - middle) / length + 0.5, 0.0), 1.0))


_ramp: Callable[[float, float, float], float] = compiled()(_share)


def _right_side(  # noqa: C901, PLR0913 - one compiled loop
    at: float, y: Array, h: Array, dx: Array, k: Array, c: Array, spots: Integers, times: Array,
    boundary: Array, switches: Array, ambient: float,
) -> Array:  # fmt: skip
    """Heat into each cell over its capacity, and the same for every sensitivity column."""
    n, width = y.shape
    p = width - 1
    row = min(max(int(np.searchsorted(times, at)) - 1, 0), len(times) - 2)
    u = (at - times[row]) / (times[row + 1] - times[row])
    ends = boundary[row] + u * (boundary[row + 1] - boundary[row])
    present = 1.0 if at >= switches[0] else 0.0
    closed = _ramp(at, switches[1], switches[3]) - _ramp(at, switches[2], switches[4])
    weight = np.array([1.0 - present, present - closed, closed])
    flow = np.zeros((n, width))
    contact = np.zeros((n + 1, 3))
    slope = np.zeros((n + 1, 3, max(p, 1)))
    touched = np.zeros(n + 1)
    for s in range(len(spots)):
        j, state, kind, name = spots[s]
        value = weight[state] * h[name]
        contact[j, kind] += value
        touched[j] = 1.0
        if p > 0:
            slope[j, kind, name] += value
    for j in range(n + 1):
        below = 0.5 * dx[j - 1] / k[j - 1] if j > 0 else 0.0
        above = 0.5 * dx[j] / k[j] if j < n else 0.0
        h0 = contact[j, 0]
        g = 1.0 / (below + above + 1.0 / h0) if h0 > 0 else (0.0 if touched[j] else 1.0 / (below + above))
        for q in range(width):
            low = y[j - 1, q] if j > 0 else (ends[0] if q == 0 else 0.0)
            high = y[j, q] if j < n else (ends[1] if q == 0 else 0.0)
            heat = g * (high - low)
            if q > 0 and h0 > 0:
                t_low = y[j - 1, 0] if j > 0 else ends[0]
                t_high = y[j, 0] if j < n else ends[1]
                heat += g * g / (h0 * h0) * slope[j, 0, q - 1] * (t_high - t_low)
            if j > 0:
                flow[j - 1, q] += heat
            if j < n:
                flow[j, q] -= heat
        for side in range(1, 3):
            ha = contact[j, side]
            i = j - 1 if side == 1 else j
            if ha <= 0 or i < 0 or i >= n:
                continue
            resistance = below if side == 1 else above
            ga = 1.0 / (resistance + 1.0 / ha)
            flow[i, 0] += ga * (ambient - y[i, 0])
            for q in range(1, width):
                flow[i, q] -= ga * y[i, q]
                flow[i, q] += ga * ga / (ha * ha) * slope[j, side, q - 1] * (ambient - y[i, 0])
    for i in range(n):
        for q in range(width):
            flow[i, q] /= c[i] * dx[i]
    return flow.ravel()


_right: Callable[..., Array] = compiled()(_right_side)
