"""The virtual measurements on which the paper's difficulty is reproduced."""

from __future__ import annotations

from collections.abc import Callable

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.fitting.paper.procedures import SolverComparison, reproduce
from softsensor.heat.model import ThermalModel

MEASUREMENTS, SEED = 20, 77
"""Virtual pressings, and what they are drawn with. By hand, 2026-11."""


def reproduce_paper(
    measurements: int = MEASUREMENTS,
    *,
    clock: Callable[[], float],
    progress: Callable[[int], None] | None = None,
) -> SolverComparison:
    """Make the measurements (2 rows a second, every sensor sound, moments known) and compare."""
    plan = Plan(
        rate_hz=2.0,
        thickness_mm=16.0,
        coefficient_spread=0.12,
        press_time_s=(20.0, 60.0),
        open_after_s=(30.0, 60.0),
        start_before_s=0.0,
        nuisances=Nuisances(loose_chance=0.0),
    )
    campaign = make_campaign(SEED, measurements, plan=plan)
    model = ThermalModel(parse_press(press_toml()))
    return reproduce(
        [(run, t.moments, t.coefficients) for run, t in campaign], model, clock=clock, progress=progress
    )
