"""`kerntemp publish`: MQTT and OPC UA in one process, which keeps nothing but its position in the store."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from api.http.tokens import TokenFile
from api.plant.following import Place
from daq.process.config import Config
from daq.process.notify import Notifier
from daq.process.stopping import stop_on_signals
from daq.records import InputError
from daq.store import Store, StoreUnavailable
from daq.store.records import in_status
from daq.store.waiting import RETRY_S, ending_reported, open_when_ready
from daq.supervision import BEAT_S, ENDS_S
from daq.words import Message, say, spoken

LOG = logging.getLogger("kerntemp.publish")
PROCESS = "publish"


def publish(config: Config, tokens: TokenFile, *, stop: threading.Event | None = None) -> None:
    """Feed the plant's systems until stopped by `stop`, SIGTERM or SIGINT.

    Raises
    ------
    InputError
        Where neither ``[mqtt]`` nor ``[opcua]`` is configured, or one of them is wrong.
    """
    if config.mqtt is None and config.opcua is None:
        raise InputError(say("plant-nothing-configured", path=str(config.path)))
    stop = stop or threading.Event()
    stop_on_signals(stop)
    logging.getLogger("asyncua").setLevel(logging.WARNING)  # it logs every request of every client
    store = open_when_ready(config.store.url, stop, LOG)
    if store is None:
        return
    with store, ending_reported(store, PROCESS):
        _Feeds(config, tokens, store, stop).run()


class _Feeds:
    """The feeds, each in a thread of its own, and the sign of life that carries their position."""

    def __init__(self, config: Config, tokens: TokenFile, store: Store, stop: threading.Event) -> None:
        self._config, self._tokens, self._store, self._stop = config, tokens, store, stop
        self._known = _kept_position(store)
        self._mqtt: Any = None
        self._leave: Any = None
        self._opcua: Any = None
        self._failed: list[BaseException] = []

    def run(self) -> None:
        """Start the feeds and beat until stopped."""
        work = [self._feed_mqtt, self._feed_leave] if self._config.mqtt else []
        work += [self._serve_opcua] if self._config.opcua else []
        threads = [threading.Thread(target=self._guarded, args=(w,), name=w.__name__, daemon=True) for w in work]
        for thread in threads:
            thread.start()
        notifier = Notifier()
        notifier.ready("feeding the plant's systems")
        try:
            while not self._stop.wait(BEAT_S):
                stalled = [why for feed in self._feeds if (why := feed.stalled())]
                status = self._beat("running", stalled)
                (notifier.status if stalled else notifier.alive)(status)
        finally:
            notifier.stopping()
            self._stop.set()
            for thread in threads:
                thread.join(ENDS_S)
        self._beat("stopped")
        if self._failed:
            raise self._failed[0]

    def _guarded(self, work: Any) -> None:
        """Run a feed; a store that is away is asked again, any other fault ends the process."""
        while not self._stop.is_set():
            try:
                work()
            except StoreUnavailable as error:
                LOG.warning("%s", say("store-trying-again", why=spoken(error)))
                self._stop.wait(RETRY_S)
            except BaseException as error:  # noqa: BLE001 - reported by the main thread
                self._failed.append(error)
                self._stop.set()

    def _feed_mqtt(self) -> None:
        from api.plant.mqtt import Publisher

        if self._config.mqtt is None:
            return
        known = self._mqtt.position if self._mqtt is not None else self._known
        self._mqtt = Publisher(self._store, self._config.mqtt, known)
        LOG.info("%s", say("plant-feeds-broker", where=f"{self._config.mqtt.host}:{self._config.mqtt.port}"))
        self._mqtt.run(self._stop)

    def _feed_leave(self) -> None:
        from api.plant.leave import LeaveFeed

        if self._config.mqtt is None:
            return
        self._leave = LeaveFeed(self._store, self._config.mqtt)
        self._leave.run(self._stop)

    def _serve_opcua(self) -> None:
        from api.plant.opcua import PressServer, check_settings

        if self._config.opcua is None:
            return
        check_settings(self._config.opcua, self._tokens)
        self._opcua = PressServer(self._store, self._config.opcua, self._tokens)
        asyncio.run(self._opcua.run(self._stop))

    @property
    def _feeds(self) -> list[Any]:
        """Those that have begun."""
        return [feed for feed in (self._mqtt, self._leave, self._opcua) if feed is not None]

    def _beat(self, state: str, stalled: Sequence[Message] = ()) -> str:
        """Write a sign of life; return what it says."""
        problems = [*stalled, *(feed.problem for feed in self._feeds if feed.problem)]
        position = self._mqtt.position if self._mqtt is not None else self._known
        status: dict[str, Any] = {
            "state": state,
            "pid": os.getpid(),
            **in_status(problems, say("plant-messages-sent", messages=self._mqtt.sent if self._mqtt else 0)),
            "position": [[press, kind, number] for (press, kind), number in position.items()],
        }
        if self._opcua is not None:
            status["opcua"] = self._opcua.address
        try:
            self._store.beat(PROCESS, status)
        except StoreUnavailable as error:
            LOG.info("%s", say("plant-no-sign-of-life", why=spoken(error)))
        return str(status["message"])


def _kept_position(store: Store) -> Mapping[Place, int]:
    """Return how far an earlier process came."""
    deadline = time.monotonic() + 60.0
    while True:
        try:
            kept = store.statuses().get(PROCESS)
            break
        except StoreUnavailable:
            if time.monotonic() > deadline:
                raise
            time.sleep(RETRY_S)
    entries = kept.status.get("position", []) if kept is not None else []
    return {(str(press), str(kind)): int(number) for press, kind, number in entries}
