"""Reports as files in a browser: axe finds nothing in them, unfolded, by day and by night, in both languages."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest
from playwright.sync_api import Browser

import daq
import softsensor
from softsensor.report.diagnosis_report import diagnosis_report
from softsensor.report.fit_report import fit_report
from tests.browser.test_page_views import violations

SAMPLES = sorted((daq.shared_files() / "samples").glob("2026-03-04-*.csv"))
PRESS = daq.shared_files() / "presses/lab.toml"
SOUGHT = ("moisture_evaporation", "edge_loss")
"""What the samples hide, and another; the page of the whole catalogue has more rows of the same kind."""

BEYOND_PICTURES = """() => [...document.querySelectorAll('.profiles > div')].filter(part => {
    const right = part.querySelector('svg').getBoundingClientRect().right;
    return [...part.querySelectorAll('*')].some(one => one.getBoundingClientRect().right > right + 1);
}).map(part => part.innerText)"""
"""Profiles next to whose picture something stands that belongs under it."""
TOO_WIDE = """() => [...document.querySelectorAll('.scroll')].filter(part => !part.querySelector('.matrix')
    && part.scrollWidth > part.clientWidth).map(part => part.innerText)"""
"""Tables of a telephone that go on beyond its right edge; a matrix may (WCAG 2.2, 1.4.10: two dimensions)."""

FEW_CELLS = "document.querySelectorAll('tr > :nth-child(n+8)').forEach(cell => cell.remove())"
"""The numbers behind pictures are thousands of cells of one make; axe looks at each."""


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_axe_finds_nothing_in_a_report_however_much_of_it_is_unfolded(
    command: str, browser: Browser, tmp_path: Path
):
    if command == "fit":
        fitted = softsensor.fit(SAMPLES[:3], PRESS, profiles=True)
        pages = {"light": fit_report(fitted.campaign), "dark": fit_report(fitted.campaign, language="de")}
    else:
        found = softsensor.diagnose(SAMPLES[:6], PRESS, effects=SOUGHT)
        assert found.verdict == "named"
        pages = dict.fromkeys(("light", "dark"), diagnosis_report(found.diagnosis, "de"))
    for scheme, content in pages.items():
        report = tmp_path / f"{command}-{scheme}.html"
        report.write_text(content, encoding="utf-8")
        look_at(report, browser, scheme)


def look_at(report: Path, browser: Browser, scheme: str) -> None:
    context = browser.new_context(viewport={"width": 375, "height": 800}, color_scheme=scheme, bypass_csp=True)
    page = context.new_page()
    page.goto(report.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
    page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate(TOO_WIDE) == []
    page.set_viewport_size({"width": 1280, "height": 900})
    assert page.evaluate(BEYOND_PICTURES) == []
    page.evaluate(FEW_CELLS)
    page.evaluate((resources.files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8"))
    assert violations(page) == [], scheme
    context.close()
