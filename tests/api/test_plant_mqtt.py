"""MQTT against a real Mosquitto on a port of its own, with connections cut between the two."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from api.plant.leave import KEEPALIVE_S, LeaveFeed, leave_body
from api.plant.mqtt import Publisher
from daq.process.config import MqttSettings
from daq.records import Channel, PressEvent, PressEventKind, PressState, Quality, Scan
from daq.store import NewRun, PressKey, Store, StoredEstimate, open_store
from tests.patience import wait_until

MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto is installed: apt-get install mosquitto")
STARTED = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
CHANNELS = (Channel("platen_top"), Channel("top_1"))
LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"


def a_free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Broker:
    """A Mosquitto that remembers nothing over a restart."""

    def __init__(self, folder: Path) -> None:
        self.port = a_free_port()
        self._file = folder / "mosquitto.conf"
        self._file.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
        self.start()

    def start(self) -> None:
        assert MOSQUITTO is not None
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(self._file)], stderr=subprocess.DEVNULL)

        def listens() -> bool:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return True
            return False

        wait_until(listens)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


class Relay:
    """A TCP line to the broker that can be cut and held down."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._down = False
        self._pairs: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if self._down:
                    near.close()
                    continue
                far = socket.create_connection(("127.0.0.1", self._target))
                self._pairs += [near, far]
                for a, b in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=(a, b), daemon=True).start()

    def _carry(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(4096):
                target.sendall(data)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def cut(self, *, hold: bool = False) -> None:
        self._down = hold
        for one in self._pairs:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._pairs.clear()

    def restore(self) -> None:
        self._down = False

    def close(self) -> None:
        self.cut(hold=True)
        self._listener.close()


class Listener:
    """A plant system: what reached it, topic by topic."""

    def __init__(self, port: int) -> None:
        self.got: dict[str, list[dict[str, Any]]] = {}
        self.retained: set[str] = set()
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._on_message
        subscribed = threading.Event()
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe("plant/#", 1)
        assert subscribed.wait(240)

    def _on_message(self, client: Any, data: Any, message: paho.MQTTMessage) -> None:
        if message.retain:
            self.retained.add(message.topic)
        if message.payload:
            self.got.setdefault(message.topic, []).append(json.loads(message.payload))

    def numbers(self, kind: str) -> list[int]:
        return [body["number"] for body in list(self.got.get(f"plant/lab/{kind}", []))]

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Recorder:
    """Writes scans and estimates as recorder and live sensor do."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.key: PressKey = store.register_press("lab", CHANNELS, LAB.read_text())
        self.next = self.key.next_number

    def scans(self, count: int) -> None:
        scans = [self.scan(self.next + i) for i in range(count)]
        self.store.append_scans(self.key, scans)
        self.store.append_estimates("lab", [self.estimate(scan) for scan in scans])
        self.next += count

    def scan(self, number: int) -> Scan:
        utc = STARTED + timedelta(seconds=0.1 * number)
        values = (200.0 + 0.01 * number, float("nan"))
        return Scan(number, utc, 0.1 * number, values, (Quality.GOOD, Quality.OPEN))

    def estimate(self, scan: Scan) -> StoredEstimate:
        return StoredEstimate(
            scan.number, scan.monotonic_s, PressState.CLOSED, 80.0, 0.5, 79.0, 81.0, True, "", "lab-7"
        )


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with open_store(str(tmp_path / "plant.sqlite")) as opened:
        yield opened


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    started = Broker(tmp_path)
    yield started
    started.kill()


@contextmanager
def running(work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Something that goes on until it is stopped, and then ends."""
    stop = threading.Event()
    thread = threading.Thread(target=work, args=(stop,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(240)
        assert not thread.is_alive()


@contextmanager
def publishing(store: Store, port: int, known: dict[tuple[str, str], int] | None = None) -> Iterator[Publisher]:
    publisher = Publisher(store, MqttSettings(host="127.0.0.1", port=port, prefix="plant"), known or {})
    with running(publisher.run):
        yield publisher


def test_scans_estimates_events_and_model_arrive_with_units_quality_and_time(store, broker):
    recorder, listener = Recorder(store), Listener(broker.port)
    store.put_model("lab", "lab-7", {"effects": [{"name": "edge_loss"}]}, reason="better on 6 runs")
    store.promote_model("lab-7", "test")
    with publishing(store, broker.port):
        wait_until(lambda: listener.got.get("plant/lab/model"))
        recorder.scans(3)
        store.append_scans(recorder.key, [], [PressEvent(PressEventKind.CLOSED, 0.15, 0.2)])
        wait_until(lambda: len(listener.numbers("estimate")) == 3 and listener.got.get("plant/lab/event"))
    assert listener.got["plant/lab/scan"][1] == {
        "press": "lab",
        "number": 1,
        "utc": "2026-03-04T07:00:00.100000+00:00",
        "temperatures_C": {"platen_top": 200.01, "top_1": None},
        "qualities": {"top_1": "open"},
    }
    estimate = listener.got["plant/lab/estimate"][2]
    assert (estimate["core_C"], estimate["core_low_C"], estimate["valid"]) == (80.0, 79.0, True)
    assert estimate["utc"] == "2026-03-04T07:00:00.200000+00:00"
    event = listener.got["plant/lab/event"][0]
    assert (event["event"], event["state"]) == ("closed", "closed")
    model = listener.got["plant/lab/model"][0]
    assert (model["version"], model["effects"]) == ("lab-7", ["edge_loss"])
    assert "open_now" not in estimate  # a record, and retained
    wait_until(lambda: len(listener.got["plant/status"]) > 1)  # the broker's word may come late
    assert [s["state"] for s in listener.got["plant/status"]] == ["online", "offline"]
    listener.close()


def test_a_press_whose_name_no_topic_can_hold_is_published_beside_the_others(store, broker):
    recorder, listener = Recorder(store), Listener(broker.port)
    odd = store.register_press('Presse "Nord" +#1', CHANNELS, LAB.read_text())
    with publishing(store, broker.port):
        wait_until(lambda: listener.got.get("plant/status"))
        recorder.scans(1)
        store.append_scans(odd, [recorder.scan(0)])
        wait_until(lambda: listener.numbers("scan") and listener.got.get('plant/Presse "Nord" %2B%231/scan'))
    listener.close()


def test_a_newcomer_sees_the_newest_of_everything_at_once(store, broker):
    recorder = Recorder(store)
    with publishing(store, broker.port) as publisher:
        wait_until(lambda: not publisher.problem and publisher.position)
        recorder.scans(5)
        wait_until(lambda: publisher.position.get(("lab", "estimate")) == 4)
        listener = Listener(broker.port)
        wait_until(lambda: listener.numbers("scan") == [4] and listener.numbers("estimate") == [4])
        assert listener.retained == {"plant/status", "plant/lab/scan", "plant/lab/estimate"}
        listener.close()


def test_over_cut_lines_everything_arrives_in_order_and_once(store, broker):
    recorder, listener, relay = Recorder(store), Listener(broker.port), Relay(broker.port)
    chance = random.Random(5)
    with publishing(store, relay.port):
        wait_until(lambda: listener.got.get("plant/status"))
        for _ in range(12):
            recorder.scans(chance.randint(50, 400))
            time.sleep(chance.uniform(0.0, 0.1))
            relay.cut()
        recorder.scans(10)
        wait_until(lambda: listener.numbers("estimate")[-1:] == [recorder.next - 1])
        wait_until(lambda: listener.numbers("scan")[-1:] == [recorder.next - 1])
    assert listener.numbers("scan") == list(range(recorder.next))
    assert listener.numbers("estimate") == list(range(recorder.next))
    assert "offline" in [s["state"] for s in listener.got["plant/status"]]
    listener.close()
    relay.close()


def test_a_broker_that_came_back_empty_gets_what_was_stored_meanwhile(store, broker):
    recorder, relay = Recorder(store), Relay(broker.port)
    with publishing(store, relay.port) as publisher:
        wait_until(lambda: not publisher.problem)
        recorder.scans(20)
        wait_until(lambda: publisher.position.get(("lab", "scan")) == 19)
        relay.cut(hold=True)
        broker.kill()
        recorder.scans(700)
        wait_until(lambda: "MQTT broker 127.0.0.1" in str(publisher.problem))
        broker.start()
        listener = Listener(broker.port)
        relay.restore()
        wait_until(lambda: listener.numbers("scan")[-1:] == [719])
    assert listener.numbers("scan") == list(range(20, 720))
    listener.close()
    relay.close()


def test_another_store_than_before_begins_with_its_own_present(store, broker):
    recorder, listener = Recorder(store), Listener(broker.port)
    recorder.scans(5)
    with publishing(store, broker.port, {("lab", "scan"): 90_000}):
        wait_until(lambda: listener.got.get("plant/status"))
        recorder.scans(2)
        wait_until(lambda: listener.numbers("scan")[-1:] == [6])
    assert listener.numbers("scan") == [5, 6]
    listener.close()


def command(tmp_path: Path, broker: Broker, **environment: str) -> subprocess.Popen[str]:
    config = tmp_path / "kerntemp.toml"
    config.write_text(
        f'[store]\nurl = "plant.sqlite"\n[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\nprefix = "plant"\n'
        f'[[press]]\nname = "lab"\nfile = "{LAB.as_posix()}"\n[[press.logger]]\nname = "x"\n'
        'profile = "exemys-rme1-tc"\nhost = "127.0.0.1"\nchannels = ["platen_top", "platen_bottom"]\n'
    )
    line = [sys.executable, "-m", "api", "publish", "--config", str(config)]
    where = {"cwd": Path(__file__).parents[2], "env": {**os.environ, **environment}}
    return subprocess.Popen(line, stderr=subprocess.DEVNULL, text=True, **where)


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_the_last_will_tells_of_a_killed_process_and_the_next_one_goes_on_where_it_stopped(
    tmp_path, store, broker
):
    recorder, listener = Recorder(store), Listener(broker.port)
    first = command(tmp_path, broker)
    wait_until(lambda: "plant/status" in listener.got)
    recorder.scans(30)
    wait_until(lambda: listener.numbers("scan")[-1:] == [29])
    first.send_signal(signal.SIGKILL)
    first.wait()
    wait_until(lambda: listener.got["plant/status"][-1]["state"] == "offline")
    recorder.scans(40)
    second = command(tmp_path, broker)
    wait_until(lambda: listener.numbers("scan")[-1:] == [69])
    second.terminate()
    assert second.wait(240) == 0
    assert listener.numbers("scan") == list(range(70))
    assert [s["state"] for s in listener.got["plant/status"]] == ["online", "offline", "online", "offline"]
    assert store.statuses()["publish"].status["state"] == "stopped"
    listener.close()


def test_systemd_is_told_that_publish_is_ready_and_alive(tmp_path, store, broker):
    Recorder(store)
    place = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(place)
        line.settimeout(240)
        service = command(tmp_path, broker, NOTIFY_SOCKET=place)
        datagrams = [line.recv(4096).decode() for _ in range(3)]
        service.terminate()
        assert service.wait(240) == 0
    assert datagrams[0].startswith("READY=1")
    assert all(message.startswith("WATCHDOG=1") for message in datagrams[1:])


LEAVE = "plant/lab/open_now"


class Pressing(Recorder):
    """A closed press whose panel may leave, with scans of now."""

    def __init__(self, store: Store) -> None:
        super().__init__(store)
        first = self.scan(0)
        store.append_scans(self.key, [first], begin=NewRun("one", 0, first.utc, first.monotonic_s))
        at = first.monotonic_s
        self.next = 1
        self.events = [PressEvent(kind, at, at) for kind in (PressEventKind.INSERTED, PressEventKind.CLOSED)]

    def say(self, *, leave: bool = True, ago_s: float = 0.0) -> None:
        scan = replace(self.scan(self.next), utc=datetime.now(UTC) - timedelta(seconds=ago_s))
        self.store.append_scans(self.key, [scan], self.events)
        self.store.append_estimates("lab", [replace(self.estimate(scan), detail={"open_now": leave})])
        self.next, self.events = self.next + 1, []


@contextmanager
def giving_leave(store: Store, port: int) -> Iterator[LeaveFeed]:
    feed = LeaveFeed(store, MqttSettings(host="127.0.0.1", port=port, prefix="plant"))
    with running(feed.run):
        yield feed


def last(listener: Listener) -> tuple[bool, bool, str]:
    """The newest word of leave to open: whether, whether that is known, and why not."""
    body = (listener.got.get(LEAVE) or [{"open_now": None, "known": None, "reason": None}])[-1]
    return body["open_now"], body["known"], body["reason"]


def test_leave_to_open_is_said_each_second_and_taken_back_when_nobody_knows(store, broker):
    pressing, listener = Pressing(store), Listener(broker.port)
    with giving_leave(store, broker.port):
        pressing.say(ago_s=2.5)
        wait_until(lambda: last(listener) == (True, True, ""))
        given = listener.got[LEAVE][-1]
        until = datetime.fromisoformat(given["valid_until_utc"]) - datetime.fromisoformat(given["utc"])
        assert (until, given["state"]) == (timedelta(seconds=5), "closed")
        wait_until(lambda: [m["open_now"] for m in listener.got[LEAVE]].count(True) > 1)  # again, unchanged
        wait_until(lambda: last(listener) == (False, False, "no scans"))
        pressing.say(leave=False)
        wait_until(lambda: last(listener) == (False, True, ""))
        pressing.say()
        wait_until(lambda: last(listener)[0])
    wait_until(lambda: last(listener) == (False, False, "not published"))
    listener.close()


def test_nothing_but_false_is_retained_so_no_relay_ever_hears_yesterdays_leave(store, broker):
    pressing = Pressing(store)
    with giving_leave(store, broker.port):
        first = Listener(broker.port)
        pressing.say()
        wait_until(lambda: last(first)[0])
        newcomer = Listener(broker.port)
        wait_until(lambda: last(newcomer)[0])
        assert [m["open_now"] for m in newcomer.got[LEAVE]][:2] == [False, True]
        assert LEAVE in newcomer.retained
    for listener in (first, newcomer):
        listener.close()


def test_leave_comes_again_by_itself_after_the_broker_was_away(store, broker):
    pressing = Pressing(store)
    with giving_leave(store, broker.port) as feed:
        pressing.say(ago_s=-2.0)
        wait_until(lambda: feed.problem is None and store.presses())
        broker.kill()
        wait_until(lambda: "MQTT broker 127.0.0.1" in str(feed.problem))
        broker.start()
        listener = Listener(broker.port)
        pressing.say(ago_s=-2.0)
        wait_until(lambda: last(listener)[0])
        assert feed.problem is None
        listener.close()


def test_a_store_that_does_not_answer_gives_no_leave():
    body = leave_body("lab", None, datetime.now(UTC))
    assert (body["open_now"], body["known"], body["reason"]) == (False, False, "store away")


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
@pytest.mark.parametrize("word", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.campaign)])
def test_the_broker_takes_leave_back_for_a_publisher_that_was_killed_or_hangs(tmp_path, store, broker, word):
    pressing, listener = Pressing(store), Listener(broker.port)
    process = command(tmp_path, broker)

    def given() -> bool:
        pressing.say()
        time.sleep(0.1)
        return last(listener)[0]

    try:
        wait_until(given)
        process.send_signal(word)
        stopped = time.monotonic()
        while last(listener)[0]:
            pressing.say()  # recorder and live sensor go on
            time.sleep(0.1)
            assert time.monotonic() - stopped < 240
        print(f"leave taken back {time.monotonic() - stopped:.1f} s after {word.name}; keepalive {KEEPALIVE_S} s")
        assert last(listener) == (False, False, "not published")
    finally:
        process.kill()
        process.wait()
        listener.close()
