"""The recorder against simulated loggers on real sockets and serial lines, and killed while it works."""

import errno
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
import tomllib
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daq.drivers import open_logger
from daq.files.run_file import toml_value
from daq.process.config import load_config
from daq.recording import press_line
from daq.recording.config_watch import ConfigWatch
from daq.recording.press_line import PressLine, Shared
from daq.recording.recorder import _status, record
from daq.records import Quality
from daq.simulated.campaign import press_toml
from daq.simulated.devices import simulated, wiring
from daq.simulated.devices_converter import Switches
from daq.simulated.press import VirtualPress, VirtualPressSettings
from daq.store import RunStatus, open_store
from daq.store.outbox import Outbox
from daq.store.write_batch import Entry
from daq.words import say
from tests.patience import wait_until

UPPER = ("platen_top", "platen_bottom", *(f"top_{i}" for i in range(1, 8)))
LOWER = tuple(f"bottom_{i}" for i in range(1, 8))
QUICK = VirtualPressSettings(between_s=(12.0, 16.0), press_time_s=(25.0, 30.0), open_after_s=(12.0, 16.0), keep=40)


class Plant:
    """A virtual press with two loggers, and the configuration of its recorder."""

    def __init__(self, folder: Path, speed: float, rate_hz: float) -> None:
        self.folder, self.speed, self.rate_hz = folder, speed, rate_hz
        self.press = VirtualPress(QUICK, 3)
        self.press.cycle(0.0)  # solved before the clock runs
        self.began = time.monotonic()
        self.lower = Switches()
        self.url = str(folder / "plant.sqlite")
        self.config = folder / "kerntemp.toml"

    def clock(self) -> float:
        return (time.monotonic() - self.began) * self.speed

    def inputs(self, columns):
        def temperatures(now_s):
            shown = self.press.temperatures(max(now_s, 0.0))
            return [shown[name] for name in columns] + [20.0] * (16 - len(columns))

        return temperatures

    def write(self, *tables, store=None):
        (self.folder / "lab.toml").write_text(press_toml())
        text = f"[store]\nurl = {toml_value(store or self.url)}\n[clock]\nspeed = {self.speed}\n"
        text += f'[[press]]\nname = "lab"\nfile = "lab.toml"\nrate_hz = {self.rate_hz}\n'
        text += 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }\n'
        for table in tables:
            text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
        self.config.write_text(text)


@contextmanager
def plant(folder, speed=1.0, rate_hz=10.0, store=None):
    made = Plant(folder, speed, rate_hz)
    upper = simulated("labjack-t7", made.inputs(UPPER), clock=made.clock, refresh_s=0.0)
    lower = simulated(
        "adam-4118-ascii",
        lambda s: made.inputs(LOWER)(s)[:8],
        clock=made.clock,
        refresh_s=0.1,
        switches=made.lower,
    )
    with upper as a, lower as b:
        made.write(
            wiring("labjack-t7", a, "upper", UPPER), wiring("adam-4118-ascii", b, "lower", LOWER), store=store
        )
        yield made


@contextmanager
def recording(made):
    stop, failures = threading.Event(), []

    def work():
        try:
            record(load_config(made.config), stop=stop)
        except BaseException as error:
            failures.append(error)
            raise

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(240)
    assert not failures
    assert not thread.is_alive()


def logger_threads():
    return {thread for thread in threading.enumerate() if thread.name.startswith("logger ")}


def test_pressings_are_recorded_as_runs_with_their_moments_and_start_temperature(tmp_path):
    speed = 10.0
    with plant(tmp_path, speed=speed, rate_hz=2.0) as made, open_store(made.url) as store:
        with recording(made):
            wait_until(lambda: len(store.runs(status=RunStatus.CLOSED).items) >= 2)
        runs = store.runs(status=RunStatus.CLOSED).items[:2]
        for record_ in runs:
            unread_s = np.diff(store.load_run(record_.run).time_s).max()  # while a busy machine reads nothing
            near = 1.0 + max(0.2 * speed, unread_s)
            zero = record_.zero_monotonic_s - made.began * made.speed
            true = made.press.cycle(zero + record_.moments.closed_s).moments
            assert zero + record_.moments.closed_s == pytest.approx(true.closed_s, abs=near)
            assert zero + record_.moments.opened_s == pytest.approx(true.opened_s, abs=near)
            assert zero == pytest.approx(true.inserted_s - 5.0, abs=6.0)
            assert record_.header["panel.material"] == "MDF"
            assert record_.header["panel.initial_temperature_C"] == pytest.approx(made.press.ambient, abs=4.0)
            assert store.configuration_of(record_.run) == made.config.read_text()
            run = store.load_run(record_.run)
            assert np.all(np.diff(run.time_s) > 0)
            assert 0.475 < np.median(np.diff(run.time_s)) < 1.0  # a busy machine misses some
            assert np.isfinite(run.columns["top_3"]).mean() > 0.9
        assert {q for scan in all_scans(store) for q in scan.qualities} <= {Quality.GOOD, Quality.LATE}
        kinds = [e.kind for e in store.press_events("lab")]
        assert kinds[:4] == ["inserted", "closed", "opened", "removed"]
        left = store.runs(status=RunStatus.INTERRUPTED).items
        assert len(left) == len(store.runs().items) - len(store.runs(status=RunStatus.CLOSED).items)
        assert store.statuses()["record"].status["state"] == "stopped"


def test_a_pressure_channel_and_a_stuck_switch_go_before_the_temperatures_and_disagreement_is_journalled(tmp_path):
    speed, stuck = 10.0, threading.Event()

    def wires(now_s):
        at = max(now_s, 0.0)
        m = made.press.cycle(at).moments
        closed = m.closed_s + 3.0 <= at < m.opened_s + 3.0
        return [0.0 if stuck.is_set() else 90.0 * closed, 0.0] + [20.0] * 14

    with plant(tmp_path, speed=speed, rate_hz=2.0) as made, open_store(made.url) as store:
        with simulated("generic", wires, clock=made.clock, refresh_s=0.0) as server:
            table = wiring("generic", server, "wires", ("bar",))
            press = made.folder / "lab.toml"
            made.config.write_text(
                made.config.read_text()
                + "[[press.logger]]\n"
                + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
            )
            pressure = 'pressure = { column = "bar", closed_above = 20.0, unit = "bar" }\n'
            press.write_text(press.read_text().replace("[press]\n", "[press]\n" + pressure))
            with recording(made):
                wait_until(lambda: len(store.runs(status=RunStatus.CLOSED).items) >= 1)
                stuck.set()
                wait_until(lambda: store.journal(press="lab", level="warning").items)
                newest = store.newest_scan_number("lab")
                wait_until(lambda: store.newest_scan_number("lab") > newest + 30)  # in which nothing is said again
        kept = store.runs(status=RunStatus.CLOSED).items[-1]
        run = store.load_run(kept.run)
        events = store.press_events("lab")
        messages = [str(e.message) for e in store.journal(press="lab", level="warning").items]
    assert [(e.kind, e.source) for e in events[1:3]] == [
        ("closed", "pressure channel"),
        ("opened", "pressure channel"),
    ]
    assert messages == ["press lab: the pressure channel reports open, but the upper face is hot; check it"]
    pressed, closed = run.columns["bar"] > 20.0, run.columns["closed"]
    assert {0.0, 1.0} == set(closed[np.isfinite(closed)])
    assert np.array_equal(closed[np.isfinite(closed)] > 0.5, pressed[np.isfinite(closed)])
    assert kept.moments.closed_s == pytest.approx(run.time_s[np.nanargmax(closed)], abs=0.01)


def test_a_calibration_file_that_is_made_while_recording_is_taken_over(tmp_path):
    with plant(tmp_path, rate_hz=5.0) as made, open_store(made.url) as store:
        named = made.config.read_text().replace('name = "upper"', 'name = "upper"\ncalibration = "upper.toml"')
        made.config.write_text(named)

        def platen():
            return store.scans_after("lab", store.newest_scan_number("lab") - 1).scans[-1].values[0]

        with recording(made):
            wait_until(lambda: store.newest_scan_number("lab") > 5)
            before = platen()
            entry = '[[calibration]]\nchannel = "platen_top"\ndate = 2026-01-01\noffset_K = -40.0\n'
            (tmp_path / "upper.toml").write_text(entry)
            wait_until(lambda: abs(platen() - before + 40.0) < 5.0)
        (warning,) = store.journal(press="lab", level="warning").items
    assert str(warning.message).startswith("press lab: logger upper: values are not corrected, ")


def test_a_silent_logger_is_said_once_leaves_gaps_with_cause_and_does_not_disturb_the_other(tmp_path):
    with plant(tmp_path, rate_hz=10.0) as made, open_store(made.url) as store:
        with recording(made):
            wait_until(lambda: store.newest_scan_number("lab") > 10)
            made.lower.silent = True
            wait_until(lambda: any("does not answer" in str(e.message) for e in store.journal().items))
            first = store.newest_scan_number("lab")
            wait_until(lambda: store.newest_scan_number("lab") > first + 20)
            status = store.statuses()["record"].status
            made.lower.silent = False
            wait_until(lambda: any("answers again" in str(e.message) for e in store.journal().items))
            last = store.newest_scan_number("lab")
        batch = store.scans_after("lab", first, 20)
        names = [c.name for c in batch.channels]
        qualities = [dict(zip(names, scan.qualities, strict=True)) for scan in batch.scans]
        assert {q["bottom_1"] for q in qualities} == {"missing"}
        # A busy machine answers one scan late; a logger that waits 0.3 s for the other would be late in most.
        assert {q["top_1"] for q in qualities} <= {"good", "late"}
        assert sum(q["top_1"] == "good" for q in qualities) >= 0.75 * len(qualities)
        gaps = np.diff([s.monotonic_s for s in batch.scans])
        assert np.median(gaps) == pytest.approx(0.1, abs=0.02)
        assert any("lower" in problem for problem in status["problems"])
        assert [r["state"] for r in status["loggers"]] == ["answers", "lost"]
        warnings = [e for e in store.journal(level="warning").items if "logger lower" in str(e.message)]
        assert len(warnings) == 1
        assert last > first + 20


@pytest.mark.skipif(os.name == "nt", reason="SIGSTOP is POSIX")
def test_scans_left_out_stand_in_the_journal_with_their_place(tmp_path):
    with plant(tmp_path, rate_hz=10.0) as made, open_store(made.url) as store:
        command = [sys.executable, "-m", "daq.recording.recorder", str(made.config)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as recorder:
            wait_until(lambda: store.newest_scan_number("lab") > 10)
            recorder.send_signal(signal.SIGSTOP)
            time.sleep(3.5)
            recorder.send_signal(signal.SIGCONT)
            number = store.newest_scan_number("lab")
            wait_until(lambda: store.newest_scan_number("lab") > number + 20)
            recorder.terminate()
        scans = all_scans(store)
        (problem,) = store.statuses()["record"].status["problems"]
        messages = {
            str(e.message).partition(": ")[2]: e for e in store.journal(limit=100).items if e.press == "lab"
        }
        (begin,) = [e for what, e in messages.items() if what == "scans begin"]
        pairs = [
            pair for what, e in messages.items() if "left out" in what for pair in e.detail["before_monotonic_s"]
        ]
    assert begin.detail == {"monotonic_s": scans[0].monotonic_s, "period_s": 0.1}
    assert set(at for at, _ in pairs) <= {s.monotonic_s for s in scans}
    due = round((scans[-1].monotonic_s - scans[0].monotonic_s) / 0.1) + 1
    assert sum(count for _, count in pairs) >= 30
    assert re.fullmatch(r"lab: \d\d scans left out in the last minute, this machine is too busy", problem)
    assert len(scans) + sum(count for _, count in pairs) == pytest.approx(due, abs=1)


def test_scans_that_wait_though_the_store_is_there_are_a_problem(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        outbox = Outbox(store)
        for waiting, problems in ((1000, []), (1001, ["1001 scans wait to be written, this machine is too busy"])):
            while outbox.waiting < waiting:
                outbox.put(Entry("info", "record", say("plain-text", text="hello")))
            assert _status([], outbox, "running")["problems"] == problems


def all_scans(store):
    scans, last = [], -1
    while batch := store.scans_after("lab", last, 5000).scans:
        scans += batch
        last = scans[-1].number
    return scans


def test_a_changed_configuration_is_taken_over_between_runs_without_losing_a_scan(tmp_path):
    with plant(tmp_path, speed=10.0, rate_hz=1.0) as made, open_store(made.url) as store:
        with recording(made):
            wait_until(lambda: store.open_run("lab") is not None)
            under_way, readers = store.open_run("lab").run, logger_threads()
            text = made.config.read_text()
            made.config.write_text(text.replace("speed = 10.0", "speed = 5.0"))
            wait_until(
                lambda: any("restart kerntemp record to apply it" in str(e.message) for e in store.journal().items)
            )
            made.config.write_text(text.replace("rate_hz = 1.0", "rate_hz = 99"))
            wait_until(lambda: any("rate_hz" in str(e.message) for e in store.journal().items))
            changed = text.replace('"MDF"', '"OSB"').replace("rate_hz = 1.0", "rate_hz = 2.0")
            made.config.write_text(changed.replace('"bottom_7"', '""'))
            wait_until(lambda: any("takes effect between runs" in str(e.message) for e in store.journal().items))
            assert not any("is in force" in str(e.message) for e in store.journal().items)
            wait_until(lambda: (now := store.open_run("lab")) is not None and now.run != under_way)
            later, readers_since = store.open_run("lab").run, logger_threads()
            wait_until(lambda: store.run_record(later).status is not RunStatus.OPEN)
        (stays,) = readers & readers_since  # the other logger has begun anew
        assert stays.name.endswith("upper")
        runs = {r.run: r.header["panel.material"] for r in store.runs().items}
        before, after = store.load_run(under_way), store.load_run(later)
        assert runs.pop(under_way) == "MDF"
        assert set(runs.values()) == {"OSB"}
        assert "bottom_7" in before.columns
        begins_s = 5.0 + 5.0  # the scans before its insertion may be older than the change
        lost = after.columns.get("bottom_7", np.full(len(after.time_s), np.nan))
        assert np.isnan(lost[after.time_s > begins_s]).all()
        assert np.median(np.diff(before.time_s)) == pytest.approx(1.0, rel=0.1)
        assert np.median(np.diff(after.time_s)) == pytest.approx(0.5, rel=0.1)
        assert np.isfinite(after.columns["bottom_6"][-20:]).any()  # the logger has begun anew
        scans = all_scans(store)
        assert [s.number for s in scans] == list(range(len(scans)))
        change = next(i for i, s in enumerate(scans) if len(s.values) == 15)
        kept = {s.qualities[0] for s in scans[change - 5 : change + 5]}
        assert kept <= {Quality.GOOD, Quality.LATE}, "the logger that stays noticed the change"


def test_a_recorder_started_while_the_press_is_closed_says_that_this_pressing_makes_no_run(tmp_path):
    with plant(tmp_path) as made, open_store(made.url) as store:
        made.press = VirtualPress(replace(QUICK, press_time_s=(3600.0, 3600.0)), 3)
        made.began -= made.press.cycle(0.0).moments.closed_s + 20.0
        with recording(made):
            wait_until(lambda: "scans-begin-late" in [e.message.code for e in store.journal(limit=100).items])
        [late] = [e for e in store.journal(limit=100).items if e.message.code == "scans-begin-late"]
        assert (late.level, late.press) == ("warning", "lab")
        assert "this pressing" in str(late.message) or "that pressing" in str(late.message)
        assert store.runs().items == ()
        assert store.press_events("lab") == []
        assert len(store.scans_after("lab", -1, 100).scans) > 10


class SettableClock(datetime):
    """The wall clock as the recorder sees it, set to another hour by somebody."""

    set_by = timedelta(0)

    @classmethod
    def now(cls, tz=None):
        return datetime.now(tz) + cls.set_by


class LineAtWork:
    """A press that takes a changed configuration over, while somebody saves the next change."""

    settings = SimpleNamespace(name="lab")

    def __init__(self, saves):
        self.saves, self.taken = list(saves), []

    def change(self, press, text):
        self.taken.append(text)
        if self.saves:
            path, content = self.saves.pop()
            path.write_text(content, encoding="utf-8")


def test_a_configuration_saved_while_the_one_before_is_taken_over_is_taken_over_next(tmp_path):
    made = Plant(tmp_path, 1.0, 10.0)
    with simulated("labjack-t7", made.inputs(UPPER), clock=made.clock) as a:
        made.write(wiring("labjack-t7", a, "upper", UPPER))
    first = made.config.read_text(encoding="utf-8")
    watch = ConfigWatch(load_config(made.config), lambda level, message, *_: None)
    line = LineAtWork([(made.config, first + "# the second\n")])
    made.config.write_text(first + "# the first\n", encoding="utf-8")
    for _ in range(3):
        watch.look([line])
    assert [text.splitlines()[-1] for text in line.taken] == ["# the first", "# the second"]


def test_a_logger_put_back_while_its_removal_is_taken_over_is_read_again(tmp_path, monkeypatch):
    stop, told = threading.Event(), []
    with plant(tmp_path) as made, open_store(made.url) as store:
        config = load_config(made.config)
        (both,) = config.press
        one = both.model_copy(update={"logger": both.logger[:1]})
        shared = Shared(store, Outbox(store), 1.0, lambda *line, **_: told.append(line[:2]), stop)
        line = PressLine(both, config.text, [open_logger(x) for x in both.logger], shared)
        line.change(one, config.text)
        rules = press_line._rules

        def meanwhile(*given):
            line._take_over()  # as the press's own thread does between two scans
            return rules(*given)

        monkeypatch.setattr(press_line, "_rules", meanwhile)
        line.change(both, config.text)
        assert [x.name for x in line._scanner.loggers] == ["upper"]
        line._take_over()
        stop.set()
        line._scanner.join(10.0)
        assert [x.name for x in line._scanner.loggers] == ["upper", "lower"]
        assert told == 2 * [("info", say("configuration-in-force"))]


@pytest.mark.parametrize("hidden", ["kerntemp.toml", "lab.toml", "upper.toml"])
def test_a_folder_that_cannot_be_read_leaves_the_configuration_as_it_was(tmp_path, monkeypatch, hidden):
    made, messages = Plant(tmp_path, 1.0, 10.0), []
    upper = simulated("labjack-t7", made.inputs(UPPER), clock=made.clock)
    with upper as a:
        wired = wiring("labjack-t7", a, "upper", UPPER) | {"calibration": "upper.toml"}
        made.write(wired)
    (tmp_path / "upper.toml").write_text("")
    watch = ConfigWatch(
        load_config(made.config), lambda level, message, *_: messages.append((level, str(message)))
    )
    watch.look([])
    assert messages == []
    reached = Path.stat, Path.read_text

    def refused(which):
        def ask(path, *args, **options):
            if path.name == hidden:
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return which(path, *args, **options)

        return ask

    with monkeypatch.context() as patched:
        patched.setattr(Path, "stat", refused(reached[0]))
        patched.setattr(Path, "read_text", refused(reached[1]))
        lines = [ReadingLine(tmp_path / hidden)]
        watch.look(lines)
        watch.look(lines)
    ((level, sentence),) = messages
    assert level == "warning"
    assert hidden in sentence
    assert "Permission denied" in sentence
    assert sentence.endswith("recording goes on with the previous configuration")
    watch.look([])
    assert messages[1:] == [("info", "configuration changed; it takes effect between runs")]


class ReadingLine:
    """A press that looks at a file of its own when it takes a configuration over."""

    def __init__(self, file):
        self.file, self.settings = file, SimpleNamespace(name="lab")

    def change(self, *_):
        self.file.read_text()


def test_a_clock_set_back_and_forth_is_journalled_and_costs_no_scan_and_no_order(tmp_path, monkeypatch):
    monkeypatch.setattr("daq.recording.acquisition.datetime", SettableClock)
    with plant(tmp_path) as made, open_store(made.url) as store:
        with recording(made):
            for hours in (-1, 2):
                seen = len(all_scans(store))
                wait_until(lambda seen=seen: len(all_scans(store)) > seen + 10)
                monkeypatch.setattr(SettableClock, "set_by", timedelta(hours=hours))
            seen = len(all_scans(store))
            wait_until(lambda: len(all_scans(store)) > seen + 10)
        messages = [str(e.message) for e in store.journal().items if "clock of this machine" in str(e.message)]
        scans = all_scans(store)
    set_by = sorted(float(m.split("set by ")[1].split(" s")[0]) for m in messages)
    assert set_by == pytest.approx([-3600, 10800], abs=1)
    assert [s.number for s in scans] == list(range(len(scans)))
    monotonic, wall = (np.diff(x) for x in zip(*((s.monotonic_s, s.utc.timestamp()) for s in scans), strict=True))
    assert np.all((monotonic > 0) & (monotonic < 2))
    assert np.count_nonzero(np.abs(wall - monotonic) > 1) == 2


def test_a_calibration_that_changes_is_in_force_between_runs_and_kept_with_them(tmp_path):
    with plant(tmp_path, speed=20.0, rate_hz=2.0) as made, open_store(made.url) as store:
        entry = '[[calibration]]\nchannel = "platen_top"\ndate = 2026-01-0{}\noffset_K = {}\n'
        (tmp_path / "upper.toml").write_text(entry.format(1, "0.0"))
        made.config.write_text(
            made.config.read_text().replace('name = "upper"', 'name = "upper"\ncalibration = "upper.toml"')
        )

        def newest():  # of a busy machine readings of single scans are missing, or of all
            after = store.scans_after("lab", store.newest_scan_number("lab") - 5).scans
            read = [scan.values[0] for scan in after if np.isfinite(scan.values[0])]
            return np.median(read) if read else np.nan

        with recording(made):
            wait_until(lambda: store.newest_scan_number("lab") > 10 and np.isfinite(newest()))
            raw = newest()
            (tmp_path / "upper.toml").write_text(entry.format(1, "0.0") + entry.format(2, "30.0"))
            wait_until(lambda: newest() > raw + 20.0)
            assert any("is in force" in str(e.message) for e in store.journal().items)
            wait_until(lambda: store.open_run("lab") is not None)
            kept = store.configuration_of(store.open_run("lab").run)
        assert "date = 2026-01-02" in kept
        assert "offset_K = 30.0" in kept
        assert tomllib.loads(kept) == tomllib.loads(made.config.read_text())


def start(made, **options):
    command = [sys.executable, "-m", "daq.recording.recorder", str(made.config)]
    where = {"cwd": Path(__file__).parents[2], "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, text=True, **where, **options)


def acknowledged_until_killed(child, wait_s):
    """Let it run for a while after its first commit, kill it, and return the last acknowledged scan."""
    numbers = []

    def listen():
        for line in child.stdout:
            numbers.append(int(line.split()[1]))

    listener = threading.Thread(target=listen)
    listener.start()
    wait_until(lambda: numbers or child.poll() is not None)
    end = time.monotonic() + wait_s
    while time.monotonic() < end:
        time.sleep(0.005)
    child.send_signal(signal.SIGKILL)
    child.wait()
    listener.join()
    child.stdout.close()
    return numbers[-1] if numbers else -1


def check_store_after_kill(url, last_acknowledged):
    with open_store(url) as store:
        numbers = [s.number for s in all_scans(store)]
        last = numbers[-1]
        assert numbers == list(range(len(numbers))), "a scan is missing or doubled"
        assert last >= last_acknowledged, "an acknowledged scan is lost"
        with store.database.reading() as connection:
            if store.database.dialect == "sqlite":
                assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
        return last


def kill_repeatedly(made, times, seed):
    chance = random.Random(seed)
    for _ in range(times):
        child = start(made)
        last = acknowledged_until_killed(child, chance.uniform(0.0, 1.2))
        assert last >= 0
        check_store_after_kill(made.url, last)


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_killed_in_mid_run_the_recorder_loses_nothing_acknowledged_and_resumes(tmp_path):
    with plant(tmp_path, speed=20.0, rate_hz=2.0) as made:
        kill_repeatedly(made, 3, 1)
        with open_store(made.url) as store:
            before = {r.run for r in store.runs().items}
            child = start(made)
            wait_until(lambda: (now := store.open_run("lab")) is not None and now.run not in before)
            run = store.open_run("lab").run
            last = acknowledged_until_killed(child, 0.3)
            assert store.run_record(run).status is RunStatus.OPEN
            child = start(made)
            wait_until(lambda: store.run_record(run).status is RunStatus.INTERRUPTED)
            assert len(store.load_run(run).time_s) > 5
            acknowledged_until_killed(child, 0.2)
            assert any(f"run {run} was interrupted" in str(e.message) for e in store.journal().items)
        check_store_after_kill(made.url, last)


@pytest.mark.skipif(os.name == "nt", reason="SIGTERM is POSIX")
def test_asked_to_end_the_recorder_writes_what_it_has_and_ends_in_order(tmp_path):
    with plant(tmp_path, speed=20.0, rate_hz=2.0) as made, open_store(made.url) as store:
        child = start(made)
        wait_until(lambda: store.open_run("lab") is not None)
        child.send_signal(signal.SIGTERM)
        out, _ = child.communicate(timeout=240)
        assert child.returncode == 0
        acknowledged = [int(line.split()[1]) for line in out.split("\n") if line]
        assert acknowledged[-1] == store.newest_scan_number("lab")
        assert store.open_run("lab") is None
        assert store.runs().items[0].status is RunStatus.INTERRUPTED
        assert store.statuses()["record"].status["state"] == "stopped"


def test_a_recorder_on_postgresql_stores_the_same(tmp_path, postgresql_url):
    with (
        plant(tmp_path, speed=20.0, rate_hz=2.0, store=postgresql_url) as made,
        open_store(postgresql_url) as store,
    ):
        with recording(made):
            wait_until(lambda: len(store.runs(status=RunStatus.CLOSED).items) >= 1)
        run = store.load_run(store.runs(status=RunStatus.CLOSED).items[0].run)
        assert 0.475 < np.median(np.diff(run.time_s)) < 1.0  # a busy machine misses some


def test_a_second_recorder_is_sent_away_and_does_not_disturb_the_first(tmp_path, store_url):
    with plant(tmp_path, speed=20.0, rate_hz=2.0, store=store_url) as made, open_store(store_url) as store:
        with recording(made):
            wait_until(lambda: store.open_run("lab") is not None)
            run = store.open_run("lab").run
            command = [sys.executable, "-m", "daq.recording.recorder", str(made.config)]
            second = subprocess.run(command, capture_output=True, text=True, timeout=240)
            assert second.returncode
            assert "another recorder" in second.stderr.splitlines()[-1]
            assert not second.stdout
            wait_until(lambda: store.run_record(run).status is not RunStatus.OPEN)
            assert store.run_record(run).status is RunStatus.CLOSED
        assert not any("interrupted" in str(e.message) for e in store.journal(limit=500).items)


@pytest.mark.skipif(os.name == "nt", reason="a link needs rights there")
@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_a_second_recorder_that_comes_by_a_link_is_sent_away_too(tmp_path, link):
    with plant(tmp_path, speed=20.0, rate_hz=2.0) as made, recording(made):
        other = tmp_path / "other"
        other.mkdir()
        wait_until(Path(made.url).exists)
        link(other / "linked.sqlite", made.url)
        text = made.config.read_text()
        assert made.url in text
        (tmp_path / "second.toml").write_text(text.replace(made.url, str(other / "linked.sqlite")))
        command = [sys.executable, "-m", "daq.recording.recorder", str(tmp_path / "second.toml")]
        second = subprocess.run(command, capture_output=True, text=True, timeout=240)
        assert second.returncode
        assert "another recorder" in second.stderr.splitlines()[-1]


def test_two_presses_in_one_process_do_not_wait_for_each_other(tmp_path, store_url):
    off = Switches()
    with plant(tmp_path, rate_hz=10.0, store=store_url) as made, open_store(store_url) as store:
        with simulated("labjack-t7", made.inputs(UPPER), clock=made.clock, refresh_s=0.0, switches=off) as server:
            other = wiring("labjack-t7", server, "alone", UPPER)
            text = made.config.read_text() + '[[press]]\nname = "second"\nfile = "lab.toml"\nrate_hz = 5.0\n'
            text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in other.items())
            made.config.write_text(text)
            with recording(made):
                wait_until(lambda: store.newest_scan_number("second") > 5)
                off.silent = True
                wait_until(
                    lambda: any("logger alone does not answer" in str(e.message) for e in store.journal().items)
                )
                before = {press: store.newest_scan_number(press) for press in ("lab", "second")}
                wait_until(lambda: all(store.newest_scan_number(p) > n + 20 for p, n in before.items()))
                status = store.statuses()[store.beats_as("record")].status
        for press, period_s in (("lab", 0.1), ("second", 0.2)):
            apart_s = np.diff([s.monotonic_s for s in store.scans_after(press, before[press], 20).scans])
            assert apart_s.min() < 1.5 * period_s, "some scan waited for nobody; a busy machine leaves others out"
            assert apart_s.mean() > 0.7 * period_s
        assert [(p["press"], p["rate_hz"]) for p in status["presses"]] == [("lab", 10.0), ("second", 5.0)]
        assert [r["state"] for r in status["loggers"]] == ["answers", "answers", "lost"]
        waiting = "memory" if store.database.path else "kerntemp-buffer.sqlite"
        assert waiting in status["room_for_waiting"]
        assert status["room_for_waiting_hours"] > 1.0
