"""The panel now, beyond its core: the profile through it, and the heat it has taken up."""

from __future__ import annotations

from dataclasses import dataclass

from daq.records import Array
from softsensor.live import mixture_steps as mixtures
from softsensor.live.kalman import KalmanFilter
from softsensor.live.setup import Linearised


@dataclass(frozen=True)
class Inside:
    """The panel now."""

    profile_C: Array  # noqa: N815
    """At even heights from the lower to the upper face. [°C]"""
    energy_kJ_m2: float  # noqa: N815
    """Heat in the panel beyond its start, water and reactions not counted. [kJ/m²]"""


def look_inside(one: KalmanFilter) -> Inside:
    """Return profile and heat as the model in force sees them."""
    cells = one.cells
    return Inside(one.linearised.profile @ cells, heat_taken_up(one.linearised, cells) / 1000.0)


def heat_taken_up(made: Linearised, cells: Array) -> float:
    """Return the heat that takes the panel from its start to `cells` (n), rho c(T) integrated. [J/m²]"""
    return float(mixtures.heat(made.model.stack, made.start_C, cells))
