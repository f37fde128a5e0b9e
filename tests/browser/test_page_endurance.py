"""A page that stays open: the server restarts under it, and days of scans pass through it."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from daq.records import Channel, PressEvent, PressEventKind, Quality, Scan
from daq.store.records import NewRun, RunEnd, StoredEstimate
from daq.store.store import Store, open_store

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

    def pressing(self, scans: int = 300, batch: int = 1) -> None:
        first, zero = self.number, 1000.0 + self.number * 0.1
        name = f"lab-{first:07d}"
        for i in range(0, scans, batch):
            rows = [self._scan(zero, i + k) for k in range(batch)]
            due = [KEYS[j] for j in range(3) if i <= (j * scans) // 3 < i + batch]
            events = [PressEvent(kind, rows[0].monotonic_s, rows[0].monotonic_s) for kind in due]
            begin = NewRun(name, first, rows[0].utc, zero, {"panel.material": "MDF"}) if i == 0 else None
            self.store.append_scans(self.key, rows, events, begin)
            said = [
                StoredEstimate(scan.number, scan.monotonic_s, "closed", 50.0, 1.0, 48.0, 52.0, True)
                for scan in rows
            ]
            self.store.append_estimates("lab", said)
            if self.stop.wait(self.pause_s):
                break
        self.store.append_scans(self.key, [], end=RunEnd(name, self.number - 1, datetime.now(UTC)))

    def _scan(self, zero: float, i: int) -> Scan:
        scan = Scan(self.number, datetime.now(UTC), zero + 0.1 * i, (20.0 + 0.1 * i,) * 16, (Quality.GOOD,) * 16)
        self.number += 1
        return scan


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
        command = [sys.executable, "-m", "api", "serve", "--config", str(self.config), "--port", str(self.port)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline().startswith("kerntemp serves")

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(20)
        self.process.stdout.close()


@pytest.fixture
def served(tmp_path: Path, browser: Browser) -> Iterator[tuple[Served, Feed, Page]]:
    store = open_store(str(tmp_path / "kerntemp.sqlite"))
    feed, server = Feed(store), Served(tmp_path)
    server.start()
    page = browser.new_page()
    yield server, feed, page
    feed.stop.set()
    page.close()
    server.end()
    store.close()


def core_text(page: Page) -> str:
    return page.get_by_test_id("core").inner_text()


def test_an_open_page_goes_on_by_itself_after_the_server_was_restarted(served):
    server, feed, page = served
    writer = threading.Thread(target=feed.pressing, args=(3000,), daemon=True)
    writer.start()
    page.goto(server.url + "#/now")
    expect(page.locator("#link")).to_have_text("live")
    server.end()
    expect(page.locator("#link")).to_have_text("no connection")
    server.start()
    expect(page.locator("#link")).to_have_text("live")
    tile = page.get_by_test_id("channels").locator(".channel b").first
    seen = tile.inner_text()
    expect(tile).not_to_have_text(seen)
    feed.stop.set()
    writer.join(20)


@pytest.mark.campaign
def test_a_tab_that_stays_open_while_many_pressings_pass_keeps_its_memory(served):
    server, feed, page = served
    feed.pause_s = 0.05
    page.goto(server.url + "#/now")
    session = page.context.new_cdp_session(page)

    def used() -> float:
        session.send("HeapProfiler.collectGarbage")
        return float(session.send("Runtime.getHeapUsage")["usedSize"]) / 1e6

    def pass_pressings(count: int) -> None:
        for _ in range(count):
            feed.pressing(batch=10)
        expect(page.locator(".facts")).to_contain_text(f"lab-{feed.number - 300:07d}")

    pass_pressings(10)
    before = used()
    pass_pressings(60)
    after = used()
    print(f"\n70 pressings, {feed.number} scans: {before:.1f} MB -> {after:.1f} MB")
    assert after < before + 5.0
