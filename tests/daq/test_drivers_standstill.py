"""A stopped converter is told from a calm room."""

from __future__ import annotations

from daq.drivers.polled import Standstill


def stale_share(standstill, times_s, value):
    return sum(standstill.too_long((value(t),), t) for t in times_s) / len(times_s)


def test_a_converter_that_stops_in_mid_run_is_noticed_within_the_limit():
    watch = Standstill(30.0)
    assert stale_share(watch, range(100), lambda t: float(t)) == 0.0
    flags = [watch.too_long((99.0,), float(t)) for t in range(100, 140)]
    assert flags.index(True) == 30


def test_a_calm_room_in_coarse_steps_raises_at_most_one_false_alarm():
    watch = Standstill(30.0)
    day = range(24 * 3600)
    wander = [round(210 + 3 * ((t // 47) % 5)) / 10 for t in day]
    flags = [watch.too_long((v,), float(t)) for t, v in zip(day, wander, strict=True)]
    assert sum(flags) <= 47


def test_what_stood_still_by_nature_is_forgotten_once_the_press_moves():
    watch = Standstill(30.0)
    for t in range(0, 1000, 50):
        watch.too_long((float(t),), float(t))
    for t in range(1000, 1101):
        watch.too_long((float(t),), float(t))
    assert [watch.too_long((1100.0,), 1100.0 + t) for t in (29, 31)] == [False, True]


def test_no_standstill_is_natural_beyond_ten_limits():
    watch = Standstill(30.0)
    for t in (0, 500, 1000):
        watch.too_long((float(t),), float(t))
    assert watch.too_long((1000.0,), 1301.0)


def test_a_module_without_any_value_is_not_called_stale():
    watch = Standstill(1.0)
    assert not any(watch.too_long((), float(t)) for t in range(100))
