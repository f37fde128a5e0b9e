"""What a run can and cannot tell: verdicts come from the profile of the run at hand."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.fitting.identifiability import _side, profile, profile_rise
from softsensor.fitting.one_run import fit_run
from softsensor.heat.model import ThermalModel
from tests.panels import panel_stated
from tests.softsensor.known_before import knowing

PRESS = parse_press(press_toml())
MODEL = ThermalModel.of(PRESS)
PLAN = Plan(rate_hz=2.0, start_before_s=0.0, open_before_s=(15.0, 20.0), thickness_mm=16.0)


@pytest.fixture(scope="module")
def measured():
    return make_campaign(11, 1, plan=replace(PLAN, nuisances=Nuisances.real_chain()))[0]


def test_full_run_shows_the_main_coefficients_within_thirty_percent_of_a_panel_that_was_measured():
    """By a data sheet's constants they are known to a factor of 1.75 at least: panel and contact act alike."""
    exact = replace(PLAN, nuisances=Nuisances.real_chain(), panel_spread=0.0)
    run, truth = make_campaign(11, 1, plan=exact)[0]
    stated = fit_run(MODEL, panel_stated(run, 0.01), truth.moments)
    sheet = fit_run(MODEL, run, truth.moments)
    for name in ("h_pp_c", "h_pp_o", "h_wa"):
        c, wide = stated.coefficients[name], sheet.coefficients[name]
        assert c.identifiable
        assert wide.identifiable
        assert c.ci95[1] / c.ci95[0] < 1.3**2, name
        assert c.ci95[1] / c.ci95[0] < wide.ci95[1] / wide.ci95[0] < 1.75**2, name


def test_run_that_ends_while_closed_cannot_tell_what_happens_after_opening(measured):
    run, truth = measured
    fitted = fit_run(MODEL, run.at_rows(run.time_s <= truth.moments.opened_s - 1.0), truth.moments)
    panel_air, contact = fitted.coefficients["h_wa"], fitted.coefficients["h_pp_c"]
    assert contact.identifiable
    assert panel_air.ci95[1] / panel_air.ci95[0] > 2.0
    if not panel_air.identifiable:
        assert "after opening" in str(panel_air.reason)
        assert any("h_wa" in str(w) for w in fitted.warnings)


def test_run_that_never_closes_says_nothing_about_closed_contacts(measured):
    run, truth = measured
    fitted = fit_run(MODEL, run.at_rows(run.time_s <= truth.moments.closed_s - 1.5), truth.moments)
    for name in ("h_pp_c", "h_p_c"):
        c = fitted.coefficients[name]
        assert c.verdict == "not identifiable"
        assert c.ci95 == pytest.approx((10.0, 50000.0))
        assert "while the press is closed" in str(c.reason)
    assert fitted.coefficients["h_pp_o"].identifiable


def test_contact_too_good_to_be_seen_is_known_from_below_only():
    plan = replace(PLAN, rate_hz=1.0, coefficients={**PLAN.coefficients, "h_pp_c": 40000.0})
    run, truth = make_campaign(5, 1, plan=plan)[0]
    c = fit_run(MODEL, run, truth.moments).coefficients["h_pp_c"]
    assert c.verdict == "one-sided"
    assert 1000.0 < c.ci95[0] < truth.coefficients["h_pp_c"]
    assert c.ci95[1] == pytest.approx(50000.0)


def test_what_only_a_prior_says_is_not_called_identified(measured):
    run, truth = measured
    short = run.at_rows(run.time_s <= truth.moments.closed_s - 1.5)
    fitted = fit_run(knowing(MODEL, h_pp_c=(700.0, 0.2)), short, truth.moments)
    c = fitted.coefficients["h_pp_c"]
    assert not c.identifiable
    assert c.value == pytest.approx(700.0, rel=0.05)


def test_profile_rises_on_both_sides_of_an_identifiable_coefficient(measured):
    run, truth = measured
    fitted = fit_run(MODEL, run, truth.moments)
    shape = profile(fitted, "h_pp_c")
    assert np.all(np.diff(shape.value) > 0)
    assert shape.value[2] == pytest.approx(fitted.coefficients["h_pp_c"].value)
    assert shape.rise[0] > shape.threshold
    assert shape.rise[-1] > shape.threshold
    assert shape.rise[2] == 0.0
    assert np.all(np.diff(np.sign(np.diff(shape.rise))) >= 0)


def test_an_interval_of_a_single_run_ends_where_the_likelihood_has_fallen_by_its_quantile(measured):
    run, truth = measured
    fitted = fit_run(MODEL, run, truth.moments, company=None)
    i = fitted.names.index("h_pp_o")
    wanted = 0.5 * fitted.quantile**2 * fitted.spread**2
    for direction in (-1, 1):
        side = _side(fitted, i, direction, 0.1)
        assert side.closed
        assert profile_rise(fitted, i, side.x, steps=20) == pytest.approx(wanted, rel=0.25)


def test_value_at_a_limit_has_no_standard_deviation_and_a_one_sided_interval():
    text = press_toml().replace(
        "guess = 12.0\nlower = 1.0\nupper = 200.0", "guess = 4.0\nlower = 1.0\nupper = 6.0"
    )
    press = parse_press(text)
    run, truth = make_campaign(11, 1, plan=PLAN)[0]
    fitted = fit_run(ThermalModel(press), run, truth.moments)
    c = fitted.coefficients["h_wa"]
    assert truth.coefficients["h_wa"] > 6.0
    assert c.value == pytest.approx(6.0)
    assert np.isnan(c.sd)
    assert fitted.as_json()["coefficients"]["h_wa"]["sd"] is None
    assert c.ci95[1] == pytest.approx(6.0)
    assert c.verdict != "identifiable"


def test_remedy_speaks_of_the_run_at_hand(measured):
    run, truth = measured
    short = fit_run(
        knowing(MODEL, h_ap=(10.0, 2.0)), run.at_rows(run.time_s <= truth.moments.opened_s + 6.0), truth.moments
    )
    reason = str(short.coefficients["h_ap"].reason)
    assert not short.coefficients["h_ap"].identifiable
    assert "6 s after opening in this run" in reason
    assert "logging for a minute after opening" in reason or "thermocouple" in reason or "instead of" in reason


def test_override_of_a_limit_in_the_header_reaches_the_fit(measured):
    run, truth = measured
    held = replace(run, header={**run.header, "coefficients.h_ap.fixed": True, "coefficients.h_ap.guess": 11.0})
    c = fit_run(MODEL, held, truth.moments).coefficients["h_ap"]
    assert c.verdict == "fixed"
    assert c.value == 11.0


@pytest.mark.parametrize("moment", ["closed_s", "opened_s"])
def test_moment_in_a_gap_is_searched_there_and_said(measured, moment):
    run, truth = measured
    at = getattr(truth.moments, moment)
    keep = (run.time_s < at - 3.0) | (run.time_s > at + 6.0)
    gap = run.at_rows(keep)
    late = float(gap.time_s[gap.time_s > at][0])
    fitted = fit_run(MODEL, gap, replace(truth.moments, **{moment: late}))
    assert abs(getattr(fitted, moment) - at) < 1.0
    assert any("no rows from" in str(w) for w in fitted.warnings)
    for name in ("h_pp_c", "h_pp_o"):
        c = fitted.coefficients[name]
        assert abs(np.log(c.value / truth.coefficients[name])) < 4.0 * c.sd / c.value, name
