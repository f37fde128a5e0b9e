"""Silence is put into words once, and alarms leave room for what they are about."""

from __future__ import annotations

import re
import threading

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import CHANNELS, LAB

TOLD = re.compile(r"(?:no|new) (?:new )?reading|no scan|silent|does not run", re.IGNORECASE)
"""A sentence that says of a silence that it is one."""


@pytest.fixture
def falling_silent(served):
    """A pressing on a watched press; what ends it, and what ends the recorder's signs of life."""
    server, feed, page = served
    feed.shares = (0.0, 0.001, 0.999)
    feed.store.put_alarm_thresholds("lab", {"silence_s": 5.0}, "foreman")
    over, dead = threading.Event(), set()

    def beat():
        while not over.wait(0.5):
            for process in {"record", "sense"} - dead:
                feed.store.beat(process, {"state": "running", "presses": [{"press": "lab"}]})

    threads = [threading.Thread(target=beat), threading.Thread(target=feed.pressing, args=(60_000,))]
    for thread in threads:
        thread.start()

    def end():
        dead.add("record")
        feed.pause_s = 3600.0

    yield server, page, end
    feed.stop.set()
    over.set()
    for thread in threads:
        thread.join(240)


@pytest.mark.parametrize("width", [375, 768, 1280, 1920])
def test_silence_is_put_into_words_once_with_its_age_and_its_cause(falling_silent, tmp_path, width):
    server, page, end = falling_silent
    page.set_viewport_size({"width": width, "height": 900})
    page.goto(server.url + "#/now")
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    expect(page.locator(".banner")).to_be_hidden()
    end()
    banner, bar = page.locator(".banner"), page.locator("#alarms")
    expect(banner).to_have_text(
        re.compile(r"^No new reading since .*\(\d.* ago\)\. record does not run; start kerntemp record$")
    )
    expect(page.get_by_test_id("answer")).to_have_text("not known")
    expect(bar).to_be_empty()
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")  # as it was then
    expect(page.get_by_test_id("band")).to_contain_text("as of")
    expect(page.locator("main")).to_contain_text(re.compile(r"Channels\s*as of \d"))
    page.screenshot(path=tmp_path / "now.png", full_page=True)
    said = banner.inner_text().removesuffix("record does not run; start kerntemp record")
    assert len(TOLD.findall(page.locator("body").inner_text())) == len(TOLD.findall(said)) + 1
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.goto(server.url + "#/runs")  # where nothing else says it
    expect(bar).to_contain_text("lab: no scan for more than 5 s")
    expect(bar).to_contain_text("record: silent for")
    page.goto(server.url + "#/alarms")
    expect(page.get_by_test_id("alarms").get_by_role("row", name="lab: no scan")).to_contain_text("stands")


def test_a_tile_and_the_wall_put_silence_into_words_once(falling_silent, tmp_path):
    server, page, end = falling_silent
    page.goto(server.url + "#/presses")
    tile = page.locator(".press-tile")
    expect(tile.locator(".core")).to_have_text("50.0°C")
    end()
    expect(tile).to_contain_text("not known, because no reading for")
    expect(tile.locator(".light")).to_have_class("light bad")
    expect(page.locator("#alarms")).to_have_text(re.compile(r"^⚠ record: silent for [^⚠]*$"))
    page.screenshot(path=tmp_path / "presses.png")
    assert len(TOLD.findall(tile.inner_text())) == 1
    page.goto(server.url + "#/wall")
    expect(page.get_by_test_id("answer")).to_contain_text("not known, because no reading for")
    expect(page.get_by_test_id("health")).to_have_text("record does not run; start kerntemp record")
    page.screenshot(path=tmp_path / "wall.png")


@pytest.mark.parametrize(("width", "height"), [(375, 812), (768, 1024), (1280, 800), (1366, 768), (1920, 1080)])
def test_many_alarms_leave_the_screen_to_what_they_are_about(served, browser, tmp_path, width, height):
    server, feed, _ = served
    names = ["lab", *(f"Linie-{1 + n // 10}-Presse-{n}" for n in range(2, 31))]
    for name in names:
        feed.store.register_press(name, CHANNELS, LAB.read_text(encoding="utf-8"))
    late = [{"press": name, "behind_scans": 9000} for name in names]
    over = threading.Event()

    def beat():
        while not over.wait(0.5):
            feed.store.beat("record", {"state": "running", "presses": []})
            feed.store.beat("sense", {"state": "running", "presses": late})

    heart = threading.Thread(target=beat)
    heart.start()
    page = browser.new_page(viewport={"width": width, "height": height}, locale="de-DE")
    page.goto(server.url + "#/presses")
    bar = page.locator("#alarms")
    expect(page.locator(".press-tile")).to_have_count(30)
    expect(bar.get_by_role("link")).to_have_text("27 weitere Alarme")
    page.screenshot(path=tmp_path / "presses.png")
    assert bar.bounding_box()["height"] <= height / 4
    if width >= 1280:
        page.wait_for_function("document.querySelector('.presses').getBoundingClientRect().bottom <= innerHeight")
    bar.get_by_role("link").click()
    expect(page.get_by_test_id("alarms").get_by_text("Messzeilen im Rückstand")).to_have_count(30)
    page.close()
    over.set()
    heart.join()
