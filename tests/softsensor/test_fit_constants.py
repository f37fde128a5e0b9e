"""A fit's intervals hold what its constants leave open, and a campaign learns how its panels scatter."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.fitting.constants import ConstantFit, changed_run, constants_of, scatter_of, with_constants
from softsensor.fitting.one_run import make_problem
from softsensor.fitting.problem import carried_among, minimise
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import Scatter
from softsensor.jobs.campaign import fit_runs
from softsensor.jobs.model_in_force import combined_model
from softsensor.signals.doubt import Origin
from softsensor.signals.moments import moments_of
from tests.panels import panel_stated

PRESS = parse_press(press_toml())
MODEL = ThermalModel(PRESS)
MAIN = ("h_pp_c", "h_pp_o", "h_wa")
K, C = "panel.conductivity_W_mK", "panel.heat_capacity_J_kgK"


def _campaign(seeds, spread, runs=3):
    plan = Plan(rate_hz=1.0, nuisances=Nuisances.real_chain(), panel_spread=spread)
    return [pair for seed in seeds for pair in make_campaign(seed, runs, plan=plan)]


def test_intervals_cover_the_truth_where_panels_scatter():
    """24 runs; without the constants' doubt, 0.06 to 0.75 of the three were covered (2026-11)."""
    pairs = _campaign(range(40, 46), 0.055, runs=4)
    fits = fit_runs(MODEL, [panel_stated(run, 0.055) for run, _ in pairs])
    hits = [
        f.coefficients[n].ci95[0] <= t.coefficients[n] <= f.coefficients[n].ci95[1]
        for f, (_, t) in zip(fits, pairs, strict=True)
        for n in MAIN
        if f.coefficients[n].identifiable
    ]
    assert len(hits) >= 60
    assert np.mean(hits) >= 0.88


def test_intervals_widen_with_what_the_header_says_of_its_constants():
    run = _campaign([40], 0.0, runs=1)[0][0]
    sure, unsure = fit_runs(MODEL, [panel_stated(run, 0.001), panel_stated(run, 0.08)])
    for name in MAIN:
        a, b = sure.coefficients[name].ci95, unsure.coefficients[name].ci95
        assert np.log(b[1] / b[0]) > 2.0 * np.log(a[1] / a[0]), name


def test_a_constant_is_moved_towards_the_panels_own_and_never_known_worse_than_before():
    pairs = _campaign([40, 43], 0.08, runs=4)
    fits = fit_runs(MODEL, [panel_stated(run, 0.08) for run, _ in pairs])
    before, after = [], []
    for f, (_, t) in zip(fits, pairs, strict=True):
        true = {K: t.panel.conductivity, C: t.panel.heat_capacity}
        for key, constant in f.constants.items():
            assert constant.value_sd < constant.sd
            if key in true:
                before.append(constant.given / true[key] - 1.0)
                after.append(constant.value / true[key] - 1.0)
    assert np.mean(np.square(after)) < np.mean(np.square(before))


def test_density_and_heat_capacity_are_one_unknown():
    run = _campaign([40], 0.0, runs=1)[0][0]
    (fitted,) = fit_runs(MODEL, [run])
    assert not [key for key in fitted.constants if key.endswith("density_kg_m3")]
    assert fitted.constants[C].sd / fitted.constants[C].given > 0.06


def _known(value, sd, prior=0.1):
    return {K: ConstantFit(1.0, prior, Origin.DATA_SHEET, value, sd)}


def test_scatter_of_constants_known_exactly_is_their_second_moment():
    values = np.array([1.1, 0.9, 1.2, 0.8, 1.05, 0.95] * 20)
    found = scatter_of(_known(v, 1e-6) for v in values)[K]
    expected = (np.sum((values - 1.0) ** 2) + 2.0 * 0.055**2) / (len(values) + 2.0)
    assert found.runs == len(values)
    assert found.panel == pytest.approx(np.sqrt(expected), rel=0.01)
    assert found.sd == pytest.approx(np.sqrt(expected), rel=0.02)


def test_what_all_panels_are_off_together_is_no_scatter_between_them():
    """Twenty panels alike and 15 % off the header, each known exactly; and panels known to 7 % each."""
    exactly = scatter_of(_known(1.15, 1e-6, 0.2) for _ in range(20))[K]
    assert exactly.panel == pytest.approx(0.055 * np.sqrt(2.0 / 22.0), rel=0.05)
    assert exactly.sd == pytest.approx(0.15, rel=0.02)
    alike = scatter_of(_known(1.0, 0.07, 0.2) for _ in range(20))[K]
    apart = scatter_of(_known(1.0 + off, 0.07, 0.2) for off in (0.12, -0.12) * 10)[K]
    assert alike.panel < alike.sd < 0.06 < 0.1 < apart.panel < apart.sd


def test_scatter_of_constants_that_no_run_knows_stays_what_it_was():
    """20 % for the product and 5.5 % for its panels; of a thickness what it was in doubt by."""
    unknown = ConstantFit(1.0, 0.1, Origin.DATA_SHEET, 1.07, 0.1)
    found = scatter_of({K: unknown, "panel.thickness_mm": unknown} for _ in range(5))
    assert found[K].panel == pytest.approx(0.055, rel=1e-3)
    assert found[K].sd == pytest.approx(np.hypot(0.2, 0.055), rel=1e-3)
    assert found["panel.thickness_mm"].sd == pytest.approx(0.1, rel=1e-3)


def test_readings_that_scatter_more_say_less_of_value_and_doubt_alike():
    """Each pair of value and doubt is a Gaussian one: without the prior the value lies where the readings put it.

    Doubts widened by what the model leaves over, values that were not, gave a scatter of 1e7 (2026-11-23).
    """
    run = _campaign([40], 0.08, runs=1)[0][0]
    problem = make_problem(MODEL, panel_stated(run, 0.08), moments_of(run, PRESS))
    problem = with_constants(problem, problem.start)
    best = minimise(problem)
    usual, noisy, lost = (constants_of(problem, best, spread) for spread in (1.0, 3.0, 1e3))
    for key, constant in usual.items():
        assert abs(lost[key].value - constant.given) < 0.01 * constant.sd, key
        assert constant.value_sd <= noisy[key].value_sd <= lost[key].value_sd < constant.sd * (1.0 + 1e-9), key
    assert usual[K].value_sd < 0.9 * usual[K].sd


def test_the_live_sensors_model_learns_the_scatter_from_the_fits_of_the_newest_runs():
    values = (1.1, 0.9, 1.2, 0.8, 1.05, 0.95)
    fits = [{"constants": {K: _known(v, 1e-6)[K].as_json()}} for v in values]
    base = replace(combined_model(PRESS, None, []), scatter={C: Scatter(0.03, 40, 0.03)})
    learned = combined_model(PRESS, base, fits).learned
    assert learned == {C: 0.03, K: scatter_of(_known(v, 1e-6) for v in values)[K].sd}


def test_what_is_stated_of_a_panel_says_nothing_of_the_others():
    stated = ConstantFit(1.0, 0.02, Origin.STATED, 1.01, 0.01)
    assert scatter_of([{K: stated}]) == {}


@pytest.mark.parametrize(("sd", "carried"), [({}, False), ({"ambient.temperature_C.sd": 2.0}, True)])
def test_intervals_carry_a_room_that_nobody_gave_where_its_deviation_is_stated(sd, carried):
    run = _campaign([40], 0.0, runs=1)[0][0]
    header = {key: value for key, value in run.header.items() if not key.startswith("ambient.")} | sd
    problem = make_problem(MODEL, replace(run, header=header), moments_of(run, PRESS))
    names = [problem.unknowns[i].name for i in carried_among(problem)]
    assert any("ambient.temperature_C" in name for name in names) == carried


def test_a_table_in_temperature_moves_as_a_whole():
    run = _campaign([40], 0.0, runs=1)[0][0]
    key = "layer.plate_top.conductivity_W_mK"
    run = type(run)(run.name, {**run.header, key: [[20.0, 40.0], [200.0, 30.0]]}, run.time_s, run.columns, "")
    assert changed_run(run, PRESS, key, 4.0).header[key] == [[20.0, 44.0], [200.0, 33.0]]
