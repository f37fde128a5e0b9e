"""Every Modbus profile against an independently written simulation of its device."""

from __future__ import annotations

import contextlib
import math

import pytest

from daq.drivers import BadFrame, LoggerSettings, NoReply, open_logger
from daq.drivers.modbus import Request, rtu_frame
from daq.records import Quality
from daq.simulated import devices_line
from daq.simulated.devices import kind_of, simulated, station, wiring
from daq.simulated.devices_converter import Converter, Switches
from daq.simulated.devices_line import serve_serial
from tests.patience import PATIENT, briefly, until_good, wait_until

STEP_K = {
    "adam-4118": 0.021,
    "adam-4018+": 0.005,
    "m-7018": 0.05,
    "m-7019r": 0.021,
    "labjack-t7": 0.001,
    "sequent-smtc": 0.03,
    "exemys-rme1-tc": 0.05,
    "adam-6018+": 0.011,
    "generic": 0.05,
}
MODBUS = tuple(STEP_K)


@contextlib.contextmanager
def logger_on(profile, temperatures, *, switches=None, names=None, **changes):
    inputs = kind_of(profile).inputs
    names = names or tuple(f"t_{k}" for k in range(inputs))
    with simulated(profile, temperatures, refresh_s=0, switches=switches) as server:
        table = wiring(profile, server, profile, names) | PATIENT | changes
        logger = open_logger(LoggerSettings(**table))
        try:
            yield logger
        finally:
            logger.close()


@pytest.mark.parametrize("profile", MODBUS)
def test_every_input_reads_its_own_temperature_within_the_resolution(profile):
    inputs = kind_of(profile).inputs
    truth = [25.0 + 13.37 * k for k in range(inputs)]
    with logger_on(profile, lambda now_s: truth) as logger:
        reading = logger.read()
    assert reading.values == pytest.approx(truth, abs=STEP_K[profile] + 1e-9)
    assert set(reading.qualities) == {Quality.GOOD}
    assert reading.requested_s < reading.received_s


@pytest.mark.parametrize("profile", ["adam-4118", "adam-4018+", "m-7018", "m-7019r", "labjack-t7", "generic"])
def test_a_broken_thermocouple_is_reported_open_and_has_no_value(profile):
    switches = Switches(open_inputs={3})
    with logger_on(profile, lambda now_s: [30.0] * kind_of(profile).inputs, switches=switches) as logger:
        reading = logger.read()
    assert math.isnan(reading.values[3])
    assert reading.qualities[3] is Quality.OPEN
    assert all(q is Quality.GOOD for k, q in enumerate(reading.qualities) if k != 3)


@pytest.mark.parametrize("profile", ["adam-6018+", "exemys-rme1-tc", "sequent-smtc"])
def test_devices_without_a_code_for_open_still_give_no_usable_value(profile):
    switches = Switches(open_inputs={0, 3})
    with logger_on(profile, lambda now_s: [30.0] * kind_of(profile).inputs, switches=switches) as logger:
        reading = logger.read()
    assert not any(reading.qualities[k].usable for k in (0, 3))
    assert all(math.isnan(reading.values[k]) for k in (0, 3))


@pytest.mark.parametrize(
    ("profile", "hot"),
    [
        ("m-7018", Quality.OVER),
        ("m-7019r", Quality.OPEN),
        ("exemys-rme1-tc", Quality.OVER),
        ("sequent-smtc", Quality.OVER),
    ],
)
def test_beyond_the_ends_of_type_k_a_device_is_under_or_over_range(profile, hot):
    # a full-scale code of an M-7019R is also its code for a broken wire: the more serious one counts
    with logger_on(profile, lambda now_s: [-300.0, 1400.0, -271.0, -268.0, 1371.0] + [20.0] * 3) as logger:
        reading = logger.read()
    assert (reading.qualities[0], reading.qualities[2]) == (Quality.UNDER, Quality.UNDER)
    assert reading.qualities[1] is hot
    assert all(math.isnan(v) for v in reading.values[:3])
    if profile != "sequent-smtc":  # 1 K is less than the microvolt it reads near -270 C
        assert reading.values[3:5] == pytest.approx((-268.0, 1371.0), abs=STEP_K[profile])


def test_adam_type_k_ends_at_zero_so_frost_reads_under_range():
    with logger_on("adam-4118", lambda now_s: [-5.0, 1500.0] + [20.0] * 6) as logger:
        reading = logger.read()
    assert reading.qualities[:3] == (Quality.UNDER, Quality.OVER, Quality.GOOD)


def test_two_modules_on_one_wire_share_it_and_keep_their_channels_apart():
    low = station("adam-4118", lambda now_s: [50.0 + k for k in range(8)], address=1, refresh_s=0)
    high = station("m-7019r", lambda now_s: [150.0 + k for k in range(8)], address=2, refresh_s=0)
    with serve_serial(low, high) as server:
        wires = (("adam-4118", "a", 1), ("m-7019r", "b", 2))
        loggers = [
            open_logger(
                LoggerSettings(**wiring(p, server, p, tuple(f"{c}{k}" for k in range(8)), address=a) | PATIENT)
            )
            for p, c, a in wires
        ]
        for _ in range(3):
            first, second = (logger.read() for logger in loggers)
            assert first.values == pytest.approx([50.0 + k for k in range(8)], abs=0.03)
            assert second.values == pytest.approx([150.0 + k for k in range(8)], abs=0.03)
        loggers[0].close()
        assert loggers[1].read().values[0] == pytest.approx(150.0, abs=0.03)
        loggers[1].close()


def test_unused_inputs_are_left_out():
    with logger_on("generic", lambda now_s: list(range(20, 36)), names=("", "a", "", "b")) as logger:
        assert [c.name for c in logger.channels] == ["a", "b"]
        assert logger.read().values == pytest.approx([21.0, 23.0])


def test_a_wrong_address_is_met_with_silence():
    with (
        logger_on("adam-4118", lambda now_s: [20.0] * 8, address=7, timeout_s=1.0) as logger,
        pytest.raises(NoReply, match=r"no reply in 1 s; check power, cable and address") as caught,
    ):
        logger.read()
    assert caught.value.cause == "silent"


def test_a_busy_device_says_so_and_is_read_again():
    switches = Switches(busy=True)
    with logger_on("exemys-rme1-tc", lambda now_s: [20.0] * 8, switches=switches) as logger:
        with pytest.raises(NoReply, match="exception 6") as caught:
            logger.read()
        assert caught.value.cause == "busy"
        switches.busy = False
        assert logger.read().qualities[0] is Quality.GOOD


def test_a_module_set_to_another_thermocouple_type_is_refused():
    override = {"checks": [{"what": "type", "function": 3, "address": 200, "count": 2, "expect": [0x0E]}]}
    with (
        logger_on("adam-4118", lambda now_s: [20.0] * 8, override=override) as logger,
        pytest.raises(NoReply, match="type reads 000F 000F, profile adam-4118 expects 000E"),
    ):
        logger.read()


def test_a_converter_that_stopped_is_called_stale():
    switches = Switches(frozen=True)
    with logger_on("exemys-rme1-tc", lambda now_s: [20.0] * 8, switches=switches, stale_after_s=0.05) as logger:
        assert logger.read().qualities[0] is Quality.GOOD
        readings: list[set[Quality]] = []

        def not_good() -> bool:
            readings.append(set(logger.read().qualities))
            return Quality.GOOD not in readings[-1]

        wait_until(not_good)
        assert readings[-1] == {Quality.STALE}


def test_the_demo_marks_its_values_simulated():
    with logger_on("exemys-rme1-tc", lambda now_s: [20.0] * 8, simulated=True) as logger:
        assert set(logger.read().qualities) == {Quality.SIMULATED}


def test_converter_refreshes_slower_than_it_is_asked_and_skews_its_channels():
    clock = [100.0]
    converter = Converter(lambda now_s: [now_s] * 8, 8, 0.8, clock=lambda: clock[0])
    first = converter.read()
    assert len(set(first)) == 8
    assert all(99.2 <= v <= 100.0 for v in first)
    clock[0] += 0.11
    changed = [a != b for a, b in zip(first, converter.read(), strict=True)]
    assert 0 < sum(changed) < 3


def test_a_serial_device_behind_a_gateway_is_reached_by_a_socket_url():
    with simulated("m-7019r", lambda now_s: [40.0] * 8, transport="rtu_over_tcp", refresh_s=0) as server:
        table = wiring("m-7019r", server, "x", ("a",)) | PATIENT
        table = {k: v for k, v in table.items() if k not in ("host", "tcp_port", "baud")} | {"port": server.port}
        logger = open_logger(LoggerSettings(**table))
        assert server.port.startswith("socket://")
        assert logger.read().values == pytest.approx([40.0], abs=0.03)
        logger.close()


def test_without_pseudo_terminals_a_serial_device_is_served_on_a_socket_url(monkeypatch):
    monkeypatch.setattr(devices_line, "HAS_PSEUDO_TERMINALS", False)
    with simulated("adam-4118-ascii", lambda now_s: [40.0] * 8, refresh_s=0) as server:
        assert server.place["port"].startswith("socket://127.0.0.1:")
        logger = open_logger(LoggerSettings(**wiring("adam-4118-ascii", server, "x", ("a",)) | PATIENT))
        assert logger.read().values == pytest.approx([40.0], abs=0.06)
        logger.close()


@pytest.mark.skipif(not devices_line.HAS_PSEUDO_TERMINALS, reason="flow control is the serial port's own")
def test_an_instrument_that_stops_the_line_while_it_works_is_read_whole():
    truth = [20.0 + k for k in range(16)]
    stopping = {"switches": Switches(flow_control=True)}
    flow = {"serial": {"baud": 9600, "xonxoff": True}}
    with logger_on("34970a", lambda now_s: truth, override=flow, **stopping) as logger:
        for _ in range(3):
            assert logger.read().values == pytest.approx(truth, abs=0.06)
    impatient = {**stopping, "timeout_s": 2.0}
    with logger_on("34970a", lambda now_s: truth, **impatient) as logger, pytest.raises(BadFrame):
        logger.read()


def test_a_device_that_was_switched_off_has_forgotten_its_settings_and_is_set_up_again():
    switches = Switches()
    for profile in ("labjack-t7", "34970a"):
        with logger_on(profile, lambda now_s: [21.0] * 16, switches=switches) as logger:
            assert set(logger.read().qualities) == {Quality.GOOD}
            switches.silent = True
            for _ in range(3):
                with pytest.raises(NoReply), briefly(logger):
                    logger.read()
            switches.silent = False
            assert set(until_good(logger).qualities) == {Quality.GOOD}


def test_an_icp_module_tells_its_first_reading_after_power_on():
    switches = Switches()
    module = station("m-7018", lambda now_s: [21.0] * 8, switches=switches)
    ask = rtu_frame(1, Request(1, 272, 1))
    assert [module.answer(ask)[3] for _ in range(3)] == [1, 0, 0]
    switches.silent = True
    assert module.answer(ask) is None
    switches.silent = False
    assert [module.answer(ask)[3] for _ in range(2)] == [1, 0]


@pytest.mark.parametrize(("scaling", "expected"), [("unit", 1.0), ("inverted", 0.0)])
@pytest.mark.parametrize("transport", ["serial", "tcp"])
def test_a_limit_switch_on_a_digital_input_is_a_channel_of_0_and_1_either_way_round(transport, scaling, expected):
    switches = Switches()
    override = {
        "inputs": 8,
        "block": {"function": 1, "address": 0, "count": 8},
        "values": {"format": "u16"},
        "scalings": {"inverted": {"scale": -1.0, "offset": 1.0}},
    }
    with simulated("adam-4118", lambda now_s: [20.0] * 8, transport=transport, switches=switches) as server:
        table = wiring("adam-4118", server, "inputs", ("", "", "", "S7")) | PATIENT
        table |= {"profile": "generic", "address": 1, "scaling": scaling, "override": override}
        table |= {"baud": 9600} if transport == "serial" else {}
        logger = open_logger(LoggerSettings(**table))
        with contextlib.closing(logger):
            open_ = logger.read()
            switches.open_inputs.add(3)
            closed = logger.read()
    assert (open_.values, closed.values) == ((1.0 - expected,), (expected,))
    assert set(open_.qualities + closed.qualities) == {Quality.GOOD}
