"""Why the drivers have a Modbus client of their own: the usual one hands out the late reply."""

from __future__ import annotations

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

from daq.drivers import ReadFailure
from daq.drivers.bus import Bus, LineTiming
from daq.drivers.link import SerialPlace
from daq.drivers.modbus import Request, registers, rtu_frame, rtu_reply
from daq.simulated.devices_line import serve_serial
from daq.simulated.modbus import Image, ModbusModule
from tests.daq.proxy import Fault, FaultProxy, rtu_spoiler

TIMEOUT_S = 1.0
"""Long beside what a busy machine keeps a thread waiting, or the late reply lies there when the driver looks."""
LATE_S = (1.3 * TIMEOUT_S, 1.4 * TIMEOUT_S)


class Numbered:
    """A converter that does not matter: every register holds its own address."""

    inputs = 8

    def __init__(self):
        from daq.simulated.devices_converter import Switches

        self.switches = Switches()

    def read(self):
        return ()


@pytest.fixture
def line(tmp_path):
    """A serial line with one module, whose first reply comes after the timeout."""
    module = ModbusModule(lambda values, written: Image({k: k for k in range(64)}), Numbered())
    first = iter([Fault.LATE])
    plan = lambda request, reply: next(first, Fault.NONE)  # noqa: E731
    with (
        serve_serial(module) as upstream,
        FaultProxy(
            upstream,
            rtu_spoiler(),
            plan,
            seed=0,
            late_s=LATE_S,
            port_link=tmp_path / "port",
        ) as wire,
    ):
        yield wire


def test_pymodbus_hands_out_the_late_reply_of_another_request(line):
    client = ModbusSerialClient(
        line.place["port"], framer=FramerType.RTU, baudrate=9600, timeout=TIMEOUT_S, retries=0
    )
    client.connect()
    got = []
    for start in (0, 8, 16):
        try:
            reply = client.read_holding_registers(start, count=8, device_id=1)
            got.append((start, None if reply.isError() else reply.registers[0]))
        except ModbusException:
            got.append((start, None))
    client.close()
    assert any(first is not None and first != start for start, first in got), got


def test_our_bus_gives_the_late_request_up_and_reads_the_next_ones_right(line):
    bus = Bus(SerialPlace(line.place["port"], 9600), numbered=False)
    timing = LineTiming(TIMEOUT_S, 1.5 * TIMEOUT_S)
    got = []
    for start in (0, 8, 16):
        request = Request(3, start, 8)
        try:
            reply = bus.exchange(rtu_frame(1, request), rtu_reply(1, request), timing)
            got.append(registers(reply.payload)[0])
        except ReadFailure as failure:
            got.append(failure.cause)
    bus.close()
    assert got == ["silent", 8, 16]
