"""What else one could say of the core of a virtual pressing: an open loop, and a Kalman filter on a fine grid.

Both know what a laboratory knows: the header's constants, coefficients of earlier runs, and when the press moved.
The open loop follows the platens alone and gives a number without a band. The filter (36 cells through plates and
panel, the exact propagator of a step) is corrected by the faces' means; what its model lacks is white noise in
every cell, of the strength that suits the true cores of two earlier runs best, which no laboratory has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from daq.press.header import panel_of
from daq.press.press_file import Press
from daq.records import Array, Run
from softsensor.heat.assembly import layer_constants
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import ModelFile
from softsensor.signals.instrument import CHANNEL_K
from softsensor.signals.moments import moments_of

CELLS = {"plate_bottom": 6, "panel": 24, "plate_top": 6}
N = sum(CELLS.values())
FIRST, LAST = CELLS["plate_bottom"], CELLS["plate_bottom"] + CELLS["panel"]
"""The panel's cells; behind all cells follow both platens and the room, which are given."""
TICK_S = 0.05
"""Scans' times are rounded to it, so that few propagators are needed. [s]"""
NOISES = 10.0 ** np.arange(-5.0, 1.0)
"""Strengths of noise in a cell that are tried. [K²/s]"""
PLATE_K, PANEL_K = 2.0, 1.0
"""What plates and panel may be off at the start. [K]"""


def open_loop(press: Press, run: Run, model: ModelFile) -> Array:
    """Return the core by platens and model alone (scans). [°C]"""
    thermal = ThermalModel(press)
    case = thermal.prepare(run, moments_of(run, press))
    return thermal.solve(case, {n: e.value for n, e in model.coefficients.items()}).core


@dataclass(frozen=True)
class Rates:
    """What drives each cell, open and closed. [1/s]"""

    opened: Array
    closed: Array

    @staticmethod
    def of(press: Press, run: Run, model: ModelFile) -> Rates:
        """Lay out plate, panel and plate of a run."""
        cells = list(CELLS.values())
        parts = [layer_constants(press, name, panel_of(run)) for name in CELLS]
        thick, k, c = (np.repeat([part[i] for part in parts], cells) for i in range(3))
        h = {n: e.value for n, e in model.coefficients.items()}
        dx = thick / np.repeat(cells, cells)
        return Rates(*(_rates(dx, dx / (2.0 * k), c * dx, h, closed=closed) for closed in (False, True)))


def _rates(dx: Array, half: Array, holds: Array, h: Mapping[str, float], *, closed: bool) -> Array:
    """Return the rates; `half` resists from a cell's middle to its face [m²K/W], `holds` its heat [J/m²K]."""
    low, high, room = N, N + 1, N + 2
    found = np.zeros((N + 3, N + 3))

    def join(i: int, j: int, contact: float = np.inf) -> None:
        flow = 1.0 / (sum(half[m] for m in (i, j) if m < N) + 1.0 / contact)
        for own, other in ((i, j), (j, i)):
            if own < N:
                found[own, [own, other]] += np.array([-flow, flow]) / holds[own]

    for i in range(N - 1):
        if i + 1 not in (FIRST, LAST):
            join(i, i + 1)
    outer = h["h_p_c" if closed else "h_p_o"]
    join(0, low, outer)
    join(N - 1, high, outer)
    join(FIRST - 1, FIRST, h["h_pp_c" if closed else "h_pp_o"])
    if closed:
        join(LAST - 1, LAST, h["h_pp_c"])
    else:
        join(LAST - 1, room, h["h_wa"])
        join(LAST, room, h["h_ap"])
    return found


def filtered(rates: Rates, press: Press, run: Run, noise: float) -> tuple[Array, Array]:
    """Return mean [°C] and standard deviation [K] of the core (scans)."""
    moments = moments_of(run, press)
    read, core = np.zeros((2, N + 3)), np.zeros(N + 3)
    read[[0, 0, 1, 1], [FIRST, FIRST + 1, LAST - 1, LAST - 2]] = 1.5, -0.5, 1.5, -0.5
    core[[N // 2 - 1, N // 2]] = 0.5
    measured, errors = _faces(run)
    platens = np.stack([run.columns["platen_bottom"], run.columns["platen_top"]], axis=1)
    ticks = np.round(run.time_s / TICK_S).astype(int)
    closed = (run.time_s >= moments.closed_s) & ~(run.time_s >= moments.opened_s)
    begin = int(np.searchsorted(run.time_s, np.nan_to_num(moments.inserted_s)))
    x = np.repeat([platens[begin, 0], panel_of(run).initial_temperature, platens[begin, 1]], list(CELLS.values()))
    x = np.append(x, [*platens[begin], run.ambient_temperature])
    start = np.repeat([PLATE_K, PANEL_K, PLATE_K, 0.0], [*CELLS.values(), 3])
    P, added = np.diag(start**2), np.diag(noise * (start > 0.0))
    steps: dict[tuple[int, bool], Array] = {}
    found = np.full((2, len(ticks)), np.nan)
    for i in range(begin, len(ticks)):
        x[N : N + 2] = np.where(np.isfinite(platens[i]), platens[i], x[N : N + 2])
        if i > begin:
            key = int(ticks[i] - ticks[i - 1]), bool(closed[i])
            if key not in steps:
                steps[key] = expm((rates.closed if key[1] else rates.opened) * key[0] * TICK_S)
            F = steps[key]
            x, P = F @ x, F @ P @ F.T + added * key[0] * TICK_S
        seen = np.isfinite(measured[i])
        if seen.any():
            H = read[seen]
            S, away = H @ P @ H.T + errors[seen][:, seen], measured[i, seen] - H @ x
            gain = np.linalg.solve(S, H @ P).T
            x, P = x + gain @ away, P - gain @ (H @ P)
        found[:, i] = core @ x, np.sqrt(core @ P @ core)
    return found[0], found[1]


def _faces(run: Run) -> tuple[Array, Array]:
    """Return the faces' means, NaN where nothing reads (scans, 2), and their errors' covariance. [°C, K²]"""
    own = [np.stack([v for n, v in run.columns.items() if n.startswith(f"{s}_")]) for s in ("bottom", "top")]
    sound = [np.isfinite(v).sum(axis=0) for v in own]
    mean = [np.nansum(v, axis=0) / np.where(n > 0, n, np.nan) for v, n in zip(own, sound, strict=True)]
    return np.stack(mean, axis=1), np.diag([CHANNEL_K**2 / len(v) for v in own])
