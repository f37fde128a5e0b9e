"""Runs that share unknowns."""

from dataclasses import replace

import numpy as np
import pytest

from daq.pressfile import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from softsensor.fit import fit_run
from softsensor.fit_joint import fit_shared, minimise_together
from softsensor.fit_problem import minimise
from softsensor.model import ThermalModel

PRESS = parse_press(press_toml())
PLAN = Plan(rate_hz=1.0, thickness_mm=(8.0, 16.0), effect_spread=0.0, press_time_s=(40.0, 60.0))


def test_edge_loss_shared_by_three_runs_is_recovered():
    campaign = make_campaign(9, 3, {"edge_loss": {"W_m3K": 1500.0}}, PLAN)
    model = ThermalModel.of(PRESS, ["edge_loss"])
    runs = [(run, truth.moments) for run, truth in campaign]
    table, found = fit_shared(model, runs, ["edge_loss.W_m3K"], start={"edge_loss.W_m3K": 300.0})
    edge = table["edge_loss.W_m3K"]
    assert found.converged
    assert abs(edge.value - 1500.0) < 3.0 * edge.sd + 150.0


def test_joint_search_over_one_run_ends_where_its_own_search_ends():
    run, truth = make_campaign(9, 1, plan=PLAN)[0]
    problem = fit_run(ThermalModel(PRESS), run, truth.moments, verdicts=False).problem
    alone = minimise(problem)
    together = minimise_together([problem], ["h_pp_c", "h_wa"], decrease=1e-4)
    i = [problem.names.index(n) for n in ("h_pp_c", "h_wa")]
    assert together.x == pytest.approx(alone.x[i], abs=3e-3)
    assert np.sqrt(np.diag(together.covariance)) == pytest.approx(np.sqrt(np.diag(alone.covariance))[i], rel=0.02)


def test_twice_the_runs_know_a_shared_coefficient_better():
    campaign = make_campaign(12, 2, plan=replace(PLAN, coefficient_spread=0.0))
    runs = [(run, truth.moments) for run, truth in campaign]
    model = ThermalModel(PRESS)
    one, _ = fit_shared(model, runs[:1], ["h_ap"])
    two, _ = fit_shared(model, runs, ["h_ap"])
    assert two["h_ap"].sd / two["h_ap"].value < one["h_ap"].sd / one["h_ap"].value
