"""What travels from recorder to store, and how a local buffer keeps it: JSON, every float to the last bit."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import groupby
from typing import Any, Literal

from daq.records import Channel, PressEvent, PressEventKind, Quality, Scan
from daq.store.convert import header_of, header_text
from daq.store.records import NewRun, PressKey, RunEnd, RunStatus


@dataclass(frozen=True)
class Parcel:
    """What belongs into one transaction: scans, then what they brought about."""

    key: PressKey
    scans: tuple[Scan, ...] = ()
    events: tuple[PressEvent, ...] = ()
    begin: NewRun | None = None
    end: RunEnd | None = None


def in_rows(parcels: Sequence[Parcel]) -> list[Parcel]:
    """Join neighbouring parcels of one press that bring nothing but scans: one insertion takes them all."""
    joined: list[Parcel] = []
    for (key, plain), neighbours in groupby(parcels, lambda p: (p.key, not (p.events or p.begin or p.end))):
        group = list(neighbours)
        joined += [Parcel(key, tuple(scan for p in group for scan in p.scans))] if plain else group
    return joined


@dataclass(frozen=True)
class Entry:
    """A line for the journal."""

    level: Literal["info", "warning", "alarm"]
    process: str
    message: str
    press: str | None = None
    detail: Mapping[str, Any] | None = None
    unix_s: float = field(default_factory=time.time)
    """When it happened; it may be written much later."""


def encode(item: Parcel | Entry) -> str:
    """Write a parcel or journal line as JSON."""
    if isinstance(item, Entry):
        return json.dumps(
            {"entry": [item.level, item.process, item.message, item.press, item.detail, item.unix_s]},
            default=str,
        )
    key = item.key
    return json.dumps(
        {
            "key": [
                key.press_id,
                key.name,
                key.layout_id,
                [[c.name, c.unit] for c in key.channels],
                key.next_number,
            ],
            "scans": [_scan(scan) for scan in item.scans],
            "events": [[e.kind.value, e.monotonic_s, e.noticed_s, e.source] for e in item.events],
            "begin": None if item.begin is None else _begin(item.begin),
            "end": None
            if item.end is None
            else [item.end.run, item.end.last_scan, item.end.ended_utc.isoformat(), item.end.status.value],
        }
    )


def _scan(scan: Scan) -> list[Any]:
    values = [None if v != v else v for v in scan.values]
    return [scan.number, scan.utc.isoformat(), scan.monotonic_s, values, [q.value for q in scan.qualities]]


def _begin(new: NewRun) -> list[Any]:
    started = new.started_utc.isoformat()
    return [new.run, new.first_scan, started, new.zero_monotonic_s, header_text(new.header), new.configuration]


def decode(text: str) -> Parcel | Entry:
    """Read what `encode` wrote."""
    tree = json.loads(text)
    if "entry" in tree:
        return Entry(*tree["entry"])
    press_id, name, layout_id, channels, number = tree["key"]
    begin, end = tree["begin"], tree["end"]
    return Parcel(
        key=PressKey(press_id, name, layout_id, tuple(Channel(*c) for c in channels), number),
        scans=tuple(
            Scan(
                n,
                datetime.fromisoformat(utc),
                monotonic_s,
                tuple(float("nan") if v is None else v for v in values),
                tuple(Quality(q) for q in qualities),
            )
            for n, utc, monotonic_s, values, qualities in tree["scans"]
        ),
        events=tuple(PressEvent(PressEventKind(k), *rest) for k, *rest in tree["events"]),
        begin=None
        if begin is None
        else NewRun(begin[0], begin[1], datetime.fromisoformat(begin[2]), begin[3], header_of(begin[4]), begin[5]),
        end=None if end is None else RunEnd(end[0], end[1], datetime.fromisoformat(end[2]), RunStatus(end[3])),
    )
