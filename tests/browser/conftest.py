"""The demonstration as a user starts it, a server over a store a test feeds, and a browser before the page."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from http.client import HTTPException
from multiprocessing import get_all_start_methods, get_context
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from api.cli import main
from daq.records import Channel, PressEvent, PressEventKind, Quality, Scan
from daq.store.records import NewRun, RunEnd, StoredEstimate
from daq.store.store import Store, open_store

PATIENT_MS = 240_000
"""What must come is waited for however busy the machine is."""
expect.set_options(timeout=PATIENT_MS)
CHROMIUM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "chromium-browser"))), None)
"""The shell without windows does the same pages with less: 14.3 s of processor time over seven tests, 23.7 s with
the whole browser (2026-11-27)."""
NOTIFICATIONS = """
window.notified = [];
window.Notification = class {
  static permission = "granted";
  static requestPermission() { return Promise.resolve("granted"); }
  constructor(title, options) { window.notified.push(options.body); }
  close() { window.notified.push("closed"); }
};
"""
"""In a page before its own scripts: notifications are allowed, and what they are is kept."""
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
FORKED = get_context("forkserver" if "forkserver" in get_all_start_methods() else "spawn")
IMPORTED = [
    "api.cli",
    "api.alarms.watch",
    "api.alarms.ways",
    "api.http.server",
    "daq.store",
    "sqlalchemy.dialects.sqlite",
    "softsensor.jobs.drift",
    "softsensor.jobs.model_in_force",
    "babel.dates",
    "fluent.runtime",
    "uvicorn.lifespan.on",
    "uvicorn.loops.asyncio",
    "uvicorn.protocols.http.h11_impl",
    "tests.browser.forked",
]
FORKED.set_forkserver_preload(IMPORTED)
"""Servers are forked off a process that has imported what they need: that takes longer than most tests."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine; 'apt-get install chromium-headless-shell' lets this test run")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        running.new_context, running.new_page = _patient(running.new_context), _patient(running.new_page)
        yield running
        running.close()


def _patient(make: Callable[..., Any]) -> Callable[..., Any]:
    def made(**options: Any) -> Any:
        opened = make(**options)
        opened.set_default_timeout(PATIENT_MS)
        return opened

    return made


@pytest.fixture(scope="module")
def demo_lines() -> list[str]:
    """The lines of the demonstration, also those to come."""
    return []


@pytest.fixture(scope="module")
def demo(browser: Browser, demo_lines: list[str]) -> Iterator[str]:
    """Start `kerntemp demo` and return the page's address."""
    command = [sys.executable, "-m", "api", "demo", "--speed", "20"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    lines, address = demo_lines, ""
    for line in running.stdout:
        lines.append(line)
        if line.startswith("Page"):
            address = line.split()[1]
            break
    assert address, "".join(lines)
    drain = threading.Thread(target=lambda: lines.extend(running.stdout), daemon=True)
    drain.start()
    yield address
    running.send_signal(signal.SIGINT)
    running.wait(240)
    drain.join(10)
    running.stdout.close()


@pytest.fixture
def open_page(browser: Browser, demo: str, demo_lines: list[str]) -> Iterator[Callable[..., Page]]:
    """Open a view; at the end no page may have complained. How all stands then is printed."""
    contexts, complaints = [], []

    def open_view(view: str, **options: object) -> Page:
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 860}, "locale": "en-GB", **options})
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: _same_host(request.url, demo, complaints))
        page.goto(demo + view)
        return page

    yield open_view
    print("".join(demo_lines[-30:]), *_stands(demo), sep="\n")
    for context in contexts:
        context.close()
    assert complaints == []


def _stands(address: str) -> Iterator[str]:
    """Say how the demonstration's press stands and what its processes say: it is shown of a test that failed."""
    for path in ("press", "health"):
        try:
            with urlopen(f"{address}api/v1/{path}", timeout=30) as answer:
                yield json.dumps(json.load(answer), indent=1)
        except (OSError, ValueError, HTTPException) as error:
            yield f"{path}: {error}"


def _same_host(url: str, address: str, complaints: list[str]) -> None:
    if not url.startswith((address, "data:", "blob:")):
        complaints.append(f"asked another host: {url}")


LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
CHANNELS = tuple(
    Channel(n)
    for n in ("platen_top", "platen_bottom", *(f"{f}_{i}" for f in ("top", "bottom") for i in range(1, 8)))
)
KEYS = (PressEventKind.INSERTED, PressEventKind.CLOSED, PressEventKind.OPENED)


class Feed:
    """Stores pressings of 30 s at 10 Hz as fast as it is told to."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.key = store.register_press("lab", CHANNELS, LAB.read_text(encoding="utf-8"))
        self.number = self.key.next_number
        self.stop = threading.Event()
        self.pause_s = 0.1
        self.shares = (0.0, 1 / 3, 2 / 3)
        """When the panel comes, the press closes and opens, as shares of the pressing."""
        self.period_s = 0.1
        self.detail: dict[str, float] | None = None
        """What estimates say beside the core."""

    def pressing(self, scans: int = 300, batch: int = 1) -> None:
        first, zero = self.number, 1000.0 + self.number * self.period_s
        name, due_at = f"lab-{first:07d}", [int(share * scans) for share in self.shares]
        for i in range(0, scans, batch):
            rows = [self._scan(zero, i + k) for k in range(batch)]
            due = [kind for kind, at in zip(KEYS, due_at, strict=True) if i <= at < i + batch]
            events = [PressEvent(kind, rows[0].monotonic_s, rows[0].monotonic_s) for kind in due]
            begin = NewRun(name, first, rows[0].utc, zero, {"panel.material": "MDF"}) if i == 0 else None
            self.store.append_scans(self.key, rows, events, begin)
            state = "closed" if due_at[1] < i + batch <= due_at[2] else "open"
            estimates = [
                StoredEstimate(
                    scan.number, scan.monotonic_s, state, 50.0, 1.0, 48.0, 52.0, True, detail=self.detail
                )
                for scan in rows
            ]
            self.store.append_estimates("lab", estimates)
            if self.stop.wait(self.pause_s):
                break
        self.store.append_scans(self.key, [], end=RunEnd(name, self.number - 1, datetime.now(UTC)))

    def _scan(self, zero: float, i: int) -> Scan:
        scan = Scan(
            self.number, datetime.now(UTC), zero + self.period_s * i, (20.0 + 0.1 * i,) * 16, (Quality.GOOD,) * 16
        )
        self.number += 1
        return scan


def comes(page: Page, asked: str, holds: str) -> Any:
    """Return what a promise gives once a predicate holds of it; `wait_for_function` takes any promise for true."""
    until = time.monotonic() + PATIENT_MS / 1000
    while not page.evaluate(f"async () => ({holds})(await {asked})"):
        assert time.monotonic() < until, page.evaluate(asked)
        page.wait_for_timeout(100)
    return page.evaluate(asked)


ACROSS = """
const {fillText: across, clearRect: anew} = CanvasRenderingContext2D.prototype;
CanvasRenderingContext2D.prototype.fillText = function (words, ...at) {
    if (this.textAlign === 'center' && this.textBaseline === 'top') this.canvas.across?.push(words);
    return across.call(this, words, ...at);
};
CanvasRenderingContext2D.prototype.clearRect = function (...at) {
    this.canvas.across = [];
    return anew.call(this, ...at);
};
"""
"""Keeps what stands below each chart as it was last drawn."""


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


class Served:
    """`kerntemp serve` that can be stopped and started again on the same port."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}/"
        self.config = folder / "kerntemp.toml"
        logger = (
            'name = "x"\nprofile = "labjack-t7"\nhost = "127.0.0.1"\nchannels = ["platen_top", "platen_bottom"]'
        )
        self.config.write_text(
            f'[[press]]\nname = "lab"\nfile = "{LAB.as_posix()}"\n[[press.logger]]\n{logger}\n', encoding="utf-8"
        )

    def start(self) -> None:
        command = ["serve", "--config", str(self.config), "--port", str(self.port)]
        self.process = FORKED.Process(target=main, args=(command,))
        self.process.start()
        while True:
            assert self.process.is_alive()
            with suppress(ConnectionRefusedError):
                socket.create_connection(("127.0.0.1", self.port)).close()
                return
            time.sleep(0.01)

    def stop_for_a_while(self) -> None:
        os.kill(self.process.pid, signal.SIGSTOP)

    def go_on(self) -> None:
        os.kill(self.process.pid, signal.SIGCONT)

    def end(self) -> None:
        """Stop the server, whatever a failed test left it in."""
        self.go_on()
        self.process.terminate()
        self.process.join(20)
        self.process.kill()
        self.process.join(20)
        self.process.close()


@pytest.fixture
def served(tmp_path: Path, browser: Browser) -> Iterator[tuple[Served, Feed, Page]]:
    store = open_store(str(tmp_path / "kerntemp.sqlite"))
    feed, server = Feed(store), Served(tmp_path)
    server.start()
    page, complaints = browser.new_page(), []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    yield server, feed, page
    feed.stop.set()
    page.close()
    server.end()
    store.close()
    assert complaints == []
