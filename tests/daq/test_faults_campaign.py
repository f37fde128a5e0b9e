"""A wire that misbehaves in every way we know must never put a value on another channel.

Each simulated input answers a temperature that tells its number and the moment of conversion, so a
value of another channel, of another module or of an older request betrays itself.
"""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from daq.drivers import LoggerSettings, ReadFailure, open_logger
from daq.drivers.protocol import Cause
from daq.simulated.devices import kind_of, station, wiring
from daq.simulated.devices_line import Server, serve_serial, serve_tcp
from tests.daq import proxy
from tests.daq.proxy import Fault, FaultProxy
from tests.editions import edition

BASE_C, CHANNEL_K, PERIOD_S, SWING_K = 20.0, 12.0, 10.0, 10.0
TIMEOUT_S, DRAIN_S = 0.08, 0.15
LATE_S = (1.05 * TIMEOUT_S, TIMEOUT_S + 0.5 * DRAIN_S)
CLOCK_SLACK_S = 0.05
SOUND_TIMEOUT_S = 1.0
UNSPOILED_TIMEOUT_S = 30.0
"""Of a wire on which nothing is spoiled: longer than a busy machine keeps a device from answering, so that what is
lost there was lost by the reader."""
KNOWN_CAUSES = {
    "silent",
    "busy",
    "port lost",
    "no port",
    "connection refused",
    "truncated",
    "crc",
    "wrong id",
    "wrong shape",
    "surplus",
    "garbage",
    "babble",
    "out of step",
    "refused",
}


def telling(first, inputs):
    """Temperatures that tell channel and time: 12 K a channel, a sawtooth of 10 K in 10 s on it."""

    def temperatures(now_s):
        ramp = now_s % PERIOD_S / PERIOD_S * SWING_K
        return [BASE_C + CHANNEL_K * (first + k) + ramp for k in range(inputs)]

    return temperatures


def channel_and_time(value):
    """Return channel number and conversion time within the period."""
    channel = round((value - BASE_C - SWING_K / 2) / CHANNEL_K)
    return channel, (value - BASE_C - CHANNEL_K * channel) / SWING_K * PERIOD_S


@dataclass
class Tally:
    """What one logger's readings came to."""

    good: int = 0
    wrong_time: int = 0
    mixed: list = field(default_factory=list)
    """Of each value on a wrong channel: what it tells of channel and time, and the reading it came with."""
    other_quality: Counter = field(default_factory=Counter)
    losses: Counter = field(default_factory=Counter)

    @property
    def attempts(self):
        return self.good + sum(self.losses.values())


@dataclass(frozen=True)
class Wired:
    """One logger on a line: which profile, which station, its first channel."""

    profile: str
    address: int = 1
    first: int = 0
    spoiled: bool = True

    @property
    def step_s(self):
        coarse = self.profile in ("m-7018", "adam-4118-ascii", "m-7019r-dcon", "generic", "sr630")
        return 0.055 if coarse else 0.025


@dataclass(frozen=True)
class Line:
    """Devices behind one proxied wire."""

    loggers: tuple[Wired, ...]
    spoiler: object
    serial: bool
    transport: str | None = None
    timeout_s: float = TIMEOUT_S
    drain_s: float = DRAIN_S
    share: float = 0.25
    """Replies that are spoiled; low where a scan takes many replies."""


LINES = {
    "RTU, two modules": Line(
        (Wired("adam-4118", 1), Wired("m-7019r", 2, first=8)), proxy.rtu_spoiler(), serial=True
    ),
    "RTU, sound neighbour": Line(
        (Wired("adam-4118", 1), Wired("m-7018", 2, first=8, spoiled=False)), proxy.rtu_spoiler(), serial=True
    ),
    "RTU over TCP": Line((Wired("adam-4018+", 1),), proxy.rtu_spoiler(), serial=False, transport="rtu_over_tcp"),
    "Modbus TCP, 8": Line((Wired("adam-6018+", first=8),), proxy.tcp_spoiler(), serial=False, share=0.5),
    "Modbus TCP, 16": Line((Wired("generic"),), proxy.tcp_spoiler(), serial=False, share=0.5),
    "ADAM and DCON ASCII": Line(
        (Wired("adam-4118-ascii", 1), Wired("m-7019r-dcon", 2, first=8)),
        proxy.guarded_text_spoiler(),
        serial=True,
    ),
    "SCPI": Line((Wired("daq970a"),), proxy.bare_text_spoiler(), serial=False, timeout_s=0.2, drain_s=0.2),
    "SR630": Line(
        (Wired("sr630"),), proxy.bare_text_spoiler(), serial=True, timeout_s=0.2, drain_s=0.2, share=0.04
    ),
    "Modbus TCP, sound": Line(
        (Wired("exemys-rme1-tc", spoiled=False),),
        proxy.tcp_spoiler(),
        serial=False,
        timeout_s=UNSPOILED_TIMEOUT_S,
    ),
}
FAULTS = [fault for fault in Fault if fault is not Fault.NONE]


def spoil_plan(line, seed):
    rng = np.random.default_rng(seed)
    sound = [wired.address for wired in line.loggers if not wired.spoiled]

    def plan(request, reply):
        if len(sound) == len(line.loggers) or request[0] in sound:
            return Fault.NONE
        return FAULTS[int(rng.integers(len(FAULTS)))] if rng.random() < line.share else Fault.NONE

    return plan


@contextlib.contextmanager
def opened(line, directory, seed, plan=None):
    """Yield the proxy and the line's loggers, each with its tally-to-be."""
    stations = [
        station(
            w.profile,
            telling(w.first, kind_of(w.profile).inputs),
            address=w.address,
            refresh_s=0,
            transport=line.transport or kind_of(w.profile).transport,
        )
        for w in line.loggers
    ]
    upstream = serve_serial(*stations) if line.serial else serve_tcp(*stations)
    link = directory / f"port-{seed}" if line.serial else None
    plan = plan or spoil_plan(line, seed)
    spoiled = (LATE_S[0] - TIMEOUT_S + line.timeout_s, LATE_S[1] - TIMEOUT_S + line.timeout_s)
    sound = [w.address for w in line.loggers if not w.spoiled]

    def in_time_s(request):
        """A sound neighbour waits longer, an unspoiled wire as long as it takes."""
        if len(sound) == len(line.loggers):
            return math.inf
        return SOUND_TIMEOUT_S if request[0] in sound else spoiled[1]

    options = {"seed": seed, "late_s": spoiled, "port_link": link, "in_time_s": in_time_s}
    if line.spoiler.numbered:
        options["again_s"] = (0.0, 0.003, 0.03)
    with upstream, FaultProxy(upstream, line.spoiler, plan, **options) as wire:
        loggers = [open_logger(settings_of(line, w, wire)) for w in line.loggers]
        try:
            yield wire, loggers, stations
        finally:
            for logger in loggers:
                logger.close()


def settings_of(line, wired, wire, **changes):
    names = tuple(f"c{wired.first + k}" for k in range(kind_of(wired.profile).inputs))
    table = wiring(wired.profile, wire, wired.profile, names, address=wired.address)
    override = table.get("override", {}) | {"timing": {"setup_s": 0.001, "response_s": 0.5, "refresh_s": 1.0}}
    beside_spoiled = any(w.spoiled for w in line.loggers)
    timeout_s = SOUND_TIMEOUT_S if beside_spoiled and not wired.spoiled else line.timeout_s
    table |= {"timeout_s": timeout_s, "drain_s": line.drain_s, "override": override}
    if line.transport:
        table["transport"] = line.transport
    return LoggerSettings(**table | changes)


def read_into(tally, logger, wired):
    """Read once and judge every value by what it tells."""
    try:
        reading = logger.read()
    except ReadFailure as failure:
        tally.losses[failure.cause] += 1
        return
    tally.good += 1
    took_s = reading.received_s - reading.requested_s
    for k, (value, quality) in enumerate(zip(reading.values, reading.qualities, strict=True)):
        if not quality.usable:
            tally.other_quality[quality] += 1
            continue
        channel, converted_s = channel_and_time(value)
        if channel != wired.first + k:
            tally.mixed.append((wired.first + k, channel, round(converted_s, 2), reading))
        age_s = (reading.received_s - converted_s) % PERIOD_S
        slack_s = CLOCK_SLACK_S + wired.step_s
        tally.wrong_time += not (age_s <= took_s + slack_s or age_s >= PERIOD_S - slack_s)


def keep_reading(tally, logger, wired, stop):
    while not stop.wait(0.01):
        read_into(tally, logger, wired)


def run_campaign(directory, faulted, seed, give_up_s):
    """Read all lines at once until so many replies were spoiled; return tallies and fault counts."""
    tallies = {(name, w.profile): Tally() for name, line in LINES.items() for w in line.loggers}
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        wires, threads = [], []
        for number, (name, line) in enumerate(LINES.items()):
            wire, loggers, _ = stack.enter_context(opened(line, directory, seed + number))
            wires.append(wire)
            for logger, wired in zip(loggers, line.loggers, strict=True):
                work = (tallies[name, wired.profile], logger, wired, stop)
                threads.append(threading.Thread(target=keep_reading, args=work))
        for thread in threads:
            thread.start()
        deadline = time.monotonic() + give_up_s
        while not (count_faults(wires) >= faulted and all(t.good for t in tallies.values())):
            if time.monotonic() > deadline:
                break
            stop.wait(0.2)
        stop.set()
        for thread in threads:
            thread.join(timeout=240)
        assert not any(thread.is_alive() for thread in threads)
    return tallies, sum((Counter(wire.faults) for wire in wires), Counter())


def count_faults(wires):
    return sum(count for wire in wires for fault, count in wire.faults.items() if fault is not Fault.NONE)


def judge(tallies, faults, faulted):
    spoiled = sum(count for fault, count in faults.items() if fault is not Fault.NONE)
    values = sum(t.good for t in tallies.values())
    print(f"\n{spoiled} spoiled replies, {values} good readings")
    for (line, profile), t in tallies.items():
        losses = ", ".join(f"{cause} {count}" for cause, count in t.losses.most_common())
        print(f"  {line:22} {profile:16} {t.good:6} good of {t.attempts:6}; wrong time {t.wrong_time}; {losses}")
    assert spoiled >= faulted
    assert {fault for fault, count in faults.items() if count} == set(Fault)
    assert not [name for name, t in tallies.items() if not t.good], "a line that reads nothing proves nothing"
    assert not {name: t.mixed for name, t in tallies.items() if t.mixed}
    assert sum(t.wrong_time for t in tallies.values()) == 0
    assert set().union(*(t.losses for t in tallies.values())) <= KNOWN_CAUSES
    assert not tallies["Modbus TCP, sound", "exemys-rme1-tc"].losses
    neighbour = tallies["RTU, sound neighbour", "m-7018"]
    assert neighbour.good
    assert set(neighbour.losses) <= {Cause.SILENT}  # how many of its replies come late, a busy machine decides


def test_no_spoiled_reply_puts_a_value_on_another_channel(tmp_path):
    tallies, faults = run_campaign(tmp_path, faulted=500, seed=1, give_up_s=180)
    judge(tallies, faults, 500)


def test_the_proxy_drops_what_a_busy_machine_kept_it_from_sending_in_time():
    """The device answers the first request only when the driver has given it up and asked again."""
    listener = socket.create_server(("127.0.0.1", 0))
    upstream = Server({"host": "127.0.0.1", "tcp_port": listener.getsockname()[1]})
    upstream.on_close(listener.close)

    def answer(stopped):
        connection, _ = listener.accept()
        with connection:
            asked = connection.recv(9)
            while len(asked) < 2:
                asked += connection.recv(9)
            for request in asked.decode():
                connection.sendall(f"<{request}>".encode())
                stopped.wait(0.1)

    upstream.start(answer)
    spoiler, sound = replace(proxy.bare_text_spoiler(), asks=len), {"seed": 1, "late_s": (0.0, 0.0)}
    patience_s = {b"1": 0.05, b"2": 60.0}
    with (
        upstream,
        FaultProxy(upstream, spoiler, lambda *_: Fault.NONE, **sound, in_time_s=patience_s.__getitem__) as wire,
        socket.create_connection(("127.0.0.1", wire.place["tcp_port"])) as driver,
    ):
        driver.settimeout(240.0)
        driver.sendall(b"1")
        while not wire._asked:
            time.sleep(0.001)
        time.sleep(patience_s[b"1"])
        driver.sendall(b"2")
        answers = driver.recv(9)
    assert answers == b"<2>"


def test_a_request_that_no_device_answers_does_not_take_the_replies_of_those_behind_it(monkeypatch):
    """Two that run together are none to a device: each later reply was judged by an older request's patience."""
    monkeypatch.setattr(proxy, "_LOST_S", 0.1)
    got, came = [], threading.Event()

    def send(part):
        got.append(part)
        came.set()

    options = {"seed": 1, "late_s": (0.0, 0.0)}
    upstream = Server({"host": "127.0.0.1", "tcp_port": 1})
    with FaultProxy(upstream, proxy.bare_text_spoiler(), lambda *_: Fault.NONE, **options) as wire:
        wire._asked.extend([(b"1?", time.monotonic() - 0.2), (b"2?", math.inf)])
        wire._pass_on(b"2\r\n", send)
        assert came.wait(240.0)
    assert got == [b"2\r\n"]


@pytest.mark.parametrize(("busy_s", "sent"), [(0.0, [b"1\r\n", b"1\r\n"]), (0.1, [b"1\r\n"])])
def test_the_proxy_drops_what_comes_twice_where_a_busy_machine_sends_it_too_late(busy_s, sent, monkeypatch):
    """Else it comes after the next question: a fault of the machine that no driver could tell."""
    monkeypatch.setattr(proxy, "_COPY_S", 0.05)
    got, both = [], threading.Event()
    upstream = Server({"host": "127.0.0.1", "tcp_port": 1})

    def send(part):
        got.append(part)
        time.sleep(busy_s)
        if part == b"2\r\n":
            both.set()

    plans = iter([Fault.DUPLICATED, Fault.NONE])
    options = {"seed": 1, "late_s": (0.0, 0.0)}
    with FaultProxy(upstream, proxy.bare_text_spoiler(), lambda *_: next(plans), **options) as wire:
        wire._asked.extend([(b"1?", math.inf), (b"2?", math.inf)])
        wire._pass_on(b"1\r\n", send)
        wire._pass_on(b"2\r\n", send)
        assert both.wait(240.0)
    assert got == [*sent, b"2\r\n"]


def test_the_proxy_carries_every_reply_to_a_driver_that_asks_again_before_one():
    """What came twice lets it ask for the next too early; that a reply is lost too would be another fault."""
    listener = socket.create_server(("127.0.0.1", 0))
    upstream = Server({"host": "127.0.0.1", "tcp_port": listener.getsockname()[1]})
    upstream.on_close(listener.close)

    def answer(stopped):
        connection, _ = listener.accept()
        with connection:
            asked = b""
            while asked.count(b"?") < 3:
                asked += connection.recv(9)
            connection.sendall(b"1\r\n2\r\n")
            connection.sendall(b"3\r\n")
            stopped.wait(240.0)

    upstream.start(answer)
    options = {"seed": 1, "late_s": (0.0, 0.0), "in_time_s": lambda _: 60.0}
    with (
        upstream,
        FaultProxy(upstream, proxy.bare_text_spoiler(), lambda *_: Fault.NONE, **options) as wire,
        socket.create_connection(("127.0.0.1", wire.place["tcp_port"])) as driver,
    ):
        driver.settimeout(240.0)
        for question in (b"1?", b"2?", b"3?"):
            driver.sendall(question)
        answers = b""
        while len(answers) < 9:
            answers += driver.recv(9)
        left = len(wire._asked)
    assert answers == b"1\r\n2\r\n3\r\n"
    assert not left, "a reply for each question, though two came at once"


@pytest.mark.campaign
@pytest.mark.timeout(1800)
def test_no_value_of_ten_thousand_spoiled_transactions_is_on_a_wrong_channel(tmp_path):
    count = edition(1500, 10_000)
    tallies, faults = run_campaign(tmp_path, faulted=count, seed=100, give_up_s=1500)
    judge(tallies, faults, count)
