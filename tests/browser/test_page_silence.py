"""Silence is put into words once, and alarms leave room for what they are about."""

from __future__ import annotations

import re
import threading

import pytest
from playwright.sync_api import expect

from api.http.tokens import TokenFile
from daq.words import say
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


ANNOUNCED = """
window.notified = [];
window.Notification = class {
  static permission = "granted";
  static requestPermission() { return Promise.resolve("granted"); }
  constructor(title, options) { window.notified.push(options.body); }
  close() { window.notified.push("closed"); }
};
window.tones = 0;
window.OscillatorNode = class extends window.OscillatorNode {
  start(...at) { window.tones += 1; return super.start(...at); }
};
for (const way of ["sound", "notification"]) localStorage.setItem(`kerntemp-alarm-${way}`, "on");
"""


def test_of_two_tabs_one_gives_the_sound_and_the_notification_and_both_show_who_took_the_alarm_on(served, browser):
    server, feed, _ = served
    token = TokenFile(server.config.parent / "kerntemp-tokens.json").create("foreman", "write")
    context = browser.new_context(locale="en-GB")
    context.add_init_script(ANNOUNCED + f"sessionStorage.setItem('kerntemp-token', {token!r});")
    tabs = [context.new_page() for _ in range(2)]
    context.clock.install()
    for tab in tabs:
        tab.goto(server.url + "#/alarms")
        expect(tab.get_by_test_id("alarms")).to_contain_text("No alarm yet.")
        tab.locator("h1").click()  # a page may sound once it was clicked
        expect(tab.locator("#muted")).to_be_hidden()
        tab.evaluate("async () => (await import('./static/bell.js')).listen()")
    feed.store.log("alarm", "record", say("store-trouble", why="nobody knows", count=3), "lab")
    bell = "const { listen } = await import('./static/bell.js')"
    looks = f"async () => {{ {bell}; await Promise.all([listen(), listen()]); }}"
    for tab in tabs:
        tab.evaluate(f"() => {{ ({looks})(); }}")  # both at once, and each beside its own looking
    for tab in tabs:
        expect(tab.get_by_role("button", name="Acknowledge")).to_have_count(1)
        tab.evaluate(looks)
    notified = [one for tab in tabs for one in tab.evaluate("window.notified")]
    assert len(notified) == 1
    assert "nobody knows" in notified[0]
    assert sum(tab.evaluate("window.tones") for tab in tabs) == 2  # one sound is two tones
    context.clock.pause_at(tabs[0].evaluate("Date.now()") / 1000 + 1)  # nobody looks again by himself
    tabs[0].get_by_role("button", name="Acknowledge").click()
    for tab in tabs:
        expect(tab.get_by_test_id("alarms")).to_contain_text("by foreman")
    assert [one for tab in tabs for one in tab.evaluate("window.notified")].count("closed") == 1
    context.close()


ROUNDS = 50
CLAIMING = f"""async (begin) => {{
    const {{ claim }} = await import('./static/tabs.js'), mine = [];
    for (let number = 0; number < {ROUNDS}; number += 1) {{
        await new Promise((due) => setTimeout(due, begin + 30 * number - Date.now()));
        mine.push(...await claim('test', [{{ id: String(number), raised_utc: new Date(number).toISOString() }}]));
    }}
    return mine.map(({{ id }}) => Number(id));
}}"""


def test_an_alarm_that_several_tabs_see_at_once_is_announced_by_one_of_them(served, browser):
    server, _, _ = served
    context = browser.new_context()
    tabs = [context.new_page() for _ in range(3)]
    for tab in tabs:
        tab.goto(server.url + "#/runs")
        expect(tab.locator("main .card").first).to_be_visible()
    begin = tabs[0].evaluate("Date.now()") + 1000
    for tab in tabs:
        tab.evaluate(f"(begin) => {{ window.claimed = ({CLAIMING})(begin); }}", begin)
    claimed = [number for tab in tabs for number in tab.evaluate("window.claimed")]
    assert sorted(claimed) == list(range(1, ROUNDS))  # the first look takes nothing
    context.close()
