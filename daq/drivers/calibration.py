"""Offset and gain of every channel, dated; the file keeps the whole history.

    [[calibration]]
    channel = "top_3"
    date = 2026-03-01
    gain = 1.0
    offset_K = -0.42          # true temperature = gain x reading + offset
    reference = "mercury thermometer 17, room"

What was measured on a day is corrected by the newest entry of that day or before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import date
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from daq.records import InputError
from daq.tables import at, explained, load_toml, text_in
from daq.words import say

LARGEST_OFFSET_K, SMALLEST_GAIN, LARGEST_GAIN = 50.0, 0.8, 1.25
"""Beyond these it is a fault, no calibration: type J read as type K is off by a factor of 1.27 (51.5 and 40.4 µV/K
at 25 °C, IEC 60584-1), a forgotten cold junction by some 25 K, of which the offset's limit is twice. [K, 1, 1]"""


class Calibration(BaseModel):
    """One entry: what corrects one channel from a day on."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    channel: str = Field(min_length=1)
    date: date
    gain: float = Field(default=1.0, ge=SMALLEST_GAIN, le=LARGEST_GAIN)
    offset_K: float = Field(default=0.0, ge=-LARGEST_OFFSET_K, le=LARGEST_OFFSET_K)  # noqa: N815
    reference: str = ""
    """What the reading was held against."""

    def correct(self, celsius: float) -> float:
        """Return the true temperature of a reading. [°C]"""
        return self.gain * celsius + self.offset_K


def read_calibrations(path: Path) -> tuple[Calibration, ...]:
    """Return the history, oldest first."""
    table = load_toml(path, say("file-of-calibrations"))
    entries = table.pop("calibration", [])
    if table or not isinstance(entries, list):
        raise InputError(at(path, say("calibration-other-tables", found=tuple(table))))
    return tuple(sorted((_entry(path, n, e) for n, e in enumerate(entries, 1)), key=lambda c: c.date))


def _entry(path: Path, number: int, table: object) -> Calibration:
    try:
        return Calibration.model_validate(table)
    except ValidationError as error:
        problem = say("calibration-entry", number=number, what=explained(error, Calibration))
        raise InputError(at(path, problem)) from None


def append_calibrations(path: Path, entries: Iterable[Calibration]) -> None:
    """Add entries to the file's end, or leave it as it was."""
    before = text_in(path) if path.exists() else ""
    text = before + "".join(_written(entry) for entry in entries)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(path.suffix + ".part")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def _written(entry: Calibration) -> str:
    quoted = entry.reference.replace("\\", "\\\\").replace('"', '\\"')
    return (
        f'\n[[calibration]]\nchannel = "{entry.channel}"\ndate = {entry.date.isoformat()}\n'
        f'gain = {entry.gain!r}\noffset_K = {entry.offset_K!r}\nreference = "{quoted}"\n'
    )


def in_force(history: Sequence[Calibration], channel: str, day: date) -> Calibration | None:
    """Return the entry that corrects `channel` on `day`, or None; of two of one day the later in the file."""
    known = [entry for entry in history if entry.channel == channel and entry.date <= day]
    return max(reversed(known), key=lambda entry: entry.date, default=None)


def corrector(history: Sequence[Calibration], names: Sequence[str], day: date) -> Callable[[int, float], float]:
    """Return what turns input number and reading into a true temperature on `day`."""
    entries = tuple(in_force(history, name, day) if name else None for name in names)

    def correct(k: int, celsius: float) -> float:
        entry = entries[k]
        return celsius if entry is None else entry.correct(celsius)

    return correct
