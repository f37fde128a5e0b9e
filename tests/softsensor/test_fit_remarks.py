"""What a fit says about the record it was given: start temperature, loads."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import Moments
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.diagnosis.verdict import diagnose
from softsensor.fitting.one_run import fit_run, make_problem
from softsensor.fitting.remarks import remarks
from softsensor.heat.model import ThermalModel
from softsensor.signals.moments import moments_of
from tests.daq.test_press_events import pressed_again

PRESS = parse_press(press_toml())
RIG = """
[initial]
kind = "uniform"
temperature_C = 20.0
[[layer]]
name = "block"
thickness_mm = 10.0
conductivity_W_mK = 15.0
density_kg_m3 = 8000.0
heat_capacity_J_kgK = 500.0
[boundary.bottom]
kind = "measured"
column = "hot"
[[contact]]
between = ["boundary.bottom", "block"]
closed = "h"
load = { column = "load_kN", reference = 10.0 }
"""


def _remark_texts(run, press=PRESS):
    moments = moments_of(run, press)
    problem = make_problem(ThermalModel(press), run, moments)
    return remarks(problem.case, problem.signals, moments)


def _run(start_before_s, rate_hz=1.0, seed=5, **header):
    plan = Plan(rate_hz=rate_hz, start_before_s=start_before_s, nuisances=Nuisances.real_chain())
    run, _ = make_campaign(seed, 1, plan=plan)[0]
    return replace(run, header={**run.header, **{k.replace("__", "."): v for k, v in header.items()}})


@pytest.mark.parametrize(("start_before_s", "when"), [(20.0, "before the insertion"), (0.0, "in the first row")])
def test_start_temperature_that_is_not_the_channels_is_told(start_before_s, when):
    texts = _remark_texts(_run(start_before_s, panel__initial_temperature_C=40.0))
    assert len(texts) == 1
    assert str(texts[0]).startswith("header key panel.initial_temperature_C = 40, but the panel's channels read")
    assert when in str(texts[0])


@pytest.mark.parametrize("rate_hz", [10.0, 1.0, 0.5])
@pytest.mark.parametrize("start_before_s", [20.0, 3.0, 0.0])
def test_start_temperature_that_is_right_is_not_doubted(rate_hz, start_before_s):
    for seed in (5, 6, 7):
        assert not any("initial_temperature" in str(r) for r in _remark_texts(_run(start_before_s, rate_hz, seed)))


def test_start_temperature_of_a_run_with_channels_on_the_hot_side_only_is_not_doubted():
    run = _run(0.0)
    bottom = replace(run, columns={n: c for n, c in run.columns.items() if not n.startswith("top_")})
    assert _remark_texts(bottom) == []


@pytest.mark.parametrize("moment", ["closed_s", "opened_s"])
def test_a_moment_that_the_log_lacks_may_lie_anywhere_in_the_gap_and_hardly_outside(moment):
    whole = _run(5.0, 10.0)
    at = getattr(moments_of(whole, PRESS), moment)
    kept = (whole.time_s < at - 2.0) | (whole.time_s > at + 1.0)
    run = whole.at_rows(kept)
    begin, end = run.time_s[run.time_s < at][-1], run.time_s[run.time_s > at][0]
    moments = moments_of(run, PRESS)
    unknown = next(u for u in make_problem(ThermalModel(PRESS), run, moments).unknowns if u.name == moment)
    found = getattr(moments, moment)
    assert begin - 1.0 < found + unknown.lower <= begin
    assert end <= found + unknown.upper < end + 1.0
    assert unknown.sd == pytest.approx((end - begin) / np.sqrt(12.0), rel=0.1)  # of a flat prior


def test_a_rig_whose_log_lacks_the_moment_of_its_beginning_is_searched_without_one(make_rig):
    t = np.r_[np.arange(-10.0, -1.0), np.arange(20.0, 60.0)]
    model, run = make_rig(RIG, t, {"hot": 20.0 + np.abs(t)}, {"a": '"block.top"'})
    far_off = fit_run(model, replace(run, columns={**run.columns, "a": 300.0 - 5.0 * t}), Moments(inserted_s=0.0))
    assert not far_off.met


@pytest.mark.parametrize(
    ("load", "lacks"),
    [(None, "is missing"), (0.0, "holds no value above 0"), (np.nan, "holds no value above 0")],
)
def test_load_column_that_holds_nothing_is_told_with_what_is_done_instead(make_rig, load, lacks):
    t = np.arange(0.0, 60.0)
    measured = {"hot": 20.0 + t} | ({} if load is None else {"load_kN": load})
    model, run = make_rig(RIG, t, measured, {"a": '"block.top"'})
    run = replace(run, columns={**run.columns, "a": 20.0 + 0.9 * t})
    model = ThermalModel.of(model.press, ["contact_load"])
    problem = make_problem(model, run, Moments(inserted_s=0.0))
    (remark,) = remarks(problem.case, problem.signals, Moments(inserted_s=0.0))
    assert str(remark).startswith(f"rig: load column 'load_kN' {lacks}")
    assert "boundary.bottom-block taken as independent of load" in str(remark)
    values = {"h": 300.0, "contact_load.exponent": 0.7}
    without = ThermalModel(model.press)
    plain = without.solve(without.prepare(run, Moments(inserted_s=0.0)), {"h": 300.0}).sensors
    assert model.solve(problem.case, values).sensors == pytest.approx(plain)


def test_load_that_is_there_is_not_talked_about(make_rig):
    t = np.arange(0.0, 60.0)
    model, run = make_rig(RIG, t, {"hot": 20.0 + t, "load_kN": 12.0}, {"a": '"block.top"'})
    run = replace(run, columns={**run.columns, "a": 20.0 + 0.9 * t})
    problem = make_problem(model, run, Moments(inserted_s=0.0))
    assert remarks(problem.case, problem.signals, Moments(inserted_s=0.0)) == []


@pytest.mark.parametrize("closed_column", [True, False])
def test_rows_after_the_press_closed_on_the_same_panel_again_are_left_out_and_that_is_told(closed_column):
    plan = Plan(rate_hz=10.0, closed_column=closed_column)
    run, truth = make_campaign(42, 1, plan=plan)[0]
    twice, closed_s = pressed_again(run, truth, 8.0)
    before = twice.at_rows(twice.time_s < moments_of(twice, PRESS).removed_s)
    fitted, known = (fit_run(ThermalModel(PRESS), r, moments_of(r, PRESS)) for r in (twice, before))
    assert fitted.met
    for name in ThermalModel(PRESS).guesses:
        assert fitted.values[name] == pytest.approx(known.values[name], rel=0.05)
    (told,) = [w for w in fitted.warnings if w.code == "fit-closed-again"]
    assert abs(told.arguments["at"] - closed_s) < 1.7
    found = diagnose(PRESS, [twice, make_campaign(43, 1, plan=plan)[0][0]])
    assert [w.arguments["what"].code for w in found.warnings] == ["fit-closed-again"]
    assert found.base.rmse_K < 2.0 * found.noise_floor_K
