"""Simulated loggers that speak text: ADAM/DCON modules, a 34970A, an SR630.

Written from the device facts alone, sharing no code with the drivers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from daq.records import COLDEST_C
from daq.simulated.devices_converter import COLD_JUNCTION_C, Converter
from daq.thermocouple import compensated, voltage


def _sum(text: str) -> str:
    return f"{sum(map(ord, text)) % 256:02X}"


def _split(buffer: bytearray, end: bytes) -> bytes | None:
    place = buffer.find(end)
    if place < 0:
        return None
    line = bytes(buffer[:place])
    del buffer[: place + 1]
    return line


_XON, _XOFF = b"\x11", b"\x13"
_FLOW = (_XON + _XOFF).decode()


class AdamModule:
    """``#AA`` and ``$AA...`` as ADAM-4000 and I-7000 modules answer them, checksums on."""

    def __init__(self, converter: Converter, *, station: int, name: str, lowest: float, highest: float) -> None:
        self.converter = converter
        self.switches = converter.switches
        self._at = f"{station:02X}"
        self._name = name
        self._range = (lowest, highest)
        self.think_s = 0.001

    def split(self, buffer: bytearray) -> bytes | None:
        """Take one command off the front of the buffer."""
        return _split(buffer, b"\r")

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply; silence on a foreign address, a wrong checksum, or a syntax error."""
        if self.switches.silent:
            return None
        text = request.decode("latin-1")
        if _sum(text[:-2]) != text[-2:]:
            return None
        text = text[:-2]
        if not re.match(r"[#$]", text) or text[1:3] != self._at:
            return None
        reply = f"?{self._at}" if self.switches.busy else self._reply(text[0], text[3:])
        return (reply + _sum(reply) + "\r").encode("latin-1")

    def _reply(self, kind: str, command: str) -> str:
        values = self.converter.read()
        if kind == "#":
            if command == "":
                return ">" + "".join(self._cell(k, v) for k, v in enumerate(values))
            if command.isdigit() and int(command) < len(values):
                return ">" + self._cell(int(command), values[int(command)])
            return f"?{self._at}"
        enabled = sum(1 << k for k in range(len(values)) if k not in self.switches.disabled_inputs)
        answers = {
            "2": "0F0640",
            "M": self._name,
            "F": "A1.00",
            "3": f"{COLD_JUNCTION_C:+07.1f}",
            "6": f"{enabled:02X}",
            "B": f"{self._mask(values):02X}",
        }
        return f"!{self._at}{answers[command]}" if command in answers else f"?{self._at}"

    def _mask(self, values: Sequence[float]) -> int:
        low, high = self._range
        return sum(1 << k for k, v in enumerate(values) if not low <= v <= high)

    def _cell(self, k: int, value: float) -> str:
        if k in self.switches.disabled_inputs:
            return " " * 7
        if math.isnan(value):
            return "+888888"
        low, high = self._range
        if value > high:
            return "+9999"
        if value < low:
            return "-0000"
        return f"{value:+07.1f}"


_REFERENCE_INTERNAL = "SENS:TEMP:TRAN:TC:RJUN:TYPE"
_CHECKS_OPEN = "SENS:TEMP:TRAN:TC:CHEC"
_SHOWS_CHANNEL = "FORM:READ:CHAN"
_TURNED_ON_BY = {_REFERENCE_INTERNAL: "INT", _CHECKS_OPEN: "ON", _SHOWS_CHANNEL: "ON"}
"""What turns a scanning meter's settings on, by the command that sets them."""
_SCAN_IGNORED = frozenset({"UNIT:TEMP", "SENS:TEMP:NPLC", "FORM:READ:TIME", "FORM:READ:ALAR", "FORM:READ:UNIT"})
"""Commands it takes that change nothing here."""


class ScanningMeter:
    """A 34970A or DAQ970A as far as a temperature scan needs it, its traps included.

    After ``*RST`` and ``CONF`` the reference junction is a fixed 0 °C, the check for open inputs
    is off, and readings carry no channel number.
    """

    def __init__(
        self, converter: Converter, *, name: str = "HEWLETT-PACKARD,34970A,0,13-2-2", scan_s: float = 0.05
    ) -> None:
        self.converter = converter
        self.switches = converter.switches
        self._name = name
        self._scan_s = scan_s
        self.think_s = 0.002
        self._reset()

    def _reset(self) -> None:
        self._scan: list[int] = []
        self._on: set[str] = set()
        """Commands whose settings are on."""
        self._errors: list[str] = []

    def split(self, buffer: bytearray) -> bytes | None:
        """Take one command off the front of the buffer."""
        return _split(buffer, b"\n")

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply to a query; commands have none. Power off forgets all settings."""
        if self.switches.silent:
            self._reset()
            return None
        reply = self._reply(request.decode("latin-1").strip(_FLOW).strip().upper())
        if reply is None or not self.switches.flow_control:
            return reply
        half = len(reply) // 2
        return _XOFF + reply[:half] + _XOFF + reply[half:] + _XON

    def _reply(self, command: str) -> bytes | None:
        self.think_s = self._scan_s if command == "READ?" else 0.002
        if command == "*IDN?":
            return (self._name + "\n").encode()
        if command == "SYST:ERR?":
            return ((self._errors.pop(0) if self._errors else '+0,"No error"') + "\n").encode()
        if command == "READ?":
            return (",".join(self._readings()) + "\n").encode() if self._scan else None
        self._obey(command)
        return None

    def _obey(self, command: str) -> None:
        head, _, rest = command.partition(" ")
        if head == "*RST":
            self._reset()
        elif head == "*CLS":
            self._errors.clear()
        elif head == "CONF:TEMP":
            self._on.clear()
        elif head == "ROUT:SCAN":
            self._scan = [int(n) for n in re.findall(r"\d{3}", rest)]
        elif head in _TURNED_ON_BY:
            self._on = self._on | {head} if rest.startswith(_TURNED_ON_BY[head]) else self._on - {head}
        elif head not in _SCAN_IGNORED:
            self._errors.append('-113,"Undefined header"')

    def _readings(self) -> list[str]:
        values = self.converter.read()
        fields = []
        for channel in self._scan:
            fields.append(f"{self._reading(values[channel % 100 - 1]):+.8E}")
            if _SHOWS_CHANNEL in self._on:
                fields.append(str(channel))
        return fields

    def _reading(self, value: float) -> float:
        if math.isnan(value):
            return 9.9e37 if _CHECKS_OPEN in self._on else COLD_JUNCTION_C + 1.7
        if _REFERENCE_INTERNAL in self._on:
            return value
        return float(compensated(voltage(value) - voltage(COLD_JUNCTION_C), 0.0))


class Monitor:
    """An SR630: slow to step from channel to channel."""

    def __init__(self, converter: Converter, *, step_s: float = 0.01) -> None:
        self.converter = converter
        self.switches = converter.switches
        self._step_s = step_s
        self._channel = 1
        self._units = ["ABS"] * converter.inputs
        self.think_s = 0.002

    def split(self, buffer: bytearray) -> bytes | None:
        """Take one command off the front of the buffer."""
        return _split(buffer, b"\r")

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply to a query; commands have none."""
        if self.switches.silent:
            return None
        command, _, rest = request.decode("latin-1").strip().partition(" ")
        self.think_s = 0.002
        reply = self._reply(command, rest)
        return None if reply is None else (reply + "\r\n").encode()

    def _reply(self, command: str, rest: str) -> str | None:
        values = self.converter.read()
        if command == "*IDN?":
            return "StanfordResearchSystems,SR630,12345,1.05"
        if command == "OPEN?":
            return str(sum(1 << k for k, v in enumerate(values) if math.isnan(v)))
        if command == "UNIT":
            channel, unit = rest.split(",")
            self._units[int(channel) - 1] = unit
        if command == "MEAS?":
            return self._measure(int(rest), values)
        return None

    def _measure(self, channel: int, values: Sequence[float]) -> str:
        if channel != self._channel:
            self._channel, self.think_s = channel, self._step_s
        value = values[channel - 1]
        shown = 0.0 if math.isnan(value) else value
        return f"{shown if self._units[channel - 1] == 'CENT' else shown - COLDEST_C:.1f}"
