"""Many runs solved side by side against the same runs solved alone."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import InputError, Moments, Run
from softsensor.heat.batch import solve_many
from softsensor.heat.batch_steps import LANES
from softsensor.heat.model import ThermalModel

WINDOW = Path(__file__).parents[2] / "deploy" / "examples" / "press_window" / "core_at_opening.py"


def assert_as_alone(model, cases, values, found):
    assert len(found) == len(cases)
    for case, own, solution in zip(cases, values, found, strict=True):
        alone = model.solve(case, own)
        assert solution.columns == alone.columns
        assert np.allclose(solution.sensors, alone.sensors, rtol=0, atol=1e-9)
        assert np.allclose(solution.core, alone.core, rtol=0, atol=1e-9)
        assert np.allclose(solution.places, alone.places, rtol=0, atol=1e-9)
        assert np.array_equal(solution.closed_share, alone.closed_share)


def test_runs_of_different_coefficients_moments_and_lengths_come_out_as_alone(
    lab_press, make_run, coefficients, moments
):
    model = ThermalModel(lab_press)
    rng = np.random.default_rng(3)
    cases, values = [], []
    for i in range(LANES + 3):
        run = make_run(end=100.0 + 6.0 * i, noise=0.1, **{"panel.thickness_mm": 8.0 + i})
        cases.append(model.prepare(run, replace(moments, closed_s=20.3 + rng.uniform(-3, 3)), max_step_s=2.0))
        own = {name: x * rng.uniform(0.7, 1.4) for name, x in coefficients.items()}
        values.append(own | {"closed_s": 0.1 * (i % 3), "initial_K": float(i), "boundary_top_K": 0.3})
    assert len({len(case.mesh.dx) for case in cases}) > 1
    assert len({len(case.h) for case in cases}) > 1
    assert_as_alone(model, cases, values, solve_many(model, cases, values))


def test_linear_effects_and_the_measuring_chain_come_out_as_alone(lab_press, make_run, coefficients, moments):
    names = ("edge_loss", "contact_load", "thermocouple_lag", "thermocouple_footprint", "paper_layer")
    model = ThermalModel.of(lab_press, names)
    case = model.prepare(make_run(end=120.0), moments)
    values = [model.guesses | coefficients | {"h_pp_c": h} for h in (300.0, 700.0, 1500.0)]
    assert not model.build(case, values[0]).nonlinear
    assert_as_alone(model, [case] * 3, values, solve_many(model, [case] * 3, values))


def test_nonlinear_models_are_solved_one_by_one(lab_press, make_run, coefficients, moments):
    model = ThermalModel.of(lab_press, ("moisture_evaporation",))
    cases = [model.prepare(make_run(end=end), moments) for end in (60.0, 70.0)]
    values = model.guesses | coefficients
    assert_as_alone(model, cases, [values] * 2, solve_many(model, cases, values))


def test_absorbed_flux_and_convecting_ends_come_out_as_alone():
    press = """
[[layer]]
name = "slab"
thickness_mm = 12.0
conductivity_W_mK = 0.2
density_kg_m3 = 700.0
heat_capacity_J_kgK = 1500.0
[initial]
kind = "uniform"
temperature_C = 35.0
[boundary.bottom]
kind = "air"
coefficient = "h_below"
ambient_C = 12.0
[boundary.top]
kind = "flux"
coefficient = "h_above"
incident_W_m2 = 900.0
absorptivity = 0.8
[[sensor]]
columns = ["face"]
at = "slab.top"
"""
    model = ThermalModel(parse_press(press))
    time_s = np.linspace(0.0, 600.0, 601)
    run = Run("sun", {"ambient.temperature_C": 18.0}, time_s, {"face": np.full(601, np.nan)})
    case = model.prepare(run, Moments())
    values = [{"h_below": 8.0, "h_above": h} for h in (5.0, 12.0)]
    assert_as_alone(model, [case] * 2, values, solve_many(model, [case] * 2, values))


def test_values_must_match_the_cases(lab_press, make_run, coefficients, moments):
    model = ThermalModel(lab_press)
    case = model.prepare(make_run(end=30.0), moments)
    assert solve_many(model, [], coefficients) == []
    with pytest.raises(ValueError, match="2 sets of values for 1 cases"):
        solve_many(model, [case], [coefficients] * 2)
    with pytest.raises(InputError, match="h_pp_c"):
        solve_many(model, [case], {k: v for k, v in coefficients.items() if k != "h_pp_c"})


def test_the_press_window_example_tells_what_single_pressings_tell(lab_press):
    example = runpy.run_path(str(WINDOW))
    model = ThermalModel(lab_press)
    core = example["window"](model, model.guesses)
    assert (np.diff(core, axis=0) > 0).all(), "hotter platens, hotter core"
    assert (np.diff(core, axis=1) < 0).all(), "thicker panel, cooler core"
    assert (np.diff(core, axis=2) > -1e-6).all(), "longer in the press, hotter core"
    run = example["pressing"](16.0, 200.0)
    moments = Moments(inserted_s=0.0, closed_s=example["CLOSED_S"], opened_s=example["CLOSED_S"] + 120.0)
    alone = model.solve(model.prepare(run, moments), model.guesses)
    at = (
        example["PLATENS_C"].index(200.0),
        example["THICKNESSES_MM"].index(16.0),
        example["PRESS_TIMES_S"].index(120.0),
    )
    assert core[at] == pytest.approx(np.interp(moments.opened_s, run.time_s, alone.core), abs=1e-8)
