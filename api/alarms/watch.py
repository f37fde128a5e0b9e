"""Looks for alarms every other second, keeps them, and sends what waits; all it knows is in the store.

Two threads, so that a receiver who does not answer keeps no alarm from being noticed. Several servers over one
store share the work: a condition is raised once, a delivery is in one hand at a time.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime

from api.alarms.ways import NotDelivered, Way
from api.answers.health import NEVER_SEEN, SILENT_S, standing_alarms
from api.answers.records import utc_now
from daq.records import InputError
from daq.store.alarms import IN_HAND_S
from daq.store.records import StoreUnavailable
from daq.store.store import Store
from daq.supervision import ENDS_S, STALLED_S, StandstillAlarm, Steps, SupervisedThread
from daq.words import Message, say, spoken

LOG = logging.getLogger("kerntemp.serve")
PROCESS = "serve"
LOOK_S = 2.0
"""How often conditions are looked at, small beside any limit of silence. [s]"""
SEND_S = 1.0
"""How often it is looked whether a delivery is due: a fifth of the first wait after one that failed. [s]"""


def look(
    store: Store, ways: Sequence[Way], now: datetime, up_s: float = math.inf, at: datetime | None = None
) -> int:
    """Take up what stands now; return how many alarms are new.

    `at` is the same moment by the clock that servers share, where it is not `now`.

    A process nobody has seen yet is missed only after the watch is up for as long as a process may be silent:
    the whole plant may have been started together with it. [s]
    """
    standing = standing_alarms(store, now)
    if up_s < SILENT_S:
        standing = [alarm for alarm in standing if alarm.message.code != NEVER_SEEN]
    return store.watch_alarms(standing, [way.name for way in ways], at or now)


def send_due(store: Store, ways: Sequence[Way], clock: Callable[[], datetime], steps: Steps | None = None) -> int:
    """Send what is due, one after the other, each in a step; return how many were taken."""
    named, steps = {way.name: way for way in ways}, steps or Steps("deliveries")
    sent, taken = 0, False if named else None
    while taken is not None:
        with steps.step(IN_HAND_S + STALLED_S):
            taken = _send_next(store, named, clock)
        sent += taken is True
    return sent


def _send_next(store: Store, ways: Mapping[str, Way], clock: Callable[[], datetime]) -> bool | None:
    """Send the next alarm that is due; return whether it was taken, None where there is none."""
    delivery = store.take_delivery(list(ways), clock())
    if delivery is None:
        return None
    try:
        ways[delivery.way].deliver(delivery.alarm)
    except NotDelivered as error:
        store.put_off(delivery, str(error), clock())
        if delivery.tries == 1:
            message = say("alarm-not-delivered", way=delivery.way, number=delivery.alarm.number, why=spoken(error))
            store.log("warning", PROCESS, message, delivery.alarm.press)
        return False
    store.delivered(delivery, clock())
    return True


class _AlarmWatch:
    """The two threads, and what is reported of them."""

    def __init__(self, store: Store, ways: Sequence[Way], clock: Callable[[], datetime] | None) -> None:
        self._store, self._ways = store, ways
        self._clock, self._shared = clock or utc_now, clock or store.alarm_clock
        self._began = self._clock()
        self._stop = threading.Event()
        looking, sending = self._looking, self._sending = Steps("alarms"), Steps("deliveries")
        self._standstills = [StandstillAlarm(steps, self._journal) for steps in (looking, sending)]
        self._threads = [
            SupervisedThread(looking.name, lambda: self._every(LOOK_S, self._look), self._journal, looking),
            SupervisedThread(sending.name, lambda: self._every(SEND_S, self._send), self._journal, sending),
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(ENDS_S)

    def stalled(self) -> Message | None:
        """Return why one of the two stands still, or None; of each it is journalled once."""
        found = [standstill.stalled() for standstill in self._standstills]
        return next((why for why in found if why is not None), None)

    def _look(self) -> None:
        now = self._clock()
        with self._looking.step():
            look(self._store, self._ways, now, (now - self._began).total_seconds(), self._shared())

    def _send(self) -> None:
        send_due(self._store, self._ways, self._shared, self._sending)

    def _every(self, seconds: float, work: Callable[[], object]) -> None:
        """Work until the end; what keeps the store away is logged once."""
        away = None
        while not self._stop.is_set():
            try:
                work()
                away = None
            except (InputError, StoreUnavailable) as error:  # the first: a newer version took the store over
                if spoken(error) != away:
                    LOG.warning("%s", say("store-trying-again", why=spoken(error)))
                away = spoken(error)
            self._stop.wait(seconds)

    def _journal(self, fault: Message) -> None:
        self._store.log("alarm", PROCESS, fault)


@contextmanager
def watching(
    store: Store, ways: Sequence[Way], clock: Callable[[], datetime] | None = None
) -> Iterator[Callable[[], Message | None]]:
    """Watch and send until the block ends; it is given what returns why one of the two stands still, or None.

    What stands is judged by this machine's clock, when an alarm ends or is due by the one that servers share.
    """
    watch = _AlarmWatch(store, ways, clock)
    watch.start()
    try:
        yield watch.stalled
    finally:
        watch.end()
