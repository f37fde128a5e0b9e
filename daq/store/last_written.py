"""What a writer knows of each press's newest scan and run in the store: a store that lacks them has gone back.

A file beside a recorder's buffer keeps it, so that a later process knows it too. What the file has is never more
than what was written: it may be some seconds old, lost or of another store, and less is known then.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from daq.store.buffer_file import opened, sealed
from daq.store.write_batch import WriteBatch


@dataclass(frozen=True)
class LastWritten:
    """The newest scan written of a press, and the first of the run under way; None where none is known."""

    scan: int
    run: int | None = None

    def with_batch(self, batch: WriteBatch) -> LastWritten:
        """Return what was written once a batch was too."""
        run = self.run if batch.begin is None else batch.begin.first_scan
        if batch.end is not None and batch.end.first_scan in (None, run):
            run = None
        return LastWritten(max([self.scan, *(scan.number for scan in batch.scans)]), run)


class WrittenSoFar(Mapping[str, LastWritten]):
    """What was written of each press, by its name; also by an earlier process that kept it in a file."""

    def __init__(self, file: Path | None = None, store: str = "") -> None:
        self._file, self._store = file, store
        self._last = {} if file is None else _read(file, store)
        self._kept = dict(self._last)
        self._keeping: threading.Thread | None = None

    def __getitem__(self, press: str) -> LastWritten:
        return self._last[press]

    def __iter__(self) -> Iterator[str]:
        return iter(self._last)

    def __len__(self) -> int:
        return len(self._last)

    def add(self, batches: Iterable[WriteBatch]) -> None:
        """Note what was written now."""
        for batch in batches:
            press = batch.key.name
            self._last[press] = self._last.get(press, LastWritten(-1)).with_batch(batch)

    def keep(self) -> None:
        """Keep it for a later process, beside other work: a disk that hangs holds up no server.

        A later process that finds an older state of it, as on a full disk, knows less.
        """
        if self._file is None or self._last == self._kept or (self._keeping and self._keeping.is_alive()):
            return
        self._keeping = threading.Thread(target=self._put, args=(self._file, dict(self._last)), daemon=True)
        self._keeping.start()

    def keep_last(self) -> None:
        """Keep it at the end, and wait for the disk."""
        self._wait()
        self.keep()
        self._wait()

    def _wait(self) -> None:
        if self._keeping is not None:
            self._keeping.join()

    def _put(self, to: Path, what: Mapping[str, LastWritten]) -> None:
        presses = {press: [last.scan, last.run] for press, last in what.items()}
        part = to.with_name(f"{to.name}.part")
        with suppress(OSError):
            with part.open("w", encoding="utf-8") as file:
                file.write(sealed(json.dumps({"store": self._store, "presses": presses})))
                file.flush()
                os.fsync(file.fileno())
            part.replace(to)
            self._kept = dict(what)

    def ends_before(self, batch: WriteBatch) -> None:
        """Note that the store should have all that came before a batch with scans, and perhaps no more."""
        last = self._last.get(batch.key.name, LastWritten(-1))
        self._last[batch.key.name] = replace(last, scan=batch.scans[0].number - 1)

    def forget(self, press: str) -> None:
        """Know nothing of a press any more."""
        self._last.pop(press, None)

    def lacking(self, there: Mapping[str, int]) -> Iterator[tuple[str, range]]:
        """Yield by press which scans were written and are not there, for the newest of each that was there."""
        for press, newest in there.items():
            lost = range(newest + 1, self._last.get(press, LastWritten(-1)).scan + 1)
            if lost:
                yield press, lost
                self._last[press] = replace(self._last[press], scan=newest)


def _read(file: Path, store: str) -> dict[str, LastWritten]:
    """Return what a file has of a store: nothing where it is of another one, damaged or not there."""
    try:
        tree = json.loads(opened(file.read_text(encoding="utf-8")))
        there = tree["presses"].items() if tree["store"] == store else ()
        return {press: LastWritten(int(scan), run) for press, (scan, run) in there}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
