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
from numba import njit
from numpy.typing import NDArray

from softsensor.kernels_terms import (
    CAP,
    DCAP,
    DG,
    DIAG,
    DLOSS,
    DROWS,
    DSLOPE,
    DSRC,
    DSTAR,
    LOSS,
    RATE,
    ROWS,
    RSLOPE,
    SLOPE,
    SRC,
    STAR,
    G,
    coefficients,
    switched,
)

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_GAMMA = 2.0 - 2.0**0.5
_D = _GAMMA / 2.0
_W = 2.0**0.5 / 4.0
_FAST = {"contract", "reassoc", "nsz", "arcp"}


class Stack(NamedTuple):
    """All a step needs that does not change from step to step. SI units, °C, per unit area."""

    dx: Array
    """Cell widths (n). [m]"""
    k: Array
    """Conductivity at 20 °C (n), or the factor on its table. [W/mK]"""
    k_slope: Array
    """Relative change of conductivity with temperature (n). [1/K]"""
    k_table: Integers
    """Row of `table_x` that multiplies k, or -1 (n)."""
    c: Array
    """Volumetric heat capacity at 20 °C (n), or the factor on its table. [J/m³K]"""
    c_slope: Array
    c_table: Integers
    table_x: Array
    """Temperatures of property tables (tables, rows), padded by repeating the last row. [°C]"""
    table_y: Array
    exchange: Array
    """Volumetric exchange with ambient (n). [W/m³K]"""
    interface: Integers
    """The interface of each contact (m)."""
    contact: Array
    """By contact and state: coupling, lower face to air, upper face to air (m, 3, 3). [W/m²K]

    At an end that is not measured the face beyond is the boundary's surface: its value is the boundary's own.
    """
    parts: NDArray[np.bool_]
    """Whether the neighbours of a contact part while open (m)."""
    bare: NDArray[np.bool_]
    """Whether it is no contact but an end of the stack that air and radiation act on at once (m)."""
    emissivity: float
    """Effective emissivity between parted neighbours while open."""
    convection: float
    """Steam transport while closed, over cells where `wet` is set. [W/m³K]"""
    wet: NDArray[np.bool_]
    ambient: float
    """[°C]"""
    measured: NDArray[np.bool_]
    """Whether the bottom and top boundary are measured temperatures (2)."""
    flux: Array
    """By boundary that is not measured: absorbed flux, emissivity, surroundings (2, 3). [W/m², -, °C]"""
    heat: Array
    """Heat released by each conversion when complete (r, n); negative takes heat. [J/m³]"""
    law: Array
    """Rate of each conversion (r, 4): kind, a, b, c. Kind 0: a exp(-b/R (1/T - 1/c)), kind 1: softened
    ramp a (T - b)+ with width c. [1/s, J/mol, K | 1/sK, °C, K]"""


class Tangents(NamedTuple):
    """Derivatives of `Stack` fields with respect to the P parameters."""

    k: Array
    """(P, n)"""
    k_slope: Array
    c: Array
    c_slope: Array
    exchange: Array
    contact: Array
    """(m, 3, 3, P)"""
    emissivity: Array
    """(P)"""
    convection: Array
    flux: Array
    """Of the absorbed flux only (2, P)."""
    heat: Array
    """(r, P, n)"""
    law: Array
    """(r, 4, P)"""


class State(NamedTuple):
    """What one step takes to the next; `march` changes the arrays in place."""

    t: Array
    """Cell temperatures (n). [°C]"""
    t_before: Array
    """Those one step earlier (n)."""
    done: Array
    """Converted fraction of each conversion (r, n)."""
    s: Array
    """Tangents of `t` (P, n)."""
    s_before: Array
    s_done: Array
    """Tangents of `done` (r, P, n)."""
    clock: Array
    """Length of the last step (1), 0 before the first. [s]"""


class Drive(NamedTuple):
    """The outside of a whole step grid."""

    h: Array
    """Step lengths (steps). [s]"""
    weight: Array
    """Mean share of each state in the step (steps, 3)."""
    d_weight: Array
    """(steps, 3, P)"""
    factor: Array
    """Factor on the coupling of the closed contact, in the step's mean (steps, m)."""
    d_factor: Array
    """(steps, m, P)"""
    boundary: Array
    """Boundary temperature: mean over the step and change across it (steps, 2, 2). [°C, K]"""
    d_boundary: Array
    """(2, P): constant shift of each boundary temperature."""


@njit(cache=True, nogil=True)
def march(stack, tan, drive, state, places, nonlinear, out, d_out, fields):
    """Take all steps; write the outputs ``places @ T`` (and tangents) before the first and after each.

    `out` (steps + 1, m), `d_out` (P, steps + 1, m); `fields` (steps + 1, n) is filled if it has rows.
    """
    p, n = state.s.shape
    r = stack.heat.shape[0]
    # empty where the first step fills everything: most calls of the live sensor are for one step
    w, dw = np.zeros((ROWS, n + 1)), np.empty((DROWS, p, n + 1))
    rate, drate = np.zeros((r, 2, n)), np.zeros((r, 2, p, n))
    scratch, d_scratch = np.zeros((8, n)), np.empty((2, p, n))
    busy = np.zeros(n, np.int64)
    steps = drive.h.shape[0]
    step = np.int64(0)  # a plain 0 would be a type of its own, and all that takes it be compiled twice
    _observe(places, state.t, state.s, out, d_out, step)
    if fields.shape[0] > 0:
        for i in range(n):
            fields[0, i] = state.t[i]
    while step < steps:
        last = step + 1
        h = drive.h[step]
        if nonlinear or step == 0:
            _expect(state.t, state.t_before, state.s, state.s_before, state.clock[0], h, w, dw)
            coefficients(stack, tan, drive, step, h, state.done, state.s_done, w, dw, rate, drate)
        else:
            switched(stack, tan, drive, step, h, state.done, state.s_done, w, dw, rate, drate)
        count = n
        if not nonlinear:
            last = _same(drive.weight, drive.d_weight, drive.factor, drive.d_factor, step)
            count = _touched(dw, busy)
        _advance(
            drive.h, drive.boundary, drive.d_boundary, stack.measured, stack.flux, stack.ambient, step, last,
            w, dw, scratch, d_scratch, busy, count, state.t, state.t_before, state.s, state.s_before,
            places, out, d_out, fields,
        )  # fmt: skip
        if r > 0:
            _convert(state.t_before, scratch, state.t, state.s_before, d_scratch, state.s, rate, drate, h, state)
        state.clock[0] = drive.h[last - 1]
        step = last


@njit(cache=True)
def _same(weight, d_weight, factor, d_factor, step):
    """Return the first later step whose contacts differ from those of `step`."""
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


@njit(cache=True)
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


@njit(cache=True, fastmath=_FAST)
def _expect(t, t_before, s, s_before, before, h, w, dw):
    """Temperatures expected in the middle of the step, and their tangents."""
    p, n = s.shape
    ratio = min(0.5 * h / before, 1.0) if before > 0.0 else 0.0
    star, dstar = w[STAR], dw[DSTAR]
    for i in range(n):
        star[i] = t[i] + ratio * (t[i] - t_before[i])
    for q in range(p):
        for i in range(n):
            dstar[q, i] = s[q, i] + ratio * (s[q, i] - s_before[q, i])


@njit(cache=True, fastmath=_FAST)
def _advance(
    lengths, boundary, d_boundary, measured, flux, ambient, step, last,
    w, dw, scratch, d_scratch, busy, count, t, t_before, s, s_before,
    places, out, d_out, fields,
):  # fmt: skip
    """Take the steps from `step` up to `last` with the same coefficients."""
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
        h = lengths[k]
        dh = _D * h
        if h != before:
            before = h
            _factor(cap, diag, g, dh, inv, back)
        for end in range(2):
            for stage in range(3):
                at = 0.0 if stage == 0 else (_GAMMA if stage == 1 else 1.0)
                ends[end, stage] = (
                    boundary[k, end, 0] + (at - 0.5) * boundary[k, end, 1] if measured[end] else flux[end, 2]
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
        tn[0] += h * (_W * first_b + _D * g[0] * ends[0, 2])
        tn[n - 1] += h * (_W * first_t + _D * g[n] * ends[1, 2])
        _solve(inv, back, tn)
        if p > 0:
            for i in range(n):
                combo[i] = dh * (t[i] + tg[i])
                move[i] = t[i] - tg[i]
            bounds[0], bounds[1] = dh * (ends[0, 0] + ends[0, 1]), dh * (ends[1, 0] + ends[1, 1])
            _carry(cap, diag, g, dh, s, s, sg)
            _disturb(dw, busy, count, move, combo, bounds, 2.0 * dh, ambient, sg)
            for q in range(p):
                sg[q, 0] += 2.0 * dh * g[0] * d_boundary[0, q]
                sg[q, n - 1] += 2.0 * dh * g[n] * d_boundary[1, q]
            _solve_many(inv, back, sg)
            for i in range(n):
                combo[i] = h * (_W * (t[i] + tg[i]) + _D * tn[i])
                move[i] = t[i] - tn[i]
            for end in range(2):
                bounds[end] = h * (_W * (ends[end, 0] + ends[end, 1]) + _D * ends[end, 2])
            for q in range(p):
                for i in range(n):
                    s_before[q, i] = s[q, i] + sg[q, i]
            _carry(cap, diag, g, _W * h, s, s_before, sn)
            _disturb(dw, busy, count, move, combo, bounds, h, ambient, sn)
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
        _observe(places, t, s, out, d_out, k + 1)
        if fields.shape[0] > 0:
            for i in range(n):
                fields[k + 1, i] = t[i]


# Elimination goes from both ends at once and meets in the middle cell: two chains of products instead of one
# twice as long. `inv` holds the inverse pivots, `back` what a cell passes on to its neighbour towards the middle.


@njit(cache=True, fastmath=_FAST)
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


@njit(cache=True, fastmath=_FAST)
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


@njit(cache=True, fastmath=_FAST)
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


@njit(cache=True, fastmath=_FAST)
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


@njit(cache=True, fastmath=_FAST)
def _carry(cap, diag, g, hw, s, z, out):
    """Write C s - hw K z, of tangents (P, n), into `out`."""
    p, n = out.shape
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


@njit(cache=True, fastmath=_FAST)
def _disturb(dw, busy, count, move, combo, bounds, share, ambient, out):
    """Add what the changed coefficients do in a stage.

    `move` (n): start minus result, which a changed heat capacity acts on. `combo` (n), `bounds` (2):
    step times the stage's weighted temperatures. `share`: the step times the stage's share.
    """
    p, n = out.shape
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


@njit(cache=True, fastmath=_FAST)
def _convert(t, scratch, tn, s, d_scratch, sn, rate, drate, h, state):
    """Advance the conversions by what the step's mean temperature made of them."""
    p, n = s.shape
    tg, sg = scratch[2], d_scratch[0]
    for r in range(rate.shape[0]):
        value, slope = rate[r, RATE], rate[r, RSLOPE]
        done, d_done = state.done[r], state.s_done[r]
        for i in range(n):
            done[i] += h * (value[i] + slope[i] * (_W * (t[i] + tg[i]) + _D * tn[i]))
        for q in range(p):
            dvalue, dslope, dq = drate[r, RATE, q], drate[r, RSLOPE, q], d_done[q]
            for i in range(n):
                mean = _W * (t[i] + tg[i]) + _D * tn[i]
                change = _W * (s[q, i] + sg[q, i]) + _D * sn[q, i]
                dq[i] += h * (dvalue[i] + dslope[i] * mean + slope[i] * change)


@njit(cache=True, fastmath=_FAST)
def _observe(places, t, s, out, d_out, row):
    """Weighted sums of cells, over each place's first to last cell with a weight."""
    m, n = places.shape
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


@njit(cache=True)
def rest(stack, tan, drive, held, held_t, d_held, state):
    """Set the state to the steady temperatures in the first step's conditions; held cells keep theirs.

    `held` (n) marks cells with a given temperature `held_t` and its tangents `d_held` (P, n).
    Returns -1, or the cell that is tied to nothing, or n if the search did not settle.
    """
    p, n = state.s.shape
    r = stack.heat.shape[0]
    w, dw = np.zeros((ROWS, n + 1)), np.zeros((DROWS, p, n + 1))
    rate, drate = np.zeros((r, 2, n)), np.zeros((r, 2, p, n))
    x, through, pivot = np.zeros(n), np.zeros(n), np.zeros(n)
    first = np.int64(0)
    _copy(held_t, d_held, state.t, state.s)
    low = drive.boundary[0, 0, 0] if stack.measured[0] else stack.flux[0, 2]
    top = drive.boundary[0, 1, 0] if stack.measured[1] else stack.flux[1, 2]
    change = 0.0
    for _ in range(REST_ROUNDS):
        _copy(state.t, state.s, w[STAR], dw[DSTAR])
        coefficients(stack, tan, drive, first, 1.0, state.done, state.s_done, w, dw, rate, drate)
        g, loss, src = w[G], w[LOSS], w[SRC]
        for j in range(1, n):
            if held[j - 1] != held[j]:
                # the panel is not there yet: what touches it later rests without it
                g[j] = 0.0
                for q in range(p):
                    dw[DG, q, j] = 0.0
        untied = _rest_factor(g, loss, w[SLOPE], held, through, pivot)
        if untied >= 0:
            return untied
        for i in range(n):
            x[i] = loss[i] * stack.ambient + src[i]
        x[0] += g[0] * low
        x[n - 1] += g[n] * top
        _rest_solve(through, pivot, held, held_t, x)
        change = 0.0
        for i in range(n):
            change = max(change, abs(x[i] - state.t[i]))
            state.t[i] = x[i]
        for q in range(p):
            for i in range(n):
                below = low if i == 0 else state.t[i - 1]
                above = top if i == n - 1 else state.t[i + 1]
                t = state.t[i]
                x[i] = dw[DLOSS, q, i] * (stack.ambient - t) + dw[DSRC, q, i] - dw[DSLOPE, q, i] * t
                x[i] += dw[DG, q, i] * (below - t) + dw[DG, q, i + 1] * (above - t)
            x[0] += g[0] * drive.d_boundary[0, q]
            x[n - 1] += g[n] * drive.d_boundary[1, q]
            _rest_solve(through, pivot, held, d_held[q], x)
            for i in range(n):
                change = max(change, 1e-3 * abs(x[i] - state.s[q, i]))
                state.s[q, i] = x[i]
        if change < SETTLED_K:
            break
    _copy(state.t, state.s, state.t_before, state.s_before)
    state.clock[0] = 0.0
    return -1 if change < UNSETTLED_K else n


@njit(cache=True)
def _copy(t, s, t_out, s_out):
    """Copy temperatures (n) and their tangents (P, n)."""
    p, n = s.shape
    for i in range(n):
        t_out[i] = t[i]
    for q in range(p):
        for i in range(n):
            s_out[q, i] = s[q, i]


@njit(cache=True)
def _rest_factor(g, loss, slope, held, through, pivot):
    """Factor K; return a cell that is tied to nothing, or -1. Held cells stand alone.

    `through` is what a cell passes on to the one above it, `pivot` its inverse pivot. A cell's pivot is its
    conductance to the next and, in series with all below, to outside: no differences, so nothing cancels.
    """
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


@njit(cache=True)
def _rest_solve(through, pivot, held, given, x):
    """Solve K x = x in place; held cells get what is given."""
    n = x.shape[0]
    for i in range(n):
        if held[i]:
            x[i] = given[i]
        elif i > 0:
            x[i] += through[i - 1] * x[i - 1]
    x[n - 1] *= pivot[n - 1]
    for i in range(n - 2, -1, -1):
        x[i] = x[i] * pivot[i] + through[i] * x[i + 1]


@njit(cache=True)
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
            e = np.exp(-x)
            r = (1.0 - e) / x if x > 1e-8 else 1.0 - 0.5 * x
            dr = (e * (1.0 + x) - 1.0) / (x * x) if x > 1e-4 else -0.5 + x / 3.0
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


@njit(cache=True, fastmath=_FAST)
def gather(first, weights, y, out):
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
