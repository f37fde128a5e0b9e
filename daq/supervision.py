"""Threads that are watched: what ends one or holds it up is reported.

An unexpected exception begins the work of a `SupervisedThread` anew. Work that stands still cannot be begun anew
from outside: whoever gives the process's signs of life asks its `Steps`, and gives or withholds them.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Generic, TypeVar

from daq.words import Message, say, spoken

LOG = logging.getLogger("kerntemp")
BEAT_S = 1.0
"""How often a process gives a sign of life. By hand, 2026-11. [s]"""
BEHIND_S = 2.0 * BEAT_S
"""Two signs of life after a process does its work, what that does not need is loaded: at a start all of them are
busy. [s]"""
IN_USE_S = 7 * 86400.0
"""What is unheard of for longer, a press, a machine, a way to people, is taken for gone: a weekend is shorter.
[s]"""

# Numbers without another source were set by hand, 2026-11.

CALM_S = 60.0
"""What comes back within this time has not been over: sensors flicker about a limit, faults come and go. [s]"""
ENDS_S = 10.0
"""A thread that is to end is waited for so long; systemd ends what hangs. [s]"""
SILENT_S = 5.0
"""A press whose newest scan is older is silent: what it shows is not of now, and its recorder looks for the cause.
More than two scans of the slowest recorder, 0.5 Hz. [s]"""
RESTART_S = 1.0
"""Between an exception and the next try: a fault that stays must not fill the journal or a core. [s]"""
STALLED_S = 60.0
"""Longer than any wait the engine allows (watchdog 11 s, another's transaction 10 s, a buffer's lock 5 s). [s]"""


class Steps:
    """Work done step by step: each must end within its time; between two it may rest for as long as it likes.

    Examples
    --------
    >>> steps = Steps("thinning")
    >>> with steps.step(0.0):
    ...     time.sleep(0.01)
    ...     print(steps.stalled() is not None)
    True
    >>> steps.stalled() is None
    True
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.done = 0
        """How many ended well."""
        self._under_way: tuple[float, float] | None = None
        """When the step began and when it is due, None between steps. [s]"""

    @contextmanager
    def step(self, longest_s: float | None = None) -> Iterator[None]:
        """Do one step inside the block, for `STALLED_S` at most unless stated otherwise."""
        now_s = time.monotonic()
        self._under_way = now_s, now_s + (STALLED_S if longest_s is None else longest_s)
        try:
            yield
            self.done += 1
        finally:
            self._under_way = None

    def stalled(self) -> Message | None:
        """Return that a step does not come to its end; None while it may still."""
        under_way, now_s = self._under_way, time.monotonic()
        if under_way is None or now_s <= under_way[1]:
            return None
        return say("thread-stalled", thread=self.name, seconds=now_s - under_way[0])


def unexpected(error: BaseException) -> Message:
    """Return what an exception that nobody foresaw says."""
    return say("unexpected-error", kind=type(error).__name__, error=spoken(error))


T = TypeVar("T")


class Pending(Generic[T]):
    """What is to be journalled: kept until the journal has taken it."""

    def __init__(self, journal: Callable[[T], object]) -> None:
        self._journal = journal
        self._waiting: list[T] = []

    def add(self, item: T) -> None:
        """Keep an item until the journal takes it."""
        self._waiting.append(item)

    def hand_over(self) -> None:
        """Journal what waits, the oldest first; raises what the journal raises."""
        while self._waiting:
            self._journal(self._waiting[0])
            del self._waiting[0]


class Faults:
    """What work meets that nobody foresaw: reported once until all is well again, for `CALM_S` at least.

    All is well when the work says so (`worked`), or a step of `steps` has ended well since.
    """

    def __init__(self, name: str, journal: Callable[[Message], None], steps: Steps | None = None) -> None:
        self.newest: Message | None = None
        """Why the work last ended, until it has gone well again."""
        self._name, self._pending = name, Pending(journal)
        self._steps, self._done = steps, 0
        self._met_s: dict[str, float] = {}
        """When each fault was last met. [s]"""

    def worked(self) -> None:
        """Note that all is well."""
        self.newest = None
        self.hand_over()

    def failed(self, error: BaseException) -> None:
        """Note an exception and report it, once for each that differs from the one before."""
        fault = say("thread-failed", thread=self._name, why=unexpected(error))
        known, self.newest = self.newest, fault
        if self._steps is not None and self._steps.done > self._done:
            known, self._done = None, self._steps.done
        if not self._met_lately(str(fault)) and known != fault:
            LOG.error("%s", fault, exc_info=error)
            self._pending.add(fault)
        self.hand_over()

    def _met_lately(self, fault: str) -> bool:
        now_s = time.monotonic()
        self._met_s = {one: at_s for one, at_s in self._met_s.items() if now_s - at_s < CALM_S}
        lately = fault in self._met_s
        self._met_s[fault] = now_s
        return lately

    def hand_over(self) -> None:
        """Journal the faults not journalled yet; what the journal does not take is reported with the next."""
        try:
            self._pending.hand_over()
        except Exception:
            LOG.exception("journal")


class SupervisedThread:
    """Does its work until it returns; an exception begins it anew, and is reported as `Faults` does."""

    def __init__(
        self,
        name: str,
        work: Callable[[], None],
        journal: Callable[[Message], None],
        steps: Steps | None = None,
    ) -> None:
        self._work, self._faults = work, Faults(name, journal, steps)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._ending = threading.Event()

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def join(self, longest_s: float) -> None:
        """Wait for the end; work that fails now is not begun anew."""
        self._ending.set()
        self._thread.join(longest_s)

    @property
    def alive(self) -> bool:
        """Whether it works."""
        return self._thread.is_alive()

    @property
    def fault(self) -> Message | None:
        """Why the work last ended, until it has gone well again."""
        return self._faults.newest

    def worked(self) -> None:
        """Note that all is well."""
        self._faults.worked()

    def failed(self, error: BaseException) -> None:
        """Note an exception and report it, once for each that differs from the one before."""
        self._faults.failed(error)

    def _run(self) -> None:
        last = False
        while not last:
            last = self._ending.is_set()
            self._faults.hand_over()
            try:
                self._work()
            except BaseException as error:  # noqa: BLE001 - whatever it is, the work must go on
                with suppress(Exception):  # as without memory: the next fault is reported
                    self.failed(error)
                self._ending.wait(RESTART_S)
            else:
                return


class StandstillAlarm:
    """Journals that steps stand still, once while they do, in a thread: they may wait for the journal."""

    def __init__(self, steps: Steps, journal: Callable[[Message], None]) -> None:
        self._steps, self._journal, self._stands = steps, journal, False

    def stalled(self) -> Message | None:
        """Return that a step does not come to its end, and journal it; None while it may still."""
        why = self._steps.stalled()
        if why is not None and not self._stands:
            LOG.error("%s", why)
            SupervisedThread("stalled", lambda: self._journal(why), lambda fault: None).start()
        self._stands = why is not None
        return why
