import json
import socket
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import httpx
import pytest

from api.http.news import Position
from daq.records import Channel, InputError, PressEvent, PressEventKind, Quality, Scan
from daq.store.records import NewRun, PressKey
from tests.patience import wait_until

PATIENT_S = 240.0
"""A busy machine answers late, and fails no test for it. [s]"""

LIVE = "/api/v1/live"
CLOSING = (PressEventKind.INSERTED, PressEventKind.CLOSED)


class Stream:
    """Reads a stream of events in the background."""

    def __init__(self, base: str, last_event_id: str = "") -> None:
        self.events: list[dict[str, object]] = []
        self._client = httpx.Client(base_url=base, timeout=240)
        headers = {"Last-Event-ID": last_event_id} if last_event_id else {}
        self._context = self._client.stream("GET", LIVE, headers=headers)
        self.answer = self._context.__enter__()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        event: dict[str, object] = {}
        try:
            for line in self.answer.iter_lines():
                if not line and "data" in event:
                    self.events.append(event)
                    event = {}
                elif line.startswith("data: "):
                    event["data"] = json.loads(line[6:])
                elif ": " in line and not line.startswith(":"):
                    name, _, value = line.partition(": ")
                    event[name] = value
        except (httpx.HTTPError, httpx.StreamError):
            return

    def wait(self, name: str, count: int = 1) -> list[dict[str, object]]:
        def found() -> list[dict[str, object]]:
            return [e for e in self.events if e["event"] == name]

        wait_until(lambda: len(found()) >= count, lambda: f"no {name}; came {[e['event'] for e in self.events]}")
        return found()

    def close(self) -> None:
        self.answer.extensions["network_stream"].get_extra_info("socket").shutdown(socket.SHUT_RDWR)
        self._thread.join(5)
        self.answer.close()
        self._client.close()


@pytest.fixture
def key(store) -> PressKey:
    channels = tuple(Channel(c.name) for c in store.channels("lab"))
    return store.register_press("lab", channels)


def scan(number: int, value: float) -> Scan:
    qualities = (Quality.GOOD,) * 15 + (Quality.OPEN,)
    return Scan(number, datetime.now(UTC), 90_000.0 + number, (value,) * 15 + (float("nan"),), qualities)


def test_scans_press_events_runs_estimates_and_fits_arrive_as_they_are_stored(
    client, store, key, make_estimate, make_fit
):
    stream = Stream(str(client.base_url))
    try:
        first = scan(key.next_number, 30.0)
        new = NewRun("lab-live", first.number, first.utc, first.monotonic_s, {})
        store.append_scans(key, [first], begin=new)
        events = [PressEvent(kind, first.monotonic_s, first.monotonic_s) for kind in CLOSING]
        store.append_scans(key, [scan(first.number + 1, 31.0)], events)
        store.append_estimates("lab", [make_estimate(first, 25.0)])
        store.put_fit("lab-live", make_fit("lab-live", 5), "1")
        data = stream.wait("scan", 2)[0]["data"]
        assert data["run"] == "lab-live"
        assert data["time_s"] == 0.0
        assert data["temperatures_C"]["top_1"] == 30.0
        assert data["temperatures_C"]["bottom_7"] is None
        assert data["qualities"] == {"bottom_7": "open"}
        assert stream.wait("press")[0]["data"]["state"] == "open"
        assert stream.wait("run")[-1]["data"]["status"] == "open"
        assert stream.wait("estimate")[0]["data"]["core_C"] == 25.0
        assert stream.wait("fit")[0]["data"]["run"] == "lab-live"
    finally:
        stream.close()


def test_who_comes_back_gets_every_scan_missed_once_and_in_order(client, store, key):
    stream = Stream(str(client.base_url))
    number = store.newest_scan_number("lab") + 1
    store.append_scans(key, [scan(number, 40.0)])
    seen = stream.wait("scan")[-1]
    stream.close()
    store.append_scans(key, [scan(number + i, 40.0 + i) for i in range(1, 31)])
    back = Stream(str(client.base_url), str(seen["id"]))
    try:
        store.append_scans(key, [scan(number + 31, 71.0)])
        numbers = [e["data"]["number"] for e in back.wait("scan", 31)]
        assert numbers == list(range(number + 1, number + 32))
    finally:
        back.close()


@pytest.fixture
def leaving(store, key, make_estimate):
    """A closed press whose panel may leave; returns what says so at a scan some time ago."""
    store.interrupt_open_runs("lab")
    first = scan(store.newest_scan_number("lab") + 1, 90.0)
    name = f"lab-leaving-{first.number}"
    store.append_scans(key, [first], begin=NewRun(name, first.number, first.utc, first.monotonic_s))
    events = [PressEvent(kind, first.monotonic_s, first.monotonic_s) for kind in CLOSING]
    store.append_scans(key, [scan(first.number + 1, 90.0)], events)

    def say(ago_s: float) -> int:
        new = scan(store.newest_scan_number("lab") + 1, 91.0)
        store.append_scans(key, [replace(new, utc=new.utc - timedelta(seconds=ago_s))])
        cured = {"cure_low": 0.9, "cure_top": 0.9, "cure_bottom": 0.9, "open_now": True}
        store.append_estimates("lab", [replace(make_estimate(new, 85.0), detail=cured)])
        return new.number

    return say


def leave_of(events):
    return [(e["data"]["number"], e["data"]["open_now"], e["data"]["reason"]) for e in events]


def test_leave_to_open_is_withdrawn_from_the_stream_when_nobody_says_so_any_more(client, store, key, leaving):
    stream = Stream(str(client.base_url))
    try:
        number = leaving(3.5)
        first, second = stream.wait("estimate", 2)
        assert leave_of([first, second]) == [(number, True, ""), (number, False, "no scans")]
        assert first["data"]["advice"]["verdict"] == "open_now"
        assert (second["data"]["core_C"], second["data"]["state"]) == (None, "unknown")
        assert second["data"]["advice"]["verdict"] == "not_known"
        number = leaving(0.0)
        assert leave_of(stream.wait("estimate", 3))[-1] == (number, True, "")
        opened = scan(number + 1, 92.0)
        store.append_scans(key, [opened], [PressEvent(PressEventKind.OPENED, 1.0, 1.0)])
        assert leave_of(stream.wait("estimate", 4))[-1] == (number, False, "estimate behind the press")
        assert len(stream.wait("estimate", 4)) == 4
    finally:
        stream.close()


def test_who_comes_back_after_the_leave_was_withdrawn_hears_that_last(client, leaving):
    stream = Stream(str(client.base_url))
    leaving(0.0)
    seen = stream.wait("estimate")[-1]
    stream.close()
    number = leaving(30.0)
    back = Stream(str(client.base_url), str(seen["id"]))
    try:
        then, now = back.wait("estimate", 2)
        assert (then["data"]["valid"], then["data"]["core_C"]) == (True, 85.0)  # as it was at its scan
        assert leave_of([then, now]) == [(number, False, ""), (number, False, "no scans")]
        assert then["data"]["advice"]["verdict"] == now["data"]["advice"]["verdict"] == "not_known"
    finally:
        back.close()


def test_who_comes_while_the_last_one_leaves_is_not_forgotten(client, store, key):
    for i in range(12):
        leaving = Stream(str(client.base_url))
        threading.Thread(target=leaving.close).start()
        coming = Stream(str(client.base_url))
        number = store.newest_scan_number("lab") + 1
        store.append_scans(key, [scan(number, 50.0 + i)])
        assert coming.wait("scan")[-1]["data"]["number"] == number
        coming.close()


def test_listeners_beyond_the_limit_are_refused_with_a_problem(serve):
    base = serve(max_listeners=2)
    streams = [Stream(base), Stream(base)]
    try:
        answer = httpx.get(base + LIVE, timeout=PATIENT_S)
        assert answer.status_code == 503
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.headers["retry-after"]
    finally:
        for stream in streams:
            stream.close()


def test_listeners_that_come_at_the_same_moment_are_counted_too(serve):
    base = serve(max_listeners=5)
    address = ("127.0.0.1", int(base.rpartition(":")[2]))
    crowd = [socket.create_connection(address, timeout=240) for _ in range(60)]
    for one in crowd:
        one.sendall(f"GET {LIVE} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    answers = [one.recv(12)[9:12] for one in crowd]
    for one in crowd:
        one.close()
    assert (answers.count(b"200"), answers.count(b"503")) == (5, 55)


def test_an_id_of_another_stream_is_refused(client):
    answer = client.get(LIVE, headers={"Last-Event-ID": "yesterday"})
    assert answer.status_code == 422
    assert "not an id of this stream" in answer.json()["detail"]


def test_an_event_id_survives_names_with_any_characters():
    position = Position({"Preße 1/a.b;c": 17}, {"Preße 1/a.b;c": 15}, 3, 4, "2c,1o")
    assert Position.parse(str(position)) == position
    with pytest.raises(InputError, match="not an id"):
        Position.parse("1/2/3")
