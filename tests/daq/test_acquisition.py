"""The schedule and its loggers: no drift, no waiting for each other, every gap with its cause."""

import math
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from statistics import median

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.drivers import BadFrame, LoggerSettings, NoReply, open_logger
from daq.recording.acquisition import ClockWatch, LoggerThread, Scanner, Ticks, nine_digits
from daq.records import Channel, Quality, Reading, Scan
from daq.simulated.devices import simulated, wiring

BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)


class Instrument:
    """A logger that answers after a while, or as it is told."""

    def __init__(self, name, takes_s=0.0):
        self.channels = (Channel(f"{name}_1"), Channel(f"{name}_2"))
        self.takes_s, self.fails, self.closed, self.count = takes_s, None, False, 0

    def read(self):
        requested = time.monotonic()
        if self.takes_s:
            time.sleep(self.takes_s)
        if self.fails is not None:
            raise self.fails
        self.count += 1
        return Reading(requested, time.monotonic(), (float(self.count), 20.0), (Quality.GOOD,) * 2)

    def close(self):
        self.closed = True


def scans_of(instruments, period_s, count, speed=1.0, between=lambda number: None):
    messages, stop = [], threading.Event()
    threads = [
        LoggerThread(f"logger {i}", x, lambda *what: messages.append(what)) for i, x in enumerate(instruments)
    ]
    scanner = Scanner(threads, period_s, speed, first_number=7)
    scanner.start(stop)
    scans = []
    for number in range(count):
        scans.append(scanner.scan(stop))
        between(number)
    stop.set()
    scanner.join(240.0)
    assert all(x.closed for x in instruments if isinstance(x, Instrument))
    return scans, messages, threads


class Counter(Instrument):
    """A device that counts tenths, behind a calibration's offset."""

    def read(self):
        return replace(super().read(), values=(363 * 0.1, 363 * 0.1 - 0.42))


def test_a_scan_holds_what_the_device_counted_and_no_rounding_of_a_product():
    assert str(363 * 0.1) == "36.300000000000004"
    scans, _, _ = scans_of([Counter("a")], 0.05, 5)
    assert {s.values for s in scans if s.qualities == (Quality.GOOD,) * 2} == {(36.3, 35.88)}


@given(value=st.floats(width=32, allow_nan=False))
def test_every_value_of_a_device_s_32_bit_floats_stays_apart_from_its_neighbours(value):
    assert np.float32(nine_digits(value)) == np.float32(value)


def test_scans_come_on_a_schedule_that_does_not_drift():
    scans, _, _ = scans_of([Instrument("a"), Instrument("b")], 0.05, 60)
    assert [s.number for s in scans] == list(range(7, 67))
    phases = [math.remainder(s.monotonic_s - scans[0].monotonic_s, 0.05) for s in scans]
    assert median(phases[40:]) == pytest.approx(median(phases[:20]), abs=0.01)
    assert {q for s in scans for q in s.qualities} <= {Quality.GOOD, Quality.LATE}  # a busy machine is late


def test_a_slow_logger_leaves_gaps_and_the_fast_one_misses_nothing():
    slow = Instrument("slow", takes_s=0.12)
    scans, _, _ = scans_of([Instrument("fast"), slow], 0.05, 30)
    fast = [s.values[0] for s in scans]
    assert (
        sum(math.isnan(v) for v in fast) <= 3
    )  # a busy machine's own lateness; the slow one leaves out 14 and more
    answered = [s.values[2] for s in scans if not math.isnan(s.values[2])]
    assert 6 <= len(answered) <= 16
    assert len(set(answered)) == len(answered), "an answer was used twice"
    assert {q for s in scans for q in s.qualities[2:]} == {Quality.GOOD, Quality.LATE}


def test_a_scan_says_how_many_ticks_went_by_before_it():
    counts = []
    stop = threading.Event()
    scanner = Scanner([LoggerThread("a", Instrument("a"), lambda *what: None)], 0.05, 1.0, first_number=0)
    scanner.start(stop)
    scans = []
    for number in range(12):
        scans.append(scanner.scan(stop))
        counts.append(scanner.left_out)
        if number == 5:
            time.sleep(0.22)  # a machine that is too busy
    stop.set()
    scanner.join(240.0)
    ticks = (scans[-1].monotonic_s - scans[0].monotonic_s) / 0.05
    uncounted = scanner.missed_ticks - sum(counts)  # those right after the last scan, where the machine is busy
    assert counts[7] >= 3, "the first scan afterwards is late itself, the next one has ticks before it"
    assert uncounted >= 0
    # A scan stands at its tick or, by as many ticks as are then left out and the one it began in, after it.
    assert -(counts[1] + 1) <= ticks - (11 + sum(counts)) <= uncounted + 1


@pytest.mark.parametrize(
    ("failure", "quality"),
    [
        (NoReply("no reply in 0.2 s; check power", "silent"), Quality.MISSING),
        (BadFrame("wrong sum", "crc"), Quality.BAD_FRAME),
        (ZeroDivisionError("a fault in a driver"), Quality.MISSING),
    ],
)
def test_a_failing_logger_gives_gaps_with_their_cause_and_comes_back(failure, quality):
    broken = Instrument("broken")

    def between(number):
        broken.fails = failure if 5 <= number < 10 else None

    scans, _, threads = scans_of([Instrument("sound"), broken], 0.04, 16, between=between)
    late = {Quality.LATE}  # where the machine is busy
    assert {q for s in scans[7:9] for q in s.qualities[2:]} - late == {quality}
    assert {q for s in scans for q in s.qualities[:2]} - late == {Quality.GOOD}
    assert Quality.GOOD in {s.qualities[2] for s in scans[10:]}
    cause = getattr(failure, "cause", "driver fault")
    assert threads[1].counters[cause] >= 4


def test_an_accelerated_clock_runs_that_much_faster():
    scans, _, _ = scans_of([Instrument("a")], 0.02, 30, speed=20.0)
    real_s = (scans[-1].utc - scans[0].utc).total_seconds()
    assert scans[-1].monotonic_s - scans[0].monotonic_s == pytest.approx(20.0 * real_s, rel=0.01)


def test_a_scan_bears_the_time_at_which_its_values_were_converted_not_asked_for():
    began = time.monotonic()
    inputs = tuple(f"top_{k}" for k in range(1, 9))
    with simulated("adam-4118", lambda now_s: [20.0 + now_s - began] * 8) as server:
        logger = open_logger(LoggerSettings(**wiring("adam-4118", server, "module", inputs)))
        scans, _, _ = scans_of([logger], 0.2, 20)
    late = [
        s.monotonic_s - began - (sum(s.values) / 8 - 20.0) for s in scans if all(q.usable for q in s.qualities)
    ]
    assert len(late) > 10
    assert median(late) == pytest.approx(0.0, abs=0.12)
    assert np.all(np.diff([s.monotonic_s for s in scans]) > 0)


def test_ticks_are_counted_from_the_start():
    ticks = Ticks(100.0, 0.1)
    assert ticks.at(10_000_000) == pytest.approx(1_000_100.0)


def test_a_clock_set_back_is_noticed_once_and_drift_is_not():
    watch, steps = ClockWatch(), []
    for n in range(100):
        set_back = timedelta(hours=1) if n >= 50 else timedelta(0)
        utc = BEGAN + timedelta(seconds=0.1001 * n) - set_back
        steps.append(watch.step(Scan(n, utc, 0.1 * n, (), ())))
    assert [n for n, s in enumerate(steps) if s is not None] == [50]
    assert steps[50] == pytest.approx(-3600.0, abs=0.1)
