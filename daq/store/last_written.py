"""What a writer knows of each press's newest scan and run in the store: a store that lacks them has gone back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

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


class WrittenSoFar(Mapping[int, LastWritten]):
    """What was written of each press, by its number in the store."""

    def __init__(self) -> None:
        self._last: dict[int, LastWritten] = {}

    def __getitem__(self, press_id: int) -> LastWritten:
        return self._last[press_id]

    def __iter__(self) -> Iterator[int]:
        return iter(self._last)

    def __len__(self) -> int:
        return len(self._last)

    def add(self, batches: Iterable[WriteBatch]) -> None:
        """Note what was written now."""
        for batch in batches:
            press_id = batch.key.press_id
            self._last[press_id] = self._last.get(press_id, LastWritten(-1)).with_batch(batch)

    def ends_before(self, batch: WriteBatch) -> None:
        """Note that the store should have all that came before a batch with scans, and perhaps no more."""
        last = self._last.get(batch.key.press_id, LastWritten(-1))
        self._last[batch.key.press_id] = replace(last, scan=batch.scans[0].number - 1)

    def forget(self, press_id: int) -> None:
        """Know nothing of a press any more."""
        self._last.pop(press_id, None)

    def lacking(self, there: Mapping[int, int]) -> Iterator[tuple[int, range]]:
        """Yield by press which scans were written and are not there, for the newest of each that was there."""
        for press_id, newest in there.items():
            lost = range(newest + 1, self._last.get(press_id, LastWritten(-1)).scan + 1)
            if lost:
                yield press_id, lost
                self._last[press_id] = replace(self._last[press_id], scan=newest)
