"""Hostile brokers, and garbage that a broker keeps: the feeds go on, and what they hold stays small."""

from __future__ import annotations

import random
import socket
import threading
import time
from contextlib import closing, suppress

import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from api.plant.leave import LeaveFeed
from api.plant.mqtt import Broker as Line
from daq.process.config import MqttSettings
from daq.store import Store
from tests.api.test_plant_mqtt import (
    MOSQUITTO,
    Broker,
    Listener,
    Recorder,
    broker,  # noqa: F401
    publishing,
    running,
    store,  # noqa: F401
)
from tests.patience import wait_until

pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto is installed: apt-get install mosquitto")

GARBAGE = [
    b"\xff\xfe\x00",
    b"{",
    b"null",
    b"[1]",
    b'{"number": null}',
    b'{"number": Infinity}',
    b'{"number": NaN}',
    b'{"number": -1e308}',
    b'{"number": "12x"}',
    b'{"number": {"number": 1}}',
    b'{"number": 99999999999999999999999999}',
    b'{"number": ' + b"9" * 5000 + b"}",
    b"[" * 200_000,
    b'{"number":' * 50_000,
    bytes(range(256)) * 8000,
]


def keep(port: int, topic: str, payload: bytes) -> None:
    """Let the broker keep a message."""
    client = paho.Client(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.loop_start()
    sent = client.publish(topic, payload, 1, retain=True)
    wait_until(sent.is_published)
    client.disconnect()
    client.loop_stop()


@pytest.mark.parametrize("number", [4, 9, 10**6], ids=["of a scan there is", "of one to be", "of none"])
def test_a_number_that_somebody_else_let_the_broker_keep_costs_no_message(
    store: Store,  # noqa: F811
    broker: Broker,  # noqa: F811
    number: int,
) -> None:
    recorder = Recorder(store)
    recorder.scans(2)
    with publishing(store, broker.port) as publisher:
        wait_until(lambda: not publisher._guessed and publisher.problem is None)
        recorder.scans(1)
        wait_until(lambda: publisher.position["lab", "scan"] == 2)
        known = publisher.position
    recorder.scans(5)  # meanwhile the feed is down
    keep(broker.port, "plant/lab/scan", b'{"number": %d}' % number)
    with closing(Listener(broker.port)) as listener, publishing(store, broker.port, known) as publisher:
        wait_until(lambda: publisher.position["lab", "scan"] == 7)
        wait_until(lambda: listener.numbers("scan")[-5:] == [3, 4, 5, 6, 7])
    (message,) = [one.message for one in store.journal(level="warning").items]
    assert message.code == "plant-retained-foreign"
    assert message.arguments["number"] == str(number)


def test_whatever_a_broker_keeps_the_feed_goes_on_with_the_next_scan(store: Store, broker: Broker) -> None:  # noqa: F811
    recorder = Recorder(store)
    recorder.scans(3)
    for payload in GARBAGE:
        for kind in ("scan", "estimate", "event", "model", "open_now"):
            keep(broker.port, f"plant/lab/{kind}", payload)
        keep(broker.port, "plant/status/kerntemp", payload)
        with publishing(store, broker.port) as publisher:
            wait_until(lambda: not publisher._guessed and publisher.problem is None)
            recorder.scans(1)
            wait_until(lambda: publisher.sent >= 2)
            assert publisher.position[("lab", "scan")] == recorder.next - 1


CONNACK = b"\x20\x02\x00\x00"
DEADLY = {
    "closes at once": [],
    "speaks another protocol": [b"HTTP/1.1 400 Bad Request\r\n\r\n"],
    "random bytes": [random.Random(4).randbytes(3000)],
    "a refusal nobody knows": [b"\x20\x02\x00\xfe"],
    "a topic that is no text": [CONNACK, b"\x30\x05\x00\x02\xff\xfe1"],
    "a length without end": [CONNACK, b"\x30\xff\xff\xff\xff\xff"],
    "an answer to nothing": [CONNACK, b"\x40\x02\x12\x34", b"\x90\x03\x12\x34\x80"],
    "a packet cut short": [CONNACK, b"\x32\x40\x00\x05plan"],
    "a message of some MB": [CONNACK, b"\x30\x80\x80\x80\x04\x00\x05plant" + b"x" * 8_000_000],
}


class Hostile:
    """A line that answers the first connections as it likes, and leads to a real broker then."""

    def __init__(self, answers: list[list[bytes]], broker_port: int) -> None:
        self.answers, self._target = answers, broker_port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.connections: list[float] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                self.connections.append(time.monotonic())
                answer = self.answers.pop() if self.answers else None
                threading.Thread(target=self._serve, args=(near, answer), daemon=True).start()

    def _serve(self, near: socket.socket, answer: list[bytes] | None) -> None:
        with suppress(OSError), near:
            if answer is not None:
                near.recv(1000)
                for part in answer:
                    near.sendall(part)
                return
            with socket.create_connection(("127.0.0.1", self._target)) as far:
                there = threading.Thread(target=self._carry, args=(near, far), daemon=True)
                there.start()
                self._carry(far, near)

    def _carry(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(4096):
                target.sendall(data)
        with suppress(OSError):
            target.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()


@pytest.fixture
def died(monkeypatch: pytest.MonkeyPatch) -> list[threading.ExceptHookArgs]:
    """The threads that ended by a fault meanwhile."""
    found: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", found.append)
    return found


@pytest.mark.parametrize("answer", DEADLY)
def test_a_hostile_broker_ends_no_thread_and_all_arrives_once_a_sound_one_is_there(
    store: Store,  # noqa: F811
    broker: Broker,  # noqa: F811
    died: list[threading.ExceptHookArgs],
    answer: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    recorder, listener = Recorder(store), Listener(broker.port)
    line = Hostile([DEADLY[answer]] * 6, broker.port)
    leave = LeaveFeed(store, MqttSettings(host="127.0.0.1", port=line.port, prefix="plant"))
    capfd.readouterr()
    with publishing(store, line.port), running(leave.run):
        wait_until(lambda: not line.answers)
        recorder.scans(3)
        wait_until(lambda: listener.numbers("scan")[-1:] == [2] and listener.got.get("plant/lab/open_now"))
    out, err = capfd.readouterr()
    assert len((out + err).splitlines()) <= 20
    assert not died
    listener.close()
    line.close()


def test_of_what_a_broker_sends_unasked_nothing_is_kept(store: Store, broker: Broker) -> None:  # noqa: F811
    line = Line(MqttSettings(host="127.0.0.1", port=broker.port, prefix="plant"))
    for i in range(2000):
        message = paho.MQTTMessage(topic=f"plant/{i}/scan".encode())
        message.retain, message.payload = True, b'{"number": 1}'
        line._on_message(None, None, message)
    assert line._arrived == {}
