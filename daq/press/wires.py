"""What a wire shows of the press: a limit switch, or a pressure channel with two thresholds.

Both go before the temperatures, the switch before the pressure, scan by scan: where a wire says nothing
(its logger is silent), the next one decides. A contact that bounces counts from its first touch. The press
file names them (``press.limit_switch``, ``press.pressure``), a run's header may name them anew, ``[[press]]``
of the configuration the switch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from daq.press.press_file import Press, PressTable, press_for_run
from daq.records import Array, EventSource, Run

CLOSED = "closed"
"""The column of a run file that says whether the press is closed, 0 or 1."""

# Numbers without another source were set by hand, 2026-11.

SILENT_S = 5.0
"""What happens while a wire says nothing for longer is taken from the temperatures. [s]"""
_BOUNCE_S = 1.0
"""A change undone sooner is a contact that bounces: a press takes 0.2 to 1 s to close. [s]"""


class Wires:
    """Whether the press is closed by its wires, scan by scan; the pressure's state is remembered."""

    def __init__(self, table: PressTable) -> None:
        self.switches = tuple(dict.fromkeys((table.limit_switch, CLOSED)))
        self.pressure = table.pressure
        self.source = EventSource.LIMIT_SWITCH
        """Which wire spoke last."""
        self._pressed: bool | None = None
        self._closed: bool | None = None
        self._changed_s = -math.inf

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns a wire may fill."""
        return self.switches if self.pressure is None else (*self.switches, self.pressure.column)

    def unit_of(self, column: str) -> str:
        """Return a wire's unit, none for a switch."""
        pressure = self.pressure
        return pressure.unit if pressure is not None and column == pressure.column else ""

    def read(self, time_s: float, values: Mapping[str, float]) -> bool | None:
        """Return whether a scan says closed; None where no wire has a value."""
        closed = self._read(values)
        if closed is None or closed is self._closed:
            return closed
        if time_s - self._changed_s < _BOUNCE_S:
            return self._closed
        self._changed_s = -math.inf if self._closed is None else time_s
        self._closed = closed
        return closed

    def _read(self, values: Mapping[str, float]) -> bool | None:
        for name in self.switches:
            value = values.get(name, math.nan)
            if value == value:
                self.source = EventSource.LIMIT_SWITCH
                return bool(value > 0.5)
        if self.pressure is None:
            return None
        value = values.get(self.pressure.column, math.nan)
        if value != value:
            return None
        self.source = EventSource.PRESSURE_CHANNEL
        limit = self.pressure.closed_above if not self._pressed else self.pressure.lower
        self._pressed = bool(value > limit)
        return self._pressed


def closed_of(run: Run, press: Press) -> tuple[Array, EventSource] | None:
    """Return 0 or 1 a row by the run's wires, NaN where they say nothing, and which wire spoke.

    None where no wire is logged.
    """
    wires = Wires(press_for_run(press, run).press)
    names = [name for name in wires.columns if name in run.columns]
    if not names:
        return None
    switches = {name: _without_blips(run.time_s, run.columns[name]) for name in names if name in wires.switches}
    rows = zip(*(switches.get(name, run.columns[name]).tolist() for name in names), strict=True)
    times = run.time_s.tolist()
    states = [wires.read(t, dict(zip(names, row, strict=True))) for t, row in zip(times, rows, strict=True)]
    return np.array([math.nan if x is None else float(x) for x in states]), wires.source


def _without_blips(times: Array, column: Array) -> Array:
    """Return a switch without single rows that all others within a second contradict, three or more a side."""
    clean, known = column.copy(), np.flatnonzero(np.isfinite(column))
    t, closed = times[known], column[known] > 0.5
    alone = np.flatnonzero((closed[1:-1] != closed[:-2]) & (closed[1:-1] != closed[2:])) + 1
    for i in alone.tolist():
        first, end = np.searchsorted(t, t[i] - _BOUNCE_S), np.searchsorted(t, t[i] + _BOUNCE_S, side="right")
        others = np.count_nonzero(closed[first:end] != closed[i])
        if min(i - first, end - 1 - i) >= 3 and others == end - first - 1:
            clean[known[i]] = float(not closed[i])
    return clean


def without_wires(run: Run, press: Press) -> Run:
    """Return the run as the temperatures alone show it."""
    wires = Wires(press_for_run(press, run).press).columns
    return replace(run, columns={name: values for name, values in run.columns.items() if name not in wires})
