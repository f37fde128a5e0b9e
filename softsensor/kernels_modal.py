"""The compiled recurrence of decoupled modes, exact in time for inputs that are straight between steps.

Each mode obeys q' = -lam q + B u(t). Over a step of length h, with x = lam h,

    q1 = exp(-x) q0 + h [(phi1 - phi2) B u0 + phi2 B u1],   phi1 = (1 - exp(-x)) / x,  phi2 = (1 - phi1) / x

(first-order hold; Moler & Van Loan 2003 review the exponential). A mode that has decayed within the step
follows its inputs, q1 = B u1 / lam - B (u1 - u0) / (h lam²); all such modes are collapsed into gains.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_DECAYED = 37.0
"""exp(-37) is below the rounding of a double."""


@njit(cache=True)
def _hold(lam, h, active, keep, old, new):
    """Fill the factors on q0, B u0 and B u1 of the first `active` modes."""
    for j in range(active):
        x = lam[j] * h
        if x > 1e-3:
            e = np.exp(-x)
            phi1 = (1.0 - e) / x
            phi2 = (1.0 - phi1) / x
        else:
            e = np.exp(-x)
            phi1 = 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0))
            phi2 = 0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0))
        keep[j] = e
        old[j] = h * (phi1 - phi2)
        new[j] = h * phi2


@njit(cache=True, fastmath=_FAST)
def _force(B, u, forced, s, row, active, z):
    """Write system s's B u, or the given forces, of the first `active` modes into z."""
    if forced.shape[0] > 0:
        for j in range(active):
            z[j] = forced[s, row, j]
        return
    first, v = B[s, 0], u[s, row, 0]
    for j in range(active):
        z[j] = first[j] * v
    for c in range(1, B.shape[1]):
        b, v = B[s, c], u[s, row, c]
        if v != 0.0:
            for j in range(active):
                z[j] += b[j] * v


@njit(cache=True, fastmath=_FAST)
def _follow(lam, z0, z1, h, first, last, q):
    """Set decayed modes to what their inputs hold them at."""
    for j in range(first, last):
        inverse = 1.0 / lam[j]
        q[j] = inverse * (z1[j] - (z1[j] - z0[j]) * inverse / h)


@njit(cache=True, nogil=True, fastmath=_FAST)
def modes(lam, B, read, h, u, forced, q, out, history):
    """Carry the modes of several systems over steps and read outputs off after each.

    The systems share rates, steps and outputs, not inputs: the temperatures are one, every tangent another.

    Parameters
    ----------
    lam
        Rates, rising (n). [1/s]
    B, u
        Gains of the inputs (s, c, n) and inputs at the step edges (s, steps + 1, c).
    forced
        Instead of B u: forces on the modes at the step edges (s, steps + 1, n), or no systems.
    read
        Outputs in terms of modes (m, n).
    q
        Modes, changed in place (s, n).
    out
        Outputs (s, steps + 1, m); their first row is left alone.
    history
        Modes at the step edges (s, steps + 1, n), filled if there are systems; first row left alone.
    """
    n, m, steps, systems, c = lam.shape[0], read.shape[0], h.shape[0], B.shape[0], B.shape[1]
    keep, old, new = np.zeros(n), np.zeros(n), np.zeros(n)
    z0, z1 = np.zeros((systems, n)), np.zeros(n)
    gain, drop = np.zeros((systems, m, c)), np.zeros((systems, m, c))
    whole = forced.shape[0] > 0 or history.shape[0] > 0
    length, active = -1.0, n
    for s in range(systems):
        _force(B, u, forced, s, 0, n, z0[s])
    for k in range(steps):
        if h[k] != length:
            if active < n and not whole:
                _settle(lam, B, u, forced, k, length, active, z0, z1, q)
            length = h[k]
            active = n
            while active > 1 and lam[active - 1] * length > _DECAYED:
                active -= 1
            _hold(lam, length, active, keep, old, new)
            if not whole:
                _collapse(lam, B, read, length, active, gain, drop)
        reach = n if whole else active
        for s in range(systems):
            before, x = z0[s], q[s]
            _force(B, u, forced, s, k + 1, reach, z1)
            for j in range(active):
                x[j] = keep[j] * x[j] + old[j] * before[j] + new[j] * z1[j]
            if whole:
                _follow(lam, before, z1, length, active, n, x)
            for a in range(m):
                row = read[a]
                value = 0.0
                for j in range(reach):
                    value += row[j] * x[j]
                if not whole:
                    for i in range(c):
                        value += gain[s, a, i] * u[s, k + 1, i] - drop[s, a, i] * (u[s, k + 1, i] - u[s, k, i])
                out[s, k + 1, a] = value
            if history.shape[0] > 0:
                for j in range(n):
                    history[s, k + 1, j] = x[j]
            for j in range(reach):
                before[j] = z1[j]
    if active < n and not whole:
        _settle(lam, B, u, forced, steps, length, active, z0, z1, q)


@njit(cache=True, fastmath=_FAST)
def _settle(lam, B, u, forced, k, length, active, z0, z1, q):
    """Set the decayed modes at step edge k, and all forces there."""
    n = lam.shape[0]
    for s in range(q.shape[0]):
        _force(B, u, forced, s, k - 1, n, z1)
        _force(B, u, forced, s, k, n, z0[s])
        _follow(lam, z1, z0[s], length, active, n, q[s])


@njit(cache=True, fastmath=_FAST)
def _collapse(lam, B, read, length, active, gain, drop):
    """Sum the decayed modes' answers to inputs and to their changes."""
    for s in range(B.shape[0]):
        for i in range(B.shape[1]):
            b = B[s, i]
            for a in range(read.shape[0]):
                row = read[a]
                g, d = 0.0, 0.0
                for j in range(active, lam.shape[0]):
                    part = row[j] * b[j] / lam[j]
                    g += part
                    d += part / (lam[j] * length)
                gain[s, a, i] = g
                drop[s, a, i] = d
