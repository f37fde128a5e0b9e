"""Looks for alarms every other second, keeps them, and sends what waits; all it knows is in the store.

Two threads, so that a receiver who does not answer keeps no alarm from being noticed. Several servers over one
store share the work: a condition is raised once, a delivery is in one hand at a time.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime

from api.alarms.ways import NotDelivered, Way
from api.answers.health import NEVER_SEEN, SILENT_S, standing_alarms
from api.answers.records import utc_now
from daq.store.records import StoreUnavailable
from daq.store.store import Store
from daq.supervision import SupervisedThread
from daq.words import Message, say, spoken

LOG = logging.getLogger("kerntemp.serve")
PROCESS = "serve"
LOOK_S = 2.0
"""How often conditions are looked at, small beside any limit of silence. [s]"""
SEND_S = 1.0
"""How often it is looked whether a delivery is due: a fifth of the first wait after one that failed. [s]"""


def look(store: Store, ways: Sequence[Way], now: datetime, up_s: float = math.inf) -> int:
    """Take up what stands now; return how many alarms are new.

    A process nobody has seen yet is missed only after the watch is up for as long as a process may be silent:
    the whole plant may have been started together with it. [s]
    """
    standing = standing_alarms(store, now)
    if up_s < SILENT_S:
        standing = [alarm for alarm in standing if alarm.message.code != NEVER_SEEN]
    return store.watch_alarms(standing, [way.name for way in ways], now)


def _look_since(began: datetime, store: Store, ways: Sequence[Way], now: datetime) -> int:
    return look(store, ways, now, (now - began).total_seconds())


def send_due(store: Store, ways: Sequence[Way], clock: Callable[[], datetime]) -> int:
    """Send what is due, one after the other; return how many were taken."""
    named = {way.name: way for way in ways}
    sent = 0
    while named and (delivery := store.take_delivery(list(named), clock())):
        try:
            named[delivery.way].deliver(delivery.alarm)
        except NotDelivered as error:
            store.put_off(delivery, str(error), clock())
            if delivery.tries == 1:
                said = say("alarm-not-delivered", way=delivery.way, number=delivery.alarm.number, why=str(error))
                store.log("warning", PROCESS, said, delivery.alarm.press)
            continue
        store.delivered(delivery, clock())
        sent += 1
    return sent


@contextmanager
def watching(store: Store, ways: Sequence[Way], clock: Callable[[], datetime] = utc_now) -> Iterator[None]:
    """Watch and send until the block ends."""
    stop, began = threading.Event(), clock()

    def every(seconds: float, work: Callable[[], object]) -> Callable[[], None]:
        def run() -> None:
            while not stop.is_set():
                try:
                    work()
                except StoreUnavailable as error:
                    LOG.info("%s", say("store-trying-again", why=spoken(error)))
                stop.wait(seconds)

        return run

    def tell(fault: Message) -> None:
        store.log("alarm", PROCESS, fault)

    threads = [
        SupervisedThread("alarms", every(LOOK_S, lambda: _look_since(began, store, ways, clock())), tell),
        SupervisedThread("deliveries", every(SEND_S, lambda: send_due(store, ways, clock)), tell),
    ]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join(5.0)
