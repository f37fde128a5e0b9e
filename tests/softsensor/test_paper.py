"""The paper's procedures, and its difficulty reproduced on two virtual measurements."""

import numpy as np
import pytest

from daq.pressfile import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.model import ThermalModel
from softsensor.paper import METHODS, fit_as_paper
from softsensor.paper_campaign import reproduce_paper
from softsensor.paper_ode import lines_of

MODEL = ThermalModel.of(parse_press(press_toml()))


@pytest.fixture(scope="module")
def measured():
    plan = Plan(
        rate_hz=1.0,
        thickness_mm=16.0,
        press_time_s=(20.0, 25.0),
        open_before_s=(8.0, 10.0),
        open_after_s=(30.0, 32.0),
        start_before_s=0.0,
        nuisances=Nuisances(loose_chance=0.0),
    )
    return make_campaign(8, 1, plan=plan)[0]


def test_adaptive_solver_and_exact_one_agree_on_temperatures_and_slopes(measured):
    run, truth = measured
    names = MODEL.press.coefficient_names
    case = MODEL.prepare(run, truth.moments)
    h = np.array([truth.coefficients[n] for n in names])
    adaptive, slopes = lines_of(MODEL, case, names, ("panel.top", "panel.bottom")).solve(h, sensitivities=True)
    exact = MODEL.solve(case, truth.coefficients, names)
    columns = [exact.columns.index(c) for c in ("top_1", "bottom_1")]
    assert np.sqrt(np.mean((adaptive - exact.sensors[:, columns]) ** 2)) < 0.1
    for i, name in enumerate(names):
        expected = exact.d_sensors[name][:, columns] * h[i]
        assert np.abs(slopes[:, :, i] - expected).max() < 0.02 * np.abs(expected).max() + 0.02, name


def test_all_of_the_papers_methods_end_at_the_same_coefficients(measured):
    run, truth = measured
    found = [fit_as_paper(MODEL, run, truth.moments, method).values for method in METHODS]
    for name in ("h_pp_c", "h_pp_o", "h_wa", "h_p_c"):
        values = [f[name] for f in found]
        assert max(values) / min(values) < 1.02, name
        assert abs(np.log(values[0] / truth.coefficients[name])) < 0.25, name


def test_unknown_method_is_refused_with_the_known_ones(measured):
    run, truth = measured
    with pytest.raises(InputError, match=r"method 'annealing': must be one of least_squares"):
        fit_as_paper(MODEL, run, truth.moments, "annealing")


def test_finite_differences_of_an_adaptive_solver_get_stuck_and_nothing_else_does():
    found = reproduce_paper(2)
    converged = {(c.solver, c.slopes): c.converged for c in found.table}
    assert converged[("adaptive", "finite differences")] == 0
    assert converged[("exact", "finite differences")] == 2
    assert converged[("exact", "exact sensitivities")] == 2
    turns = [np.sum(np.diff(np.sign(np.diff(y))) != 0) for y in (found.adaptive, found.exact)]
    assert turns[0] > 10
    assert turns[1] == 1
