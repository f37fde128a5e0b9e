"""What a run must offer to be solved, and how it is refused otherwise."""

import re
from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import At, Core, Sensor, parse_press, press_for_run, read_press
from daq.records import BoundaryGap, BrokenTime, InputError, Moments, Nonphysical, OutsideLayer, Run
from softsensor.effects import BUILT_IN
from softsensor.heat.batch import solve_many
from softsensor.heat.case import step_edges, step_means
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import FittedValue, MissingCauses, ModelFile
from softsensor.heat.run_checks import check_times
from softsensor.heat.timing import ramp
from softsensor.live.replay import replay
from tests.softsensor.conftest import LAB_PRESS


def prepared(press, run, moments):
    return ThermalModel.of(press).prepare(run, moments)


def test_a_missing_boundary_column_is_named(lab_press, make_run, moments):
    run = make_run(end=30.0)
    del run.columns["platen_top"]
    with pytest.raises(InputError, match=r"column 'platen_top' is missing; boundary.top needs it"):
        prepared(lab_press, run, moments)


def test_an_empty_boundary_column_is_named(lab_press, make_run, moments):
    run = make_run(end=30.0)
    run.columns["platen_bottom"][:] = np.nan
    with pytest.raises(BoundaryGap, match="column 'platen_bottom' holds no value"):
        prepared(lab_press, run, moments)


def test_a_short_gap_in_a_boundary_is_bridged_by_a_straight_line(lab_press, make_run, moments, coefficients):
    line = {"top": lambda t: 190.0 + 0.1 * t, "bottom": lambda t: 195.0 + 0.05 * t}
    whole, holed = make_run(end=60.0, **line), make_run(end=60.0, **line)
    holed.columns["platen_top"][200:290] = np.nan
    model = ThermalModel.of(lab_press)
    expected = model.solve(model.prepare(whole, moments), coefficients).sensors
    found = model.solve(model.prepare(holed, moments), coefficients).sensors
    assert np.abs(found - expected).max() < 1e-9


@pytest.mark.parametrize(("first", "last"), [(0, 1), (4, 5), (9, 10)])
def test_a_slow_logger_may_lose_a_single_cell_of_a_boundary_and_not_two(lab_press, make_run, moments, first, last):
    whole = make_run(end=60.0)
    run = whole.at_rows(np.linspace(0, len(whole.time_s) - 1, 10).round().astype(int))
    run.columns["platen_top"][first:last] = np.nan
    prepared(lab_press, run, moments)
    run.columns["platen_top"][3:5] = np.nan
    with pytest.raises(BoundaryGap, match=r"'platen_top' is empty for 20\.\d s around time_s = "):
        prepared(lab_press, run, moments)


@pytest.mark.parametrize(("first", "last"), [(0, 150), (200, 350), (400, 600)])
def test_a_long_gap_in_a_boundary_is_refused_with_its_length_and_place(lab_press, make_run, moments, first, last):
    run = make_run(end=60.0)
    run.columns["platen_top"][first:last] = np.nan
    with pytest.raises(BoundaryGap, match=r"'platen_top' is empty for \d+\.\d s around time_s = .* at most 10 s"):
        prepared(lab_press, run, moments)


@pytest.mark.parametrize("kind", ["falling", "equal", "not a number", "one row"])
def test_times_that_do_not_rise_are_refused(lab_press, make_run, moments, kind):
    run = make_run(end=30.0)
    if kind == "falling":
        run.time_s[50] = 2.0
    elif kind == "equal":
        run.time_s[50] = run.time_s[49]
    elif kind == "not a number":
        run.time_s[50] = np.nan
    else:
        run = Run("short", run.header, run.time_s[:1], {name: x[:1] for name, x in run.columns.items()})
    with pytest.raises(BrokenTime, match="time_s"):
        prepared(lab_press, run, moments)


def test_a_gap_in_the_rows_is_refused_where_a_boundary_is_measured(lab_press, make_run, moments):
    run = make_run(end=150.0)
    keep = (run.time_s < 25.0) | (run.time_s > 90.0)
    cut = run.at_rows(keep)
    with pytest.raises(BrokenTime, match=r"no row for 65\.\d s after time_s = 24\.9"):
        prepared(lab_press, cut, moments)


@pytest.mark.parametrize("rig", ["lab", "pmma"])
def test_times_in_milliseconds_are_refused_whether_a_boundary_is_measured_or_not(make_run, moments, rig):
    press, run = read_press(LAB_PRESS.with_stem(rig)), make_run()
    with pytest.raises(BrokenTime, match=r"rows are 100 s apart by time_s.* in milliseconds"):
        check_times(press, replace(run, time_s=1000.0 * run.time_s), moments)


def test_a_sensor_outside_a_panel_is_refused(lab_press, make_run, moments):
    text = """
[[layer]]
name = "panel"
from_run = true
[[sensor]]
columns = ["core_1"]
at = { layer = "panel", depth_mm = 17.0 }
"""
    with pytest.raises(OutsideLayer, match=r"depth_mm = 17 lies outside layer 'panel', 16 mm thick in this run"):
        prepared(parse_press(text), make_run(end=30.0), moments)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("panel.conductivity_W_mK", -0.1),
        ("panel.conductivity_W_mK", float("nan")),
        ("panel.density_kg_m3", 0.0),
        ("panel.heat_capacity_J_kgK", 1e9),
        ("panel.thickness_mm", -16.0),
        ("panel.initial_temperature_C", -300.0),
        ("panel.thickness_mm", "thick"),
    ],
)
def test_nonphysical_panel_constants_are_refused_with_their_limits(lab_press, make_run, moments, key, value):
    with pytest.raises(Nonphysical, match=rf"{re.escape(key)} = .*: must be a number from"):
        prepared(lab_press, make_run(end=30.0, **{key: value}), moments)


@pytest.mark.parametrize("line", ["conductivity_W_mK = 0", "conductivity_W_mK = nan", "conductivity_W_mK = []"])
def test_nonphysical_layer_constants_are_refused(line):
    text = f'[[layer]]\nname = "a"\nthickness_mm = 1\ndensity_kg_m3 = 1\nheat_capacity_J_kgK = 1\n{line}\n'
    with pytest.raises(InputError, match=r"layer\.0"):
        parse_press(text)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("conductivity_W_mK", 1e9),
        ("conductivity_W_mK", 1e-6),
        ("conductivity_W_mK", [[20.0, 45.0], [100.0, 1e9]]),
        ("density_kg_m3", 1e6),
        ("heat_capacity_J_kgK", 1.0),
        ("thickness_mm", 1e6),
    ],
)
def test_layer_constants_no_matter_has_are_refused_with_their_limits(lab_press, make_run, key, value):
    run = make_run(end=30.0, **{f"layer.plate_bottom.{key}": value})
    with pytest.raises(InputError, match=rf"layer\.0\.{key}.*: .* must be a number from .*'plate_bottom'"):
        press_for_run(lab_press, run)


@pytest.mark.parametrize("value", [-400.0, 1e5])
def test_outside_temperatures_that_cannot_be_are_refused_with_their_place(lab_press, make_run, moments, value):
    run = make_run(end=30.0)
    run.columns["platen_top"][40] = value
    with pytest.raises(Nonphysical, match=r"'platen_top' = .* °C at time_s = 4: boundary.top must lie between"):
        prepared(lab_press, run, moments)
    with pytest.raises(Nonphysical, match=r"ambient\.temperature_C = .*: must be a number from"):
        prepared(lab_press, make_run(end=30.0, **{"ambient.temperature_C": value}), moments)


@pytest.mark.parametrize("value", [float("nan"), -5.0, float("inf")])
def test_a_nonphysical_coefficient_is_refused(lab_press, make_run, moments, coefficients, value):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(end=30.0), moments)
    with pytest.raises(Nonphysical, match=r"h_pp_c = .*: must be a finite number, at least 0"):
        model.solve(case, coefficients | {"h_pp_c": value})


def test_moments_that_contradict_each_other_are_refused(lab_press, make_run):
    wrong = Moments(inserted_s=0.0, closed_s=20.0, opened_s=10.0)
    with pytest.raises(InputError, match=r"opened_s = 10 .* before .*closed_s = 20"):
        prepared(lab_press, make_run(end=30.0), wrong)
    with pytest.raises(InputError, match=r"closed_s = 20 lies before inserted_s = 25"):
        prepared(lab_press, make_run(end=30.0), Moments(inserted_s=25.0, closed_s=20.0))
    with pytest.raises(InputError, match=r"ramp_s = -1"):
        prepared(lab_press, make_run(end=30.0), Moments(inserted_s=0.0, closed_s=20.0, ramp_s=-1.0))


@pytest.mark.parametrize(
    "wrong",
    [{"fineness": 0.0}, {"fineness": "2"}, {"max_step_s": -1.0}, {"switch_step_s": np.nan}, {"growth": 0.5}],
)
def test_a_grid_that_cannot_be_is_refused(lab_press, make_run, moments, wrong):
    with pytest.raises(InputError, match=rf"{next(iter(wrong))} = .*must be a number from"):
        ThermalModel.of(lab_press).prepare(make_run(end=30.0), moments, **wrong)


def test_a_tangent_the_model_does_not_have_is_refused(lab_press, make_run, moments, coefficients):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(end=30.0), moments)
    with pytest.raises(InputError, match=r"'h_pp' is no parameter of this model; it has .*h_pp_c"):
        model.solve(case, coefficients, ("h_pp",))


def test_steps_are_fine_at_switches_and_end_with_the_run(moments):
    times = np.arange(0.0, 200.0, 0.7)
    edges = step_edges(times, moments, 0.5, 0.04)
    steps = np.diff(edges)
    assert edges[0] == times[0]
    assert edges[-1] == times[-1]
    assert (steps > 0).all()
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        near = np.abs((edges[1:] + edges[:-1]) / 2 - moment) < 0.25
        assert steps[near].max() < 0.05


def test_steps_grow_with_the_time_since_the_last_switch_where_that_is_asked_for():
    times, moments = np.arange(0.0, 3000.0), Moments(inserted_s=0.0, closed_s=1000.0)
    edges = step_edges(times, moments, 0.5, 0.04, later=0.01)
    steps, after = np.diff(edges), edges[:-1]
    assert steps[(after > 900.0) & (after < 990.0)].min() > 8.0
    assert steps[(after > 1001.0) & (after < 1050.0)].max() < 0.51
    assert steps.max() <= 0.01 * 2000.0 * 1.25


def test_a_platen_that_is_read_keeps_its_steps_however_long_the_run(lab_press, make_run):
    run = make_run(end=600.0)
    assert prepared(lab_press, run, Moments(inserted_s=0.0, closed_s=10.0)).h.max() < 0.63


def test_step_means_keep_the_area_under_a_series():
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0.0, 10.0, 80))
    values = rng.normal(size=80)
    edges = np.sort(np.concatenate([[times[0], times[-1]], rng.uniform(times[0], times[-1], 30)]))
    means = step_means(times, values, edges)
    assert np.sum(means[:, 0] * np.diff(edges)) == pytest.approx(np.trapezoid(values, times), abs=1e-12)
    assert means[:, 1].sum() == pytest.approx(values[-1] - values[0])


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("setting.pressure_N_cm2", "high", "must be a number; correct"),
        ("ambient.temperature_C", "warm", "must be a number; correct"),
        ("ambient.temperature_C", True, "must be a number; correct"),
        ("setting.pressure_N_cm2", 0, "must be a number above 0 N/cm²"),
        ("setting.pressure_N_cm2", -5.0, "must be a number above 0 N/cm²"),
        ("setting.pressure_N_cm2", float("nan"), "must be a number above 0 N/cm²"),
    ],
)
def test_a_header_key_that_is_no_sound_number_is_named(lab_press, make_run, moments, key, value, expected):
    with pytest.raises(InputError, match=rf"cycle: header key {re.escape(key)} = .*: {expected}"):
        prepared(lab_press, make_run(end=30.0, **{key: value}), moments)


def test_an_infinite_boundary_is_refused_where_an_empty_one_is_bridged(lab_press, make_run, moments):
    run = make_run(end=30.0)
    run.columns["platen_top"][40] = np.inf
    with pytest.raises(Nonphysical, match=r"'platen_top' = inf °C at time_s = 4"):
        prepared(lab_press, run, moments)


LOADED = """
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
kind = "measured"
column = "platen_bottom"
[[contact]]
between = ["boundary.bottom", "panel"]
open = "h_o"
closed = "h_c"
load = { column = "kN" }
"""


@pytest.mark.parametrize(
    ("rows", "value", "expected"),
    [
        ((300, 450), np.nan, r"load column 'kN' is empty for 15\.\d s around time_s = .*at most 10 s"),
        ((300, 301), np.inf, r"load column 'kN' = inf at time_s = 30: must be a finite number"),
        ((0, 601), np.inf, r"load column 'kN' = inf at time_s = 0: must be a finite number"),
        ((300, 301), 0.0, r"load column 'kN' = 0 at time_s = 30, where the press is closed: must be above 0"),
        ((300, 301), -0.5, r"load column 'kN' = -0.5 at time_s = 30, where the press is closed"),
        ((0, 100), -2.0, r"load column 'kN' = -2 at time_s = 0: must be a finite number, not below 0"),
        ((300, 390), np.nan, None),
        ((0, 100), 0.0, None),
        ((0, 100), -0.1, None),
        ((0, 212), 0.0, None),  # it comes with the end of the ramp of closing, after 20.3 s
        ((0, 217), 0.0, r"load column 'kN' = 0 at time_s = 21\.6, where the press is closed"),
    ],
)
def test_a_load_is_held_to_the_boundarys_rule_and_above_0_while_closed(make_run, moments, rows, value, expected):
    run = make_run(end=60.0)
    run.columns["kN"] = np.full(len(run.time_s), 80.0)
    run.columns["kN"][slice(*rows)] = value
    if expected is None:
        assert np.isfinite(prepared(parse_press(LOADED), run, moments).load[0]).all()
        return
    with pytest.raises((BoundaryGap, Nonphysical), match=expected):
        prepared(parse_press(LOADED), run, moments)


def test_a_start_from_first_readings_needs_one_in_the_panel(lab_press, make_run, moments, coefficients):
    run = make_run(end=30.0, **{"initial.kind": "sensors"})
    model = ThermalModel.of(lab_press)
    with pytest.raises(
        InputError, match=r"\[initial\] kind = \"sensors\" .* 'panel'; top_1, .* are empty: fill one"
    ):
        model.solve(model.prepare(run, moments), coefficients)
    absent = replace(run, columns={name: run.columns[name] for name in ("platen_top", "platen_bottom")})
    with pytest.raises(InputError, match=r"'panel', where the run has no channel that a \[\[sensor\]\]"):
        model.solve(model.prepare(absent, moments), coefficients)
    run.columns["bottom_2"][:5] = 31.0
    start = model.solve(model.prepare(run, moments), coefficients).column("bottom_2")[0]
    assert start == pytest.approx(31.0, abs=0.5)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("conductivity_offset.ratio", 0.0),
        ("heat_capacity_offset.ratio", -1.0),
        ("contact_asymmetry.ratio", 0.0),
        ("density_profile.amplitude", -3.0),
        ("contact_buildup.deficit", 2.0),
        ("contact_buildup.time_constant_s", 0.0),
        ("paper_layer.resistance_m2K_W", -1e-4),
        ("open_radiation.emissivity", -3.0),
        ("moisture_evaporation.moisture_percent", float("nan")),
        ("h_p_c", None),
        ("h_p_c", "900"),
        ("closed_s", float("inf")),
    ],
)
def test_a_value_no_matter_has_is_refused_by_name(lab_press, make_run, moments, coefficients, name, value):
    model = ThermalModel.of(lab_press, [name.partition(".")[0]] if "." in name else [])
    case = model.prepare(make_run(end=30.0), moments)
    with pytest.raises(Nonphysical, match=rf"{re.escape(name)} = .*: must be a finite number"):
        model.solve(case, coefficients | {name: value})
    with pytest.raises(Nonphysical, match=re.escape(name)):
        solve_many(model, [case], coefficients | {name: value})


def test_every_typical_value_and_limit_of_a_search_can_be():
    for effect in BUILT_IN:
        for p in effect.parameters:
            assert p.least <= min(p.neutral, p.typical, p.lower), p
            assert p.most >= max(p.neutral, p.typical, p.upper), p


def test_a_misspelt_value_or_method_is_refused_by_name(lab_press, make_run, moments, coefficients):
    model = ThermalModel.of(lab_press, ["edge_loss"])
    case = model.prepare(make_run(end=30.0), moments)
    with pytest.raises(InputError, match=r"'edge_loss\.W_m3k' is no parameter of this model; it has .*W_m3K"):
        model.solve(case, coefficients | {"edge_loss.W_m3k": 500.0})
    with pytest.raises(InputError, match="method = 'exakt': must be 'implicit' or 'exact'"):
        model.solve(case, coefficients, method="exakt")


def test_a_coefficient_only_the_header_names_is_its_guess_there(lab_press, make_run, moments, coefficients):
    header = {"contact.2.closed": "h_new", "coefficients.h_new.guess": 250.0}
    model, run = ThermalModel.of(lab_press), make_run(end=60.0, every=0.5, **header)
    case = model.prepare(run, moments)
    found = model.solve(case, coefficients).core
    assert found == pytest.approx(model.solve(case, coefficients | {"h_new": 250.0}).core, abs=1e-12)
    assert np.abs(found - model.solve(case, coefficients | {"h_new": 700.0}).core).max() > 0.05


def test_an_insulated_end_in_the_header_insulates_the_laboratory_press(lab_press, make_run, moments, coefficients):
    header = {"boundary.top.kind": "insulated", "contact.3.open": "h_top", "contact.3.closed": "h_top"}
    run = make_run(end=60.0, every=0.5, **header)
    model = ThermalModel.of(lab_press)
    case = model.prepare(run, moments)
    loose, tight = (model.solve(case, coefficients | {"h_top": h}, fields=True).fields[-1] for h in (1.0, 5000.0))
    assert np.abs(loose - tight).max() < 1e-9, "no heat passes, however good the contact"


def test_steps_wholly_before_or_after_a_ramp_have_exactly_no_or_the_whole_share():
    """So that equal steps are solved with one factorisation."""
    rng = np.random.default_rng(4)
    for middle in rng.uniform(5.0, 25.0, 200):
        edges = np.concatenate([[0.0], np.cumsum(rng.uniform(0.02, 0.4, 150))])
        share = ramp(edges, middle, 0.5, mean=True)[0]
        assert np.all(share[edges[1:] <= middle - 0.25] == 0.0)
        assert np.all(share[edges[:-1] >= middle + 0.25] == 1.0)
        assert share @ np.diff(edges) == pytest.approx(edges[-1] - middle)


def test_a_core_at_a_depth_is_what_a_thermocouple_there_reads(lab_press, make_run, moments, coefficients):
    deep = At(layer="panel", depth_mm=5.7)
    sensor = Sensor(columns=("core_*",), at=deep)
    press = lab_press.model_copy(update={"core": Core(at=deep), "sensor": (*lab_press.sensor[:-1], sensor)})
    run, model = make_run(every=0.5), ThermalModel(press)
    found = model.solve(model.prepare(run, moments), coefficients)
    assert found.core.tolist() == found.column("core_1").tolist()

    sure, complete = (
        {n: FittedValue(v, 1e-3 * v) for n, v in coefficients.items()},
        MissingCauses(12, 1.0, 0.0, {}),
    )
    known = ModelFile("m", "lab", sure, missing=complete)
    closed = ((run.time_s >= moments.closed_s) & (run.time_s < moments.opened_s)).astype(float)
    columns = {n: v for n, v in run.columns.items() if n.startswith("platen")} | {"closed": closed}
    estimates = [e.core_C for e in replay(press, replace(run, columns=columns), known).estimates]
    while_closed = (run.time_s > 40.0) & (run.time_s < 80.0)
    assert np.array(estimates)[while_closed] == pytest.approx(found.core[while_closed], abs=1.0)
    middle = ThermalModel(lab_press)
    away = middle.solve(middle.prepare(run, moments), coefficients).core - found.core
    assert np.abs(away[while_closed]).min() > 1.0
