"""A Modbus module: one block of registers a scan, its status bits, its set-up."""

from __future__ import annotations

import itertools
import struct
import time

from daq.drivers import modbus
from daq.drivers.bus import Bus, Exchange, LineTiming, TakeReply
from daq.drivers.decode import Sample, decode
from daq.drivers.profile import Profile, Write
from daq.drivers.protocol import Cause, NoReply
from daq.drivers.settings import LoggerSettings
from daq.records import InputError
from daq.words import say

_PACK = {"s16": ">h", "u16": ">H", "s32": ">i", "u32": ">I", "f32": ">f"}


class ModbusDevice:
    """One station. Asks for the same registers in the same shape every time, or in two by turns."""

    def __init__(
        self, bus: Bus, profile: Profile, *, station: int, timing: LineTiming, settings: LoggerSettings
    ) -> None:
        if profile.block is None:
            raise InputError(say("profile-table-missing", profile=profile.name, table="block"))
        self.bus = bus
        self.timing = timing
        self._profile = profile
        self._station = station
        self._scaling = profile.scalings[settings.scaling or profile.scaling or ""]
        self._used = settings.used
        self._cold_junction = settings.cold_junction_C
        self._local_echo = settings.local_echo
        block = profile.block
        functions = (block.function, block.alternate or block.function)
        self._blocks = itertools.cycle([modbus.Request(f, block.address, block.count) for f in functions])

    def set_up(self) -> None:
        """Write the profile's set-up and hold the device against the profile's checks."""
        for write in self._profile.writes:
            for request in self._writes(write):
                self._ask(request)
                time.sleep(self._profile.timing.setup_s)
        for check in self._profile.checks:
            request = modbus.Request(check.function, check.address, check.count)
            found = _words(request, self._ask(request).payload)
            expected = check.expect * check.count if len(check.expect) == 1 else check.expect
            if found != expected:
                problem = say(
                    "logger-check-differs",
                    place=str(self.bus.place),
                    station=self._station,
                    what=check.what,
                    found=_hex(found),
                    profile=self._profile.name,
                    expected=_hex(expected),
                )
                raise NoReply(problem, Cause.REFUSED)

    def sample(self) -> Sample:
        """Fetch all inputs once."""
        with self.bus.lock:
            request = next(self._blocks)
            reply = self._ask(request)
            flags = self._flags()
        words = _words(request, reply.payload)
        values, qualities = decode(self._profile, self._scaling, words, flags, self._cold_junction)
        return Sample(values, qualities, reply.requested_s, reply.received_s)

    def _flags(self) -> tuple[bool, ...] | None:
        status = self._profile.status_bits
        if status is None:
            return None
        request = modbus.Request(status.function, status.address, self._profile.inputs)
        return modbus.bits(self._ask(request).payload, self._profile.inputs)

    def _ask(self, request: modbus.Request) -> Exchange:
        return self.bus.exchange(*self._framed(request), self.timing)

    def _framed(self, request: modbus.Request) -> tuple[bytes, TakeReply]:
        if not self.bus.numbered:
            take = modbus.rtu_reply(self._station, request, local_echo=self._local_echo)
            return modbus.rtu_frame(self._station, request), take
        transaction = self.bus.next_transaction()
        frame = modbus.tcp_frame(transaction, self._station, request)
        return frame, modbus.tcp_reply(transaction, self._station, request)

    def _writes(self, write: Write) -> list[modbus.Request]:
        data = struct.pack(_PACK[write.format], write.value if write.format == "f32" else int(write.value))
        function = 6 if len(data) == 2 else 16
        inputs = (0,) if write.stride is None else self._used
        stride = write.stride or 0
        return [modbus.Request(function, write.address + k * stride, len(data) // 2, data) for k in inputs]


def _words(request: modbus.Request, payload: bytes) -> tuple[int, ...]:
    """Return registers, or bits as 0 and 1."""
    if request.function in (1, 2):
        return tuple(int(bit) for bit in modbus.bits(payload, request.count))
    return modbus.registers(payload)


def _hex(found: tuple[int, ...]) -> str:
    return " ".join(f"{value:04X}" for value in found)
