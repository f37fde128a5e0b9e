"""The solver that is exact in time for a linear stack: decoupled modes between the ramps.

While the contacts stay as they are, C dT/dt = -K T + f(t) with constant C and K. With S = C^-1/2 K C^-1/2
= U diag(lam) U^T (symmetric tridiagonal) the modes q = U^T C^1/2 T decouple, and for outside temperatures
that are straight between the run's rows each step is exact (`heat.modal_steps`). Space is discretised as in
the implicit solver, so both must agree up to the latter's time error.

Through a ramp (closing, opening, handling) the contacts change continuously; there the implicit step is
used in steps of 10 ms. A staircase of constant contacts would need one eigenvalue problem a stair.

Tangents obey the same equation, forced by what a parameter's change does to the temperatures:
C s' = -K s + (-dK T + df - dC T'). The forcing is taken as straight between steps, which after a switch
start at 2 ms and grow up to a second; tangents are therefore not exact but good to 0.4 % of their largest
value with 0.1 K of noise on the platens, and to 2e-3 for coefficients away from them. What the ramps' steps
leave is below 0.5 mK a quarter of a second after a ramp, and 2 mK where tangents are asked for.
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

from daq.records import Array, InputError
from daq.words import say
from softsensor.heat import implicit_steps, modal_steps, step_terms
from softsensor.heat.build import Build
from softsensor.heat.case import Case, snap, step_means
from softsensor.heat.modal_steps import Neighbourhood
from softsensor.heat.readout import Reader
from softsensor.heat.timing import HANDLING_RAMP_S, OPENING_RAMP, TIMINGS

FIRST_STEP_S, GROWTH = 2e-3, 1.3
"""First step after a switch, and by how much each is longer than the one before; half of it, and half the excess
over 1, move faces by 0.2 mK each. [s, 1]

What these numbers do was measured (`tests.calibration.steps`: three sample runs, seed 2026, 2026-11-29)."""
RAMP_STEP_S = 0.01
"""In a closing or opening ramp; twice as long with tangents, and while the panel is handled, whose contacts
are weak. Half as long moves a face by 34 mK in the ramp, by 0.7 a second later, the core by 0.1. [s]"""
COARSE_STEP_S = 1.0
"""Longest step of tangents; twice and half as long move what a contact 1 % larger does by 0.4 mK at most. [s]"""
ALL_ROWS_S = 1.0
"""How long after a ramp no row is left out for them; twice as long moves that by 0.1 mK. [s]"""
AT_ONCE = 48
"""Steps of all tangents taken at a time: so few that their modes stay in the cache. By hand; moves no answer."""
KEPT = 64
"""Eigensystems remembered. By hand; moves no answer."""


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
    """Temperature outside both ends at the step edges (steps + 1, 2). [°C]"""
    coarse: NDArray[np.int64]
    """The step edges tangents are carried on."""
    spread: Reader | None
    """Reads tangents off at all step edges; None in a grid that is not fine."""


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


def exact_grid(case: Case, values: Mapping[str, float], *, fine: bool) -> Grid:
    """Return a case's grid for the exact solver, remembered; `fine` if more than the rows' moments counts.

    That is where tangents are wanted, or channels answer late or on a clock of their own.
    """
    return _grid(_Key(case), tuple((n, float(values.get(n, 0.0))) for n in (*TIMINGS, OPENING_RAMP)), fine)


def run_exact(grid: Grid, build: Build, places: Array, *, fields: bool = False) -> implicit_steps.Record:
    """Solve a linear model built on the grid's sparse case; return what is read at its step edges.

    `places` are the weights that read the cells (m, n).

    Raises
    ------
    InputError
        If the contacts change while the press is closed.
    """
    factor = build.drive.factor
    loaded = any(np.ptp(series) > 0.0 for series in grid.case.load.values())
    if (factor != factor[:1]).any() or (loaded and (factor != 1.0).any()):
        raise InputError(say("solve-exact-contact-changes"))
    march = _March(build, grid, places, whole=fields)
    steady = [span for span in grid.spans if span.steady]
    w, dw = freeze(build, np.array([span.at for span in steady], dtype=np.int64))
    frozen = dict(zip(steady, zip(w, dw, strict=True), strict=True))
    for span in grid.spans:
        if span.steady:
            march.steady(span, *frozen[span])
        else:
            march.ramp(span)
    d_out = np.empty((0, *march.out.shape))
    if build.request.names and grid.spread is not None:
        d_out = grid.spread(march.d_out[: len(build.request.names)])
    return implicit_steps.Record(places, march.out, d_out, march.fields)


class _March:
    """The state while spans are taken one after the other."""

    def __init__(self, build: Build, grid: Grid, places: Array, *, whole: bool) -> None:
        self.edges, self.coarse, self.h = grid.case.edges, grid.coarse, grid.case.h
        self.whole = whole
        self.build, self.drive = build, build.drive
        shift = (build.drive.boundary - grid.sparse.boundary)[0, :, 0]
        self.outside = grid.outside + shift
        self.places = places
        self.state = build.start
        steps, m = len(self.h), len(places)
        self.out = np.empty((steps + 1, m))
        self.d_out = np.zeros((build.width, len(self.coarse), m))
        self.fields = np.empty((steps + 1 if whole else 0, len(self.state.t)))
        self.out[0], self.d_out[:, 0] = places @ self.state.t, self.state.s @ places.T
        if whole:
            self.fields[0] = self.state.t

    def ramp(self, span: Span) -> None:
        """Take the implicit step through changing contacts."""
        a, b = span.first, span.last
        d, k = self.drive, slice(span.at, span.at + b - a)
        part = implicit_steps.Drive(
            d.h[k], d.weight[k], d.d_weight[k], d.factor[k], d.d_factor[k], d.boundary[k], d.d_boundary
        )
        self.state.clock[0] = 0.0
        record = implicit_steps.empty_record(self.places, b - a, self.build.width, whole=self.whole)
        implicit_steps.march(self.build.stack, self.build.tangents, part, self.state, record, False)
        self.out[a : b + 1] = record.out
        at = int(np.searchsorted(self.coarse, a))
        self.d_out[:, at : at + b - a + 1] = record.d_out
        if self.whole:
            self.fields[a : b + 1] = record.fields

    def steady(self, span: Span, w: Array, dw: Array) -> None:
        """Take exact steps with constant contacts and so constant coefficients.

        `w` and `dw` are the coefficients and their tangents as `step_terms` has them, each with its own unit.
        """
        modes = _decouple(w, self.build.stack.ambient)
        names, m = self.build.request.names, len(self.places)
        read = np.zeros((max(m, 3), len(modes.rates)))
        read[:m] = self.places @ modes.to_t
        edges = self.coarse[np.searchsorted(self.coarse, span.first) : np.searchsorted(self.coarse, span.last) + 1]
        chosen = np.arange(span.first, span.last + 1) if self.whole else edges[: len(edges) if names else 0]
        history = np.empty((len(chosen), len(modes.rates)))
        q = modes.from_t @ self.state.t
        out = np.empty((span.last - span.first + 1, len(read)))
        steps, outside = self.h[span.first : span.last], self.outside[span.first : span.last + 1]
        forced = modal_steps.Forced(modes.rates, steps, modes.gains, outside)
        modal_steps.drive(forced, q, modal_steps.Noted(read, out, chosen - span.first, history))
        self.out[span.first : span.last + 1] = out[:, :m]
        self.state.t[:] = modes.to_t @ q
        if self.whole:
            self.fields[chosen] = history @ modes.to_t.T
        if names:
            self._tangents(w, dw, modes, edges, history[edges - span.first] if self.whole else history, read[:m])

    def _tangents(
        self, w: Array, dw: Array, modes: Modes, edges: NDArray[np.int64], history: Array, read: Array
    ) -> None:
        """Carry the tangents over a span, forced by what the parameters do to the temperatures."""
        n, p = len(modes.rates), len(self.build.request.names)
        around = self._neighbourhood(dw, modes, edges, history)
        power = np.empty((p, len(edges), len(around.cells)))
        modal_steps.disturb(w, dw, self.drive.d_boundary, self.build.stack.ambient, around, power)
        gains, busy = modes.from_power.T[around.cells], np.flatnonzero(power.any(axis=(1, 2)))
        h = snap(np.diff(self.edges[edges]))
        start = self.state.s[:p] @ modes.from_t.T
        at = int(np.searchsorted(self.coarse, edges[0]))
        for first in range(0, len(h), AT_ONCE):
            last = min(first + AT_ONCE, len(h))
            forces = np.zeros((p, last + 1 - first, n))
            forces[busy] = power[busy, first : last + 1] @ gains
            q = np.empty_like(forces)
            q[:, 0] = start
            modal_steps.carry(modes.rates, h[first:last], forces, q)
            self.d_out[:p, at + first : at + last + 1] = q @ read.T
            start = q[:, -1]
        self.state.s[:p] = start @ modes.to_t.T

    def _neighbourhood(self, dw: Array, modes: Modes, edges: NDArray[np.int64], history: Array) -> Neighbourhood:
        """Return the cells any parameter touches, and the temperatures in and beside them."""
        n = len(modes.rates)
        touched = (dw[: step_terms.DSLOPE + 1] != 0.0).any(axis=(0, 1))
        touched[:n] |= touched[1:]
        touched[[0, n - 1]] |= self.drive.d_boundary.any(axis=1)
        cells = np.flatnonzero(touched[:n])
        near = np.zeros(n + 2, dtype=bool)
        near[cells] = near[cells + 1] = near[cells + 2] = True
        around = np.empty((len(edges), int(near.sum())))
        low, top = int(near[0]), int(near[-1])
        around[:, low : around.shape[1] - top] = history @ modes.to_t[near[1:-1]].T
        for end, there in ((0, low), (-1, top)):
            if there:
                around[:, end] = self.outside[edges, end]
        return Neighbourhood(cells, np.cumsum(near) - 1, around)


def freeze(build: Build, steps: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the coefficients of some steps (spans, rows, n + 1), and tangents (spans, rows, P, n + 1)."""
    p, n = build.start.s.shape
    w = np.zeros((len(steps), step_terms.ROWS, n + 1))
    dw = np.zeros((len(steps), step_terms.DROWS, p, n + 1))
    modal_steps.freeze_steps(build.stack, build.tangents, build.drive, build.start, steps, (w, dw))
    return w, dw


_remembered: OrderedDict[bytes, Modes] = OrderedDict()
_lock = Lock()


def _decouple(w: Array, ambient: float) -> Modes:
    """Solve the eigenvalue problem of constant contacts, or remember it."""
    n = w.shape[1] - 1
    rows = [step_terms.CAP, step_terms.G, step_terms.LOSS, step_terms.SRC, step_terms.DIAG]
    key = w[rows].tobytes() + np.float64(ambient).tobytes()
    with _lock:
        if key in _remembered:
            _remembered.move_to_end(key)
            return _remembered[key]
    cap, g, loss, src, diag = w[rows]
    root = np.sqrt(cap[:n])
    from scipy.linalg import eigh_tridiagonal  # loads slowly, and most runs are solved in steps

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


class _Key:
    """A case as a dictionary key: the same object is the same key."""

    def __init__(self, case: Case) -> None:
        self.case = case

    def __hash__(self) -> int:
        return id(self.case)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and other.case is self.case


@lru_cache(maxsize=256)
def _grid(key: _Key, shifts: tuple[tuple[str, float], ...], fine: bool) -> Grid:
    """Lay out the steps: all rows, the ramps finely, and short steps after a ramp if `fine`."""
    case = key.case
    times = case.run.time_s
    start, end = float(times[0]), float(times[-1])
    ramps = [r for r in case.row_clock.ramps(dict(shifts)) if start < r[1] and r[0] < end]
    parts: list[NDArray[Any]] = [times]
    for first, last in ramps:
        handled = abs(last - first - HANDLING_RAMP_S) < 1e-9
        step = RAMP_STEP_S * (2.0 if handled or fine else 1.0)
        parts.append(np.linspace(max(first, start), min(last, end), max(4, round((last - first) / step)) + 1))
    if fine:
        longest = min(float(np.median(np.diff(times))), COARSE_STEP_S)
        count = max(int(np.log(longest / FIRST_STEP_S) / np.log(GROWTH)), 4)
        for switch in [start, *(last for _, last in ramps)]:
            after = switch + FIRST_STEP_S * (GROWTH ** np.arange(1, count + 1) - 1.0) / (GROWTH - 1.0)
            parts.append(after[after < end])
        parts += [np.linspace(a, b, 5) for a, b in pairwise([start, *sum(sorted(ramps), ()), end]) if b > a]
    edges = np.unique(np.concatenate(parts))
    rows = np.isin(edges, times)
    close = np.flatnonzero(np.diff(edges) < 1e-7)
    drop = {int(i) if not rows[i] else int(i) + 1 for i in close}
    edges = np.delete(edges, [i for i in drop if not rows[i]])
    outside = np.empty((len(edges), 2))
    for end_number in range(2):
        series = case.outside[:, end_number]
        outside[:, end_number] = np.interp(edges, times, series)
        if not case.layout.measured[end_number]:
            outside[:, end_number] = case.layout.flux[end_number, 2]
    coarse = _coarse(edges, ramps, start)
    spans = _spans(edges, ramps)
    spread = _spread(edges, coarse, spans) if fine else None
    return Grid(replace(case, edges=edges), _sparse(case, edges, spans), spans, outside, coarse, spread)


def _spread(edges: Array, coarse: NDArray[np.int64], spans: tuple[Span, ...]) -> Reader:
    """Read tangents off between the chosen edges, never across a ramp's end."""
    first, weights = [], []
    for span in spans:
        a, b = np.searchsorted(coarse, (span.first, span.last))
        nodes, stop = coarse[a : b + 1], span.last + (1 if span is spans[-1] else 0)
        if len(nodes) < 4:
            seconds = float(edges[span.last] - edges[span.first])
            raise InputError(say("solve-exact-moments-too-near", seconds=seconds))
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
        spacing = min(0.1 * since[i], COARSE_STEP_S) if since[i] > ALL_ROWS_S else 0.0
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
    return replace(
        case,
        edges=few,
        boundary=np.stack([step_means(times, series, few) for series in case.outside.T], axis=1),
        load={m: np.full(len(few) - 1, float(np.mean(series))) for m, series in case.load.items()},
    )
