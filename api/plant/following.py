"""What the store holds beyond a position, in order and as messages for other systems.

One list for each press and kind: `scan`, `estimate`, `event`. The `number` in every message counts up in its
list, so a receiver knows what it has, and a sender that was away goes on where it stopped.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from api.answers.decimation import number_or_none
from api.answers.present import STATE_AFTER
from daq.records import Channel, Quality, Scan
from daq.store.records import ModelRecord, StoredEstimate, StoredPressEvent
from daq.store.store import Store

KINDS = ("scan", "estimate", "event")
BATCH = 200
"""Most messages of one kind at a time."""
MOST_BEHIND = 1_000_000
"""Scans a list goes back at most, a day at 10 Hz; what is older is in the store."""
REMEMBERED = 5000
"""Scans whose time is kept, so that an estimate can say when it was true."""

Place = tuple[str, str]
"""Press and kind."""


@dataclass(frozen=True)
class Outgoing:
    """One message: `number` is its place in the list of its press and kind."""

    press: str
    kind: str
    number: int
    body: Mapping[str, Any]


@dataclass
class Following:
    """Reads on from a position; `arrived` moves it."""

    store: Store
    position: dict[Place, int] = field(default_factory=dict)
    _times: OrderedDict[tuple[str, int], datetime] = field(default_factory=OrderedDict)

    def start(self, known: Mapping[Place, int]) -> None:
        """Begin after what is known to have arrived; an unknown list begins now.

        A number the store does not reach belongs to another store: that list begins now, too.
        """
        for press in self.store.presses():
            for kind in KINDS:
                newest, place = self._newest(press, kind), (press, kind)
                arrived = known.get(place, newest)
                self.position[place] = max(arrived, newest - MOST_BEHIND) if arrived <= newest else newest

    def waiting(self) -> list[Outgoing]:
        """Return the next messages of every list, oldest first within each."""
        for press in self.store.presses():
            if (press, "scan") not in self.position:  # a press that was recorded for the first time
                self.position |= {(press, "scan"): -1, (press, "estimate"): -1, (press, "event"): 0}
        return [m for place, number in list(self.position.items()) for m in self._after(place, number)]

    def message(self, place: Place, number: int) -> Outgoing | None:
        """Return the message of a list that has a number, None where the store has none."""
        following = self._after(place, number - 1) if number > 0 or place[1] != "event" else []
        return next((m for m in following[:1] if m.number == number), None)

    def _after(self, place: Place, number: int) -> list[Outgoing]:
        read = {"scan": self._scans, "estimate": self._estimates, "event": self._events}
        return read[place[1]](place[0], number)

    def arrived(self, message: Outgoing) -> None:
        """Note that a message has arrived."""
        self.position[message.press, message.kind] = message.number

    def _newest(self, press: str, kind: str) -> int:
        if kind == "scan":
            return self.store.newest_scan_number(press)
        if kind == "estimate":
            return self.store.newest_estimate_number(press)
        newest = 0
        while events := self.store.press_events(press, after=newest):
            newest = events[-1].number
        return newest

    def _scans(self, press: str, after: int) -> list[Outgoing]:
        batch = self.store.scans_after(press, after, BATCH)
        for scan in batch.scans:
            self._times[press, scan.number] = scan.utc
        while len(self._times) > REMEMBERED:
            self._times.popitem(last=False)
        return [Outgoing(press, "scan", s.number, scan_body(press, batch.channels, s)) for s in batch.scans]

    def _estimates(self, press: str, after: int) -> list[Outgoing]:
        found = self.store.estimates_after(press, after, BATCH)
        return [Outgoing(press, "estimate", e.number, estimate_body(press, e, self._utc(press, e))) for e in found]

    def _events(self, press: str, after: int) -> list[Outgoing]:
        found = self.store.press_events(press, after=after, limit=BATCH)
        return [Outgoing(press, "event", e.number, event_body(e)) for e in found]

    def _utc(self, press: str, estimate: StoredEstimate) -> datetime | None:
        known = self._times.get((press, estimate.number))
        if known is not None:
            return known
        scans = self.store.scans_after(press, estimate.number - 1, 1).scans
        return scans[0].utc if scans and scans[0].number == estimate.number else None


def scan_body(press: str, channels: tuple[Channel, ...], scan: Scan) -> dict[str, Any]:
    """Return one scan; qualities are given only where they are not good. Temperatures in °C."""
    names = [channel.name for channel in channels]
    return {
        "press": press,
        "number": scan.number,
        "utc": scan.utc.isoformat(),
        "temperatures_C": {n: number_or_none(v) for n, v in zip(names, scan.values, strict=True)},
        "qualities": {n: str(q) for n, q in zip(names, scan.qualities, strict=True) if q is not Quality.GOOD},
    }


def estimate_body(press: str, estimate: StoredEstimate, utc: datetime | None) -> dict[str, Any]:
    """Return one estimate; low and high bound 95 %, and the code `reason` says why `valid` is false."""
    return {
        "press": press,
        "number": estimate.number,
        "utc": None if utc is None else utc.isoformat(),
        "state": str(estimate.state),
        "core_C": number_or_none(estimate.core_celsius),
        "core_sd_K": number_or_none(estimate.core_sd_kelvin),
        "core_low_C": number_or_none(estimate.core_low_celsius),
        "core_high_C": number_or_none(estimate.core_high_celsius),
        "valid": estimate.valid,
        "reason": estimate.reason,
        "reason_arguments": (estimate.detail or {}).get("reason_arguments", {}),
        "model_version": estimate.model_version,
    }


def event_body(event: StoredPressEvent) -> dict[str, Any]:
    """Return one press event and the state the press is in after it."""
    return {
        "press": event.press,
        "number": event.number,
        "event": event.kind,
        "state": STATE_AFTER.get(event.kind, "unknown"),
        "utc": None if event.utc is None else event.utc.isoformat(),
        "scan": event.scan_number,
        "source": event.source,
    }


def model_body(model: ModelRecord) -> dict[str, Any]:
    """Return the model version in force."""
    return {
        "press": model.press,
        "number": model.number,
        "version": model.version,
        "utc": model.created_utc.isoformat(),
        "effects": [str(effect.get("name", effect)) for effect in model.model.get("effects", [])],
        "reason": model.reason,
    }
