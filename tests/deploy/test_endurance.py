"""A short version of the endurance run: every kind of fault at least once, and nothing unaccounted for.

The quick tests hold what counts to account: the plant's clock, the idle press, the values a fault explains, and
a small store whose balance is sound until something in it is changed.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta

import pytest

from daq.drivers.polled import FOUND_AGAIN_S
from daq.records import Channel, PressEvent, PressEventKind, PressState, Quality, Scan
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from daq.store import NewRun, RunEnd, StoredEstimate, open_store
from tests.deploy.balance import take_balance
from tests.deploy.endurance import FAULTS, LOWER, UPPER, Endurance, Pace, Plan
from tests.deploy.truth import KILLED, RESTARTED, Fault, PacedPress, PlantClock, Record, Shift, Truth


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_after_every_kind_of_fault_nothing_is_unaccounted_for(tmp_path):
    plan = Plan(3, 9, Pace(15.0, 1.0), Pace(120.0, 0.5), day_s=3600.0)
    plant = Endurance(tmp_path, plan, seed=3)
    balance = plant.run()
    text = "\n".join(balance.lines)
    print("\n" + text)
    assert {fault.kind for fault in plant.faults} == {*FAULTS, RESTARTED}
    assert {what: count for what, count in balance.unaccounted.items() if count} == {}, text
    assert balance.sound, text


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


# --- a small recorded store, sound and then changed -----------------------------------------------------

COLUMNS = (*UPPER, *LOWER)
LOST = Fault("logger lost", 9.95, 13.95, LOWER)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the folder of two pressings as they are stored: scans of 100 ms, 10 s of the press each second."""
    folder = tmp_path_factory.mktemp("recorded")
    kept = Record(4, [(20.0, 2)], [(0.0, 0.0, 10.0)], [Shift(0, 10.0, 1.0)], [LOST], 0, 36.0)
    kept.write(folder / "truth.json")
    truth = kept.truth()
    begin = datetime(2026, 3, 4, tzinfo=UTC)
    scans, cores = [], []
    for n in range(360):
        gave, lost = truth.temperatures(float(n)), 100 <= n < 140
        values = [math.nan if lost and name in LOWER else gave[name] for name in COLUMNS]
        qualities = [Quality.GOOD if value == value else Quality.MISSING for value in values]
        scans.append(Scan(n, begin + timedelta(seconds=0.1 * n), float(n), tuple(values), tuple(qualities)))
        cores.append(truth.core(float(n)))
    with open_store(str(folder / "plant.sqlite")) as store:
        key = store.register_press("lab", [Channel(name) for name in COLUMNS])
        store.log("info", "record", "press lab: scans begin", "lab", {"monotonic_s": 0.0})
        store.append_scans(key, scans)
        for number, true in truth.pressings.items():
            first, last = int(true.inserted_s) - 5, int(true.removed_s) + 3
            store.append_scans(key, [], begin=NewRun(f"r{number}", first, scans[first].utc, float(first)))
            for kind in PressEventKind:
                at_s = getattr(true, f"{kind.value}_s")
                store.append_scans(key, scans[int(at_s) + 2 : int(at_s) + 3], [PressEvent(kind, at_s, at_s + 2.0)])
            store.append_scans(key, [], end=RunEnd(f"r{number}", last, scans[last].utc))
            store.append_estimates("lab", [estimate(n, cores[n], true) for n in range(first, last + 1)])
            coefficients = {name: {"value": value} for name, value in BASE_COEFFICIENTS.items()}
            store.put_fit(f"r{number}", {"fingerprint": "f", "rmse_K": 0.3, "coefficients": coefficients})
    return folder


def estimate(number, core, true):
    inside = true.inserted_s <= number < true.removed_s
    state = PressState.CLOSED if true.closed_s <= number < true.opened_s else PressState.OPEN
    reason = "" if inside else "no panel in the press"
    band = core, 0.5, core - 1.0, core + 1.0
    return StoredEstimate(number, float(number), state if inside else PressState.IDLE, *band, inside, reason)


def changed(recorded, folder, change):
    """Take the balance of the recorded store after some SQL, or what a function does to it."""
    source, copy = (sqlite3.connect(place / "plant.sqlite") for place in (recorded, folder))
    with closing(source), closing(copy):
        source.backup(copy)
        change(copy) if callable(change) else copy.execute(change)
        copy.commit()
    with open_store(str(folder / "plant.sqlite")) as store:
        return take_balance(store, Record.read(recorded / "truth.json").truth())


def lose(first, count):
    """Return what takes scans away and counts on without a hole, in all tables."""

    def change(copy):
        copy.execute("delete from estimate where number between ? and ?", (first, first + count - 1))
        copy.execute("delete from scan where number between ? and ?", (first, first + count - 1))
        places = ("scan.number", "estimate.number", "press_event.scan_number", "run.first_scan", "run.last_scan")
        for table, column in (place.split(".") for place in places):
            copy.execute(f"update {table} set {column} = -{column} where {column} > ?", (first,))
            copy.execute(f"update {table} set {column} = -{column} - ? where {column} < 0", (count,))

    return change


def go_on_with_the_last_values(copy):
    """Store a lost logger's last values as good ones."""
    (last,) = copy.execute("select readings from scan where number = 99").fetchone()
    copy.execute("update scan set readings = ?, faults = null where faults is not null", (last,))


def all_late(copy):
    copy.execute("update scan set faults = ?", (json.dumps(dict.fromkeys(COLUMNS, "late")),))


CHANGES = {
    "scans lost after a start": ("scans", lose(3, 6)),
    "scans lost before an end": ("scans", lose(345, 6)),
    "scans lost in between": ("scans", lose(300, 1)),
    "all values the same": ("good values right", f"update scan set readings = '{[20.0] * 16}'"),
    "a lost logger's last values": ("good values right", go_on_with_the_last_values),
    "all values late": ("values", all_late),
    "events deleted": ("press events", "delete from press_event"),
    "one event deleted": ("press events", "delete from press_event where press_event_id = 3"),
    "events moved": ("press events of no pressing", "update press_event set monotonic_s = monotonic_s - 15"),
    "closings moved": ("moments of runs", "update run set closed_s = closed_s + 60, opened_s = opened_s + 60"),
    "coefficients deleted": ("coefficients", "delete from coefficient"),
    "fits emptied": ("fits", """update fit set fit_json = '{"fingerprint": 1}'"""),
    "estimates deleted": ("estimates of runs", "delete from estimate where number % 10 = 3"),
    "estimates without a core": ("estimates right", "update estimate set core_celsius = null, valid = 0"),
    "estimates far off": ("estimates right", "update estimate set core_celsius = core_high_celsius + 50"),
    "bands of any width": (
        "estimates right",
        "update estimate set core_celsius = 300, core_low_celsius = 0, core_high_celsius = 400",
    ),
    "estimates of another state": ("estimates right", "update estimate set state = 'idle'"),
    "a state called unknown beside whole scans": (
        "estimates right",
        "update estimate set state = 'unknown', valid = 0, reason = 'platen reading missing'",
    ),
    "runs refused": (
        "estimates right",
        "update estimate set state = 'unknown', valid = 0, reason = 'run refused', core_celsius = null",
    ),
    "said to be no panel": (
        "estimates right",
        "update estimate set state = 'idle', valid = 0, reason = 'no panel in the press'",
    ),
}


def test_the_recorded_store_leaves_nothing_unaccounted_for(recorded, tmp_path):
    balance = changed(recorded, tmp_path, "select 1")
    assert not any(balance.unaccounted.values()), balance.lines
    assert any("due 2, there 2," in line and line.startswith("pressings") for line in balance.lines), balance.lines


@pytest.mark.parametrize("name", CHANGES)
def test_the_balance_sees_what_was_changed_in_a_store(recorded, tmp_path, name):
    line, change = CHANGES[name]
    balance = changed(recorded, tmp_path, change)
    assert balance.unaccounted[line] != 0, balance.lines
