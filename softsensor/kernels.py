"""The compiled loops: one implicit time step of a layered stack with its forward tangents.

Everything here works on plain arrays. A stack of ``n`` cells (bottom to top) obeys, cell by cell,

    C dT/dt = sum of G (T_neighbour - T) + sinks (T_ambient - T) + sources            [W/m²]

and one step is TR-BDF2 (Bank et al. 1985; Hosea & Shampine 1996): L-stable, second order, both stages
with the same tridiagonal matrix. What depends on temperature is taken at the temperature
extrapolated to the middle of the step, so a step is linear and its tangents are exact derivatives
of the step itself. The evaporation-like sources, the only stiff ones, enter with their slope.

Index conventions: cells ``i = 0..n-1``; interfaces ``j = 0..n``, interface j lies below cell j.
States are 0 idle, 1 open, 2 closed. The last axis of a tangent array runs over the parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_GAMMA = 2.0 - 2.0**0.5
_D = _GAMMA / 2.0
_W = 2.0**0.5 / 4.0
_SIGMA = 5.670374419e-8
_GAS = 8.31446261815324
_ZERO_C = 273.15


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
    """By contact and state: coupling, lower face to air, upper face to air (m, 3, 3). [W/m²K]"""
    parts: NDArray[np.bool_]
    """Whether the neighbours of a contact part while open (m)."""
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
    """Derivatives of `Stack` fields with respect to the parameters (last axis)."""

    k: Array
    k_slope: Array
    c: Array
    c_slope: Array
    exchange: Array
    contact: Array
    emissivity: Array
    convection: Array
    flux: Array
    """Of the absorbed flux only (2, P)."""
    heat: Array
    law: Array
    """(r, 4, P)"""


class State(NamedTuple):
    """What one step takes to the next; the step changes the arrays in place."""

    t: Array
    """Cell temperatures (n). [°C]"""
    t_before: Array
    """Those one step earlier (n)."""
    done: Array
    """Converted fraction of each conversion (r, n)."""
    s: Array
    """Tangents of `t` (n, P)."""
    s_before: Array
    s_done: Array
    """Tangents of `done` (r, n, P)."""
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


class Work(NamedTuple):
    """Scratch arrays, allocated once."""

    g: Array
    low: Array
    up: Array
    dg: Array
    dlow: Array
    dup: Array
    diag: Array
    rhs: Array
    cap: Array
    dcap: Array
    src: Array
    dsrc: Array
    slope: Array
    dslope: Array
    fac: Array
    inv: Array
    tg: Array
    tn: Array
    sg: Array
    sn: Array
    star: Array
    sstar: Array
    cond: Array
    dcond: Array
    rate: Array
    drate: Array
    rslope: Array
    moved: Array


@njit(cache=True)
def make_work(n, p, r):
    """Return scratch space for n cells, p parameters, r conversions."""
    z = np.zeros
    return Work(
        z(n + 1), z(n + 1), z(n + 1), z((n + 1, p)), z((n + 1, p)), z((n + 1, p)),
        z(n), z(n), z(n), z((n, p)), z(n), z((n, p)), z(n), z((n, p)), z(n), z(n),
        z(n), z(n), z((n, p)), z((n, p)), z(n), z((n, p)), z(n), z((n, p)),
        z((r, n)), z((r, n, p)), z((r, n)), z(n),
    )  # fmt: skip


@njit(cache=True)
def _table(x, y, t):
    """Interpolate a table at t, constant beyond its ends; return value and slope."""
    last = x.shape[0] - 1
    if t <= x[0]:
        return y[0], 0.0
    if t >= x[last]:
        return y[last], 0.0
    j = np.searchsorted(x, t) - 1
    slope = (y[j + 1] - y[j]) / (x[j + 1] - x[j])
    return y[j] + slope * (t - x[j]), slope


@njit(cache=True)
def _rate(law, t):
    """Return a conversion's rate [1/s], its slope in T, and its derivatives in a, b, c."""
    a, b, c = law[1], law[2], law[3]
    if law[0] == 0.0:
        kelvin = t + _ZERO_C
        inverse = 1.0 / kelvin - 1.0 / c
        value = a * np.exp(-b / _GAS * inverse)
        return (
            value,
            value * b / _GAS / kelvin**2,
            value / a,
            -value * inverse / _GAS,
            -value * b / _GAS / c**2,
        )
    x = (t - b) / c
    if x > 30.0:
        soft, step = x, 1.0
    elif x < -30.0:
        soft, step = 0.0, 0.0
    else:
        soft, step = np.log1p(np.exp(x)), 1.0 / (1.0 + np.exp(-x))
    return a * c * soft, a * step, c * soft, -a * step, a * (soft - x * step)


@njit(cache=True)
def _properties(stack, tan, work, nonlinear):
    """Fill conductivity and heat capacity per cell (and their tangents) at the temperatures `star`."""
    n, p = work.dcap.shape
    for i in range(n):
        t = work.star[i]
        lift = 1.0 + stack.k_slope[i] * (t - 20.0)
        value, slope = 1.0, 0.0
        if stack.k_table[i] >= 0:
            value, slope = _table(stack.table_x[stack.k_table[i]], stack.table_y[stack.k_table[i]], t)
        floor = 0.05
        if lift < floor:
            work.cond[i] = stack.k[i] * floor * value
            dk_dt = stack.k[i] * floor * slope
        else:
            work.cond[i] = stack.k[i] * lift * value
            dk_dt = stack.k[i] * (stack.k_slope[i] * value + lift * slope)
        for q in range(p):
            work.dcond[i, q] = tan.k[i, q] * lift * value + stack.k[i] * tan.k_slope[i, q] * (t - 20.0) * value
            if nonlinear:
                work.dcond[i, q] += dk_dt * work.sstar[i, q]
        lift = 1.0 + stack.c_slope[i] * (t - 20.0)
        value, slope = 1.0, 0.0
        if stack.c_table[i] >= 0:
            value, slope = _table(stack.table_x[stack.c_table[i]], stack.table_y[stack.c_table[i]], t)
        if lift < floor:
            work.cap[i] = stack.dx[i] * stack.c[i] * floor * value
            dc_dt = stack.c[i] * floor * slope
        else:
            work.cap[i] = stack.dx[i] * stack.c[i] * lift * value
            dc_dt = stack.c[i] * (stack.c_slope[i] * value + lift * slope)
        for q in range(p):
            work.dcap[i, q] = stack.dx[i] * (
                tan.c[i, q] * lift * value + stack.c[i] * tan.c_slope[i, q] * (t - 20.0) * value
            )
            if nonlinear:
                work.dcap[i, q] += stack.dx[i] * dc_dt * work.sstar[i, q]


@njit(cache=True)
def _joints(stack, work):
    """Conductance of the interfaces inside layers and of perfect joints, with tangents."""
    n, p = work.dcap.shape
    for j in range(n + 1):
        work.low[j] = 0.0
        work.up[j] = 0.0
        work.g[j] = 0.0
        for q in range(p):
            work.dg[j, q] = 0.0
            work.dlow[j, q] = 0.0
            work.dup[j, q] = 0.0
    for j in range(1, n):
        a = 2.0 * work.cond[j - 1] / stack.dx[j - 1]
        b = 2.0 * work.cond[j] / stack.dx[j]
        g = a * b / (a + b)
        work.g[j] = g
        fa = (g / a) ** 2 * 2.0 / stack.dx[j - 1]
        fb = (g / b) ** 2 * 2.0 / stack.dx[j]
        for q in range(p):
            work.dg[j, q] = fa * work.dcond[j - 1, q] + fb * work.dcond[j, q]
    if stack.measured[0]:
        work.g[0] = 2.0 * work.cond[0] / stack.dx[0]
        for q in range(p):
            work.dg[0, q] = 2.0 * work.dcond[0, q] / stack.dx[0]
    if stack.measured[1]:
        work.g[n] = 2.0 * work.cond[n - 1] / stack.dx[n - 1]
        for q in range(p):
            work.dg[n, q] = 2.0 * work.dcond[n - 1, q] / stack.dx[n - 1]


@njit(cache=True)
def _contact_values(stack, tan, drive, step, m, h, dh):
    """Mix a contact's three values by the step's shares of the states; fill h (3) and dh (3, P)."""
    p = dh.shape[1]
    for v in range(3):
        h[v] = 0.0
        for q in range(p):
            dh[v, q] = 0.0
        for s in range(3):
            f = drive.factor[step, m] if (s == 2 and v == 0) else 1.0
            w = drive.weight[step, s]
            h[v] += w * stack.contact[m, s, v] * f
            for q in range(p):
                dh[v, q] += (
                    w * f * tan.contact[m, s, v, q] + drive.d_weight[step, s, q] * f * stack.contact[m, s, v]
                )
                if s == 2 and v == 0:
                    dh[v, q] += w * stack.contact[m, s, v] * drive.d_factor[step, m, q]


@njit(cache=True)
def _gap_radiation(stack, tan, drive, step, j, work, h, dh):
    """Add the radiation between parted faces to the coupling h[0]."""
    p = dh.shape[1]
    w = drive.weight[step, 1]
    a = work.star[j - 1] + _ZERO_C
    b = work.star[j] + _ZERO_C
    shape = _SIGMA * (a * a + b * b) * (a + b)
    h[0] += w * stack.emissivity * shape
    d_a = _SIGMA * (3 * a * a + 2 * a * b + b * b)
    d_b = _SIGMA * (3 * b * b + 2 * a * b + a * a)
    for q in range(p):
        dh[0, q] += (
            w * tan.emissivity[q] * shape
            + drive.d_weight[step, 1, q] * stack.emissivity * shape
            + w * stack.emissivity * (d_a * work.sstar[j - 1, q] + d_b * work.sstar[j, q])
        )


@njit(cache=True)
def _faces(gl, gu, h):
    """Eliminate the two faces of a contact: coupling, loss of the lower cell, loss of the upper cell."""
    lower = gl + h[0] + h[1]
    upper = gu + h[0] + h[2]
    det = lower * upper - h[0] * h[0]
    return (
        gl * h[0] * gu / det,
        gl * (h[1] * upper + h[0] * h[2]) / det,
        gu * (h[2] * lower + h[0] * h[1]) / det,
    )


@njit(cache=True)
def _contacts(stack, tan, drive, step, work, h, dh):
    """Replace the joints that are contacts by coupling and losses to air, with tangents."""
    n, p = work.dcap.shape
    for m in range(stack.interface.shape[0]):
        j = stack.interface[m]
        _contact_values(stack, tan, drive, step, m, h, dh)
        if j == 0 or j == n:
            _end(stack, work, j, h, dh)
            continue
        if stack.parts[m] and (stack.emissivity != 0.0 or tan.emissivity.any()):
            _gap_radiation(stack, tan, drive, step, j, work, h, dh)
        gl = 2.0 * work.cond[j - 1] / stack.dx[j - 1]
        gu = 2.0 * work.cond[j] / stack.dx[j]
        lower = gl + h[0] + h[1]
        upper = gu + h[0] + h[2]
        det = lower * upper - h[0] * h[0]
        g, low, up = _faces(gl, gu, h)
        work.g[j] = g
        work.low[j] = low
        work.up[j] = up
        for q in range(p):
            dgl = 2.0 * work.dcond[j - 1, q] / stack.dx[j - 1]
            dgu = 2.0 * work.dcond[j, q] / stack.dx[j]
            dlower = dgl + dh[0, q] + dh[1, q]
            dupper = dgu + dh[0, q] + dh[2, q]
            ddet = dlower * upper + lower * dupper - 2.0 * h[0] * dh[0, q]
            work.dg[j, q] = (dgl * h[0] * gu + gl * dh[0, q] * gu + gl * h[0] * dgu - g * ddet) / det
            work.dlow[j, q] = (
                dgl * (h[1] * upper + h[0] * h[2])
                + gl * (dh[1, q] * upper + h[1] * dupper + dh[0, q] * h[2] + h[0] * dh[2, q])
                - low * ddet
            ) / det
            work.dup[j, q] = (
                dgu * (h[2] * lower + h[0] * h[1])
                + gu * (dh[2, q] * lower + h[2] * dlower + dh[0, q] * h[1] + h[0] * dh[1, q])
                - up * ddet
            ) / det


@njit(cache=True)
def _end(stack, work, j, h, dh):
    """A boundary with a coefficient: in series with half a cell to the boundary's temperature."""
    p = dh.shape[1]
    n = work.cap.shape[0]
    i = 0 if j == 0 else n - 1
    end = 0 if j == 0 else 1
    a, kelvin = h[0], 0.0
    if not stack.measured[end] and stack.flux[end, 1] > 0.0:
        x = work.star[i] + _ZERO_C
        y = stack.flux[end, 2] + _ZERO_C
        a += stack.flux[end, 1] * _SIGMA * (x * x + y * y) * (x + y)
        kelvin = stack.flux[end, 1] * _SIGMA * (3 * x * x + 2 * x * y + y * y)
    g = 2.0 * work.cond[i] / stack.dx[i]
    value = a * g / (a + g) if a + g > 0.0 else 0.0
    work.g[j] = value
    for q in range(p):
        da = dh[0, q] + kelvin * work.sstar[i, q]
        dcell = 2.0 * work.dcond[i, q] / stack.dx[i]
        work.dg[j, q] = (g * g * da + a * a * dcell) / (a + g) ** 2


@njit(cache=True)
def _sources(stack, tan, drive, step, state, work):
    """Fill sources [W/m²] at `star`, their slope in temperature, and the tangents of both."""
    n, p = work.dcap.shape
    src, slope, dsrc, dslope, dx = work.src, work.slope, work.dsrc, work.dslope, stack.dx
    exchange, d_exchange, ambient = stack.exchange, tan.exchange, stack.ambient
    for i in range(n):
        src[i] = exchange[i] * dx[i] * ambient
        slope[i] = exchange[i] * dx[i]
        for q in range(p):
            dsrc[i, q] = d_exchange[i, q] * dx[i] * ambient
            dslope[i, q] = d_exchange[i, q] * dx[i]
    for end in range(2):
        if not stack.measured[end]:
            _absorbed(stack, tan, work, end)
    for r in range(stack.heat.shape[0]):
        _conversion(stack, tan, state, work, r)
    if stack.convection != 0.0 or tan.convection.any():
        _steam(stack, tan, drive, step, work)


@njit(cache=True)
def _absorbed(stack, tan, work, end):
    """Put a boundary's absorbed flux into the outermost cell, less what the face gives back at once."""
    n, p = work.dcap.shape
    i = 0 if end == 0 else n - 1
    j = 0 if end == 0 else n
    g = 2.0 * work.cond[i] / stack.dx[i]
    share = 1.0 - work.g[j] / g
    work.src[i] += stack.flux[end, 0] * share
    for q in range(p):
        dg = 2.0 * work.dcond[i, q] / stack.dx[i]
        dshare = -work.dg[j, q] / g + work.g[j] / (g * g) * dg
        work.dsrc[i, q] += tan.flux[end, q] * share + stack.flux[end, 0] * dshare


@njit(cache=True)
def _conversion(stack, tan, state, work, r):
    """Add the heat of one conversion: Q (1 - done) rate(T), linear in T about `star`."""
    n, p = work.dcap.shape
    for i in range(n):
        heat = stack.heat[r, i] * stack.dx[i]
        active = False
        for q in range(p):
            if tan.heat[r, i, q] != 0.0:
                active = True
        work.rate[r, i] = 0.0
        work.rslope[r, i] = 0.0
        for q in range(p):
            work.drate[r, i, q] = 0.0
        if heat == 0.0 and not active:
            continue
        t = work.star[i]
        value, slope, da, db, dc = _rate(stack.law[r], t)
        left = 1.0 - state.done[r, i]
        true_slope = slope
        if slope < 0.0 or heat > 0.0:
            slope = 0.0
        # rate of conversion = left (value + slope (T - star)); work.rate is its part without T
        work.rate[r, i] = left * (value - slope * t)
        work.rslope[r, i] = left * slope
        work.src[i] += heat * work.rate[r, i]
        work.slope[i] -= heat * work.rslope[r, i]
        second = _rate_slope_change(stack.law[r], t)
        for q in range(p):
            st = work.sstar[i, q]
            dl = -state.s_done[r, i, q]
            dvalue = da * tan.law[r, 1, q] + db * tan.law[r, 2, q] + dc * tan.law[r, 3, q] + true_slope * st
            dslope = 0.0
            if slope != 0.0:
                dslope = (
                    second[0] * st
                    + second[1] * tan.law[r, 1, q]
                    + second[2] * tan.law[r, 2, q]
                    + second[3] * tan.law[r, 3, q]
                )
            drate = dl * (value - slope * t) + left * (dvalue - dslope * t - slope * st)
            drslope = dl * slope + left * dslope
            work.drate[r, i, q] = drate
            dheat = tan.heat[r, i, q] * stack.dx[i]
            work.dsrc[i, q] += dheat * work.rate[r, i] + heat * drate
            work.dslope[i, q] -= dheat * work.rslope[r, i] + heat * drslope


@njit(cache=True)
def _rate_slope_change(law, t):
    """Derivatives of a rate's slope in T, a, b, c."""
    a, b, c = law[1], law[2], law[3]
    if law[0] == 0.0:
        kelvin = t + _ZERO_C
        inverse = 1.0 / kelvin - 1.0 / c
        value = a * np.exp(-b / _GAS * inverse)
        f = b / _GAS / kelvin**2
        return (
            value * f * (f - 2.0 / kelvin),
            value * f / a,
            value * f * (1.0 / b - inverse / _GAS),
            -value * b / _GAS / c**2 * f,
        )
    x = (t - b) / c
    if x >= 30.0:
        return 0.0, 1.0, 0.0, 0.0
    if x <= -30.0:
        return 0.0, 0.0, 0.0, 0.0
    step = 1.0 / (1.0 + np.exp(-x))
    bend = step * (1.0 - step)
    return a * bend / c, step, -a * bend / c, -a * bend * x / c


@njit(cache=True)
def _steam(stack, tan, drive, step, work):
    """Steam leaves cells above 100 °C and condenses in cooler ones in proportion to 100 °C - T."""
    n, p = work.dcap.shape
    w = drive.weight[step, 2]
    hot = 0.0
    cold = 0.0
    for i in range(n):
        if stack.wet[i]:
            over = work.star[i] - 100.0
            if over > 0.0:
                hot += over * stack.dx[i]
            else:
                cold -= over * stack.dx[i]
    if hot <= 0.0 or cold <= 1e-9:
        return
    ratio = hot / cold
    for q in range(p):
        dhot = 0.0
        dcold = 0.0
        for i in range(n):
            if stack.wet[i]:
                if work.star[i] > 100.0:
                    dhot += work.sstar[i, q] * stack.dx[i]
                else:
                    dcold -= work.sstar[i, q] * stack.dx[i]
        dratio = dhot / cold - ratio * dcold / cold
        f = w * stack.convection
        df = w * tan.convection[q] + drive.d_weight[step, 2, q] * stack.convection
        for i in range(n):
            if stack.wet[i]:
                over = work.star[i] - 100.0
                if over > 0.0:
                    work.dsrc[i, q] -= stack.dx[i] * (df * over + f * work.sstar[i, q])
                else:
                    work.dsrc[i, q] -= stack.dx[i] * (
                        df * over * ratio + f * (work.sstar[i, q] * ratio + over * dratio)
                    )
    for i in range(n):
        if stack.wet[i]:
            over = work.star[i] - 100.0
            share = 1.0 if over > 0.0 else ratio
            work.src[i] -= w * stack.convection * stack.dx[i] * over * share


@njit(cache=True)
def _matrix(stack, work):
    """Collect the diagonal of K from joints, losses and slopes."""
    n = work.cap.shape[0]
    for i in range(n):
        work.diag[i] = work.g[i] + work.g[i + 1] + work.low[i + 1] + work.up[i] + work.slope[i]


@njit(cache=True)
def _factor(work, dh):
    """Factor C + dh K by elimination without pivoting (diagonally dominant)."""
    n = work.cap.shape[0]
    pivot = work.cap[0] + dh * work.diag[0]
    work.inv[0] = 1.0 / pivot
    for i in range(1, n):
        off = dh * work.g[i]
        work.fac[i] = off * work.inv[i - 1]
        work.inv[i] = 1.0 / (work.cap[i] + dh * work.diag[i] - work.fac[i] * off)


@njit(cache=True)
def _solve(work, dh, x):
    """Overwrite the right-hand side x (n) by the solution."""
    n = x.shape[0]
    fac, inv, g = work.fac, work.inv, work.g
    for i in range(1, n):
        x[i] += fac[i] * x[i - 1]
    x[n - 1] *= inv[n - 1]
    for i in range(n - 2, -1, -1):
        x[i] = (x[i] + dh * g[i + 1] * x[i + 1]) * inv[i]


@njit(cache=True, fastmath=True)
def _solve_many(work, dh, x):
    """Overwrite the right-hand sides x (n, P) by the solutions."""
    n, p = x.shape
    fac, inv, wg = work.fac, work.inv, work.g
    for i in range(1, n):
        f = fac[i]
        for q in range(p):
            x[i, q] += f * x[i - 1, q]
    f = inv[n - 1]
    for q in range(p):
        x[n - 1, q] *= f
    for i in range(n - 2, -1, -1):
        f = inv[i]
        g = dh * wg[i + 1] * f
        for q in range(p):
            x[i, q] = x[i, q] * f + g * x[i + 1, q]


@njit(cache=True, fastmath=True)
def _apply(diag, g, t, out):
    """Write K T, without the boundaries' and ambient's own temperatures, into `out` (n)."""
    n = t.shape[0]
    for i in range(n):
        y = diag[i] * t[i]
        if i > 0:
            y -= g[i] * t[i - 1]
        if i < n - 1:
            y -= g[i + 1] * t[i + 1]
        out[i] = y


@njit(cache=True, fastmath=True)
def _stage_tangent(work, s, s_mid, d_boundary, moved, combo, bounds, ambient, hw, share, out):
    """Right-hand side of a stage's tangents, into `out` (n, P).

    Parameters
    ----------
    s, s_mid
        Tangents at the step's start and, in the second stage, in between (else zeros of no columns).
    moved
        Start minus result of the stage (n), which a changed heat capacity acts on.
    combo, bounds
        The step times the stage's weighted temperatures, of cells (n) and boundaries (2).
    hw, share
        Step times the weight of K s; step times the stage's share.
    """
    n, p = out.shape
    cap, dcap, diag, g, dg = work.cap, work.dcap, work.diag, work.g, work.dg
    dlow, dup, dsrc, dslope = work.dlow, work.dup, work.dsrc, work.dslope
    second = s_mid.shape[1] == p
    for i in range(n):
        outside = share * ambient - combo[i]
        below = bounds[0] if i == 0 else combo[i - 1]
        above = bounds[1] if i == n - 1 else combo[i + 1]
        below -= combo[i]
        above -= combo[i]
        c, d, move, here = cap[i] - hw * diag[i], hw * diag[i], moved[i], combo[i]
        left = hw * g[i] if i > 0 else 0.0
        right = hw * g[i + 1] if i < n - 1 else 0.0
        down, up = max(i - 1, 0), min(i + 1, n - 1)
        for q in range(p):
            out[i, q] = (
                c * s[i, q]
                + left * s[down, q]
                + right * s[up, q]
                + dcap[i, q] * move
                + (dlow[i + 1, q] + dup[i, q]) * outside
                + share * dsrc[i, q]
                - dslope[i, q] * here
                + dg[i, q] * below
                + dg[i + 1, q] * above
            )
        if second:
            for q in range(p):
                out[i, q] += left * s_mid[down, q] + right * s_mid[up, q] - d * s_mid[i, q]
    for q in range(p):
        out[0, q] += share * g[0] * d_boundary[0, q]
        out[n - 1, q] += share * g[n] * d_boundary[1, q]


@njit(cache=True)
def _outside(stack, drive, step, at):
    """Boundary temperatures at the fraction `at` of a step (2)."""
    low = stack.flux[0, 2]
    top = stack.flux[1, 2]
    if stack.measured[0]:
        low = drive.boundary[step, 0, 0] + (at - 0.5) * drive.boundary[step, 0, 1]
    if stack.measured[1]:
        top = drive.boundary[step, 1, 0] + (at - 0.5) * drive.boundary[step, 1, 1]
    return low, top


@njit(cache=True)
def _extrapolate(state, work, h, nonlinear):
    """Temperatures expected in the middle of the step, and their tangents."""
    n, p = work.sstar.shape
    ratio = 0.0
    if state.clock[0] > 0.0:
        ratio = min(0.5 * h / state.clock[0], 1.0)
    for i in range(n):
        work.star[i] = state.t[i] + ratio * (state.t[i] - state.t_before[i])
        if nonlinear:
            for q in range(p):
                work.sstar[i, q] = state.s[i, q] + ratio * (state.s[i, q] - state.s_before[i, q])


@njit(cache=True)
def _convert(stack, tan, state, work, h):
    """Advance the conversions by what the step really released, and their tangents."""
    n, p = work.dcap.shape
    for r in range(stack.heat.shape[0]):
        for i in range(n):
            if work.rate[r, i] == 0.0 and work.rslope[r, i] == 0.0:
                continue
            mean = _W * (state.t[i] + work.tg[i]) + _D * work.tn[i]
            change = h * (work.rate[r, i] + work.rslope[r, i] * mean)
            left = 1.0 - state.done[r, i]
            free = True
            if change < 0.0:
                change, free = 0.0, False
            if change > left:
                change, free = left, False
            for q in range(p):
                if free:
                    smean = _W * (state.s[i, q] + work.sg[i, q]) + _D * work.sn[i, q]
                    drslope = 0.0
                    if work.rslope[r, i] != 0.0 and stack.heat[r, i] != 0.0:
                        heat = stack.heat[r, i] * stack.dx[i]
                        drslope = (
                            -(
                                work.dslope[i, q]
                                - tan.exchange[i, q] * stack.dx[i]
                                + tan.heat[r, i, q] * stack.dx[i] * work.rslope[r, i]
                            )
                            / heat
                        )
                    state.s_done[r, i, q] += h * (work.drate[r, i, q] + drslope * mean + work.rslope[r, i] * smean)
                elif change > 0.0:
                    state.s_done[r, i, q] = 0.0
            state.done[r, i] += change


@njit(cache=True, fastmath=True)
def _temperatures(work, t, bottom, top, ambient, h):
    """Both stages of TR-BDF2: `tg` in between and `tn` at the end of the step."""
    n = t.shape[0]
    cap, g, low, up, src, rhs, tg, tn = work.cap, work.g, work.low, work.up, work.src, work.rhs, work.tg, work.tn
    first_b, first_t = g[0] * (bottom[0] + bottom[1]), g[n] * (top[0] + top[1])
    _apply(work.diag, g, t, rhs)
    for i in range(n):
        tg[i] = cap[i] * t[i] + _D * h * (2.0 * ((low[i + 1] + up[i]) * ambient + src[i]) - rhs[i])
    tg[0] += _D * h * first_b
    tg[n - 1] += _D * h * first_t
    _solve(work, _D * h, tg)
    for i in range(n):
        tn[i] = cap[i] * t[i] + h * ((low[i + 1] + up[i]) * ambient + src[i] - _W * rhs[i])
    _apply(work.diag, g, tg, rhs)
    for i in range(n):
        tn[i] -= h * _W * rhs[i]
    tn[0] += h * (_W * first_b + _D * g[0] * bottom[2])
    tn[n - 1] += h * (_W * first_t + _D * g[n] * top[2])
    _solve(work, _D * h, tn)


@njit(cache=True, fastmath=True)
def _tangents(work, t, s, d_boundary, bottom, top, ambient, h):
    """Both stages of the tangents: `sg` and `sn`."""
    n = t.shape[0]
    combo, moved, tg, tn = work.rhs, work.moved, work.tg, work.tn
    bounds = np.empty(2)
    none = np.empty((n, 0))
    for i in range(n):
        combo[i] = h * _D * (t[i] + tg[i])
        moved[i] = t[i] - tg[i]
    bounds[0] = h * _D * (bottom[0] + bottom[1])
    bounds[1] = h * _D * (top[0] + top[1])
    _stage_tangent(work, s, none, d_boundary, moved, combo, bounds, ambient, h * _D, h * _GAMMA, work.sg)
    _solve_many(work, _D * h, work.sg)
    for i in range(n):
        combo[i] = h * (_W * (t[i] + tg[i]) + _D * tn[i])
        moved[i] = t[i] - tn[i]
    bounds[0] = h * (_W * (bottom[0] + bottom[1]) + _D * bottom[2])
    bounds[1] = h * (_W * (top[0] + top[1]) + _D * top[2])
    _stage_tangent(work, s, work.sg, d_boundary, moved, combo, bounds, ambient, h * _W, h, work.sn)
    _solve_many(work, _D * h, work.sn)


@njit(cache=True)
def advance(stack, tan, drive, step, state, work, nonlinear, fresh):
    """Take one step in place. `fresh` forces new coefficients; else the last ones are kept."""
    n, p = work.sstar.shape
    h = drive.h[step]
    if nonlinear or fresh:
        _extrapolate(state, work, h, nonlinear)
        hh = np.empty(3)
        dhh = np.empty((3, p))
        _properties(stack, tan, work, nonlinear)
        _joints(stack, work)
        _contacts(stack, tan, drive, step, work, hh, dhh)
        _sources(stack, tan, drive, step, state, work)
        _matrix(stack, work)
        _factor(work, _D * h)
    bottom = np.empty(3)
    top = np.empty(3)
    for stage in range(3):
        at = 0.0 if stage == 0 else (_GAMMA if stage == 1 else 1.0)
        bottom[stage], top[stage] = _outside(stack, drive, step, at)
    _temperatures(work, state.t, bottom, top, stack.ambient, h)
    if p > 0:
        _tangents(work, state.t, state.s, drive.d_boundary, bottom, top, stack.ambient, h)
    if stack.heat.shape[0] > 0:
        _convert(stack, tan, state, work, h)
    for i in range(n):
        state.t_before[i] = state.t[i]
        state.t[i] = work.tn[i]
        for q in range(p):
            state.s_before[i, q] = state.s[i, q]
            state.s[i, q] = work.sn[i, q]
    state.clock[0] = h


@njit(cache=True, nogil=True)
def march(stack, tan, drive, state, places, nonlinear, out, d_out, fields):
    """Take all steps; write the outputs ``places @ T`` (and tangents) before the first and after each.

    `out` (steps + 1, m), `d_out` (steps + 1, m, P); `fields` (steps + 1, n) is filled if it has rows.
    """
    n, p = state.s.shape
    work = make_work(n, p, stack.heat.shape[0])
    steps = drive.h.shape[0]
    _observe(places, state, out, d_out, 0)
    keep = fields.shape[0] > 0
    if keep:
        fields[0] = state.t
    for step in range(steps):
        fresh = step == 0 or drive.h[step] != drive.h[step - 1]
        if not fresh:
            for s in range(3):
                if drive.weight[step, s] != drive.weight[step - 1, s]:
                    fresh = True
                for q in range(p):
                    if drive.d_weight[step, s, q] != drive.d_weight[step - 1, s, q]:
                        fresh = True
            for m in range(drive.factor.shape[1]):
                if drive.factor[step, m] != drive.factor[step - 1, m]:
                    fresh = True
        advance(stack, tan, drive, step, state, work, nonlinear, fresh)
        _observe(places, state, out, d_out, step + 1)
        if keep:
            fields[step + 1] = state.t


@njit(cache=True)
def _observe(places, state, out, d_out, row):
    """Weighted sums of cells, skipping zero weights."""
    m, n = places.shape
    p = state.s.shape[1]
    for a in range(m):
        value = 0.0
        for q in range(p):
            d_out[row, a, q] = 0.0
        for i in range(n):
            w = places[a, i]
            if w != 0.0:
                value += w * state.t[i]
                for q in range(p):
                    d_out[row, a, q] += w * state.s[i, q]
        out[row, a] = value


@njit(cache=True)
def rest(stack, tan, drive, held, held_t, d_held, state):
    """Set the state to the steady temperatures in the first step's conditions; held cells keep theirs.

    `held` (n) marks cells with a given temperature `held_t` and its tangents `d_held` (n, P).
    """
    n, p = state.s.shape
    work = make_work(n, p, stack.heat.shape[0])
    hh = np.empty(3)
    dhh = np.empty((3, p))
    state.t[:] = held_t
    state.s[:] = d_held
    for _ in range(12):
        work.star[:] = state.t
        work.sstar[:] = state.s
        _properties(stack, tan, work, True)
        _joints(stack, work)
        _contacts(stack, tan, drive, 0, work, hh, dhh)
        _sources(stack, tan, drive, 0, state, work)
        for i in range(n):
            work.slope[i] = stack.exchange[i] * stack.dx[i]
        _matrix(stack, work)
        low, top = _outside(stack, drive, 0, 0.0)
        for i in range(n):
            if held[i]:
                work.diag[i] = 1.0
                work.tn[i] = held_t[i]
                continue
            work.tn[i] = (work.low[i + 1] + work.up[i]) * stack.ambient + work.src[i]
            if i == 0:
                work.tn[i] += work.g[0] * low
            if i == n - 1:
                work.tn[i] += work.g[n] * top
        _rest_solve(work, held, work.tn)
        for q in range(p):
            for i in range(n):
                if held[i]:
                    work.rhs[i] = d_held[i, q]
                    continue
                v = (work.dlow[i + 1, q] + work.dup[i, q]) * (stack.ambient - work.tn[i])
                v += work.dsrc[i, q] - tan.exchange[i, q] * stack.dx[i] * work.tn[i]
                below = low if i == 0 else work.tn[i - 1]
                above = top if i == n - 1 else work.tn[i + 1]
                v += work.dg[i, q] * (below - work.tn[i]) + work.dg[i + 1, q] * (above - work.tn[i])
                if i == 0:
                    v += work.g[0] * drive.d_boundary[0, q]
                if i == n - 1:
                    v += work.g[n] * drive.d_boundary[1, q]
                work.rhs[i] = v
            _rest_solve(work, held, work.rhs)
            for i in range(n):
                state.s[i, q] = work.rhs[i]
        change = 0.0
        for i in range(n):
            change = max(change, abs(work.tn[i] - state.t[i]))
            state.t[i] = work.tn[i]
        if change < 1e-10:
            break
    state.t_before[:] = state.t
    state.s_before[:] = state.s
    state.clock[0] = 0.0


@njit(cache=True)
def _rest_solve(work, held, x):
    """Solve K x = x in place; rows of held cells are the identity. Work.fac and work.inv are scratch."""
    n = x.shape[0]
    for i in range(n):
        diag = work.diag[i] if work.diag[i] > 0.0 else 1.0
        low = 0.0
        if i > 0 and not held[i]:
            low = work.g[i]
        pivot = diag
        if i > 0 and low != 0.0:
            up = 0.0 if held[i - 1] else work.g[i]
            pivot -= low * up * work.inv[i - 1]
            x[i] += low * work.inv[i - 1] * x[i - 1]
        work.inv[i] = 1.0 / pivot
    x[n - 1] *= work.inv[n - 1]
    for i in range(n - 2, -1, -1):
        up = 0.0 if held[i] else work.g[i + 1]
        x[i] = (x[i] + up * x[i + 1]) * work.inv[i]


@njit(cache=True)
def delay(h, y, dy, tau, dtau):
    """Filter outputs in place by a first-order lag of `tau` seconds, input linear over each step.

    `y` (steps + 1, m), `dy` (steps + 1, m, P), `dtau` (P): derivative of tau. The filter starts settled.
    """
    steps = h.shape[0]
    m, p = dy.shape[1], dy.shape[2]
    for a in range(m):
        before = y[0, a]
        d_before = dy[0, a].copy()
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
                d_now = dy[step + 1, a, q]
                dy[step + 1, a, q] = (
                    dy[step, a, q] * e + d_before[q] * (r - e) + d_now * (1.0 - r) + slope * dtau[q]
                )
                d_before[q] = d_now
            before = now


@njit(cache=True)
def gather(first, weights, y, out):
    """Weighted sums of four neighbouring rows of `y` (rows, c), starting at `first`."""
    for row in range(out.shape[0]):
        i = first[row]
        for c in range(out.shape[1]):
            value = 0.0
            for a in range(4):
                w = weights[row, a]
                if w != 0.0:
                    value += w * y[i + a, c]
            out[row, c] = value
