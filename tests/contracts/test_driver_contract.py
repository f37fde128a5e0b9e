"""What the recorder may rely on, whatever the logger: every profile passes every sentence."""

from __future__ import annotations

import contextlib
import math
import time
from pathlib import Path

import pytest

from daq.drivers import LoggerSettings, NoReply, ReadFailure, open_logger
from daq.drivers import profile as profiles
from daq.drivers.profile import profile_names, profile_table
from daq.records import Quality
from daq.simulated.devices import KINDS, kind_of, simulated, wiring
from daq.simulated.devices_converter import Switches
from daq.simulated.devices_line import Server
from tests.patience import PATIENT, briefly, found_again, until_good

QUICK_SETUP = {"timing": {"setup_s": 0.002}}
PROFILES = profile_names()
CANNOT_SAY_BUSY = {"34970a", "daq970a", "sr630"}


def truth(inputs):
    """A temperature that tells its input."""
    return [20.0 + 10.0 * k for k in range(inputs)]


@contextlib.contextmanager
def logger_of(profile, *, names=None, switches=None, **changes):
    inputs = kind_of(profile).inputs
    names = names or tuple(f"t_{k}" for k in range(inputs))
    with simulated(profile, lambda now_s: truth(inputs), refresh_s=0, switches=switches) as server:
        table = wiring(profile, server, profile, names)
        table |= PATIENT | {"override": table.get("override", {}) | QUICK_SETUP} | changes
        if profile == "generic":
            table["override"] = {**table["override"], "timing": {"response_s": 0.5, "refresh_s": 1.0}}
        logger = open_logger(LoggerSettings(**table))
        try:
            yield logger
        finally:
            logger.close()


@pytest.fixture(params=PROFILES)
def profile(request):
    return request.param


def test_there_is_a_simulated_device_for_every_profile():
    assert set(PROFILES) == set(KINDS)


def test_every_profile_states_its_sources_and_how_sure_it_is(profile):
    table = profile_table(profile)
    if profile != "generic":
        assert table["sources"]
        assert set(table["marks"].values()) <= {"A", "A-", "B", "C"}
    unsettled = {key for key, mark in table.get("marks", {}).items() if mark == "C"}
    assert not unsettled & set(table), "what is not established must have no default"


def test_channels_are_known_before_the_port_is_opened(profile):
    inputs = kind_of(profile).inputs
    serial = kind_of(profile).transport == "serial"
    nowhere = Server({"port": "/dev/no-such-port"} if serial else {"host": "127.0.0.1", "tcp_port": 1})
    table = wiring(profile, nowhere, profile, ("a", "", "b") + ("",) * (inputs - 3))
    logger = open_logger(LoggerSettings(**table))
    assert [c.name for c in logger.channels] == ["a", "b"]
    with pytest.raises(NoReply, match=r"cannot (open|connect)") as caught:
        logger.read()
    assert caught.value.cause == ("no port" if serial else "connection refused")
    logger.close()


def test_every_channel_reports_its_own_input_between_request_and_reply(profile):
    inputs = kind_of(profile).inputs
    with logger_of(profile) as logger:
        before = time.monotonic()
        for _ in range(3):
            reading = logger.read()
            assert reading.values == pytest.approx(truth(inputs), abs=0.06)
            assert reading.qualities == (Quality.GOOD,) * inputs
        assert before < reading.requested_s <= reading.received_s <= time.monotonic()


def test_unused_inputs_are_left_out_without_shifting_the_others(profile):
    inputs = kind_of(profile).inputs
    names = tuple("" if k % 2 else f"t_{k}" for k in range(inputs))
    with logger_of(profile, names=names) as logger:
        assert [c.name for c in logger.channels] == [n for n in names if n]
        assert logger.read().values == pytest.approx(truth(inputs)[::2], abs=0.06)


def test_a_broken_thermocouple_costs_only_its_own_channel(profile):
    inputs = kind_of(profile).inputs
    with logger_of(profile, switches=Switches(open_inputs={2})) as logger:
        reading = logger.read()
    assert math.isnan(reading.values[2])
    assert not reading.qualities[2].usable
    others = [k for k in range(inputs) if k != 2]
    assert all(reading.qualities[k] is Quality.GOOD for k in others)
    assert [reading.values[k] for k in others] == pytest.approx([truth(inputs)[k] for k in others], abs=0.06)


def test_a_device_that_falls_silent_is_a_named_gap_and_is_found_again(profile):
    switches = Switches()
    with logger_of(profile, switches=switches) as logger:
        logger.read()

        def fall_silent():
            switches.silent = True
            for _ in range(3):
                with pytest.raises(ReadFailure) as caught, briefly(logger):
                    logger.read()
                assert caught.value.cause in ("silent", "port lost")
                assert caught.value.quality in (Quality.MISSING, Quality.BAD_FRAME)

        reading = found_again(logger, fall_silent, lambda: setattr(switches, "silent", False))
        assert reading.values == pytest.approx(truth(kind_of(profile).inputs), abs=0.06)


@pytest.mark.parametrize("profile", sorted(set(PROFILES) - CANNOT_SAY_BUSY))
def test_a_busy_device_is_a_named_gap(profile):
    switches = Switches(busy=True)
    with logger_of(profile, switches=switches) as logger:
        with pytest.raises(ReadFailure) as caught:
            logger.read()
        assert caught.value.cause in ("busy", "refused")
        switches.busy = False
        assert until_good(logger).qualities[0] is Quality.GOOD


def test_closing_twice_does_no_harm_and_reading_after_it_says_so(profile):
    with logger_of(profile) as logger:
        logger.read()
        logger.close()
        logger.close()
        with pytest.raises(NoReply, match="closed"):
            logger.read()


def test_values_of_a_simulated_device_can_be_marked_as_such(profile):
    with logger_of(profile, simulated=True) as logger:
        assert set(logger.read().qualities) == {Quality.SIMULATED}


def test_every_profile_stands_in_the_table_of_profiles(profile):
    table = (Path(profiles.__file__).parent / "profiles" / "README.md").read_text(encoding="utf-8")
    assert f"`{profile}`" in table
