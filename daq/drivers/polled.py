"""The logger the recorder sees: any device, with set-up, rest, staleness and calibration around it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from daq.drivers.bus import Bus, LineTiming
from daq.drivers.decode import Sample
from daq.drivers.profile import Timing
from daq.drivers.protocol import Cause, NoReply, ReadFailure
from daq.drivers.settings import LoggerSettings
from daq.records import Channel, Quality, Reading
from daq.words import say, spoken

_FAILURES_BEFORE_REST, _FIRST_REST_S = 3, 0.25
"""Failures in a row after which a device rests, and for how long; doubled each time. By hand, 2026-11. [1, s]"""

# Numbers without another source were set by hand, 2026-11.

FOUND_AGAIN_S = 5.0
"""A device that answers again is read again within this time. [s]"""
_LONGEST_REST_S = 0.3 * FOUND_AGAIN_S
"""A silent module costs its bus a timeout and a drain each time: ask it rarely, yet leave time for a
question under way, for connecting and for set-up. [s]"""

_STANDSTILLS_KEPT, _LONGEST_STANDSTILL = 100, 10
"""Standstills of a value from which the usual one is learned; times the profile's limit beyond which none is
natural. By hand, 2026-11."""

Correct = Callable[[int, float], float]
"""Calibration: input and reading in, true temperature out."""


class Device(Protocol):
    """A station on a bus: what differs between protocols."""

    bus: Bus
    timing: LineTiming

    def set_up(self) -> None:
        """Prepare the device and make sure it is the right one."""

    def sample(self) -> Sample:
        """Fetch all inputs once."""


class Standstill:
    """Notices that a converter has stopped: all its values stand still longer than they ever do.

    Coarse values in a calm room stand still by nature, so the standstills of late count, thrice,
    where they are longer than the profile's limit.
    """

    def __init__(self, stale_after_s: float) -> None:
        self._stale_after_s = stale_after_s
        self._natural_s: deque[float] = deque(maxlen=_STANDSTILLS_KEPT)
        self._values: tuple[float, ...] = ()
        self._moved_s = 0.0

    def too_long(self, values: tuple[float, ...], now_s: float) -> bool:
        """Whether `values` have been the same for too long; empty values never have."""
        if values != self._values:
            if self._values:
                self._natural_s.append(now_s - self._moved_s)
            self._values, self._moved_s = values, now_s
        natural_s = 3 * max(self._natural_s, default=0.0)
        limit_s = min(max(self._stale_after_s, natural_s), _LONGEST_STANDSTILL * self._stale_after_s)
        return bool(values) and now_s - self._moved_s > limit_s


class PolledLogger:
    """A DataLogger: asks its device, and gives a silent device rest."""

    def __init__(
        self,
        device: Device,
        settings: LoggerSettings,
        timing: Timing,
        *,
        correct: Correct | None = None,
        release: Callable[[Bus], None],
    ) -> None:
        self._device = device
        self._used = settings.used
        self._channels = tuple(Channel(settings.channels[k], age_s=timing.age_s) for k in self._used)
        self._standstill = Standstill(settings.stale_after_s or timing.stale_after_s)
        self._correct = correct
        self._simulated = settings.simulated
        self._release: Callable[[Bus], None] | None = release
        self._ready_for = 0
        self._failures = 0
        self._rest_until = 0.0
        self._rests_for = NoReply(say("logger-no-answer-yet"), Cause.SILENT)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The inputs in use, in the order `read` reports them."""
        return self._channels

    def read(self) -> Reading:
        """Wait for the next reading.

        Raises NoReply (silence: try again) or BadFrame (noise: drop it).
        """
        if self._release is None:
            raise NoReply(say("logger-closed"), Cause.CLOSED)
        left = self._rest_until - time.monotonic()
        if left > 0:
            raise NoReply(spoken(self._rests_for), self._rests_for.cause)
        try:
            with self._device.bus.lock:
                self._get_ready()
                sample = self._device.sample()
        except ReadFailure as failure:
            self._failed(failure)
            raise
        self._failures = 0
        return self._reading(sample)

    def close(self) -> None:
        """Release the port. A second call does no harm."""
        if self._release is not None:
            self._release(self._device.bus)
            self._release = None

    def _get_ready(self) -> None:
        generation = self._device.bus.open(self._device.timing)
        if self._ready_for != generation:
            self._device.set_up()
            self._ready_for = self._device.bus.generation

    def _failed(self, failure: ReadFailure) -> None:
        if not isinstance(failure, NoReply) or failure.cause is Cause.BUSY:
            return
        self._failures += 1
        self._rests_for = failure
        if self._failures >= _FAILURES_BEFORE_REST:
            self._ready_for = 0
            doublings = min(self._failures - _FAILURES_BEFORE_REST, 8)
            self._rest_until = time.monotonic() + min(_FIRST_REST_S * 2**doublings, _LONGEST_REST_S)

    def _reading(self, sample: Sample) -> Reading:
        measured = [v for v, q in zip(sample.values, sample.qualities, strict=True) if q is Quality.GOOD]
        frozen = self._standstill.too_long(tuple(measured), sample.received_s)
        values, qualities = [], []
        for k in self._used:
            value, quality = sample.values[k], sample.qualities[k]
            if quality is Quality.GOOD:
                quality = Quality.STALE if frozen else Quality.SIMULATED if self._simulated else Quality.GOOD
                value = self._correct(k, value) if self._correct else value
            values.append(value)
            qualities.append(quality)
        return Reading(sample.requested_s, sample.received_s, tuple(values), tuple(qualities))
