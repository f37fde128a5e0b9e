"""Checks before the first pressing: does every channel read room temperature, and is it itself?

Functions of readings already taken; whoever asks takes them (`collect`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from enum import StrEnum

import numpy as np

from daq.drivers.calibration import Calibration
from daq.drivers.protocol import DataLogger, ReadFailure
from daq.records import Channel, InputError, Quality, Reading
from daq.words import Message, say

# Numbers without another source were set by hand, 2026-11.

OFF_K = 2.5
"""Type K class 1 is good to 1.5 K at room temperature; a logger adds about 1 K."""
NOISY_K = 0.5
"""Standard deviation at rest beyond which a junction is loose or picks up mains."""
WARM_K = 2.0
"""Fingers warm a bare junction by several kelvin; less is draught."""


class RoomVerdict(StrEnum):
    """What a channel is worth at room temperature."""

    OK = "ok"
    OFF = "off"
    NOISY = "noisy"
    NO_VALUE = "no value"

    @property
    def message(self) -> Message:
        """The verdict in words."""
        return say(f"room-check-{self.value.replace(' ', '-')}")


@dataclass(frozen=True)
class RoomCheck:
    """One channel at room temperature."""

    channel: str
    verdict: RoomVerdict
    mean_celsius: float
    deviation_kelvin: float
    """Reading minus reference."""
    noise_kelvin: float
    quality: Quality
    """The worst that was seen."""


@dataclass(frozen=True)
class Warmed:
    """Which channel answered the warm hand."""

    channel: str | None
    """None where no channel rose clearly."""
    rise_kelvin: float
    next_rise_kelvin: float
    """Of the channel that rose second most: 14 sensors on one board warm each other."""


def collect(
    logger: DataLogger,
    count: int,
    *,
    period_s: float = 0.5,
    give_up_s: float = 30.0,
    wait: Callable[[float], None] = time.sleep,
) -> tuple[Reading, ...]:
    """Return `count` readings, gaps left out; the last failure is raised when time runs out."""
    readings: list[Reading] = []
    deadline = time.monotonic() + give_up_s + count * period_s
    while len(readings) < count:
        try:
            readings.append(logger.read())
        except ReadFailure:
            if time.monotonic() > deadline:
                raise
        if len(readings) < count:
            wait(period_s)
    return tuple(readings)


def check_at_room_temperature(
    channels: Sequence[Channel], readings: Sequence[Reading], reference_celsius: float
) -> tuple[RoomCheck, ...]:
    """Return how each channel compares with a thermometer in the room.

    Parameters
    ----------
    channels
        As the logger reports them.
    readings
        Five or more, the sensors lying in still air beside the thermometer.
    reference_celsius
        What the thermometer says. [°C]
    """
    if len(readings) < 2:
        raise InputError(say("room-check-too-few", readings=len(readings)))
    return tuple(_checked(c.name, k, readings, reference_celsius) for k, c in enumerate(channels))


def _checked(name: str, k: int, readings: Sequence[Reading], reference: float) -> RoomCheck:
    bad = [r.qualities[k] for r in readings if not r.qualities[k].usable]
    values = np.array([r.values[k] for r in readings])
    if bad:
        return RoomCheck(name, RoomVerdict.NO_VALUE, math.nan, math.nan, math.nan, bad[0])
    mean, noise = float(values.mean()), float(values.std(ddof=1))
    deviation = mean - reference
    verdict = RoomVerdict.OK
    if abs(deviation) > OFF_K:
        verdict = RoomVerdict.OFF
    elif noise > NOISY_K:
        verdict = RoomVerdict.NOISY
    return RoomCheck(name, verdict, mean, deviation, noise, Quality.GOOD)


def offsets_from_room(checks: Sequence[RoomCheck], day: date, reference: str) -> tuple[Calibration, ...]:
    """Return offsets that bring every sound channel to the reference; those that are off stay out.

    A channel off by more than a thermocouple can be is a fault to mend, not to calibrate away.
    """
    return tuple(
        Calibration(channel=c.channel, date=day, offset_K=round(-c.deviation_kelvin, 3), reference=reference)
        for c in checks
        if c.verdict is RoomVerdict.OK
    )


def warmed_channel(channels: Sequence[Channel], before: Sequence[Reading], after: Sequence[Reading]) -> Warmed:
    """Return the channel that was warmed by hand between two sets of readings.

    The rise is counted against the median channel, so a room that warms does not matter.
    """
    rise = _means(channels, after) - _means(channels, before)
    usable = np.isfinite(rise)
    if not usable.any():
        return Warmed(None, math.nan, math.nan)
    relative = np.where(usable, rise - np.median(rise[usable]), -np.inf)
    order = np.argsort(relative)[::-1]
    first = float(relative[order[0]])
    second = float(relative[order[1]]) if len(order) > 1 and usable[order[1]] else 0.0
    clear = first >= WARM_K and first >= 2 * max(second, 0.0)
    return Warmed(channels[int(order[0])].name if clear else None, first, second)


def _means(channels: Sequence[Channel], readings: Sequence[Reading]) -> np.ndarray:
    rows = [[v if q.usable else math.nan for v, q in zip(r.values, r.qualities, strict=True)] for r in readings]
    table = np.array(rows).reshape(len(rows), len(channels))
    counts = np.isfinite(table).sum(axis=0)
    sums = np.where(np.isfinite(table), table, 0.0).sum(axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
