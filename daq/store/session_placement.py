"""Scans recorded before the store could say where they belong: they get press, numbers and layout when it can.

A recorder that starts while the store is away (or while an older buffer is still to be written) numbers its
scans from 0 under a session of its own, a negative press number. When the session's first batch is due, the
press is registered and the session's place is noted, durably and once; every batch is moved to that place,
also by a later process that finds the session in the buffer. So a kill at any moment doubles and loses nothing.

A press that the store does not have any more, since another store or an older one is in its place, gets a place
there in the same way: its number in the old store is the session then.
"""

from __future__ import annotations

import time
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from daq.records import Channel
from daq.store.records import PressKey, RunEnd
from daq.store.store import Store
from daq.store.write_batch import WriteBatch

Notes = MutableMapping[int, dict[str, Any]]
"""What is known of each session; a buffer keeps it durably."""


def session_key(notes: Notes, press: str, channels: Sequence[Channel], press_file: str) -> PressKey:
    """Return the key of a new session: scans from 0, their press to be found later."""
    session = min([-time.time_ns(), *(known - 1 for known in notes)])  # a clock stands, or is set back
    notes[session] = _begun(press, channels, press_file)
    return PressKey(session, press, 0, tuple(channels), 0)


@dataclass(frozen=True)
class SessionPlace:
    """Where a session's scans belong."""

    press_id: int
    shift: int
    """What is added to the session's scan numbers."""
    interrupted: tuple[str, ...] = ()
    """Runs that a crash before this session left open."""


def _begun(press: str, channels: Sequence[Channel], press_file: str) -> dict[str, Any]:
    """Return what is noted of a session that is not placed yet."""
    return {"press": press, "channels": [[c.name, c.unit] for c in channels], "press_file": press_file}


class SessionPlacement:
    """Moves write batches to their place in the store."""

    def __init__(self, store: Store, notes: Notes) -> None:
        self._store, self._notes = store, notes
        self.press_files: dict[str, str] = {}
        """By press, for one that has to be registered again."""

    def waits_for_place(self, batch: WriteBatch) -> bool:
        """Whether this is the first batch of a session: all before it must be written before it is placed."""
        return self.is_moved(batch.key) and "press_id" not in self._note(batch.key)

    def forget(self, gone: PressKey) -> None:
        """Have whatever belonged to a press that the store does not have any more placed again.

        Another press may have been placed where this one was.
        """
        press_id, press = gone.press_id, gone.name
        placed = [key for key, note in self._notes.items() if note.get("press_id") == press_id]
        sessions = [key for key in placed if self._notes[key].get("press", press) == press]
        for session in sessions:
            note = self._notes[session]
            self._notes[session] = {k: v for k, v in note.items() if k not in ("press_id", "shift")}
        if not sessions:
            self._notes[press_id] = {"press": press, "channels": None, "press_file": ""}

    def is_moved(self, key: PressKey) -> bool:
        """Whether what has this key gets press and numbers of another one."""
        return key.press_id < 0 or key.press_id in self._notes

    def place(self, key: PressKey) -> SessionPlace:
        """Find a session's place in the store; noted before anything is written there."""
        note = self._note(key)
        if "press_id" in note:
            return SessionPlace(note["press_id"], note["shift"])
        interrupted = self._store.interrupt_open_runs(key.name)
        channels = key.channels if note["channels"] is None else [Channel(*c) for c in note["channels"]]
        press_file = note["press_file"] or self.press_files.get(key.name, "")
        registered = self._store.register_press(key.name, channels, press_file)
        place = SessionPlace(registered.press_id, registered.next_number, tuple(interrupted))
        self._notes[key.press_id] = {**note, "press_id": place.press_id, "shift": place.shift}
        return place

    def _note(self, key: PressKey) -> dict[str, Any]:
        """Return what is known of a session; one whose note a damaged buffer lost begins anew."""
        return self._notes.get(key.press_id, _begun(key.name, key.channels, ""))

    def moved(self, batch: WriteBatch) -> WriteBatch:
        """Return the batch as the store takes it."""
        key, shift = batch.key, 0
        if self.is_moved(key):
            place = self.place(key)
            key, shift = replace(key, press_id=place.press_id), place.shift
        if key is batch.key:
            return batch
        begin, end = batch.begin, batch.end
        return WriteBatch(
            key,
            tuple(replace(scan, number=scan.number + shift) for scan in batch.scans),
            batch.events,
            None if begin is None else replace(begin, first_scan=begin.first_scan + shift),
            None if end is None else _shifted(end, shift),
        )


def _shifted(end: RunEnd, shift: int) -> RunEnd:
    first = None if end.first_scan is None else end.first_scan + shift
    return replace(end, last_scan=end.last_scan + shift, first_scan=first)
