"""A short version of the endurance run: every kind of fault at least once, and nothing unaccounted for.

The quick tests hold what counts to account: the plant's clock, the idle press, the values a fault explains.
"""

from __future__ import annotations

import math
import os
from datetime import UTC, datetime, timedelta

import pytest

from daq.drivers.polled import FOUND_AGAIN_S
from daq.records import Channel, Quality, Scan
from daq.store import open_store
from tests.deploy.balance import take_balance
from tests.deploy.endurance import FAULTS, Endurance, Pace, Plan
from tests.deploy.truth import KILLED, RESTARTED, Fault, PacedPress, PlantClock, Shift, Truth


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_after_every_kind_of_fault_nothing_is_unaccounted_for(tmp_path):
    plan = Plan(3, 9, Pace(15.0, 1.0), Pace(120.0, 0.5), day_s=3600.0)
    plant = Endurance(tmp_path, plan, seed=3)
    balance = plant.run()
    told = "\n".join(balance.lines)
    print("\n" + told)
    assert {fault.kind for fault in plant.faults} == {*FAULTS, RESTARTED}
    assert {what: count for what, count in balance.unaccounted.items() if count} == {}, told
    assert balance.sound, told


def test_the_plants_clock_changes_its_pace_and_never_jumps(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    clock = PlantClock()
    assert clock() == 0.0
    clock.run(20.0)
    now[0] = 110.0
    clock.run(600.0)
    assert clock() == pytest.approx(200.0)
    now[0] = 111.0
    assert clock() == pytest.approx(800.0)
    assert clock.at(105.0) == pytest.approx(100.0)
    assert clock.at(110.0) == pytest.approx(200.0)


def test_the_press_stands_idle_after_the_panels_asked_for_and_goes_on_where_it_stood():
    press = PacedPress(seed=4)
    press.go_on(50.0, 2)
    evening = [press.temperatures(at)["top_1"] for at in range(50, 1000)]
    assert press.idle
    assert sorted(press.pressed) == [1, 2]
    assert max(evening[: int(press.pressed[2].removed_s) - 50]) > 90.0
    night = [press.temperatures(float(at))["top_1"] for at in range(1000, 40_000, 10)]
    assert max(night) - min(night) < 15.0
    press.go_on(40_000.0, 1)
    assert abs(press.temperatures(40_000.0)["top_1"] - night[-1]) < 15.0
    morning = [press.temperatures(float(at))["top_1"] for at in range(40_000, 40_400)]
    assert max(morning) > 90.0
    assert press.idle
    assert 40_000.0 < press.pressed[3].closed_s < 40_100.0


def plant(faults, ended_s):
    """Return the truth of a press of ten times real speed that stands at 20 °C, without a panel."""
    still = dict.fromkeys(("platen_top", "top_1", "bottom_1"), 20.0)
    clock, shifts = PlantClock([(0.0, 0.0, 10.0)]), [Shift(0, 10.0, 1.0)]
    return Truth("lab", shifts, clock.at, faults, {}, 0, ended_s, lambda at_s: still, lambda at_s: math.nan)


def balance_of(tmp_path, fault, missing, scans=80):
    """Count scans of 100 ms, 10 s of the press each second, in which `bottom_1` has no value at some times. [s]"""
    truth = plant([fault], 100.0)
    begin = datetime(2026, 3, 4, tzinfo=UTC)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", [Channel(name) for name in ("platen_top", "top_1", "bottom_1")])
        for n in range(scans):
            at_s = 100.0 + 0.1 * n
            why = next((quality for quality, since, until in missing if since <= at_s <= until), Quality.GOOD)
            at = begin + timedelta(seconds=at_s)
            qualities = (Quality.GOOD, Quality.GOOD, why)
            store.append_scans(key, [Scan(n, at, 10.0 * at_s, (20.0,) * 3, qualities)])
        return take_balance(store, truth)


@pytest.mark.parametrize(
    ("dead_since_s", "column", "missing"), [(101.14, "bottom_1", 0), (103.3, "bottom_1", 2), (101.14, "top_1", 2)]
)
def test_a_value_is_a_dead_sensors_only_if_its_scan_may_hold_a_spoiled_answer(
    tmp_path, dead_since_s, column, missing
):
    """The scan of a busy machine is stamped before the moment its sensor died: 0.04 s before it here."""
    fault = Fault("sensor dead", dead_since_s, 103.4, (column,))
    balance = balance_of(tmp_path, fault, [(Quality.UNDER, 101.05, 101.25)])
    assert balance.unaccounted["values"] == missing, balance.lines
    assert balance.unaccounted["scans"] == 0, balance.lines


@pytest.mark.parametrize(
    ("missing", "column", "unaccounted"),
    [
        ([(100.95, 102.05 + FOUND_AGAIN_S - 0.1)], "bottom_1", 0),
        ([(100.95, 102.05 + FOUND_AGAIN_S + 0.2)], "bottom_1", 2),
        ([(100.95, 103.0), (104.0, 104.05)], "bottom_1", 1),
        ([(100.95, 102.05)], "top_1", 11),
    ],
    ids=["as long as the driver promises", "longer", "lost once more after it was found", "the other logger's"],
)
def test_a_lost_logger_explains_a_value_until_its_driver_has_found_it_again_but_no_longer_than_it_promises(
    tmp_path, missing, column, unaccounted
):
    fault = Fault("logger lost", 100.97, 102.05, (column,))
    balance = balance_of(tmp_path, fault, [(Quality.MISSING, *span) for span in missing])
    assert balance.unaccounted["values"] == unaccounted, balance.lines


@pytest.mark.parametrize(
    ("faults", "until_s", "unaccounted"),
    [
        ([Fault(KILLED, 110.0, 112.2)], 108.05, 0),
        ([Fault(KILLED, 110.0, 112.2)], 105.0, 30),
        ([Fault("store away", 97.0, 108.0), Fault(KILLED, 110.0, 112.2)], 95.05, 0),
        ([Fault("store away", 85.0, 96.0), Fault(KILLED, 110.0, 112.2)], 105.0, 30),
        ([Fault(RESTARTED, 110.0, 112.2)], 109.8, 0),
        ([Fault(RESTARTED, 110.0, 112.2)], 109.0, 8),
        ([], 109.8, 23),
    ],
)
def test_scans_that_were_due_before_the_recorder_went_are_its_own_loss(tmp_path, faults, until_s, unaccounted):
    """Scans of 100 ms from 90 s to a moment, then from a new recorder on, which comes 2.3 s after 110 s."""
    balance = taken(tmp_path, plant(faults, 115.0), [(90.0, until_s), (112.3, 115.0)])
    assert balance.unaccounted["scans"] == pytest.approx(unaccounted, abs=1 if unaccounted else 0), balance.lines


def test_scans_that_stop_while_the_recorder_is_at_work_are_unaccounted_for(tmp_path):
    assert taken(tmp_path, plant([], 120.0), [(90.0, 115.0)]).unaccounted["scans"] == pytest.approx(48, abs=1)


def taken(folder, truth, sessions):
    begin = datetime(2026, 3, 4, tzinfo=UTC)
    scans: list[Scan] = []
    with open_store(str(folder / "s.sqlite")) as store:
        key = store.register_press("lab", [Channel(name) for name in ("platen_top", "top_1", "bottom_1")])
        for since_s, until_s in sessions:
            store.log("info", "record", "press lab: scans begin", "lab", {"monotonic_s": round(10.0 * since_s, 6)})
            for n in range(int((until_s - since_s) / 0.1 + 1e-6) + 1):
                at_s = since_s + 0.1 * n
                utc, stamp = begin + timedelta(seconds=at_s), round(10.0 * at_s, 6)
                scans.append(Scan(len(scans), utc, stamp, (20.0,) * 3, (Quality.GOOD,) * 3))
        store.append_scans(key, scans)
        return take_balance(store, truth)
