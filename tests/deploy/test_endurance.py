"""A short version of the endurance run: every kind of fault at least once, and nothing unaccounted for.

The quick tests hold what counts to account: the plant's clock, the idle press, the values a fault explains.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta

import pytest

from daq.records import Channel, Quality, Scan
from daq.store import open_store
from tests.deploy.balance import RESTARTED, Fault, Shift, Truth, take_balance
from tests.deploy.endurance import FAULTS, Endurance, Pace, PacedPress, Plan, PlantClock


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
    assert all(share < 0.2 for share in balance.grown_share.values()), told


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


@pytest.mark.parametrize(
    ("dead_since_s", "column", "missing"), [(101.14, "bottom_1", 0), (103.3, "bottom_1", 2), (101.14, "top_1", 2)]
)
def test_a_value_is_a_dead_sensors_only_if_its_scan_may_hold_a_spoiled_answer(
    tmp_path, dead_since_s, column, missing
):
    """The scan of a busy machine is stamped before the moment its sensor died: 0.04 s before it here."""
    truth = Truth(
        "lab",
        [Shift(0, 10.0, 1.0)],
        lambda real_s: real_s * 10.0,
        [Fault("sensor dead", dead_since_s, 103.4, (column,))],
        {},
        0,
    )
    begin = datetime(2026, 3, 4, tzinfo=UTC)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        key = store.register_press("lab", [Channel(name) for name in ("platen_top", "top_1", "bottom_1")])
        for n in range(40):
            good, last = Quality.GOOD, Quality.UNDER if n in (11, 12) else Quality.GOOD
            at_s = 100.0 + 0.1 * n
            scan = Scan(n, begin + timedelta(seconds=at_s), 10.0 * at_s, (20.0,) * 3, (good, good, last))
            store.append_scans(key, [scan])
        balance = take_balance(store, truth)
    assert balance.unaccounted["values"] == missing, balance.lines
    assert balance.unaccounted["scans"] == 0, balance.lines
