"""The compiled loop for many runs at once: implicit steps of linear stacks, without tangents.

Eight or more runs are carried side by side, each in a lane of arrays (cells, lanes), so that one processor
instruction serves several runs and no run waits for the last product of its own elimination.

With temperatures counted from ambient, losses and volumetric exchange have no source, and both stages of
TR-BDF2 (see `implicit_steps`) become the same system with another right-hand side, without a product K T:

    (C + d h K) u  = C T                      + d h g (T_out at 0 + T_out at gamma h) / 2 + d h f
    (C + d h K) T' = C (kappa u - sqrt(2) T)  + d h g T_out at h                          + d h f

where d = 1 - 1/sqrt(2), gamma = 2 d, kappa = 1 + sqrt(2), and f is a flux through an end. The results differ
from those of `implicit_steps.march` by rounding only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.compiled import compiled
from softsensor.heat.step_terms import (
    CAP,
    DIAG,
    FAST,
    GAMMA,
    LOSS,
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
    coefficients,
    contacts,
    room,
)

# Numbers without another source were set by hand, 2026-11.

_ROOT, _KAPPA = 2.0**0.5, 1.0 + 2.0**0.5
"""TR-BDF2's second stage starts from _KAPPA u - _ROOT t, with t the step's begin and u the mean of it and the
first stage: _KAPPA = 2 `implicit_steps._W` / `D`, _ROOT = _KAPPA - 1."""
LANES = 8
"""Runs side by side: few enough that their arrays stay in the fastest cache."""
SPAN = 3
"""Most neighbouring cells a place is read from."""


class Ready(NamedTuple):
    """One run, ready to be laid into a lane."""

    stack: Stack
    tan: Tangents
    drive: Drive
    state: State
    places: Array
    """Weights of the places (m, n)."""


class Lanes(NamedTuple):
    """Runs side by side. `fill_lane` fills one lane, `march_lanes` changes the cells."""

    h: Array
    """Step lengths, 0 where the run has ended (steps, lanes). [s]"""
    group: Integers
    """The row of `joint` and `ends` a step uses (steps, lanes)."""
    outer: Array
    """Outside temperatures over ambient: means over and changes across steps (steps, 4, lanes). [K]"""
    joints: Integers
    """Interface of each contact (lanes, contacts)."""
    joint: Array
    """By group each contact's conductance, and the diagonals of the cells below and above
    (lanes, groups, contacts, 3). [W/m²K]"""
    ends: Array
    """By group, of bottom and top: conductance and power (lanes, groups, 4). [W/m²K, W/m²]"""
    cap: Array
    """Of the cells (n, lanes), as `g`, `diag` and `t`; cells the run lacks stay at ambient. [J/m²K]"""
    g: Array
    diag: Array
    t: Array
    """Over ambient. [K]"""
    reach: Integers
    """Cells of each run (lanes)."""
    first: Integers
    """First cell of each place (lanes, m)."""
    weights: Array
    """(lanes, m, `SPAN`)"""
    ambient: Array
    """(lanes). [°C]"""

    @staticmethod
    def empty(runs: int, steps: int, cells: int, contacts: int, places: int) -> Lanes:
        """Return room for runs of at most so many steps, cells, contacts and places."""
        side = (cells, LANES)
        return Lanes(
            h=np.empty((steps, runs)), group=np.empty((steps, runs), np.int64), outer=np.empty((steps, 4, runs)),
            joints=np.empty((runs, contacts), np.int64), joint=np.empty((runs, steps, contacts, 3)),
            ends=np.empty((runs, steps, 4)), cap=np.ones(side), g=np.zeros(side), diag=np.zeros(side),
            t=np.zeros(side), reach=np.ones(LANES, np.int64), first=np.zeros((runs, places), np.int64),
            weights=np.zeros((runs, places, SPAN)), ambient=np.zeros(runs),
        )  # fmt: skip


class Flat(NamedTuple):
    """Cells of all lanes one after the other, and the factors of their matrices (cells x lanes)."""

    cap: Array
    g: Array
    diag: Array
    t: Array
    dh: Array
    """d times the step's length. [s]"""
    keep: Array
    low: Array
    back: Array
    u: Array
    """Temperatures of the first stage."""


@compiled(nogil=True)
def fill_lane(run, lane, lanes):
    """Fill one lane with a run: its coefficients once in full, then what the press's states change."""
    stack, tan, drive, state = run.stack, run.tan, run.drive, run.state
    h, group, outer, ends = lanes.h, lanes.group, lanes.outer, lanes.ends
    cap, g, diag, t = lanes.cap, lanes.g, lanes.diag, lanes.t
    n, steps = stack.dx.shape[0], drive.h.shape[0]
    co = room(np.int64(0), np.int64(0), n)
    w = co.w
    lanes.reach[lane], lanes.ambient[lane] = n, stack.ambient
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
            coefficients(stack, tan, drive, np.int64(0), state, co)
            for i in range(n):
                cap[i, lane], diag[i, lane], g[i, lane] = w[CAP, i], w[DIAG, i], w[G, i]
            g[0, lane] = 0.0
        changed = step == 0 or _differs(drive.weight, drive.factor, step)
        if changed and step > 0:
            # exchange stays; a flux adds to the source of its end cell anew
            w[SRC, 0] = w[SLOPE, 0] * stack.ambient
            w[SRC, n - 1] = w[SLOPE, n - 1] * stack.ambient
            contacts(stack, tan, drive, step, co)
        if changed:
            row += 1
            _join(stack.interface, w, lanes, lane, row)
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
    lanes.joints[lane, stack.interface.shape[0] :] = -1
    _place(run.places, lanes, lane)


@compiled(inner=True)
def _join(interface, w, lanes, lane, row):
    """Write a group's contacts."""
    n = w.shape[1] - 1
    for m in range(interface.shape[0]):
        j = interface[m]
        lanes.joints[lane, m] = j
        lanes.joint[lane, row, m, 0] = w[G, j]
        lanes.joint[lane, row, m, 1] = _diagonal(w, max(j - 1, 0))
        lanes.joint[lane, row, m, 2] = _diagonal(w, min(j, n - 1))


@compiled(inner=True)
def _place(places, lanes, lane):
    """Write each place's first cell and the weights from there."""
    n = places.shape[1]
    for a in range(places.shape[0]):
        begin = 0
        while begin < n - 1 and places[a, begin] == 0.0:
            begin += 1
        lanes.first[lane, a] = begin
        for b in range(SPAN):
            lanes.weights[lane, a, b] = places[a, begin + b] if begin + b < n else 0.0


@compiled(inner=True)
def _diagonal(w, i):
    return w[G, i] + w[G, i + 1] + w[LOSS, i] + w[SLOPE, i]


@compiled(inner=True)
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


@compiled(nogil=True, fastmath=FAST)
def march_lanes(lanes, out):
    """Take all steps of all lanes; write the places before the first step and after each.

    `out` (runs, steps + 1, places) [°C]; there may be fewer runs than lanes.
    """
    h, group, outer, ends, reach = lanes.h, lanes.group, lanes.outer, lanes.ends, lanes.reach
    steps, runs, cells = h.shape[0], out.shape[0], lanes.cap.shape[0]
    size = lanes.cap.size
    flat = Flat(
        lanes.cap.reshape(size), lanes.g.reshape(size), lanes.diag.reshape(size), lanes.t.reshape(size),
        np.zeros(size), np.empty(size), np.zeros(size), np.zeros(size), np.empty(size),
    )  # fmt: skip
    caps, keep, dh = flat.cap, flat.keep, flat.dh
    source = np.zeros((4, LANES))
    length, now = np.full(LANES, -1.0), np.full(LANES, -1)
    _read(lanes, out, np.int64(0))
    for step in range(steps):
        stale = False
        for x in range(runs):
            if group[step, x] != now[x]:
                now[x] = group[step, x]
                _switch(lanes, x, now[x])
                stale = True
            if h[step, x] != length[x]:
                length[x] = h[step, x]
                stale = True
                for i in range(cells):
                    dh[i * LANES + x] = D * length[x]
        if stale:
            _factor(flat)
        for x in range(runs):
            last = (reach[x] - 1) * LANES + x
            b0, b1, b2, b3 = outer[step, 0, x], outer[step, 1, x], outer[step, 2, x], outer[step, 3, x]
            g0, f0, g1, f1 = ends[x, now[x], 0], ends[x, now[x], 1], ends[x, now[x], 2], ends[x, now[x], 3]
            f, s = dh[x] * keep[x] / caps[x], dh[x] * keep[last] / caps[last]
            source[0, x] = f * (f0 + g0 * (b0 + 0.5 * (GAMMA - 1.0) * b1))
            source[1, x] = s * (f1 + g1 * (b2 + 0.5 * (GAMMA - 1.0) * b3))
            source[2, x] = f * (f0 + g0 * (b0 + 0.5 * b1))
            source[3, x] = s * (f1 + g1 * (b2 + 0.5 * b3))
        _first_stage(flat, source[0], source[1], reach)
        _second_stage(flat, source[2], source[3], reach)
        _read(lanes, out, step + 1)


@compiled(inner=True)
def _switch(lanes, x, row):
    """Put a run's contacts into the state of another group."""
    joints, joint, n, g, diag = lanes.joints[x], lanes.joint[x, row], lanes.reach[x], lanes.g, lanes.diag
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


@compiled(fastmath=FAST)
def _factor(flat):
    """Factor C + d h K by elimination without pivoting; g of the lowest interface is 0."""
    cap, diag, g, dh, keep, low, back = flat.cap, flat.diag, flat.g, flat.dh, flat.keep, flat.low, flat.back
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


@compiled(inner=True, fastmath=FAST)
def _first_stage(flat, bottom, top, reach):
    """Set u to the solution of the first stage."""
    keep, low, t, u = flat.keep, flat.low, flat.t, flat.u
    for k in range(LANES):
        u[k] = keep[k] * t[k] + bottom[k]
    for k in range(t.shape[0] - LANES):
        u[k + LANES] = keep[k + LANES] * t[k + LANES] + low[k + LANES] * u[k]
    _substitute(flat.back, top, reach, u)


@compiled(inner=True, fastmath=FAST)
def _second_stage(flat, bottom, top, reach):
    """Set t to the solution of the second stage."""
    keep, low, t, u = flat.keep, flat.low, flat.t, flat.u
    for k in range(LANES):
        t[k] = keep[k] * (_KAPPA * u[k] - _ROOT * t[k]) + bottom[k]
    for k in range(t.shape[0] - LANES):
        x = keep[k + LANES] * (_KAPPA * u[k + LANES] - _ROOT * t[k + LANES])
        t[k + LANES] = x + low[k + LANES] * t[k]
    _substitute(flat.back, top, reach, t)


@compiled(inner=True, fastmath=FAST)
def _substitute(back, top, reach, y):
    """Add what enters each run's top cell and substitute downwards."""
    for x in range(LANES):
        y[(reach[x] - 1) * LANES + x] += top[x]
    for k in range(y.shape[0] - LANES - 1, -1, -1):
        y[k] += back[k] * y[k + LANES]


@compiled(inner=True, fastmath=FAST)
def _read(lanes, out, row):
    """Read the places off every run."""
    t, first, weights, ambient = lanes.t, lanes.first, lanes.weights, lanes.ambient
    for x in range(out.shape[0]):
        for a in range(out.shape[2]):
            i = first[x, a]
            value = 0.0
            for b in range(weights.shape[2]):
                if weights[x, a, b] != 0.0:
                    value += weights[x, a, b] * (t[i + b, x] + ambient[x])
            out[x, row, a] = value
