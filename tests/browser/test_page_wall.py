"""The one answer, and the wall: told from one look ahead, and nothing told that rests on old readings."""

from __future__ import annotations

import threading
import time

import pytest
from playwright.sync_api import expect

from daq.store.records import StoredEstimate

AHEAD = {
    "open_in_s": 11.0,
    "target_in_s": 26.0,
    "target_earliest_s": 23.0,
    "target_latest_s": 30.0,
    "peak_C": 70.0,
}
COURSE = [[0.0, 50.0, 48.0, 52.0], [20.0, 58.0, 54.0, 62.0], [40.0, 66.0, 60.0, 72.0]]


@pytest.fixture
def pressing(served):
    """A pressing with a target of which the sensor says when to open; the server, its page, the feed."""
    server, feed, page = served
    append = feed.store.append_estimates

    def foreseeing(press, estimates):
        beside = {**AHEAD, "forecast_age_s": 0.3, "course": COURSE, "left_out": {"top_3": -71.2}}
        append(press, [StoredEstimate(*_told(e), detail=beside) for e in estimates])

    feed.store.append_estimates = foreseeing
    feed.shares = (0.0, 0.001, 0.999)
    writer = threading.Thread(target=feed.pressing, args=(6000,), daemon=True)
    writer.start()
    while feed.store.open_run("lab") is None:
        time.sleep(0.01)
    run = feed.store.open_run("lab").run
    feed.store.annotate_run(run, {"setting.core_target_C": 60.0}, "test")
    yield server, page
    feed.stop.set()
    writer.join(20)


def _told(e):
    core = (e.core_celsius, e.core_sd_kelvin, e.core_low_celsius, e.core_high_celsius)
    return e.number, e.monotonic_s, e.state, *core, True, "", "1"


@pytest.mark.parametrize("view", ["#/now", "#/wall"])
def test_the_answer_is_one_line_and_nothing_beside_it_contradicts_it(pressing, view):
    server, page = pressing
    page.goto(server.url + view)
    answer = page.get_by_test_id("answer")
    expect(answer).to_have_text("open in 11 s (8 to 15)")
    expect(answer).to_have_class("answer open_in")
    expect(page.get_by_text("Peak if opened now")).to_have_count(0)
    expect(page.locator(".chart canvas").first).to_be_visible()


def test_a_channel_that_is_not_used_says_so_on_its_tile_and_is_not_called_good(pressing):
    server, page = pressing
    page.goto(server.url + "#/now")
    tile = page.locator(".channel", has_text="top_3")
    expect(tile).to_contain_text("71 K below its neighbours, not used")
    expect(tile).not_to_contain_text("good")
    expect(page.locator(".channel", has_text="top_4")).to_contain_text("good")


@pytest.mark.parametrize("view", ["#/now", "#/wall"])
def test_without_readings_no_answer_stands_and_nothing_is_green(pressing, view):
    server, page = pressing
    page.goto(server.url + view)
    answer = page.get_by_test_id("answer")
    expect(answer).to_have_text("open in 11 s (8 to 15)")
    server.stop_for_a_while()
    expect(answer).to_contain_text("not known, because no reading for")
    green = """() => [...document.querySelectorAll('body *')].filter((e) => {
        const good = getComputedStyle(document.documentElement).getPropertyValue('--good').trim();
        const probe = Object.assign(document.createElement('i'), {style: `color:${good}`});
        document.body.append(probe);
        const rgb = getComputedStyle(probe).color;
        probe.remove();
        const styles = [getComputedStyle(e), getComputedStyle(e, '::before')];
        const drawn = styles[1].content !== 'none' && styles[1].backgroundColor === rgb;
        const own = e.checkVisibility() && e.innerText?.trim() && styles[0].color === rgb;
        return drawn || own || styles[0].backgroundColor === rgb;
    }).map((e) => e.className)"""
    assert page.evaluate(green) == []
    server.go_on()
    expect(answer).to_have_text("open in 11 s (8 to 15)")
    assert page.evaluate(green) != []


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (768, 1024), (375, 812)])
def test_the_wall_fills_the_screen_and_does_not_scroll(pressing, browser, width, height):
    server, _ = pressing
    page = browser.new_page(viewport={"width": width, "height": height}, locale="de-DE")
    page.goto(server.url + "#/wall")
    expect(page.get_by_test_id("answer")).to_have_text("öffnen in 11 s (8 bis 15)")
    expect(page.locator(".chart canvas")).to_be_visible()
    size = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    assert size == [width, height]
    chart = page.locator(".chart .uplot").bounding_box()
    assert chart["y"] + chart["height"] <= height  # with its axis
    letters = page.get_by_test_id("core").evaluate("e => parseFloat(getComputedStyle(e).fontSize)")
    assert letters >= 0.15 * min(width, height)
    page.close()


def test_a_part_of_the_chart_stays_in_view_until_follow_is_pressed(pressing):
    server, page = pressing
    page.goto(server.url + "#/now")
    chart = page.locator(".chart").first
    expect(chart.locator("canvas")).to_be_visible()
    follow = chart.get_by_role("button", name="Follow")
    expect(follow).to_be_hidden()
    chart.focus()
    page.keyboard.press("+")
    expect(follow).to_be_visible()
    page.wait_for_timeout(1500)
    expect(follow).to_be_visible()
    follow.click()
    expect(follow).to_be_hidden()


def test_machines_are_given_the_advice_the_page_shows(pressing):
    server, page = pressing
    page.goto(server.url + "#/now")
    told = page.evaluate("fetch('api/v1/advice').then((answer) => answer.json())")["items"][0]
    assert (told["press"], told["advice"]["verdict"]) == ("lab", "open_in")
    assert 10.0 < told["advice"]["open_latest_s"] <= 15.0  # counted from now
