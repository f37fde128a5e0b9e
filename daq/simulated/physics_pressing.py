"""A pressing of the virtual press as data: everything that decides it, before anything is solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from daq.records import Array, EventSource, Moments, Panel

BASE_COEFFICIENTS: Mapping[str, float] = {
    "h_p_o": 800.0,
    "h_p_c": 900.0,
    "h_pp_o": 40.0,
    "h_pp_c": 700.0,
    "h_wa": 12.0,
    "h_ap": 10.0,
}
"""Heat transfer coefficients of the laboratory press. [W/m²K]"""

DryingLaw = Literal["equilibrium", "kinetic", "sorbed"]
"""Water leaves towards what its temperature holds, sharply about one; at a pace that grows with the excess; or,
bound as it is below fibre saturation, over some tens of kelvins."""
NEVER = 1e9
"""Later than any run. [s]"""
LOAD_REFERENCE = 350.0
"""[N/cm²]"""
EASING_S = 1.0
"""Over so long a press lets go of pressure. [s]"""


@dataclass(frozen=True)
class Plates:
    """Both press plates: steel, 10 mm, unless another press is meant. SI units."""

    thickness: float = 0.010
    conductivity: float = 45.0
    density: float = 7850.0
    heat_capacity: float = 490.0

    @property
    def stored(self) -> float:
        """Heat capacity per volume. [J/m³K]"""
        return self.density * self.heat_capacity

    @property
    def resistance(self) -> float:
        """[m²K/W]"""
        return self.thickness / self.conductivity


@dataclass(frozen=True)
class Platen:
    """A platen's true temperature: a smooth curve through evenly spaced knots."""

    start: float
    step: float
    values: Array

    def at(self, times: Array) -> Array:
        """Return the temperature at any times inside the knots. [°C]"""
        from daq.simulated.physics_kernel import platen_curve  # nothing is compiled for who only draws a pressing

        return np.asarray(platen_curve(times, self.start, self.step, self.values))


@dataclass(frozen=True)
class OutsideFault:
    """Faults outside the catalogue; the defaults do nothing. Times in s of the run."""

    lapse_drop: float = 0.0
    """The upper contact loses this share between `lapse_from` and `lapse_to`."""
    lapse_from: float = NEVER
    lapse_to: float = 2 * NEVER
    split_resistance: float = 0.0
    """A delamination inside the panel opens within 2 s. [m²K/W]"""
    split_depth: float = 0.0
    """From the lower face. [m]"""
    split_from: float = NEVER
    draught: float = 1.0
    """Panel-air and plate-air coefficients are multiplied by this from `draught_from` on."""
    draught_from: float = NEVER
    lift: float = 1.0
    """The open contact to the lower plate is multiplied by this from `lift_from` on."""
    lift_from: float = NEVER
    wet_heat: float = 0.0
    """Heat that condensing steam releases near the upper face and takes back later. [J/m²]"""
    wet_release: float = NEVER
    wet_return: float = NEVER
    wet_width: float = 1.5
    flash_rate: float = 0.0
    """Layers above 100 °C lose this share of the excess a second while pent-up steam bursts out. [1/s]"""
    flash_from: float = NEVER
    flash_to: float = 2 * NEVER


@dataclass(frozen=True)
class Pressing:
    """Everything that decides one pressing. SI units, times in s of the run."""

    panel: Panel
    ambient: float
    platen_bottom: Platen
    platen_top: Platen
    start: float
    end: float
    inserted: float
    closed: float = NEVER
    """Middle of the closing ramp."""
    opened: float = 2 * NEVER
    """Middle of the opening ramp."""
    removed: float = 3 * NEVER
    closing_ramp: float = 0.5
    opening_ramp: float = 0.3
    coefficients: Mapping[str, float] = field(default_factory=lambda: dict(BASE_COEFFICIENTS))
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Physical effects by the contract's names, and thermocouple lag and footprint."""
    outside: OutsideFault = OutsideFault()
    plates: Plates = field(default_factory=Plates)
    pressure: float = LOAD_REFERENCE
    """[N/cm²]"""
    vapour_law: Literal["proportional", "uniform"] = "proportional"
    """How steam spreads over the cooler layers; a second law keeps tests from leaning on the first."""
    drying_law: DryingLaw = "equilibrium"
    eased: float = 1.0
    """Share of the pressure that is left from `eased_from` on, within `EASING_S`."""
    eased_from: float = NEVER

    def pressure_at(self, times: Array) -> Array:
        """Return the pressure at any times, 0 while the press is open. [N/cm²]"""
        share = 1.0 - (1.0 - self.eased) * np.clip((times - self.eased_from) / EASING_S, 0.0, 1.0)
        closed = (times >= self.closed - self.closing_ramp / 2) & (times < self.opened + self.opening_ramp / 2)
        return np.where(closed, self.pressure * share, 0.0)

    def moments(self, start_s: float = 0.0, removed_s: float = float("nan")) -> Moments:
        """Return when it truly began, closed and opened, on a clock that shows `start_s` at its 0. [s]"""
        inserted, closed, opened = (start_s + t for t in (self.inserted, self.closed, self.opened))
        return Moments(inserted, closed, opened, removed_s, self.closing_ramp, EventSource.TRUTH)
