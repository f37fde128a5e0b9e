"""The next pressing: its worth by formulas one can check by hand, and on campaigns of the virtual press."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import softsensor
from api.cli import main
from daq.press.press_file import Press, parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign, press_toml, write_campaign
from daq.simulated.physics import solve
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.diagnosis.decision import SURE_T, Verdict, beyond_chance
from softsensor.diagnosis.extension import fit_campaign_model
from softsensor.diagnosis.extension_unknowns import lay_out, logarithm_of
from softsensor.diagnosis.settling import SettledModel, settle_base
from softsensor.effects import find_effect
from softsensor.heat.model import ThermalModel
from softsensor.planning.design_point import design_point_of, planned_digest, shares, with_core
from softsensor.planning.information import (
    RunInformation,
    covariance_after,
    evidence,
    further_runs,
    runs_needed,
)
from softsensor.planning.open_points import OpenPoint, PointKind, contender, open_numbers
from softsensor.planning.plan import plan
from softsensor.planning.program import FACTORS, default_ranges, designed_run, settings_of
from softsensor.planning.summary import plan_messages, point_message
from softsensor.signals.digest import digest_run
from softsensor.signals.doubt import Doubt, Origin
from softsensor.signals.moments import moments_seen
from tests.screens import flooding, text_of


def test_n_runs_know_a_straight_line_as_n_times_its_readings_do() -> None:
    x, sd = np.array([0.0, 1.0, 2.0]), 0.5
    rows = np.column_stack([np.ones(3), x]) / sd
    after = covariance_after(np.zeros((2, 2)), RunInformation(rows.T @ rows, np.zeros(2)), 4)
    assert after[1, 1] == pytest.approx(sd**2 / (4 * np.sum((x - x.mean()) ** 2)))  # the slope's, by the book


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), runs=st.integers(1, 4))
def test_the_evidence_is_that_of_one_large_gaussian_over_all_readings(seed: int, runs: int) -> None:
    rng = np.random.default_rng(seed)
    rows, apart, known = rng.normal(size=(6, 3)), rng.normal(size=6), np.diag(rng.uniform(0.1, 5.0, 3))
    one = RunInformation(rows.T @ rows, rows.T @ apart, float(apart @ apart))
    wide = np.tile(rows, (runs, 1))
    covariance = np.eye(6 * runs) + wide @ np.linalg.inv(known) @ wide.T
    both = np.tile(apart, runs)
    assert evidence(known, one, runs) == pytest.approx(float(both @ np.linalg.solve(covariance, both)), rel=1e-6)


def test_what_the_shared_numbers_can_take_up_is_not_settled_by_repeating() -> None:
    """A difference along a number known to 1 of a run's noise: n/(1 + n) of its square, at most 1."""
    same = RunInformation(np.eye(1), np.eye(1)[0], 1.0)
    assert [evidence(np.eye(1), same, n) for n in (1, 3, 99)] == pytest.approx([0.5, 0.75, 0.99])
    assert runs_needed(lambda n: evidence(np.eye(1), same, n) > 1.0) is None


def test_a_difference_nothing_can_take_up_grows_with_the_runs() -> None:
    clear = RunInformation(np.zeros((1, 1)), np.zeros(1), 4.0)
    assert [evidence(np.eye(1), clear, n) for n in (1, 5)] == pytest.approx([4.0, 20.0])


@pytest.mark.parametrize(("further", "share"), [(1, 0.0), (3, 0.0), (4, 1.0)])
def test_pressings_however_clear_do_not_outvote_runs_that_say_nothing(further: int, share: float) -> None:
    """Seven runs with no difference and k with the same one: Student's t is √(k (n - 1) / (n - k)), n = 7 + k."""
    worse = further_runs(np.zeros(7), 1e8 * further, further, 0)
    assert beyond_chance(worse).mean() == share
    assert (np.sqrt(further * (6 + further) / 7) > SURE_T) == bool(share)


def test_what_a_pressing_says_scatters_as_twice_the_logarithm_of_odds_does() -> None:
    drawn = further_runs(np.zeros(0), 18.0, 2, 1)
    assert drawn.mean() == pytest.approx(9.0, abs=0.9)
    assert drawn.std() == pytest.approx(6.0, rel=0.1)


@cache
def press() -> Press:
    """The virtual press as a press file describes it."""
    return parse_press(press_toml())


@cache
def stage() -> SettledModel:
    """The plain model on three pressings of 16 mm, of panels that conduct better than their headers say."""
    plan = Plan(rate_hz=2.0, thickness_mm=16.0, closed_column=True)
    runs = [run for run, _ in make_campaign(5, 3, {"conductivity_offset": {"ratio": 1.15}}, plan)]
    return settle_base(ThermalModel(press()), [digest_run(press(), r, moments_seen(r, press())) for r in runs])


def between(first: str, second: str) -> OpenPoint:
    """A matter between two causes, as three runs leave it."""
    base = stage()
    past = [design_point_of(press(), d.digest, base.fit) for d in base.data]
    known = []
    for name in (first, second):
        model = base.fit.layout.model.extended(find_effect(name))
        layout = lay_out(model, [d.digest for d in base.data], base.population, base.fit.values)
        fit = fit_campaign_model(layout, base.data, rounds=8)
        known.append(contender(name, fit, base, past, ()))
    return OpenPoint(PointKind.CAUSE, first, base, tuple(known))


def prospect(point: OpenPoint, *, core: bool = False, **changed: float) -> float:
    like = stage().data[0].digest
    usual = settings_of(like.run, press(), like.moments)
    run, moments = designed_run(like.run, press(), like.moments, {**usual, **changed})
    described = with_core(press(), changed.get("thickness_mm", 16.0)) if core else press()
    digest = planned_digest(described, run, moments, like)
    return point.prospect(design_point_of(described, digest, stage().fit), ()).worth


def test_another_thickness_or_the_core_tells_conductivity_from_heat_capacity() -> None:
    """facts, physics.md, section 7: a hard pair (cosine 0.97) that either of them separates."""
    point = between("conductivity_offset", "heat_capacity_offset")
    long = prospect(point, press_time_s=120.0)
    assert prospect(point, press_time_s=120.0, thickness_mm=8.0) > 1.1 * long > 1.1 * prospect(point)
    assert prospect(point, press_time_s=120.0, thickness_mm=8.0, core=True) > 2.0 * prospect(point)


def test_two_names_of_one_cause_are_never_told_apart() -> None:
    point = between("conductivity_offset", "heat_capacity_offset")
    twins = replace(point, contenders=(point.contenders[0], point.contenders[0]))
    assert prospect(twins, thickness_mm=8.0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.campaign
def test_two_designed_pressings_tell_apart_what_repeated_ones_hardly_do() -> None:
    """A conductivity 15 % off in seven panels of 16 mm, which these do not tell from the heat capacity.

    Settings of the plan are the campaign's program: the virtual press computes by its own equations. Another cause
    may come in where nobody has pressed before; the plan's question is which of the two it is.
    """
    usual, hidden = Plan(rate_hz=2.0, thickness_mm=16.0), "conductivity_offset"
    runs = [run for run, _ in make_campaign(502, 7, hidden, usual)]
    found = softsensor.diagnose(runs, press())
    planned = softsensor.plan(found, press(), ranges={"thickness_mm": (8.0, 19.0)}).planned.points[0]
    assert set(planned.point.names) == {"conductivity_offset", "heat_capacity_offset"}
    designed_runs, repeated_runs = (one.prospect.runs or 99 for one in (planned.best, planned.repeated))
    assert designed_runs <= 2
    assert repeated_runs >= 2 * designed_runs
    best = planned.best.settings
    designed = Plan(
        rate_hz=2.0,
        thickness_mm=best["thickness_mm"],
        press_time_s=(best["press_time_s"],) * 2,
        open_before_s=(best["waiting_s"],) * 2,
        platen_C=(best["platen_temperature_C"],) * 2,
    )
    further = [run for run, _ in make_campaign(502, 9, hidden, designed)][7:]
    (effect,) = softsensor.diagnose([*runs, *further], press()).content["effects"]
    assert set(effect["set"]) & set(planned.point.names) == {"conductivity_offset"}


def test_the_usual_settings_give_the_run_they_were_read_from() -> None:
    like = stage().data[0].digest
    run, moments = designed_run(like.run, press(), like.moments, settings_of(like.run, press(), like.moments))
    assert (moments.closed_s, moments.opened_s) == pytest.approx((like.moments.closed_s, like.moments.opened_s))
    for column in ("platen_top", "closed"):
        assert run.columns[column] == pytest.approx(like.run.columns[column][: len(run.time_s)], abs=0.3)


def test_a_designed_run_waits_presses_and_heats_as_it_is_told() -> None:
    like = stage().data[0].digest
    usual = settings_of(like.run, press(), like.moments)
    wanted = {**usual, "press_time_s": usual["press_time_s"] + 40.0, "waiting_s": usual["waiting_s"] + 10.0}
    wanted |= {"platen_temperature_C": usual["platen_temperature_C"] + 15.0, "thickness_mm": 8.0}
    run, moments = designed_run(like.run, press(), like.moments, wanted)
    seen = moments_seen(replace(run, columns={"closed": run.columns["closed"], **run.columns}), press())
    assert seen.opened_s - seen.closed_s == pytest.approx(usual["press_time_s"] + 40.0, abs=1.5)
    assert moments.closed_s == pytest.approx(like.moments.closed_s + 10.0)
    assert run.header["panel.thickness_mm"] == 8.0
    assert run.columns["platen_top"][0] == pytest.approx(like.run.columns["platen_top"][0] + 15.0)
    before = run.columns["platen_top"][run.time_s < moments.opened_s - 1.0]
    assert np.ptp(before[-40:]) == pytest.approx(0.0, abs=0.5)  # what was last read is held


def test_ranges_are_the_runs_own_somewhat_widened() -> None:
    found = default_ranges([{"thickness_mm": 16.0}, {"thickness_mm": 20.0}])
    assert found == {"thickness_mm": (12.0, 25.0)}
    assert default_ranges([{"thickness_mm": 16.0}], {"thickness_mm": (8.0, 19.0)})["thickness_mm"] == (8.0, 19.0)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"thickness_mm": (19.0, 8.0)}, "give the lower end first"),
        ({"thickness_mm": (0.1, 8.0)}, "must lie between 2 and 80"),
        ({"pressure_N_cm2": (200.0, 300.0)}, "no such setting here; known are thickness_mm"),
    ],
)
def test_a_range_that_cannot_be_is_refused(given: dict[str, tuple[float, float]], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        default_ranges([{"thickness_mm": 16.0}], given)


def test_a_panels_own_scatter_is_its_own_and_the_rest_of_its_tables_doubt_is_shared() -> None:
    own, common = shares("panel.conductivity_W_mK", Doubt(0.1, 0.02, Origin.MATERIAL_TABLE))
    assert own == pytest.approx(0.055 / 0.2)
    assert own**2 + common**2 == pytest.approx(1.0)
    assert shares("panel.conductivity_W_mK", Doubt(0.1, 0.005, Origin.DATA_SHEET)) == (1.0, 0.0)
    assert shares("layer.plate_top.thickness_mm", Doubt(10.0, 0.1, Origin.DATA_SHEET)) == (0.0, 1.0)


def test_the_command_says_what_is_open_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = write_campaign(tmp_path, make_campaign(7, 3, None, Plan(rate_hz=1.0, thickness_mm=16.0)))
    out = tmp_path / "plan.json"
    ranges = ["--range", "thickness_mm=8:19", "--range", "press_time_s=40:120"]
    report = tmp_path / "plan.html"
    written_to = ["--json", str(out), "--html", str(report)]
    command = ["plan", *map(str, runs), "--press", str(tmp_path / "press.toml"), *written_to, *ranges]
    assert main(command) == 0
    output = capsys.readouterr().out
    shown = text_of(report)
    assert all(line in shown for line in output.splitlines() if str(tmp_path) not in line)
    assert "<svg" in report.read_text(encoding="utf-8")
    written = json.loads(out.read_text(encoding="utf-8"))
    assert set(written) == {"runs", "verdict", "usual", "ranges", "open"}
    assert written["runs"] == 3
    assert written["ranges"]["thickness_mm"] == [8.0, 19.0]
    assert set(written["usual"]) == set(FACTORS)
    for point in written["open"]:
        assert set(point["best"]["settings"]) == set(FACTORS)
        assert point["best"]["worth"] >= point["repeated"]["worth"]
    assert len(output.splitlines()) >= max(len(written["open"]), 1)
    monkeypatch.setenv("KERNTEMP_LANGUAGE", "de")
    assert main([*command[:-4], "--range", "thickness_mm=8"]) == 2
    assert "muss NAME=UNTEN:OBEN sein" in capsys.readouterr().err


def test_a_plan_in_python_is_the_commands() -> None:
    runs = [run for run, _ in make_campaign(7, 3, None, Plan(rate_hz=1.0, thickness_mm=16.0))]
    found = softsensor.diagnose(runs, press(), effects=["edge_loss"])
    planned = softsensor.plan(found, press(), ranges={"thickness_mm": (8.0, 19.0)})
    written = json.loads(planned.to_json())
    assert len(planned.frame()) == sum(3 for _ in written["open"])
    assert len(str(planned)) > 10
    assert flooding(planned) == {}
    assert planned.plot()


def test_no_pressing_lies_outside_ranges_that_leave_out_the_usual_settings() -> None:
    runs = [run for run, _ in make_campaign(7, 2, None, Plan(rate_hz=1.0, thickness_mm=16.0))]
    found = softsensor.diagnose(runs, press(), effects=["edge_loss"]).diagnosis
    ranges = {"thickness_mm": (8.0, 9.0), "platen_temperature_C": (150.0, 160.0)}
    planned = plan(press(), found, ranges)
    assert planned.points
    for advice in planned.points:
        assert "thickness_mm" not in advice.repeated.changed
        for pressing in (advice.best, advice.with_core):
            assert pressing is not None
            assert set(pressing.changed) >= set(ranges)
            assert all(low <= pressing.settings[name] <= high for name, (low, high) in planned.ranges.items())


def test_a_setting_that_one_run_does_not_state_is_planned_as_the_others_have_it() -> None:
    runs = [run for run, _ in make_campaign(7, 3, None, Plan(rate_hz=1.0, thickness_mm=16.0))]
    pressed = "setting.pressure_N_cm2"
    for silent in range(3):
        stated = [
            replace(run, header={k: v for k, v in run.header.items() if (i, k) != (silent, pressed)})
            for i, run in enumerate(runs)
        ]
        found = softsensor.diagnose(stated, press(), effects=["edge_loss"]).diagnosis
        planned = plan(press(), found, {"pressure_N_cm2": (100.0, 200.0)})
        assert planned.points
        assert all(100.0 <= advice.best.settings["pressure_N_cm2"] <= 200.0 for advice in planned.points)


def test_a_coefficient_is_said_to_be_known_to_the_factor_that_its_interval_ends_at() -> None:
    """The interval is of the logarithm: half of it is 0.97 from value / 2.64 to value x 2.64."""
    past = [design_point_of(press(), d.digest, stage().fit) for d in stage().data]
    for point in open_numbers(stage(), past, ()):
        if point.kind is PointKind.COEFFICIENT:
            half = point.half_now
            assert half is not None
            at = stage().fit.layout.names.index(logarithm_of(point.name))
            sd = float(np.sqrt(np.linalg.inv(point.contenders[0].before)[at, at]))
            line = str(point_message(point))
            assert f"a factor of {np.exp(1.96 * sd):.2f}"[:-1] in line
            assert "(wanted: 1.35)" in line
            return
    pytest.fail("three runs know every coefficient")


def test_a_model_that_does_not_describe_the_runs_forecasts_no_pressing() -> None:
    runs = [run for run, _ in make_campaign(7, 2, None, Plan(rate_hz=1.0, thickness_mm=16.0))]
    found = softsensor.diagnose(runs, press(), effects=["edge_loss"]).diagnosis
    assert plan(press(), found).points  # two runs leave coefficients open
    off = plan(press(), replace(found, verdict=Verdict.NOT_DESCRIBED))
    assert not off.points
    assert [m.code for m in plan_messages(off)] == ["plan-not-described"]


def test_what_if_is_the_pressing_that_other_settings_really_give() -> None:
    """Two virtual pressings, alike but for thickness and press time: one foretells the other's core."""
    alike = {"rate_hz": 2.0, "closed_column": True, "coefficient_spread": 0.0, "panel_spread": 0.0}
    alike |= {"platen_C": (190.0, 190.0), "open_before_s": (10.0, 10.0)}
    first, other = (
        make_campaign(3, 1, None, Plan(**alike, thickness_mm=thickness, press_time_s=(seconds, seconds)))[0]
        for thickness, seconds in ((12.0, 50.0), (16.0, 80.0))
    )
    foretold = softsensor.simulate(
        first[0], press(), BASE_COEFFICIENTS, settings={"thickness_mm": 16.0, "press_time_s": 80.0}
    ).simulated
    truth = solve(other[1].pressing)
    closed = [moments.closed_s for moments in (first[1].moments, other[1].moments)]
    after = np.linspace(0.0, 78.0, 40)
    core = np.interp(closed[0] + after, foretold.time_s, foretold.core)
    assert core == pytest.approx(truth.at("core", closed[1] + after), abs=1.0)
    assert not foretold.rmse


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"press_time": 60.0}, "press_time: this run has no such setting; it has platen_temperature_C"),
        ({"press_time_s": 0.1}, "press_time_s = 0.1 must lie between 5 and 3600"),
    ],
)
def test_a_setting_that_no_press_has_is_refused(changed: dict[str, float], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        softsensor.simulate(stage().data[0].digest.run, press(), settings=changed)
