"""The compiled loops: implicit time steps of a layered stack with forward tangents.

Everything here works on plain arrays. A stack of ``n`` cells (bottom to top) obeys, cell by cell,

    C dT/dt = sum of G (T_neighbour - T) + losses (T_ambient - T) + sources            [W/m²]

and one step is TR-BDF2 (Bank et al. 1985; Hosea & Shampine 1996): L-stable, second order, both stages
with the same tridiagonal matrix. What depends on temperature is taken at the temperature
extrapolated to the middle of the step, so a step is linear and its tangents are exact derivatives
of the step itself. Sources that fall with temperature, the only stiff ones, enter with their slope.

Index conventions: cells ``i = 0..n-1``; interfaces ``j = 0..n``, interface j lies below cell j.
States are 0 idle, 1 open, 2 closed. In tangent arrays the parameters come before the cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from softsensor.heat.step_terms import (
    CAP,
    DCAP,
    DG,
    DIAG,
    DLOSS,
    DSLOPE,
    DSRC,
    DSTAR,
    FAST,
    GAMMA,
    LOSS,
    RATE,
    RSLOPE,
    SLOPE,
    SRC,
    STAR,
    Array,
    D,
    Drive,
    G,
    Integers,
    Stack,
    State,
    Tangents,
    any_of,
    coefficients,
    lag_weights,
    room,
    switched,
)

__all__ = [
    "Array",
    "Drive",
    "Integers",
    "Record",
    "Stack",
    "State",
    "Tangents",
    "delay",
    "empty_record",
    "march",
    "rest",
    "weighted_rows",
]

# Numbers without another source were set by hand, 2026-11.

_W = 2.0**0.5 / 4.0
"""TR-BDF2: weight of the step's begin and of its first stage, (1 - `D`) / 2; the end weighs `D`."""


class Record(NamedTuple):
    """What is read off the temperatures, before the first step and after each."""

    places: Array
    """Weights of the outputs (m, n)."""
    out: Array
    """(steps + 1, m). [°C]"""
    d_out: Array
    """(P, steps + 1, m)"""
    fields: Array
    """All cell temperatures (steps + 1, n), filled if it has rows. [°C]"""


def empty_record(places: Array, steps: int, p: int, *, whole: bool) -> Record:
    """Return room for so many steps and parameters of places read by weights (m, n); for all cells if `whole`."""
    m, n = places.shape
    fields = np.empty((steps + 1 if whole else 0, n))
    return Record(places, np.empty((steps + 1, m)), np.empty((p, steps + 1, m)), fields)


class Work(NamedTuple):
    """Room for a step."""

    scratch: Array
    """Inverse pivots, back substitution, both stages, right-hand side, differences, sums, loads (8, n)."""
    d_scratch: Array
    """Both stages' tangents (2, P, n)."""
    busy: Integers
    """Cells whose coefficients any parameter changes (n)."""


class Outside(NamedTuple):
    """What lies beyond the stack, as in `Stack`."""

    ambient: float
    measured: NDArray[np.bool_]
    flux: Array


class Stage(NamedTuple):
    """What a stage of a step does with temperatures, for its tangents."""

    move: Array
    """Start minus result, which a changed heat capacity acts on (n). [K]"""
    combo: Array
    """The step times the stage's weighted temperatures (n). [s °C]"""
    bounds: Array
    """The same outside (2)."""
    share: float
    """The step times the stage's share. [s]"""


@compiled(nogil=True)
def march(stack, tan, drive, state, record, nonlinear):
    """Take all steps, and record before the first and after each."""
    p, n = state.s.shape
    r = stack.heat.shape[0]
    co = room(r, p, n)
    work = Work(np.zeros((8, n)), np.empty((2, p, n)), np.zeros(n, np.int64))
    outside = Outside(stack.ambient, stack.measured, stack.flux)
    steps = drive.h.shape[0]
    step = np.int64(0)  # a plain 0 would be a type of its own, and all that takes it be compiled twice
    _observe(record, state, step)
    while step < steps:
        last = step + 1
        if nonlinear or step == 0:
            _expect(state, drive.h[step], co)
            coefficients(stack, tan, drive, step, state, co)
        else:
            switched(stack, tan, drive, step, state, co)
        count = n
        if not nonlinear:
            last = _same(drive, step)
            count = _touched(co.dw, work.busy)
        _advance(outside, drive, state, record, co, work, (step, last, count))
        if r > 0:
            _convert(stack.heat, state, co, work, drive.h[step])
        state.clock[0] = drive.h[last - 1]
        step = last


@compiled(inner=True)
def _same(drive, step):
    """Return the first later step whose contacts differ from those of `step`."""
    weight, d_weight, factor, d_factor = drive.weight, drive.d_weight, drive.factor, drive.d_factor
    steps, p = weight.shape[0], d_weight.shape[2]
    for last in range(step + 1, steps):
        for s in range(3):
            if weight[last, s] != weight[step, s]:
                return last
            for q in range(p):
                if d_weight[last, s, q] != d_weight[step, s, q]:
                    return last
        for m in range(factor.shape[1]):
            if factor[last, m] != factor[step, m]:
                return last
            for q in range(p):
                if d_factor[last, m, q] != d_factor[step, m, q]:
                    return last
    return steps


@compiled(inner=True)
def _touched(dw, busy):
    """List the cells whose coefficients any parameter changes; return how many."""
    p, n = dw.shape[1], busy.shape[0]
    count = 0
    for i in range(n):
        for q in range(p):
            if (
                dw[DCAP, q, i] != 0.0
                or dw[DLOSS, q, i] != 0.0
                or dw[DSRC, q, i] != 0.0
                or dw[DSLOPE, q, i] != 0.0
                or dw[DG, q, i] != 0.0
                or dw[DG, q, i + 1] != 0.0
            ):
                busy[count] = i
                count += 1
                break
    return count


@compiled(inner=True, fastmath=FAST)
def _expect(state, h, co):
    """Temperatures expected in the middle of a step of length h, and their tangents."""
    t, t_before, s, s_before, before = state.t, state.t_before, state.s, state.s_before, state.clock[0]
    p, n = s.shape
    ratio = min(0.5 * h / before, 1.0) if before > 0.0 else 0.0
    star, dstar = co.w[STAR], co.dw[DSTAR]
    for i in range(n):
        star[i] = t[i] + ratio * (t[i] - t_before[i])
    for q in range(p):
        for i in range(n):
            dstar[q, i] = s[q, i] + ratio * (s[q, i] - s_before[q, i])


@compiled(inner=True, fastmath=FAST)
def _advance(outside, drive, state, record, co, work, span):
    """Take steps with the same coefficients; `span`: first step, the one after the last, how many are busy."""
    step, last, count = span
    boundary, d_boundary, ambient = drive.boundary, drive.d_boundary, outside.ambient
    t, t_before, s, s_before = state.t, state.t_before, state.s, state.s_before
    w, dw, scratch, d_scratch, busy = co.w, co.dw, work.scratch, work.d_scratch, work.busy[:count]
    p, n = s.shape
    cap, g, loss, src, diag = w[CAP], w[G], w[LOSS], w[SRC], w[DIAG]
    inv, back, tg, tn = scratch[0], scratch[1], scratch[2], scratch[3]
    rhs, move, combo, load = scratch[4], scratch[5], scratch[6], scratch[7]
    sg, sn = d_scratch[0], d_scratch[1]
    ends = np.empty((2, 3))
    bounds = np.empty(2)
    for i in range(n):
        load[i] = loss[i] * ambient + src[i]
    before = -1.0
    for k in range(step, last):
        h = drive.h[k]
        dh = D * h
        if h != before:
            before = h
            _factor(cap, diag, g, dh, inv, back)
        for end in range(2):
            for stage in range(3):
                at = 0.0 if stage == 0 else (GAMMA if stage == 1 else 1.0)
                ends[end, stage] = (
                    boundary[k, end, 0] + (at - 0.5) * boundary[k, end, 1]
                    if outside.measured[end]
                    else outside.flux[end, 2]
                )
        # the boundaries as sources, then both stages of the temperatures
        first_b, first_t = g[0] * (ends[0, 0] + ends[0, 1]), g[n] * (ends[1, 0] + ends[1, 1])
        _conduct(diag, g, t, rhs)
        for i in range(n):
            tg[i] = cap[i] * t[i] + dh * (2.0 * load[i] - rhs[i])
        tg[0] += dh * first_b
        tg[n - 1] += dh * first_t
        _solve(inv, back, tg)
        for i in range(n):
            combo[i] = t[i] + tg[i]
        _conduct(diag, g, combo, rhs)
        for i in range(n):
            tn[i] = cap[i] * t[i] + h * (load[i] - _W * rhs[i])
        tn[0] += h * (_W * first_b + D * g[0] * ends[0, 2])
        tn[n - 1] += h * (_W * first_t + D * g[n] * ends[1, 2])
        _solve(inv, back, tn)
        if p > 0:
            for i in range(n):
                combo[i] = dh * (t[i] + tg[i])
                move[i] = t[i] - tg[i]
            bounds[0], bounds[1] = dh * (ends[0, 0] + ends[0, 1]), dh * (ends[1, 0] + ends[1, 1])
            _carry(w, dh, s, s, sg)
            _disturb(dw, busy, Stage(move, combo, bounds, 2.0 * dh), ambient, sg)
            for q in range(p):
                sg[q, 0] += 2.0 * dh * g[0] * d_boundary[0, q]
                sg[q, n - 1] += 2.0 * dh * g[n] * d_boundary[1, q]
            _solve_many(inv, back, sg)
            for i in range(n):
                combo[i] = h * (_W * (t[i] + tg[i]) + D * tn[i])
                move[i] = t[i] - tn[i]
            for end in range(2):
                bounds[end] = h * (_W * (ends[end, 0] + ends[end, 1]) + D * ends[end, 2])
            for q in range(p):
                for i in range(n):
                    s_before[q, i] = s[q, i] + sg[q, i]
            _carry(w, _W * h, s, s_before, sn)
            _disturb(dw, busy, Stage(move, combo, bounds, h), ambient, sn)
            for q in range(p):
                sn[q, 0] += h * g[0] * d_boundary[0, q]
                sn[q, n - 1] += h * g[n] * d_boundary[1, q]
            _solve_many(inv, back, sn)
            for q in range(p):
                for i in range(n):
                    s_before[q, i] = s[q, i]
                    s[q, i] = sn[q, i]
        for i in range(n):
            t_before[i] = t[i]
            t[i] = tn[i]
        _observe(record, state, k + 1)


# Elimination goes from both ends at once and meets in the middle cell: two chains of products instead of one
# twice as long. `inv` holds the inverse pivots, `back` what a cell passes on to its neighbour towards the middle.


@compiled(inner=True, fastmath=FAST)
def _factor(cap, diag, g, dh, inv, back):
    """Factor C + dh K by elimination without pivoting (diagonally dominant)."""
    n = inv.shape[0]
    mid = n // 2
    low, high = 0.0, 0.0
    for i in range(n - 1 - mid):
        j = n - 1 - i
        inv[i] = 1.0 / (cap[i] + dh * diag[i] - low * dh * g[i])
        inv[j] = 1.0 / (cap[j] + dh * diag[j] - high * dh * g[j + 1])
        low = dh * g[i + 1] * inv[i]
        high = dh * g[j] * inv[j]
        back[i] = low
        back[j] = high
    if n % 2 == 0:
        i = mid - 1
        inv[i] = 1.0 / (cap[i] + dh * diag[i] - low * dh * g[i])
        low = dh * g[mid] * inv[i]
        back[i] = low
    inv[mid] = 1.0 / (cap[mid] + dh * diag[mid] - low * dh * g[mid] - high * dh * g[mid + 1])


@compiled(inner=True, fastmath=FAST)
def _solve(inv, back, x):
    """Overwrite the right-hand side x (n) by the solution."""
    n = x.shape[0]
    mid = n // 2
    low, high = 0.0, 0.0
    for i in range(n - 1 - mid):
        j = n - 1 - i
        low += x[i]
        high += x[j]
        x[i] = low * inv[i]
        x[j] = high * inv[j]
        low *= back[i]
        high *= back[j]
    if n % 2 == 0:
        low += x[mid - 1]
        x[mid - 1] = low * inv[mid - 1]
        low *= back[mid - 1]
    low = (x[mid] + low + high) * inv[mid]
    x[mid] = low
    high = low
    if n % 2 == 0:
        low = x[mid - 1] + back[mid - 1] * low
        x[mid - 1] = low
    for i in range(n - 2 - mid, -1, -1):
        j = n - 1 - i
        low = x[i] + back[i] * low
        high = x[j] + back[j] * high
        x[i] = low
        x[j] = high


@compiled(inner=True, fastmath=FAST)
def _solve_many(inv, back, x):
    """Overwrite right-hand sides x (P, n), P a multiple of four, by the solutions.

    Four systems at a time: while one waits for its last product, the others use the unit.
    """
    p, n = x.shape
    mid = n // 2
    for q in range(0, p, 4):
        a, b, c, d = x[q], x[q + 1], x[q + 2], x[q + 3]
        la, lb, lc, ld = 0.0, 0.0, 0.0, 0.0
        ha, hb, hc, hd = 0.0, 0.0, 0.0, 0.0
        for i in range(n - 1 - mid):
            j = n - 1 - i
            f, u = inv[i], back[i]
            la, lb, lc, ld = a[i] + la, b[i] + lb, c[i] + lc, d[i] + ld
            a[i], b[i], c[i], d[i] = la * f, lb * f, lc * f, ld * f
            la, lb, lc, ld = la * u, lb * u, lc * u, ld * u
            f, u = inv[j], back[j]
            ha, hb, hc, hd = a[j] + ha, b[j] + hb, c[j] + hc, d[j] + hd
            a[j], b[j], c[j], d[j] = ha * f, hb * f, hc * f, hd * f
            ha, hb, hc, hd = ha * u, hb * u, hc * u, hd * u
        if n % 2 == 0:
            i = mid - 1
            f, u = inv[i], back[i]
            la, lb, lc, ld = a[i] + la, b[i] + lb, c[i] + lc, d[i] + ld
            a[i], b[i], c[i], d[i] = la * f, lb * f, lc * f, ld * f
            la, lb, lc, ld = la * u, lb * u, lc * u, ld * u
        f = inv[mid]
        la, lb, lc, ld = (
            (a[mid] + la + ha) * f,
            (b[mid] + lb + hb) * f,
            (c[mid] + lc + hc) * f,
            (d[mid] + ld + hd) * f,
        )
        a[mid], b[mid], c[mid], d[mid] = la, lb, lc, ld
        ha, hb, hc, hd = la, lb, lc, ld
        if n % 2 == 0:
            i = mid - 1
            u = back[i]
            la, lb, lc, ld = a[i] + u * la, b[i] + u * lb, c[i] + u * lc, d[i] + u * ld
            a[i], b[i], c[i], d[i] = la, lb, lc, ld
        for i in range(n - 2 - mid, -1, -1):
            j = n - 1 - i
            u = back[i]
            la, lb, lc, ld = a[i] + u * la, b[i] + u * lb, c[i] + u * lc, d[i] + u * ld
            a[i], b[i], c[i], d[i] = la, lb, lc, ld
            u = back[j]
            ha, hb, hc, hd = a[j] + u * ha, b[j] + u * hb, c[j] + u * hc, d[j] + u * hd
            a[j], b[j], c[j], d[j] = ha, hb, hc, hd


@compiled(inner=True, fastmath=FAST)
def _conduct(diag, g, t, out):
    """Write K T, without the boundaries' and ambient's own temperatures, into `out` (n)."""
    n = t.shape[0]
    out[0] = diag[0] * t[0]
    if n == 1:
        return
    out[0] -= g[1] * t[1]
    # shifted views instead of i - 1 and i + 1: an index that cannot be negative vectorises
    here, above, inner, d, g_low, g_high = t[1:], t[2:], out[1:], diag[1:], g[1:], g[2:]
    for i in range(n - 2):
        inner[i] = d[i] * here[i] - g_low[i] * t[i] - g_high[i] * above[i]
    out[n - 1] = diag[n - 1] * t[n - 1] - g[n - 1] * t[n - 2]


@compiled(inner=True, fastmath=FAST)
def _carry(w, hw, s, z, out):
    """Write C s - hw K z, of tangents (P, n), into `out`."""
    p, n = out.shape
    cap, diag, g = w[CAP], w[DIAG], w[G]
    c, d, g_low, g_high = cap[1:], diag[1:], g[1:], g[2:]
    for q in range(p):
        sq, zq, oq = s[q], z[q], out[q]
        oq[0] = cap[0] * sq[0] - hw * diag[0] * zq[0]
        if n == 1:
            continue
        oq[0] += hw * g[1] * zq[1]
        s_here, here, above, inner = sq[1:], zq[1:], zq[2:], oq[1:]
        for i in range(n - 2):
            inner[i] = c[i] * s_here[i] - hw * (d[i] * here[i] - g_low[i] * zq[i] - g_high[i] * above[i])
        oq[n - 1] = cap[n - 1] * sq[n - 1] - hw * (diag[n - 1] * zq[n - 1] - g[n - 1] * zq[n - 2])


@compiled(inner=True, fastmath=FAST)
def _disturb(dw, busy, stage, ambient, out):
    """Add what the changed coefficients do in a stage, in the `busy` cells."""
    p, n = out.shape
    move, combo, bounds, share, count = stage.move, stage.combo, stage.bounds, stage.share, busy.shape[0]
    outside = share * ambient
    for q in range(p):
        dcap, dg, dloss = dw[DCAP, q], dw[DG, q], dw[DLOSS, q]
        dsrc, dslope, oq = dw[DSRC, q], dw[DSLOPE, q], out[q]
        if count == n:
            for i in range(n):
                oq[i] += dcap[i] * move[i] + dloss[i] * (outside - combo[i]) + share * dsrc[i]
                oq[i] -= dslope[i] * combo[i]
            upper, below, inner = combo[1:], oq[1:], dg[1:]
            for i in range(n - 1):
                oq[i] += inner[i] * (upper[i] - combo[i])
            for i in range(n - 1):
                below[i] -= inner[i] * (upper[i] - combo[i])
            oq[0] += dg[0] * (bounds[0] - combo[0])
            oq[n - 1] += dg[n] * (bounds[1] - combo[n - 1])
            continue
        for b in range(count):
            i = busy[b]
            low = bounds[0] if i == 0 else combo[i - 1]
            high = bounds[1] if i == n - 1 else combo[i + 1]
            oq[i] += dcap[i] * move[i] + dloss[i] * (outside - combo[i]) + share * dsrc[i]
            oq[i] += dg[i] * (low - combo[i]) + dg[i + 1] * (high - combo[i]) - dslope[i] * combo[i]


@compiled(inner=True, fastmath=FAST)
def _convert(heat, state, co, work, h):
    """Advance the conversions by what the step's mean temperature made of them."""
    t, tn, s, sn = state.t_before, state.t, state.s_before, state.s
    rate, drate = co.rate, co.drate
    p, n = s.shape
    tg, sg = work.scratch[2], work.d_scratch[0]
    for r in range(rate.shape[0]):
        value, slope = rate[r, RATE], rate[r, RSLOPE]
        done, d_done = state.done[r], state.s_done[r]
        for i in range(n):
            done[i] += h * (value[i] + slope[i] * (_W * (t[i] + tg[i]) + D * tn[i]))
        if not any_of(heat[r]):
            continue
        for q in range(p):
            dvalue, dslope, dq = drate[r, RATE, q], drate[r, RSLOPE, q], d_done[q]
            for i in range(n):
                mean = _W * (t[i] + tg[i]) + D * tn[i]
                change = _W * (s[q, i] + sg[q, i]) + D * sn[q, i]
                dq[i] += h * (dvalue[i] + dslope[i] * mean + slope[i] * change)


@compiled(inner=True, fastmath=FAST)
def _observe(record, state, row):
    """Record weighted sums of cells, over each place's first to last cell with a weight."""
    places, out, d_out, t, s = record.places, record.out, record.d_out, state.t, state.s
    m, n = places.shape
    if record.fields.shape[0] > 0:
        for i in range(n):
            record.fields[row, i] = t[i]
    p = s.shape[0]
    for a in range(m):
        first, last = 0, n
        while first < n and places[a, first] == 0.0:
            first += 1
        while last > first and places[a, last - 1] == 0.0:
            last -= 1
        value = 0.0
        for i in range(first, last):
            value += places[a, i] * t[i]
        out[row, a] = value
        for q in range(p):
            value = 0.0
            for i in range(first, last):
                value += places[a, i] * s[q, i]
            d_out[q, row, a] = value


SETTLED_K = 1e-10
"""The search for a steady state ends when no temperature changes by more. [K]"""
UNSETTLED_K = 1e-6
"""It has failed if any still changes by more after `REST_ROUNDS`: rounding alone changes less. [K]"""
REST_ROUNDS = 100
"""At most; a start that is not steady by then is refused."""


class Held(NamedTuple):
    """Cells that keep their temperature while the others come to rest."""

    cells: NDArray[np.bool_]
    """(n)"""
    t: Array
    """(n). [°C]"""
    d_t: Array
    """(P, n)"""


@compiled()
def rest(stack, tan, drive, held, state):
    """Set the state to the steady temperatures in the first step's conditions.

    Returns -1, or the cell that is tied to nothing, or n if the search did not settle.
    """
    p, n = state.s.shape
    co = room(stack.heat.shape[0], p, n)
    w, dw = co.w, co.dw
    x, factors, outside = np.zeros(n), np.zeros((2, n)), np.zeros(2)
    _copy(held.t, held.d_t, state.t, state.s)
    for end in range(2):
        outside[end] = drive.boundary[0, end, 0] if stack.measured[end] else stack.flux[end, 2]
    change = 0.0
    for _ in range(REST_ROUNDS):
        _copy(state.t, state.s, w[STAR], dw[DSTAR])
        coefficients(stack, tan, drive, np.int64(0), state, co)
        g, loss, src = w[G], w[LOSS], w[SRC]
        for j in range(1, n):
            if held.cells[j - 1] != held.cells[j]:
                # the panel is not there yet: what touches it later rests without it
                g[j] = 0.0
                for q in range(p):
                    dw[DG, q, j] = 0.0
        untied = _rest_factor(w, held.cells, factors)
        if untied >= 0:
            return untied
        for i in range(n):
            x[i] = loss[i] * stack.ambient + src[i]
        x[0] += g[0] * outside[0]
        x[n - 1] += g[n] * outside[1]
        _rest_solve(factors, held.cells, held.t, x)
        change = 0.0
        for i in range(n):
            change = max(change, abs(x[i] - state.t[i]))
            state.t[i] = x[i]
        change = max(change, _rest_tangents(stack.ambient, outside, drive.d_boundary, held, factors, co, state))
        if change < SETTLED_K:
            break
    _copy(state.t, state.s, state.t_before, state.s_before)
    state.clock[0] = 0.0
    return -1 if change < UNSETTLED_K else n


@compiled(inner=True)
def _rest_tangents(ambient, outside, d_outside, held, factors, co, state):
    """Bring the tangents to rest; return a thousandth of the largest change."""
    p, n = state.s.shape
    g, dw, x, change = co.w[G], co.dw, np.zeros(n), 0.0
    for q in range(p):
        for i in range(n):
            below = outside[0] if i == 0 else state.t[i - 1]
            above = outside[1] if i == n - 1 else state.t[i + 1]
            t = state.t[i]
            x[i] = dw[DLOSS, q, i] * (ambient - t) + dw[DSRC, q, i] - dw[DSLOPE, q, i] * t
            x[i] += dw[DG, q, i] * (below - t) + dw[DG, q, i + 1] * (above - t)
        x[0] += g[0] * d_outside[0, q]
        x[n - 1] += g[n] * d_outside[1, q]
        _rest_solve(factors, held.cells, held.d_t[q], x)
        for i in range(n):
            change = max(change, 1e-3 * abs(x[i] - state.s[q, i]))
            state.s[q, i] = x[i]
    return change


@compiled(inner=True)
def _copy(t, s, t_out, s_out):
    """Copy temperatures (n) and their tangents (P, n)."""
    p, n = s.shape
    for i in range(n):
        t_out[i] = t[i]
    for q in range(p):
        for i in range(n):
            s_out[q, i] = s[q, i]


@compiled(inner=True)
def _rest_factor(w, held, factors):
    """Factor K into `factors` (2, n); return a cell that is tied to nothing, or -1. Held cells stand alone.

    The first row is what a cell passes on to the one above it, the second its inverse pivot. A cell's pivot is its
    conductance to the next and, in series with all below, to outside: no differences, so nothing cancels.
    """
    g, loss, slope, through, pivot = w[G], w[LOSS], w[SLOPE], factors[0], factors[1]
    n = pivot.shape[0]
    outside = 0.0
    for i in range(n):
        own = loss[i] + slope[i]
        if i == 0:
            own += g[0]
        if i == n - 1:
            own += g[n]
        up = g[i + 1] if i < n - 1 else 0.0
        outside = own + (outside * through[i - 1] if i > 0 else 0.0)
        if held[i]:
            outside, up = 1.0, 0.0
        if up + outside <= 0.0:
            return i
        pivot[i] = 1.0 / (up + outside)
        through[i] = up * pivot[i]
    return -1


@compiled(inner=True)
def _rest_solve(factors, held, given, x):
    """Solve K x = x in place; held cells get what is given."""
    through, pivot = factors[0], factors[1]
    n = x.shape[0]
    for i in range(n):
        if held[i]:
            x[i] = given[i]
        elif i > 0:
            x[i] += through[i - 1] * x[i - 1]
    x[n - 1] *= pivot[n - 1]
    for i in range(n - 2, -1, -1):
        x[i] = x[i] * pivot[i] + through[i] * x[i + 1]


@compiled()
def delay(h, y, dy, tau, dtau):
    """Filter outputs in place by a first-order lag of `tau` seconds, input linear over each step.

    `y` (steps + 1, m), `dy` (P, steps + 1, m), `dtau` (P): derivative of tau. The filter starts settled.
    """
    steps = h.shape[0]
    p, m = dy.shape[0], dy.shape[2]
    for a in range(m):
        before = y[0, a]
        d_before = dy[:, 0, a].copy()
        for step in range(steps):
            x = h[step] / tau
            e, r, dr = lag_weights(x)
            now = y[step + 1, a]
            old = y[step, a]
            y[step + 1, a] = old * e + before * (r - e) + now * (1.0 - r)
            dx = -x / tau
            slope = (-old * e + before * (dr + e) - now * dr) * dx
            for q in range(p):
                d_now = dy[q, step + 1, a]
                dy[q, step + 1, a] = (
                    dy[q, step, a] * e + d_before[q] * (r - e) + d_now * (1.0 - r) + slope * dtau[q]
                )
                d_before[q] = d_now
            before = now


@compiled(fastmath=FAST)
def weighted_rows(first, weights, y, out):
    """Weighted sums of four neighbouring rows of `y` (b, rows, c), starting at `first`, into (b, ., c)."""
    for b in range(out.shape[0]):
        for row in range(out.shape[1]):
            i = first[row]
            for c in range(out.shape[2]):
                out[b, row, c] = (
                    weights[row, 0] * y[b, i, c]
                    + weights[row, 1] * y[b, i + 1, c]
                    + weights[row, 2] * y[b, i + 2, c]
                    + weights[row, 3] * y[b, i + 3, c]
                )
