"""A run that the model does not describe says nothing about coefficients, and that is told before all else."""

import json
from dataclasses import astuple, replace

import numpy as np
import pytest

from api.commands.fitting import _lines
from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.diagnosis.missing_causes import stored_missing_causes, with_missing_causes
from softsensor.fitting.one_run import fit_run
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import model_text
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.campaign import fit_campaign
from softsensor.report.fit_figures import _campaign_title
from softsensor.report.fit_report import fit_report
from softsensor.signals.moments import moments_of

PRESS = parse_press(press_toml())
NAMES = PRESS.coefficient_names
PLAN = Plan(rate_hz=1.0, thickness_mm=16.0, press_time_s=(20.0, 40.0), open_after_s=(30.0, 40.0))


def _without(run, begin_s, end_s):
    return run.at_rows((run.time_s < begin_s) | (run.time_s > end_s))


def _late(run, truth):
    """The record begins in the middle of the pressing."""
    return _without(run, 0.0, truth.moments.closed_s + 10.0)


@pytest.fixture(scope="module")
def measured():
    return make_campaign(6, 9, plan=replace(PLAN, nuisances=Nuisances.real_chain()))


@pytest.fixture(scope="module")
def found(measured):
    """Nine runs, the fourth begun too late."""
    runs = [_late(run, truth) if i == 3 else run for i, (run, truth) in enumerate(measured)]
    return fit_campaign(PRESS, runs, profiles=True)


def remains(fit):
    return f"residual at rest {fit.rmse_still_K:.1f} K, where the readings span "


def test_run_whose_record_begins_too_late_is_called_not_described(found):
    bad = found.runs[3]
    assert bad.rmse_K > 5.0
    assert not bad.met
    assert all(f.met for f in found.runs if f is not bad)
    for name in NAMES:
        c = bad.coefficients[name]
        assert not c.identifiable
        assert str(c.reason).startswith(f"the model does not describe this run: {remains(bad)}")
        assert c.ci95 == (PRESS.coefficient(name).lower, PRESS.coefficient(name).upper)
    assert sum("does not describe" in str(w) for w in bad.warnings) == 1


def test_campaign_without_the_run_is_the_same_campaign(found, measured):
    others = fit_campaign(PRESS, [run for i, (run, _) in enumerate(measured) if i != 3])
    for name in NAMES:
        np.testing.assert_equal(astuple(found.coefficients[name]), astuple(others.coefficients[name]))
    assert found.model_file().as_json() == others.model_file().as_json()
    assert found.dependence.as_json() == others.dependence.as_json()
    assert set(found.borrowed) == {f.run for f in others.runs}
    assert with_missing_causes(found.model_file(), found.runs).missing.runs == 8


def test_report_and_json_say_it_before_all_else(found):
    bad = found.runs[3]
    page = fit_report(found).replace("\N{NO-BREAK SPACE}", " ")
    text = f"The model does not describe 1 of 9 runs: {bad.run} ({remains(bad)}"
    assert page.partition('class="finding">')[2].startswith(text)
    assert "Fitted to 8 runs" in page
    assert f"{bad.run} (not described" in page
    lines = list(_lines(found))
    assert lines[0].startswith(text)
    assert next(line for line in lines if line.lstrip().startswith(bad.run)).split()[1:7] == ["–"] * 6
    content = json.loads(json.dumps(found.as_json(), allow_nan=False))["runs"][3]
    assert content["met"] is False
    assert any("does not describe" in w for w in content["warnings"])
    assert all(table["sd"] is None for table in content["coefficients"].values())
    assert "joint" not in content["coefficients"]["h_wa"]


def test_run_by_itself_gives_no_coefficient_and_a_model_file_of_guesses(found, measured):
    alone = fit_campaign(PRESS, [_late(*measured[3])], profiles=True)
    assert str(alone.shortfall).startswith(f"The model does not describe this run: {remains(alone.runs[0])}")
    assert str(alone.shortfall) in fit_report(alone).replace("&#39;", "'").replace("\N{NO-BREAK SPACE}", " ")
    model = parse_model(json.loads(model_text(with_missing_causes(alone.model_file(), alone.runs))), "text")
    for name in NAMES:
        table, c = PRESS.coefficient(name), alone.coefficients[name]
        assert c.runs == 0
        assert c.median == pytest.approx(table.guess, rel=1e-3)
        assert c.median_ci95 == pytest.approx((table.lower, table.upper))
        assert model.coefficients[name].value == pytest.approx(table.guess, rel=1e-3)
    assert model.missing.unexplained_K > 0.5


def test_press_file_with_the_faces_exchanged_is_noticed(measured):
    text = press_toml().replace('"top_*"', '"_"').replace('"bottom_*"', '"top_*"').replace('"_"', '"bottom_*"')
    fitted = fit_campaign(parse_press(text), [run for run, _ in measured[:2]])
    assert not fitted.met
    assert str(fitted.shortfall).startswith("The model describes none of these runs")
    page = fit_report(fitted).replace("\N{NO-BREAK SPACE}", " ")
    assert page.partition('class="finding">')[2].startswith("The model describes none of these runs")
    assert str(_campaign_title(fitted)).startswith("No coefficient is known")
    assert next(_lines(fitted)) == str(fitted.shortfall)


def test_causes_a_diagnosis_is_there_for_do_not_make_a_run_a_misfit():
    hidden = {"moisture_evaporation": {"moisture_percent": 4.0, "temperature_C": 102.0}}
    runs = [run for run, _ in make_campaign(7, 2, hidden, replace(PLAN, press_time_s=(50.0, 90.0)))]
    fits = fit_campaign(PRESS, runs).runs
    assert all(f.rmse_K > 0.8 for f in fits)
    assert all(f.met for f in fits)


def test_stored_fits_of_runs_not_described_carry_no_evidence():
    cause = {"score": 5.0, "power": 20.0, "absorbed": {}, "rest_K": 0.1}
    nothing = {"score": 0.0, "power": 0.0, "absorbed": {}, "rest_K": 0.1}
    good = {"met": True, "evidence": {"": nothing, "edge_loss": cause}}
    bad = {"met": False, "evidence": {"": {**nothing, "rest_K": 9.0}, "edge_loss": {**cause, "score": 500.0}}}
    assert stored_missing_causes([good, bad, good]) == stored_missing_causes([good, good])
    assert stored_missing_causes([bad]).unexplained_K == pytest.approx(np.sqrt(0.1**2), abs=0.1)


@pytest.mark.parametrize("switch", [True, False], ids=["limit switch", "detected"])
def test_insertion_and_closing_in_one_gap_are_not_made_up(switch):
    plan = replace(PLAN, start_before_s=10.0, closed_column=switch, nuisances=Nuisances.real_chain())
    run, truth = make_campaign(6, 4, plan=plan)[3]
    m = truth.moments
    lost = fit_campaign(PRESS, [_without(run, m.inserted_s - 0.5, m.closed_s + 5.0)])
    assert str(lost.shortfall).startswith(
        "The model does not describe this run: insertion and closing fall into one gap"
    )
    assert not any(c.identifiable for c in lost.runs[0].coefficients.values())
    inside = fit_campaign(PRESS, [_without(run, m.inserted_s + 4.5, m.closed_s + 5.0)])
    assert inside.runs[0].met
    first = run.time_s >= m.inserted_s
    cut = run.at_rows(first)
    assert fit_campaign(PRESS, [_without(cut, m.inserted_s + 4.5, m.closed_s + 5.0)]).runs[0].met


def _breaking_off(run, *moments):
    """The record lacks 12 s from the second row after each of these moments on."""
    for at in moments:
        later = run.time_s[run.time_s > at]
        run = _without(run, later[1], later[0] + 12.0)
    return run


@pytest.mark.parametrize("switch", [True, False], ids=["limit switch", "detected"])
@pytest.mark.parametrize("rate_hz", [2.0, 0.5])
def test_a_press_that_closes_just_before_a_gap_is_met_there_and_not_in_its_middle(switch, rate_hz):
    plan = Plan(rate_hz=rate_hz, closed_column=switch, press_time_s=(40.0, 60.0))
    for run, truth in make_campaign(8640001 if rate_hz < 1.0 else 8640000, 2, None, plan):
        closed = truth.moments.closed_s
        fitted = fit_campaign(PRESS, [_breaking_off(run, closed)]).runs[0]
        assert fitted.met
        assert fitted.closed_s == pytest.approx(closed, abs=0.5)


@pytest.mark.parametrize(("rate_hz", "seed", "number"), [(0.5, 8640001, 0), (1.0, 8640003, 0), (1.0, 8640003, 1)])
def test_a_press_that_moves_just_before_two_gaps_is_met_at_both(rate_hz, seed, number):
    plan = Plan(rate_hz=rate_hz, closed_column=True, press_time_s=(40.0, 60.0), start_before_s=12.0)
    run, truth = make_campaign(seed, 3, None, plan)[number]
    m = truth.moments
    fitted = fit_campaign(PRESS, [_breaking_off(run, m.closed_s, m.opened_s)]).runs[0]
    assert fitted.rmse_still_K < 0.35
    assert (fitted.closed_s, fitted.opened_s) == pytest.approx((m.closed_s, m.opened_s), abs=0.5)


def test_a_spike_in_a_platen_channel_moves_no_coefficient_and_is_told(measured):
    run, _ = measured[0]
    spiked = run.columns["platen_top"].copy()
    spiked[[20, 45]] += 150.0
    spoiled = replace(run, columns=run.columns | {"platen_top": spiked})
    sound, mended = fit_campaign(PRESS, [run, replace(spoiled, name="spiked")]).runs
    assert any("platen_top: 2 single cells jump" in str(w) for w in mended.warnings)
    assert not any("single cells jump" in str(w) for w in sound.warnings)
    for name in ("h_p_c", "h_pp_c"):
        log_change = np.log(mended.coefficients[name].value / sound.coefficients[name].value)
        assert abs(log_change) < 0.02


def test_white_noise_in_place_of_faces_is_no_description(measured):
    run, _ = measured[0]
    rng = np.random.default_rng(5)
    faces = {c: rng.normal(100.0, 30.0, len(v)) for c, v in run.columns.items() if c.startswith(("top", "bottom"))}
    (fitted,) = fit_campaign(PRESS, [replace(run, columns=run.columns | faces)]).runs
    assert not fitted.met
    assert not any(c.identifiable for c in fitted.coefficients.values())


def test_a_pressing_with_a_cause_that_the_model_lacks_is_not_met_as_one_outlier_and_a_slow_departure():
    run, truth = make_campaign(8610003, 2, effects=["resin_cure"])[1]
    fit = fit_run(ThermalModel(PRESS), run, moments_of(run, PRESS), company=None)
    assert fit.rmse_K < 0.75 * fit.initial_rmse_K
    assert fit.rmse_still_K < 0.5
    assert fit.closed_s == pytest.approx(truth.moments.closed_s, abs=1.0)  # a row
