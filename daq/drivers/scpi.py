"""Scanning multimeters of the 34970A family: every value comes with the number of its channel."""

from __future__ import annotations

import math
import re
import time

from daq.drivers.bus import Bus, Exchange, LineTiming
from daq.drivers.decode import Sample, limited
from daq.drivers.lines import ascii_line, line_reply
from daq.drivers.profile import Profile, Scpi
from daq.drivers.protocol import BadFrame, Cause, NoReply
from daq.records import InputError, Quality
from daq.words import say

_OVERLOAD = 9.9e36
"""The instrument says 9.9E37 for an overload; with the open check on that is a broken wire."""
_NUMBER = re.compile(r"[+-]?\d+\.\d+E[+-]\d{2}")


class ScpiDevice:
    """One instrument; scans the channels in use."""

    def __init__(self, bus: Bus, profile: Profile, *, timing: LineTiming, used: tuple[int, ...]) -> None:
        if profile.scpi is None:
            raise InputError(say("profile-table-missing", profile=profile.name, table="scpi"))
        self.bus = bus
        self.timing = timing
        self._profile = profile
        self._scpi: Scpi = profile.scpi
        self._used = used
        self._channels = tuple(self._scpi.first_channel + k for k in used)

    def set_up(self) -> None:
        """Configure the scan. The format comes last: CONFigure and *RST switch it off again."""
        for command in ("*CLS", "*RST", "*CLS"):  # the first ends whatever lay half sent on the line
            self._send(command)
        name = ascii_line(self._query("*IDN?").payload)
        if self._scpi.model not in name:
            raise NoReply(
                say("logger-other-name", place=str(self.bus.place), found=repr(name), expected=self._scpi.model),
                Cause.REFUSED,
            )
        channels = f"(@{','.join(str(c) for c in self._channels)})"
        for command in (
            f"CONF:TEMP TC,{self._scpi.thermocouple},{channels}",
            f"UNIT:TEMP C,{channels}",
            f"SENS:TEMP:TRAN:TC:RJUN:TYPE INT,{channels}",
            f"SENS:TEMP:TRAN:TC:CHEC ON,{channels}",
            f"SENS:TEMP:NPLC {self._scpi.line_cycles:g},{channels}",
            f"ROUT:SCAN {channels}",
            "FORM:READ:CHAN ON",
            "FORM:READ:TIME OFF",
            "FORM:READ:ALAR OFF",
            "FORM:READ:UNIT OFF",
        ):
            self._send(command)
        fault = ascii_line(self._query("SYST:ERR?").payload)
        if not fault.startswith(("+0", "0")):
            raise NoReply(say("logger-refuses-set-up", place=str(self.bus.place), fault=fault), Cause.REFUSED)

    def sample(self) -> Sample:
        """Scan once."""
        reply = self._query("READ?")
        fields = ascii_line(reply.payload).split(",")
        if len(fields) != 2 * len(self._channels):
            raise BadFrame(
                say("reply-field-count", fields=len(fields), channels=len(self._channels)), Cause.WRONG_SHAPE
            )
        if fields[1::2] != [str(c) for c in self._channels]:
            raise BadFrame(
                say(
                    "reply-other-channels", found=tuple(fields[1::2]), asked=tuple(str(c) for c in self._channels)
                ),
                Cause.WRONG_SHAPE,
            )
        values = [math.nan] * self._profile.inputs
        qualities = [Quality.MISSING] * self._profile.inputs
        for k, text in zip(self._used, fields[::2], strict=True):
            values[k], qualities[k] = self._value(text)
        return Sample(tuple(values), tuple(qualities), reply.requested_s, reply.received_s)

    def _value(self, text: str) -> tuple[float, Quality]:
        if not _NUMBER.fullmatch(text):
            raise BadFrame(say("reply-no-value", reply=repr(text[:20])), Cause.WRONG_SHAPE)
        value = float(text)
        return limited(self._profile, value, Quality.OPEN if abs(value) > _OVERLOAD else Quality.GOOD)

    def _send(self, command: str) -> None:
        self.bus.send(f"{command}\n".encode("ascii"), self.timing)
        time.sleep(self._profile.timing.setup_s)

    def _query(self, command: str) -> Exchange:
        return self.bus.exchange(f"{command}\n".encode("ascii"), line_reply(b"\n"), self.timing)
