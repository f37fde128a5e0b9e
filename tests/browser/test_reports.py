"""Reports as files in a browser: axe finds nothing in them, unfolded, by day and by night, in both languages."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest
from playwright.sync_api import Browser

import daq
from tests.browser.test_page_views import violations

SAMPLES = sorted((daq.shared_files() / "samples").glob("2026-03-04-*.csv"))
PRESS = str(daq.shared_files() / "presses/lab.toml")


@pytest.fixture(scope="module", params=[("fit", 3, "en"), ("fit", 3, "de"), ("diagnose", 8, "de")], ids=str)
def report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    command, runs, language = request.param
    path = Path(tmp_path_factory.mktemp("reports") / f"{command}-{language}.html")
    arguments = [command, *map(str, SAMPLES[:runs]), "--press", PRESS, "--html", str(path)]
    told = {**os.environ, "KERNTEMP_LANGUAGE": language}
    subprocess.run([sys.executable, "-m", "api", *arguments], check=True, capture_output=True, env=told)
    return path


def test_axe_finds_nothing_in_a_report_however_much_of_it_is_unfolded(report: Path, browser: Browser):
    for scheme in ("light", "dark"):
        context = browser.new_context(
            viewport={"width": 1280, "height": 900}, color_scheme=scheme, bypass_csp=True
        )
        page = context.new_page()
        page.goto(report.as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
        page.evaluate((resources.files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8"))
        assert violations(page) == [], scheme
        page.set_viewport_size({"width": 375, "height": 800})
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
        context.close()
