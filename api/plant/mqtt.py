"""Live values, press events, estimates and model version over MQTT.

Topics, each message JSON, quality of service 1, retained (so a newcomer sees the newest at once):

=========================  ==================================================================
``prefix/status``          ``{"state": "online" | "offline", "version", "utc"}``; offline is the last will
``prefix/PRESS/scan``      every scan: ``temperatures_C`` and, where not good, ``qualities``
``prefix/PRESS/estimate``  every estimate: ``core_C`` with ``core_low_C``, ``core_high_C`` (95 %), ``valid``
``prefix/PRESS/event``     ``inserted``, ``closed``, ``opened``, ``removed``, and the ``state`` after it
``prefix/PRESS/model``     the model version in force
``prefix/PRESS/open_now``  whether the press may open now: of the present, not a record; see `api.plant.leave`
=========================  ==================================================================

Records stay what they were at their `utc`, retained or not: a retained estimate does not become old by itself.

After an interruption everything stored meanwhile follows, in order. Where to go on is asked of the broker
itself: its retained message carries the number that really arrived, so nothing is sent twice even if the
answer to it was lost (2026-11-21; a number kept here alone would repeat what was in flight). A broker that
forgot is continued from the position kept in the store; so is one that keeps a message which is not this store's
to the last byte: anybody may have written it, and the journal says so. A broker that drops after it has stored a
message and before it retains it could still see one twice: `number` shows it. What the live sensor fills in
afterwards, for the seconds of an idle press before an insertion it had not seen yet, is in the store alone.
"""

from __future__ import annotations

import json
import math
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from api.answers.health import installed_version
from api.plant.following import KINDS, Following, Outgoing, Place, model_body
from daq.process.config import MqttSettings
from daq.records import InputError
from daq.store.store import Store
from daq.supervision import Steps
from daq.tables import reason_of, text_in
from daq.words import Message, say, spoken

PROCESS = "publish"
QOS = 1
"""At least once: the broker acknowledges, and what is repeated does no harm, for a value replaces a value."""
KEEPALIVE_S = 15
"""The broker sends the last will after one and a half times this. [s]"""
ANSWER_S = 10.0
"""Longest wait for the broker's answer. [s]"""
POLL_S = 0.1
"""How often the store is asked for news while there is none. [s]"""
MODEL_S = 2.0
"""How often the models in force are looked at; one is promoted once a night. [s]"""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 5.0
"""After a try that did not reach the broker, doubled each time up to the second: it is back within seconds. [s]"""
_LOOK_S = 0.05
"""How often a wait for the broker's answer looks whether the line is lost. [s]"""
_KEPT_SIGNS = str.maketrans({"#": "%23", "+": "%2B", "\0": "%00"})


class BrokerAway(ConnectionError):
    """The broker does not answer: try again. The text says what to do."""


@dataclass(frozen=True)
class Will:
    """What the broker sends where a connection ends without goodbye."""

    topic: tuple[str, ...]
    body: Mapping[str, Any]
    client: str = ""
    """What the client identifier ends with: two connections with the same one push each other out."""
    keepalive_s: int = KEEPALIVE_S


@dataclass(frozen=True)
class Retained:
    """What a broker keeps of a list: the number in the message, and the message's sum."""

    number: int
    sum: bytes


class Broker:
    """One connection to the broker: it ends with the first fault, and a new one is made."""

    def __init__(self, settings: MqttSettings, will: Will | None = None) -> None:
        will = will or Will(("status",), {"state": "offline"})
        self._settings, self._keepalive_s = settings, will.keepalive_s
        self._answered = threading.Event()
        self._lost = threading.Event()
        self._reason: Message | None = None
        self._arrived: dict[str, Retained | None] = {}
        """Of the topics asked for, what the broker keeps."""
        self._marker = threading.Event()
        self._client = paho.Client(
            CallbackAPIVersion.VERSION2, client_id=settings.client + will.client, reconnect_on_failure=False
        )
        if settings.user:
            self._client.username_pw_set(settings.user, _password(settings))
        if settings.tls:
            self._client.tls_set(None if settings.certificates is None else str(settings.certificates))
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message
        self._client.will_set(self.topic(*will.topic), json_bytes(will.body), QOS, retain=True)

    def topic(self, *parts: str) -> str:
        """Return a topic below the prefix; signs that MQTT keeps for itself as ``%23`` and ``%2B``."""
        return "/".join((self._settings.prefix, *(part.translate(_KEPT_SIGNS) for part in parts)))

    def open(self) -> None:
        """Connect. Raises `BrokerAway`."""
        where = f"{self._settings.host}:{self._settings.port}"
        try:
            self._client.connect(self._settings.host, self._settings.port, self._keepalive_s)
        except (OSError, ValueError) as error:
            raise BrokerAway(say("plant-broker-unreachable", where=where, why=reason_of(error))) from error
        self._client.loop_start()
        self._wait(self._answered, "plant-broker-not-connected")

    def retained(self, presses: Mapping[str, str]) -> dict[Place, Retained]:
        """Ask the broker what it really keeps of every list. Raises `BrokerAway`."""
        marker = self.topic("status", self._settings.client)
        topics = {self.topic(press, kind): (press, kind) for press in presses for kind in KINDS}
        self._arrived = dict.fromkeys(topics)
        self._client.subscribe([(topic, QOS) for topic in (marker, *topics)])
        self._client.publish(marker, b"", QOS)  # comes back after what was retained
        self._wait(self._marker, "plant-broker-not-subscribed")
        self._client.unsubscribe([marker, *topics])
        found = {place: self._arrived[topic] for topic, place in topics.items()}
        return {place: kept for place, kept in found.items() if kept is not None}

    def send(self, messages: list[tuple[str, bytes]], *, qos: int = QOS, retain: bool = True) -> None:
        """Publish in order and wait until the broker has all of it. Raises `BrokerAway`."""
        sent = [self._client.publish(topic, body, qos, retain=retain) for topic, body in messages]
        deadline = time.monotonic() + ANSWER_S
        for info in sent:
            while info.rc != paho.MQTT_ERR_SUCCESS or not info.is_published():
                if self._lost.is_set() or time.monotonic() > deadline or info.rc != paho.MQTT_ERR_SUCCESS:
                    raise BrokerAway(self._complaint("plant-broker-not-taking"))
                info.wait_for_publish(_LOOK_S)

    def close(self) -> None:
        """Say goodbye and leave. A second call does no harm."""
        self._client.disconnect()
        self._client.loop_stop()

    def abandon(self) -> None:
        """Let the connection go without goodbye, so that the broker sends the last will."""
        line = self._client.socket()
        if isinstance(line, socket.socket):
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)
        self._client.loop_stop()

    def _wait(self, event: threading.Event, code: str) -> None:
        deadline = time.monotonic() + ANSWER_S
        while not event.wait(_LOOK_S):
            if self._lost.is_set() or time.monotonic() > deadline:
                self._client.loop_stop()
                raise BrokerAway(self._complaint(code))

    def _complaint(self, code: str) -> Message:
        where = f"{self._settings.host}:{self._settings.port}"
        return Message(code, {"where": where, "why": self._reason or say("plant-broker-silent")})

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._reason = say("plant-broker-refused", reason=str(reason))
            self._lost.set()
        else:
            self._answered.set()

    def _on_disconnect(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._reason = self._reason or say("connection-lost", reason=str(reason))
        self._lost.set()

    def _on_message(self, client: Any, data: Any, message: paho.MQTTMessage) -> None:
        """Take what the broker sends, of which nothing is sure: number and sum, of topics asked for alone."""
        try:
            topic = message.topic
        except UnicodeDecodeError:  # a fault here would end the library's thread, and nobody would hear of it
            return
        if message.retain and topic in self._arrived:
            number = _number(message.payload)
            self._arrived[topic] = None if number is None else Retained(number, sha256(message.payload).digest())
        elif not message.retain and topic == self.topic("status", self._settings.client):
            self._marker.set()


class Publisher:
    """Feeds one broker from the store until stopped; a broker that is away costs nothing."""

    def __init__(self, store: Store, settings: MqttSettings, known: Mapping[Place, int]) -> None:
        self.problem: Message | None = None
        self.sent = 0
        self._steps = Steps("mqtt")
        self._store, self._settings = store, settings
        self._following = Following(store)
        self._following.start(known)
        self._guessed = set(self._following.position) - set(known)
        self._models: dict[str, str] = {}
        self._models_looked = -math.inf

    @property
    def position(self) -> dict[Place, int]:
        """What has arrived, to be kept and given back at the next start."""
        return dict(self._following.position)

    def stalled(self) -> Message | None:
        """Return that it stands still; None while it works or waits."""
        return self._steps.stalled()

    def run(self, stop: threading.Event) -> None:
        """Connect, send, connect again, until stopped. Raises what the store raises."""
        pause_s = FIRST_PAUSE_S
        while not stop.is_set():
            broker = Broker(self._settings)
            try:
                with self._steps.step():
                    self._connect(broker)
                pause_s = FIRST_PAUSE_S
                while not stop.is_set():
                    with self._steps.step():
                        sent = self._send_waiting(broker)
                    if not sent:
                        stop.wait(POLL_S)
                broker.send([(broker.topic("status"), json_bytes({"state": "offline"}))])
            except BrokerAway as error:
                self.problem = spoken(error)
                stop.wait(pause_s)
                pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            finally:
                broker.close()

    def _connect(self, broker: Broker) -> None:
        broker.open()
        arrived = self._arrived(broker.retained(self._store.presses()))
        known = {place: number for place, number in self.position.items() if place not in self._guessed}
        self._following.start({**self.position, **_further(known, arrived)})
        self._guessed.clear()
        self._models.clear()
        online = {"state": "online", "version": installed_version(), "utc": datetime.now(UTC).isoformat()}
        broker.send([(broker.topic("status"), json_bytes(online))])
        self.problem = None

    def _arrived(self, kept: Mapping[Place, Retained]) -> dict[Place, int]:
        """Return the numbers of the messages that are this store's to the last byte.

        By any other, whoever wrote it, scans would be passed over that no receiver ever got.
        """
        arrived = {}
        for place, one in kept.items():
            own = self._following.message(place, one.number) if 0 <= one.number < 2**53 else None
            if own is not None and sha256(json_bytes(own.body)).digest() == one.sum:
                arrived[place] = one.number
            else:
                message = say("plant-retained-foreign", press=place[0], kind=place[1], number=str(one.number)[:20])
                self._store.log("warning", PROCESS, message, place[0])
        return arrived

    def _send_waiting(self, broker: Broker) -> bool:
        waiting = self._following.waiting() + self._models_in_force()
        if not waiting:
            return False
        broker.send([(broker.topic(m.press, m.kind), json_bytes(m.body)) for m in waiting])
        for message in waiting:
            if message.kind in KINDS:
                self._following.arrived(message)
            else:
                self._models[message.press] = str(message.body["version"])
        self.sent += len(waiting)
        return True

    def _models_in_force(self) -> list[Outgoing]:
        if time.monotonic() - self._models_looked < MODEL_S and self._models:
            return []
        self._models_looked = time.monotonic()
        active = [self._store.active_model(press) for press in self._store.presses()]
        return [
            Outgoing(model.press, "model", model.number, model_body(model))
            for model in active
            if model is not None and self._models.get(model.press) != model.version
        ]


def _further(known: Mapping[Place, int], arrived: Mapping[Place, int]) -> dict[Place, int]:
    return {place: max(number, known.get(place, number)) for place, number in arrived.items()}


def _number(retained: bytes | bytearray) -> int | None:
    """Return the number in a message, None where it holds none: anybody may have written it."""
    try:
        return int(json.loads(retained)["number"])
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None


def json_bytes(body: Mapping[str, Any]) -> bytes:
    """Return a message's body."""
    return json.dumps(body, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()


def _password(settings: MqttSettings) -> str:
    if settings.password_file is None:
        return ""
    try:
        return text_in(settings.password_file).split("\n")[0]
    except (OSError, UnicodeDecodeError) as error:
        problem = say("plant-password-unreadable", path=str(settings.password_file), why=reason_of(error))
        raise InputError(problem) from error
