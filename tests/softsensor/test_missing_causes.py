"""What runs say about causes their model leaves out."""

import json
from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from softsensor.diagnosis.missing_causes import (
    RunEvidence,
    missing_causes,
    run_evidence,
    stored_missing_causes,
    with_missing_causes,
)
from softsensor.effects import find_effect
from softsensor.fitting.problem import minimise
from softsensor.heat.model_file import model_text
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.campaign import fit_campaign
from softsensor.jobs.fitter import fit_one

PRESS = parse_press(press_toml())
PLAN = Plan(rate_hz=2.0, thickness_mm=16.0, press_time_s=(50.0, 90.0), closed_column=False)
RUNS = 4


@pytest.fixture(scope="module")
def plain():
    return fit_campaign(PRESS, [run for run, _ in make_campaign(61, RUNS, None, PLAN)])


@pytest.fixture(scope="module")
def steaming():
    return fit_campaign(
        PRESS, [run for run, _ in make_campaign(62, RUNS, {"vapour_convection": {"W_m3K": 1.5e4}}, PLAN)]
    )


def evidence(fit):
    return [run_evidence(f.problem, f.minimum.evaluation) for f in fit.runs]


def test_nothing_is_the_likeliest_where_nothing_is_missing(plain):
    seen = missing_causes(evidence(plain))
    assert seen.runs == RUNS
    assert seen.nothing > max(doubt.chance for doubt in seen.causes.values())
    assert abs(seen.causes["vapour_convection"].size) < 0.2
    assert seen.unexplained_K < 0.2


def test_a_cause_the_coefficients_have_absorbed_is_seen_over_the_runs(steaming):
    seen = missing_causes(evidence(steaming))
    steam = seen.causes["vapour_convection"]
    assert steam.chance > 0.5
    size = steam.parameters["W_m3K"]
    assert abs(size.value - 1.5e4) < 2.0 * size.sd + 2e3


def test_the_score_is_what_a_fit_with_the_cause_would_gain(steaming):
    """The quadratic form against a second way: the cost where the cause is switched on at a small size."""
    fit = steaming.runs[0]
    evidence = run_evidence(fit.problem, fit.minimum.evaluation)["vapour_convection"]
    effect = find_effect("vapour_convection")
    share = 0.1
    values = dict(fit.problem.values) | {"vapour_convection.W_m3K": share * 1.2e4}
    with_cause = replace(fit.problem, model=fit.problem.model.extended(effect), values=values)
    again = minimise(with_cause, fit.minimum.x, decrease=1e-4)
    gained = fit.minimum.evaluation.loss - again.evaluation.loss
    assert gained == pytest.approx(share * evidence.score - 0.5 * share**2 * evidence.power, rel=0.25, abs=0.5)


def test_a_model_file_carries_it_there_and_back(steaming):
    model = with_missing_causes(steaming.model_file(), steaming.runs)
    assert parse_model(json.loads(model_text(model)), "model.json").missing == model.missing


def test_stored_fits_carry_it_too(plain):
    run = plain.runs[0].problem.case.run
    entry = json.loads(json.dumps(fit_one(PRESS, run, None)))
    seen = stored_missing_causes([entry, {"coefficients": {}}])
    assert seen is not None
    assert seen.runs == 1
    assert stored_missing_causes([{"coefficients": {}}]) is None


def test_a_cause_that_can_only_add_is_not_blamed_for_the_opposite():
    runs = [{"": RunEvidence(0, 0, {}, 0.1), "edge_loss": RunEvidence(-30.0, 20.0, {}, 0.1)} for _ in range(5)]
    seen = missing_causes(runs)
    assert seen.causes["edge_loss"].size == pytest.approx(0.0, abs=1e-9)
    assert seen.nothing > 0.9


def test_more_runs_leave_less_doubt():
    rng = np.random.default_rng(3)

    def chance(count):
        runs = [
            {"": RunEvidence(0, 0, {}, 0.1), "edge_loss": RunEvidence(5.0 * rng.standard_normal(), 25.0, {}, 0.1)}
            for _ in range(count)
        ]
        return missing_causes(runs).causes["edge_loss"]

    few, many = chance(3), chance(60)
    assert many.chance < few.chance
    assert many.parameters["W_m3K"].sd < few.parameters["W_m3K"].sd
