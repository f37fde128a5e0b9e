"""The solver that is exact in time for a linear stack: decoupled modes between the ramps.

While the contacts stay as they are, C dT/dt = -K T + f(t) with constant C and K. With S = C^-1/2 K C^-1/2
= U diag(lam) U^T (symmetric tridiagonal) the modes q = U^T C^1/2 T decouple, and for outside temperatures
that are straight between the run's rows each step is exact (`kernels_modal`). Space is discretised as in
the implicit solver, so both must agree up to the latter's time error.

Through a ramp (closing, opening, handling) the contacts change continuously; there the implicit step is
used in steps of 8 ms. A staircase of constant contacts would need one eigenvalue problem a stair.

Tangents obey the same equation, forced by what a parameter's change does to the temperatures:
C s' = -K s + (-dK T + df - dC T'). The forcing is taken as straight between steps, which after a switch
start at 2 ms and grow by 20 % up to half a second; tangents are therefore not exact but good to about 1e-3
of their largest value.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal

from daq.records import Array, InputError
from softsensor import kernels, kernels_modal, kernels_terms
from softsensor.case import Case, snap, step_means
from softsensor.readout import Reader
from softsensor.timing import HANDLING_RAMP_S, TIMINGS, Clock

FIRST_STEP_S = 2e-3
GROWTH = 1.2
RAMP_STEP_S = 0.008
"""In a closing or opening ramp; twice as long while the panel is handled, whose contacts are weak. [s]"""
COARSE_STEP_S = 0.5
"""Longest step of tangents, and how long after a ramp no row is left out for them. [s]"""
FEW = 12
"""Up to so many disturbed cells are forced one by one."""
KEPT = 64
"""Eigensystems remembered."""


@dataclass(frozen=True)
class Span:
    """Steps `first` to `last` of a grid; `steady` if the contacts stay as they are."""

    first: int
    last: int
    steady: bool
    at: int
    """Its first step among those of the sparse case: one for a steady span."""


@dataclass(frozen=True)
class Grid:
    """A case whose step edges hold all rows, and spans of constant contacts."""

    case: Case
    sparse: Case
    """The same with one step for each steady span, to build coefficients on."""
    spans: tuple[Span, ...]
    outside: Array
    """Temperature outside both ends at the step edges, and 1 (steps + 1, 3). [°C]"""
    coarse: NDArray[np.int64]
    """The step edges tangents are carried on."""
    spread: Reader
    """Reads tangents off at all step edges."""


@dataclass(frozen=True)
class Modes:
    """A stack with constant contacts, decoupled."""

    rates: Array
    """(n). [1/s]"""
    to_t: Array
    """Temperatures from modes (n, n)."""
    from_t: Array
    """Modes from temperatures (n, n)."""
    gains: Array
    """Of the temperature below, above, and of 1 (3, n)."""
    from_power: Array
    """Forces on the modes from power in the cells (n, n)."""


@dataclass(frozen=True)
class Forcing:
    """How a parameter's change acts: power in `cells` = `on` @ (temperatures of `seen`, outside, 1)."""

    cells: NDArray[np.int64]
    seen: NDArray[np.int64]
    on: Array

    def power(self, columns: NDArray[np.int64], inputs: Array) -> Array:
        """Return the power in `cells` (rows, cells); inputs are temperatures of `columns`, outside, 1."""
        chosen = np.concatenate([np.searchsorted(columns, self.seen), len(columns) + np.arange(3)])
        return inputs[:, chosen] @ self.on.T


def exact_grid(case: Case, values: Mapping[str, float], *, fine: bool) -> Grid:
    """Return a case's grid for the exact solver, remembered; `fine` if tangents are wanted."""
    return _grid(_Key(case), tuple(float(values.get(name, 0.0)) for name in TIMINGS), fine)


def run_exact(grid: Grid, build: Any, places: Array, *, fields: bool = False) -> tuple[Array, Array, Array]:
    """Solve a linear model built on the grid's sparse case; return outputs, tangents, cell temperatures.

    Raises
    ------
    InputError
        If the contacts change while the press is closed.
    """
    factor = build.drive.factor
    loaded = any(np.ptp(series) > 0.0 for series in grid.case.load.values())
    if (factor != factor[:1]).any() or (loaded and (factor != 1.0).any()):
        raise InputError("method = 'exact': a contact changes while the press is closed; use the implicit solver")
    march = _March(build, grid, places, whole=fields)
    for span in grid.spans:
        if span.steady:
            march.steady(span)
        else:
            march.ramp(span)
    d_out = grid.spread(march.d_out[:, grid.coarse]) if build.names else march.d_out
    return march.out, d_out, march.fields


class _March:
    """The state while spans are taken one after the other."""

    def __init__(self, build: Any, grid: Grid, places: Array, *, whole: bool) -> None:
        self.edges, self.coarse, self.h = grid.case.edges, grid.coarse, grid.case.h
        self.whole = whole
        self.build, self.drive = build, build.drive
        shift = (build.drive.boundary - grid.sparse.boundary)[0, :, 0]
        self.outside = grid.outside + np.append(shift, 0.0)
        self.places = places
        self.state = build.start
        steps, m = len(self.h), len(places)
        self.out = np.empty((steps + 1, m))
        self.d_out = np.zeros((build.width, steps + 1, m))
        self.fields = np.empty((steps + 1 if whole else 0, len(self.state.t)))
        self.out[0], self.d_out[:, 0] = places @ self.state.t, self.state.s @ places.T
        if whole:
            self.fields[0] = self.state.t

    def ramp(self, span: Span) -> None:
        """Take the implicit step through changing contacts."""
        a, b = span.first, span.last
        d, k = self.drive, slice(span.at, span.at + b - a)
        part = kernels.Drive(
            d.h[k], d.weight[k], d.d_weight[k], d.factor[k], d.d_factor[k], d.boundary[k], d.d_boundary
        )
        m = len(self.places)
        out = np.empty((b - a + 1, m))
        d_out = np.empty((self.build.width, b - a + 1, m))
        fields = np.empty((b - a + 1 if self.whole else 0, len(self.state.t)))
        self.state.clock[0] = 0.0
        kernels.march(
            self.build.stack, self.build.tangents, part, self.state, self.places, False, out, d_out, fields
        )
        self.out[a : b + 1], self.d_out[:, a : b + 1] = out, d_out
        if self.whole:
            self.fields[a : b + 1] = fields

    def steady(self, span: Span) -> None:
        """Take exact steps with constant contacts."""
        a, b = span.first, span.last
        w, dw = _coefficients(self.build, self.drive, span.at)
        ambient, d_boundary = self.build.stack.ambient, self.drive.d_boundary
        modes = _decouple(w, ambient)
        forcings = [_forcing(w, dw, i, d_boundary, ambient) for i in range(len(self.build.names))]
        n, m = len(modes.rates), len(self.places)
        dense = self.whole or any(len(f.cells) > FEW for f in forcings)
        seen = np.unique(np.concatenate([f.seen for f in forcings])) if forcings and not dense else np.arange(0)
        read = np.concatenate([self.places @ modes.to_t, modes.to_t[seen]])
        q = (modes.from_t @ self.state.t)[None]
        out = np.empty((1, b - a + 1, len(read)))
        out[0, 0] = read @ q[0]
        history = np.empty((1 if dense else 0, b - a + 1, n))
        if dense:
            history[0, 0] = q[0]
        u, h = np.ascontiguousarray(self.outside[None, a : b + 1]), self.h[a:b]
        none = np.empty((0, 0, n))
        kernels_modal.modes(modes.rates, modes.gains[None], read, h, u, none, q, out, history)
        self.out[a : b + 1] = out[0, :, :m]
        seen_t = history[0] @ modes.to_t.T if dense else out[0, :, m:]
        if forcings:
            inputs = np.concatenate([seen_t, u[0]], axis=1)
            self._tangents(span, forcings, modes, np.arange(n) if dense else seen, inputs, read[:m])
        self.state.t[:] = modes.to_t @ q[0]
        if self.whole:
            self.fields[a : b + 1] = seen_t

    def _tangents(
        self,
        span: Span,
        forcings: list[Forcing],
        modes: Modes,
        seen: NDArray[np.int64],
        inputs: Array,
        read: Array,
    ) -> None:
        """Carry the tangents over a span, forced by what the parameters do to the temperatures."""
        n, p = len(modes.rates), len(forcings)
        edges = self.coarse[np.searchsorted(self.coarse, span.first) : np.searchsorted(self.coarse, span.last) + 1]
        h, steps = snap(np.diff(self.edges[edges])), len(edges) - 1
        inputs = inputs[edges - span.first]
        q = self.state.s[:p] @ modes.from_t.T
        out = np.empty((p, steps + 1, len(read)))
        out[:, 0] = q @ read.T
        none = np.empty((0, 0, n))
        few = [i for i, f in enumerate(forcings) if len(f.cells) <= FEW]
        c = max([len(forcings[i].cells) for i in few], default=1) or 1
        gains, u = np.zeros((len(few), c, n)), np.zeros((len(few), steps + 1, c))
        for row, i in enumerate(few):
            f = forcings[i]
            gains[row, : len(f.cells)] = modes.from_power[:, f.cells].T
            u[row, :, : len(f.cells)] = f.power(seen, inputs)
        x, y = q[few], out[few]
        kernels_modal.modes(modes.rates, gains, read, h, u, none, x, y, none)
        q[few], out[few] = x, y
        for i in sorted(set(range(p)) - set(few)):
            f = forcings[i]
            forced = (f.power(seen, inputs) @ modes.from_power[:, f.cells].T)[None]
            gains, u = np.zeros((1, 1, n)), np.zeros((1, 1, 1))
            kernels_modal.modes(modes.rates, gains, read, h, u, forced, q[i : i + 1], out[i : i + 1], none)
        self.d_out[:p, edges] = out
        self.state.s[:p] = q @ modes.to_t.T


def _coefficients(build: Any, drive: kernels.Drive, step: int) -> tuple[Array, Array]:
    """Return the coefficients of a step and their tangents."""
    p, n = build.start.s.shape
    w = np.zeros((kernels_terms.ROWS, n + 1))
    dw = np.zeros((kernels_terms.DROWS, p, n + 1))
    empty, d_empty = np.zeros((0, 2, n)), np.zeros((0, 2, p, n))
    kernels_terms.coefficients(
        build.stack, build.tangents, drive, step, 1.0, build.start.done, build.start.s_done, w, dw, empty, d_empty
    )
    return w, dw


_remembered: OrderedDict[bytes, Modes] = OrderedDict()
_lock = Lock()


def _decouple(w: Array, ambient: float) -> Modes:
    """Solve the eigenvalue problem of constant contacts, or remember it."""
    n = w.shape[1] - 1
    rows = [kernels_terms.CAP, kernels_terms.G, kernels_terms.LOSS, kernels_terms.SRC, kernels_terms.DIAG]
    key = w[rows].tobytes() + np.float64(ambient).tobytes()
    with _lock:
        if key in _remembered:
            _remembered.move_to_end(key)
            return _remembered[key]
    cap, g, loss, src, diag = w[rows]
    root = np.sqrt(cap[:n])
    rates, u = eigh_tridiagonal(diag[:n] / cap[:n], -g[1:n] / (root[1:] * root[:-1]))
    power = u.T / root
    inputs = np.zeros((n, 3))
    inputs[0, 0] += g[0]
    inputs[n - 1, 1] += g[n]
    inputs[:, 2] = loss[:n] * ambient + src[:n]
    modes = Modes(
        rates=np.maximum(rates, 0.0),
        to_t=np.ascontiguousarray(u / root[:, None]),
        from_t=np.ascontiguousarray(u.T * root),
        gains=np.ascontiguousarray((power @ inputs).T),
        from_power=power,
    )
    with _lock:
        _remembered[key] = modes
        while len(_remembered) > KEPT:
            _remembered.popitem(last=False)
    return modes


def _forcing(w: Array, dw: Array, i: int, d_boundary: Array, ambient: float) -> Forcing:
    """Return -dK T + df - dC T' of parameter `i` as a matrix on temperatures and outside."""
    n = w.shape[1] - 1
    t = kernels_terms
    if not dw[:, i].any() and not d_boundary[:, i].any():
        none = np.arange(0)
        return Forcing(none, none, np.zeros((0, 3)))
    cap, g, diag = w[t.CAP, :n], w[t.G], w[t.DIAG, :n]
    dcap, dg, dloss = dw[t.DCAP, i, :n], dw[t.DG, i], dw[t.DLOSS, i, :n]
    dsrc, dslope = dw[t.DSRC, i, :n], dw[t.DSLOPE, i, :n]
    share = dcap / cap
    below, above = dg[:n] - share * g[:n], dg[1:] - share * g[1:]
    here = -(dg[:n] + dg[1:] + dloss + dslope) + share * diag
    rest = dloss * ambient + dsrc - share * (w[t.LOSS, :n] * ambient + w[t.SRC, :n])
    rest[0] += g[0] * d_boundary[0, i]
    rest[n - 1] += g[n] * d_boundary[1, i]
    cells = np.flatnonzero((below != 0) | (above != 0) | (here != 0) | (rest != 0))
    near = np.zeros(n + 2, dtype=bool)
    near[cells] = near[cells + 1] = near[cells + 2] = True
    seen = np.flatnonzero(near[1:-1])
    rows, column = np.arange(len(cells)), np.searchsorted(seen, cells)
    on = np.zeros((len(cells), len(seen) + 3))
    on[rows, column] = here[cells]
    on[rows, np.where(cells > 0, column - 1, len(seen))] = below[cells]
    on[rows, np.where(cells < n - 1, column + 1, len(seen) + 1)] = above[cells]
    on[:, -1] = rest[cells]
    return Forcing(cells, seen, on)


class _Key:
    """A case as a dictionary key: the same object is the same key."""

    def __init__(self, case: Case) -> None:
        self.case = case

    def __hash__(self) -> int:
        return id(self.case)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and other.case is self.case


@lru_cache(maxsize=256)
def _grid(key: _Key, shifts: tuple[float, ...], fine: bool) -> Grid:
    """Lay out the steps: all rows, the ramps finely, and short steps after a ramp if `fine`."""
    case = key.case
    times = case.run.time_s
    start, end = float(times[0]), float(times[-1])
    shift = dict(zip(TIMINGS, shifts, strict=True))
    m = case.moments
    moments = replace(
        m,
        inserted_s=m.inserted_s + shift["inserted_s"],
        closed_s=m.closed_s + shift["closed_s"],
        opened_s=m.opened_s + shift["opened_s"],
        ramp_s=m.ramp_s + shift["ramp_s"],
    )
    clock = Clock.of(moments, times, start, mean=False, has_states=case.press.has_states)
    ramps = [r for r in clock.ramps() if start < r[1] and r[0] < end]
    parts: list[NDArray[Any]] = [times]
    for first, last in ramps:
        step = RAMP_STEP_S * (2.0 if abs(last - first - HANDLING_RAMP_S) < 1e-9 else 1.0)
        parts.append(np.linspace(max(first, start), min(last, end), max(4, round((last - first) / step)) + 1))
    if fine:
        longest = min(float(np.median(np.diff(times))), COARSE_STEP_S)
        count = max(int(np.log(longest / FIRST_STEP_S) / np.log(GROWTH)), 4)
        for switch in [start, *(last for _, last in ramps)]:
            after = switch + FIRST_STEP_S * (GROWTH ** np.arange(1, count + 1) - 1.0) / (GROWTH - 1.0)
            parts.append(after[after < end])
    edges = np.unique(np.concatenate(parts))
    rows = np.isin(edges, times)
    close = np.flatnonzero(np.diff(edges) < 1e-7)
    drop = {int(i) if not rows[i] else int(i) + 1 for i in close}
    edges = np.delete(edges, [i for i in drop if not rows[i]])
    outside = np.ones((len(edges), 3))
    for end_number in range(2):
        series = case.outside[:, end_number]
        outside[:, end_number] = np.interp(edges, times, series)
        if not case.layout.measured[end_number]:
            outside[:, end_number] = case.layout.flux[end_number, 2]
    has_states = case.press.has_states
    whole = replace(
        case,
        edges=edges,
        h=snap(np.diff(edges)),
        edge_clock=Clock.of(case.moments, edges, start, mean=False, has_states=has_states),
        reader=Reader.at(edges, times),
        slope_reader=Reader.at(edges, times, slope=True),
    )
    coarse = _coarse(edges, ramps, start)
    spans = _spans(edges, ramps)
    return Grid(whole, _sparse(case, edges, spans), spans, outside, coarse, _spread(edges, coarse, spans))


def _spread(edges: Array, coarse: NDArray[np.int64], spans: tuple[Span, ...]) -> Reader:
    """Read tangents off between the chosen edges, never across a ramp's end."""
    first, weights = [], []
    for span in spans:
        a, b = np.searchsorted(coarse, (span.first, span.last))
        nodes, stop = coarse[a : b + 1], span.last + (1 if span is spans[-1] else 0)
        if len(nodes) < 4:
            raise InputError(
                f"method = 'exact': less than four steps in {edges[span.last] - edges[span.first]:g} s"
            )
        part = Reader.at(edges[nodes], edges[span.first : stop])
        first.append(part.first + a)
        weights.append(part.weights)
    return Reader(np.concatenate(first), np.concatenate(weights))


def _coarse(edges: Array, ramps: list[tuple[float, float]], start: float) -> NDArray[np.int64]:
    """Choose step edges for tangents: all around a ramp, then ever fewer."""
    switches = np.array([start, *(last for _, last in ramps)])
    since = edges - switches[np.clip(np.searchsorted(np.sort(switches), edges, side="right") - 1, 0, None)]
    ends = np.array([first for first, _ in ramps] + [last for _, last in ramps])
    kept = [0]
    for i in range(1, len(edges)):
        spacing = min(0.1 * since[i], COARSE_STEP_S) if since[i] > 2 * COARSE_STEP_S else 0.0
        last = i == len(edges) - 1 or bool((np.abs(edges[i] - ends) < 1e-6).any())
        inside = any(first < edges[i] < stop for first, stop in ramps)
        if last or inside or edges[i] - edges[kept[-1]] >= spacing - 1e-9:
            kept.append(i)
    return np.array(kept)


def _spans(edges: Array, ramps: list[tuple[float, float]]) -> tuple[Span, ...]:
    """Cut the steps into ramps and what lies between them."""
    middle = (edges[1:] + edges[:-1]) / 2
    inside = np.zeros(len(middle), dtype=bool)
    for first, last in ramps:
        inside |= (middle > first) & (middle < last)
    cuts = [0, *(np.flatnonzero(np.diff(inside)) + 1).tolist(), len(middle)]
    spans: list[Span] = []
    at = 0
    for a, b in pairwise(cuts):
        spans.append(Span(a, b, not bool(inside[a]), at))
        at += 1 if spans[-1].steady else b - a
    return tuple(spans)


def _sparse(case: Case, edges: Array, spans: tuple[Span, ...]) -> Case:
    """Return the case with one step for each steady span and all steps of the ramps."""
    chosen = [np.arange(s.first, s.last) if not s.steady else np.array([s.first]) for s in spans]
    few = edges[np.concatenate([*chosen, [len(edges) - 1]])]
    times = case.run.time_s
    load = {m: np.full(len(few) - 1, float(np.mean(series))) for m, series in case.load.items()}
    clock = case.step_clock
    return replace(
        case,
        edges=few,
        h=snap(np.diff(few)),
        boundary=np.stack([step_means(times, series, few) for series in case.outside.T], axis=1),
        load=load,
        scene=replace(case.scene, step_start=few[:-1], step_end=few[1:], load=load),
        step_clock=Clock.of(case.moments, few, clock.start, mean=True, has_states=clock.has_states),
    )
