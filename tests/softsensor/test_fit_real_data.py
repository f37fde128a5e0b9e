"""Measured runs of other laboratories, read through their mapping, fitted through their press file."""

from dataclasses import replace

import numpy as np
import pytest

from daq.files.mapping import read_foreign, read_mapping
from daq.press.press_file import read_press
from softsensor.diagnosis.missing_causes import with_missing_causes
from softsensor.fitting.one_run import fit_run
from softsensor.heat.model import ThermalModel
from softsensor.jobs.campaign import fit_campaign
from softsensor.signals.moments import moments_of
from tests.measured import INERT_BOARD, PRESS_RIG, ROOT, measured

DATA_SHEET_HEAT_CAPACITY = 1070.0


@pytest.fixture(scope="module")
def rig():
    mapped = read_mapping(ROOT / "deploy/mappings/press_rig.toml")
    runs = [read_foreign(path, mapped) for path in measured(PRESS_RIG)]
    return fit_campaign(read_press(ROOT / "deploy/presses/rig.toml"), runs)


def test_press_rig_is_met_to_four_tenths_of_a_kelvin_with_two_constant_contacts(rig):
    errors = [fitted.rmse_K for fitted in rig.runs]
    assert len(errors) >= 6
    assert np.median(errors) <= 0.4
    assert max(errors) <= 0.65
    assert all(fitted.converged and fitted.met for fitted in rig.runs)


def test_contacts_of_the_press_rig_lie_where_its_author_found_them(rig):
    """The author's pseudo-steady values at light load run from 1.2 to 4.5 kW/m2K."""
    for fitted in rig.runs:
        for c in fitted.coefficients.values():
            assert c.identifiable
            assert c.ci95[0] < 5000.0
            assert c.ci95[1] > 1200.0


def test_inert_board_is_met_with_the_heat_capacity_of_its_data_sheet():
    mapped = read_mapping(ROOT / "deploy/mappings/inert_board.toml")
    run = read_foreign(measured(INERT_BOARD)[0], mapped)
    press = read_press(ROOT / "deploy/presses/inert_board.toml")
    model = ThermalModel(press)
    assert press.layer[0].heat_capacity_J_kgK == pytest.approx(DATA_SHEET_HEAT_CAPACITY, rel=0.05)
    fitted = fit_run(model, run, moments_of(run, press))
    assert fitted.rmse_K <= 3.5
    assert fitted.met

    def error(heat_capacity):
        given = replace(run, header={**run.header, "layer.board.heat_capacity_J_kgK": float(heat_capacity)})
        return fit_run(model, given, moments_of(given, press), company=None).rmse_K

    capacities = np.array([1030.0, 1100.0, 1170.0])
    errors = [error(c) for c in capacities]
    parabola = np.polyfit(capacities - 1100.0, errors, 2)
    best = 1100.0 - parabola[1] / (2.0 * parabola[0])
    assert parabola[0] > 0
    assert min(errors) <= 3.5
    assert best == pytest.approx(DATA_SHEET_HEAT_CAPACITY, rel=0.05)


def test_runs_of_the_press_rig_teach_what_the_load_does_to_its_contacts(rig):
    """The diagnosis of the same runs, which solves at the exponent itself, says 0.041 (0.032 to 0.050)."""
    seen = with_missing_causes(rig.model_file(), rig.runs).missing
    assert seen is not None
    load = seen.causes["contact_load"]
    assert load.chance > 0.5
    exponent = load.parameters["exponent"]
    assert exponent.value - 2.0 * exponent.sd < 0.041 < exponent.value + 2.0 * exponent.sd
    assert exponent.value > 2.0 * exponent.sd
