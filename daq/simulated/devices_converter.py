"""The analogue half of a simulated logger: a converter that steps from input to input.

Real modules refresh a channel about once a second however often they are asked, and no two
channels at the same moment. Input k of n is converted at k/n of the refresh time.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

COLD_JUNCTION_C = 31.0
"""Terminal temperature inside a simulated module."""
WARM_UP_S = 600.0
"""Time constant with which a module's terminals reach their temperature after power-on."""

Temperatures = Callable[[float], Sequence[float]]
"""True temperature of every input at a time of the converter's clock. [s -> °C]

Asked for moments up to one refresh time in the past, in rising order.
"""


@dataclass
class Switches:
    """What a test or a user does to a simulated device while it runs."""

    silent: bool = False
    """Power off."""
    busy: bool = False
    """Answers, but not with data."""
    frozen: bool = False
    """The converter has stopped; the old values are still served."""
    open_inputs: set[int] = field(default_factory=set)
    """Thermocouples that are broken."""
    disabled_inputs: set[int] = field(default_factory=set)
    """Inputs switched off in the module's configuration."""
    flow_control: bool = False
    """XON/XOFF: the line is stopped while a scanning instrument works out its reply."""
    answered_s: float = -math.inf
    """When the inputs were last read out, on the machine's monotonic clock. [s]"""


class Converter:
    """Holds the last conversion of every input."""

    def __init__(
        self,
        temperatures: Temperatures,
        inputs: int,
        refresh_s: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        switches: Switches | None = None,
        warm_up_kelvin: float = 0.0,
    ) -> None:
        self.inputs = inputs
        self.switches = switches or Switches()
        self._temperatures = temperatures
        self._refresh_s = refresh_s
        self._warm_up_kelvin = warm_up_kelvin
        self._switched_on_s = clock()
        self._clock = clock
        self._held = [math.nan] * inputs
        self._converted_s = [-math.inf] * inputs
        self._lock = threading.Lock()

    def read(self) -> tuple[float, ...]:
        """Return what the inputs read now; NaN for a broken thermocouple. [°C]"""
        with self._lock:
            if not self.switches.frozen or math.isinf(self._converted_s[0]):
                self._convert()
            broken = self.switches.open_inputs
            shown = tuple(math.nan if k in broken else v for k, v in enumerate(self._held))
            self.switches.answered_s = time.monotonic()
            return shown

    def _convert(self) -> None:
        now = self._clock()
        due = [(self._last_conversion(k, now), k) for k in range(self.inputs)]
        truth: Sequence[float] = ()
        read_at = math.nan
        for moment, k in sorted(due):
            if moment == self._converted_s[k]:
                continue
            if moment != read_at:
                truth, read_at = self._temperatures(moment), moment
            self._held[k] = float(truth[k]) + self._cold_junction_error(moment)
            self._converted_s[k] = moment

    def _cold_junction_error(self, moment: float) -> float:
        """How far the cold junction sensor lags the terminals while the module warms up. [K]"""
        age_s = max(moment - self._switched_on_s, 0.0)
        return self._warm_up_kelvin * math.exp(-age_s / WARM_UP_S)

    def _last_conversion(self, k: int, now: float) -> float:
        if self._refresh_s <= 0:
            return now
        phase = k / self.inputs * self._refresh_s
        return math.floor((now - phase) / self._refresh_s) * self._refresh_s + phase
