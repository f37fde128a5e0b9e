"""Photograph the page before a running demonstration: ``python deploy/figures/page_pictures.py [FOLDER]``.

Without a folder, README's picture is renewed; with one, every view goes there, light and dark, wide and narrow.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

PICTURES = Path(__file__).parents[1] / "pictures"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "chromium-browser"))), None)
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
SPEED = 5
"""Slow enough that the live sensor keeps up beside a browser that draws without a graphics card."""
PRESSINGS_BEFORE = 3
CLOSED_S = (8.0, 13.0)
"""The picture is begun when a press has been closed for so long: it takes some 15 s of the demonstration's time,
and the shortest pressing 35 s."""


def page_address(demo: subprocess.Popen[str]) -> str:
    """Return the address the demonstration prints."""
    for line in demo.stdout or ():
        if line.startswith("Page"):
            return line.split()[1]
    raise SystemExit("the demonstration did not start")


def take(browser: Browser, address: str, view: str, path: Path, **options: object) -> None:
    """Photograph one view."""
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 820}, "locale": "en-GB", **options})
    page = context.new_page()
    page.goto(address + view)
    if view.startswith("#/runs/"):
        page.get_by_test_id("simulation").wait_for(timeout=120_000)  # solved on the server first
    page.wait_for_timeout(2500)
    page.screenshot(path=path, full_page=view != "#/now")
    context.close()


def wait_for(browser: Browser, address: str) -> str:
    """Wait for fitted pressings and a closed press; return the newest fitted run."""
    page = browser.new_page()
    page.goto(address)
    deadline = time.monotonic() + 1200
    while time.monotonic() < deadline:
        state = page.evaluate(
            "Promise.all(['press', 'coefficients'].map(p => fetch('api/v1/' + p).then(a => a.json())))"
            ".then(([p, c]) => [c.items.map(i => i.run), p.items[0]?.state, p.items[0]?.time_since_closing_s])"
        )
        if len(state[0]) >= PRESSINGS_BEFORE and state[1] == "closed" and CLOSED_S[0] < state[2] < CLOSED_S[1]:
            page.close()
            return str(state[0][0])
        time.sleep(0.1)
    raise SystemExit("no pressing in time")


def main() -> None:
    """Start the demonstration, take the pictures, end it."""
    parser = argparse.ArgumentParser(description="Photograph the page before a running demonstration.")
    parser.add_argument("folder", type=Path, nargs="?", help="every view goes here; README's picture without")
    folder = parser.parse_args().folder
    demo = subprocess.Popen(
        [sys.executable, "-m", "api", "demo", "--speed", str(SPEED)], stdout=subprocess.PIPE, text=True
    )
    try:
        address = page_address(demo)
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            run = wait_for(browser, address)
            PICTURES.mkdir(exist_ok=True)
            if folder is None:
                take(browser, address, "#/now", PICTURES / "page.png")
                return
            folder.mkdir(exist_ok=True)
            for name in ("now", f"runs/{run}", "runs", "coefficients", "diagnosis", "loggers"):
                file = name.split("/")[0] + ("-one" if "/" in name else "")
                take(browser, address, f"#/{name}", folder / f"{file}.png")
                take(browser, address, f"#/{name}", folder / f"{file}-dark.png", color_scheme="dark")
                narrow = {"width": 375, "height": 780}
                take(browser, address, f"#/{name}", folder / f"{file}-375.png", viewport=narrow, locale="de-DE")
                tablet = {"width": 820, "height": 1180}
                take(browser, address, f"#/{name}", folder / f"{file}-tablet.png", viewport=tablet, has_touch=True)
    finally:
        demo.send_signal(signal.SIGINT)
        demo.wait(60)


if __name__ == "__main__":
    main()
