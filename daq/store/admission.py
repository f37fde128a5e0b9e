"""Scans recorded before the store could say where they belong: they get press, numbers and layout when it can.

A recorder that starts while the store is away (or while an older buffer is still to be written) numbers its
scans from 0 under a session of its own, a negative press number. When the session's first parcel is due, the
press is registered and the session's place is noted, durably and once; every parcel is moved to that place,
also by a later process that finds the session in the buffer. So a kill at any moment doubles and loses nothing.
"""

from __future__ import annotations

import time
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from daq.records import Channel
from daq.store.parcels import Parcel
from daq.store.records import PressKey
from daq.store.store import Store

Notes = MutableMapping[int, dict[str, Any]]
"""What is known of each session; a buffer keeps it durably."""


def session_key(notes: Notes, press: str, channels: Sequence[Channel], press_file: str) -> PressKey:
    """Return the key of a new session: scans from 0, their press to be found later."""
    session = -time.time_ns()
    notes[session] = {"channels": [[c.name, c.unit] for c in channels], "press_file": press_file}
    return PressKey(session, press, 0, tuple(channels), 0)


@dataclass(frozen=True)
class Place:
    """Where a session's scans belong."""

    press_id: int
    shift: int
    """What is added to the session's scan numbers."""
    interrupted: tuple[str, ...] = ()
    """Runs that a crash before this session left open."""


class Admission:
    """Moves parcels to their place in the store."""

    def __init__(self, store: Store, notes: Notes) -> None:
        self._store, self._notes = store, notes
        self._layouts: dict[tuple[int, tuple[Channel, ...]], int] = {}

    def waits_for_place(self, parcel: Parcel) -> bool:
        """Whether this is the first parcel of a session: all before it must be written before it is placed."""
        return parcel.key.press_id < 0 and "press_id" not in self._notes[parcel.key.press_id]

    def place(self, key: PressKey) -> Place:
        """Find a session's place in the store; noted before anything is written there."""
        note = self._notes[key.press_id]
        if "press_id" in note:
            return Place(note["press_id"], note["shift"])
        interrupted = self._store.interrupt_open_runs(key.name)
        channels = [Channel(*c) for c in note["channels"]]
        registered = self._store.register_press(key.name, channels, note["press_file"])
        place = Place(registered.press_id, registered.next_number, tuple(interrupted))
        self._notes[key.press_id] = {**note, "press_id": place.press_id, "shift": place.shift}
        return place

    def moved(self, parcel: Parcel) -> Parcel:
        """Return the parcel as the store takes it."""
        key, shift = parcel.key, 0
        if key.press_id < 0:
            place = self.place(key)
            key, shift = replace(key, press_id=place.press_id), place.shift
        if key.layout_id == 0:
            key = replace(key, layout_id=self._layout(key))
        if key is parcel.key:
            return parcel
        begin, end = parcel.begin, parcel.end
        return Parcel(
            key,
            tuple(replace(scan, number=scan.number + shift) for scan in parcel.scans),
            parcel.events,
            None if begin is None else replace(begin, first_scan=begin.first_scan + shift),
            None if end is None else replace(end, last_scan=end.last_scan + shift),
        )

    def _layout(self, key: PressKey) -> int:
        known = (key.press_id, key.channels)
        if known not in self._layouts:
            self._layouts[known] = self._store.layout_of(key.press_id, key.name, key.channels)
        return self._layouts[known]
