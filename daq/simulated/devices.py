"""Simulated loggers, by the name of the profile that reads them.

>>> with simulated("adam-4118", lambda now_s: [20.0] * 8, transport="tcp") as server:
...     sorted(server.place)
['host', 'tcp_port']
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from daq.records import InputError
from daq.simulated import modbus
from daq.simulated.ascii import AdamModule, Monitor, ScanningMeter
from daq.simulated.devices_converter import Converter, Switches, Temperatures
from daq.simulated.devices_line import Server, Station, serve_serial, serve_tcp
from daq.words import say

Transport = Literal["serial", "tcp", "rtu_over_tcp"]


@dataclass(frozen=True)
class DeviceKind:
    """One device that can be simulated."""

    inputs: int
    refresh_s: float
    transport: Transport
    """What it has in life."""
    build: Callable[[Converter, int, bool], Station]
    """Converter, station address, whether on Modbus TCP."""
    settings: Mapping[str, Any]
    """What the logger's settings must add to profile and place."""


def _modbus(encode: modbus.Encode, writable: Callable[[int], bool] = lambda address: False) -> Any:
    def build(converter: Converter, station: int, tcp: bool) -> Station:
        return modbus.ModbusModule(encode, converter, station=station, tcp=tcp, writable=writable)

    return build


def _labjack_setup(address: int) -> bool:
    return any(first <= address < first + 64 for first in (9000, 9300, 40000, 41000))


def _adam(name: str, lowest: float, highest: float) -> Any:
    def build(converter: Converter, station: int, tcp: bool) -> Station:
        return AdamModule(converter, station=station, name=name, lowest=lowest, highest=highest)

    return build


def _meter(name: str) -> Any:
    return lambda converter, station, tcp: ScanningMeter(converter, name=name)


KINDS: Mapping[str, DeviceKind] = {
    "adam-4118": DeviceKind(8, 0.8, "serial", _modbus(modbus.encode_adam_4118), {}),
    "adam-4018+": DeviceKind(
        8, 0.8, "serial", _modbus(modbus.encode_adam_4018_hundredth), {"scaling": "hundredth"}
    ),
    "m-7018": DeviceKind(
        8,
        0.8,
        "serial",
        _modbus(modbus.encode_m7018_engineering),
        {"scaling": "engineering", "baud": 9600, "address": 1},
    ),
    "m-7019r": DeviceKind(
        8,
        0.8,
        "serial",
        _modbus(modbus.encode_m7019r_hex),
        {"scaling": "hex", "baud": 9600, "address": 1},
    ),
    "adam-4118-ascii": DeviceKind(8, 0.8, "serial", _adam("4118", 0.0, 1370.0), {"checksum": True}),
    "m-7019r-dcon": DeviceKind(
        8,
        0.8,
        "serial",
        _adam("7019R", -270.0, 1372.0),
        {"checksum": True, "baud": 9600, "address": 1},
    ),
    "34970a": DeviceKind(16, 0.0, "serial", _meter("HEWLETT-PACKARD,34970A,0,13-2-2"), {"baud": 9600}),
    "daq970a": DeviceKind(16, 0.0, "rtu_over_tcp", _meter("Keysight Technologies,DAQ970A,MY1,A.03.01"), {}),
    "sr630": DeviceKind(16, 0.0, "serial", lambda converter, station, tcp: Monitor(converter), {}),
    "labjack-t7": DeviceKind(16, 0.0, "tcp", _modbus(modbus.encode_labjack_t7, _labjack_setup), {}),
    "sequent-smtc": DeviceKind(8, 0.8, "serial", _modbus(modbus.encode_smtc), {"address": 1}),
    "exemys-rme1-tc": DeviceKind(8, 1.0, "tcp", _modbus(modbus.encode_rme1), {}),
    "adam-6018+": DeviceKind(8, 0.8, "tcp", _modbus(modbus.encode_adam_6018), {}),
    "generic": DeviceKind(
        16,
        0.8,
        "tcp",
        _modbus(modbus.encode_sixteen),
        {
            "address": 1,
            "scaling": "tenth",
            "override": {
                "inputs": 16,
                "block": {"function": 3, "address": 0, "count": 16},
                "values": {"format": "s16"},
                "errors": [{"raw": 32767, "quality": "open"}],
            },
        },
    ),
}


def station(
    profile: str,
    temperatures: Temperatures,
    *,
    address: int = 1,
    transport: Transport | None = None,
    refresh_s: float | None = None,
    clock: Callable[[], float] = time.monotonic,
    switches: Switches | None = None,
) -> Station:
    """Return a device that is not on a line yet; give several to `serve_serial` for one bus."""
    kind = kind_of(profile)
    pace = kind.refresh_s if refresh_s is None else refresh_s
    converter = Converter(temperatures, kind.inputs, pace, clock=clock, switches=switches)
    return kind.build(converter, address, (transport or kind.transport) == "tcp")


def simulated(
    profile: str,
    temperatures: Temperatures,
    *,
    address: int = 1,
    transport: Transport | None = None,
    refresh_s: float | None = None,
    clock: Callable[[], float] = time.monotonic,
    switches: Switches | None = None,
) -> Server:
    """Start one simulated device on a line of its own.

    Parameters
    ----------
    profile
        Name of the profile that reads it.
    temperatures
        True temperatures of its inputs at a time of `clock`. [s -> °C]
    address
        Station on the bus.
    transport
        None: what the device has in life.
    refresh_s
        Time to convert all inputs once; None: the device's own, 0: at every request. [s]
    clock
        Time base of `temperatures` and of the converter. [s]
    switches
        Faults to turn on and off while it runs.
    """
    wire = transport or kind_of(profile).transport
    device = station(
        profile,
        temperatures,
        address=address,
        transport=wire,
        refresh_s=refresh_s,
        clock=clock,
        switches=switches,
    )
    return serve_serial(device) if wire == "serial" else serve_tcp(device)


def kind_of(profile: str) -> DeviceKind:
    """Return what is simulated under this profile's name."""
    if profile not in KINDS:
        raise InputError(say("simulated-no-device", profile=profile, known=tuple(sorted(KINDS))))
    return KINDS[profile]


def wiring(
    profile: str, server: Server, name: str, channels: tuple[str, ...], *, address: int = 1
) -> dict[str, Any]:
    """Return the settings table that reads a simulated device."""
    table: dict[str, Any] = {"name": name, "profile": profile, "channels": list(channels)}
    table |= dict(kind_of(profile).settings) | dict(server.place)
    if address != 1:
        table["address"] = address
    return table
