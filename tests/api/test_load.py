"""Many open pages, a poller and hostile clients while scans are recorded at 10 Hz: a table, and no scan lost.

The press is virtual, everything else is real: loggers over Modbus TCP, recorder, live sensor and server in
processes of their own. Whether a scan was late or lost is read from the store afterwards, not from the page.
"""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.patience import wait_until

PAGES, POLLS_PER_S, SECONDS = 50, 20, 20
PATHS = (
    "/api/v1/press",
    "/api/v1/runs?limit=20",
    "/api/v1/health",
    "/api/v1/channels",
    "/api/v1/coefficients",
    "/metrics",
)
HOSTILE_STREAMS, SILENT, LISTENERS = 1200, 500, 200
RATE_HZ = 10.0


@contextmanager
def plant(folder: Path) -> Iterator[str]:
    """The demonstration at real speed; yields the server's address when scans arrive."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit("cut short"))  # the demonstration ends with us
    command = [sys.executable, "-m", "api", "demo", "--speed", "1", "--data", str(folder)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        address = next(line.split()[1] for line in running.stdout if line.startswith("Page")).rstrip("/")
        wait_until(lambda: newest_scan(folder) >= 50 and whole_since(folder, newest_scan(folder) - 20))
        yield address
    finally:
        running.terminate()
        running.wait(240)
        running.stdout.close()
        signal.signal(signal.SIGTERM, before)


def rows(folder: Path, query: str, *values: object) -> list[tuple[object, ...]]:
    path = folder / "kerntemp.sqlite"
    if not path.exists():
        return []
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(query, values).fetchall()


def whole_since(folder: Path, number: int) -> bool:
    """Whether every logger has answered in every scan from `number` on."""
    return not rows(folder, "SELECT 1 FROM scan WHERE number >= ? AND faults IS NOT NULL", number)


def newest_scan(folder: Path) -> int:
    try:
        found = rows(folder, "SELECT max(number) FROM scan")
    except sqlite3.OperationalError:
        return -1
    return int(found[0][0]) if found and found[0][0] is not None else -1


def check_store(folder: Path, first: int, last: int) -> None:
    """Print and assert what the store says about the scans recorded meanwhile."""
    found = rows(folder, "SELECT number, monotonic_s, faults FROM scan WHERE number BETWEEN ? AND ?", first, last)
    steps = np.diff([row[1] for row in found])
    faults = [row for row in found if row[2] is not None]
    print(
        f"scans in the store  {len(found)} of {last - first + 1}; step median {1000 * np.median(steps):.1f} ms, "
        f"longest {1000 * steps.max():.1f} ms; scans with a missing value {len(faults)}"
    )
    assert [row[0] for row in found] == list(range(first, last + 1)), "a scan is lost"
    assert steps.max() < 1.5 / RATE_HZ, "a scan is late"
    assert not faults, "a reading came too late for its scan"


@dataclass
class Seen:
    """What one open page got."""

    numbers: set[int] = field(default_factory=set)


async def page(client: httpx.AsyncClient, base: str, seen: Seen, until: float) -> None:
    async with client.stream("GET", base + "/api/v1/live") as answer:
        assert answer.status_code == 200
        async for line in answer.aiter_lines():
            if line.startswith('data: {"press"') and '"temperatures_C"' in line:
                seen.numbers.add(json.loads(line[6:])["number"])
            if time.monotonic() > until:
                return


async def poller(client: httpx.AsyncClient, base: str, taken: list[float], until: float) -> None:
    number, start = 0, time.monotonic()
    while time.monotonic() < until:
        begun = time.perf_counter()
        answer = await client.get(base + PATHS[number % len(PATHS)])
        taken.append(time.perf_counter() - begun)
        assert answer.status_code == 200
        number += 1
        await asyncio.sleep(max(start + number / POLLS_PER_S - time.monotonic(), 0))


async def drive(base: str, pages: int, seconds: float) -> tuple[list[Seen], list[float]]:
    seen, taken = [Seen() for _ in range(pages)], []
    until = time.monotonic() + seconds
    async with httpx.AsyncClient(timeout=240, limits=httpx.Limits(max_connections=pages + 10)) as client:
        tasks = [asyncio.create_task(page(client, base, one, until)) for one in seen]
        await asyncio.sleep(1.0)
        await poller(client, base, taken, until)
        await asyncio.gather(*tasks)
    return seen, taken


def tell(taken: list[float]) -> float:
    p50, p99, worst = np.percentile(1000 * np.array(taken), [50, 99, 100])
    print(f"reads               {len(taken)}; median {p50:.1f} ms, p99 {p99:.1f} ms, longest {worst:.1f} ms")
    return float(p99)


@pytest.mark.benchmark
def test_fifty_open_pages_and_a_poller_miss_no_scan(tmp_path):
    with plant(tmp_path) as base:
        before = newest_scan(tmp_path) + 1
        seen, taken = asyncio.run(drive(base, PAGES, SECONDS))
        after = newest_scan(tmp_path)
    print(f"\n{PAGES} pages, {POLLS_PER_S} polls/s, 10 scans/s, {SECONDS} s")
    tell(taken)
    check_store(tmp_path, before, after)
    whole = [set(range(min(s.numbers), max(s.numbers) + 1)) == s.numbers for s in seen]
    print(f"pages without a gap {sum(whole)} of {PAGES}")
    assert all(whole)


@pytest.mark.benchmark
def test_thousands_of_streams_and_silent_clients_are_refused_and_disturb_neither_recorder_nor_reader(tmp_path):
    with plant(tmp_path) as base:
        host, port = base.removeprefix("http://").split(":")
        before = newest_scan(tmp_path) + 1
        asked = f"GET /api/v1/live HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()
        streams = [socket.create_connection((host, int(port)), timeout=240) for _ in range(HOSTILE_STREAMS)]
        silent = [socket.create_connection((host, int(port)), timeout=240) for _ in range(SILENT)]
        for stream in streams:
            stream.sendall(asked)
        answers = [stream.recv(12)[9:12] for stream in streams]
        _, taken = asyncio.run(drive(base, 0, 8))
        for opened in (*streams, *silent):
            opened.close()
        _, calm = asyncio.run(drive(base, 1, 4))
        after = newest_scan(tmp_path)
    accepted, refused = answers.count(b"200"), answers.count(b"503")
    print(
        f"\n{HOSTILE_STREAMS} streams asked for: {accepted} taken, {refused} refused; {SILENT} silent connections"
    )
    tell(taken)
    tell(calm)
    check_store(tmp_path, before, after)
    assert (accepted, refused) == (LISTENERS, HOSTILE_STREAMS - LISTENERS)
