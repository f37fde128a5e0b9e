"""Drivers: every thermocouple logger behind one protocol."""

from daq.drivers.opening import SuccessorLogger, open_logger, uncorrected
from daq.drivers.protocol import BadFrame, DataLogger, NoReply, ReadFailure
from daq.drivers.settings import LoggerSettings

__all__ = [
    "BadFrame",
    "DataLogger",
    "LoggerSettings",
    "NoReply",
    "ReadFailure",
    "SuccessorLogger",
    "open_logger",
    "uncorrected",
]
