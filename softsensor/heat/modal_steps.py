"""The compiled recurrence of decoupled modes, exact in time for forces that are straight between steps.

Each mode obeys q' = -lam q + z(t). Over a step of length h, with x = lam h,

    q1 = exp(-x) q0 + h [(phi1 - phi2) z0 + phi2 z1],   phi1 = (1 - exp(-x)) / x,  phi2 = (1 - phi1) / x

(first-order hold; Moler & Van Loan 2003 review the exponential). It holds for any x: a mode that has decayed
within the step follows its force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.compiled import compiled
from softsensor.heat.step_terms import (
    CAP,
    DCAP,
    DG,
    DIAG,
    DLOSS,
    DSLOPE,
    DSRC,
    FAST,
    LOSS,
    SRC,
    Array,
    Coefficients,
    G,
    Integers,
    coefficients,
)

_NEXT_TO_NOTHING = 1e-200
"""Added to all modes: one that nothing forces would decay into subnormal numbers, which take ten times as long."""


@compiled()
def freeze_steps(stack, tan, drive, state, steps, out):
    """Fill the coefficients and their tangents, `out` (spans, ...) each, of some steps of a linear stack."""
    w, dw = out
    p, n = state.s.shape
    rate, drate = np.zeros((0, 2, n)), np.zeros((0, 2, p, n))
    for i in range(steps.shape[0]):
        coefficients(stack, tan, drive, steps[i], state, Coefficients(w[i], dw[i], rate, drate))


@compiled(inner=True)
def _hold(lam, h, keep, old, new):
    """Fill the factors on q0, z0 and z1 of every mode."""
    for j in range(lam.shape[0]):
        x = lam[j] * h
        e = np.exp(-x)
        if x > 1e-3:
            phi1 = (1.0 - e) / x
            phi2 = (1.0 - phi1) / x
        else:
            phi1 = 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0))  # their series, by definition
            phi2 = 0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0))  # by definition
        keep[j] = e
        old[j] = h * (phi1 - phi2)
        new[j] = h * phi2


@compiled(nogil=True, fastmath=FAST)
def carry(lam, h, z, q):
    """Carry the modes of several systems from step edge to step edge.

    The systems share rates and steps: the temperatures are one, the tangent of every parameter another.

    Parameters
    ----------
    lam
        Rates, not negative (n). [1/s]
    h
        Step lengths (steps). [s]
    z
        Forces on the modes at the step edges (s, steps + 1, n).
    q
        Modes at the step edges (s, steps + 1, n), of which the first are given.
    """
    n, steps = lam.shape[0], h.shape[0]
    keep, old, new = np.empty(n), np.empty(n), np.empty(n)
    length = -1.0
    for k in range(steps):
        if h[k] != length:
            length = h[k]
            _hold(lam, length, keep, old, new)
        for s in range(q.shape[0]):
            before, after, force, next_force = q[s, k], q[s, k + 1], z[s, k], z[s, k + 1]
            for j in range(n):
                after[j] = keep[j] * before[j] + old[j] * force[j] + (new[j] * next_force[j] + _NEXT_TO_NOTHING)


class Forced(NamedTuple):
    """Modes driven by what is outside, over some steps."""

    rates: Array
    """Not negative (n). [1/s]"""
    h: Array
    """Step lengths (steps). [s]"""
    gains: Array
    """Forces on the modes by the temperature below, that above, and 1 (3, n)."""
    outside: Array
    """Those temperatures at the step edges (steps + 1, 2). [°C]"""


class Noted(NamedTuple):
    """What is kept of the modes."""

    read: Array
    """Places in terms of modes (m, n), m at least 3."""
    out: Array
    """Places (steps + 1, m)."""
    chosen: Integers
    """Step edges, rising, whose modes are wanted (c)."""
    history: Array
    """Those modes (c, n)."""


@compiled(nogil=True, fastmath=FAST)
def drive(forced, q, noted):
    """Carry the modes q (n) of the temperatures, in place, and note places at every step edge."""
    lam, h, gains, u = forced.rates, forced.h, forced.gains, forced.outside
    read, out, chosen, history = noted.read, noted.out, noted.chosen, noted.history
    n, m, steps = lam.shape[0], read.shape[0], h.shape[0]
    keep, old, new = np.empty(n), np.empty(n), np.empty(n)
    below, above, rest, next_below, next_above = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    r0, r1, r2 = read[0], read[1], read[2]
    length = -1.0
    wanted = 0
    for k in range(steps + 1):
        s0, s1, s2 = 0.0, 0.0, 0.0
        if k == 0:
            for j in range(n):
                s0 += r0[j] * q[j]
                s1 += r1[j] * q[j]
                s2 += r2[j] * q[j]
        else:
            if h[k - 1] != length:
                length = h[k - 1]
                _hold(lam, length, keep, old, new)
                for j in range(n):
                    below[j], next_below[j] = old[j] * gains[0, j], new[j] * gains[0, j]
                    above[j], next_above[j] = old[j] * gains[1, j], new[j] * gains[1, j]
                    rest[j] = (old[j] + new[j]) * gains[2, j] + _NEXT_TO_NOTHING
            low, top, next_low, next_top = u[k - 1, 0], u[k - 1, 1], u[k, 0], u[k, 1]
            for j in range(n):
                force = below[j] * low + above[j] * top + next_below[j] * next_low + next_above[j] * next_top
                x = keep[j] * q[j] + force + rest[j]
                q[j] = x
                s0 += r0[j] * x
                s1 += r1[j] * x
                s2 += r2[j] * x
        out[k, 0], out[k, 1], out[k, 2] = s0, s1, s2
        for a in range(3, m):
            value = 0.0
            for j in range(n):
                value += read[a, j] * q[j]
            out[k, a] = value
        if wanted < chosen.shape[0] and chosen[wanted] == k:
            for j in range(n):
                history[wanted, j] = q[j]
            wanted += 1


class Neighbourhood(NamedTuple):
    """Temperatures in and beside the cells that parameters touch."""

    cells: Integers
    """Those touched (c)."""
    column: Integers
    """Of `t`, by place: 0 outside below, 1 .. n the cells, n + 1 outside above."""
    t: Array
    """(steps, .). [°C]"""


@compiled(fastmath=FAST)
def disturb(w, dw, shift, ambient, temperatures, power):
    """Fill what changes of the parameters do in the cells they touch: -dK T + df - dC T'.

    Parameters
    ----------
    w, dw
        Coefficients and their tangents, see `heat.step_terms`.
    shift
        Tangents of the temperatures outside below and above (2, P). [K]
    temperatures
        `Neighbourhood` at every step edge.
    power
        (P, steps, c). [W/m²]
    """
    cells, column, around = temperatures.cells, temperatures.column, temperatures.t
    n = w.shape[1] - 1
    for q in range(power.shape[0]):
        for c in range(cells.shape[0]):
            i = cells[c]
            share = dw[DCAP, q, i] / w[CAP, i]
            low, high = dw[DG, q, i] - share * w[G, i], dw[DG, q, i + 1] - share * w[G, i + 1]
            here = share * w[DIAG, i] - dw[DG, q, i] - dw[DG, q, i + 1] - dw[DLOSS, q, i] - dw[DSLOPE, q, i]
            rest = dw[DLOSS, q, i] * ambient + dw[DSRC, q, i] - share * (w[LOSS, i] * ambient + w[SRC, i])
            if i == 0:
                rest += w[G, 0] * shift[0, q]
            if i == n - 1:
                rest += w[G, n] * shift[1, q]
            below, own, above = column[i], column[i + 1], column[i + 2]
            for k in range(around.shape[0]):
                power[q, k, c] = low * around[k, below] + here * around[k, own] + high * around[k, above] + rest
