"""The demonstration as a user starts it, and a real browser before its page."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

expect.set_options(timeout=30_000)
CHROMIUM = next((p for p in ("/usr/bin/chromium", "/usr/bin/chromium-browser") if Path(p).exists()), None)
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine; 'apt-get install chromium' lets this test run")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield running
        running.close()


@pytest.fixture(scope="module")
def demo(browser: Browser) -> Iterator[str]:
    """Start `kerntemp demo` and return the page's address."""
    command = [sys.executable, "-m", "api", "demo", "--speed", "20"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    said: list[str] = []
    address = ""
    for line in running.stdout:
        said.append(line)
        if line.startswith("Page"):
            address = line.split()[1]
            break
    assert address, "".join(said)
    drain = threading.Thread(target=lambda: said.extend(running.stdout), daemon=True)
    drain.start()
    yield address
    running.send_signal(signal.SIGINT)
    running.wait(60)
    drain.join(10)
    running.stdout.close()


@pytest.fixture
def open_page(browser: Browser, demo: str) -> Iterator[Callable[..., Page]]:
    """Open a view; at the end no page may have complained."""
    contexts, complaints = [], []

    def open_view(view: str, **options: object) -> Page:
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 860}, "locale": "en-GB", **options})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(60_000)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: _same_host(request.url, demo, complaints))
        page.goto(demo + view)
        return page

    yield open_view
    for context in contexts:
        context.close()
    assert complaints == []


def _same_host(url: str, address: str, complaints: list[str]) -> None:
    if not url.startswith((address, "data:", "blob:")):
        complaints.append(f"asked another host: {url}")
