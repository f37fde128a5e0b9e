"""The compiled loop for many runs at once: implicit steps of linear stacks, without tangents.

Eight or more runs are carried side by side, each in a lane of arrays (cells, lanes), so that one processor
instruction serves several runs and no run waits for the last product of its own elimination.

With temperatures counted from ambient, losses and volumetric exchange have no source, and both stages of
TR-BDF2 (see `kernels`) become the same system with another right-hand side, without a product K T:

    (C + d h K) u  = C T                      + d h g (T_out at 0 + T_out at gamma h) / 2 + d h f
    (C + d h K) T' = C (kappa u - sqrt(2) T)  + d h g T_out at h                          + d h f

where d = 1 - 1/sqrt(2), gamma = 2 d, kappa = 1 + sqrt(2), and f is a flux through an end. The results differ
from those of `kernels.march` by rounding only.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softsensor.kernels_terms import CAP, DIAG, DROWS, LOSS, ROWS, SLOPE, SRC, STAR, G, coefficients, contacts

_GAMMA = 2.0 - 2.0**0.5
_D = _GAMMA / 2.0
_ROOT = 2.0**0.5
_KAPPA = 1.0 + 2.0**0.5
_FAST = {"contract", "reassoc", "nsz", "arcp"}
LANES = 8
"""Runs side by side: few enough that their arrays stay in the fastest cache."""
SPAN = 3
"""Most neighbouring cells a place is read from."""


@njit(cache=True, nogil=True)
def lay_out(
    stack, tan, drive, state, places, lane, h, group, outer, joints, joint, ends, cap, g, diag, t, reach, first,
    weights,
):  # fmt: skip
    """Fill one lane with a run: its coefficients once in full, then what the press's states change.

    Parameters
    ----------
    h, group
        Step lengths, 0 where the run has ended [s], and the row of `joint` and `ends` a step uses
        (steps, lanes).
    outer
        Outside temperatures over ambient: means over and changes across steps (steps, 4, lanes). [K]
    joints, joint
        Interface of each contact (lanes, m), and by group its conductance and the diagonals of the cells
        below and above (lanes, groups, m, 3). [W/m²K]
    ends
        By group, of bottom and top: conductance and power (lanes, groups, 4). [W/m²K, W/m²]
    cap, g, diag, t
        Of the cells (n, lanes); `t` over ambient. Cells the run lacks stay at ambient.
    reach
        Cells of each run (lanes).
    first, weights
        First cell and weights of each place (lanes, places), (lanes, places, 3).
    """
    n, steps = stack.dx.shape[0], drive.h.shape[0]
    w, dw = np.zeros((ROWS, n + 1)), np.zeros((DROWS, 0, n + 1))
    rate, drate = np.zeros((0, 2, n)), np.zeros((0, 2, 0, n))
    reach[lane] = n
    for i in range(n):
        w[STAR, i] = state.t[i]
        t[i, lane] = state.t[i] - stack.ambient
    for i in range(n, cap.shape[0]):
        cap[i, lane], diag[i, lane], g[i, lane], t[i, lane] = 1.0, 0.0, 0.0, 0.0
    row = np.int64(-1)
    for step in range(h.shape[0]):
        if step >= steps:
            h[step, lane], group[step, lane] = 0.0, row
            for end in range(4):
                outer[step, end, lane] = 0.0
            continue
        h[step, lane] = drive.h[step]
        if step == 0:
            coefficients(stack, tan, drive, np.int64(0), 1.0, state.done, state.s_done, w, dw, rate, drate)
            for i in range(n):
                cap[i, lane], diag[i, lane], g[i, lane] = w[CAP, i], w[DIAG, i], w[G, i]
            g[0, lane] = 0.0
        changed = step == 0 or _differs(drive.weight, drive.factor, step)
        if changed and step > 0:
            # exchange stays; a flux adds to the source of its end cell anew
            w[SRC, 0] = w[SLOPE, 0] * stack.ambient
            w[SRC, n - 1] = w[SLOPE, n - 1] * stack.ambient
            contacts(
                stack.dx, stack.interface, stack.contact, tan.contact, stack.parts, stack.bare, stack.emissivity,
                tan.emissivity, stack.measured, stack.flux, tan.flux,
                drive.weight[step], drive.d_weight[step], drive.factor[step], drive.d_factor[step], w, dw,
            )  # fmt: skip
        if changed:
            row += 1
            for m in range(stack.interface.shape[0]):
                j = stack.interface[m]
                joints[lane, m] = j
                joint[lane, row, m, 0] = w[G, j]
                joint[lane, row, m, 1] = _diagonal(w, max(j - 1, 0))
                joint[lane, row, m, 2] = _diagonal(w, min(j, n - 1))
            for end in range(2):
                i = 0 if end == 0 else n - 1
                ends[lane, row, 2 * end] = w[G, 0 if end == 0 else n]
                ends[lane, row, 2 * end + 1] = w[SRC, i] - w[SLOPE, i] * stack.ambient
            if n == 1:
                ends[lane, row, 3] = 0.0
        group[step, lane] = row
        for end in range(2):
            here = stack.measured[end]
            mean = drive.boundary[step, end, 0] if here else stack.flux[end, 2]
            outer[step, 2 * end, lane] = mean - stack.ambient
            outer[step, 2 * end + 1, lane] = drive.boundary[step, end, 1] if here else 0.0
    for m in range(stack.interface.shape[0], joints.shape[1]):
        joints[lane, m] = -1
    for a in range(places.shape[0]):
        begin = 0
        while begin < n - 1 and places[a, begin] == 0.0:
            begin += 1
        first[lane, a] = begin
        for b in range(SPAN):
            weights[lane, a, b] = places[a, begin + b] if begin + b < n else 0.0


@njit(cache=True)
def _diagonal(w, i):
    return w[G, i] + w[G, i + 1] + w[LOSS, i] + w[SLOPE, i]


@njit(cache=True)
def _differs(weight, factor, step):
    """Whether a step's contacts differ from those of the step before."""
    for s in range(3):
        if weight[step, s] != weight[step - 1, s]:
            return True
    count = 0
    for m in range(factor.shape[1]):
        if factor[step, m] != factor[step - 1, m]:
            count += 1
    return count > 0


@njit(cache=True, nogil=True, fastmath=_FAST)
def march_lanes(h, group, outer, joints, joint, ends, cap, g, diag, t, reach, first, weights, ambient, out):
    """Take all steps of all lanes; write the places before the first step and after each.

    Arrays as `lay_out` fills them; `ambient` (runs) [°C], `out` (runs, steps + 1, places) [°C]. There may
    be fewer runs than lanes.
    """
    steps, runs = h.shape[0], out.shape[0]
    size = cap.size
    keep, low, back, u, dh = np.empty(size), np.zeros(size), np.zeros(size), np.empty(size), np.zeros(size)
    caps, gs, diags, ts = cap.reshape(size), g.reshape(size), diag.reshape(size), t.reshape(size)
    source = np.zeros((4, LANES))
    length, now = np.full(LANES, -1.0), np.full(LANES, -1)
    _read(t, first, weights, ambient, out, np.int64(0))
    for step in range(steps):
        stale = False
        for x in range(runs):
            if group[step, x] != now[x]:
                now[x] = group[step, x]
                _switch(joints[x], joint[x, now[x]], reach[x], x, g, diag)
                stale = True
            if h[step, x] != length[x]:
                length[x] = h[step, x]
                stale = True
                for i in range(cap.shape[0]):
                    dh[i * LANES + x] = _D * length[x]
        if stale:
            _factor(caps, diags, gs, dh, keep, low, back)
        for x in range(runs):
            last = (reach[x] - 1) * LANES + x
            b0, b1, b2, b3 = outer[step, 0, x], outer[step, 1, x], outer[step, 2, x], outer[step, 3, x]
            g0, f0, g1, f1 = ends[x, now[x], 0], ends[x, now[x], 1], ends[x, now[x], 2], ends[x, now[x], 3]
            f, s = dh[x] * keep[x] / caps[x], dh[x] * keep[last] / caps[last]
            source[0, x] = f * (f0 + g0 * (b0 + 0.5 * (_GAMMA - 1.0) * b1))
            source[1, x] = s * (f1 + g1 * (b2 + 0.5 * (_GAMMA - 1.0) * b3))
            source[2, x] = f * (f0 + g0 * (b0 + 0.5 * b1))
            source[3, x] = s * (f1 + g1 * (b2 + 0.5 * b3))
        _first_stage(keep, low, back, source[0], source[1], reach, ts, u)
        _second_stage(keep, low, back, source[2], source[3], reach, u, ts)
        _read(t, first, weights, ambient, out, step + 1)


@njit(cache=True)
def _switch(joints, joint, n, x, g, diag):
    """Put a run's contacts into the state of another group."""
    for m in range(joints.shape[0]):
        j = joints[m]
        if j < 0:
            continue
        if 0 < j < n:
            g[j, x] = joint[m, 0]
        diag[max(j - 1, 0), x] = joint[m, 1]
        diag[min(j, n - 1), x] = joint[m, 2]


# Below, arrays (cells, lanes) are taken flat: a loop over all of them whose values depend on those one cell,
# that is LANES values, before is turned into vector instructions, and overlap is checked once a loop.


@njit(cache=True, fastmath=_FAST)
def _factor(cap, diag, g, dh, keep, low, back):
    """Factor C + d h K by elimination without pivoting; g of the lowest interface is 0."""
    size = cap.shape[0]
    for k in range(LANES):
        keep[k] = 1.0 / (cap[k] + dh[k] * diag[k])
    for k in range(size - LANES):
        hold = dh[k + LANES] * g[k + LANES]
        low[k + LANES] = hold
        keep[k + LANES] = 1.0 / (cap[k + LANES] + dh[k + LANES] * diag[k + LANES] - hold * hold * keep[k])
    for k in range(size - LANES):
        back[k] = low[k + LANES] * keep[k]
    for k in range(size):
        low[k] *= keep[k]
        keep[k] *= cap[k]


@njit(cache=True, fastmath=_FAST)
def _first_stage(keep, low, back, bottom, top, reach, t, u):
    """Set u to the solution of the first stage."""
    for k in range(LANES):
        u[k] = keep[k] * t[k] + bottom[k]
    for k in range(t.shape[0] - LANES):
        u[k + LANES] = keep[k + LANES] * t[k + LANES] + low[k + LANES] * u[k]
    _substitute(back, top, reach, u)


@njit(cache=True, fastmath=_FAST)
def _second_stage(keep, low, back, bottom, top, reach, u, t):
    """Set t to the solution of the second stage."""
    for k in range(LANES):
        t[k] = keep[k] * (_KAPPA * u[k] - _ROOT * t[k]) + bottom[k]
    for k in range(t.shape[0] - LANES):
        x = keep[k + LANES] * (_KAPPA * u[k + LANES] - _ROOT * t[k + LANES])
        t[k + LANES] = x + low[k + LANES] * t[k]
    _substitute(back, top, reach, t)


@njit(cache=True, fastmath=_FAST)
def _substitute(back, top, reach, y):
    """Add what enters each run's top cell and substitute downwards."""
    for x in range(LANES):
        y[(reach[x] - 1) * LANES + x] += top[x]
    for k in range(y.shape[0] - LANES - 1, -1, -1):
        y[k] += back[k] * y[k + LANES]


@njit(cache=True, fastmath=_FAST)
def _read(t, first, weights, ambient, out, row):
    """Read the places off every run."""
    for x in range(out.shape[0]):
        for a in range(out.shape[2]):
            i = first[x, a]
            value = 0.0
            for b in range(weights.shape[2]):
                if weights[x, a, b] != 0.0:
                    value += weights[x, a, b] * (t[i + b, x] + ambient[x])
            out[x, row, a] = value
