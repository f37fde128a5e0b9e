"""Simulated Modbus modules: register images as the vendors describe them, and their own framing.

Written from the device facts alone and sharing no code with the drivers, so that an error there
cannot cancel itself here.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.simulated.devices_converter import COLD_JUNCTION_C, Converter
from daq.thermocouple import voltage

Words = dict[int, int]
Bits = dict[int, bool]
_TYPE_K = 0x0F
"""Type code of a K input, of ICP DAS and Advantech alike."""
RESET_FLAG = 272
"""ICP DAS coil 00273: set at the first reading after power-on, then clear."""


@dataclass(frozen=True)
class Image:
    """What a master can read from a module at one moment."""

    words: Words
    bits: Bits = field(default_factory=dict)


Encode = Callable[[Sequence[float], Mapping[int, int]], Image]
"""Temperatures (NaN: broken wire) and registers written so far, to the image."""


def _clipped(value: float, low: int, high: int) -> int:
    return int(min(max(round(value), low), high)) & 0xFFFF


def _signed(
    values: Sequence[float], per_degree: float, broken: int, at: int = 0, ends: tuple[int, int] = (-32768, 32767)
) -> Words:
    return {at + k: broken if math.isnan(v) else _clipped(v * per_degree, *ends) for k, v in enumerate(values)}


def _broken(values: Sequence[float], at: int = 0) -> Bits:
    return {at + k: math.isnan(v) for k, v in enumerate(values)}


def encode_adam_4118(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """0 to 1370 °C on 0 to 7FFF; a broken wire drives the input to full scale."""
    words = {k: 0x7FFF if math.isnan(v) else _clipped(v / 1370 * 32767, 0, 32767) for k, v in enumerate(values)}
    words |= {200 + k: _TYPE_K for k in range(8)} | {210: 0x4118, 211: 0, 212: 0xA100, 213: 0, 220: 0xFF}
    return Image(words, _broken(values))


def encode_adam_4018_hundredth(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """The field project's reading of the ADAM-4018+: hundredths of a degree."""
    return Image(_signed(values, 100, 0x7FFF), _broken(values))


def encode_m7018_engineering(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """Tenths, ending at -270 and 1372 °C; a broken wire reads 7FFF (M-7018R); one type code for all inputs."""
    words = _signed(values, 10, 0x7FFF, ends=(-2700, 13720)) | {486: _TYPE_K}
    return _icp_das(words, {})


def encode_m7019r_hex(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """-270 to 1372 °C on E6D0 to 7FFF; a broken wire reads 7FFF; a type code and a status bit for each input."""
    words = _signed(values, 32767 / 1372, 0x7FFF, ends=(0xE6D0 - 0x10000, 0x7FFF))
    return _icp_das(
        words | {256 + k: _TYPE_K for k in range(8)},
        {128 + k: not -270.0 <= v <= 1372.0 for k, v in enumerate(values)},
    )


def _icp_das(words: Words, bits: Bits) -> Image:
    return Image(words | {128: round(COLD_JUNCTION_C * 100)}, bits | {256: True, RESET_FLAG: True})


def encode_smtc(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """Hundredths, then bare microvolts against the terminals."""
    inside = np.clip(values, -270.0, 1372.0)  # what lies outside no junction shows, but a wrong wire does
    emf = voltage(inside) + 0.04 * (np.array(values) - inside)
    microvolt = [float(v) for v in 1000 * (emf - voltage(COLD_JUNCTION_C))]
    return Image(_signed(values, 100, 0x7FFF) | _signed(microvolt, 1, 0x7FFF, at=8))


def encode_rme1(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """Tenths and a status register each: 0 normal, 1 low, 2 high."""
    status = {8 + k: 2 if math.isnan(v) or v > 1372 else 1 if v < -270 else 0 for k, v in enumerate(values)}
    return Image(_signed(values, 10, 13720) | status | {200 + k: 3 for k in range(8)})


def encode_adam_6018(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """0 to 1370 °C on 0 to FFFF."""
    words = {k: 0xFFFF if math.isnan(v) else _clipped(v / 1370 * 65535, 0, 65535) for k, v in enumerate(values)}
    return Image(words)


def encode_labjack_t7(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """Floats; an input not yet configured for type K in Celsius answers -9999."""
    words: Words = {60000: 0x40E0, 60001: 0}
    for k, v in enumerate(values):
        configured = written.get(9001 + 2 * k) == 22 and written.get(9301 + 2 * k) == 1
        shown = v if configured and not math.isnan(v) else -9999.0
        words[7000 + 2 * k], words[7001 + 2 * k] = struct.unpack(">HH", struct.pack(">f", shown))
    return Image(words)


def encode_sixteen(values: Sequence[float], written: Mapping[int, int]) -> Image:
    """No particular maker: 16 registers of tenths, 7FFF for a broken wire."""
    return Image(_signed(values, 10, 0x7FFF))


class ModbusModule:
    """A module with a station address, on RTU or TCP."""

    def __init__(
        self,
        encode: Encode,
        converter: Converter,
        *,
        station: int = 1,
        tcp: bool = False,
        think_s: float = 0.001,
        writable: Callable[[int], bool] = lambda address: False,
    ) -> None:
        self.converter = converter
        self.switches = converter.switches
        self._encode = encode
        self._station = station
        self._tcp = tcp
        self.think_s = think_s
        self._writable = writable
        self._written: dict[int, int] = {}
        self._reset_reported = False

    def split(self, buffer: bytearray) -> bytes | None:
        """Take one request off the front of the buffer."""
        return _split_tcp(buffer) if self._tcp else _split_rtu(buffer)

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply, or None for silence: not ours, damaged, or off, which forgets all settings."""
        if self.switches.silent:
            self._written.clear()
            self._reset_reported = False
            return None
        if self._tcp:
            if request[6] != self._station:
                return None
            pdu = self._answer(request[7:])
            return request[:4] + struct.pack(">H", len(pdu) + 1) + request[6:7] + pdu
        if request[0] != self._station or checksum(request[:-2]) != request[-2:]:
            return None
        body = request[:1] + self._answer(request[1:-2])
        return body + checksum(body)

    def _answer(self, pdu: bytes) -> bytes:
        function, address = struct.unpack(">BH", pdu[:3])
        if self.switches.busy:
            return bytes([function | 0x80, 6])
        image = self._encode(self.converter.read(), self._written)
        if function in (1, 2, 3, 4):
            count = struct.unpack(">H", pdu[3:5])[0]
            if function in (1, 2) and address <= RESET_FLAG < address + count and RESET_FLAG in image.bits:
                image.bits[RESET_FLAG] = not self._reset_reported
                self._reset_reported = True
            return _read(image, function, address, count)
        if function in (6, 16):
            return self._write(function, address, pdu)
        return bytes([function | 0x80, 1])

    def _write(self, function: int, address: int, pdu: bytes) -> bytes:
        data = pdu[3:5] if function == 6 else pdu[6:]
        values = struct.unpack(f">{len(data) // 2}H", data)
        if not all(self._writable(address + k) for k in range(len(values))):
            return bytes([function | 0x80, 2])
        self._written |= {address + k: v for k, v in enumerate(values)}
        return pdu[:5]


def _read(image: Image, function: int, address: int, count: int) -> bytes:
    span = range(address, address + count)
    known: Mapping[int, int] = image.bits if function in (1, 2) else image.words
    if not 1 <= count <= 125 or any(k not in known for k in span):
        return bytes([function | 0x80, 2])
    if function in (1, 2):
        data = bytearray((count + 7) // 8)
        for place, k in enumerate(span):
            data[place // 8] |= bool(image.bits[k]) << (place % 8)
    else:
        data = bytearray(b"".join(struct.pack(">H", image.words[k] & 0xFFFF) for k in span))
    return bytes([function, len(data)]) + bytes(data)


def _split_tcp(buffer: bytearray) -> bytes | None:
    if len(buffer) < 7:
        return None
    size = 6 + int.from_bytes(buffer[4:6], "big")
    if len(buffer) < size:
        return None
    frame = bytes(buffer[:size])
    del buffer[:size]
    return frame


def _split_rtu(buffer: bytearray) -> bytes | None:
    """Find the next frame whose checksum fits; noise before it is dropped, as silence would do."""
    while len(buffer) >= 8:
        size = 9 + buffer[6] if buffer[1] in (15, 16) else 8
        if len(buffer) < size:
            return None
        if checksum(buffer[: size - 2]) == buffer[size - 2 : size]:
            frame = bytes(buffer[:size])
            del buffer[:size]
            return frame
        del buffer[0]
    return None


_TABLE = tuple((lambda c: [c := (c >> 1) ^ (0xA001 if c & 1 else 0) for _ in range(8)][-1])(n) for n in range(256))


def checksum(data: bytes | bytearray) -> bytes:
    """Return the two bytes that seal an RTU frame."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc.to_bytes(2, "little")
