"""Runs that are not what they say: the live sensor must not answer them with a wrong core in a narrow band."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from daq.press.detector import CHANGE_S
from daq.press.events import PressEventDetector
from daq.press.header import doubts
from daq.press.press_file import parse_press
from daq.recording.run_keeper import RunKeeper, RunNames, RunRules
from daq.records import InputError, PressState, Quality, Scan
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.heat.model_file import FittedValue, MissingCauses, ModelFile
from softsensor.live.consistency import (
    FaceReadings,
    Insertion,
    StartError,
    contradiction,
    first_error,
    place_insertion,
    start_error,
)
from softsensor.live.sensor import ScanSensor
from softsensor.live.validity import InvalidReason
from tests.editions import edition

PRESS = parse_press(press_toml())
MODEL = ModelFile(
    "test", "lab", {name: FittedValue(value, 0.2 * value) for name, value in BASE_COEFFICIENTS.items()}
)
HELD = replace(MODEL, missing=MissingCauses(8, 0.9, 0.0, {}))
"""The same after eight runs were held against it: without, constants are doubted like the material table."""
PLAN = Plan(
    rate_hz=2.0, thickness_mm=16.0, start_before_s=6.0, closed_column=True,
    press_time_s=(40.0, 60.0), open_before_s=(6.0, 12.0), open_after_s=(35.0, 45.0),
)  # fmt: skip


@pytest.fixture(scope="module")
def pressing():
    return make_campaign(21, 1, None, PLAN)[0]


def replay(run, model=MODEL):
    sensor = ScanSensor(PRESS, run.header, model)
    return [
        sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
        for i, t in enumerate(run.time_s.tolist())
    ]


def with_columns(run, chosen, change):
    columns = {n: change(v) if n.startswith(chosen) else v for n, v in run.columns.items()}
    return replace(run, columns=columns)


def held_from(run, at_s, until_s=np.inf):
    """Repeat what was read last before a moment."""
    still = (run.time_s >= at_s) & (run.time_s < until_s)
    last = int(np.argmax(still)) - 1
    return lambda values: np.where(still, values[max(last, 0)], values)


def share_missed(estimates, core):
    """Return the share of valid rows whose band misses the truth."""
    rows = [not e.core_low_C <= c <= e.core_high_C for e, c in zip(estimates, core, strict=True) if e.valid]
    return float(np.mean(rows)) if rows else 0.0


def recorded_from(run, at_s):
    """Return header and rows of the run that a recorder makes which begins then; no rows where it makes none."""
    names, detector = list(run.columns), PressEventDetector(PRESS)
    header = {k: v for k, v in run.header.items() if k != "panel.initial_temperature_C"}
    places = [i for i, name in enumerate(names) if name.startswith(("top_", "bottom_"))]
    keeper = RunKeeper(RunRules("lab", 5.0, 5.0, 3600.0, header), RunNames("lab", None), places)
    rows = np.flatnonzero(run.time_s >= at_s)
    for number, (row, time_s) in enumerate(zip(rows, run.time_s[rows].tolist(), strict=True)):
        values = {name: float(column[row]) for name, column in run.columns.items()}
        qualities = tuple(Quality.GOOD if value == value else Quality.MISSING for value in values.values())
        now = datetime(2026, 3, 4, tzinfo=UTC) + timedelta(seconds=time_s)
        scan = Scan(number, now, time_s, tuple(values.values()), qualities)
        for begin, _ in keeper.take(scan, detector.update(time_s, values)):
            if begin is not None:
                return begin.header, rows[begin.first_scan :]
    return {}, rows[:0]


@pytest.mark.parametrize("switch", [True, False], ids=["with a switch", "without a switch"])
@pytest.mark.parametrize("seed", range(501, edition(503, 513)))
def test_a_recorder_that_begins_in_the_middle_of_a_pressing_gives_no_core_that_is_surely_wrong(seed, switch):
    """Whatever the moment: before, where the panel lies on the hot plate, closed, open again."""
    ((run, truth),) = make_campaign(seed, 1, None, replace(PLAN, closed_column=switch))
    m = truth.moments
    waiting = np.arange(m.inserted_s - 2.0, m.closed_s + 1.0, 1.0)
    seen, believed = 0, 0
    for at_s in (*waiting, m.closed_s + 10.0, m.opened_s - 1.0, m.opened_s + 2.0):
        header, rows = recorded_from(run, at_s)
        sensor = ScanSensor(PRESS, header, HELD)
        for row in rows:
            values = {name: float(column[row]) for name, column in run.columns.items()}
            try:
                estimate = sensor.update(float(run.time_s[row] - run.time_s[rows[0]]), values)
            except InputError as refused:
                assert "panel.initial_temperature_C" in str(refused)  # noqa: PT017 - told, and not guessed
                break
            seen, believed = seen + 1, believed + estimate.valid
            if estimate.valid:
                assert estimate.core_low_C - 1.0 <= truth.core_C[row] <= estimate.core_high_C + 1.0
    assert 0.2 * seen < believed


def test_platens_that_come_a_few_scans_late_are_waited_for(pressing):
    run, truth = pressing
    late = run.time_s < 3.0
    estimates = replay(with_columns(run, "platen_top", lambda v: np.where(late, np.nan, v)))
    assert {(e.valid, e.reason) for e in estimates[: int(late.sum())]} == {
        (False, InvalidReason.PLATEN_READING_MISSING)
    }
    assert np.mean([e.valid for e in estimates[int(late.sum()) :]]) > 0.95
    assert share_missed(estimates, truth.core_C) < 0.1


def test_platens_that_come_when_the_panel_has_long_lain_there_leave_the_core_unknown(pressing):
    run, truth = pressing
    late = run.time_s < truth.moments.closed_s + 5.0
    estimates = replay(with_columns(run, "platen", lambda v: np.where(late, np.nan, v)))
    assert not any(e.valid for e in estimates)
    assert estimates[-1].reason is InvalidReason.PLATENS_MISSING_AT_INSERTION


@pytest.mark.parametrize("wire", [True, False])
@pytest.mark.parametrize("after_s", [2.0, 20.0])
def test_a_run_that_begins_in_mid_press_is_not_answered(pressing, wire, after_s):
    run, truth = pressing
    kept = run.time_s > truth.moments.closed_s + after_s
    columns = {n: v[kept] for n, v in run.columns.items() if wire or n != "closed"}
    estimates = replay(replace(run, time_s=run.time_s[kept], columns=columns))
    assert share_missed(estimates, truth.core_C[kept]) == 0.0
    assert np.mean([e.valid for e in estimates]) < 0.1


def test_a_start_temperature_that_all_sensors_contradict_is_not_believed(pressing):
    run, _ = pressing
    wrong = run.header["panel.initial_temperature_C"] + 10.0
    estimates = replay(replace(run, header=dict(run.header) | {"panel.initial_temperature_C": wrong}))
    closed = [e for e in estimates if e.state is PressState.CLOSED]
    assert {e.valid for e in closed} == {False}
    assert closed[0].reason is InvalidReason.START_TEMPERATURE_CONTRADICTED
    assert closed[0].invalid.arguments["header_C"] == wrong


@pytest.mark.parametrize("off", [-4.0, 3.0])
def test_a_start_temperature_that_is_a_little_off_is_put_right_by_the_sensors(pressing, off):
    run, truth = pressing
    wrong = run.header["panel.initial_temperature_C"] + off
    estimates = replay(replace(run, header=dict(run.header) | {"panel.initial_temperature_C": wrong}))
    there = [i for i, e in enumerate(estimates) if e.valid and e.state is not PressState.IDLE]
    assert len(there) > 100
    assert max(abs(estimates[i].core_C - truth.core_C[i]) for i in there) < 1.0
    assert np.mean([estimates[i].core_low_C <= truth.core_C[i] <= estimates[i].core_high_C for i in there]) > 0.95


def test_a_lower_face_that_warms_already_is_no_contradiction():
    assert start_error(np.array([21.0, 45.0]), 20.0) == 1.0
    assert start_error(np.array([np.nan, np.nan]), 20.0) == 0.0
    assert contradiction(1.0, 20.0) is None
    found = contradiction(start_error(np.array([60.0, 104.0]), 20.0), 20.0)
    assert found.line == "start temperature contradicted; measured_C=60; header_C=20"
    assert str(found.message) == "sensors read 60 °C, but the header gives a start temperature of 20 °C"


@pytest.mark.parametrize("face", ["top_", "bottom_"])
def test_a_face_that_repeats_itself_while_the_panel_warms_does_not_count(pressing, face):
    run, truth = pressing
    estimates = replay(with_columns(run, face, held_from(run, 2.0)))
    assert share_missed(estimates, truth.core_C) < 0.05
    assert np.mean([e.valid for e in estimates]) > 0.9


def test_faces_that_both_repeat_themselves_count_no_more_than_faces_nobody_reads(pressing):
    run, truth = pressing
    still, silent = (
        replay(with_columns(run, ("top_", "bottom_"), change))
        for change in (held_from(run, 2.0), lambda v: np.where(run.time_s >= 2.0, np.nan, v))
    )
    assert share_missed(still, truth.core_C) < 0.05
    assert all(e.valid for e in still if e.state is PressState.CLOSED)
    late = truth.moments.opened_s + CHANGE_S + 2.0
    after = [[(e.state, e.reason) for e in one if e.time_s > late] for one in (still, silent)]
    assert after[0]
    assert after[0] == after[1] == [(PressState.OPEN, InvalidReason.PANEL_NOT_SEEN)] * len(after[0])


def test_a_logger_that_stands_still_over_the_closing_is_a_gap(pressing):
    run, truth = pressing
    begun = truth.moments.closed_s - 1.0
    frozen = held_from(run, begun, begun + 20.0)
    estimates = replay(with_columns(run, ("top_", "bottom_", "platen"), frozen))
    assert share_missed(estimates, truth.core_C) < 0.05
    silent = [e for e in estimates if begun + 15.0 < e.time_s < begun + 19.0]
    assert {(e.valid, e.reason) for e in silent} == {(False, InvalidReason.PLATEN_READING_MISSING)}


def test_without_a_wire_faces_that_repeat_themselves_do_not_show_a_closed_press_for_ever():
    """A logger of its own that repeats what it read last, beside platens that go on: nobody sees it open."""
    ((run, truth),) = make_campaign(21, 1, None, replace(PLAN, closed_column=False))
    still = held_from(run, truth.moments.closed_s + 5.0)
    estimates = replay(with_columns(run, ("top_", "bottom_"), still))
    late = [e for e in estimates if e.time_s > truth.moments.opened_s]
    assert len(late) > 60
    assert {(e.valid, e.reason) for e in late} == {(False, InvalidReason.PRESS_STATE_UNKNOWN)}


def test_a_switch_that_opens_for_a_moment_with_no_sensor_on_the_panel_leaves_the_press_closed(pressing):
    run, truth = pressing
    middle = (truth.moments.closed_s + truth.moments.opened_s) / 2
    slip = (run.time_s > middle) & (run.time_s < middle + 1.5)
    columns = {n: v for n, v in run.columns.items() if not n.startswith(("top_", "bottom_"))}
    columns["closed"] = np.where(slip, 0.0, columns["closed"])
    estimates = replay(replace(run, columns=columns))
    assert share_missed(estimates, truth.core_C) < 0.15


@pytest.mark.parametrize(("before_s", "after_s"), [(2.0, 2.0), (3.0, 0.4), (0.5, 4.0), (10.0, 10.0), (2.0, 18.0)])
def test_a_gap_in_the_log_around_the_closing_does_not_deceive(before_s, after_s):
    ((run, truth),) = make_campaign(910801, 1, None, replace(PLAN, closed_column=False, thickness_mm=8.0))
    since = run.time_s - truth.moments.closed_s
    kept = (since < -before_s) | (since > after_s)
    columns = {n: v[kept] for n, v in run.columns.items()}
    estimates = replay(replace(run, time_s=run.time_s[kept], columns=columns), HELD)
    assert share_missed(estimates, truth.core_C[kept]) < 0.1
    if before_s + after_s < 6.0:
        assert np.mean([e.valid for e in estimates]) > 0.9


def test_a_closing_that_went_unheard_leaves_the_core_unknown(pressing):
    run, truth = pressing
    since = run.time_s - truth.moments.closed_s
    unheard = (since > -2.0) & (since < 15.0)
    deaf = with_columns(run, ("top_", "bottom_"), lambda v: np.where(unheard, np.nan, v))
    estimates = replay(replace(deaf, columns={n: v for n, v in deaf.columns.items() if n != "closed"}))
    assert share_missed(estimates, truth.core_C) == 0.0
    assert not any(e.valid for e in estimates if e.time_s > truth.moments.closed_s + 16.0)


# --- a panel nobody saw coming -----------------------------------------------------------------------

TIME = np.arange(0.0, 40.0, 0.5)


def faces(came_at, read_from, start=20.0, closed=30.0):
    """Upper and lower face of a panel that comes at a time: the lower one rises with the root of time (N, 2)."""
    since = np.maximum(TIME - came_at, 0.0)
    lower = np.where(closed > TIME, start + 25.0 * np.sqrt(since), 150.0)
    upper = np.where(closed > TIME, start, 140.0)
    table = np.column_stack([upper, lower])
    table[read_from > TIME, 1] = np.nan
    return table


def test_a_lower_face_heard_before_the_panel_came_leaves_its_moment_to_the_detector():
    assert place_insertion(FaceReadings(TIME, faces(10.0, 0.0), 1), 20.0, 10.2, np.inf, 40.0) == Insertion(10.2)


def test_an_insertion_that_only_the_closing_shows_lies_before_the_lower_face_was_first_read_hot():
    shown = FaceReadings(TIME, faces(10.0, 0.0), 1)
    assert place_insertion(shown, 20.0, 17.0, 18.0, 19.0).at == pytest.approx(10.0, abs=1.0)  # 38 °C by then


def test_a_lower_face_still_hot_from_the_panel_before_but_heard_all_along_leaves_it_to_the_detector_too():
    hot = faces(10.0, 0.0)
    hot[TIME < 10.0, 1] = 60.0
    assert place_insertion(FaceReadings(TIME, hot, 1), 20.0, 10.2, np.inf, 40.0, opened=2.0) == Insertion(10.2)
    hot[(TIME > 4.0) & (TIME < 12.0), 1] = np.nan
    came = place_insertion(
        FaceReadings(TIME[TIME < 14.0], hot[TIME < 14.0], 1), 20.0, 12.5, np.inf, 14.0, opened=2.0
    )
    assert came.at == pytest.approx(10.0, abs=0.3)
    assert 0.3 < came.sd < 1.5


@pytest.mark.parametrize("late_s", [3.0, 6.0])
def test_a_lower_face_first_heard_on_the_plate_tells_how_long_it_has_lain_there(late_s):
    seen = 10.0 + late_s + 2.0 > TIME
    came = place_insertion(
        FaceReadings(TIME[seen], faces(10.0, 10.0 + late_s)[seen], 1), 20.0, 10.0 + late_s, np.inf, 39.0
    )
    assert came.at == pytest.approx(10.0, abs=0.3)
    assert 0.3 * late_s < came.sd < 0.5 * late_s


def test_without_a_lower_face_the_usual_wait_is_taken_within_what_the_log_allows():
    came = place_insertion(FaceReadings(TIME, faces(10.0, np.inf), 1), 20.0, 29.0, 30.0, 31.0)
    assert (came.at, came.sd) == (12.0, pytest.approx(30.0 / np.sqrt(12.0)))
    cold_until_25 = np.where(TIME <= 25.0, 21.0, np.nan)
    came = place_insertion(
        FaceReadings(TIME, np.column_stack([faces(10.0, 0.0)[:, 0], cold_until_25]), 1), 20.0, 29.0, 30.0, 31.0
    )
    assert came.at == 25.0
    assert came.sd == pytest.approx(5.0 / np.sqrt(12.0))


@pytest.mark.parametrize(("order", "lower"), [([0, 1], 1), ([1, 0], 0), ([0], -1)])
def test_an_upper_face_that_warms_in_the_open_press_tells_when_the_panel_came(order, lower):
    warming = faces(10.0, np.inf)
    warming[:, 0] += np.where(TIME < 30.0, 6.0 * np.sqrt(np.maximum(TIME - 15.0, 0.0)), 0.0)
    came = place_insertion(FaceReadings(TIME, warming[:, order], lower), 20.0, 29.0, 30.0, 31.0)
    assert came.at == pytest.approx(15.0, abs=0.5)
    assert came.sd == 3.0


def test_the_start_is_judged_by_the_face_that_may_have_warmed_least():
    plugged = faces(10.0, 12.0)
    plugged[TIME < 12.0] = np.nan
    seen = FaceReadings(TIME, plugged, 1)
    assert first_error(seen, 20.0, Insertion(10.0), 30.0) == StartError(0.0, 0.0, 2)
    assert first_error(seen, 40.0, Insertion(10.0), 30.0) == StartError(-20.0, -20.0, 2)
    found = first_error(seen, 0.0, Insertion(10.0), 30.0)
    assert found.off == 20.0
    assert 10.0 < found.certain < 20.0
    assert first_error(FaceReadings(TIME[:20], plugged[:20], 1), 20.0, Insertion(9.0), 30.0).faces == 0
    plugged[(TIME >= 12.0) & (TIME < 15.0), 0] = np.nan  # the upper face joins later and is colder than the header
    assert first_error(seen, 25.0, Insertion(10.0), 30.0) == StartError(-5.0, -5.0, 2)


def test_the_ramp_of_the_closing_is_no_slope_of_the_waiting_panel():
    joined = faces(4.0, 29.0)
    ramp = (TIME >= 29.5) & (TIME < 30.5)
    joined[ramp, 1] += 40.0
    came = place_insertion(FaceReadings(TIME, joined, 1), 20.0, 29.0, 30.0, 31.0)
    assert (came.at, came.sd) == (11.0, pytest.approx(30.0 / np.sqrt(12.0)))


def test_rows_that_are_missing_hide_when_the_panel_came():
    there = (TIME < 9.0) | (TIME > 25.0)
    came = place_insertion(
        FaceReadings(TIME[TIME < 9.0], faces(10.0, 0.0)[TIME < 9.0], 1), 20.0, 25.5, np.inf, 25.5
    )
    assert there.sum() > 10
    assert 8.5 <= came.at < 20.0
    assert came.sd > 4.0


def fallen_silent(run, chosen, until_s):
    return with_columns(run, chosen, lambda values: np.where(run.time_s < until_s, np.nan, values))


@pytest.mark.parametrize(
    ("chosen", "since", "after_s"),
    [
        ("bottom_", "closed_s", np.inf),
        ("bottom_", "closed_s", 20.0),
        ("bottom_", "closed_s", 2.0),
        (("top_", "bottom_"), "inserted_s", 1.0),
        (("top_", "bottom_"), "inserted_s", 4.0),
    ],
    ids=["no lower sensors", "20 s after closing", "2 s after closing", "plugged in", "plugged in late"],
)
@pytest.mark.parametrize("number", [0, 1, 2])
def test_sensors_that_join_late_or_never_leave_the_core_known(number, chosen, since, after_s):
    plan = replace(PLAN, closed_column=False, start_before_s=10.0, open_before_s=(8.0, 28.0))
    run, truth = make_campaign(22, 3, None, plan)[number]
    late = fallen_silent(run, chosen, getattr(truth.moments, since) + after_s)
    estimates = replay(replace(late, columns={n: v for n, v in late.columns.items() if np.isfinite(v).any()}))
    closed = [e for e in estimates if e.state is PressState.CLOSED]
    assert np.mean([e.valid for e in closed]) > 0.95
    assert share_missed(estimates, truth.core_C) < 0.1


@pytest.mark.parametrize("off", [-20.0, -9.0, -3.0, 3.0, 9.0, 20.0])
@pytest.mark.parametrize("after_s", [0.0, 4.0])
def test_a_start_temperature_that_sensors_plugged_in_with_the_panel_contradict_is_not_believed(off, after_s):
    plan = replace(PLAN, closed_column=False, start_before_s=10.0, open_before_s=(15.0, 25.0))
    ((run, truth),) = make_campaign(23, 1, None, plan)
    plugged = fallen_silent(run, ("top_", "bottom_"), truth.moments.inserted_s + after_s)
    wrong = dict(run.header) | {"panel.initial_temperature_C": run.header["panel.initial_temperature_C"] + off}
    estimates = replay(replace(plugged, header=wrong))
    there = [i for i, e in enumerate(estimates) if e.state in (PressState.OPEN, PressState.CLOSED) and e.valid]
    assert (
        np.mean([not estimates[i].core_low_C <= truth.core_C[i] <= estimates[i].core_high_C for i in there] or [0])
        < 0.1
    )
    if abs(off) == 3.0:
        assert len(there) > 100


def test_an_idle_press_whose_lower_face_is_unheard_is_not_said_to_be_empty(pressing):
    run, truth = pressing
    estimates = replay(replace(run, columns={n: v for n, v in run.columns.items() if not n.startswith("bottom_")}))
    idle = [e for e in estimates if e.state is PressState.IDLE and 3.5 < e.time_s < truth.moments.closed_s]
    assert idle
    assert all(not e.valid and e.reason is InvalidReason.LOWER_FACE_SILENT for e in idle)


def test_a_press_open_for_long_with_no_sensor_heard_may_hold_another_panel(pressing):
    run, truth = pressing
    columns = {n: v for n, v in run.columns.items() if not n.startswith(("top_", "bottom_"))}
    estimates = replay(replace(run, columns=columns))
    opened = truth.moments.opened_s
    assert any(e.valid for e in estimates if opened + 2.0 < e.time_s < opened + 14.0)
    assert not any(e.valid for e in estimates if e.time_s > opened + 17.0)


def test_a_run_that_begins_with_the_panel_long_on_the_plate_is_not_answered():
    plan = replace(PLAN, closed_column=False, start_before_s=10.0, open_before_s=(20.0, 25.0))
    ((run, truth),) = make_campaign(24, 1, None, plan)
    late = run.time_s > truth.moments.inserted_s + 10.0
    estimates = replay(run.at_rows(late))
    closed = [e for e in estimates if e.state is PressState.CLOSED]
    assert closed
    assert not any(e.valid for e in closed)


def test_a_start_temperature_read_from_a_pressed_panel_is_not_believed(pressing):
    run, truth = pressing
    columns = {n: v for n, v in run.columns.items() if not n.startswith(("top_", "bottom_"))}
    estimates = replay(
        replace(run, header=dict(run.header) | {"panel.initial_temperature_C": 157.0}, columns=columns)
    )
    closed = [e for e in estimates if truth.moments.closed_s + 1.0 < e.time_s < truth.moments.opened_s]
    assert len(closed) > 50
    assert {e.invalid.line for e in closed} == {"start temperature too high; header_C=157"}


@pytest.mark.parametrize("key", ["density_kg_m3", "heat_capacity_J_kgK"])
@pytest.mark.parametrize("factor", [0.5, 1.5, 2.0])
def test_a_constant_far_from_that_of_its_material_is_doubted_whichever_way_it_is_off(pressing, key, factor):
    run, truth = pressing
    usual = {"density_kg_m3": run.header["panel.density_kg_m3"], "heat_capacity_J_kgK": 1550.0}[key]
    mistaken = replace(run, header={**run.header, f"panel.{key}": factor * usual})
    assert [estimates.code for estimates in doubts(mistaken.header)] == ["header-far-from-table"]
    estimates = replay(mistaken, HELD)
    assert share_missed(estimates, truth.core_C) <= 0.05


def without(run, begin, end):
    """Return a run without its scans between two times."""
    return run.at_rows((run.time_s <= begin) | (run.time_s > end))


def test_a_clock_that_jumps_is_doubted_and_scans_that_are_lost_are_not(pressing):
    """After 25 s without scans the faces have warmed by 5 K; after a jump they stand where they were."""
    run, truth = pressing
    lost_s = truth.moments.closed_s + 10.0
    jumped = replay(replace(run, time_s=run.time_s + 25.0 * (run.time_s > lost_s)), HELD)
    assert not any(e.valid for e in jumped if e.time_s > lost_s + 1.0)
    lost = replay(without(run, lost_s, lost_s + 25.0), HELD)
    assert np.mean([e.valid for e in lost if e.time_s > lost_s]) > 0.9


BOARD = parse_press("""
[press]
name = "board"
area_m2 = 0.01
[initial]
kind = "uniform"
temperature_C = 20.0
[[layer]]
name = "board"
thickness_mm = 50.0
conductivity_W_mK = 0.1
density_kg_m3 = 150.0
heat_capacity_J_kgK = 840.0
[boundary.top]
kind = "measured"
column = "hot"
[boundary.bottom]
kind = "insulated"
[[sensor]]
columns = ["inside"]
at = { layer = "board", depth_mm = 40.0 }
[core]
at = { layer = "board", depth_mm = 25.0 }
""")


def heated_board(time_s, *depths_m, conductivity):
    """Return what `BOARD` is at some depths, 20 °C first, its top held at 220 °C (Carslaw & Jaeger, 3.4)."""
    odd = (2 * np.arange(200)[:, None] + 1) * np.pi / 2
    decay = np.exp(-conductivity / (150.0 * 840.0) * (odd / 0.05) ** 2 * time_s)
    return [
        220.0 - 200.0 * (2.0 * np.sin(odd) / odd * decay * np.cos(odd * x / 0.05)).sum(axis=0) for x in depths_m
    ]


def test_scans_ten_seconds_apart_are_no_holes_that_contradict_the_model_for_good():
    """A fifth too little conductivity meets the first scans of a face heated at once badly, later ones well."""
    time_s = np.arange(0.0, 7200.0, 10.0)
    inside, core = heated_board(time_s, 0.040, 0.025, conductivity=0.12)
    sensor = ScanSensor(BOARD, {"ambient.temperature_C": 20.0})
    estimates = [
        sensor.update(t, {"hot": 220.0, "inside": v}) for t, v in zip(time_s.tolist(), inside, strict=True)
    ]
    late = [(e, truth) for e, truth in zip(estimates, core, strict=True) if e.time_s > 1200.0]
    assert all(e.valid and e.core_low_C < truth < e.core_high_C for e, truth in late)


def test_faces_that_stand_still_in_the_closed_press_are_read_late_and_tell_the_core_no_better(pressing):
    run, truth = pressing
    late = with_columns(run, ("top_", "bottom_"), lambda v: np.r_[np.full(20, v[0]), v[:-20]])
    assert share_missed(replay(late, HELD), truth.core_C) < 0.01
