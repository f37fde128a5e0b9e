"""Real runs of other laboratories: moisture in moist pine and not in dry, the load in a press rig."""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from daq.foreign import read_foreign, read_mapping
from daq.pressfile import read_press
from softsensor.diagnosis import diagnose

ROOT = Path(__file__).resolve().parents[2]
PYROLYSIS_C = 140.0
"""When the back face is this hot, the heated one chars, which is not in the model."""


def _runs(folder, pattern, mapping):
    where = Path(os.environ.get("KERNTEMP_DATA", ROOT.parent / "shared" / "data")) / folder
    if not where.is_dir():
        pytest.skip(f"the measured runs are not here: set KERNTEMP_DATA to the folder that holds {folder}")
    mapped = read_mapping(ROOT / f"deploy/mappings/{mapping}.toml")
    return [read_foreign(path, mapped) for path in sorted(where.glob(pattern))]


def _before_charring(run):
    hot = np.flatnonzero(run.columns["bottom_1"] > PYROLYSIS_C)
    rows = slice(0, hot[0] if len(hot) else len(run.time_s))
    columns = {name: values[rows] for name, values in run.columns.items()}
    return replace(run, time_s=run.time_s[rows], columns=columns)


@cache
def moist():
    runs = [_before_charring(r) for r in _runs("pine_gasification", "FSRI*.csv", "pine")]
    return diagnose(read_press(ROOT / "deploy/presses/pine_disc.toml"), runs)


def test_moist_pine_is_named_moist():
    found = moist()
    assert [f.set[0] for f in found.findings] == ["moisture_evaporation"]
    assert 85.0 < found.findings[0].parameters["temperature_C"].value < 115.0


def test_moisture_halves_the_error_on_a_pine_run_left_out():
    found = moist()
    assert found.extended.heldout_rmse_K < 0.5 * found.base.heldout_rmse_K


def test_residual_of_moist_pine_sits_where_water_boils():
    found = moist()
    for white, run in zip(found.stages[0].data, found.stages[0].fit.runs, strict=True):
        back, residual = white.digest.y[:, 0], run.misfit[:, 0]
        boiling = (back > 85.0) & (back < 115.0)
        assert np.nanmean(residual[boiling]) < -4.0
        assert abs(np.nanmean(residual[(back > 40.0) & (back < 75.0)])) < 2.0


def test_dry_pine_gets_no_moisture_verdict():
    runs = [_before_charring(r) for r in _runs("pine_gasification", "UMD*.csv", "pine")]
    found = diagnose(read_press(ROOT / "deploy/presses/pine_disc.toml"), runs)
    assert all("moisture_evaporation" not in f.set for f in found.findings)


def test_press_rig_shows_the_load_and_no_sensor_offset():
    runs = _runs("press_rig", "2309*.dat", "press_rig")
    found = diagnose(read_press(ROOT / "deploy/presses/rig.toml"), runs)
    assert [f.set for f in found.findings] == [("contact_load",)]
    assert found.findings[0].parameters["exponent"].ci95[0] > 0.0
    assert found.extended.heldout_rmse_K < 0.75 * found.base.heldout_rmse_K
