"""A panel whose header gives conductivity and heat capacity as tables in temperature."""

from dataclasses import replace

import numpy as np
import pytest

from daq.files.run_file import read_run, write_run
from daq.press.header import check_header, panel_of
from daq.press.press_file import parse_press
from daq.records import InputError, Moments, Run
from softsensor.heat.model import ThermalModel

TOML = """
[initial]
kind = "uniform"
temperature_C = 0.0
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
kind = "measured"
column = "hot"
[boundary.top]
kind = "measured"
column = "cold"
[[sensor]]
columns = ["in_1"]
at = { layer = "panel", depth_mm = 6.0 }
"""
TIMES = np.arange(0.0, 4001.0, 10.0)


def _run(**constants):
    header = {"panel.thickness_mm": 10.0, "panel.density_kg_m3": 700.0, "panel.conductivity_W_mK": 0.1}
    header |= {"panel.heat_capacity_J_kgK": 1500.0, "panel.initial_temperature_C": 0.0, **constants}
    ones = np.ones(len(TIMES))
    return Run("r", header, TIMES, {"hot": 200.0 * ones, "cold": 0.0 * ones, "in_1": 0.0 * ones})


def _inside(run):
    model = ThermalModel(parse_press(TOML))
    return model.solve(model.prepare(run, Moments(inserted_s=0.0)), {}).sensors[:, 0]


def test_steady_profile_of_a_linear_conductivity_is_kirchhoffs():
    """k = 0.1 (1 + T/100): theta = T + T^2/200 is a straight line through the panel; Carslaw, Jaeger, 1.6."""
    table = [[t, 0.1 * (1.0 + t / 100.0)] for t in (0.0, 100.0, 200.0)]
    theta = 0.4 * (200.0 + 200.0**2 / 200.0)
    expected = -100.0 + np.sqrt(100.0**2 + 200.0 * theta)
    assert _inside(_run(**{"panel.conductivity_W_mK": table}))[-1] == pytest.approx(expected, abs=0.5)
    assert _inside(_run())[-1] == pytest.approx(80.0, abs=0.1)


def test_table_of_one_value_is_that_value():
    flat = {
        "panel.conductivity_W_mK": [[0, 0.1], [300, 0.1]],
        "panel.heat_capacity_J_kgK": [[0, 1500.0], [300, 1500]],
    }
    assert _inside(_run(**flat)) == pytest.approx(_inside(_run()), abs=0.02)


def test_table_survives_its_file(tmp_path):
    run = _run(**{"panel.conductivity_W_mK": [[20.0, 0.12], [100.0, 0.14]]})
    write_run(run, tmp_path / "r.csv")
    assert panel_of(read_run(tmp_path / "r.csv")).conductivity_table == ((20.0, 0.12), (100.0, 0.14))
    assert panel_of(run).conductivity == 0.12


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([[20, 0.1], [20, 0.2]], "its table do not rise"),
        ([[20, 0.1, 3]], "a table has rows of a temperature and a value"),
        ([], "a table has rows"),
        ([[20, -0.1]], "panel.conductivity_W_mK"),
    ],
)
def test_table_that_is_none_is_refused(value, message):
    run = _run(**{"panel.conductivity_W_mK": value})
    with pytest.raises(InputError, match=message):
        check_header(run.header, "r.csv")
    with pytest.raises(InputError, match=r"a table|rise|conductivity"):
        panel_of(replace(run, header=dict(run.header)))
