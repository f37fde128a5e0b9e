"""The press as an ordinary differential equation for an adaptive solver: how the paper solved it.

Method of lines on a case's mesh, optionally with the sensitivities integrated beside the temperatures by
the same solver. Only `softsensor.fitting.paper.procedures` uses it, to show what adaptive steps do to a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from daq.compiled import compiled
from daq.press.press_file import BoundaryKind
from daq.records import Array, InputError
from daq.words import say
from softsensor.heat.case import Case
from softsensor.heat.model import ThermalModel
from softsensor.heat.timing import OPENING_RAMP_S, ramp_length

Integers = NDArray[np.int64]


class Slab(NamedTuple):
    """What the compiled right-hand side needs of a run."""

    dx: Array
    """Cell widths (n). [m]"""
    conductivity: Array
    """(n). [W/mK]"""
    capacity: Array
    """Heat capacity per volume (n). [J/m³K]"""
    spots: Integers
    """Interface, state, kind (0 coupling, 1 lower face to air, 2 upper) and coefficient of each entry."""
    time_s: Array
    """Of the boundary temperatures (rows). [s]"""
    boundary: Array
    """Measured boundary temperatures (rows, 2). [°C]"""
    switches: Array
    """Insertion, closing, opening (infinite: not in this run), closing ramp, opening ramp. [s]"""
    ambient: float
    """[°C]"""


@dataclass(frozen=True)
class Lines:
    """A run's semi-discrete equations, ready to integrate."""

    model: ThermalModel
    case: Case
    names: tuple[str, ...]
    slab: Slab
    places: Array
    """Weights that read the sensors' places (places, n)."""

    def solve(self, h: Array, *, sensitivities: bool, method: str = "LSODA") -> tuple[Array, Array]:
        """Integrate with the solver's default tolerances; places (rows, places) and derivatives by ln h."""
        n, p = len(self.slab.dx), len(h) if sensitivities else 0
        names = self.names if sensitivities else ()
        state = self.model.build(self.case, dict(zip(self.names, h, strict=True)), names).start
        start = np.column_stack([state.t, state.s[:p].T * h[:p]])
        t = self.case.run.time_s
        band = 2 * (1 + p)
        options: dict[str, Any] = {"lband": band, "uband": band} if method == "LSODA" else {}

        def right(at: float, y: Array) -> Array:
            return _right(at, y.reshape(n, 1 + p), h, self.slab)

        found = solve_ivp(right, (t[0], t[-1]), start.ravel(), method=method, t_eval=t, **options)
        states = found.y.T.reshape(len(found.t), n, 1 + p)
        values = np.einsum("mn,tnq->tmq", self.places, states)
        if len(values) < len(t):
            values = np.concatenate([values, np.repeat(values[-1:], len(t) - len(values), axis=0)])
        return values[:, :, 0], values[:, :, 1:]


def lines_of(model: ThermalModel, case: Case, names: tuple[str, ...], labels: tuple[str, ...]) -> Lines:
    """Return the equations of a case whose boundaries are measured and whose properties are constant.

    Raises
    ------
    InputError
        For another boundary.
    """
    ends = (case.press.boundary.bottom, case.press.boundary.top)
    for end, boundary in zip(("bottom", "top"), ends, strict=True):
        if boundary.kind is not BoundaryKind.MEASURED:
            raise InputError(say("paper-boundary-not-measured", boundary=f"boundary.{end}", kind=boundary.kind))
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
    temperatures = np.stack([_filled(run.time_s, run.columns[b.column or ""]) for b in ends], axis=1)
    came = np.array([moments.inserted_s, moments.closed_s, moments.opened_s])
    never = np.where(np.isnan(came), np.inf, came)
    switches = np.array([*never, ramp_length(moments.ramp_s)[0], OPENING_RAMP_S])
    places = np.stack([case.places[case.labels.index(label)] for label in labels])
    slab = Slab(
        stack.dx,
        np.asarray(stack.k),
        np.asarray(stack.c),
        np.array(spots, dtype=np.int64),
        run.time_s,
        temperatures,
        switches,
        case.ambient,
    )
    return Lines(model, case, names, slab, places)


def _name_of(probe: Mapping[str, float], value: float) -> str:
    return next(n for n, v in probe.items() if abs(v - value) < 1e-9)


def _filled(t: Array, values: Array) -> Array:
    good = np.isfinite(values)
    return np.interp(t, t[good], values[good])


def _share(at: float, middle: float, length: float) -> float:
    return float(min(max((at - middle) / length + 0.5, 0.0), 1.0))


_ramp: Callable[[float, float, float], float] = compiled()(_share)


def _outside_at(at: float, slab: Slab) -> tuple[Array, Array]:
    """Return the boundary temperatures (2) [°C] and the shares of the states idle, open and closed (3)."""
    times, boundary, switches = slab.time_s, slab.boundary, slab.switches
    row = min(max(int(np.searchsorted(times, at)) - 1, 0), len(times) - 2)
    u = (at - times[row]) / (times[row + 1] - times[row])
    present = 1.0 if at >= switches[0] else 0.0
    closed = _ramp(at, switches[1], switches[3]) - _ramp(at, switches[2], switches[4])
    shares = np.array([1.0 - present, present - closed, closed])
    return boundary[row] + u * (boundary[row + 1] - boundary[row]), shares


_outside: Callable[[float, Slab], tuple[Array, Array]] = compiled()(_outside_at)


def _contacts_of(shares: Array, h: Array, slab: Slab, p: int) -> tuple[Array, Array, Array]:
    """Return contacts by kind (n + 1, 3), their slopes by ln h (n + 1, 3, p), and which interfaces have any."""
    n = len(slab.dx)
    contact = np.zeros((n + 1, 3))
    slope = np.zeros((n + 1, 3, max(p, 1)))
    touched = np.zeros(n + 1)
    for s in range(len(slab.spots)):
        j, state, kind, name = slab.spots[s]
        value = shares[state] * h[name]
        contact[j, kind] += value
        touched[j] = 1.0
        if p > 0:
            slope[j, kind, name] += value
    return contact, slope, touched


_contacts: Callable[[Array, Array, Slab, int], tuple[Array, Array, Array]] = compiled()(_contacts_of)


def _right_side(at: float, y: Array, h: Array, slab: Slab) -> Array:  # noqa: C901 - one compiled loop
    """Heat into each cell over its capacity, and the same for every sensitivity column."""
    n, width = y.shape
    dx, k, ambient = slab.dx, slab.conductivity, slab.ambient
    ends, shares = _outside(at, slab)
    contact, slope, touched = _contacts(shares, h, slab, width - 1)
    flow = np.zeros((n, width))
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
            flow[i, q] /= slab.capacity[i] * dx[i]
    return flow.ravel()


_right: Callable[..., Array] = compiled()(_right_side)
