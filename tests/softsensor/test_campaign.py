"""A campaign's coefficients against the truths of the virtual press, and against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from daq.simulated.physics_pressing import Plates
from softsensor.fitting.dependence import Dependence, _regress, fit_dependence
from softsensor.fitting.population import Knowledge, population
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.campaign import fit_campaign
from tests.panels import panel_stated

PRESS = parse_press(press_toml())


@pytest.fixture(scope="module")
def campaign():
    chain = Nuisances.real_chain()
    plan = Plan(rate_hz=2.0, thickness_mm=16.0, coefficient_spread=0.15, nuisances=chain, panel_spread=0.0)
    measured = [(panel_stated(run, 0.001), truth) for run, truth in make_campaign(4, 8, plan=plan)]
    return measured, fit_campaign(PRESS, [run for run, _ in measured])


def test_mean_of_a_campaign_covers_the_mean_of_the_truths(campaign):
    measured, found = campaign
    for name in ("h_pp_c", "h_pp_o", "h_wa", "h_p_c"):
        truths = np.array([t.coefficients[name] for _, t in measured])
        c = found.coefficients[name]
        assert c.runs >= 7
        assert c.ci95[0] < truths.mean() < c.ci95[1]
        assert c.bootstrap95[0] < truths.mean() < c.bootstrap95[1]


def test_the_interval_of_a_well_determined_median_is_students_of_the_scatter(campaign):
    _, found = campaign
    for name in ("h_pp_o", "h_pp_c", "h_wa"):
        c = found.coefficients[name]
        half = np.log(c.median_ci95[1] / c.median_ci95[0]) / 2.0
        assert half == pytest.approx(2.365 * c.spread / np.sqrt(8), rel=0.02)  # 8 runs: 7 degrees of freedom


def test_badly_determined_runs_borrow_from_the_others(campaign):
    measured, found = campaign
    own, joint = [], []
    for fitted, (_, truth) in zip(found.runs, measured, strict=True):
        for name in ("h_ap", "h_p_o"):
            own.append(np.log(fitted.coefficients[name].value / truth.coefficients[name]))
            joint.append(np.log(found.borrowed[fitted.run][name].value / truth.coefficients[name]))
    assert np.sqrt(np.mean(np.square(joint))) < np.sqrt(np.mean(np.square(own)))


def test_json_holds_what_the_contract_names_and_survives_json(campaign):
    _, found = campaign
    content = json.loads(json.dumps(found.as_json(), allow_nan=False))
    run = content["runs"][0]
    assert {"run", "converged", "coefficients", "rmse_K", "rmse_closed_K", "initial_rmse_K"} <= set(run)
    assert {"seconds", "closed_s", "opened_s", "warnings"} <= set(run)
    assert {"value", "sd", "ci95", "identifiable"} <= set(run["coefficients"]["h_pp_c"])
    assert {"mean", "sd", "ci95"} <= set(content["campaign"]["h_pp_c"])


def test_model_file_of_a_campaign_reads_back(campaign):
    _, found = campaign
    model = parse_model(found.model_file().as_json(), "text")
    assert set(model.coefficients) == set(PRESS.coefficient_names)
    assert model.covariance.shape == (6, 6)
    assert np.all(np.linalg.eigvalsh(model.covariance) > 0)


def test_order_of_runs_does_not_change_a_run(campaign):
    measured, found = campaign
    again = fit_campaign(PRESS, [run for run, _ in measured[:3]][::-1], workers=1)
    values = {f.run: f.coefficients["h_pp_c"].value for f in again.runs}
    for fitted in found.runs[:3]:
        assert values[fitted.run] == fitted.coefficients["h_pp_c"].value


def test_population_of_perfectly_known_runs_is_their_mean_and_scatter():
    logs = np.array([[0.1], [0.3], [-0.2], [0.4], [0.0], [-0.1]] * 5)
    runs = [Knowledge(np.array([[1e8]]), 1e8 * x, x) for x in logs]
    found = population(("h",), runs)
    assert found.mean[0] == pytest.approx(logs.mean(), abs=1e-4)
    assert found.spread[0] == pytest.approx(logs.std(ddof=1), rel=0.05)


def test_run_that_knows_nothing_takes_the_population():
    known = [Knowledge(np.array([[1e6]]), 1e6 * np.array([x]), np.array([x])) for x in (0.9, 1.0, 1.1, 1.0)]
    blind = Knowledge(np.zeros((1, 1)), np.zeros(1), np.array([7.0]))
    found = population(("h",), [*known, blind])
    mean, covariance = found.members[-1]
    assert mean[0] == pytest.approx(1.0, abs=0.01)
    expected = found.spread[0] ** 2 + found.mean_covariance[0, 0]
    assert covariance[0, 0] == pytest.approx(expected, rel=0.05)
    assert found.mean[0] == pytest.approx(1.0, abs=0.01)


def test_dependence_on_pressure_is_found_and_predicts_a_program_never_run(campaign):
    _, found = campaign
    rng = np.random.default_rng(3)
    runs, fits, knowledge = [], [], []
    for i in range(12):
        pressure = 280.0 + 10.0 * i
        y = np.log(700.0) + 0.8 * np.log(pressure / 340.0) + 0.05 * rng.standard_normal()
        base = found.runs[i % 8].problem.case.run
        runs.append(replace(base, header={**base.header, "setting.pressure_N_cm2": pressure}))
        fits.append(found.runs[i % 8])
        knowledge.append(Knowledge(np.array([[4e3]]), np.array([4e3 * y]), np.array([y])))
    fitted = fit_dependence(("h_pp_c",), runs, fits, knowledge)
    assert fitted is not None
    slope = fitted.as_json()["coefficients"]["h_pp_c"]["pressure_N_cm2"]
    assert slope["ci95"][0] < 0.8 / 340.0 < slope["ci95"][1]
    assert slope["ci95"][0] > 0
    predicted = fitted.predict({"pressure_N_cm2": 420.0})["h_pp_c"]
    assert abs(predicted.value - 700.0 * (420 / 340) ** 0.8) < 2.5 * predicted.sd


def test_coefficients_of_a_hotter_program_are_predicted_from_cooler_ones():
    trends = {"h_pp_c": 0.012, "h_pp_o": -0.010}
    plan = Plan(
        rate_hz=1.0, thickness_mm=16.0, coefficient_spread=0.05, trends_per_K=trends, platen_C=(180.0, 200.0),
        nuisances=Nuisances.real_chain(),
    )  # fmt: skip
    found = fit_campaign(PRESS, [run for run, _ in make_campaign(31, 12, plan=plan)])
    assert found.dependence is not None
    predicted = found.dependence.predict({"platen_temperature_C": 210.0})
    for name, trend in trends.items():
        expected = plan.coefficients[name] * np.exp(trend * 15.0)
        assert abs(predicted[name].value - expected) < 2.5 * predicted[name].sd, name
        slope = found.dependence.as_json()["coefficients"][name]["platen_temperature_C"]["ci95"]
        assert slope[0] < trend < slope[1]
        assert slope[0] * slope[1] > 0


def test_second_press_with_other_plates_is_fitted_by_its_own_press_file():
    plates = Plates(thickness=0.006, conductivity=16.0, density=7900.0, heat_capacity=500.0)
    plan = Plan(rate_hz=2.0, thickness_mm=16.0, plates=plates)
    run, truth = make_campaign(14, 1, plan=plan)[0]
    found = fit_campaign(parse_press(press_toml(plates=plates)), [run])
    for name in ("h_pp_c", "h_pp_o", "h_wa", "h_p_c"):
        c = found.runs[0].coefficients[name]
        assert abs(np.log(c.value / truth.coefficients[name])) < 4.0 * c.sd / c.value, name
    assert found.runs[0].rmse_K < 0.5


def test_settings_that_hardly_vary_give_no_slope(campaign):
    _, found = campaign
    runs = [f.problem.case.run for f in found.runs]
    still = [replace(r, header={k: v for k, v in r.header.items() if not k.startswith("setting.")}) for r in runs]
    knowledge = [Knowledge(np.eye(1), np.zeros(1), np.zeros(1))] * len(runs)
    fitted = fit_dependence(("h",), still, found.runs, knowledge)
    assert fitted is None or fitted.settings == ("press_time_s",)


def test_what_no_run_can_tell_stays_within_the_limits_of_the_press_file():
    run, truth = make_campaign(4, 1, plan=Plan(rate_hz=2.0, closed_column=True))[0]
    keep = run.time_s < truth.moments.closed_s - 0.5
    short = run.at_rows(keep)
    found = fit_campaign(PRESS, [short])
    model = found.model_file()
    for name in PRESS.coefficient_names:
        table, c = PRESS.coefficient(name), found.coefficients[name]
        assert table.lower <= c.ci95[0] <= c.mean <= c.ci95[1] <= table.upper
        assert table.lower <= model.coefficients[name].value <= table.upper
    assert found.coefficients["h_pp_c"].runs == 0


def test_interval_of_a_program_holds_what_it_says_with_few_runs():
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(400):
        x = np.column_stack([np.ones(8), *(rng.uniform(-1.7, 1.7, (2, 8)))])
        beta, covariance, spread = _regress(x, rng.normal(0.0, 0.2, 8), np.full(8, 1e4))
        zero, one = np.zeros(2), np.ones(2)
        predicted = Dependence(
            ("h",), ("pressure_N_cm2", "press_time_s"), zero, one, beta[None], covariance[None],
            np.array([spread]), -2 * one, 2 * one, 8,
        )  # fmt: skip
        program = dict(zip(predicted.settings, rng.uniform(-1.0, 1.0, 2), strict=True))
        low, high = predicted.program(program).intervals["h"]
        inside.append(np.log(low) < rng.normal(0.0, 0.2) < np.log(high))
    assert 0.92 < np.mean(inside) < 0.98


def test_a_run_whose_header_leaves_a_coefficient_without_use_is_named():
    run, _ = make_campaign(4, 1, plan=Plan(rate_hz=2.0, thickness_mm=16.0))[0]
    header = {**run.header, "contact.1.closed": "h_new", "contact.2.closed": "h_new"}
    with pytest.raises(InputError, match=r"its header leaves coefficient 'h_pp_c' .* without use"):
        fit_campaign(PRESS, [replace(run, header=header)])
