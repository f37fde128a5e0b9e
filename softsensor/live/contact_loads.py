"""What presses on contacts, as the live sensor follows it: a load column scan by scan, and what it does.

A fit knows a run's loads beforehand, the live sensor one scan at a time. So the factors of closed contacts are
tabulated twice: over the time since closing at the first scan's load (`march_steps.Factors`), and over the load,
whose factor multiplies the other: exact for effects that are products of a function of time and one of load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from daq.press.press_file import Press
from daq.records import Array
from softsensor.effects.contact_load import LEAST_LOAD
from softsensor.heat.case import Case

MOST = 1.0 / LEAST_LOAD
"""Largest load of the table, as a multiple of the reference: as far up as down; beyond, the factor stays."""


class HeldLoads:
    """Logarithm of each contact's load over its reference, held where a scan lacks it; 0 before it is known."""

    def __init__(self, press: Press) -> None:
        self._columns = press.load_references
        self._logs = [0.0] * (len(press.contact) if self._columns else 0)

    @property
    def logs(self) -> tuple[float, ...]:
        """By contact; none at all where no contact has a load to follow."""
        return tuple(self._logs)

    def note(self, values: Mapping[str, float]) -> None:
        """Take a scan."""
        for m, (column, reference) in self._columns.items():
            share = values.get(column, math.nan) / reference
            if math.isfinite(share):
                self._logs[m] = math.log(max(share, LEAST_LOAD))


def over_loads(case: Case) -> tuple[Case, Array]:
    """Return a case in whose steps the loads of followed contacts rise, and the loads' logarithms (steps)."""
    logs = np.linspace(math.log(LEAST_LOAD), math.log(MOST), len(case.h))
    loads = dict.fromkeys(case.press.load_references, np.exp(logs))
    return replace(case, load={**case.load, **loads}), logs
