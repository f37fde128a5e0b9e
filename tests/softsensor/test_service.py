"""The sense process on a store that fills as a recorder would fill it."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from api.answers.records import estimate_now
from daq.drivers.settings import LoggerSettings
from daq.press.events import PressEventDetector
from daq.press.press_file import parse_press
from daq.press.resin_file import parse_resin
from daq.process.config import PressSettings
from daq.recording.run_keeper import RunKeeper, RunNames, RunRules
from daq.records import Channel, PressState, Quality, Run, Scan
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import NewRun, RunEnd, RunStatus, StoreUnavailable, open_store, results
from daq.supervision import RESTART_S
from daq.words.message import words
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.jobs.fitter import Fitter
from softsensor.jobs.guarded import Guarded
from softsensor.jobs.model_in_force import PRESS_FILE, combined_model, up_to_date
from softsensor.jobs.press_follower import Follower
from softsensor.jobs.run_fits import RunFits
from softsensor.jobs.stored_estimates import details_of
from softsensor.live.sensor import ScanSensor
from softsensor.live.validity import InvalidReason
from tests.daq.test_kills import is_zombie
from tests.daq.test_store_unreadable import tear
from tests.patience import wait_until
from tests.softsensor.test_night import configured

PRESS = parse_press(press_toml())
PLAN = Plan(
    rate_hz=2.0, thickness_mm=16.0, start_before_s=8.0, closed_column=False,
    press_time_s=(30.0, 40.0), open_before_s=(6.0, 8.0), open_after_s=(25.0, 30.0),
)  # fmt: skip
BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def fitter():
    with Fitter() as made:
        yield made


@pytest.fixture
def store(tmp_path):
    with open_store(str(tmp_path / "kerntemp.sqlite")) as opened:
        yield opened


@pytest.fixture(scope="module")
def pressing():
    """One pressing, and the panel taken away after it."""
    ((run, truth),) = make_campaign(41, 1, None, PLAN)
    count = 24
    tail = run.time_s[-1] + 0.5 * np.arange(1, count + 1)
    cold = {
        n: np.full(count, v[~np.isnan(v)][-1] if n.startswith("platen") else 24.0) for n, v in run.columns.items()
    }
    columns = {n: np.concatenate([v, cold[n]]) for n, v in run.columns.items()}
    return replace(run, time_s=np.concatenate([run.time_s, tail]), columns=columns), truth


class Recorder:
    """Puts a run into a store scan by scan, as the recorder does."""

    def __init__(self, store, run, header=None, press="lab"):
        self.store, self.run = store, run
        self.names = tuple(run.columns)
        self.key = store.register_press(press, [Channel(n) for n in self.names], "press")
        self.detector = PressEventDetector(PRESS)
        header = {k: v for k, v in run.header.items() if k != "run"} if header is None else header
        rules = RunRules(press, 5.0, 3.0, 3600.0, header)
        places = [i for i, n in enumerate(self.names) if n.startswith(("top", "bottom"))]
        self.keeper = RunKeeper(rules, RunNames(press, store.unused_run_name(press, BEGAN)), places)
        self.done = 0

    def put(self, count):
        for i in range(self.done, min(self.done + count, len(self.run.time_s))):
            at = float(self.run.time_s[i])
            values = tuple(float(self.run.columns[n][i]) for n in self.names)
            quality = tuple(Quality.GOOD if v == v else Quality.MISSING for v in values)
            scan = Scan(self.key.next_number + i, BEGAN + timedelta(seconds=at), 100.0 + at, values, quality)
            events = self.detector.update(scan.monotonic_s, dict(zip(self.names, values, strict=True)))
            changes = self.keeper.take(scan, events) or [(None, None)]
            for begin, end in changes[:-1]:
                self.store.append_scans(self.key, [], [], begin, end)
            self.store.append_scans(self.key, [scan], events, *changes[-1])
        self.done = min(self.done + count, len(self.run.time_s))

    @property
    def finished(self):
        return self.done >= len(self.run.time_s)


def follower(store, fitter):
    logger = LoggerSettings.model_validate(
        {"name": "x", "profile": "m-7018", "host": "h", "channels": ["platen_top", "platen_bottom"]}
    )
    return Follower(
        store,
        PressSettings(name="lab", file="press.toml", logger=(logger,)),
        PRESS,
        RunFits(store, "lab", PRESS, fitter),
    )


def drain(sense):
    now = time.monotonic()
    while sense.step(now):
        now += 1.0  # looks for runs and models every time
    sense.step(now + 2.0)


def fitted(store, sense, run):
    """Wait for the fit of a whole run, whatever the sensor's own store refuses."""

    def marked():
        with suppress(StoreUnavailable):
            drain(sense)
        return "fingerprint" in (store.fit(run) or {})

    wait_until(marked, f"no fit of {run}")


def follow(store, fitter, recorder, chunk=20, restart_at=None):
    sense = follower(store, fitter)
    while not recorder.finished:
        recorder.put(chunk)
        drain(sense)
        if restart_at is not None and recorder.done >= restart_at:
            sense, restart_at = follower(store, fitter), None
            drain(sense)
    return sense


def estimate_rows(store):
    record = store.runs().items[0]
    return [
        (t, str(e.state), e.core_celsius, e.core_low_celsius, e.core_high_celsius, e.valid)
        for t, e in store.estimates(record.run)
    ]


def test_every_scan_of_a_pressing_gets_its_estimate_and_the_pressing_its_fit(store, fitter, pressing):
    run, truth = pressing
    recorder = Recorder(store, run)
    sense = follow(store, fitter, recorder)
    record = store.runs().items[0]
    rows = estimate_rows(store)
    assert len(rows) == record.last_scan - record.first_scan + 1
    shift = float(run.time_s[np.searchsorted(run.time_s, record.zero_monotonic_s - 100.0 - 1e-6)])
    errors = [
        core - np.interp(t + shift, run.time_s[: len(truth.core_C)], truth.core_C)
        for t, state, core, *_, valid in rows
        if valid and state == str(PressState.CLOSED)
    ]
    assert len(errors) > 40
    assert np.sqrt(np.mean(np.square(errors))) < 1.0
    wait_until(lambda: drain(sense) or store.fit(record.run))
    fit = store.fit(record.run)
    assert set(fit["coefficients"]) == set(PRESS.coefficient_names)
    assert fit["model_version"] == PRESS_FILE
    drain(sense)
    assert sense.model.version == f"{PRESS_FILE}+1"


def test_a_pressing_is_refitted_when_the_press_opens_not_only_when_the_panel_is_gone(store, fitter, pressing):
    recorder = Recorder(store, pressing[0])
    sense = follower(store, fitter)
    while not recorder.finished:
        recorder.put(2)
        drain(sense)
        record = store.open_run("lab")
        if record is not None and np.isfinite(record.moments.opened_s):
            break
    run = store.open_run("lab").run
    wait_until(lambda: drain(sense) or store.fit(run))
    assert store.fit(run)["coefficients"]["h_pp_c"]["value"] > 0.0
    assert store.open_run("lab").run == run
    assert "fingerprint" not in store.fit(run)  # the night or the run's end looks at all of it


def test_a_fit_of_the_opening_that_comes_once_the_run_is_over_is_not_taken_for_one_of_the_whole_run(
    store, fitter, pressing
):
    recorder = Recorder(store, pressing[0])
    sense = follower(store, fitter)
    while (record := store.open_run("lab")) is None or not np.isfinite(record.moments.opened_s):
        recorder.put(2)
        drain(sense)
    recorder.put(len(pressing[0].time_s))  # on a busy machine the sensor is behind
    assert store.run_record(record.run).status is not RunStatus.OPEN
    wait_until(lambda: sense.fits.collect("", None))
    assert "fingerprint" not in store.fit(record.run)
    fitted(store, sense, record.run)


def test_an_estimate_carries_what_is_inside_and_what_lies_ahead(store, fitter, pressing):
    header = dict(pressing[0].header) | {"setting.core_target_C": 40.0}
    recorder = Recorder(store, pressing[0], {k: v for k, v in header.items() if k != "run"})
    sense = follower(store, fitter)
    while recorder.done < 80:
        recorder.put(5)
        drain(sense)
    detail = store.estimates_after("lab", store.newest_estimate_number("lab") - 1)[-1].detail
    assert len(detail["profile_C"]) == 11
    assert detail["energy_kJ_m2"] > 100.0
    assert detail["target_earliest_s"] <= detail["target_in_s"] <= detail["target_latest_s"]
    assert 0.0 <= detail["open_in_s"] <= detail["target_in_s"]


def test_an_estimate_with_a_resin_says_cure_and_leave_to_open_and_the_api_hands_it_on(store, fitter, pressing):
    recorder = Recorder(store, pressing[0], {k: v for k, v in pressing[0].header.items() if k != "run"})
    sense = follower(store, fitter)
    limits = "[limits]\ncure_least = 0.3\n[grades]\nmatt_from = 0.2\nglossy_from = 0.99\n"
    law = "[order]\nrate_per_s = 0.05\nactivation_energy_kJ_mol = 85.0\n"
    sense.resin = parse_resin(f'[resin]\nname = "x"\nsource = "test"\n{law}{limits}')
    while recorder.done < 80:
        recorder.put(5)
        drain(sense)
    estimates = store.estimates_after("lab", 0)
    closed = [e for e in estimates if e.valid and e.state == "closed"]
    assert 0.0 <= closed[0].detail["cure_low"] <= closed[-1].detail["cure_low"] <= closed[-1].detail["cure_top"]
    assert not any(e.detail["open_now"] for e in estimates if e.detail and "open_now" in e.detail and not e.valid)
    leave = next(e for e in closed if e.detail["open_now"])
    assert (closed[0].detail["grade"], leave.detail["grade"]) == ("undercured", "matt")
    assert estimate_now(leave, None, BEGAN, BEGAN).grade == "matt"
    assert estimate_now(leave, store.open_run("lab"), BEGAN, BEGAN).advice.verdict == "open_now"
    silent = replace(leave, valid=False, reason=InvalidReason.LIVE_SENSOR_SILENT.value)
    assert estimate_now(leave, None, BEGAN, BEGAN).open_now
    assert not estimate_now(leave, None, BEGAN, BEGAN + timedelta(seconds=6)).open_now
    assert not estimate_now(silent, None, BEGAN, BEGAN).open_now


def test_a_resin_file_counts_as_it_stands_when_a_pressing_begins(store, fitter, pressing, tmp_path):
    """Limits that were made stricter hold from the next panel on; a file half written leaves those there were."""
    file, sense = tmp_path / "resin.toml", follower(store, fitter)
    law = '[resin]\nname = "x"\nsource = "test"\n[order]\nrate_per_s = 0.05\nactivation_energy_kJ_mol = 85.0\n'
    sense.settings = sense.settings.model_copy(update={"resin": file})
    taken = []
    for limit in ("0.3", "0.9", "90.0"):
        file.write_text(f"{law}[limits]\ncure_least = {limit}\n", encoding="utf-8")
        recorder = Recorder(store, pressing[0], {k: v for k, v in pressing[0].header.items() if k != "run"})
        while not recorder.finished:
            recorder.put(40)
            drain(sense)
            file.write_text(f"{law}[limits]\ncure_least = 0.5\n", encoding="utf-8")  # amid a pressing
            taken += [sense.resin.limits.cure_least] if sense.live is not None else []
            file.write_text(f"{law}[limits]\ncure_least = {limit}\n", encoding="utf-8")
    assert list(dict.fromkeys(taken)) == [0.3, 0.9]
    told = [str(entry.message) for entry in store.journal(level="alarm").items]
    assert any("cure_least = 90" in text and "last readable content" in text for text in told)


def test_beside_a_core_that_is_not_valid_nothing_is_foreseen(pressing):
    run, _ = pressing
    wrong = {"panel.initial_temperature_C": run.header["panel.initial_temperature_C"] + 20.0}
    sensor = ScanSensor(PRESS, dict(run.header) | wrong | {"setting.core_target_C": 60.0})
    foreseen = []
    for i, t in enumerate(run.time_s[:60].tolist()):
        estimate = sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
        sensor.look_ahead()
        if estimate.state is PressState.CLOSED:
            foreseen.append(
                (estimate.valid, set(details_of(sensor, estimate)) - {"suspected", "reason_arguments"})
            )
    assert len(foreseen) > 20
    assert np.isfinite(sensor.forecast.target_in_s)  # it was worked out, of an estimate that cannot be
    assert all(not valid and not beside for valid, beside in foreseen)


def test_a_restart_in_mid_press_agrees_with_the_uninterrupted_estimate(tmp_path, fitter, pressing):
    answers = []
    for name, restart in (("whole", None), ("restarted", 60)):
        with open_store(str(tmp_path / f"{name}.sqlite")) as store:
            recorder = Recorder(store, pressing[0])
            recorder.run = replace(
                recorder.run,
                time_s=recorder.run.time_s[:100],
                columns={n: v[:100] for n, v in recorder.run.columns.items()},
            )
            follow(store, fitter, recorder, restart_at=restart)
            answers.append(repr(estimate_rows(store)))
    assert answers[0] == answers[1]


def test_a_promoted_model_is_taken_without_restart(store, fitter, pressing):
    recorder = Recorder(store, pressing[0])
    sense = follower(store, fitter)
    recorder.put(40)
    drain(sense)
    known = {n: FittedValue(PRESS.coefficient(n).guess, 50.0) for n in PRESS.coefficient_names}
    model = ModelFile("lab-7", "lab", known, (("edge_loss", {"W_m3K": FittedValue(900.0, 100.0)}),))
    store.put_model("lab", "lab-7", model.as_json())
    store.promote_model("lab-7", "test")
    recorder.put(40)
    drain(sense)
    recorder.put(1)
    drain(sense)
    versions = [e.model_version for _, e in store.estimates(store.runs().items[0].run)]
    assert versions[-1] == "lab-7"
    assert versions[0] == ""


def test_looking_for_a_new_model_takes_no_longer_however_many_fits_of_other_presses_are_stored(store, fitter):
    sense = follower(store, fitter)
    steps = []
    connection = store.database.engine.connect()
    connection.connection.dbapi_connection.set_progress_handler(lambda: steps.append(1), 10)
    connection.close()  # the pool hands it out again
    taken = []
    for first, last in ((0, 5), (5, 600)):
        runs = [Run(f"other-{i}", {}, np.arange(2.0), {"top_1": np.ones(2)}) for i in range(first, last)]
        store.import_runs(runs, "other")
        with store.database.writing() as connection:
            for run in runs:
                results.put_fit(connection, run.name, {"coefficients": {}})
        sense.model.refresh()
        steps.clear()
        sense.model.refresh()
        taken.append(len(steps))
    assert 0 < taken[1] <= taken[0] + 2


def test_what_the_operator_writes_down_counts_at_once(store, fitter, pressing):
    run = pressing[0]
    partial = {k: v for k, v in run.header.items() if k != "run" and not k.startswith("panel.")}
    recorder = Recorder(store, run, partial)
    sense = follower(store, fitter)
    recorder.put(40)
    drain(sense)
    assert "panel.thickness_mm" in str(sense.problem)
    name = store.runs().items[0].run
    store.annotate_run(name, {k: v for k, v in run.header.items() if k.startswith("panel.")}, "operator")
    recorder.put(10)
    drain(sense)
    assert sense.problem is None
    assert all(e.valid for t, e in store.estimates(name)[3:])


def departures_journalled(store):
    messages = [entry.message for entry in store.journal().items if entry.message.code == "channel-departs"]
    return [(one.arguments["column"], one.arguments["kelvin"]) for one in messages]


def test_a_sensor_that_falls_off_in_the_closed_press_is_told_once(store, fitter, pressing):
    run, truth = pressing
    columns = {name: values.copy() for name, values in run.columns.items()}
    columns["bottom_3"][run.time_s > truth.moments.closed_s + 12.0] -= 70.0
    follow(store, fitter, Recorder(store, replace(run, columns=columns)))
    ((column, kelvin),) = departures_journalled(store)
    assert column == "bottom_3"
    assert kelvin == pytest.approx(70.0, abs=5.0)


def test_sensors_that_come_off_one_by_one_with_the_panel_are_not_called_faulty(store, fitter, pressing):
    run, truth = pressing
    columns = {name: values.copy() for name, values in run.columns.items()}
    rest = run.time_s > run.time_s[-25] - 8.0  # removed at the 24th scan from the end
    assert run.time_s[rest][0] > truth.moments.opened_s + 4.0
    for column in ("bottom_3", "top_5"):
        columns[column][rest] = np.minimum(columns[column][rest], 45.0)
    follow(store, fitter, Recorder(store, replace(run, columns=columns)))
    assert departures_journalled(store) == []


def test_channels_read_one_after_another_while_the_press_closes_are_not_called_faulty(store, fitter, pressing):
    run, truth = pressing
    columns = {name: values.copy() for name, values in run.columns.items()}
    closing = np.abs(run.time_s - truth.moments.closed_s) < 1.5
    columns["bottom_6"][closing] += 15.0
    follow(store, fitter, Recorder(store, replace(run, columns=columns)))
    assert departures_journalled(store) == []


def test_between_pressings_the_state_is_idle(store, fitter, pressing):
    recorder = Recorder(store, pressing[0])
    recorder.put(10)
    sense = follower(store, fitter)
    drain(sense)
    recorder.put(3)
    drain(sense)
    idle = store.estimates_after("lab", -1)
    assert [(str(e.state), e.valid) for e in idle] == [("idle", False)] * len(idle)
    assert len(idle) >= 1


def fit_entry(value, sd=10.0):
    return {"coefficients": {"h_pp_c": {"value": value, "sd": sd, "identifiable": True}}}


def test_runs_bring_the_coefficients_up_to_date():
    fresh = up_to_date(PRESS, None, [fit_entry(v) for v in (400.0, 410.0, 390.0, 405.0)])
    assert fresh.coefficients["h_pp_c"].value == pytest.approx(400.0, rel=0.05)
    base = ModelFile("m", "lab", {"h_pp_c": FittedValue(700.0, 70.0)})
    mixed = up_to_date(PRESS, base, [fit_entry(400.0)] * 4)
    assert 480.0 < mixed.coefficients["h_pp_c"].value < 620.0
    assert mixed.version == "m+4"
    assert up_to_date(PRESS, None, []) is None


def test_a_fit_that_knows_nothing_changes_nothing():
    unknown = {"coefficients": {"h_pp_c": {"value": 5.0, "sd": 50.0, "identifiable": False}}}
    base = ModelFile("m", "lab", {"h_pp_c": FittedValue(700.0, 70.0)})
    assert combined_model(PRESS, base, [unknown]).coefficients == base.coefficients


class _Moody:
    """A store that refuses some of what is written, as one does that another process holds."""

    def __init__(self, store):
        self._store, self.refusals, self._asked = store, 0, 0

    def __getattr__(self, name):
        return getattr(self._store, name)

    def append_estimates(self, press, estimates):
        self._now_and_then()
        self._store.append_estimates(press, estimates)

    def put_fit(self, run, fit, model_version):
        self._now_and_then()
        self._store.put_fit(run, fit, model_version)

    def load_run(self, run):
        self._now_and_then()
        return self._store.load_run(run)

    def _now_and_then(self):
        self._asked += 1
        if self._asked % 3 == 2:
            self.refusals += 1
            raise StoreUnavailable("store: database is locked")


def test_a_store_that_refuses_now_and_then_changes_no_estimate(tmp_path, fitter, pressing):
    run, _ = pressing
    rows_to = []
    for moody in (False, True):
        with open_store(str(tmp_path / f"{moody}.sqlite")) as opened:
            sense = follower(_Moody(opened) if moody else opened, fitter)
            recorder = Recorder(opened, run)
            while not recorder.finished:
                recorder.put(20)
                for _ in range(4):
                    with suppress(StoreUnavailable):
                        drain(sense)
            rows_to.append(estimate_rows(opened))
            if moody:
                assert sense.store.refusals > 3
            fitted(opened, sense, opened.runs().items[0].run)
    assert len(rows_to[0]) > 100
    assert repr(rows_to[1]) == repr(rows_to[0])


def test_a_pressing_that_ended_while_the_process_was_away_gets_all_its_estimates(tmp_path, fitter, pressing):
    run, _ = pressing
    rows_to = []
    for away in (False, True):
        with open_store(str(tmp_path / f"{away}.sqlite")) as opened:
            recorder = Recorder(opened, run)
            sense = follower(opened, fitter)
            while not recorder.finished:
                recorder.put(20)
                if not away or recorder.done <= 60:
                    drain(sense)
            assert opened.open_run("lab") is None
            sense = follower(opened, fitter) if away else sense
            drain(sense)
            record = opened.runs().items[0]
            rows_to.append(estimate_rows(opened)[: record.last_scan - record.first_scan + 1])
            assert len(rows_to[-1]) == record.last_scan - record.first_scan + 1
            wait_until(lambda sense=sense, run=record.run: drain(sense) or opened.fit(run))
    assert repr(rows_to[1]) == repr(rows_to[0])


def test_however_many_pressings_ended_meanwhile_each_scan_of_them_gets_its_estimate(store, fitter, pressing):
    run, _ = pressing
    recorder = Recorder(store, run)
    sense = follower(store, fitter)
    drain(sense)
    recorder.put(2)
    drain(sense)
    pattern = store.scans_after("lab", 0).scans[0]
    header = {name: value for name, value in run.header.items() if name != "run"}
    first, per, count = 2, 8, 30
    for k in range(count):
        numbers = range(first + k * per, first + (k + 1) * per)
        scans = [replace(pattern, number=n, monotonic_s=pattern.monotonic_s + n / 4) for n in numbers]
        begin = NewRun(f"lab-{k}", numbers[1], scans[1].utc, scans[1].monotonic_s, header)
        end = RunEnd(begin.run, numbers[-2], scans[-2].utc, RunStatus.INTERRUPTED)
        store.append_scans(recorder.key, scans, begin=begin, end=end)
    drain(follower(store, fitter))
    bare = [r.run for r in store.runs().items if len(store.estimates(r.run)) != per - 2]
    assert len(store.runs().items) == count
    assert not bare


def test_a_run_that_begins_among_scans_that_came_together_and_ends_meanwhile_keeps_its_estimates(
    store, fitter, pressing
):
    """One run is over, the next one open, and the recorder ends that one while the sensor is at their scans."""
    run, _ = pressing
    recorder = Recorder(store, run)
    sense = follower(store, fitter)
    recorder.put(2)
    drain(sense)
    pattern = store.scans_after("lab", 0).scans[0]
    header = {name: value for name, value in run.header.items() if name != "run"}
    scans = [replace(pattern, number=n, monotonic_s=pattern.monotonic_s + n / 4) for n in range(2, 18)]
    for name, first, last in (("lab-a", 3, 8), ("lab-b", 11, None)):
        begin = NewRun(name, first, scans[first - 2].utc, scans[first - 2].monotonic_s, header)
        end = None if last is None else RunEnd(name, last, scans[last - 2].utc, RunStatus.CLOSED)
        store.append_scans(recorder.key, [s for s in scans if (s.number < 9) == (name == "lab-a")], (), begin, end)
    sense.step(sense._looked)
    assert sense.last == 17
    store.interrupt_open_runs("lab")
    drain(sense)
    assert [len(store.estimates(name)) for name in ("lab-a", "lab-b")] == [6, 7]


def test_a_kill_before_a_pressing_was_caught_up_with_leaves_no_scan_of_it_without_estimate(
    store, fitter, pressing
):
    run, _ = pressing
    recorder = Recorder(store, run)
    recorder.put(40)
    drain(follower(store, fitter))
    record = store.open_run("lab")
    store.interrupt_open_runs("lab")
    with store.database.writing() as connection:
        connection.exec_driver_sql(
            f"DELETE FROM estimate WHERE number IN ({record.first_scan}, {record.first_scan + 1})"
        )
    assert store.last_scan_followed("lab") == record.first_scan - 1
    drain(follower(store, fitter))
    ended = store.run_record(record.run)
    assert len(store.estimates(record.run)) == ended.last_scan - ended.first_scan + 1
    assert store.last_scan_followed("lab") == store.newest_estimate_number("lab")


def test_a_run_that_ends_between_two_questions_keeps_all_its_estimates(tmp_path, store, fitter, pressing):
    class Overtaken:
        """A store in which the recorder writes a run's end just before the open run is asked for."""

        def __init__(self):
            self.armed = False

        def __getattr__(self, name):
            return getattr(store, name)

        def open_run(self, press):
            if self.armed:
                self.armed = False
                recorder.put(1)
            return store.open_run(press)

    run, _ = pressing
    with open_store(str(tmp_path / "rehearsal.sqlite")) as other:
        rehearsal = Recorder(other, run)
        while not other.runs(status=RunStatus.CLOSED).items:
            rehearsal.put(1)
    recorder, overtaken = Recorder(store, run), Overtaken()
    sense = follower(overtaken, fitter)
    for count in (rehearsal.done - 12, 11):  # a removal is noticed scans after the run's last one
        drain(sense)
        recorder.put(count)
        overtaken.armed = count == 11
    sense.step(sense._looked)
    assert not overtaken.armed
    drain(sense)
    (record,) = store.runs().items
    assert record.status is RunStatus.CLOSED
    assert len(store.estimates(record.run)) == record.last_scan - record.first_scan + 1


def test_a_pressing_whose_fit_a_kill_prevented_is_fitted_after_the_restart(store, pressing):
    class Deaf:
        """A worker that never comes to the fit."""

        replaced = frozenset()

        def submit(self, press, run, model):
            return Future()

    run, _ = pressing
    follow(store, Deaf(), Recorder(store, run))
    (record,) = store.runs().items
    assert store.fit(record.run) is None
    assert store.last_scan_followed("lab") >= record.last_scan
    with Fitter() as fitter:
        sense = follower(store, fitter)
        fitted(store, sense, record.run)
    again = follower(store, Deaf())
    drain(again)
    assert not again.fits._under_way, "what is fitted is not fitted anew at each start"


FIT_WORKER = """
import time
from softsensor.jobs.fitter import Fitter
if __name__ == "__main__":
    with Fitter() as fitter:
        fitter.warm_up().result()
        print(*fitter._pool._processes, flush=True)
        time.sleep(600)
"""


def test_a_sensor_that_has_to_compile_first_gives_signs_of_life_meanwhile(tmp_path):
    configured(tmp_path)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "nothing compiled yet")}
    command = [sys.executable, "-m", "api", "sense", "--config", str(tmp_path / "kerntemp.toml")]
    sensing = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
            while (status := store.statuses().get("sense")) is None:
                assert sensing.poll() is None, sensing.stderr.read()
                time.sleep(0.1)
        assert status.status["state"] == "starting"
        assert "compiling the model" in status.status["message"]
    finally:
        sensing.kill()
        sensing.communicate()


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_the_fitting_worker_ends_when_its_process_is_killed(tmp_path):
    script = tmp_path / "worker.py"
    script.write_text(FIT_WORKER)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment
    ) as one:
        worker = int(one.stdout.readline())
        assert not is_zombie(worker)
        os.kill(one.pid, signal.SIGKILL)
    wait_until(lambda: is_zombie(worker))


@pytest.mark.parametrize("compiled", [True, False])
def test_the_fits_worker_lets_the_live_sensor_begin_first_unless_it_has_to_compile(monkeypatch, compiled):
    begun = []
    monkeypatch.setattr("softsensor.jobs.fitter.kept", lambda _: compiled)
    monkeypatch.setattr("softsensor.jobs.fitter.BEHIND_S", 3600.0)
    monkeypatch.setattr(Fitter, "warm_up", lambda _: begun.append(True))
    with Fitter() as fitter:
        fitter.warm_up_behind()
    assert fitter._later.finished.is_set()  # nothing comes after the sensor has ended
    assert begun == ([] if compiled else [True])


def test_the_fits_worker_begins_in_a_while_where_fits_are_sent(monkeypatch):
    """Two threads that met a lost worker would each replace it."""
    begun = []
    monkeypatch.setattr("softsensor.jobs.fitter.kept", lambda _: True)
    monkeypatch.setattr("softsensor.jobs.fitter.BEHIND_S", 0.0)
    monkeypatch.setattr(Fitter, "warm_up", lambda _: begun.append(threading.current_thread().name))
    with Fitter() as fitter:
        fitter.warm_up_behind()
        wait_until(lambda: begun)
    assert begun[0].startswith("fits")


def kill_here():
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_a_worker_that_is_killed_while_it_helps_to_compile_is_replaced():
    with Fitter() as fitter:
        with pytest.raises(BrokenProcessPool):
            fitter._pool.submit(kill_here).result(60.0)
        assert fitter.warm_up().result(60.0) is None


class Poison:
    """A model that really kills each worker it comes to."""

    def __reduce__(self):
        return kill_here, ()


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_a_fit_whose_worker_is_killed_is_made_by_another(store, pressing):
    run, _ = pressing
    with Fitter() as fitter:
        fitter.warm_up().result()
        (worker,) = fitter._pool._processes
        os.kill(worker, signal.SIGSTOP)  # so that the kill finds the fit under way
        sense = follow(store, fitter, Recorder(store, run))
        assert sense.fits._under_way
        os.kill(worker, signal.SIGKILL)
        (record,) = store.runs().items
        fitted(store, sense, record.run)
    assert "run-fit-killed" not in [entry.message.code for entry in store.journal().items]
    (line,) = [entry for entry in store.journal().items if entry.message.code == "run-fit-again"]
    assert (line.level, line.process, line.press) == ("warning", "sense", "lab")
    assert line.message.arguments["run"] == record.run


@pytest.mark.skipif(os.name == "nt", reason="SIGSTOP is POSIX")
def test_a_worker_that_stands_still_is_ended_and_the_fit_given_to_another(pressing, monkeypatch):
    run, _ = pressing
    with Fitter() as fitter:
        fitter.warm_up()
        (stopped,) = fitter._pool._processes
        os.kill(stopped, signal.SIGSTOP)
        monkeypatch.setattr("softsensor.jobs.fitter.LONGEST_S", 0.2)  # too short for the second to start, too
        asked = fitter.submit(parse_press(press_toml()), run, None)
        with pytest.raises(BrokenProcessPool):
            asked.result(60.0)
        assert fitter.replaced == {run.name}
        wait_until(lambda: is_zombie(stopped))
        assert stopped not in fitter._pool._processes


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_a_fit_that_kills_every_worker_ends_in_an_alarm_and_the_live_sensor_goes_on(store, pressing):
    run, _ = pressing
    store.import_run(replace(run, name="poisonous"), "lab", press_toml())
    with Fitter() as fitter:
        sense = follower(store, fitter)
        sense.last = -1
        sense.fits.submit("poisonous", Poison())
        recorder = Recorder(store, run)
        while not recorder.finished:
            recorder.put(20)
            drain(sense)
        (record,) = [r for r in store.runs().items if r.kind != "imported"]
        fitted(store, sense, record.run)
        assert len(store.estimates(record.run)) > 100
    (alarm,) = [entry for entry in store.journal(level="alarm").items]
    assert (alarm.message.code, alarm.message.arguments["run"]) == ("run-fit-killed", "poisonous")


def guarded_lab(store, fitter):
    fits = RunFits(store, "lab", PRESS, fitter)
    return Guarded(lambda: replace(follower(store, fitter), fits=fits))


def follow_guarded(guarded, recorder, until=None, chunk=20, now=0.0):
    """Let a guarded press follow a run; each fault has time to be tried again."""
    while not recorder.finished and (until is None or recorder.done < until):
        recorder.put(chunk)
        for _ in range(20):
            now += 1.0 + RESTART_S
            guarded.step(now)
    return now


def alarms(store):
    return [words(entry.message) for entry in store.journal(level="alarm", limit=500).items]


OUR_FAULT = "press lab: unexpected fault (ZeroDivisionError: a fault of ours); please report it"
POISONED = 60
"""A scan of the pressing, in the closed press."""


@pytest.fixture
def breaking(monkeypatch, pressing):
    """Where the sensor breaks: at one scan; at all from it on where it was begun before; nowhere."""
    update, where, at = ScanSensor.update, {"scan": POISONED, "for_good": False}, []

    def breaks(sensor, time_s, values):
        begun = vars(sensor).setdefault("begun", time_s)
        reached = where["scan"] is not None and values["top_1"] == pressing[0].columns["top_1"][where["scan"]]
        at.extend([time_s] if reached and not at else [])
        if reached or (where["for_good"] and at and begun < at[0] <= time_s):
            raise ZeroDivisionError("a fault of ours")
        return update(sensor, time_s, values)

    monkeypatch.setattr(ScanSensor, "update", breaks)
    return where


def test_a_fault_of_one_presss_sensor_is_told_once_and_it_begins_anew(store, fitter, pressing, breaking):
    recorder, guarded = Recorder(store, pressing[0]), guarded_lab(store, fitter)
    recorder.put(POISONED + 2)
    guarded.step(0.0)
    guarded.step(0.5 * RESTART_S)
    assert words(guarded.problem) == OUR_FAULT
    breaking["scan"] = None
    follow_guarded(guarded, recorder, now=1.0)
    assert alarms(store) == [OUR_FAULT]
    assert guarded.problem is None
    record = store.runs().items[0]
    assert len(estimate_rows(store)) == record.last_scan - record.first_scan + 1
    assert all(reason != InvalidReason.CALCULATION_FAILED for reason in reasons(store, record.run))


def reasons(store, run):
    return [estimate.reason for _, estimate in store.estimates(run)]


def followed_through_a_fault(store, fitter, run, taken):
    """Let a guarded press follow a run in which its sensor fails; return the run's record."""
    recorder, guarded = Recorder(store, run), guarded_lab(store, fitter)
    now = follow_guarded(guarded, recorder, POISONED + 60)
    assert guarded.problem is None, "while the run is still open"
    assert taken("lab") == store.newest_scan_number("lab")
    follow_guarded(guarded, recorder, now=now)
    assert alarms(store) == [OUR_FAULT]
    return store.runs().items[0]


def test_a_scan_at_which_the_sensor_always_fails_costs_its_own_estimate_alone(store, fitter, pressing, breaking):
    record = followed_through_a_fault(store, fitter, pressing[0], store.last_scan_followed)
    assert len(estimate_rows(store)) == record.last_scan - record.first_scan + 1
    assert reasons(store, record.run).count(InvalidReason.CALCULATION_FAILED) == 2, "two read the same"
    assert sum(state == str(PressState.CLOSED) and valid for _, state, *_, valid in estimate_rows(store)) > 40


def test_a_sensor_that_fails_at_every_scan_from_one_on_begins_with_those_that_come(
    store, fitter, pressing, breaking
):
    breaking["for_good"] = True
    run, truth = pressing
    record = followed_through_a_fault(store, fitter, run, store.newest_estimate_number)
    assert len(estimate_rows(store)) > record.last_scan - record.first_scan - 40
    late = [row for row in estimate_rows(store) if row[0] > run.time_s[POISONED + 20]]
    assert len(late) > 40
    for t, state, _, low, high, valid in late:
        core = np.interp(t, run.time_s[: len(truth.core_C)], truth.core_C)
        assert not valid or state == str(PressState.IDLE) or low < core < high, "it has not seen the panel come"


class Sometimes:
    """A store that is away for what is named, while it is."""

    def __init__(self, store):
        self.store, self.away = store, set()

    def __getattr__(self, name):
        if name in self.away:
            raise StoreUnavailable("away")
        return getattr(self.store, name)


def test_a_fault_while_the_store_is_away_is_told_when_it_is_back(store, fitter, pressing, breaking):
    sometimes = Sometimes(store)
    recorder, guarded = Recorder(store, pressing[0]), guarded_lab(sometimes, fitter)
    recorder.put(POISONED + 2)
    sometimes.away = {"log"}
    for now in (0.0, 10.0):
        with suppress(StoreUnavailable):
            guarded.step(now)
    assert alarms(store) == []
    breaking["scan"], sometimes.away = None, set()
    follow_guarded(guarded, recorder, now=100.0)
    assert alarms(store) == [OUR_FAULT]


def test_what_the_store_refuses_a_press_alone_is_an_alarm_unless_it_passes(store, fitter, pressing):
    sometimes = Sometimes(store)
    recorder, guarded = Recorder(store, pressing[0]), guarded_lab(sometimes, fitter)
    recorder.put(POISONED)
    for away, now, wanted in (({"scans_after"}, 0.0, 0), (set(), 10.0, 0), ({"scans_after"}, 20.0, 0)):
        sometimes.away = away
        assert _stepped_at(guarded, now) == bool(away)
        assert len(alarms(store)) == wanted
    for now in (30.0, 40.0):
        assert _stepped_at(guarded, now)
        assert alarms(store) == ["away"]
        assert words(guarded.problem) == "away"
    sometimes.away = set()
    assert not _stepped_at(guarded, 50.0)
    assert guarded.problem is None


def _stepped_at(guarded, now):
    """Let a guarded press work, as `sense` does; return whether the store kept something from it."""
    try:
        guarded.step(now)
    except StoreUnavailable:
        guarded.report_kept()
        return True
    return False


def test_no_scan_goes_through_the_sensor_twice_because_the_journal_was_away(store, fitter, pressing, monkeypatch):
    run, _ = pressing
    update, newest, twice = ScanSensor.update, {}, []

    def taking(sensor, time_s, values):
        if newest.get(sensor, -1e9) >= time_s:
            twice.append(time_s)
        newest[sensor] = time_s
        return update(sensor, time_s, values)

    monkeypatch.setattr(ScanSensor, "update", taking)
    loose = run.columns["top_1"].copy()
    loose[POISONED:] -= 60.0
    sometimes = Sometimes(store)
    recorder = Recorder(store, replace(run, columns=run.columns | {"top_1": loose}))
    guarded = guarded_lab(sometimes, fitter)
    now = 0.0
    while not recorder.finished:
        recorder.put(5)
        sometimes.away = {"log"} if recorder.done < POISONED + 60 else set()
        for _ in range(5):
            now += 1.0
            with suppress(StoreUnavailable):
                guarded.step(now)
    codes = [entry.message.code for entry in store.journal(level="warning").items]
    assert codes.count("channel-departs") == 1
    assert not twice


def test_a_model_in_force_that_cannot_be_taken_costs_no_estimate_and_is_told_once(store, fitter, pressing):
    recorder, guarded = Recorder(store, pressing[0]), guarded_lab(store, fitter)
    store.put_model("lab", "from-later", {"version": "from-later", "effects": [{"name": "not known yet"}]})
    store.promote_model("from-later", "test")
    now = follow_guarded(guarded, recorder, POISONED)
    assert len(estimate_rows(store)) > POISONED // 2
    assert guarded.problem.code == "sense-model-not-taken"
    assert [entry.message.code for entry in store.journal(level="alarm").items] == ["sense-model-not-taken"]
    sound = ModelFile("sound", "lab", {n: FittedValue(c.guess, 1.0) for n, c in PRESS.coefficients.items()})
    store.put_model("lab", "sound", sound.as_json())
    store.promote_model("sound", "test")
    guarded.step(now + 10.0)
    assert guarded.problem is None
    assert guarded.follower.model.version == "sound"


class Asked:
    """A worker that is asked for fits and never ends one."""

    def __init__(self):
        self.runs, self.replaced = [], frozenset()

    def submit(self, press, run, model):
        self.runs.append(run.name)
        return Future()


def test_a_fit_under_way_is_not_made_a_second_time_when_the_sensor_begins_anew(store, pressing):
    follow(store, Asked(), Recorder(store, pressing[0]))
    (record,) = store.runs().items
    asked = Asked()
    guarded = guarded_lab(store, asked)
    guarded.step(0.0)
    assert asked.runs == [record.run], "it was left by a process that was killed"
    guarded._failed(ZeroDivisionError("a fault of ours"))
    for now in (1e6, 2e6):
        guarded.step(now)
    assert asked.runs == [record.run]
    assert not guarded.follower.fits._due


def test_a_run_that_cannot_be_read_has_no_fit_which_is_told_once_and_the_sensor_goes_on(store, pressing):
    asked = Asked()
    guarded = guarded_lab(store, asked)
    recorder = Recorder(store, pressing[0])
    follow_guarded(guarded, recorder, POISONED + 20)
    poison(store, store.open_run("lab").first_scan + POISONED)
    follow_guarded(guarded, recorder, now=1e6)
    assert not asked.runs
    messages = store.journal(level="alarm").items
    assert {entry.message.code for entry in messages} == {"run-not-fitted"}
    assert len(messages) <= 2, "as the press opens, and as the panel has left"
    assert store.newest_estimate_number("lab") >= store.newest_scan_number("lab") - 1
    again = guarded_lab(store, asked)
    again.step(1e7)
    assert len(store.journal(level="alarm").items) == len(messages)


def test_the_sensor_says_nothing_of_a_panel_whose_header_is_damaged_and_goes_on_with_the_next(store, pressing):
    guarded = guarded_lab(store, Asked())
    recorder = Recorder(store, pressing[0])
    follow_guarded(guarded, recorder, POISONED)
    run = store.open_run("lab").run
    with store.database.writing() as connection:
        connection.exec_driver_sql(f"UPDATE run SET header_toml = 'x = = 1' WHERE run = '{run}'")
    follow_guarded(guarded, recorder, POISONED + 40, now=1e6)
    assert guarded.problem.code == "of-run"
    assert f"run {run}: its header is damaged in store" in str(guarded.problem)
    warned = [str(entry.message) for entry in store.journal(level="warning").items]
    assert warned == [str(guarded.problem)]  # once, not at every scan
    newest = store.estimates_after("lab", store.newest_estimate_number("lab") - 1)[-1]
    assert (newest.valid, newest.reason) == (False, InvalidReason.RUN_REFUSED.value)
    follow_guarded(guarded, recorder, now=2e6)
    assert store.open_run("lab") is None
    assert guarded.fault is None
    assert {entry.message.code for entry in store.journal(level="alarm").items} == {"run-not-fitted"}
    follow_guarded(guarded, Recorder(store, pressing[0]), POISONED, now=3e6)
    assert guarded.problem is None
    newest = store.estimates_after("lab", store.newest_estimate_number("lab") - 1)[-1]
    assert (newest.state, newest.reason) == (PressState.CLOSED, "")


def poison(store, number):
    """Damage what is stored of a scan, so that nobody can read it."""
    with store.database.writing() as connection:
        connection.exec_driver_sql(f"UPDATE scan SET readings = '[1' WHERE number = {number}")


POISON = """CREATE TRIGGER poison AFTER INSERT ON scan WHEN NEW.number = {number} BEGIN
UPDATE scan SET readings = '[1' WHERE number = NEW.number; END"""


@pytest.mark.parametrize("begun", [False, True], ids=["running", "begun"])
def test_the_real_process_passes_over_a_scan_that_cannot_be_read(tmp_path, pressing, begun):
    configured(tmp_path)
    command = [sys.executable, "-m", "api", "sense", "--config", str(tmp_path / "kerntemp.toml")]
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        recorder = Recorder(store, pressing[0])
        recorder.put(40)
        bad = store.newest_scan_number("lab") + (0 if begun else 1)
        if begun:
            poison(store, bad)
        else:
            with store.database.writing() as connection:
                connection.exec_driver_sql(POISON.format(number=bad))
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as sensing:
            try:
                wait_until(lambda: alarms(store) if begun else store.newest_estimate_number("lab") == bad - 1)
                while not recorder.finished and store.newest_estimate_number("lab") <= bad:
                    recorder.put(1)
                    time.sleep(0.2)
                assert store.open_run("lab"), "while the run is still open"
                wait_until(lambda: "Error" not in store.statuses()["sense"].status["message"], 60.0)
                [message] = [entry.message for entry in store.journal(level="alarm").items]
                assert message.arguments["what"].code == "store-scan-damaged"
                assert message.arguments["what"].arguments["scan"] == bad
            finally:
                sensing.terminate()
                sensing.communicate()
            assert sensing.returncode == 0


def test_newest_scans_on_a_torn_page_keep_the_sensor_from_their_press_alone(tmp_path, fitter, pressing):
    path = tmp_path / "kerntemp.sqlite"
    configured(tmp_path)
    config = tmp_path / "kerntemp.toml"
    text = config.read_text(encoding="utf-8")
    config.write_text(text + text[text.index("[[press]]") :].replace('"lab"', '"north"'), encoding="utf-8")
    with open_store(str(path)) as store:
        north, lab = (Recorder(store, pressing[0], press=press) for press in ("north", "lab"))
        north.put(40)
        lab.put(40)
        drain(follower(store, fitter))
        lab.put(40)
        with store.database.reading() as connection:
            newest = "SELECT readings FROM scan ORDER BY press_id DESC, number DESC LIMIT 1"
            readings = connection.exec_driver_sql(newest).scalar_one()
    tear(path, readings.encode())
    command = [sys.executable, "-m", "api", "sense", "--config", str(config)]
    with (
        open_store(str(path)) as store,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as sensing,
    ):
        north.store = store
        try:
            wait_until(lambda: store.newest_estimate_number("north") >= 0)
            north.put(len(pressing[0].time_s))
            record = store.runs(press="north").items[0]
            wait_until(lambda: store.newest_estimate_number("north") >= record.last_scan)
            named = "press lab: scan "
            wait_until(lambda: any(one.startswith(named) for one in alarms(store)), lambda: alarms(store))
            [problem] = store.statuses()["sense"].status["problems"]
            [alarm] = [one for one in alarms(store) if one.startswith(named)]
            assert alarm in problem
            assert "kerntemp backup --restore" in alarm
        finally:
            sensing.terminate()
    assert sensing.returncode == 0
