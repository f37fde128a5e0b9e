"""Many open pages and a poller while scans are stored at 10 Hz: a table of latencies, and no scan lost."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import httpx
import numpy as np
import pytest

from daq.records import Channel, Quality, Scan
from daq.store.store import open_store

PAGES, POLLS_PER_S, RATE_HZ, SECONDS = 50, 20, 10, 15
PATHS = ("/api/v1/press", "/api/v1/runs?limit=20", "/api/v1/health", "/api/v1/channels", "/metrics")
LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"


def _configuration(folder: Path) -> Path:
    path = folder / "kerntemp.toml"
    channels = ["platen_top", "platen_bottom", *(f"top_{i}" for i in range(1, 8))]
    logger = f'name = "x"\nprofile = "labjack-t7"\nhost = "127.0.0.1"\nchannels = {json.dumps(channels)}\n'
    path.write_text(f'[[press]]\nname = "lab"\nfile = "{LAB.as_posix()}"\n[[press.logger]]\n{logger}')
    return path


async def _page(client: httpx.AsyncClient, base: str, numbers: set[int], until: float) -> None:
    async with client.stream("GET", base + "api/v1/live") as answer:
        async for line in answer.aiter_lines():
            if line.startswith('data: {"press"'):
                numbers.add(json.loads(line[6:])["number"])
            if time.monotonic() > until:
                return


async def _poller(client: httpx.AsyncClient, base: str, taken: list[float], until: float) -> None:
    number = 0
    while time.monotonic() < until:
        begun = time.perf_counter()
        answer = await client.get(base.rstrip("/") + PATHS[number % len(PATHS)])
        taken.append(time.perf_counter() - begun)
        assert answer.status_code == 200
        number += 1
        await asyncio.sleep(max(1 / POLLS_PER_S - (time.perf_counter() - begun), 0))


async def _drive(base: str, write: object) -> tuple[list[set[int]], list[float]]:
    seen: list[set[int]] = [set() for _ in range(PAGES)]
    taken: list[float] = []
    until = time.monotonic() + SECONDS
    limits = httpx.Limits(max_connections=PAGES + 10)
    async with httpx.AsyncClient(timeout=30, limits=limits) as client:
        pages = [asyncio.create_task(_page(client, base, numbers, until)) for numbers in seen]
        await asyncio.sleep(1.0)
        writer = asyncio.create_task(asyncio.to_thread(write))
        await _poller(client, base, taken, until)
        await writer
        await asyncio.gather(*pages)
    return seen, taken


@pytest.mark.benchmark
def test_fifty_open_pages_and_a_poller_miss_no_scan(tmp_path):
    config = _configuration(tmp_path)
    store = open_store(str(tmp_path / "kerntemp.sqlite"))
    key = store.register_press("lab", tuple(Channel(f"c{i}") for i in range(16)), LAB.read_text())
    late: list[float] = []

    def write() -> None:
        start = time.monotonic()
        for number in range(RATE_HZ * (SECONDS - 3)):
            time.sleep(max(start + number / RATE_HZ - time.monotonic(), 0))
            begun = time.perf_counter()
            values = tuple(20.0 + i for i in range(16))
            scan = Scan(number, datetime.now(UTC), time.monotonic(), values, (Quality.GOOD,) * 16)
            store.append_scans(key, [scan])
            late.append(time.perf_counter() - begun)

    command = [sys.executable, "-m", "api", "serve", "--config", str(config), "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        base = server.stdout.readline().split()[-1]
        seen, taken = asyncio.run(_drive(base, write))
    finally:
        server.terminate()
        server.wait(20)
        server.stdout.close()
        store.close()
    everything = set(range(RATE_HZ * (SECONDS - 3)))
    complete = sum(everything <= numbers for numbers in seen)
    print(f"\n{PAGES} pages, {POLLS_PER_S} polls/s, {RATE_HZ} scans/s, {SECONDS} s")
    for name, values in (("read", taken), ("commit of a scan", late)):
        p50, p99 = np.percentile(1000 * np.array(values), [50, 99])
        print(f"{name:18}{len(values):6} times   median {p50:7.1f} ms   p99 {p99:7.1f} ms")
    print(f"pages that saw every scan: {complete} of {PAGES}")
    assert len(late) == len(everything)
    assert complete == PAGES
