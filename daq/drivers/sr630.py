"""Stanford Research SR630: one query a channel, no channel in the reply.

Sixteen bare numbers could slip by one without anybody noticing. So each scan ends with ``*IDN?``:
only when the name of the instrument comes exactly in its place do the numbers count.
"""

from __future__ import annotations

import re
import time

from daq.drivers.bus import Bus, Exchange, LineTiming
from daq.drivers.decode import Sample, limited
from daq.drivers.lines import ascii_line, line_reply
from daq.drivers.profile import Profile
from daq.drivers.protocol import BadFrame, Cause, NoReply
from daq.records import Quality
from daq.words import say

_NUMBER = re.compile(r"[+-]?\d{1,4}\.\d{1,4}(E[+-]?\d{1,2})?")
_MODEL = "SR630"


class Sr630Device:
    """The instrument with its sixteen inputs."""

    def __init__(self, bus: Bus, profile: Profile, *, timing: LineTiming, used: tuple[int, ...]) -> None:
        self.bus = bus
        self.timing = timing
        self._profile = profile
        self._used = used

    def set_up(self) -> None:
        """Make sure it is an SR630 and that it reads Celsius."""
        self.bus.send(b"\r", self.timing)  # ends half a command that somebody else left in its buffer
        self._in_step()
        for k in self._used:
            self.bus.send(f"UNIT {k + 1},CENT\r".encode("ascii"), self.timing)
            time.sleep(self._profile.timing.setup_s)

    def sample(self) -> Sample:
        """Ask channel by channel, then for the open inputs, then for the name."""
        inputs = self._profile.inputs
        with self.bus.lock:
            replies = {k: self._query(f"MEAS? {k + 1}") for k in self._used}
            flags = ascii_line(self._query("OPEN?").payload).strip()
            self._in_step()
        if not re.fullmatch(r"\d{1,5}", flags):
            raise BadFrame(say("reply-no-open-mask", reply=repr(flags)), Cause.WRONG_SHAPE)
        values = [float("nan")] * inputs
        qualities = [Quality.MISSING] * inputs
        for k, reply in replies.items():
            is_open = bool(int(flags) >> k & 1)
            quality = Quality.OPEN if is_open else Quality.GOOD
            values[k], qualities[k] = limited(self._profile, _number(reply), quality)
        first, last = replies[self._used[0]], replies[self._used[-1]]
        return Sample(tuple(values), tuple(qualities), first.requested_s, last.received_s)

    def _in_step(self) -> None:
        name = ascii_line(self._query("*IDN?").payload)
        if re.fullmatch(r"[\s\d.+\-E]*", name):
            raise BadFrame(say("reply-out-of-step", reply=repr(name)), Cause.OUT_OF_STEP)
        if _MODEL not in name:
            raise NoReply(
                say("logger-other-name", place=str(self.bus.place), found=repr(name), expected=_MODEL),
                Cause.REFUSED,
            )

    def _query(self, command: str) -> Exchange:
        return self.bus.exchange(f"{command}\r".encode("ascii"), line_reply(b"\r\n"), self.timing)


def _number(reply: Exchange) -> float:
    text = ascii_line(reply.payload).strip()
    if not _NUMBER.fullmatch(text):
        raise BadFrame(say("reply-no-value", reply=repr(text[:20])), Cause.WRONG_SHAPE)
    return float(text)
