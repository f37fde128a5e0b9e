"""From a settings table to a logger ready to read."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial

from daq.drivers.bus import Bus, LineTiming, release_bus, share_bus
from daq.drivers.calibration import corrector, read_calibrations
from daq.drivers.dcon import DconDevice
from daq.drivers.link import Place, SerialPlace, SocketPlace, socket_of
from daq.drivers.modbus_device import ModbusDevice
from daq.drivers.polled import Correct, Device, PolledLogger
from daq.drivers.profile import Profile, profile_for
from daq.drivers.protocol import Cause, DataLogger, NoReply
from daq.drivers.scpi import ScpiDevice
from daq.drivers.settings import LoggerSettings
from daq.drivers.sr630 import Sr630Device
from daq.records import Channel, InputError, Reading
from daq.words import Message, say, spoken


def open_logger(settings: LoggerSettings) -> DataLogger:
    """Return the logger these settings describe.

    Reads profile and calibration files, so what is wrong there is raised now as InputError; a calibration
    file that is not there yet corrects nothing (`uncorrected` says so). The port is opened by the first
    `read`: a logger that is off does not keep others from starting.
    """
    return _opened(settings, profile_for(settings), _correction(settings))


def _opened(settings: LoggerSettings, profile: Profile, correct: Correct | None) -> DataLogger:
    bus = share_bus(place_of(settings, profile), numbered=_numbered(settings, profile))
    try:
        return _on_bus(settings, profile, correct, bus)
    except InputError:
        release_bus(bus)
        raise


def _correction(settings: LoggerSettings) -> Correct | None:
    if settings.calibration is None or uncorrected(settings):
        return None
    return corrector(read_calibrations(settings.calibration), settings.channels, datetime.now(UTC).date())


def _on_bus(settings: LoggerSettings, profile: Profile, correct: Correct | None, bus: Bus) -> PolledLogger:
    device = _device(settings, profile, bus)
    return PolledLogger(device, settings, profile.timing, correct=correct, release=release_bus)


def uncorrected(settings: LoggerSettings) -> Message | None:
    """Return a remark on a calibration file that nobody has made yet; None where there is one."""
    if settings.calibration is None or settings.calibration.exists():
        return None
    return say("logger-uncorrected", logger=settings.name, file=str(settings.calibration))


def _numbered(settings: LoggerSettings, profile: Profile) -> bool:
    return profile.protocol == "modbus" and _transport(settings) == "tcp"


class SuccessorLogger:
    """A logger that takes over from one still running: it opens its port once that one has let go.

    Files are read now, for what they are on may hang by then. Raises InputError for what is wrong in profile,
    calibration file or settings.
    """

    def __init__(self, settings: LoggerSettings) -> None:
        profile, correct = profile_for(settings), _correction(settings)
        place = place_of(settings, profile)
        trial = _on_bus(settings, profile, correct, Bus(place, numbered=_numbered(settings, profile)))
        self._open = partial(_opened, settings, profile, correct)
        self._channels = trial.channels
        self._logger: DataLogger | None = None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The inputs in use, in the order `read` reports them."""
        return self._channels

    def read(self) -> Reading:
        """Wait for the next reading. Raises NoReply or BadFrame."""
        if self._logger is None:
            try:
                self._logger = self._open()
            except InputError as error:
                raise NoReply(spoken(error), Cause.IN_USE) from error
        return self._logger.read()

    def close(self) -> None:
        """Release the port."""
        if self._logger is not None:
            self._logger.close()


def place_of(settings: LoggerSettings, profile: Profile) -> Place:
    """Return where the device is found."""
    if settings.host is not None:
        return SocketPlace(settings.host, settings.tcp_port or profile.tcp_port)
    if settings.port is not None and (place := socket_of(settings.port)):
        return place
    line = profile.serial
    baud = settings.baud or (line.baud if line else None)
    if settings.port is None or baud is None:
        raise InputError(say("logger-needs-baud", logger=settings.name))
    return SerialPlace(
        settings.port,
        baud,
        settings.parity or (line.parity if line else "N"),
        settings.stop_bits or (line.stop_bits if line else 1),
        settings.data_bits or (line.data_bits if line else 8),
        line.xonxoff if line else False,
    )


def _transport(settings: LoggerSettings) -> str:
    return settings.transport or ("tcp" if settings.host else "rtu")


def line_timing_of(settings: LoggerSettings, profile: Profile) -> LineTiming:
    """Return the waits that hold for this logger."""
    timeout_s = settings.timeout_s or profile.timing.response_s
    drain_s = settings.drain_s or profile.timing.drain_s or max(timeout_s, profile.timing.response_s)
    return LineTiming(timeout_s, drain_s, profile.timing.turnaround_s)


def _device(settings: LoggerSettings, profile: Profile, bus: Bus) -> Device:
    timing = line_timing_of(settings, profile)
    station = settings.address if settings.address is not None else profile.address
    if profile.protocol == "modbus":
        return ModbusDevice(bus, profile, station=station or 0, timing=timing, settings=settings)
    if profile.protocol == "dcon":
        guarded = bool(settings.checksum)
        return DconDevice(bus, profile, station=station or 0, timing=timing, with_checksum=guarded)
    if profile.protocol == "scpi":
        return ScpiDevice(bus, profile, timing=timing, used=settings.used)
    return Sr630Device(bus, profile, timing=timing, used=settings.used)
