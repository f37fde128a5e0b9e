"""Registers and status of a device turned into temperatures and what each is worth. No I/O."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq import thermocouple
from daq.drivers.profile import REGISTERS, Field16, Format, Profile, Scaling
from daq.records import Array, Quality

_CODES = {"s16": "h", "u16": "H", "s32": "i", "u32": "I", "f32": "f"}
_NO_VALUE = (Quality.OPEN, Quality.OVER, Quality.UNDER, Quality.MISSING, Quality.BAD_FRAME)


@dataclass(frozen=True)
class Sample:
    """What one request brought, for every input of the device."""

    values: tuple[float, ...]
    """[°C], NaN where there is none."""
    qualities: tuple[Quality, ...]
    requested_s: float
    received_s: float


def number(words: Sequence[int], form: Format, word_order: str = "big", byte_order: str = "big") -> float:
    """Return one raw value from its registers.

    >>> number((0xFFFF,), "s16"), number((0x0000, 0x41C8), "f32", word_order="little")
    (-1.0, 25.0)
    """
    ordered = words if word_order == "big" else tuple(reversed(words))
    each = ">H" if byte_order == "big" else "<H"
    data = b"".join(struct.pack(each, word) for word in ordered)
    return float(struct.unpack(">" + _CODES[form], data)[0])


def raw_values(words: Sequence[int], field: Field16, inputs: int) -> list[float]:
    """Return the raw value of every input."""
    size = REGISTERS[field.format]
    starts = [field.at + k * field.step for k in range(inputs)]
    return [number(words[s : s + size], field.format, field.word_order, field.byte_order) for s in starts]


def decode(
    profile: Profile,
    scaling: Scaling,
    words: Sequence[int],
    flags: Sequence[bool] | None = None,
    cold_junction: float | None = None,
) -> tuple[tuple[float, ...], tuple[Quality, ...]]:
    """Return temperature and quality of every input of a Modbus device.

    Parameters
    ----------
    profile, scaling
        How the device writes.
    words
        Registers of the block, unsigned.
    flags
        Status bits, where the device has them.
    cold_junction
        Terminal temperature for bare voltages where the profile does not derive it. [°C]
    """
    if profile.values is None:
        raise ValueError(f"profile {profile.name} has no register values")
    raw = raw_values(words, profile.values, profile.inputs)
    physical = [r * scaling.factor + scaling.offset for r in raw]
    celsius = _celsius(profile, physical, words, cold_junction)
    half_count = 0.5 * abs(scaling.factor) if profile.values.unit == "C" else 0.0
    status = _status(profile, words, flags, celsius, half_count)
    qualities = [_judge(profile, r, s) for r, s in zip(raw, status, strict=True)]
    pairs = [limited(profile, v, q, half_count) for v, q in zip(celsius, qualities, strict=True)]
    return tuple(v for v, _ in pairs), tuple(q for _, q in pairs)


def limited(profile: Profile, celsius: float, quality: Quality, half_count: float = 0.0) -> tuple[float, Quality]:
    """Return value and quality, the value NaN where it is none, outside the limits over or under.

    A device that clips shows the limit itself, to half a count. [K]
    """
    if quality in _NO_VALUE:
        return math.nan, quality
    if math.isnan(celsius):
        return math.nan, Quality.MISSING
    if (end := _beyond(profile, celsius, half_count if profile.limits.clips else -1e-9)) is not Quality.GOOD:
        return math.nan, end
    return celsius, quality


def out_of_range(profile: Profile, celsius: float, half_count: float = 0.0) -> Quality:
    """Return what a flag of open or out of range means for a value: over or under at an end, else open."""
    end = _beyond(profile, celsius, half_count)
    return Quality.OPEN if end is Quality.GOOD else end


def _beyond(profile: Profile, celsius: float, reach: float) -> Quality:
    if celsius >= profile.limits.upper_C - reach:
        return Quality.OVER
    return Quality.UNDER if celsius <= profile.limits.lower_C + reach else Quality.GOOD


def _status(
    profile: Profile,
    words: Sequence[int],
    flags: Sequence[bool] | None,
    celsius: Sequence[float],
    half_count: float,
) -> list[Quality]:
    bits = profile.status_bits
    if bits and flags is not None:
        flagged = [
            out_of_range(profile, value, half_count) if bits.quality == "range" else bits.quality
            for value in celsius
        ]
        return [quality if flag else Quality.GOOD for quality, flag in zip(flagged, flags, strict=False)]
    if profile.status_codes:
        codes = profile.status_codes
        found = words[codes.at : codes.at + profile.inputs]
        return [codes.codes.get(str(c), Quality.GOOD if c == 0 else Quality.MISSING) for c in found]
    return [Quality.GOOD] * profile.inputs


def _judge(profile: Profile, raw: float, status: Quality) -> Quality:
    """Weigh code and status: either may say open, which is the gravest."""
    if status is Quality.OPEN:
        return status
    for error in profile.errors:
        hit = raw == error.raw or (math.isnan(raw) and math.isnan(error.raw))
        if hit and (status is not Quality.GOOD or not error.with_status):
            return error.quality
    return status


def _celsius(
    profile: Profile, physical: Sequence[float], words: Sequence[int], cold_junction: float | None
) -> list[float]:
    unit = profile.values.unit if profile.values else "C"
    if unit in ("C", "F", "K"):
        return [thermocouple.celsius_of(v, unit) for v in physical]
    millivolt = np.array(physical) / (1e3 if unit == "uV" else 1.0)
    cold = _cold_junction(profile, millivolt, words, cold_junction)
    found = thermocouple.compensated(millivolt, cold)
    beyond = np.isnan(found) & np.isfinite(cold) & np.isfinite(millivolt)  # no temperature gives that
    return [float(v) for v in np.where(beyond, np.copysign(np.inf, millivolt), found)]


def _cold_junction(profile: Profile, millivolt: Array, words: Sequence[int], setting: float | None) -> float:
    rule = profile.cold_junction
    if rule is None or rule.kind == "setting" or rule.temperatures is None:
        return math.nan if setting is None else setting
    reported = np.array(raw_values(words, rule.temperatures, profile.inputs)) * rule.scale
    implied = thermocouple.implied_cold_junction(millivolt, reported)
    sane = implied[(implied > -40) & (implied < 100)]
    return float(np.median(sane)) if sane.size else math.nan
