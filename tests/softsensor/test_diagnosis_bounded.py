"""Neither a prediction that grows without end nor a press file with nothing left to fit ends a diagnosis."""

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import Run
from softsensor.diagnosis.directions import direction
from softsensor.diagnosis.extension import fit_campaign_model
from softsensor.diagnosis.extension_unknowns import lay_out
from softsensor.effects import find_effect
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import UNBOUNDED_K, MeanNoise, Whitened, digest_run
from softsensor.signals.instrument import MEAN_FAST_K, MEAN_SLOW_K, MEAN_WHITE_K
from softsensor.signals.moments import moments_of

FILE = """
    [[layer]]
    name = "panel"
    from_run = true
    [boundary.bottom]
    kind = "measured"
    column = "cold"
    [boundary.top]
    kind = "measured"
    column = "hot"
    [[contact]]
    between = ["boundary.bottom", "panel"]
    closed = "h"
    [coefficients.h]
    guess = 50.0
    lower = 1.0
    upper = 5000.0
    [[sensor]]
    columns = ["in_1"]
    at = { layer = "panel", depth_mm = 37.5 }
    """
PRESS = parse_press(FILE)
HEADER = {
    "panel.material": "stone wool",
    "panel.thickness_mm": 50.0,
    "panel.density_kg_m3": 100.0,
    "panel.conductivity_W_mK": ((20.0, 0.035), (100.0, 0.045), (200.0, 0.062), (300.0, 0.085)),
    "panel.heat_capacity_J_kgK": 840.0,
    "panel.initial_temperature_C": 21.0,
}
STEAM = ThermalModel(PRESS, (find_effect("vapour_convection"),))


@pytest.fixture(scope="module")
def wool():
    """Stone wool, warmed to 330 °C in two hours."""
    time_s = np.arange(0.0, 7200.0, 30.0)
    risen = time_s / time_s[-1]
    columns = {"cold": 21.0 + 40.0 * risen, "hot": 21.0 + 309.0 * risen, "in_1": 21.0 + 240.0 * risen}
    run = Run("wool", HEADER, time_s, columns)
    return digest_run(PRESS, run, moments_of(run, PRESS))


def test_steam_in_wool_grows_without_end_and_is_told_in_numbers_that_can_be_compared(wool):
    name = "vapour_convection.W_m3K"
    with np.errstate(all="ignore"):
        solution = wool.solve(STEAM, {"h": 50.0, name: 1e5}, (name,))
    assert not np.abs(solution.sensors).max() < 1e100
    seen = wool.observed(solution)
    assert np.abs(seen).max() == UNBOUNDED_K
    slope = wool.observed_tangents(solution, (name,))
    assert np.isfinite(slope).all()
    assert not slope[np.abs(seen) == UNBOUNDED_K].any()


def test_a_cause_that_cannot_be_in_this_panel_is_weighed_and_found_wanting(wool):
    data = [Whitened.of(wool, MeanNoise(MEAN_SLOW_K, MEAN_FAST_K, MEAN_WHITE_K))]
    fit = fit_campaign_model(lay_out(ThermalModel(PRESS), [wool], {}, {}), data, rounds=1)
    for size in (5e4, 1e5):
        found = direction(fit, data, STEAM, {"vapour_convection.W_m3K": size})
        assert np.isfinite([found.amplitude, found.gain]).all()


def test_what_is_finite_stays_to_the_last_bit(wool):
    solution = wool.solve(ThermalModel(PRESS), {"h": 50.0})
    assert wool.observed(solution).tobytes() == wool.bins(solution.sensors[:, :1]).tobytes()


def test_a_press_whose_coefficients_are_all_fixed_leaves_runs_only_numbers_of_their_own(wool):
    fixed = parse_press(FILE.replace("guess = 50.0", "guess = 50.0\n    fixed = true"))
    data = [Whitened.of(wool, MeanNoise(MEAN_SLOW_K, MEAN_FAST_K, MEAN_WHITE_K))]
    layout = lay_out(ThermalModel(fixed), [wool], {}, {})
    fit = fit_campaign_model(layout, data)
    assert not layout.names
    assert np.abs(fit.runs[0].eta).max() > 0.1  # what the panel began at, and the platens
    assert fit.cost < fit_campaign_model(layout, data, rounds=0).cost
