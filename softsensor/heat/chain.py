"""The measuring chain: what a panel channel reads of the solver's temperatures, at the run's rows.

It reads, in this order: a mixture with the press face (footprint), late (lag), on its own clock (offset).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.heat import implicit_steps
from softsensor.heat.build import Build
from softsensor.heat.case import Case
from softsensor.heat.readout import Derivatives, Reader


@dataclass(frozen=True)
class Solution:
    """What the model says about a run."""

    columns: tuple[str, ...]
    sensors: Array
    """Panel channels as their thermocouples would read (rows, columns). [°C]"""
    core: Array
    """Middle of the panel (rows). [°C]"""
    places: Array
    """True temperature at each of the case's places (rows, places). [°C]"""
    d_sensors: Mapping[str, Array]
    """Derivative of `sensors` by parameter."""
    d_core: Mapping[str, Array]
    closed_share: Array
    """0 open .. 1 closed at each row."""
    fields: Array
    """Cell temperatures at every step edge (steps + 1, n), empty unless asked for. [°C]"""
    final: implicit_steps.State

    __repr__ = on_screen

    def column(self, name: str) -> Array:
        """Return one channel (rows). [°C]"""
        return np.asarray(self.sensors[:, self.columns.index(name)])


def read_places(case: Case, build: Build) -> Array:
    """Return the weights that read off the places, and the press faces opposite them where they mix in (m, n)."""
    faces = build.terms.footprint != 0 or any(t.footprint != 0 for t in build.request.d_terms.values())
    return np.concatenate([case.places, case.press_face]) if faces else case.places


def observe(case: Case, build: Build, record: implicit_steps.Record) -> Solution:
    """Apply the measuring chain and read off the rows."""
    names, terms, d_terms, m = build.request.names, build.terms, build.request.d_terms, len(case.places)
    out, d_out = record.out, record.d_out[: len(names)]
    true, d_true = out[:, :m], d_out[:, :, :m]
    rows = case.reader(true)
    d_rows = case.reader(d_true) if names else np.empty((0, *rows.shape))
    true_rows, d_core = rows, d_rows[:, :, m - 1]
    d_lag = np.array([float(d_terms[name].lag) if name in d_terms else 0.0 for name in names])
    lag, clock = float(terms.lag), float(terms.clock)
    y, dy = true, d_true
    if out.shape[1] > m:
        y, dy = _mix_footprint(case, build, out, d_out)
    if lag != 0.0 or d_lag.any():
        y, dy = y.copy(), dy.copy()
        implicit_steps.delay(case.h, y, dy, max(lag, 1e-3), d_lag)
    times = case.run.time_s - clock
    if clock != 0.0 or y is not true:
        read = Reader.at(case.edges, times) if clock != 0.0 else case.reader
        rows, d_rows = read(y), read(dy)
    for i, name in enumerate(names):
        if name in d_terms and d_terms[name].clock:
            slope = Reader.at(case.edges, times, slope=True) if clock != 0.0 else case.slope_reader
            d_rows = d_rows.copy() if d_core.base is d_rows else d_rows
            d_rows[i] -= float(d_terms[name].clock) * slope(y)
    columns = tuple(case.place_of[c] for c in case.columns)
    return Solution(
        columns=case.columns,
        sensors=rows[:, columns],
        core=true_rows[:, m - 1],
        places=true_rows,
        d_sensors=Derivatives(names, d_rows, columns),
        d_core={name: d_core[i] for i, name in enumerate(names)},
        closed_share=case.row_clock.shares(build.request.values)[0][:, 2],
        fields=record.fields,
        final=build.start,
    )


def _mix_footprint(case: Case, build: Build, out: Array, d_out: Array) -> tuple[Array, Array]:
    """Mix the opposite press face into the panel's surface sensors while closed."""
    request, m = build.request, len(case.places)
    y, dy = out[:, :m].copy(), d_out[:, :, :m].copy()
    w = float(request.terms.footprint)
    shares, d_shares = case.edge_clock.shares(request.values, request.names)
    closed, d_closed = shares[:, 2], d_shares[:, 2]
    for place in np.flatnonzero(case.press_face.any(axis=1)):
        gap = out[:, m + place] - y[:, place]
        d_gap = d_out[:, :, m + place] - dy[:, :, place]
        y[:, place] += w * closed * gap
        dy[:, :, place] += w * closed * d_gap + w * gap * d_closed.T
        for name, terms in request.d_terms.items():
            dy[request.names.index(name), :, place] += float(terms.footprint) * closed * gap
    return y, dy
