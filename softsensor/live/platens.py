"""Boundary temperatures as the live sensor holds them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from daq.press.press_file import BoundaryKind, Press
from softsensor.heat.run_checks import MAX_BRIDGE_S


class HeldPlatens:
    """Boundary temperatures of a press, bottom and top, held where a scan lacks them."""

    def __init__(self, press: Press) -> None:
        self._ends = press.boundary.bottom, press.boundary.top
        self._values, self._read_s = [math.nan, math.nan], [math.nan, math.nan]

    @property
    def values(self) -> tuple[float, float]:
        """[°C]"""
        return self._values[0], self._values[1]

    @property
    def measured(self) -> tuple[float, ...]:
        """Those that are measured, as far as they are known. [°C]"""
        both = zip(self._ends, self._values, strict=True)
        return tuple(value for end, value in both if end.kind is BoundaryKind.MEASURED and value == value)

    def note(self, time_s: float, values: Mapping[str, float]) -> bool:
        """Take a scan; return whether both are known at all."""
        for side, end in enumerate(self._ends):
            value = values.get(end.column or "", math.nan) if end.kind is BoundaryKind.MEASURED else 0.0
            if value == value:
                self._values[side], self._read_s[side] = value, time_s
        return all(value == value for value in self._values)

    def lost(self, time_s: float) -> bool:
        """Return whether one of them has been held for longer than `MAX_BRIDGE_S`."""
        return time_s - min(self._read_s) > MAX_BRIDGE_S
