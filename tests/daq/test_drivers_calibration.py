"""Calibration with history, the check at room temperature, and the warm hand."""

from __future__ import annotations

import math
from datetime import date

import numpy as np
import pytest

from daq.drivers import LoggerSettings, open_logger
from daq.drivers.calibration import (
    Calibration,
    append_calibrations,
    corrector,
    in_force,
    read_calibrations,
)
from daq.drivers.commissioning import (
    check_at_room_temperature,
    collect,
    offsets_from_room,
    warmed_channel,
)
from daq.records import Channel, InputError, Quality, Reading
from daq.simulated.devices import simulated, wiring

SPRING, SUMMER = date(2026, 3, 1), date(2026, 7, 1)
CHANNELS = tuple(Channel(f"top_{k}") for k in range(1, 5))


def readings_of(table, qualities=None):
    table = np.atleast_2d(table)
    good = (Quality.GOOD,) * table.shape[1]
    return tuple(Reading(i, i + 0.1, tuple(row), qualities or good) for i, row in enumerate(table.tolist()))


def test_a_run_is_corrected_by_what_was_in_force_on_its_day():
    history = (
        Calibration(channel="top_1", date=SPRING, offset_K=-0.4),
        Calibration(channel="top_1", date=SUMMER, offset_K=-0.6),
    )
    assert in_force(history, "top_1", date(2026, 2, 1)) is None
    assert in_force(history, "top_1", date(2026, 4, 1)).offset_K == -0.4
    assert in_force(history, "top_1", date(2026, 8, 1)).offset_K == -0.6
    correct = corrector(history, ("", "top_1"), date(2026, 8, 1))
    assert correct(1, 20.6) == pytest.approx(20.0)
    assert correct(0, 20.6) == 20.6


def test_the_file_keeps_every_entry_and_reads_back_what_was_written(tmp_path):
    path = tmp_path / "calibration.toml"
    first = Calibration(channel="top_1", date=SUMMER, offset_K=-0.1234567, reference='Hg "17"')
    second = Calibration(channel="top_2", date=SPRING, gain=1.01)
    append_calibrations(path, [first])
    append_calibrations(path, [second])
    assert read_calibrations(path) == (second, first)
    assert [p.name for p in tmp_path.iterdir()] == ["calibration.toml"]


def test_of_two_calibrations_on_one_day_the_later_entry_is_in_force_and_both_are_kept(tmp_path):
    path = tmp_path / "calibration.toml"
    append_calibrations(path, [Calibration(channel="top_1", date=SUMMER, offset_K=-0.4)])
    append_calibrations(path, [Calibration(channel="top_1", date=SUMMER, offset_K=0.7)])
    append_calibrations(path, [Calibration(channel="top_1", date=SPRING, offset_K=5.0)])
    history = read_calibrations(path)
    assert [entry.offset_K for entry in history] == [5.0, -0.4, 0.7]
    assert corrector(history, ("top_1",), SUMMER)(0, 20.0) == pytest.approx(20.7)
    assert corrector(history, ("top_1",), SPRING)(0, 20.0) == pytest.approx(25.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[calibration]]\nchannel = "a"\ndate = 2026-01-01\noffset = 1.0\n',
            "entry 1: offset = 1.0: unknown key; did you mean offset_K",
        ),
        ('[[calibration]]\nchannel = "a"\ndate = 2026-01-01\noffset_K = 99.0\n', "offset_K.*50"),
        ('[[calibration]]\nchannel = "a"\n', "entry 1: date"),
        ("x = 1\n", "only .*calibration"),
        ("[[calib", "calibration.toml"),
    ],
)
def test_a_wrong_file_is_refused_by_entry_and_key(tmp_path, text, message):
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_calibrations(path)


def test_readings_come_corrected_out_of_the_driver(tmp_path):
    path = tmp_path / "calibration.toml"
    append_calibrations(path, [Calibration(channel="b", date=SPRING, gain=1.02, offset_K=-0.5)])
    with simulated("exemys-rme1-tc", lambda now_s: [100.0] * 8, refresh_s=0) as server:
        table = wiring("exemys-rme1-tc", server, "x", ("a", "b")) | {"calibration": path}
        logger = open_logger(LoggerSettings(**table))
        assert logger.read().values == pytest.approx((100.0, 101.5))
        logger.close()


def test_room_check_tells_sound_off_noisy_and_dead_channels_apart():
    rng = np.random.default_rng(3)
    table = 21.0 + rng.normal(0, 0.05, (20, 4))
    table[:, 1] += 6.0
    table[:, 2] += rng.normal(0, 2.0, 20)
    qualities = (Quality.GOOD, Quality.GOOD, Quality.GOOD, Quality.OPEN)
    checks = check_at_room_temperature(CHANNELS, readings_of(table, qualities), 20.5)
    assert [c.verdict for c in checks] == ["ok", "off", "noisy", "no value"]
    assert checks[0].deviation_kelvin == pytest.approx(0.5, abs=0.05)
    assert checks[3].quality is Quality.OPEN
    assert math.isnan(checks[3].mean_celsius)
    offsets = offsets_from_room(checks, SPRING, "mercury")
    assert [o.channel for o in offsets] == ["top_1"]
    assert offsets[0].correct(checks[0].mean_celsius) == pytest.approx(20.5, abs=1e-3)


def test_the_channel_warmed_by_hand_is_found_in_a_warming_room():
    before = readings_of(np.full((5, 4), 20.0))
    after = readings_of(np.full((5, 4), 21.0) + np.array([0.0, 0.1, 6.0, 0.3]))
    warmed = warmed_channel(CHANNELS, before, after)
    assert warmed.channel == "top_3"
    assert warmed.rise_kelvin == pytest.approx(5.8, abs=0.1)


def test_the_channel_warmed_by_hand_is_found_beside_one_that_gives_no_value():
    qualities = (Quality.GOOD, Quality.OPEN, Quality.GOOD, Quality.GOOD)
    before = readings_of(np.full((5, 4), 20.0), qualities)
    after = readings_of(np.full((5, 4), 20.0) + np.array([0.0, 0.0, 6.0, 0.3]), qualities)
    warmed = warmed_channel(CHANNELS, before, after)
    assert (warmed.channel, warmed.rise_kelvin) == ("top_3", pytest.approx(5.7))
    nobody = warmed_channel(CHANNELS, before, before)
    assert (nobody.channel, nobody.rise_kelvin) == (None, 0.0)


@pytest.mark.parametrize("rise", [[0.1, 0.2, 0.3, 0.2], [5.0, 0.0, 4.0, 0.0], [np.nan] * 4])
def test_no_channel_is_named_when_none_or_two_are_warm(rise):
    before = readings_of(np.full((5, 4), 20.0))
    assert warmed_channel(CHANNELS, before, readings_of(20.0 + np.array([rise] * 5))).channel is None


def test_readings_are_collected_across_gaps():
    with simulated("exemys-rme1-tc", lambda now_s: [20.0] * 8, refresh_s=0) as server:
        logger = open_logger(LoggerSettings(**wiring("exemys-rme1-tc", server, "x", ("a", "b"))))
        waits = []
        assert len(collect(logger, 3, wait=waits.append)) == 3
        assert waits == [0.5, 0.5]
        logger.close()
