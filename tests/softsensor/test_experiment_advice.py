"""Advice is true for the run at hand: what it has, what it is fitted with, what it rests on."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.fitting.experiment_advice import ALONE, Company, apart, repeats_for, role_of
from softsensor.fitting.one_run import fit_run
from softsensor.heat.model import ThermalModel
from tests.softsensor.known_before import knowing

PRESS = parse_press(press_toml())
MODEL = ThermalModel(PRESS)
PLAN = Plan(
    rate_hz=2.0, thickness_mm=16.0, press_time_s=(20.0, 25.0), open_before_s=(8.0, 10.0),
    open_after_s=(30.0, 32.0), closed_column=False, nuisances=Nuisances.real_chain(),
)  # fmt: skip


@pytest.fixture(scope="module")
def measured():
    return make_campaign(11, 1, plan=PLAN)[0]


@pytest.fixture(scope="module")
def fitted(measured):
    run, truth = measured
    return fit_run(knowing(MODEL, h_ap=(10.0, 0.2)), run, truth.moments)


def _advice(fitted, partner, company=ALONE, name="h_p_o"):
    return str(apart(fitted, partner, role_of(PRESS, name, fitted), company))


def test_sharing_is_advised_only_where_runs_can_share_and_do_not_yet(fitted):
    assert "(--shared h_ap)" in _advice(fitted, "h_ap", Company(3))
    assert "--shared" not in _advice(fitted, "h_ap")
    assert "--shared" not in _advice(fitted, "h_ap", Company(3, ("h_ap",)))
    assert "--shared" not in _advice(fitted, "edge_loss.W_m3K", Company(3))


def test_moments_are_told_better_by_what_the_record_lacks(fitted):
    limit = "a limit switch as the column closed"
    assert _advice(fitted, "inserted_s") == "Log faster than the 2 Hz of this run."
    assert limit in _advice(fitted, "closed_s")
    case = fitted.problem.case
    switched = replace(
        case, run=replace(case.run, columns={**case.run.columns, "closed": np.ones(len(case.run.time_s))})
    )
    has = replace(fitted, problem=replace(fitted.problem, case=switched))
    assert limit not in _advice(has, "closed_s")
    signals = replace(has.problem.signals, time_s=0.1 * np.arange(len(case.run.time_s)))
    fast = replace(has, problem=replace(has.problem, signals=signals))
    assert "Log faster" not in _advice(fast, "skew:all")


def test_start_temperature_that_is_in_the_header_is_not_asked_for_again(fitted):
    assert "header" not in _advice(fitted, "initial_K")
    assert _advice(fitted, "initial_K")


def test_no_thermocouple_is_asked_for_where_one_sits(fitted):
    for name in PRESS.coefficient_names:
        role = role_of(PRESS, name, fitted)
        assert "face of panel" not in str(role.beside)
        assert "face of panel" not in str(role.record)
        assert role.record


def test_run_with_channels_above_only_is_told_to_log_those_below(measured):
    run, truth = measured
    above = {n: c for n, c in run.columns.items() if not n.startswith("bottom_")}
    fitted = fit_run(MODEL, replace(run, columns=above), truth.moments)
    unknown = {n: str(c.reason) for n, c in fitted.coefficients.items() if not c.identifiable}
    assert "h_pp_o" in unknown
    assert "Log the channels that this run lacks too (panel, bottom face)" in unknown["h_pp_o"]
    assert not any("face of panel towards upper plate" in reason for reason in unknown.values())


@pytest.mark.parametrize(("before", "after"), [(10.0, 5.0), (10.0, 40.0), (90.0, 40.0), (90.0, 90.0)])
def test_no_longer_state_is_asked_for_than_the_run_has(fitted, before, after):
    t = np.arange(0.0, before + 20.0 + after, 1.0)
    signals = replace(fitted.problem.signals, time_s=t)
    problem = replace(fitted.problem, signals=signals, rows=np.ones(len(t)))
    run = replace(fitted, problem=problem, closed_s=before - 0.5, opened_s=before + 20.0 - 0.5)
    record = str(role_of(PRESS, "h_pp_o", run).record)
    if "instead of" in record:
        assert float(record.partition("instead of ")[2].split()[0]) < 60.0
    else:
        assert min(before, after) >= 60.0


def test_what_was_known_before_does_not_make_fewer_runs_do(measured):
    run, truth = measured
    bare = fit_run(MODEL, run, truth.moments, company=None)
    known = knowing(MODEL, h_ap=(bare.coefficients["h_ap"].value, 0.1))
    fitted = fit_run(known, run, truth.moments, company=None)
    i = bare.problem.names.index("h_ap")
    assert fitted.covariance[i, i] < 0.1 * bare.covariance[i, i]
    assert repeats_for(fitted, i) == pytest.approx(repeats_for(bare, i), rel=0.2, abs=1)


def test_so_many_runs_that_nobody_makes_them_are_no_advice(fitted):
    i = fitted.problem.names.index("h_ap")
    hopeless = replace(fitted, covariance=1e4 * fitted.covariance, spread=100.0 * fitted.spread)
    assert repeats_for(hopeless, i) is None


def test_a_free_back_has_no_platen_to_turn_a_thermocouple_to(fitted):
    air = PRESS.boundary.bottom.model_copy(update={"kind": "air", "column": None, "coefficient": "h_air"})
    free = PRESS.model_copy(update={"boundary": PRESS.boundary.model_copy(update={"bottom": air})})
    assert str(role_of(free, "h_air", fitted).beside) == "Put a thermocouple on the outer face of lower plate."
    assert "towards lower platen" in str(role_of(PRESS, "h_p_o", fitted).beside)
