"""Nobody dies unseen: an error at any call in any thread of the recorder is told, and recording goes on."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from daq import supervision
from daq.process.config import load_config
from daq.process.notify import Notifier
from daq.recording import acquisition, press_line, recorder, run_keeper
from daq.store import journal, open_store, outbox, recording, session_placement, store, write_batch
from daq.supervision import SupervisedThread, unexpected
from daq.words import say
from tests.daq.injecting import Injected, Injector
from tests.daq.test_recorder import plant
from tests.daq.test_recorder import recording as recording_by
from tests.patience import wait_until

MODULES = (
    acquisition,
    press_line,
    recorder,
    run_keeper,
    outbox,
    session_placement,
    store,
    write_batch,
    recording,
    journal,
)
PRESSING_S = 10.0
"""In so much time a pressing of the plant begins and ends, on a busy machine, too."""
LONGEST_S = 240.0


def all_numbers(opened):
    numbers, last = [], -1
    while more := opened.scans_after("lab", last, 5000).scans:
        numbers += [scan.number for scan in more]
        last = numbers[-1]
    return numbers


def _reported(call, alarms, before):
    """Whether an error at a call is told: by an alarm of its own, by one before it, or by a driver's gaps."""
    return len(alarms) > before or call[1] in "".join(alarms) or "read" in call[1]


@pytest.mark.campaign
def test_an_error_at_any_call_in_any_thread_is_told_and_recording_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("daq.supervision.RESTART_S", 0.02)
    monkeypatch.setattr(outbox, "_FIRST_RETRY_S", 0.02)
    monkeypatch.setattr(recorder, "BEAT_S", 0.1)
    with plant(tmp_path, speed=20.0, rate_hz=1.0) as made, open_store(made.url) as opened:
        injector = Injector(monkeypatch, MODULES)
        unreported = []

        def alarms():
            return [str(e.message) for e in opened.journal(level="alarm", limit=200).items]

        with recording_by(made):
            wait_until(lambda: opened.runs().items and len(opened.press_events("lab")) >= 4)
            threads = [name for name in injector.seen if name in ("writer", "scans", "logger", "Thread-1")]
            assert {"writer", "scans", "logger"} <= set(threads)
            names = ("writer", "scans", "logger")
            often = [(thread, label) for thread in names for label in sorted(injector.seen[thread])]
            tried, seldom = set(), set()

            def inject(calls, longest_s):
                before = len(alarms())
                if (call := injector.first_called(calls, longest_s)) is None:
                    return None
                newest = opened.newest_scan_number("lab")
                wait_until(lambda: opened.newest_scan_number("lab") > newest + 2)
                at = time.monotonic() + LONGEST_S
                while not (reported := _reported(call, alarms(), before)) and time.monotonic() < at:
                    time.sleep(0.02)
                if not reported:
                    unreported.append(call)
                tried.add(call)
                return call

            for call in often:
                if inject([call], 0.3) is None:
                    seldom.add(call)
            while seldom and (call := inject(seldom, PRESSING_S)):  # where a run begins, say: what comes first
                seldom.discard(call)
        print(f"{len(tried)} calls, not {sorted(seldom)}")
        assert len(tried) > 40
        assert not unreported, unreported
        numbers = all_numbers(opened)
        missing = sorted(set(range(numbers[-1] + 1)) - set(numbers))
        assert len(missing) <= 12, "a fault in the scanner costs its own scan at most"


def test_a_fault_the_journal_did_not_take_is_told_as_soon_as_it_takes_one():
    journalled, tries = [], []

    def journal(fault):
        tries.append(fault)
        if len(tries) < 3:
            raise Injected("the journal")
        journalled.append(fault)

    def work():
        for reading in (Injected("first"), None, Injected("second")):
            thread.failed(reading) if reading else thread.worked()

    thread = SupervisedThread("press", work, journal)
    thread.start()
    thread.join(240.0)
    faults = [unexpected(Injected(which)) for which in ("first", "second")]
    assert journalled == [say("thread-failed", thread="press", why=fault) for fault in faults]
    assert len(tries) == 4


def test_while_the_writer_fails_the_watchdog_is_not_fed_and_health_says_why(tmp_path, monkeypatch):
    beats = []
    monkeypatch.setattr(Notifier, "alive", lambda self, status: beats.append("fed"))
    monkeypatch.setattr(Notifier, "status", lambda self, status: beats.append(status))
    monkeypatch.setattr(recorder, "BEAT_S", 0.05)
    broken = threading.Event()
    take = outbox.Outbox._take

    def taking(self):
        if broken.is_set():
            raise Injected("the writer")
        take(self)

    monkeypatch.setattr(outbox.Outbox, "_take", taking)
    with plant(tmp_path) as made, open_store(made.url) as opened, recording_by(made):
        wait_until(lambda: opened.newest_scan_number("lab") > 5 and "fed" in beats)
        broken.set()
        first = reported_first(beats, "writer")
        wait_until(lambda: len(beats) > first + 10)
        broken.clear()
        assert "fed" not in beats[first : first + 10]
        wait_until(lambda: "fed" in beats[first + 10 :])
        (alarm,) = [e.message for e in opened.journal(level="alarm").items]
        inner = say("unexpected-error", kind="Injected", error=say("plain-text", text="the writer"))
        assert alarm == say("thread-failed", thread="writer", why=inner)


def test_a_thread_whose_fault_cannot_even_be_put_into_words_goes_on_and_reports_the_next(monkeypatch):
    """As where no memory is left: the report fails as the work did."""
    reports, journalled, begun = [], [], []
    words = supervision.unexpected

    def unexpected_once(error):
        reports.append(error)
        if len(reports) < 3:
            raise MemoryError
        return words(error)

    monkeypatch.setattr(supervision, "unexpected", unexpected_once)
    monkeypatch.setattr(supervision, "RESTART_S", 0.0)

    def work():
        begun.append(None)
        if len(begun) <= 3:
            raise MemoryError(f"{len(begun)}")

    thread = SupervisedThread("pages", work, journalled.append)
    thread.start()
    wait_until(lambda: not thread.alive)
    assert len(begun) == 4
    fault = words(MemoryError("3"))
    assert journalled == [say("thread-failed", thread="pages", why=fault)]


def reported_first(beats, what):
    """Wait for the first sign of life that tells of something; return which it was."""
    wait_until(lambda: any(what in beat for beat in beats))
    return next(i for i, beat in enumerate(beats) if what in beat)


def test_while_the_check_of_the_file_stands_the_watchdog_is_not_fed_and_health_says_why(tmp_path, monkeypatch):
    beats, reading, free = [], threading.Event(), threading.Event()
    monkeypatch.setattr(Notifier, "alive", lambda self, status: beats.append("fed"))
    monkeypatch.setattr(Notifier, "status", lambda self, status: beats.append(status))
    monkeypatch.setattr(recorder, "BEAT_S", 0.05)
    monkeypatch.setattr(recorder, "_PAGES_S", 0.02)
    monkeypatch.setattr(recorder, "_READING_S", 0.2)

    def standing(path):
        reading.set()
        free.wait()
        return ""

    monkeypatch.setattr(recorder, "damage_of", standing)
    try:
        with plant(tmp_path) as made, open_store(made.url) as opened, recording_by(made):
            wait_until(reading.is_set)
            first = reported_first(beats, "check of")
            wait_until(lambda: len(beats) > first + 5)
            assert "fed" not in beats[first : first + 5]
            wait_until(lambda: "pages-stalled" in str(opened.statuses()[opened.beats_as("record")].status))
            newest = opened.newest_scan_number("lab")
            wait_until(lambda: opened.newest_scan_number("lab") > newest)
            free.set()
            monkeypatch.setattr(recorder, "_READING_S", 300.0)
            wait_until(lambda: "fed" in beats[first + 5 :])
    finally:
        free.set()


def test_while_idle_scans_are_thinned_signs_of_life_go_on_and_tell_when_it_stands_still(tmp_path, monkeypatch):
    beats, thinning, free = [], threading.Event(), threading.Event()
    monkeypatch.setattr(Notifier, "alive", lambda self, status: beats.append("fed"))
    monkeypatch.setattr(recorder, "BEAT_S", 0.05)
    monkeypatch.setattr(recorder, "_THIN_S", 0.02)
    monkeypatch.setattr(recorder, "_READING_S", 0.2)

    def message_in(opened):
        return opened.statuses()[opened.beats_as("record")].status["message"]

    def standing(self, before):
        thinning.set()
        free.wait()
        yield 0

    monkeypatch.setattr(store.Store, "thin_idle", standing)
    try:
        with plant(tmp_path) as made, open_store(made.url) as opened, recording_by(made):
            wait_until(thinning.is_set)
            newest, fed = opened.newest_scan_number("lab"), len(beats)
            wait_until(lambda: len(beats) > fed + 5 and opened.newest_scan_number("lab") > newest)
            wait_until(lambda: "thinning: no progress" in message_in(opened))
            fed = len(beats)
            wait_until(lambda: len(beats) > fed)
            free.set()
            wait_until(lambda: "thinning" not in message_in(opened))
    finally:
        free.set()


def test_a_recorder_thins_what_was_recorded_long_ago(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "_THIN_S", 0.2)
    with plant(tmp_path) as made, open_store(made.url) as opened:
        with recording_by(made):
            wait_until(lambda: opened.newest_scan_number("lab") > 10)
        with opened.database.writing() as connection:
            for table in ("scan", "press_event"):
                connection.exec_driver_sql(f"UPDATE {table} SET unix_s = unix_s - 4000000")
            connection.exec_driver_sql("DELETE FROM run")
        with recording_by(made):
            wait_until(lambda: [s.number for s in opened.scans_after("lab", -1, 2).scans][1] > 10)


@pytest.mark.skipif(os.name == "nt", reason="pipes with names are POSIX")
@pytest.mark.parametrize("which", ["kerntemp.toml", "lab.toml"])
def test_while_a_file_of_the_configuration_hangs_recording_and_signs_of_life_go_on(tmp_path, monkeypatch, which):
    """As on a network drive that is away: a pipe that nobody writes into is read for ever, too."""
    beats = []
    monkeypatch.setattr(Notifier, "alive", lambda self, status: beats.append(status))
    monkeypatch.setattr(recorder, "BEAT_S", 0.05)
    monkeypatch.setattr("daq.supervision.STALLED_S", 0.5)
    with plant(tmp_path) as made, open_store(made.url) as opened, recording_by(made):
        wait_until(lambda: opened.newest_scan_number("lab") > 5)
        hung, pipe, sound = tmp_path / which, tmp_path / "pipe", tmp_path / "sound"
        os.mkfifo(pipe)
        sound.write_text(hung.read_text())
        pipe.rename(hung)
        pipe.hardlink_to(hung)
        wait_until(lambda: any("kerntemp.toml, or a file it names, has stalled" in beat for beat in beats))
        newest, fed = opened.newest_scan_number("lab"), len(beats)
        wait_until(lambda: len(beats) > fed + 20 and opened.newest_scan_number("lab") > newest + 10)
        sound.replace(hung)
        pipe.open("w").close()  # who waits for it reads nothing, and then the file in its place
        wait_until(lambda: "has stalled" not in beats[-1])


@pytest.mark.skipif(os.name == "nt", reason="these signals are POSIX")
def test_a_closed_terminal_or_a_wish_to_rotate_logs_does_not_end_the_recorder(tmp_path):
    with plant(tmp_path) as made, open_store(made.url) as opened:
        command = [sys.executable, "-m", "daq.recording.recorder", str(made.config)]
        where = {"cwd": Path(__file__).parents[2], "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, **where) as child:
            try:
                wait_until(lambda: opened.newest_scan_number("lab") > 2)
                for one in (signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2):
                    child.send_signal(one)
                newest = opened.newest_scan_number("lab")
                wait_until(lambda: opened.newest_scan_number("lab") > newest + 5)
                assert child.poll() is None
            finally:
                child.terminate()
        assert load_config(made.config).press
