"""The panel now, beyond its core: the profile through it, and the heat it has taken up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.heat import step_terms
from softsensor.live.kalman import KalmanFilter
from softsensor.live.mixture import Mixture
from softsensor.live.setup import Linearised

LEAST_SHARE = 0.01
"""Filters with less than this share of all hypotheses do not count: 50 K off, they would move a cell by 0.5 K."""


@dataclass(frozen=True)
class Inside:
    """The panel now."""

    profile_C: Array  # noqa: N815
    """At even heights from the lower to the upper face. [°C]"""
    energy_kJ_m2: float  # noqa: N815
    """Heat in the panel beyond its start, water and reactions not counted. [kJ/m²]"""

    __repr__ = on_screen


def look_inside(filters: Sequence[KalmanFilter], mixture: Mixture) -> Inside:
    """Return profile and heat as all hypotheses together expect them, should nothing have changed at once."""
    profiles, heats = [], []
    for one, share, cells in believed(filters, mixture):
        profiles.append(share * (one.linearised.profile @ cells))
        heats.append(share * heat_taken_up(one.linearised, cells))
    return Inside(np.sum(profiles, axis=0), sum(heats) / 1000.0)


def believed(filters: Sequence[KalmanFilter], mixture: Mixture) -> list[tuple[KalmanFilter, float, Array]]:
    """Return the filters that count, each with its share of all and its cells' expected temperatures (n). [°C]

    Where shares are not known, neither is anything that they weigh: all of it is NaN.
    """
    totals = np.array([shares.sum() for shares in mixture.shares])
    counted = np.where(totals < LEAST_SHARE, 0.0, totals)
    found = zip(filters, counted / counted.sum(), totals, mixture.shares, strict=True)
    return [(one, float(share), one.cells(shares / total)) for one, share, total, shares in found if share != 0.0]


def heat_taken_up(made: Linearised, cells: Array) -> float:
    """Return the heat that takes the panel from its start to `cells` (n), rho c(T) integrated. [J/m²]"""
    return float(step_terms.heat(made.model.stack, made.start_C, cells))
