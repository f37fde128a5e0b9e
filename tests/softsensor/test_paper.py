"""The paper's procedures, and its difficulty reproduced on two virtual measurements."""

import time
from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.fitting.identifiability import held_against
from softsensor.fitting.one_run import fit_run
from softsensor.fitting.paper.ode import lines_of
from softsensor.fitting.paper.procedures import METHODS, _prepare, fit_as_paper
from softsensor.fitting.paper.virtual_runs import reproduce_paper
from softsensor.heat.model import ThermalModel
from softsensor.signals.moments import moments_of
from softsensor.signals.robust import channel_scatter

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


def test_both_solvers_agree_on_a_run_that_is_cut_before_the_press_opens_or_closes(measured):
    run, truth = measured
    names = MODEL.press.coefficient_names
    h = np.array([truth.coefficients[n] for n in names])
    for until_s in (truth.moments.opened_s - 3.0, truth.moments.closed_s - 3.0):
        cut = run.at_rows(np.flatnonzero(run.time_s < until_s))
        moments = replace(truth.moments, opened_s=np.nan, removed_s=np.nan)
        if until_s < truth.moments.closed_s:
            moments = replace(moments, closed_s=np.nan)
        case = MODEL.prepare(cut, moments)
        adaptive, _ = lines_of(MODEL, case, names, ("panel.top", "panel.bottom")).solve(h, sensitivities=False)
        exact = MODEL.solve(case, truth.coefficients, names)
        columns = [exact.columns.index(c) for c in ("top_1", "bottom_1")]
        assert np.sqrt(np.mean((adaptive - exact.sensors[:, columns]) ** 2)) < 0.1


def test_a_boundary_that_is_not_measured_is_refused_by_the_papers_solver(measured):
    run, truth = measured
    text = press_toml().replace('kind = "measured"\ncolumn = "platen_top"', 'kind = "insulated"')
    model = ThermalModel.of(parse_press(text))
    case = model.prepare(run, truth.moments)
    with pytest.raises(InputError, match=r"boundary\.top is insulated"):
        lines_of(model, case, model.press.coefficient_names, ("panel.top",))


def test_all_of_the_papers_methods_end_at_the_same_coefficients(measured):
    run, truth = measured
    found = [fit_as_paper(MODEL, run, truth.moments, method).values for method in METHODS]
    for name in ("h_pp_c", "h_pp_o", "h_wa", "h_p_c"):
        values = [f[name] for f in found]
        assert max(values) / min(values) < 1.02, name
        assert abs(np.log(values[0] / truth.coefficients[name])) < 0.25, name


@pytest.mark.parametrize("closed_column", [True, False], ids=["limit switch", "detected"])
@pytest.mark.parametrize("method", ["least_squares", "nelder_mead_then_least_squares:averages"])
def test_papers_method_finds_the_contact_with_moments_a_real_run_has(method, closed_column):
    plan = Plan(rate_hz=1.0, thickness_mm=16.0, press_time_s=(20.0, 25.0), closed_column=closed_column)
    for run, truth in make_campaign(17, 2, plan=plan):
        fitted = fit_run(MODEL, run, moments_of(run, MODEL.press), method=method)
        contact = fitted.coefficients["h_pp_c"]
        assert fitted.converged
        assert abs(np.log(contact.value / truth.coefficients["h_pp_c"])) < 0.15
        assert contact.ci95[0] < contact.value < contact.ci95[1]
        assert fitted.rmse_K < fitted.initial_rmse_K


def test_papers_method_takes_its_verdicts_from_the_run():
    plan = Plan(rate_hz=2.0, thickness_mm=16.0, open_before_s=(15.0, 20.0), start_before_s=0.0, closed_column=True)
    run, truth = make_campaign(11, 1, plan=plan)[0]
    keep = run.time_s < truth.moments.closed_s - 1.0
    short = run.at_rows(keep)
    fitted = fit_run(MODEL, short, moments_of(short, MODEL.press), method="least_squares")
    assert fitted.coefficients["h_pp_c"].verdict == "not identifiable"
    assert "while the press is closed" in str(fitted.coefficients["h_pp_c"].reason)
    assert any(str(w).startswith("h_pp_c is not identifiable") for w in fitted.warnings)
    assert fitted.coefficients["h_pp_o"].identifiable


def test_search_that_ends_far_from_what_the_run_allows_is_not_called_converged(measured):
    run, truth = measured
    own = fit_run(MODEL, run, truth.moments)
    worse = replace(own, rmse_still_K=3.0 * own.rmse_still_K)
    judged = held_against(worse, own)
    assert not judged.converged
    assert any("stuck" in str(w) and f"{own.rmse_still_K:.2f} K" in str(w) for w in judged.warnings)
    far = replace(own.coefficients["h_pp_c"], value=5696.0, ci95=(5000.0, 6500.0))
    judged = held_against(replace(own, coefficients={**own.coefficients, "h_pp_c": far}), own)
    assert any(str(w).startswith("h_pp_c = 5696 W/m²K lies outside what the run allows") for w in judged.warnings)


def test_slopes_of_the_papers_residuals_are_those_of_differences(measured):
    run, truth = measured
    for every in (False, True):
        problem = _prepare(MODEL, run, truth.moments, every)
        x = np.log([truth.coefficients[n] for n in problem.names]) + 0.1
        jacobian = problem.jacobian(problem.solution(x, derive=True)[1])
        for i in range(len(x)):
            step = np.zeros(len(x))
            step[i] = 1e-4
            ends = [problem.residuals(problem.solution(x + s * step, derive=False)[0]) for s in (1.0, -1.0)]
            assert jacobian[:, i] == pytest.approx(
                (ends[0] - ends[1]) / 2e-4, abs=2e-3 * np.abs(jacobian[:, i]).max()
            )


def test_sensors_that_scatter_weigh_less():
    rng = np.random.default_rng(3)
    cells = 100.0 + np.concatenate([rng.normal(0, 0.3, (200, 7)), rng.normal(0, 2.0, (200, 7))])
    apart = channel_scatter(cells, own_offsets=True)
    assert np.median(apart[:200]) == pytest.approx(0.3 * np.sqrt(6 / 7), rel=0.1)
    assert np.median(apart[200:]) == pytest.approx(2.0 * np.sqrt(6 / 7), rel=0.1)


def test_a_run_the_model_cannot_meet_stays_within_the_limits(measured):
    """Averages and gradient alone, from guesses far off and without the limits' help, once divided by zero."""
    run, truth = measured
    wild = {name: 1.5 for name in MODEL.press.coefficient_names} | {"h_pp_c": 49000.0}
    found = fit_as_paper(MODEL, run, truth.moments, "least_squares", start=wild)
    for name, value in found.values.items():
        table = MODEL.press.coefficient(name)
        assert 0.999 * table.lower <= value <= 1.001 * table.upper


def test_unknown_method_is_refused_with_the_known_ones(measured):
    run, truth = measured
    with pytest.raises(InputError, match=r"method 'annealing': must be one of least_squares"):
        fit_as_paper(MODEL, run, truth.moments, "annealing")


@pytest.mark.campaign
def test_finite_differences_of_an_adaptive_solver_get_stuck_and_nothing_else_does():
    found = reproduce_paper(2, clock=time.perf_counter)
    converged = {(c.solver, c.slopes): c.converged for c in found.table}
    assert converged[("adaptive", "finite differences")] == 0
    assert converged[("exact", "finite differences")] == 2
    assert converged[("exact", "exact sensitivities")] == 2
    turns = [np.sum(np.diff(np.sign(np.diff(y))) != 0) for y in (found.adaptive, found.exact)]
    assert turns[0] > 10
    assert turns[1] == 1
