"""What travels from recorder to store, and how a local buffer keeps it: JSON, every float to the last bit."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import datetime
from itertools import groupby
from typing import Any, Literal

from daq.records import Channel, EventSource, PressEvent, PressEventKind, Quality, Scan
from daq.store.convert import header_of, header_text
from daq.store.records import NewRun, PressKey, RunEnd, RunStatus
from daq.words import Message, spoken


@dataclass(frozen=True)
class WriteBatch:
    """What belongs into one transaction: scans, then what they brought about."""

    key: PressKey
    scans: tuple[Scan, ...] = ()
    events: tuple[PressEvent, ...] = ()
    begin: NewRun | None = None
    end: RunEnd | None = None


def in_rows(batches: Sequence[WriteBatch]) -> list[WriteBatch]:
    """Join neighbouring write batches of one press that bring nothing but scans: one insertion takes them all."""
    joined: list[WriteBatch] = []
    for (key, plain), neighbours in groupby(batches, lambda p: (p.key, not (p.events or p.begin or p.end))):
        group = list(neighbours)
        joined += [WriteBatch(key, tuple(scan for p in group for scan in p.scans))] if plain else group
    return joined


def in_parts(batch: WriteBatch) -> Iterator[tuple[WriteBatch, ...]]:
    """Yield the parts of a batch the store does not take whole, each with what to try where it fails too."""
    key, scans, begin = batch.key, batch.scans, batch.begin
    if scans:
        yield (WriteBatch(key, scans),)
    if begin is not None:
        cleaned = replace(begin, header=dict(_writable(begin.header)))
        bare = replace(begin, header={}, configuration="")
        yield tuple(WriteBatch(key, begin=one) for one in (begin, cleaned, bare))
    for event in batch.events:
        yield (WriteBatch(key, scans, (event,)),)
    if batch.end is not None:
        yield (WriteBatch(key, end=batch.end),)


def _writable(header: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield a header's keys without those whose values cannot be written, such as a number of 5000 digits."""
    for name, value in header.items():
        with suppress(ValueError, TypeError):
            header_text({name: value})
            yield name, _cleaned(value)


def _cleaned(value: Any) -> Any:
    """Return a text without what no server keeps: NUL, halves of characters."""
    if not isinstance(value, str):
        return value
    return value.replace("\0", "\ufffd").encode("utf-8", "replace").decode()


Level = Literal["info", "warning", "alarm"]


@dataclass(frozen=True)
class Entry:
    """A line for the journal."""

    level: Level
    process: str
    message: Message
    press: str | None = None
    detail: Mapping[str, Any] | None = None
    unix_s: float = field(default_factory=time.time)
    """When it happened; it may be written much later."""


def encode_item(item: WriteBatch | Entry) -> str:
    """Write a batch or journal line as JSON."""
    if isinstance(item, Entry):
        return json.dumps(
            {"entry": [item.level, item.process, item.message.to_json(), item.press, item.detail, item.unix_s]},
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
            "end": None if item.end is None else _end(item.end),
        }
    )


def item_in_words(item: object) -> str:
    """Return an item for a person to read, also one that `encode_item` cannot write."""
    if isinstance(item, WriteBatch | Entry):
        with suppress(ValueError, TypeError):
            return encode_item(item)
    return _shown(item)


def _shown(value: object) -> str:
    """Return a value as Python shows it; a whole number too long for that by its hexadecimal digits."""
    with suppress(ValueError):
        return repr(value)
    if isinstance(value, int):
        return hex(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {_shown(one)}" for name, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_shown(one) for one in value) + "]"
    if is_dataclass(value):
        return f"{type(value).__name__}(" + ", ".join(_shown(getattr(value, f.name)) for f in fields(value)) + ")"
    return object.__repr__(value)


def _scan(scan: Scan) -> list[Any]:
    values = [None if v != v else v for v in scan.values]
    return [scan.number, scan.utc.isoformat(), scan.monotonic_s, values, [q.value for q in scan.qualities]]


def _begin(new: NewRun) -> list[Any]:
    started = new.started_utc.isoformat()
    return [new.run, new.first_scan, started, new.zero_monotonic_s, header_text(new.header), new.configuration]


def _end(end: RunEnd) -> list[Any]:
    return [end.run, end.last_scan, end.ended_utc.isoformat(), end.status.value, end.first_scan]


def decode_item(text: str) -> WriteBatch | Entry:
    """Read what `encode_item` wrote."""
    tree = json.loads(text)
    if "entry" in tree:
        level, process, message, *rest = tree["entry"]
        english = isinstance(message, str)  # in older buffers
        return Entry(level, process, spoken(message) if english else Message.from_json(message), *rest)
    press_id, name, layout_id, channels, number = tree["key"]
    begin, end = tree["begin"], tree["end"]
    return WriteBatch(
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
        events=tuple(
            PressEvent(PressEventKind(k), at, noticed, EventSource(by)) for k, at, noticed, by in tree["events"]
        ),
        begin=None
        if begin is None
        else NewRun(begin[0], begin[1], datetime.fromisoformat(begin[2]), begin[3], header_of(begin[4]), begin[5]),
        end=None
        if end is None
        else RunEnd(end[0], end[1], datetime.fromisoformat(end[2]), RunStatus(end[3]), *end[4:]),
    )
