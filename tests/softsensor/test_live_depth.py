"""How far a buried thermocouple may lie from its stated depth, in the live sensor's filters."""

import numpy as np
import pytest
from scipy.special import erfc, erfcx

from daq.press.press_file import parse_press
from daq.records import Run
from softsensor.live.march_steps import PressTiming, march_span
from softsensor.live.priors import plans_for
from softsensor.live.replay import replay
from softsensor.live.setup import linearise, set_up

BETWEEN = """
[initial]
kind = "steady"
[[layer]]
name = "board"
thickness_mm = 20.0
conductivity_W_mK = 0.1
density_kg_m3 = 150.0
heat_capacity_J_kgK = 840.0
[boundary.top]
kind = "measured"
column = "hot"
[boundary.bottom]
kind = "measured"
column = "cold"
[[sensor]]
columns = ["inside", "beside"]
at = { layer = "board", depth_mm = 5.0, "depth_mm.sd" = 0.4 }
[[sensor]]
columns = ["face"]
at = "board.middle"
"""


def at_rest():
    """Return the first filter of a board at rest between 20 and 220 °C."""
    press, time_s = parse_press(BETWEEN), np.arange(0.0, 60.0, 1.0)
    columns = {"hot": 220.0, "cold": 20.0, "inside": 70.0, "beside": 70.0, "face": 120.0}
    run = Run("rest", {}, time_s, {name: np.full(len(time_s), t) for name, t in columns.items()})
    setup = set_up(press, run, None)
    plan = plans_for(press, None, (0.0, 0.0, 0.0), unowned=[d.prior for d in setup.directions])[0]
    return linearise(setup, plan, plan.start)


def test_a_sensor_reads_more_by_the_slope_of_the_profile_the_higher_it_lies():
    """At rest it is 10 K/mm: 0.4 mm, one standard deviation, are 4 K, at the start and after a march at rest."""
    made = at_rest()
    chain, depth = made.model.chain, made.names.index("constant sensor 0 depth")
    for elapsed in (0.0, 5.0):
        if elapsed:
            timing = PressTiming(0.0, -np.inf, 0.0, np.inf, np.inf, 0.5, False, 1.0, 1.0, 1.0, 0.5)
            march_span(made.model, timing, np.array([0.0, elapsed]), np.array([[20.0, 220.0]] * 2))
        assert chain.read == pytest.approx([70.0, 120.0], abs=1e-6)
        assert chain.d_read[:, depth] == pytest.approx([4.0, 0.0], abs=1e-6)
    assert chain.d_level[depth] == 0.0


def test_one_place_has_one_depth_and_only_buried_sensors_have_any():
    assert [p.sd for p in at_rest().priors if p.name.endswith("depth")] == [0.0004]


HEATED = """
[[layer]]
name = "board"
thickness_mm = 60.0
thickness_mm.sd = 0.1
conductivity_W_mK = 0.1
conductivity_W_mK.sd = 0.001
density_kg_m3 = 150.0
density_kg_m3.sd = 0.5
heat_capacity_J_kgK = 840.0
heat_capacity_J_kgK.sd = 8.0
[boundary.bottom]
kind = "measured"
column = "hot"
[boundary.top]
kind = "insulated"
[[contact]]
between = ["boundary.bottom", "board"]
closed = "h"
[coefficients.h]
guess = 40.0
[[sensor]]
columns = ["inside"]
at = { layer = "board", depth_mm = 4.0, "depth_mm.sd" = 0.4 }
[core]
at = { layer = "board", depth_mm = 6.0 }
[initial]
kind = "uniform"
temperature_C = 20.0
"""


def heated(time_s, depth_m, h=25.0):
    """Return a thick board of 20 °C heated through a contact from 300 °C on (Carslaw & Jaeger, 2.7)."""
    k, diffusivity = 0.1, 0.1 / (150.0 * 840.0)
    s = np.sqrt(diffusivity * np.maximum(time_s, 1e-9))
    eta = depth_m / (2.0 * s)
    return 20.0 + 280.0 * (erfc(eta) - np.exp(-(eta**2)) * erfcx(eta + h * s / k))


@pytest.mark.parametrize("off_mm", [-0.6, 0.0, 0.6])
def test_the_band_holds_the_core_where_a_thermocouple_lies_elsewhere_in_steep_heat(off_mm):
    """1.5 standard deviations off, the core is missed by 7.9 K: the band was ±0.8 K."""
    time_s = np.arange(0.0, 300.0, 1.0)
    inside, core = heated(time_s, 0.004 + 0.001 * off_mm), heated(time_s, 0.006)
    run = Run("heated", {"ambient.temperature_C": 20.0}, time_s, {"hot": np.full(300, 300.0), "inside": inside})
    estimates = replay(parse_press(HEATED), run).estimates
    late = [(e, truth) for e, truth in zip(estimates, core.tolist(), strict=True) if e.time_s > 60.0]
    assert all(e.valid and e.core_low_C < truth < e.core_high_C for e, truth in late)
