"""The live sensor's march: compiled loops from platen temperatures to what the panel's thermocouples read.

Parameters are counted in units of their prior's standard deviation. The last axis of a tangent array runs over the
thermal parameters (P) and then, where a measuring chain is involved, over its two: lag and footprint (Q = P + 2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from softsensor.heat import implicit_steps as kernels
from softsensor.heat.step_terms import lag_weights
from softsensor.heat.timing import HANDLING_RAMP_S, OPENING_RAMP_S

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Numbers without another source were set by hand, 2026-11.

LONGEST_STEP_S = 0.5
"""Longest step of a march: what a block covers at 10 Hz (up to the first scan beyond `block_steps.BLOCK_S`), so
that a settled one takes one. [s]"""
_SWITCH_STEP_S, _SETTLING_S, _GROWTH = 0.08, 0.35, 0.15
"""Step around a ramp, how long beyond it such steps last, and how steps grow after. By hand, 2026-11. [s, s, -]

A fit's finer ones last a little longer (`heat.case.SWITCHED_S`); with that here, a start temperature 4 K off left
the core 1.13 instead of 0.75 K off in one pressing of the tests."""


class ByLoad(NamedTuple):
    """What a contact's load does to its factor, over that at the first scan's load."""

    loads: Array
    """Logarithms of the load over its reference, even; none where no contact's load is followed (L)."""
    log: Array
    """Of the factor (L, contacts)."""
    d_log: Array
    """(L, contacts, P)"""


class Factors(NamedTuple):
    """Factor on closed contacts over the time since closing, integrated: a step's mean is a difference."""

    edges: Array
    """[s since closing]"""
    total: Array
    """(edges, contacts)"""
    d_total: Array
    """(edges, contacts, P)"""
    by_load: ByLoad


class SensorChain(NamedTuple):
    """From temperatures at places to what the panel's thermocouples read; changed in place."""

    opposite: NDArray[np.bool_]
    """Whether a press face lies opposite each place while closed (M)."""
    moved: Integers
    """Column of the parameter by which each place is moved in height, -1 where it is none (M)."""
    lag: float
    """[s]"""
    footprint: float
    true: Array
    """Before the lag (M)."""
    d_true: Array
    """(M, Q)"""
    read: Array
    """After the lag (M)."""
    d_read: Array
    """(M, Q)"""
    level: Array
    """Core now, and its slope (2). [°C, K/s]"""
    d_level: Array
    """(P)"""


class PressTiming(NamedTuple):
    """When things happen; infinite where they do not (yet). [s]"""

    start: float
    inserted: float
    closed: float
    opened: float
    removed: float
    ramp: float
    switching: bool
    """Whether opening and closing changes anything."""
    inserted_unit: float
    """How many seconds one unit of the parameter for the insertion is; so for the next two moments."""
    closed_unit: float
    opened_unit: float
    longest: float
    """Longest step. [s]"""


class LinearModel(NamedTuple):
    """The thermal model linearised about one set of parameters; `state` and `chain` change in place."""

    stack: kernels.Stack
    tangents: kernels.Tangents
    d_boundary: Array
    """Derivatives of the boundary temperatures (2, P)."""
    nonlinear: bool
    factors: Factors
    places: Array
    """Weights of the outputs: sensors' places, what is beside each, core (2 M + 1, n).

    Beside a place is the press face opposite, or what its reading changes by if the place is moved by one unit."""
    moving: Integers
    """Columns of the moments of insertion, closing and opening, -1 where they are no parameters (3)."""
    state: kernels.State
    chain: SensorChain


@compiled(inner=True)
def step_length(t, end, timing):
    """Return the next step from `t`: fine around switches, growing after them, never across a window's begin."""
    h = timing.longest
    for k in range(5):
        if k == 0:
            moment, half = timing.start, 0.0
        elif k == 1:
            moment, half = timing.inserted, HANDLING_RAMP_S
        elif k == 2:
            moment, half = timing.closed, timing.ramp / 2 + _SETTLING_S
        elif k == 3:
            moment, half = timing.opened, OPENING_RAMP_S / 2 + _SETTLING_S
        else:
            moment, half = timing.removed, HANDLING_RAMP_S
        if not math.isfinite(moment):
            continue
        if t < moment - half - 1e-9:
            h = min(h, moment - half - t)
        elif t < moment + half - 1e-9:
            h = min(h, _SWITCH_STEP_S)
        else:
            h = min(h, 0.5 * _SWITCH_STEP_S + _GROWTH * (t - moment - half))
    left = end - t
    if left <= 1.3 * h:
        return left
    return min(h, 0.5 * left) if left < 2.0 * h else h


@compiled(inner=True)
def _area(edge, middle, length):
    """Integral up to `edge` of a rise from 0 to 1 about `middle`."""
    x = (edge - middle) / length + 0.5
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return edge - middle
    return length * x * x / 2


@compiled(inner=True)
def _share(edge, middle, length):
    return min(max((edge - middle) / length + 0.5, 0.0), 1.0)


@compiled(inner=True)
def _mean_rise(a, b, middle, length):
    if middle == -math.inf:
        return 1.0
    if middle == math.inf:
        return 0.0
    return (_area(b, middle, length) - _area(a, middle, length)) / (b - a)


@compiled(inner=True)
def set_shares(drive, k, a, b, timing, moving):
    """Fill a step's shares of idle, open, closed and their derivatives by the moments."""
    weight, d_weight = drive.weight, drive.d_weight
    if not timing.switching:
        weight[k, 2] = 1.0
        return
    present = _mean_rise(a, b, timing.inserted, HANDLING_RAMP_S) - _mean_rise(
        a, b, timing.removed, HANDLING_RAMP_S
    )
    closed = _mean_rise(a, b, timing.closed, timing.ramp) - _mean_rise(a, b, timing.opened, OPENING_RAMP_S)
    closed = min(max(closed, 0.0), 1.0)
    weight[k, 0] = 1.0 - present
    weight[k, 1] = max(present - closed, 0.0)
    weight[k, 2] = closed
    if moving[0] >= 0 and math.isfinite(timing.inserted):
        change = _share(a, timing.inserted, HANDLING_RAMP_S) - _share(b, timing.inserted, HANDLING_RAMP_S)
        d_weight[k, 1, moving[0]] = change / (b - a) * timing.inserted_unit
        d_weight[k, 0, moving[0]] = -d_weight[k, 1, moving[0]]
    if moving[1] >= 0 and math.isfinite(timing.closed):
        change = _share(a, timing.closed, timing.ramp) - _share(b, timing.closed, timing.ramp)
        d_weight[k, 2, moving[1]] = change / (b - a) * timing.closed_unit
        d_weight[k, 1, moving[1]] = -d_weight[k, 2, moving[1]]
    if moving[2] >= 0 and math.isfinite(timing.opened):
        change = _share(b, timing.opened, OPENING_RAMP_S) - _share(a, timing.opened, OPENING_RAMP_S)
        d_weight[k, 2, moving[2]] = change / (b - a) * timing.opened_unit
        d_weight[k, 1, moving[2]] = -d_weight[k, 2, moving[2]]


@compiled(inner=True)
def _set_factors(drive, k, a, b, factors, closed):
    """Fill the mean factors on closed contacts over a step."""
    factor, d_factor = drive.factor, drive.d_factor
    if not math.isfinite(closed):
        return
    last = factors.edges.shape[0] - 1
    low = min(max(a - closed, factors.edges[0]), factors.edges[last] - 1.0)
    high = min(low + (b - a), factors.edges[last])
    i = 0
    while i < last - 1 and factors.edges[i + 1] < low:
        i += 1
    j = i
    while j < last - 1 and factors.edges[j + 1] < high:
        j += 1
    u = (low - factors.edges[i]) / (factors.edges[i + 1] - factors.edges[i])
    v = (high - factors.edges[j]) / (factors.edges[j + 1] - factors.edges[j])
    for m in range(factors.total.shape[1]):
        first = factors.total[i, m] + u * (factors.total[i + 1, m] - factors.total[i, m])
        second = factors.total[j, m] + v * (factors.total[j + 1, m] - factors.total[j, m])
        factor[k, m] = (second - first) / (high - low)
        for q in range(factors.d_total.shape[2]):
            d_first = factors.d_total[i, m, q] * (1 - u) + u * factors.d_total[i + 1, m, q]
            d_second = factors.d_total[j, m, q] * (1 - v) + v * factors.d_total[j + 1, m, q]
            d_factor[k, m, q] = (d_second - d_first) / (high - low)


@compiled(inner=True)
def _set_loads(drive, k, by_load, outside, along):
    """Multiply a step's factors by what the loads do, `along` the way from outside[0] to outside[1]."""
    factor, d_factor = drive.factor, drive.d_factor
    loads = by_load.loads
    last = loads.shape[0] - 1
    if last < 1:
        return
    for m in range(by_load.log.shape[1]):
        load = outside[0, 2 + m] + along * (outside[1, 2 + m] - outside[0, 2 + m])
        x = (min(max(load, loads[0]), loads[last]) - loads[0]) / (loads[1] - loads[0])
        i = min(int(x), last - 1)
        u = x - i
        rise = math.exp((1.0 - u) * by_load.log[i, m] + u * by_load.log[i + 1, m])
        for q in range(by_load.d_log.shape[2]):
            d_log = (1.0 - u) * by_load.d_log[i, m, q] + u * by_load.d_log[i + 1, m, q]
            d_factor[k, m, q] = rise * (d_factor[k, m, q] + factor[k, m] * d_log)
        factor[k, m] *= rise


@compiled(inner=True)
def read_sensors(chain, out, d_out, k, h, closed):
    """Bring the measuring chain to output row `k`, `h` seconds after the last (0: settled).

    The outputs are the sensors' places, what is beside them, and the core (`LinearModel.places`).
    """
    m = chain.read.shape[0]
    p = chain.d_level.shape[0]
    after = out[k, 2 * m]
    chain.level[1] = (after - chain.level[0]) / h if h > 0.0 else 0.0
    chain.level[0] = after
    for q in range(p):
        chain.d_level[q] = d_out[q, k, 2 * m]
    row = np.empty(p + 2)
    for a in range(m):
        y = out[k, a]
        for q in range(p):
            row[q] = d_out[q, k, a]
        row[p] = 0.0
        row[p + 1] = 0.0
        if chain.moved[a] >= 0:
            row[chain.moved[a]] += out[k, m + a]
        if chain.opposite[a] and closed > 0.0:
            w = chain.footprint * closed
            gap = out[k, m + a] - y
            row[p + 1] = closed * gap
            if w != 0.0:
                y += w * gap
                for q in range(p):
                    row[q] += w * (d_out[q, k, m + a] - row[q])
        _delay(chain, a, y, row, h)


@compiled(inner=True)
def _delay(chain, a, y, row, h):
    """First-order lag with the input straight over the step, and its derivative by the time constant."""
    tau = chain.lag
    q_all = row.shape[0]
    p = q_all - 2
    old = chain.read[a]
    before = chain.true[a]
    if h <= 0.0 or tau < 2e-3:
        chain.read[a] = y
        for q in range(q_all):
            chain.d_read[a, q] = row[q]
        if h > 0.0:
            chain.d_read[a, p] = -(y - before) / h
    else:
        x = h / tau
        e, r, dr = lag_weights(x)
        chain.read[a] = old * e + before * (r - e) + y * (1.0 - r)
        for q in range(q_all):
            chain.d_read[a, q] = chain.d_read[a, q] * e + chain.d_true[a, q] * (r - e) + row[q] * (1.0 - r)
        chain.d_read[a, p] += (-old * e + before * (dr + e) - y * dr) * (-x / tau)
    chain.true[a] = y
    for q in range(q_all):
        chain.d_true[a, q] = row[q]


@compiled()
def march_span(model, timing, span, outside):
    """Take the model from ``span[0]`` to ``span[1]``, what is outside straight from outside[0] to outside[1].

    Outside are the temperatures of the boundaries, bottom and top, and the logarithms of the contacts' loads.
    """
    drive = drive_of(model.d_boundary, model.moving, model.factors, timing, span, outside)
    chain, (p, n) = model.chain, model.state.s.shape
    steps, outputs = drive.h.shape[0], model.places.shape[0]
    out, d_out = np.empty((steps + 1, outputs)), np.empty((p, steps + 1, outputs))
    record = kernels.Record(model.places, out, d_out, np.empty((0, n)))
    kernels.march(model.stack, model.tangents, drive, model.state, record, model.nonlinear)
    t = span[0]
    for k in range(steps):
        t += drive.h[k]
        read_sensors(chain, out, d_out, k + 1, drive.h[k], _closed(t, timing))


@compiled(inner=True)
def drive_of(d_boundary, moving, factors, timing, span, outside):
    """Cut a span into steps, each with its press state, contact factors and platens."""
    p = d_boundary.shape[1]
    lengths = np.empty(400)
    t, steps = span[0], 0
    while span[1] - t > 1e-9 and steps < 400:
        lengths[steps] = step_length(t, span[1], timing)
        t += lengths[steps]
        steps += 1
    h = lengths[:steps].copy()
    contacts = factors.total.shape[1]
    drive = kernels.Drive(
        h, np.zeros((steps, 3)), np.zeros((steps, 3, p)), np.ones((steps, contacts)),
        np.zeros((steps, contacts, p)), np.zeros((steps, 2, 2)), d_boundary,
    )  # fmt: skip
    t = span[0]
    for k in range(steps):
        for side in range(2):
            slope = (outside[1, side] - outside[0, side]) / (span[1] - span[0])
            drive.boundary[k, side, 0] = outside[0, side] + slope * (t + 0.5 * h[k] - span[0])
            drive.boundary[k, side, 1] = slope * h[k]
        set_shares(drive, k, t, t + h[k], timing, moving)
        _set_factors(drive, k, t, t + h[k], factors, timing.closed)
        _set_loads(drive, k, factors.by_load, outside, (t + 0.5 * h[k] - span[0]) / (span[1] - span[0]))
        t += h[k]
    return drive


@compiled(inner=True)
def _closed(t, timing):
    """Return how far the press is closed at a time, from 0 to 1."""
    if not timing.switching:
        return 1.0
    closed = _share(t, timing.closed, timing.ramp) if math.isfinite(timing.closed) else 0.0
    if math.isfinite(timing.opened):
        closed -= _share(t, timing.opened, OPENING_RAMP_S)
    return closed


@compiled()
def settle_sensors(state, chain, places):
    """Bring the measuring chain to rest at the state's temperatures."""
    p, n = state.s.shape
    m = places.shape[0]
    out, d_out = np.zeros((1, m)), np.zeros((p, 1, m))
    for a in range(m):
        for i in range(n):
            out[0, a] += places[a, i] * state.t[i]
            for q in range(p):
                d_out[q, 0, a] += places[a, i] * state.s[q, i]
    read_sensors(chain, out, d_out, 0, 0.0, 0.0)
