"""What the sensor foresees against what then happens in the virtual press."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import PressState
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_places import solve_places
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.heat.implicit_steps import Stack
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.live.inside import heat_taken_up, look_inside
from softsensor.live.sensor import ScanSensor

PRESS = parse_press(press_toml())
MODEL = ModelFile("test", "lab", {n: FittedValue(v, 0.15 * v) for n, v in BASE_COEFFICIENTS.items()})
PLAN = Plan(
    rate_hz=1.0, thickness_mm=16.0, start_before_s=5.0, closed_column=True,
    press_time_s=(100.0, 101.0), open_before_s=(6.0, 8.0), open_after_s=(155.0, 156.0),
)  # fmt: skip
TARGET = 35.0


@pytest.fixture(scope="module")
def pressing():
    return make_campaign(71, 1, None, PLAN)[0]


def follow(run, **wishes):
    """Feed a run and return, scan by scan: time, state, estimate, what is inside, what lies ahead."""
    header = dict(run.header) | {f"setting.core_{name}_C": value for name, value in wishes.items()}
    sensor = ScanSensor(PRESS, header, MODEL)
    rows = []
    for i, t in enumerate(run.time_s.tolist()):
        estimate = sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
        sensor.look_ahead()
        rows.append((t, estimate.state, estimate, sensor.inside, sensor.forecast))
    return rows


@pytest.fixture(scope="module")
def followed(pressing):
    return follow(pressing[0], target=TARGET, limit=60.0)


def test_the_target_is_reached_when_the_sensor_said_it_would_be(pressing, followed):
    run, truth = pressing
    reached = float(run.time_s[np.argmax(truth.core_C >= TARGET)])
    foreseen = [
        (t, o) for t, state, _, _, o in followed if state is PressState.CLOSED and reached - 40 < t < reached - 5
    ]
    assert len(foreseen) > 30
    assert max(abs(t + o.target_in_s - reached) for t, o in foreseen) < 5.0  # steam may help: its size is open
    assert all(o.target_earliest_s <= o.target_in_s <= o.target_latest_s for _, o in foreseen)
    assert np.mean([t + o.target_earliest_s <= reached <= t + o.target_latest_s for t, o in foreseen]) > 0.9


def peak_out_of_the_press(pressing, opened):
    """Return the core's peak in a panel that leaves the press when it opens, and loses heat to air on both sides.

    The virtual press has a panel in no air at all, and one that its lower plate no longer warms, with air above:
    what air below takes is what air above does.
    """
    out = replace(pressing, opened=opened, end=opened + 150.0)
    lifted = replace(out, outside=replace(out.outside, lift=0.0, lift_from=opened))
    insulated, above = (
        solve_places(one, {}, 0.0, "fast").core(np.arange(opened, out.end, 0.5)).max()
        for one in (replace(out, removed=opened + 0.2), lifted)
    )
    assert insulated > above
    return 2.0 * above - insulated


def test_the_peak_of_a_panel_taken_out_is_foreseen_at_the_opening(pressing, followed):
    run, truth = pressing
    opened = truth.moments.opened_s
    foreseen = next(o for t, _, _, _, o in followed if t > opened - 1.0)
    out = peak_out_of_the_press(truth.pressing, opened)
    assert out > 55.0
    assert out < truth.core_C[run.time_s > opened].max() - 3.0, "the hot plate would have warmed it further"
    assert foreseen.peak_C == pytest.approx(out, abs=4.0)


def test_opening_when_advised_lets_the_core_of_a_panel_taken_out_peak_at_the_target(pressing):
    _, truth = pressing
    advised = next(
        t + o.open_in_s
        for t, state, _, _, o in follow(pressing[0], target=70.0)
        if state is PressState.CLOSED and t > 60
    )
    assert peak_out_of_the_press(truth.pressing, advised) == pytest.approx(70.0, abs=3.0)


def test_the_moment_to_open_lies_within_its_bounds_which_are_narrower_than_those_of_a_press_that_stays_closed(
    pressing,
):
    _, truth = pressing
    closed, target = truth.moments.closed_s, 60.0
    moments = np.arange(closed + 20.0, closed + 100.0, 1.0)
    peaks = [peak_out_of_the_press(truth.pressing, m) for m in moments]
    right = float(np.interp(target, peaks, moments))
    foreseen = [
        (t, o)
        for t, state, _, _, o in follow(pressing[0], target=target)
        if state is PressState.CLOSED and closed + 10.0 < t < right - 5.0
    ]
    assert len(foreseen) > 15
    assert np.mean([t + o.open_earliest_s <= right <= t + o.open_latest_s for t, o in foreseen]) > 0.9
    for _, o in foreseen:
        assert o.open_earliest_s <= o.open_in_s <= o.open_latest_s
        assert o.open_latest_s - o.open_earliest_s < 0.5 * (o.target_latest_s - o.target_earliest_s)
    print(
        right,
        [
            (t, o.open_earliest_s, o.open_in_s, o.open_latest_s, o.target_latest_s - o.target_earliest_s)
            for t, o in foreseen
        ][::4],
    )


def test_no_panel_is_let_go_for_the_heat_it_would_get_from_the_plate_afterwards(pressing):
    """Three seconds in the closed press do not warm a core to 35 °C, one and a half minutes on the plate do."""
    _, truth = pressing
    closed = truth.moments.closed_s
    o = next(o for t, _, _, _, o in follow(pressing[0], target=TARGET) if t > closed + 3.0)
    stays = replace(truth.pressing, opened=closed + 3.0, end=closed + 150.0)
    assert solve_places(stays, {}, 0.0, "fast").core(np.arange(0.0, stays.end, 0.5)).max() > TARGET
    assert peak_out_of_the_press(truth.pressing, closed + 3.0) < TARGET
    assert o.peak_C < TARGET
    assert o.open_in_s > 2.0


def test_a_limit_is_warned_of_before_it_is_passed(pressing, followed):
    run, truth = pressing
    passed = float(run.time_s[np.argmax(truth.core_C >= 60.0)])
    warned = next(t for t, _, _, _, o in followed if o.warning)
    assert warned < passed - 10.0


def test_the_heat_taken_up_is_that_of_the_profile(pressing, followed):
    run, _ = pressing
    _, _, _, inside, _ = followed[80]
    profile = inside.profile_C
    assert len(profile) == 11
    assert profile[0] > profile[5] < profile[-1]
    capacity, start = 1550.0 * run.header["panel.density_kg_m3"], run.header["panel.initial_temperature_C"]
    depth = np.linspace(0.0, 0.016, 11)
    assert inside.energy_kJ_m2 == pytest.approx(np.trapezoid(profile - start, depth) * capacity / 1000.0, rel=0.04)


def test_the_middle_of_the_profile_is_the_core_that_is_told(followed):
    held = [
        (estimate.core_C, inside.profile_C[5])
        for _, _, estimate, inside, _ in followed
        if inside and estimate.valid
    ]
    core, profile = np.array(held).T
    assert len(core) > 90
    assert np.abs(core - profile).max() < 0.3


def test_filters_count_inside_the_panel_by_their_shares(pressing):
    run, _ = pressing
    sensor = ScanSensor(PRESS, run.header, MODEL)
    for i, t in enumerate(run.time_s[:60].tolist()):
        sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
    current = sensor._run.passes.current
    one, two, mixture = current.filters[0], current.filters[1], current.mixture

    def inside(first, second):
        shares = [wanted * own / own.sum() for wanted, own in zip((first, second), mixture.shares, strict=False)]
        return look_inside([one, two], replace(mixture, shares=tuple(shares)))

    first, second, both = inside(1.0, 1e-9), inside(1e-9, 1.0), inside(0.25, 0.75)
    assert np.abs(first.profile_C - second.profile_C).max() > 0.01
    assert both.profile_C == pytest.approx(0.25 * first.profile_C + 0.75 * second.profile_C)
    assert both.energy_kJ_m2 == pytest.approx(0.25 * first.energy_kJ_m2 + 0.75 * second.energy_kJ_m2)
    assert inside(0.005, 0.995).profile_C == pytest.approx(second.profile_C), "too little to count"
    assert np.isnan(inside(np.nan, np.nan).profile_C).all(), "shares that nobody knows"


def test_nothing_is_foreseen_where_nothing_is_wanted(pressing):
    run, _ = pressing
    sensor = ScanSensor(PRESS, run.header, MODEL)
    for i, t in enumerate(run.time_s[:60].tolist()):
        sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
        sensor.look_ahead()
    assert np.isnan(sensor.forecast.target_in_s)
    assert sensor.forecast.warning is None


def test_the_heat_taken_up_counts_a_heat_capacity_that_grows_with_temperature():
    cells, nothing = np.arange(4), np.zeros((1, 2))
    stack = Stack(*(np.empty(0) for _ in Stack._fields))._replace(
        dx=np.full(4, 0.004), c=np.full(4, 1.1e6), c_slope=np.full(4, 0.003), c_table=np.full(4, -1),
        table_x=nothing, table_y=nothing, wet=cells > 0,
    )  # fmt: skip
    field = np.array([200.0, 120.0, 60.0, 120.0])
    made = SimpleNamespace(model=SimpleNamespace(stack=stack), start_C=20.0)
    per_cell = 0.004 * 1.1e6 * ((field - 20.0) + 0.003 / 2 * (field - 20.0) ** 2)
    assert heat_taken_up(made, field) == pytest.approx(per_cell[1:].sum(), rel=1e-9)


def test_the_course_foreseen_meets_the_core_that_comes_and_is_as_old_as_its_look(pressing, followed):
    run, truth = pressing
    t, foreseen = next((t, o) for t, state, _, _, o in followed if state is PressState.CLOSED and t > 40.0)
    ahead = np.array(foreseen.course)
    assert 2 <= len(ahead) <= 12
    assert 0.0 <= foreseen.forecast_age_s <= 2.0
    at = t - foreseen.forecast_age_s + ahead[:, 0]
    there = at < truth.moments.opened_s
    core = np.interp(at[there], run.time_s, truth.core_C)
    assert there.sum() >= 3
    assert ((ahead[there, 2] <= core) & (core <= ahead[there, 3])).all()
    assert (np.diff(ahead[there, 3] - ahead[there, 2]) > -0.5).all()  # what is further off is known no better
    assert ahead[:, 1:].max() < max(np.nanmax(run.columns[side]) for side in PRESS.platens) + 20.0


def test_a_channel_that_stands_still_beside_six_is_left_out_and_a_sound_one_is_not(pressing):
    run, _ = pressing
    columns = {name: values.copy() for name, values in run.columns.items()}
    dead = next(name for name in columns if name.startswith("top_"))
    hot = run.time_s > 40.0
    columns[dead][hot] = columns[dead][np.argmax(hot)] - 70.0
    sensor = ScanSensor(PRESS, run.header, MODEL)
    found = []
    for i, t in enumerate(run.time_s[: np.argmax(run.time_s > 50.0)].tolist()):
        sensor.update(t, {name: float(values[i]) for name, values in columns.items()})
        found.append((t, sensor.left_out))
    assert all(not left for t, left in found if t < 40.0)
    last = found[-1][1]
    assert list(last) == [dead]
    assert last[dead] == pytest.approx(-70.0, abs=5.0)
    again = {name: float(values[i]) for name, values in run.columns.items()}
    again[dead] = float(np.median([v for name, v in again.items() if name.startswith("top_") and name != dead]))
    sensor.update(t + 0.1, again)
    assert abs(sensor.left_out[dead]) > 10.0  # what it is left out for, though at this scan it agrees


def test_a_single_bad_reading_leaves_no_channel_out(pressing):
    run, _ = pressing
    columns = {name: values.copy() for name, values in run.columns.items()}
    name = next(name for name in columns if name.startswith("top_"))
    columns[name][np.searchsorted(run.time_s, [10.0, 40.0, 45.0])] += 80.0
    sensor = ScanSensor(PRESS, run.header, MODEL)
    for i, t in enumerate(run.time_s[run.time_s < 50.0].tolist()):
        sensor.update(t, {name: float(values[i]) for name, values in columns.items()})
        assert sensor.left_out == {}


def test_without_a_panel_in_the_press_no_channel_departs_from_its_neighbours(pressing):
    run, truth = pressing
    scattered = {name: values.copy() for name, values in run.columns.items()}
    before = run.time_s < truth.moments.inserted_s - 2.0
    for name in ("top_1", "top_2"):
        scattered[name][before] += 8.0 * (-1.0) ** np.arange(before.sum())
    sensor = ScanSensor(PRESS, run.header, MODEL)
    for i in np.flatnonzero(before).tolist():
        estimate = sensor.update(
            float(run.time_s[i]), {name: float(values[i]) for name, values in scattered.items()}
        )
        assert estimate.state is PressState.IDLE
        assert sensor.left_out == {}
