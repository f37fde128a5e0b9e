"""Coefficients of one step, and their tangents: properties, contacts, losses, sources.

Everything that depends on temperature is taken at the temperatures expected in the middle of the step.
Rows of the coefficient arrays are named below; ``w`` has shape (rows, n + 1), ``dw`` (rows, P, n + 1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from daq.printed import on_screen
from daq.records import COLDEST_C, GAS_CONSTANT, STEFAN_BOLTZMANN
from softsensor.effects.effect import BENDS_C, REFERENCE_C

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Numbers without another source were set by hand, 2026-11.

ROWS, DROWS = 8, 7
"""How many are named below, by definition."""
CAP, G, LOSS, SRC, SLOPE, DIAG, COND, STAR = range(ROWS)
"""Heat capacity [J/m²K]; conductance of each interface; loss of each cell to ambient [W/m²K]; source
[W/m²]; its slope; diagonal of K; conductivity; expected temperature."""
DCAP, DG, DLOSS, DSRC, DSLOPE, DCOND, DSTAR = range(DROWS)
RATE, RSLOPE = range(2)
"""Of each conversion: mean rate in the step, its part without temperature, and its slope. [1/s, 1/sK]"""

GAMMA = 2.0 - 2.0**0.5
"""TR-BDF2: share of a step that its first stage takes, so that both stages have one matrix."""
D = GAMMA / 2.0
FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Liberties the compiler may take: none that would let it forget NaN or infinity."""

ZERO_C = -COLDEST_C
"""0 °C in kelvin. [K]"""
BOILING_C = 100.0
"""Water boils at, at 1013 hPa; 99.97 by IAPWS-IF97. [°C]"""
_FLOOR = 0.05
"""Least factor a property falls to when it falls with temperature."""
BEND_STEP_K = float(BENDS_C[1] - BENDS_C[0])
_NODES, _SHARES = np.polynomial.legendre.leggauss(4)


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
    source: Array
    """Heat that cells release while closed, by source (k, n). [W/m³]"""
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
    """Rate of each conversion (r, 5): kind, a, b, c, u. Kind 0: a exp(-b/R (1/T - 1/c)), kind 1: softened
    ramp a (T - b)+ with width c; u: `effects.effect.Conversion.own`. [1/s, J/mol, K | 1/sK, °C, K]"""
    bends: Array
    """Logarithms of factors by temperature at `BENDS_C` (2, 61): on the conductivity where `wet` is set, on the
    closed contacts of these cells by the temperature of the outermost one; (2, 0) without."""


class Tangents(NamedTuple):
    """Derivatives of `Stack` fields with respect to the P parameters."""

    k: Array
    """(P, n)"""
    k_slope: Array
    c: Array
    c_slope: Array
    exchange: Array
    source: Array
    """(k, P, n)"""
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
    """(r, 5, P)"""
    bends: Array
    """(2, P, 61) or (2, P, 0)"""


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

    def __repr__(self) -> str:
        """Return it in short, as it stands in results."""
        return on_screen(self)


class Drive(NamedTuple):
    """The outside of a whole step grid."""

    h: Array
    """Step lengths (steps). [s]"""
    weight: Array
    """Mean share of each state in the step (steps, 3)."""
    d_weight: Array
    """(steps, 3, P)"""
    factor: Array
    """Factor on the coupling of a closed contact, then on each source, in the step's mean (steps, m + k)."""
    d_factor: Array
    """(steps, m + k, P)"""
    boundary: Array
    """Boundary temperature: mean over the step and change across it (steps, 2, 2). [°C, K]"""
    d_boundary: Array
    """(2, P): constant shift of each boundary temperature."""


class Coefficients(NamedTuple):
    """What a step's matrix and right-hand side are made of, by the rows named above; filled in place."""

    w: Array
    """(`ROWS`, n + 1)"""
    dw: Array
    """Their tangents (`DROWS`, P, n + 1)."""
    rate: Array
    """Of each conversion (r, 2, n)."""
    drate: Array
    """(r, 2, P, n)"""


class Property(NamedTuple):
    """Conductivity or heat capacity of the cells: base (1 + slope (T - 20)) table(T)."""

    base: Array
    """(n)"""
    slope: Array
    """(n). [1/K]"""
    table: Integers
    """Row of `table_x`, or -1 (n)."""
    table_x: Array
    table_y: Array
    d_base: Array
    """Tangents of base (P, n)."""
    d_slope: Array


class Reaction(NamedTuple):
    """What one conversion releases, by what law, and how far it is; as in `Stack`, `Tangents` and `State`."""

    heat: Array
    law: Array
    d_heat: Array
    d_law: Array
    done: Array
    d_done: Array


@compiled(inner=True)
def room(r, p, n):
    """Return room for coefficients; empty where `coefficients` fills everything."""
    rate, drate = np.zeros((r, 2, n)), np.zeros((r, 2, p, n))
    return Coefficients(np.zeros((ROWS, n + 1)), np.empty((DROWS, p, n + 1)), rate, drate)


@compiled(inner=True)
def any_of(values):
    """Whether any of a vector differs from 0; Numba's own takes three times as long to compile."""
    found = False
    for i in range(values.shape[0]):
        found = found or values[i] != 0.0
    return found


@compiled(inner=True)
def _table(x, y, t):
    """Interpolate a table at t, constant beyond its ends; return value and slope."""
    last = x.shape[0] - 1
    if t <= x[0]:
        return y[0], 0.0
    if t >= x[last]:
        return y[last], 0.0
    j = 0
    while x[j + 1] < t:
        j += 1
    slope = (y[j + 1] - y[j]) / (x[j + 1] - x[j])
    return y[j] + slope * (t - x[j]), slope


@compiled(inner=True)
def lag_weights(x):
    """Return what a first-order lag keeps over a step of x = h / tau, the mean of that, and its slope by x.

    e = exp(-x), r = (1 - e) / x and dr / dx: where the input goes straight from a to b, an output of y becomes
    y e + a (r - e) + b (1 - r).
    """
    e = np.exp(-x)
    if x > 1e-4:
        return e, (1.0 - e) / x, (e * (1.0 + x) - 1.0) / (x * x)
    return e, 1.0 - 0.5 * x, -0.5 + x / 3.0  # their series, by definition


@compiled(inner=True)
def _rate(kind, a, b, c, t):
    """Return a conversion's rate [1/s] and its derivatives in T, a, b, c; then those of its slope in T."""
    if kind == 0.0:
        kelvin = t + ZERO_C
        inverse = 1.0 / kelvin - 1.0 / c
        value = a * np.exp(-b / GAS_CONSTANT * inverse)
        f = b / GAS_CONSTANT / kelvin**2
        first = (value, value * f, value / a, -value * inverse / GAS_CONSTANT, -value * b / GAS_CONSTANT / c**2)
        return first, (
            value * f * (f - 2.0 / kelvin),
            value * f / a,
            value * f * (1.0 / b - inverse / GAS_CONSTANT),
            -value * b / GAS_CONSTANT / c**2 * f,
        )
    x = (t - b) / c
    soft, step = x, 1.0
    if x < -20.0:
        soft, step = 0.0, 0.0
    elif x < 30.0:
        e = np.exp(x)
        soft, step = np.log1p(e), e / (1.0 + e)
    bend = step * (1.0 - step)
    first = (a * c * soft, a * step, c * soft, -a * step, a * (soft - x * step))
    return first, (a * bend / c, step, -a * bend / c, -a * bend * x / c)


@compiled(inner=True)
def properties(dx, law, star, dstar, value, dvalue):
    """Fill a property times `dx` of each cell (n), and its tangents (P, n), at the temperatures `star`."""
    p, n = law.d_base.shape
    base, slope, table = law.base, law.slope, law.table
    by_base, by_slope, by_star = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        t = star[i] - REFERENCE_C
        lift = 1.0 + slope[i] * t
        bend = base[i] * slope[i]
        if lift < _FLOOR:
            lift, bend = _FLOOR, 0.0
        y = 1.0
        if table[i] >= 0:
            y, dy = _table(law.table_x[table[i]], law.table_y[table[i]], star[i])
            bend = bend * y + base[i] * lift * dy
        value[i] = base[i] * lift * y * dx[i]
        by_base[i], by_slope[i], by_star[i] = dx[i] * lift * y, dx[i] * base[i] * t * y, dx[i] * bend
    for q in range(p):
        db, ds, st, out = law.d_base[q], law.d_slope[q], dstar[q], dvalue[q]
        for i in range(n):
            out[i] = by_base[i] * db[i] + by_slope[i] * ds[i] + by_star[i] * st[i]


@compiled(inner=True)
def _bend(bends, t):
    """Return where a temperature stands in a free function, how far beyond, its value and its slope. [1/K]"""
    last = bends.shape[0] - 1
    x = (t - BENDS_C[0]) / BEND_STEP_K
    j = min(max(int(x), 0), last - 1)
    u = min(max(x - j, 0.0), 1.0)
    slope = (bends[j + 1] - bends[j]) / BEND_STEP_K if u == x - j else 0.0
    return j, u, (1.0 - u) * bends[j] + u * bends[j + 1], slope


@compiled(inner=True)
def bend_conductivity(wet, bends, d_bends, co):
    """Multiply the panel's conductivity by the free function of its temperature."""
    w, dw = co.w, co.dw
    for i in range(wet.shape[0]):
        if wet[i]:
            j, u, log, slope = _bend(bends, w[STAR, i])
            f, before = np.exp(log), w[COND, i]
            w[COND, i] = f * before
            for q in range(dw.shape[1]):
                d_log = slope * dw[DSTAR, q, i] + (1.0 - u) * d_bends[q, j] + u * d_bends[q, j + 1]
                dw[DCOND, q, i] = f * (dw[DCOND, q, i] + before * d_log)


@compiled(inner=True)
def _bend_contact(stack, tan, drive, at, co, h, dh):
    """Multiply the closed share of a contact's coupling by the free function of the panel's face.

    `at`: step and number of the contact; h (3) and dh (3, P) as in `_contact_values`. Paper is one cell.
    """
    step, m = at
    face, n = -1, stack.dx.shape[0]
    for cell in (stack.interface[m] + 1, stack.interface[m] - 2, stack.interface[m], stack.interface[m] - 1):
        if 0 <= cell < n and stack.wet[cell]:
            face = cell
    if face < 0:
        return
    weight, value, factor = drive.weight[step, 2], stack.contact[m, 2, 0], drive.factor[step, m]
    j, u, log, slope = _bend(stack.bends[1], co.w[STAR, face])
    f, closed, d_bends = np.exp(log), weight * value * factor, tan.bends[1]
    h[0] += closed * (f - 1.0)
    for q in range(dh.shape[1]):
        d_closed = drive.d_weight[step, 2, q] * value * factor + weight * tan.contact[m, 2, 0, q] * factor
        d_closed += weight * value * drive.d_factor[step, m, q]
        d_log = slope * co.dw[DSTAR, q, face] + (1.0 - u) * d_bends[q, j] + u * d_bends[q, j + 1]
        dh[0, q] += d_closed * (f - 1.0) + closed * f * d_log


@compiled(inner=True)
def joints(dx, measured, co):
    """Conductance of the interfaces inside layers and of perfect joints, with tangents."""
    w, dw = co.w, co.dw
    n, p = dx.shape[0], dw.shape[1]
    cond, g = w[COND], w[G]
    dcond, dg = dw[DCOND], dw[DG]
    g[0] = 0.0
    g[n] = 0.0
    for j in range(1, n):
        g[j] = 2.0 / (dx[j - 1] / cond[j - 1] + dx[j] / cond[j])
    below, above = np.empty(n), np.empty(n)
    for j in range(1, n):
        below[j - 1] = 0.5 * dx[j - 1] * (g[j] / cond[j - 1]) ** 2
        above[j - 1] = 0.5 * dx[j] * (g[j] / cond[j]) ** 2
    for q in range(p):
        lower, upper, inner = dcond[q], dcond[q, 1:], dg[q, 1:]
        dg[q, 0] = 0.0
        dg[q, n] = 0.0
        for i in range(n - 1):
            inner[i] = below[i] * lower[i] + above[i] * upper[i]
    for end in range(2):
        if measured[end]:
            i, j = (0, 0) if end == 0 else (n - 1, n)
            g[j] = 2.0 * cond[i] / dx[i]
            for q in range(p):
                dg[q, j] = 2.0 * dcond[q, i] / dx[i]


@compiled(inner=True)
def contacts(stack, tan, drive, step, co):
    """Replace joints that are contacts by coupling and losses to air, with tangents; fill the losses."""
    w, dw, weight, d_weight = co.w, co.dw, drive.weight[step], drive.d_weight[step]
    n, p = stack.dx.shape[0], dw.shape[1]
    loss, dloss, star, dstar = w[LOSS], dw[DLOSS], w[STAR], dw[DSTAR]
    emissivity, d_emissivity = stack.emissivity, tan.emissivity
    for i in range(n):
        loss[i] = 0.0
    for q in range(p):
        for i in range(n):
            dloss[q, i] = 0.0
    h = np.empty(3)
    dh = np.empty((3, p))
    radiates = emissivity != 0.0 or any_of(d_emissivity)
    for m in range(stack.interface.shape[0]):
        j = stack.interface[m]
        _contact_values(stack.contact[m], tan.contact[m], drive, (step, m), h, dh)
        if stack.bends.shape[1] > 0:
            _bend_contact(stack, tan, drive, (step, m), co, h, dh)
        if j == 0 or j == n:
            _end(stack, tan.flux, co, m, h, dh)
            continue
        if stack.parts[m] and radiates:
            share, a, b = weight[1], star[j - 1] + ZERO_C, star[j] + ZERO_C
            shape = STEFAN_BOLTZMANN * (a * a + b * b) * (a + b)
            d_a = STEFAN_BOLTZMANN * (3 * a * a + 2 * a * b + b * b)
            d_b = STEFAN_BOLTZMANN * (3 * b * b + 2 * a * b + a * a)
            h[0] += share * emissivity * shape
            for q in range(p):
                dh[0, q] += (share * d_emissivity[q] + d_weight[1, q] * emissivity) * shape
                dh[0, q] += share * emissivity * (d_a * dstar[q, j - 1] + d_b * dstar[q, j])
        _inner(stack.dx, co, j, h, dh)


@compiled(inner=True)
def _contact_values(contact, d_contact, drive, at, h, dh):
    """Mix a contact's three values (3, 3) by the step's shares of the states; fill h (3) and dh (3, P).

    `at`: step and number of the contact.
    """
    step, m = at
    weight, d_weight, d_factor = drive.weight[step], drive.d_weight[step], drive.d_factor[step, m]
    p = dh.shape[1]
    for v in range(3):
        h[v] = 0.0
        for q in range(p):
            dh[v, q] = 0.0
        for s in range(3):
            closed = s == 2 and v == 0
            f = drive.factor[step, m] if closed else 1.0
            share, value = weight[s], contact[s, v]
            h[v] += share * value * f
            for q in range(p):
                dh[v, q] += share * f * d_contact[s, v, q] + d_weight[s, q] * f * value
            if closed:
                for q in range(p):
                    dh[v, q] += share * value * d_factor[q]


@compiled(inner=True)
def _inner(dx, co, j, h, dh):
    """Eliminate the two faces of a contact: its coupling, and the losses of the cells on either side."""
    w, dw = co.w, co.dw
    gl, gu = 2.0 * w[COND, j - 1] / dx[j - 1], 2.0 * w[COND, j] / dx[j]
    lower, upper = gl + h[0] + h[1], gu + h[0] + h[2]
    det = lower * upper - h[0] * h[0]
    g = gl * h[0] * gu / det
    below, above = h[1] * upper + h[0] * h[2], h[2] * lower + h[0] * h[1]
    low, up = gl * below / det, gu * above / det
    w[G, j] = g
    w[LOSS, j - 1] += low
    w[LOSS, j] += up
    for q in range(dh.shape[1]):
        dgl, dgu = 2.0 * dw[DCOND, q, j - 1] / dx[j - 1], 2.0 * dw[DCOND, q, j] / dx[j]
        d0, d1, d2 = dh[0, q], dh[1, q], dh[2, q]
        dlower, dupper = dgl + d0 + d1, dgu + d0 + d2
        ddet = dlower * upper + lower * dupper - 2.0 * h[0] * d0
        dbelow = d1 * upper + h[1] * dupper + d0 * h[2] + h[0] * d2
        dabove = d2 * lower + h[2] * dlower + d0 * h[1] + h[0] * d1
        dw[DG, q, j] = (dgl * h[0] * gu + gl * d0 * gu + gl * h[0] * dgu - g * ddet) / det
        dw[DLOSS, q, j - 1] += (dgl * below + gl * dbelow - low * ddet) / det
        dw[DLOSS, q, j] += (dgu * above + gu * dabove - up * ddet) / det


@compiled(inner=True)
def _end(stack, d_flux, co, m, h, dh):
    """Contact m at an end of the stack, h (3) and dh (3, P) as in `_contact_values`."""
    end = 0 if stack.interface[m] == 0 else 1
    if stack.measured[end]:
        _measured_end(stack.dx, co, end, h, dh)
    else:
        _surface(stack, d_flux[end], co, m, h, dh)


@compiled(inner=True)
def _measured_end(dx, co, end, h, dh):
    """A contact h[0] with a measured temperature; where they part, the face loses to the air."""
    w, dw, n = co.w, co.dw, dx.shape[0]
    i, j, own = (0, 0, 2) if end == 0 else (n - 1, n, 1)
    g = 2.0 * w[COND, i] / dx[i]
    total = g + h[0] + h[own]
    joined, lost = g * h[0] / total, g * h[own] / total
    w[G, j] = joined
    w[LOSS, i] += lost
    for q in range(dh.shape[1]):
        dg = 2.0 * dw[DCOND, q, i] / dx[i]
        dtotal = dg + dh[0, q] + dh[own, q]
        dw[DG, q, j] = (dg * h[0] + g * dh[0, q] - joined * dtotal) / total
        dw[DLOSS, q, i] += (dg * h[own] + g * dh[own, q] - lost * dtotal) / total


@compiled(inner=True)
def _surface(stack, d_flux, co, m, h, dh):
    """A surface that air and radiation act on, behind half a cell and, unless bare, a contact h[0].

    Its temperature x solves g (T - x) + h (T_a - x) + eps sigma (T_a^4 - x^4) + flux = 0 with the air's h
    at the cell's expected temperature; about it radiation is taken with its slope, so that steps of
    any length settle.
    """
    w, dw, dx, bare, n = co.w, co.dw, stack.dx, stack.bare[m], stack.dx.shape[0]
    end, i, j, outer = (0, 0, 0, 1) if stack.interface[m] == 0 else (1, n - 1, n, 2)
    flux = stack.flux[end]
    g = 2.0 * w[COND, i] / dx[i]
    half = g
    if not bare:
        if h[0] == 0.0:
            return
        g = half * h[0] / (half + h[0])
    t, around, sigma = w[STAR, i] + ZERO_C, flux[2] + ZERO_C, flux[1] * STEFAN_BOLTZMANN
    x = max(t, 1.0)
    if sigma > 0.0:
        for _ in range(100):
            rest = g * (t - x) + h[outer] * (around - x) + sigma * (around**4 - x**4) + flux[0]
            move = rest / (g + h[outer] + 4.0 * sigma * x**3)  # the slope of x⁴, by definition
            x = max(x + move, 1.0)
            if abs(move) < 1e-12 * x:
                break
    else:
        x = (g * t + h[outer] * around + flux[0]) / (g + h[outer])
    slope, bend = 4.0 * sigma * x**3, 12.0 * sigma * x**2  # of x⁴, by definition
    a = h[outer] + slope
    power = flux[0] + sigma * (around**4 - x**4) + slope * (x - around)
    share = g / (a + g)
    w[G, j] = a * share
    w[SRC, i] += power * share
    for q in range(dh.shape[1]):
        dg = 2.0 * dw[DCOND, q, i] / dx[i]
        if not bare:
            dg = (h[0] * h[0] * dg + half * half * dh[0, q]) / (half + h[0]) ** 2
        move = (dg * (t - x) + g * dw[DSTAR, q, i] + dh[outer, q] * (around - x) + d_flux[q]) / (a + g)
        da = dh[outer, q] + bend * move
        dpower = d_flux[q] + bend * (x - around) * move
        dw[DG, q, j] = (g * g * da + a * a * dg) / (a + g) ** 2
        dw[DSRC, q, i] += dpower * share + power * (dg * a - g * da) / (a + g) ** 2


@compiled(inner=True)
def exchange_sources(dx, ambient, rate, d_rate, co):
    """Start the sources with the volumetric exchange with ambient."""
    w, dw = co.w, co.dw
    n = dx.shape[0]
    for i in range(n):
        w[SRC, i] = rate[i] * dx[i] * ambient
        w[SLOPE, i] = rate[i] * dx[i]
    for q in range(d_rate.shape[0]):
        dsrc, dslope, dr = dw[DSRC, q], dw[DSLOPE, q], d_rate[q]
        for i in range(n):
            dsrc[i] = dr[i] * dx[i] * ambient
            dslope[i] = dr[i] * dx[i]


@compiled(inner=True)
def closed_source(dx, source, d_source, drive, at, co):
    """Add the heat of a source (n), which the panel releases in the closed press by itself.

    `at`: step and number of the source's factor.
    """
    step, k = at
    weight, course = drive.weight[step, 2], drive.factor[step, k]
    for i in range(dx.shape[0]):
        co.w[SRC, i] += weight * course * source[i] * dx[i]
    for q in range(co.dw.shape[1]):
        change = drive.d_weight[step, 2, q] * course + weight * drive.d_factor[step, k, q]
        for i in range(dx.shape[0]):
            co.dw[DSRC, q, i] += dx[i] * (change * source[i] + weight * course * d_source[q, i])


@compiled(inner=True)
def active_stretches(heat, d_heat, ends):
    """List where a conversion acts, stretch by stretch: first cell and the one after the last. Return how many.

    Some act in two cells only, and everywhere else there is nothing to differentiate.
    """
    p, n = d_heat.shape
    size = np.abs(heat)
    for q in range(p):
        dh = d_heat[q]
        for i in range(n):
            size[i] += abs(dh[i])
    count, inside = 0, False
    for i in range(n):
        if inside and size[i] == 0.0:
            ends[count, 1] = i
            count += 1
        elif size[i] != 0.0 and not inside:
            ends[count, 0] = i
        inside = size[i] != 0.0
    if inside:
        ends[count, 1] = n
        count += 1
    return count


@compiled(inner=True)
def conversion(dx, reaction, h, r, co):
    """Add the heat of conversion r, dZ/dt = (1 - Z) (1 - u + u Z) rate(T), as the mean of a step of length h.

    With the rate frozen over the step and E = exp(-h rate) its mean is (1 - Z) (1 - u + u Z) (1 - E) / h over
    1 - u + u Z + u E (1 - Z), linear in T about `star`; a source that grows with temperature, and one that speeds
    up as it goes (u > 0), is taken at `star` alone. `co.rate` and `co.drate` come as zeros, or from the step
    before. Of one without heat only the tangents of its heat are filled: no other acts on anything.
    """
    w, dw, rate, drate = co.w, co.dw, co.rate[r], co.drate[r]
    heat, law, d_heat, d_law, done, d_done = reaction
    n, p = dx.shape[0], dw.shape[1]
    star, value, slope = w[STAR], rate[RATE], rate[RSLOPE]
    ends = np.empty((n, 2), np.uint64)  # an index that cannot be negative vectorises
    count = active_stretches(heat, d_heat, ends)
    part = np.zeros((4, n))
    # value and slope are linear in the tangents of: the fraction left, the rate (through left * kept),
    # and the rate's slope; both of the last are linear in those of T, a, b, c; the value in that of u, too
    by_law = np.zeros((7, n))
    own = law[4]
    for k in range(count):
        for i in range(ends[k, 0], ends[k, 1]):
            value[i] = 0.0
            slope[i] = 0.0
            t = star[i]
            first, second = _rate(law[0], law[1], law[2], law[3], t)
            if first[0] == 0.0:
                continue
            gone = -np.expm1(-h * first[0])
            stiff = 0.0 if heat[i] > 0.0 or own > 0.0 else 1.0
            left, kept = 1.0 - done[i], 1.0 - gone
            pace = 1.0 - own * left
            over = 1.0 / (pace + own * kept * left)
            by_rate = left * pace * kept * over * over
            slope[i] = stiff * by_rate * first[1]
            value[i] = left * pace * gone * over / h - slope[i] * t
            w[SRC, i] += heat[i] * dx[i] * value[i]
            w[SLOPE, i] -= heat[i] * dx[i] * slope[i]
            part[0, i] = -stiff * kept * first[1]
            part[1, i] = stiff * by_rate * (second[0] - h * first[1] * first[1])
            part[2, i] = (kept * over * over - 1.0) / h
            part[3, i] = by_rate * first[1] - slope[i]
            for a in range(3):
                by_law[a, i] = by_rate * first[2 + a]
                by_law[3 + a, i] = stiff * by_rate * (second[1 + a] - h * first[1] * first[2 + a])
            by_law[6, i] = -left * left * kept * gone * over * over / h
    if not any_of(heat):
        for q in range(p):
            dh, dsrc, dk = d_heat[q], dw[DSRC, q], dw[DSLOPE, q]
            for k in range(count):
                for i in range(ends[k, 0], ends[k, 1]):
                    dsrc[i] += dx[i] * (dh[i] * value[i])
                    dk[i] -= dx[i] * (dh[i] * slope[i])
        return
    by_done, by_star, of_done, of_star = part[0], part[1], part[2], part[3]
    for q in range(p):
        st, dz, dh = dw[DSTAR, q], d_done[q], d_heat[q]
        dvalue, dslope, dsrc, dk = drate[RATE, q], drate[RSLOPE, q], dw[DSRC, q], dw[DSLOPE, q]
        da, db, dc, du = d_law[1, q], d_law[2, q], d_law[3, q], d_law[4, q]
        for k in range(count):
            for i in range(ends[k, 0], ends[k, 1]):
                ds = by_done[i] * dz[i] + by_star[i] * st[i]
                dv = of_done[i] * dz[i] + of_star[i] * st[i]
                ds += by_law[3, i] * da + by_law[4, i] * db + by_law[5, i] * dc
                dv += by_law[0, i] * da + by_law[1, i] * db + by_law[2, i] * dc + by_law[6, i] * du - ds * star[i]
                dslope[i] = ds
                dvalue[i] = dv
                dsrc[i] += dx[i] * (dh[i] * value[i] + heat[i] * dv)
                dk[i] -= dx[i] * (dh[i] * slope[i] + heat[i] * ds)


SPARE_K_M = 0.01
"""Room below 100 °C, summed over the depth, at which half of the steam still finds where to condense: 0.6 K in a
panel of 16 mm. Without it the last cool cell takes all of it, jumps to 100 °C, and the derivatives stay what they
were before the jump. So small that only the last seconds differ, so large that a stride of 2 s follows: rho c
times it over what the hot layers give, 1.2e6 x 0.01 / (1.2e4 x 0.2), is 5 s. [K m]"""


@compiled(inner=True)
def steam(dx, wet, factor, d_factor, co):
    """Steam leaves cells above 100 °C and condenses in cooler ones by 100 °C - T, as far as there is room."""
    w, dw = co.w, co.dw
    n, p = dx.shape[0], dw.shape[1]
    star, dstar = w[STAR], dw[DSTAR]
    hot = 0.0
    cold = 0.0
    for i in range(n):
        if wet[i]:
            over = (star[i] - BOILING_C) * dx[i]
            if over > 0.0:
                hot += over
            else:
                cold -= over
    if hot <= 0.0:
        return
    room, ratio = cold / (cold + SPARE_K_M), hot / (cold + SPARE_K_M)
    for i in range(n):
        if wet[i]:
            over = star[i] - BOILING_C
            w[SRC, i] -= factor * dx[i] * over * (room if over > 0.0 else ratio)
    for q in range(p):
        if factor == 0.0 and d_factor[q] == 0.0:
            continue
        dhot = 0.0
        dcold = 0.0
        for i in range(n):
            if wet[i]:
                if star[i] > BOILING_C:
                    dhot += dstar[q, i] * dx[i]
                else:
                    dcold -= dstar[q, i] * dx[i]
        dratio = (dhot - ratio * dcold) / (cold + SPARE_K_M)
        droom = (1.0 - room) * dcold / (cold + SPARE_K_M)
        df, st, dsrc = d_factor[q], dstar[q], dw[DSRC, q]
        for i in range(n):
            if wet[i]:
                over = star[i] - BOILING_C
                share, dshare = (room, droom) if over > 0.0 else (ratio, dratio)
                dsrc[i] -= dx[i] * (df * over * share + factor * (st[i] * share + over * dshare))


@compiled()
def coefficients(stack, tan, drive, step, state, co):
    """Fill all coefficients of a step, from the expected temperatures in its rows `STAR` and `DSTAR`."""
    w, dw = co.w, co.dw
    conductivity = Property(
        stack.k, stack.k_slope, stack.k_table, stack.table_x, stack.table_y, tan.k, tan.k_slope
    )
    capacity = Property(stack.c, stack.c_slope, stack.c_table, stack.table_x, stack.table_y, tan.c, tan.c_slope)
    properties(np.ones(stack.dx.shape[0]), conductivity, w[STAR], dw[DSTAR], w[COND], dw[DCOND])
    properties(stack.dx, capacity, w[STAR], dw[DSTAR], w[CAP], dw[DCAP])
    if stack.bends.shape[1] > 0:
        bend_conductivity(stack.wet, stack.bends[0], tan.bends[0], co)
    joints(stack.dx, stack.measured, co)
    switched(stack, tan, drive, step, state, co)


@compiled(inner=True)
def switched(stack, tan, drive, step, state, co):
    """Fill what changes with the press's state: contacts, sources and the diagonal."""
    w, weight, d_weight = co.w, drive.weight[step], drive.d_weight[step]
    n, p = stack.dx.shape[0], co.dw.shape[1]
    exchange_sources(stack.dx, stack.ambient, stack.exchange, tan.exchange, co)
    for k in range(stack.source.shape[0]):
        closed_source(stack.dx, stack.source[k], tan.source[k], drive, (step, stack.interface.shape[0] + k), co)
    contacts(stack, tan, drive, step, co)
    for r in range(stack.heat.shape[0]):
        reaction = Reaction(stack.heat[r], stack.law[r], tan.heat[r], tan.law[r], state.done[r], state.s_done[r])
        conversion(stack.dx, reaction, drive.h[step], r, co)
    if stack.convection != 0.0 or any_of(tan.convection):
        share = weight[2]
        d_factor = np.empty(p)
        for q in range(p):
            d_factor[q] = share * tan.convection[q] + d_weight[2, q] * stack.convection
        steam(stack.dx, stack.wet, share * stack.convection, d_factor, co)
    for i in range(n):
        w[DIAG, i] = w[G, i] + w[G, i + 1] + w[LOSS, i] + w[SLOPE, i]


@compiled()
def heat(stack, start, field):
    """Return the heat that takes the wet cells from `start` to `field` (n), rho c(T) integrated. [J/m²]"""
    n = field.shape[0]
    none, value, star = np.empty((0, n)), np.empty(n), np.empty(n)
    capacity = Property(stack.c, stack.c_slope, stack.c_table, stack.table_x, stack.table_y, none, none)
    total = 0.0
    for k in range(_NODES.shape[0]):
        for i in range(n):
            star[i] = start + 0.5 * (1.0 + _NODES[k]) * (field[i] - start)
        properties(stack.dx, capacity, star, none, value, none)
        for i in range(n):
            if stack.wet[i]:
                total += 0.5 * _SHARES[k] * value[i] * (field[i] - start)
    return total
