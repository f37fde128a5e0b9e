"""The live sensor's compiled loops: marching between scans, sensors to faces, Kalman update, mixture.

Parameters are counted in units of their prior's standard deviation, so that a belief starts as x ~ N(0, I).
The last axis of a tangent array runs over the thermal parameters (P) and then, where a measuring chain
is involved, over its two: lag and footprint (Q = P + 2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from softsensor import kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LONGEST_STEP_S = 0.5
_SWITCH_STEP_S = 0.08
_GROWTH = 0.15
_SETTLING_S = 0.35
"""How long around a ramp the fine steps last. [s]"""
_HANDLING_S = 0.2
_OPENING_S = 0.35
_BIG = 1e30


class Factors(NamedTuple):
    """Factor on closed contacts over the time since closing, integrated: a step's mean is a difference."""

    edges: Array
    """[s since closing]"""
    total: Array
    """(edges, contacts)"""
    d_total: Array
    """(edges, contacts, P)"""


class Chain(NamedTuple):
    """From temperatures at places to what the panel's thermocouples read; changed in place."""

    opposite: NDArray[np.bool_]
    """Whether a press face lies opposite each place while closed (M)."""
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


class Timing(NamedTuple):
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


@njit(cache=True)
def step_length(t, end, timing):
    """Return the next step from `t`: fine around switches, growing after them, never across a window's begin."""
    h = timing.longest
    for k in range(5):
        if k == 0:
            moment, half = timing.start, 0.0
        elif k == 1:
            moment, half = timing.inserted, _HANDLING_S
        elif k == 2:
            moment, half = timing.closed, timing.ramp / 2 + _SETTLING_S
        elif k == 3:
            moment, half = timing.opened, _OPENING_S / 2 + _SETTLING_S
        else:
            moment, half = timing.removed, _HANDLING_S
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


@njit(cache=True)
def _area(edge, middle, length):
    """Integral up to `edge` of a rise from 0 to 1 about `middle`."""
    x = (edge - middle) / length + 0.5
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return edge - middle
    return length * x * x / 2


@njit(cache=True)
def _share(edge, middle, length):
    return min(max((edge - middle) / length + 0.5, 0.0), 1.0)


@njit(cache=True)
def _mean_rise(a, b, middle, length):
    if middle == -math.inf:
        return 1.0
    if middle == math.inf:
        return 0.0
    return (_area(b, middle, length) - _area(a, middle, length)) / (b - a)


@njit(cache=True)
def _set_weights(weight, d_weight, k, a, b, timing, moving):
    """Fill a step's shares of idle, open, closed and their derivatives by the moments."""
    if not timing.switching:
        weight[k, 2] = 1.0
        return
    present = _mean_rise(a, b, timing.inserted, _HANDLING_S) - _mean_rise(a, b, timing.removed, _HANDLING_S)
    closed = _mean_rise(a, b, timing.closed, timing.ramp) - _mean_rise(a, b, timing.opened, _OPENING_S)
    closed = min(max(closed, 0.0), 1.0)
    weight[k, 0] = 1.0 - present
    weight[k, 1] = max(present - closed, 0.0)
    weight[k, 2] = closed
    if moving[0] >= 0 and math.isfinite(timing.inserted):
        change = _share(a, timing.inserted, _HANDLING_S) - _share(b, timing.inserted, _HANDLING_S)
        d_weight[k, 1, moving[0]] = change / (b - a) * timing.inserted_unit
        d_weight[k, 0, moving[0]] = -d_weight[k, 1, moving[0]]
    if moving[1] >= 0 and math.isfinite(timing.closed):
        change = _share(a, timing.closed, timing.ramp) - _share(b, timing.closed, timing.ramp)
        d_weight[k, 2, moving[1]] = change / (b - a) * timing.closed_unit
        d_weight[k, 1, moving[1]] = -d_weight[k, 2, moving[1]]
    if moving[2] >= 0 and math.isfinite(timing.opened):
        change = _share(b, timing.opened, _OPENING_S) - _share(a, timing.opened, _OPENING_S)
        d_weight[k, 2, moving[2]] = change / (b - a) * timing.opened_unit
        d_weight[k, 1, moving[2]] = -d_weight[k, 2, moving[2]]


@njit(cache=True)
def _set_factors(factor, d_factor, k, factors, a, b, closed):
    """Fill the mean factors on closed contacts over a step."""
    if not math.isfinite(closed):
        return
    last = factors.edges.shape[0] - 1
    low = min(max(a - closed, factors.edges[0]), factors.edges[last] - 1.0)
    high = min(low + (b - a), factors.edges[last])
    i = min(max(np.searchsorted(factors.edges, low) - 1, 0), last - 1)
    j = min(max(np.searchsorted(factors.edges, high) - 1, 0), last - 1)
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


@njit(cache=True)
def sense(chain, out, d_out, k, h, closed):
    """Bring the measuring chain to output row `k`, `h` seconds after the last (0: settled).

    The outputs are the sensors' places, the press faces opposite them, and the core.
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
        if chain.opposite[a] and closed > 0.0:
            w = chain.footprint * closed
            gap = out[k, m + a] - y
            row[p + 1] = closed * gap
            if w != 0.0:
                y += w * gap
                for q in range(p):
                    row[q] += w * (d_out[q, k, m + a] - row[q])
        _delay(chain, a, y, row, h, p)


@njit(cache=True)
def _delay(chain, a, y, row, h, p):
    """First-order lag with the input straight over the step, and its derivative by the time constant."""
    tau = chain.lag
    q_all = row.shape[0]
    old = chain.read[a]
    before = chain.true[a]
    if h <= 0.0:
        chain.read[a] = y
        chain.d_read[a] = row
    elif tau < 2e-3:
        chain.read[a] = y
        for q in range(q_all):
            chain.d_read[a, q] = row[q]
        chain.d_read[a, p] = -(y - before) / h
    else:
        x = h / tau
        e = math.exp(-x)
        r = (1.0 - e) / x
        dr = (e * (1.0 + x) - 1.0) / (x * x) if x > 1e-4 else -0.5 + x / 3.0
        chain.read[a] = old * e + before * (r - e) + y * (1.0 - r)
        for q in range(q_all):
            chain.d_read[a, q] = chain.d_read[a, q] * e + chain.d_true[a, q] * (r - e) + row[q] * (1.0 - r)
        chain.d_read[a, p] += (-old * e + before * (dr + e) - y * dr) * (-x / tau)
    chain.true[a] = y
    for q in range(q_all):
        chain.d_true[a, q] = row[q]


@njit(cache=True)
def march(stack, tangents, d_boundary, state, nonlinear, factors, chain, places, timing, span, outside, moving):
    """Take the model from ``span[0]`` to ``span[1]`` with platens straight from outside[0] to outside[1].

    `places` are the weights of the chain's outputs; `moving` the columns of the moments of insertion, closing and
    opening, -1 where they are no parameters.
    """
    p, n = state.s.shape
    lengths = np.empty(400)
    t, steps = span[0], 0
    while span[1] - t > 1e-9 and steps < 400:
        lengths[steps] = step_length(t, span[1], timing)
        t += lengths[steps]
        steps += 1
    h = lengths[:steps].copy()
    weight, d_weight = np.zeros((steps, 3)), np.zeros((steps, 3, p))
    contacts = factors.total.shape[1]
    factor, d_factor = np.ones((steps, contacts)), np.zeros((steps, contacts, p))
    boundary = np.zeros((steps, 2, 2))
    t = span[0]
    for k in range(steps):
        for side in range(2):
            slope = (outside[1, side] - outside[0, side]) / (span[1] - span[0])
            boundary[k, side, 0] = outside[0, side] + slope * (t + 0.5 * h[k] - span[0])
            boundary[k, side, 1] = slope * h[k]
        _set_weights(weight, d_weight, k, t, t + h[k], timing, moving)
        _set_factors(factor, d_factor, k, factors, t, t + h[k], timing.closed)
        t += h[k]
    drive = kernels.Drive(h, weight, d_weight, factor, d_factor, boundary, d_boundary)
    outputs = places.shape[0]
    out, d_out = np.empty((steps + 1, outputs)), np.empty((p, steps + 1, outputs))
    kernels.march(stack, tangents, drive, state, places, nonlinear, out, d_out, np.empty((0, n)))
    t = span[0]
    for k in range(steps):
        t += h[k]
        closed = 1.0
        if timing.switching:
            closed = _share(t, timing.closed, timing.ramp) if math.isfinite(timing.closed) else 0.0
            if math.isfinite(timing.opened):
                closed -= _share(t, timing.opened, _OPENING_S)
        sense(chain, out, d_out, k + 1, h[k], closed)


@njit(cache=True)
def settle(state, chain, places):
    """Bring the measuring chain to rest at the state's temperatures."""
    p, n = state.s.shape
    m = places.shape[0]
    out, d_out = np.zeros((1, m)), np.zeros((p, 1, m))
    for a in range(m):
        for i in range(n):
            out[0, a] += places[a, i] * state.t[i]
            for q in range(p):
                d_out[q, 0, a] += places[a, i] * state.s[q, i]
    sense(chain, out, d_out, 0, 0.0, 0.0)


class Consensus(NamedTuple):
    """What is known of the channels of all places; changed in place."""

    place: Integers
    """Place of each channel (K)."""
    shift: Array
    """Of each channel against its place's consensus (K). [K]"""
    scatter: Array
    """Mean square departure from the consensus (K). [K²]"""
    seen: Array
    """How many readings each channel has given (K)."""
    level: Array
    """Last consensus of each place, NaN at first (M). [°C]"""


@njit(cache=True)
def agree(consensus, values, out, trust):
    """Write the robust mean of each place's channels into `out` (M), NaN where none is usable.

    A channel's constant shift against the others is learned, so that it may drop out and return; one
    that departs from the others loses its vote. `trust` (M) gets the effective number of channels.
    """
    channels, places = consensus.place.shape[0], out.shape[0]
    for m in range(places):
        count = 0
        near = np.empty(channels)
        who = np.empty(channels, np.int64)
        for k in range(channels):
            if consensus.place[k] != m or not math.isfinite(values[k]):
                continue
            if consensus.seen[k] > 0.0 or consensus.level[m] != consensus.level[m]:
                near[count] = values[k] - consensus.shift[k]
                who[count] = k
                count += 1
        if count == 0:
            for k in range(channels):
                if consensus.place[k] == m and math.isfinite(values[k]):
                    near[count] = values[k]
                    who[count] = k
                    count += 1
        if count == 0:
            out[m] = math.nan
            trust[m] = 0.0
            continue
        middle = np.median(near[:count])
        total, weights = 0.0, 0.0
        for c in range(count):
            k = who[c]
            w = 0.04 / (0.04 + consensus.scatter[k])
            away = abs(near[c] - middle)
            w *= 1.0 if away < 0.6 else (0.6 / away) ** 2
            total += w * near[c]
            weights += w
        level = total / weights
        out[m] = level
        trust[m] = weights
        consensus.level[m] = level
        for k in range(channels):
            if consensus.place[k] != m or not math.isfinite(values[k]):
                continue
            seen = consensus.seen[k]
            away = values[k] - level - consensus.shift[k]
            if seen == 0.0:
                consensus.shift[k] = values[k] - level
                away = 0.0
            gain = 1.0 / min(seen + 1.0, 300.0)
            bounded = min(max(away, -0.6), 0.6)
            consensus.shift[k] += gain * bounded
            consensus.scatter[k] += max(0.05, 1.0 / (seen + 1.0)) * (away * away - consensus.scatter[k])
            consensus.seen[k] = seen + 1.0


@njit(cache=True)
def drift(x, cov, first, keep, variance):
    """Let the slow errors of the faces, states `first` and on, fade and be renewed."""
    n = x.shape[0]
    for a in range(first, n):
        x[a] *= keep
        for b in range(n):
            cov[a, b] *= keep
        for b in range(n):
            cov[b, a] *= keep
        cov[a, a] += variance * (1.0 - keep * keep)


@njit(cache=True, fastmath=True)
def absorb(x, cov, row, innovation, noise, limit):
    """One scalar Kalman update; beyond `limit` standard deviations the reading loses weight, beyond twice all.

    Returns the log-likelihood and the squared normalised innovation, both bounded by the limit.
    """
    n = x.shape[0]
    gain = np.empty(n)
    spread = noise
    for a in range(n):
        value = 0.0
        for b in range(n):
            value += cov[a, b] * row[b]
        gain[a] = value
        spread += row[a] * value
    square = innovation * innovation / spread
    fit = -0.5 * min(square, limit * limit) - 0.5 * math.log(spread)
    if square > limit * limit:
        spread = abs(innovation) * math.sqrt(spread) / limit
    if square > 4.0 * limit * limit:
        spread *= math.sqrt(square) / (2.0 * limit)
    move = innovation / spread
    for a in range(n):
        x[a] += gain[a] * move
        scaled = gain[a] / spread
        for b in range(n):
            cov[a, b] -= scaled * gain[b]
    return fit, square


@njit(cache=True)
def blend(x, cov, readout, where, absent, spike, one_sided, means, variances, evidence, sizes):
    """Split a joint belief into "nothing" and "one suspect at a time".

    The joint belief took every suspect as N(0, 1): at work. Each hypothesis narrows all suspects but its own
    to N(absent, spike^2); for Gaussians that is exact (Savage-Dickey).

    Parameters
    ----------
    readout
        Derivative of what is asked for by all states (N).
    where
        Columns of the suspects (E).
    absent, spike
        Where a suspect lies that is not at work, and how closely (E).
    one_sided
        Whether a suspect can only lie above `absent` (E).
    means, variances
        Get the shift of what is asked for from its joint mean, and its variance (E + 1).
    evidence
        Gets the logarithm of each hypothesis's likelihood relative to the joint belief (E + 1).
    sizes
        Gets the suspects' own mean under their own hypothesis (E).
    """
    e, n = where.shape[0], x.shape[0]
    to_all = cov @ readout
    variance = 0.0
    for a in range(n):
        variance += readout[a] * to_all[a]
    if e == 0:
        means[0], variances[0], evidence[0] = 0.0, variance, 0.0
        return
    own = np.empty((e, e))
    cross = np.empty(e)
    mean = np.empty(e)
    for a in range(e):
        mean[a] = x[where[a]]
        cross[a] = to_all[where[a]]
        for b in range(e):
            own[a, b] = cov[where[a], where[b]]
        own[a, a] += 1e-12
    precision = np.linalg.inv(own)
    slope = precision @ cross
    rest = variance - cross @ slope
    pull = precision @ mean
    before = mean @ pull
    narrow = precision.copy()
    base = 0.5 * (np.linalg.slogdet(precision)[1] - before)
    for a in range(e):
        narrow[a, a] += 1.0 / (spike[a] * spike[a]) - 1.0
        pull[a] += absent[a] / (spike[a] * spike[a])
        base -= math.log(spike[a]) + 0.5 * (absent[a] / spike[a]) ** 2
    inner = np.linalg.inv(narrow)
    still = inner @ pull
    base += 0.5 * (pull @ still - np.linalg.slogdet(narrow)[1])
    carried = inner @ slope
    plain = slope @ (still - mean)
    means[0] = plain
    variances[0] = max(rest + slope @ carried, 1e-12)
    evidence[0] = base
    for j in range(e):
        s = 1.0 / (spike[j] * spike[j]) - 1.0
        t = absent[j] / (spike[j] * spike[j])
        d = 1.0 - s * inner[j, j]
        f = s / d
        lift = f * (still[j] - t * inner[j, j]) - t
        size = still[j] + inner[j, j] * lift
        spread = inner[j, j] * (1.0 + f * inner[j, j])
        evidence[1 + j] = base + math.log(spike[j]) + 0.5 * (absent[j] / spike[j]) ** 2
        evidence[1 + j] += 0.5 * (lift * still[j] - t * size) - 0.5 * math.log(d)
        shift = plain + carried[j] * lift
        total = rest + slope @ carried + f * carried[j] * carried[j]
        if one_sided[j]:
            root = math.sqrt(spread)
            mass, push, shrink = _half_normal((size - absent[j]) / root)
            evidence[1 + j] += mass - _half_normal(-absent[j])[0]
            lever = carried[j] * (1.0 + f * inner[j, j]) / spread
            shift += lever * root * push
            total += lever * lever * spread * (shrink - 1.0)
            size += root * push
        sizes[j] = size
        means[1 + j] = shift
        variances[1 + j] = max(total, 1e-12)


@njit(cache=True)
def _half_normal(z):
    """Log mass, mean shift and variance factor of N(z, 1) cut at 0, in units of its deviation."""
    if z < -6.0:
        mass = -0.5 * z * z - math.log(-z) - 0.9189385332046727
        ratio = -z + 1.0 / (-z)
    else:
        share = 0.5 * math.erfc(-z / math.sqrt(2.0))
        mass = math.log(share)
        ratio = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / share
    return mass, ratio, max(1.0 - z * ratio - ratio * ratio, 1e-3)


@njit(cache=True)
def quantile(weights, means, sds, share):
    """Return the `share` quantile of a mixture of normals."""
    low, high = _BIG, -_BIG
    for j in range(weights.shape[0]):
        if weights[j] > 1e-9:
            low = min(low, means[j] - 8.0 * sds[j])
            high = max(high, means[j] + 8.0 * sds[j])
    for _ in range(40):
        middle = 0.5 * (low + high)
        total = 0.0
        for j in range(weights.shape[0]):
            if weights[j] > 1e-9:
                total += weights[j] * 0.5 * math.erfc((means[j] - middle) / (sds[j] * math.sqrt(2.0)))
        if total < share:
            low = middle
        else:
            high = middle
        if high - low < 1e-3:
            break
    return 0.5 * (low + high)


@njit(cache=True)
def absorb_faces(x, cov, at, chain, read_before, d_before, level, moment, votes, elapsed, errors, units, limit):
    """Update a belief by what the faces read during a block of scans.

    Parameters
    ----------
    at
        Where the filter is linearised (P).
    read_before, d_before
        The measuring chain at the block's begin (M), (M, Q).
    level, moment, votes
        Mean reading of each place (M), its mean time as a share of the block, the number of good channels.
    elapsed
        Length of the block. [s]
    errors
        White noise of one channel, share of the slope the model may be off right after a switch, its
        correlation time. [K, s, s]
    units
        Units of the chain's two parameters.

    Returns
    -------
    Log-likelihood, sum of squared normalised innovations, number of readings, and the logarithm of how much
    likelier the readings are if something changed at once (heavy tails of `errors[3]` K).
    """
    m, p = level.shape[0], at.shape[0]
    n = x.shape[0]
    row = np.zeros(n)
    fit, squares, count, jump = 0.0, 0.0, 0.0, 0.0
    coldest = -1
    for a in range(m):
        if math.isfinite(level[a]) and (coldest < 0 or level[a] < level[coldest]):
            coldest = a
    for a in range(m):
        if not math.isfinite(level[a]):
            continue
        u = moment[a]
        value = u * chain.read[a] + (1.0 - u) * read_before[a]
        slope = (chain.read[a] - read_before[a]) / elapsed if elapsed > 0.0 else 0.0
        row[:] = 0.0
        for q in range(p):
            row[q] = u * chain.d_read[a, q] + (1.0 - u) * d_before[a, q]
            value += row[q] * (x[q] - at[q])
        for q in range(2):
            row[p + q] = units[q] * (u * chain.d_read[a, p + q] + (1.0 - u) * d_before[a, p + q])
            value += row[p + q] * x[p + q]
        row[p + 2 + a] = 1.0
        row[p + 2 + m + a] = 1.0
        value += x[p + 2 + a] + x[p + 2 + m + a]
        if elapsed <= 0.0 and (a != coldest or level[a] - value > 1.0):
            continue  # the first scan of a run may lie at the insertion, when a face is already warming
        rough = errors[1] * slope
        noise = errors[0] ** 2 / max(votes[a], 0.2) + 3e-4
        noise += rough * rough * max(1.0, errors[2] / max(elapsed, 0.02))
        gained, square = absorb(x, cov, row, level[a] - value, noise, limit)
        wide = (level[a] - value) / errors[3]
        log_spread = -2.0 * (gained + 0.5 * min(square, limit * limit))
        jump += 0.5 * min(square, 200.0) + 0.5 * log_spread - math.log(1.25 * errors[3] * (1.0 + wide * wide))
        fit += gained
        squares += min(square, 25.0)
        count += 1.0
    return fit, squares, count, jump


@njit(cache=True)
def take(
    stack, tangents, d_boundary, state, nonlinear, factors, chain, places, timing, moving,
    span, outside, x, cov, at, level, moment, votes, errors, units, limit, slow, said,
):  # fmt: skip
    """March over blocks of scans and correct by what the faces read: `march`, `drift`, `absorb_faces` for each.

    `slow` are standard deviation and time constant of the faces' slow error [K, s]; `said` (K, 4) gets by block
    what `absorb_faces` returns.
    """
    for k in range(span.shape[0]):
        elapsed = span[k, 1] - span[k, 0]
        read_before, d_before = chain.read.copy(), chain.d_read.copy()
        if elapsed > 0.0:
            march(
                stack, tangents, d_boundary, state, nonlinear, factors, chain, places, timing,
                span[k], outside[k], moving,
            )  # fmt: skip
            keep = math.exp(-elapsed / slow[1])
            drift(x, cov, x.shape[0] - chain.read.shape[0], keep, slow[0] * slow[0])
        said[k, 0], said[k, 1], said[k, 2], said[k, 3] = absorb_faces(
            x, cov, at, chain, read_before, d_before, level[k], moment[k], votes[k], elapsed, errors, units, limit
        )  # fmt: skip
