"""What is said of the press as it stands, where the live sensor, the run before or other presses could mislead."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import event

from api.answers.blisters import blisters_of
from api.answers.drift import drift_of
from api.answers.records import press_now
from api.answers.thresholds import crossed
from api.http.news import Position, news
from daq.records import Channel, PressEvent, PressEventKind, Quality, Run, Scan
from daq.simulated.campaign_pressfile import press_toml
from daq.store.records import NewRun, PressKey, RunEnd, RunStatus, StoredEstimate
from daq.store.store import Store, open_store
from softsensor.opening.blisters import learn_limit
from softsensor.opening.limits import Normal

CHANNELS = tuple(Channel(name) for name in ("platen_top", "platen_bottom", "top_1", "bottom_1"))
START = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
KIND = PressEventKind
TARGET = {"setting.core_target_C": 40.0}


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with open_store(str(tmp_path / "kerntemp.sqlite")) as opened:
        yield opened


def scan(number: int) -> Scan:
    return Scan(
        number, START + timedelta(seconds=number), 1000.0 + number, (200.0, 200.0, 90.0, 90.0), (Quality.GOOD,) * 4
    )


def estimate(number: int, core: float, **detail: float) -> StoredEstimate:
    at = 1000.0 + number
    return StoredEstimate(number, at, "closed", core, 1.0, core - 2, core + 2, True, detail=detail or None)


def record(store: Store, key: PressKey, name: str, numbers: range, core: float, *, ended: bool) -> None:
    """Store a run whose core stands at one temperature."""
    first = scan(numbers[0])
    rows = [scan(n) for n in numbers]
    store.append_scans(key, rows[:1], begin=NewRun(name, first.number, first.utc, first.monotonic_s, TARGET))
    at = first.monotonic_s
    store.append_scans(key, rows[1:], [PressEvent(kind, at, at) for kind in (KIND.INSERTED, KIND.CLOSED)])
    store.append_estimates(key.name, [estimate(n, core) for n in numbers])
    if ended:
        store.append_scans(key, [], end=RunEnd(name, numbers[-1], scan(numbers[-1]).utc))


def now_of(store: Store, later_s: float = 0.2):
    """The press some time after its newest scan."""
    return press_now(store, "lab", "", START + timedelta(seconds=store.newest_scan_number("lab") + later_s))


def test_the_run_before_does_not_count_as_having_reached_the_target(store):
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(20), 55.0, ended=True)
    record(store, key, "two", range(20, 25), 25.0, ended=False)
    target = now_of(store).target
    assert (target.temperature_C, target.reached) == (40.0, False)


def test_a_target_once_reached_stays_reached_though_the_core_cools_again(store):
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 41.0, ended=False)
    assert now_of(store).target.reached
    for first in range(5, 1005, 250):
        store.append_scans(key, [scan(n) for n in range(first, first + 250)])
        store.append_estimates("lab", [estimate(n, 30.0) for n in range(first, first + 250)])
    assert now_of(store).target.reached


def test_the_time_to_the_target_is_what_the_live_sensor_said_last(store):
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 30.0, ended=False)
    store.append_scans(key, [scan(5)])
    store.append_estimates("lab", [estimate(5, 31.0, target_in_s=17.5)])
    assert now_of(store, 0.0).target.time_to_target_s == 17.5
    assert now_of(store, 3.0).target.time_to_target_s == 14.5


def test_an_estimate_that_is_not_valid_hands_on_no_outlook(store):
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 30.0, ended=False)
    store.append_scans(key, [scan(5)])
    ahead = {"target_in_s": 17.5, "open_in_s": 9.0, "peak_C": 81.0, "energy_kJ_m2": 700.0, "profile_C": [99.0]}
    beside = {**ahead, "warning": "core will peak at 81 °C", "suspected": "edge_loss"}
    kept = replace(estimate(5, 31.0), detail=beside)
    store.append_estimates("lab", [kept])
    now = now_of(store)
    assert {name: getattr(now.estimate, name) for name in beside} == beside
    store.append_estimates("lab", [replace(kept, valid=False, reason="calculation failed")])
    now = now_of(store)
    assert {getattr(now.estimate, name) for name in set(ahead) - {"profile_C"}} == {None}
    assert (now.estimate.profile_C, now.estimate.warning, now.estimate.suspected) == (None, "", "edge_loss")
    assert now.target.time_to_target_s is None


def test_limits_alone_still_say_when_to_open_where_nobody_updates_the_core_any_more(store):
    """Else the page would draw the target that does not count."""
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 30.0, ended=False)
    store.append_scans(key, [scan(n) for n in range(5, 30)])
    store.append_estimates("lab", [estimate(5, 30.0, limited=True)])
    now = now_of(store).estimate
    assert (now.valid, now.reason, now.limited) == (False, "live sensor silent", True)


def test_a_core_nobody_updates_any_more_is_not_shown_as_the_core_of_now(store):
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 30.0, ended=False)
    store.append_scans(key, [scan(n) for n in range(5, 8)])
    fresh = now_of(store).estimate
    assert (fresh.valid, fresh.utc) == (True, START + timedelta(seconds=4))
    store.append_scans(key, [scan(n) for n in range(8, 30)])
    stale = now_of(store)
    assert not stale.estimate.valid
    assert stale.estimate.reason == "live sensor silent"
    assert stale.estimate.reason_arguments == {"silent_s": 25}
    assert (stale.state, stale.estimate.state, stale.estimate.core_C) == ("closed", "closed", None)
    assert stale.estimate.utc == START + timedelta(seconds=4)
    assert stale.target.time_to_target_s is None


LEAVE = {"cure_top": 0.9, "cure_bottom": 0.9, "cure_low": 0.85, "open_now": True, "limits_in_s": 0.0}


def pressing_that_may_end(store: Store) -> PressKey:
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 30.0, ended=False)
    store.append_scans(key, [scan(5)])
    store.append_estimates("lab", [estimate(5, 31.0, **LEAVE)])
    return key


@pytest.mark.parametrize(("later_s", "leave"), [(0.0, True), (4.9, True), (5.1, False), (600.0, False)])
def test_leave_to_open_is_taken_back_when_recorder_and_sensor_stop_together(store, later_s, leave):
    pressing_that_may_end(store)
    now = now_of(store, later_s)
    assert (now.estimate.open_now, now.estimate.valid, now.age_s) == (leave, leave, later_s)
    assert now.estimate.advice.verdict == ("open_now" if leave else "not_known")
    assert now.state == ("closed" if leave else "unknown")
    if not leave:
        assert (now.estimate.reason, now.time_s, now.faces.top_C) == ("no scans", None, None)
        assert now.estimate.reason_arguments == {"silent_s": round(later_s)}
        since = "10 min" if later_s == 600.0 else f"{later_s:.0f} s"
        assert now.estimate.advice.sentence == f"not known, because no scan for {since}"


def test_of_a_press_that_fell_silent_the_core_of_then_is_known_else_none(store):
    key = pressing_that_may_end(store)
    assert now_of(store, 4.9).last_core is None
    then = now_of(store, 600.0).last_core
    assert (then.utc, then.core_C, then.core_low_C, then.core_high_C) == (
        START + timedelta(seconds=5),
        31.0,
        29.0,
        33.0,
    )
    assert now_of(store, -30.0).last_core is None
    store.append_scans(key, [scan(n) for n in range(6, 12)])  # without an estimate: the live sensor went first
    assert now_of(store, 600.0).last_core is None


def test_of_a_press_that_fell_silent_without_a_panel_no_core_is_known(store):
    key = pressing_that_may_end(store)
    store.append_scans(key, [], [PressEvent(KIND.REMOVED, 1005.0, 1005.0)])
    assert now_of(store, 600.0).last_core is None


@pytest.mark.parametrize(("kinds", "known"), [((), True), ((KIND.OPENED, KIND.REMOVED), False)])
def test_of_a_press_whose_recorder_was_stopped_the_core_of_then_is_known(store, kinds, known):
    """As where it died, unless the panel was gone."""
    key = pressing_that_may_end(store)
    store.append_scans(key, [], [PressEvent(kind, 1005.0, 1005.0) for kind in kinds])
    assert (now_of(store, 600.0).last_core is not None) == known
    store.append_scans(key, [], end=RunEnd("one", 5, scan(5).utc, status=RunStatus.INTERRUPTED))
    assert (now_of(store, 600.0).last_core is not None) == known
    store.append_scans(key, [scan(6)])  # read on without a pressing
    assert now_of(store, 600.0).last_core is None


def test_a_recorder_whose_clock_runs_ahead_gives_no_leave(store):
    pressing_that_may_end(store)
    now = now_of(store, -30.0)
    assert (now.state, now.estimate.open_now, now.estimate.reason) == ("unknown", False, "clock ahead")
    assert now.estimate.reason_arguments == {"ahead_s": 30}


def test_what_is_told_says_until_when_it_may_be_acted_on(store):
    pressing_that_may_end(store)
    now = now_of(store, 1.5).estimate
    assert (now.utc, now.age_s) == (START + timedelta(seconds=5), 1.5)
    assert now.valid_until_utc == START + timedelta(seconds=10)
    assert now_of(store, 9.0).estimate.valid_until_utc is None


@pytest.mark.parametrize(
    ("kind", "state", "reason"),
    [
        (KIND.OPENED, "open", "estimate behind the press"),  # which the sensor has not taken in
        (KIND.REMOVED, "idle", "no panel in the press"),
    ],
)
def test_an_estimate_of_another_state_than_the_recorders_is_none_of_this_panel(store, kind, state, reason):
    key = pressing_that_may_end(store)
    store.append_scans(key, [scan(6)], [PressEvent(kind, 1006.0, 1006.0)])
    now = now_of(store)
    assert (now.state, now.estimate.state, now.estimate.reason) == (state, state, reason)
    assert (now.estimate.open_now, now.estimate.core_C) == (False, None)


def test_a_new_panel_has_no_estimate_before_its_own(store):
    key = pressing_that_may_end(store)
    store.append_scans(key, [], end=RunEnd("one", 5, scan(5).utc))
    assert now_of(store).estimate.reason == "no panel in the press"
    new = scan(6)
    store.append_scans(key, [new], begin=NewRun("two", 6, new.utc, new.monotonic_s, TARGET))
    store.append_scans(key, [scan(7)], [PressEvent(KIND.INSERTED, 1006.0, 1006.0)])
    now = now_of(store)
    assert (now.state, now.estimate.reason) == ("open", "no estimate yet")
    store.append_estimates("lab", [replace(estimate(7, 24.0), state="idle", valid=False, reason="x")])
    assert now_of(store).estimate.reason == "no estimate yet"
    store.append_estimates("lab", [replace(estimate(7, 24.0), state="open")])
    assert now_of(store).estimate.valid


def test_a_panel_a_stopped_recorder_left_in_the_press_is_not_said_to_be_gone_while_its_faces_are_warm(store):
    key = store.register_press("lab", CHANNELS)
    record(store, key, "one", range(5), 25.0, ended=False)
    store.interrupt_open_runs("lab")
    store.append_scans(key, [scan(5)])
    store.append_estimates("lab", [replace(estimate(5, 25.0), state="idle", valid=False)])
    now = now_of(store)
    assert (now.state, now.estimate.reason, now.estimate.open_now) == ("unknown", "press state unknown", False)
    cold = replace(scan(6), values=(200.0, 200.0, 22.0, 24.0))
    store.append_scans(key, [cold])
    assert now_of(store).state == "idle"


def test_marked_panels_teach_what_steam_is_borne_by_what_the_live_sensor_last_said_of_them(store):
    """Against the rule asked directly; a panel whose steam nobody knew counts for nothing."""
    key = store.register_press("lab", CHANNELS)
    steam = (60.0, 70.0, 95.0, None)
    for i, (kPa, verdict) in enumerate(zip(steam, ("good", "good", "blister", "blister"), strict=True)):
        record(store, key, f"run-{i}", range(10 * i, 10 * i + 5), 55.0, ended=False)
        store.append_scans(key, [last := scan(10 * i + 5)])
        beside = {} if kPa is None else {"steam_kPa": kPa, "steam_high_kPa": 1.25 * kPa}
        store.append_estimates("lab", [estimate(last.number, 55.0, **beside)])
        store.append_scans(key, [], end=RunEnd(f"run-{i}", last.number, last.utc))
        store.annotate_run(f"run-{i}", {"panel.verdict": verdict}, "foreman")
    found = blisters_of(store, "lab", None)
    sd = np.full(3, np.log(1.25) / 1.959964)
    asked = learn_limit(Normal(np.log(steam[:3]), sd), np.array([False, False, True]))
    assert (found.marks, found.blistered, len(found.panels)) == (3, 1, 4)
    assert found.steam_most_kPa == pytest.approx(asked.most_kPa, abs=0.1)
    assert found.ci95_kPa == pytest.approx(asked.ci95_kPa, abs=0.1)


def test_a_core_above_its_limit_is_no_alarm_once_nobody_says_so_any_more(store):
    pressing_that_may_end(store)
    store.put_alarm_thresholds("lab", {"core_above_C": 20.0}, "test")
    at = START + timedelta(seconds=5)
    assert [a.message.code for a in crossed(store, at)] == ["alarm-core-above"]
    assert crossed(store, at + timedelta(seconds=6)) == []


def test_an_estimate_between_pressings_carries_the_time_of_its_own_scan(store):
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, [scan(n) for n in range(30)])
    behind = Position({"lab": 29}, {"lab": 9})
    nothing = float("nan")
    idle = [
        StoredEstimate(n, 1000.0 + n, "idle", nothing, nothing, nothing, nothing, False, "no panel in the press")
        for n in (10, 20)
    ]
    store.append_estimates("lab", idle)
    sent = [line for event in news(store, behind) for line in event.decode().splitlines() if line[:5] == "data:"]
    assert ['"utc":"2026-03-04T07:00:10Z"' in sent[0], '"utc":"2026-03-04T07:00:20Z"' in sent[1]] == [True, True]
    assert len(sent) == 2


def test_the_stream_knows_the_run_of_each_of_many_presses_and_beside_an_import(store, campaign):
    names = [f"press-{i}" for i in range(6)]
    for i, name in enumerate(names):
        key = store.register_press(name, CHANNELS)
        record(store, key, f"run-{i}", range(2), 25.0, ended=False)
    store.import_runs([run for run, _ in campaign], "elsewhere")
    behind = Position(dict.fromkeys(names, -1), dict.fromkeys(names, -1))
    text = b"".join(news(store, behind)).decode()
    for i, name in enumerate(names):
        assert text.count(f'"press":"{name}","run":"run-{i}","number":') == 4, name  # two scans, two estimates
        assert text.count(f'"press":"{name}","run":"run-{i}","event":') == 2, name


def fit(value: float) -> dict[str, object]:
    known = {"value": value, "sd": value / 30, "ci95": [0.9 * value, 1.1 * value], "identifiable": True}
    steady = {"value": 40.0, "sd": 1.0, "ci95": [38.0, 42.0], "identifiable": True}
    return {
        "coefficients": {"h_pp_c": known, "h_pp_o": steady},
        "rmse_K": 0.3,
        "initial_rmse_K": 1.0,
        "warnings": [],
    }


def test_a_coefficient_that_jumped_is_named_with_the_run_at_which_it_did(store):
    key = store.register_press("lab", CHANNELS)
    scatter = np.random.default_rng(1).standard_normal(20)
    for i, noise in enumerate(scatter):
        record(store, key, f"run-{i:02}", range(5 * i, 5 * i + 5), 30.0, ended=True)
        store.put_fit(f"run-{i:02}", fit(700.0 + 10 * noise))
    values = {f"run-{i:02}": 700.0 + 10 * noise for i, noise in enumerate(scatter)}
    assert drift_of(store, "lab") == []
    for i in range(20, 27):
        record(store, key, f"run-{i:02}", range(5 * i, 5 * i + 5), 30.0, ended=True)
        store.put_fit(f"run-{i:02}", fit(490.0))
        values[f"run-{i:02}"] = 490.0
    (drift,) = drift_of(store, "lab")
    for i in np.random.default_rng(2).permutation(27):  # fitted anew, as workers finish
        store.put_fit(f"run-{i:02}", fit(values[f"run-{i:02}"]))
    assert drift_of(store, "lab") == [drift]
    assert (drift.coefficient, drift.since_run) == ("h_pp_c", "run-20")
    assert drift.factor == pytest.approx(0.7, abs=0.03)
    assert "look at what was done to the press before it" in drift.sentence

    lag = {"effects": [{"name": "thermocouple_lag", "parameters": {}}]}
    store.put_model("lab", "lab-9", lag)
    for i in range(20, 27):
        store.put_fit(f"run-{i:02}", fit(490.0), "lab-9")
    assert drift_of(store, "lab") == []  # with another effect the coefficient means another thing
    store.promote_model("lab-9", "test")
    assert drift_of(store, "lab") == []
    for i in range(20):
        store.put_fit(f"run-{i:02}", fit(values[f"run-{i:02}"]), "lab-9")
    assert drift_of(store, "lab") == [drift]


def test_runs_of_unknown_date_have_no_place_on_a_control_chart(store):
    one = {"top_1": np.ones(2)}
    began = datetime(2026, 3, 4, tzinfo=UTC)
    for press, dated in (("told", True), ("untold", False)):
        for i in range(27):
            header = {"recorded.started_utc": began + timedelta(hours=i)} if dated else {}
            store.import_run(Run(f"{press}-{i:02}", header, np.array([0.0, 60.0]), one), press)
            store.put_fit(f"{press}-{i:02}", fit(700.0 + 10 * (i % 3) if i < 20 else 490.0))
    assert [d.coefficient for d in drift_of(store, "told")] == ["h_pp_c"]
    assert drift_of(store, "untold") == []


def test_what_a_hundred_presses_start_from_is_worked_out_once_each(store: Store) -> None:
    text = press_toml()
    names = [f"press-{i}" for i in range(100)]
    for name in names:
        store.import_run(Run(f"{name}-run", {}, np.arange(2.0), {"top_1": np.ones(2)}), name, text)
    asked: list[str] = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *given: asked.append(given[2]))
    counts = []
    for _ in range(2):
        asked.clear()
        for name in names:
            press_now(store, name, text, START)
        counts.append(sum("fit.fit_json" in statement for statement in asked))
    assert counts == [100, 0]
