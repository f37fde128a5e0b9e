"""One press's part of the `sense` process, kept from ending that of the others."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from daq.store import Store, StoreUnavailable
from daq.supervision import RESTART_S, Pending, unexpected
from daq.words import Message, say, spoken
from softsensor.jobs.run_fits import write_journal

LOG = logging.getLogger("kerntemp.sense")

SINGLY = 4
"""Scans that are passed over singly, one a failure, before it is more than a disturbance: half a second at 10 Hz,
and as many seconds without an estimate. By hand, 2026-11."""

AGAIN_S = 0.5
"""How long a press waits that the store gave or took nothing of. [s]"""


class ScanFollower(Protocol):
    """What follows a press through the store, scan by scan."""

    store: Store
    last: int
    """Newest scan taken."""
    taking: int | None
    """Scan that is being taken; None while something else is done."""
    passed: int
    """All scans up to it are passed over."""
    poisoned: set[int]
    """Scans that are passed over singly."""

    @property
    def problem(self) -> Message | None:
        """What keeps the sensor from saying what it should."""
        ...

    @property
    def name(self) -> str:
        """The press."""
        ...

    @property
    def run(self) -> str:
        """The run that is being pressed; none: empty."""
        ...

    def step(self, now: float) -> bool:
        """Do what there is to do; return whether there was anything."""
        ...


F = TypeVar("F", bound=ScanFollower)


class Guarded(Generic[F]):
    """A press's follower, begun anew after an exception that nobody foresaw: the other presses' sensors go on.

    It begins where the store says, as after a restart. A scan at which it fails a second time is passed over.
    Where it fails further before a scan beyond was taken, all that are there by then are, and the sensor begins
    with the next, as where a recorder was begun in mid-run. A kind of fault is journalled once a run.
    """

    def __init__(self, begin: Callable[[], F]) -> None:
        self._begin = begin
        self.follower = begin()
        self.fault: Message | None = None
        """What nobody foresaw, until a scan beyond it was taken."""
        self.kept_from: Message | None = None
        """Why the store gives or takes nothing of this press now, until it does."""
        self._kept_again = False
        """Whether it did not the time before either."""
        self._pending, self._journalled = Pending(self._journal), set[str]()
        self._failures = 0
        """Since a scan beyond was taken."""
        self._beyond, self._run = -1, ""
        """Newest scan at which it has failed, or that was passed over for it, and the run of that."""
        self._wait_until = -math.inf

    @property
    def problem(self) -> Message | None:
        """What keeps the sensor from saying what it should."""
        return self.fault or self.kept_from or self.follower.problem

    def step(self, now: float) -> bool:
        """Do what there is to do; return whether there was anything.

        Raises
        ------
        StoreUnavailable
            Where the store gives or takes nothing, for all presses or for this one: after `AGAIN_S` it is asked
            again, and whoever holds other presses asks for them meanwhile.
        """
        if now < self._wait_until:
            return False
        try:
            worked = self.follower.step(now)
        except StoreUnavailable as error:
            self._kept_again = self.kept_from is not None
            self.kept_from, self._wait_until = spoken(error), now + AGAIN_S
            raise
        except Exception as error:  # noqa: BLE001 - one press's fault must not end the others
            self._wait_until = now + RESTART_S
            self._failed(error)
            return False
        self.kept_from = None
        if self.follower.last > self._beyond:
            self.fault, self._failures = None, 0
            if self.follower.run != self._run:
                self._journalled.clear()
        self._pending.hand_over()
        return worked

    def report_kept(self) -> None:
        """Journal, once, what again keeps this press from going on while the store serves the others."""
        if self._kept_again and self.kept_from is not None and str(self.kept_from) not in self._journalled:
            self._journalled.add(str(self.kept_from))
            self._journal(self.kept_from)

    def _failed(self, error: Exception) -> None:
        before, self.follower = self.follower, self._begin()
        self.follower.passed, self.follower.poisoned = before.passed, before.poisoned
        self.fault, self._run = say("of-press", press=before.name, what=unexpected(error)), before.run
        if (kind := type(error).__name__) not in self._journalled:
            self._journalled.add(kind)
            self._pending.add(self.fault)
            LOG.error("%s", self.fault, exc_info=error)
        self._beyond = max(self._beyond, before.last)
        if before.taking is not None:
            self._pass_over(before.taking)
        self._pending.hand_over()

    def _pass_over(self, scan: int) -> None:
        """Leave out what fails again and again, beginning with a single scan."""
        self._failures += 1
        self._beyond = max(self._beyond, scan)
        if 1 < self._failures <= 1 + SINGLY:
            self.follower.poisoned.add(scan)
        elif self._failures > 1:
            follower = self.follower
            follower.passed = self._beyond = follower.store.newest_scan_number(follower.name)

    def _journal(self, fault: Message) -> None:
        try:
            write_journal(self.follower.store, "alarm", fault, self.follower.name)
        except StoreUnavailable:
            raise
        except Exception:  # what the journal will never take stands in the log, and the sensor goes on
            LOG.exception("journal")
