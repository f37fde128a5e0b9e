"""A device, a port or a connection that goes away is missed by nobody else and found again in 5 s."""

from __future__ import annotations

import contextlib
import threading
import time
from statistics import median

import pytest
import serial

from daq.drivers import LoggerSettings, ReadFailure, open_logger
from daq.records import Quality
from daq.simulated.devices import simulated, station, wiring
from daq.simulated.devices_converter import Switches
from daq.simulated.devices_line import serve_serial
from tests.daq.proxy import Fault, FaultProxy, rtu_spoiler, tcp_spoiler
from tests.patience import LONGEST_S, PATIENT, briefly, found_again, until_good, wait_until

EIGHT = tuple(f"c{k}" for k in range(8))
QUICK = {"timeout_s": 0.2, "drain_s": 0.1}


def warm(now_s):
    return [30.0 + 10 * k for k in range(8)]


@contextlib.contextmanager
def wired(profile, directory, *, fault=Fault.NONE, settings=None, **options):
    """A wire whose every reply suffers one fault, none unless asked for."""
    serial = profile == "adam-4118"
    with simulated(profile, warm, refresh_s=0) as upstream:
        spoiler = rtu_spoiler() if serial else tcp_spoiler()
        link = directory / "port" if serial else None
        sound = {"plan": lambda *_: fault, "seed": 0, "late_s": (0.3, 0.4), "port_link": link}
        with FaultProxy(upstream, spoiler, **sound, **options) as wire:
            logger = open_logger(
                LoggerSettings(**wiring(profile, wire, profile, EIGHT) | PATIENT | (settings or {}))
            )
            try:
                yield wire, logger
            finally:
                logger.close()


def gaps(logger, seconds, at_last=None):
    """Read on for a while, and until a cause stands there; return all causes. Nothing good may come."""
    causes, begun = set(), time.monotonic()
    with briefly(logger):
        while time.monotonic() - begun < seconds or (at_last or logger) not in {*causes, logger}:
            assert time.monotonic() - begun < LONGEST_S, causes
            with pytest.raises(ReadFailure) as caught:
                logger.read()
            causes.add(caught.value.cause)
    return causes


@pytest.mark.parametrize("profile", ["adam-4118", "exemys-rme1-tc"])
def test_a_port_that_vanishes_is_a_gap_and_is_read_again_when_it_returns(profile, tmp_path):
    gone = "no port" if profile == "adam-4118" else "connection refused"
    with wired(profile, tmp_path) as (wire, logger):
        until_good(logger)

        def lose():
            wire.vanish()
            assert gaps(logger, 1.0, gone) - {"port lost", "silent"} == {gone}
            with pytest.raises(ReadFailure, match=f"{gone}; "):
                logger.read()

        assert found_again(logger, lose, wire.appear).values == pytest.approx(warm(0), abs=0.06)


@pytest.mark.parametrize("profile", ["adam-4118", "exemys-rme1-tc"])
def test_a_connection_that_is_open_but_dead_is_made_anew(profile, tmp_path):
    with wired(profile, tmp_path, settings=QUICK) as (wire, logger):
        until_good(logger)

        def lose():
            wire.go_dead()
            assert gaps(logger, 1.0) <= {"port lost", "silent"}

        def find():
            wire.revive()
            if profile == "adam-4118":
                wire.vanish()
                wire.appear()

        found_again(logger, lose, find)


def test_a_silent_module_costs_its_neighbour_on_the_wire_no_reading():
    off = Switches()
    first = station("adam-4118", warm, address=1, refresh_s=0, switches=off)
    second = station("m-7018", warm, address=2, refresh_s=0)
    with serve_serial(first, second) as server:
        loggers = [
            open_logger(
                LoggerSettings(
                    **wiring(profile, server, profile, tuple(f"{profile}{k}" for k in range(8)), address=address)
                    | timing
                )
            )
            for profile, address, timing in (("adam-4118", 1, QUICK), ("m-7018", 2, PATIENT))
        ]
        for logger in loggers:
            until_good(logger)
        off.silent = True
        stop = threading.Event()
        silent = threading.Thread(target=_keep_failing, args=(loggers[0], stop))
        silent.start()
        waits = []
        for _ in range(20):
            start = time.monotonic()
            assert loggers[1].read().qualities[0] is Quality.GOOD
            waits.append(time.monotonic() - start)
            stop.wait(0.1)
        stop.set()
        silent.join()
        assert median(waits) < 1.0
        found_again(loggers[0], lambda: None, lambda: setattr(off, "silent", False))
        for logger in loggers:
            logger.close()


def _keep_failing(logger, stop):
    while not stop.wait(0.1):
        with pytest.raises(ReadFailure):
            logger.read()


def test_a_frozen_module_is_stale_until_it_moves_again():
    switches = Switches()
    with simulated("exemys-rme1-tc", lambda now_s: [now_s % 100] * 8, refresh_s=0, switches=switches) as server:
        table = wiring("exemys-rme1-tc", server, "frozen", EIGHT) | PATIENT | {"stale_after_s": 0.5}
        logger = open_logger(LoggerSettings(**table))
        until_good(logger)
        switches.frozen = True
        wait_until(lambda: logger.read().qualities[0] is Quality.STALE)
        switches.frozen = False
        wait_until(lambda: logger.read().qualities[0] is Quality.GOOD)
        logger.close()


def test_noise_on_opening_the_port_costs_at_most_the_first_reading(tmp_path):
    noise = {"greeting": b"\xff\x00\x80\x01\x03", "settings": {"timeout_s": 5.0}}
    with wired("adam-4118", tmp_path, **noise) as (_, logger):
        with contextlib.suppress(ReadFailure):
            logger.read()
        assert logger.read().values == pytest.approx(warm(0), abs=0.06)


@pytest.mark.parametrize(("alternate", "expected"), [(None, "older moment"), (3, "refused")])
def test_a_reply_later_than_any_drain_never_moves_channels_and_two_functions_betray_it(alternate, expected):
    """The wire holds the second reply back until the third request has left."""
    held = []
    count = iter(range(100))

    class Holding:
        """A module whose second reply comes right after the third request, before its own."""

        think_s = 0.001

        def __init__(self, module):
            self._module = module
            self.split = module.split

        def answer(self, request):
            reply = self._module.answer(request)
            number = next(count)
            if number == 1:
                held.append(reply)
                return None
            return held.pop() if number == 2 else reply

    ramp = iter(range(20, 90))
    module = station("m-7018", lambda now_s: [float(v) for v in [next(ramp)] * 8], refresh_s=0)
    with serve_serial(Holding(module)) as server:
        changes = {"override": {"checks": [], "block": {"alternate": alternate}}}
        patient = {"timeout_s": 2.0, "drain_s": 0.1}  # a busy machine answers all but the second in time
        logger = open_logger(LoggerSettings(**wiring("m-7018", server, "x", EIGHT) | patient | changes))
        assert set(logger.read().values) == {20.0}
        with pytest.raises(ReadFailure):
            logger.read()
        if expected == "refused":
            with pytest.raises(ReadFailure, match="expected 04 10"):
                logger.read()
        else:
            assert set(logger.read().values) == {21.0}
        logger.close()


def test_a_port_another_program_holds_is_a_gap_that_says_so():
    pytest.importorskip("fcntl", reason="ports are always exclusive on Windows")
    with simulated("m-7018", warm, refresh_s=0) as server:
        table = wiring("m-7018", server, "x", EIGHT) | PATIENT
        with serial.Serial(server.port, exclusive=True):
            logger = open_logger(LoggerSettings(**table))
            with pytest.raises(ReadFailure, match=r"port in use; another program has it open") as caught:
                logger.read()
            assert caught.value.cause == "port in use"
        assert logger.read().values == pytest.approx(warm(0), abs=0.06)
        logger.close()


def test_a_converter_that_echoes_what_is_sent_is_read_where_the_settings_say_so(tmp_path):
    with wired("adam-4118", tmp_path, fault=Fault.ECHOED, settings={"local_echo": True}) as (_, logger):
        assert logger.read().values == pytest.approx(warm(0), abs=0.06)
    unsaid = {"fault": Fault.ECHOED, "settings": {"timeout_s": 5.0}}
    with wired("adam-4118", tmp_path, **unsaid) as (_, logger), pytest.raises(ReadFailure) as caught:
        logger.read()
    assert caught.value.cause in ("wrong shape", "surplus", "truncated")
