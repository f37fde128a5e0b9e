"""What an operator enters and is told, in the words of the fields on the page, and on the screens of the plant."""

from __future__ import annotations

import re
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from playwright.sync_api import expect

from api.http.tokens import TokenFile
from daq.records import Run
from tests.browser.conftest import CHANNELS, LAB, comes


@pytest.fixture
def write(served):
    """Give the page's tab a token that may write."""
    server, _, page = served
    token = TokenFile(server.config.parent / "kerntemp-tokens.json").create("foreman", "write")
    page.add_init_script(f"sessionStorage.setItem('kerntemp-token', {token!r})")


@pytest.mark.parametrize(
    ("language", "fields", "save", "refused", "outside", "doubted"),
    [
        (
            "en",
            ("Material", "Thickness", "Start temperature"),
            "Save",
            ("press lab: material 'unobtainium' is not in the table", "Density of the panel"),
            "press lab: Thickness = 900: must be a number from 0.1 to 500 mm",
            (
                "Start temperature = 61: hands and room bring no panel above 38 °C",
                "Thickness = 190: no earlier run",
            ),
        ),
        (
            "de",
            ("Material", "Dicke", "Starttemperatur"),
            "Speichern",
            ("Presse lab: Material 'unobtainium' steht nicht in der Tabelle", "Dichte der Platte"),
            "Presse lab: Dicke = 900: muss eine Zahl von 0,1 bis 500 mm sein",
            (
                "Starttemperatur = 61: Hände und Raum erwärmen keine Platte über 38 °C",
                "Dicke = 190: keine frühere",
            ),
        ),
    ],
)
def test_the_card_refuses_and_doubts_by_the_names_of_its_fields(
    served, write, tmp_path, language, fields, save, refused, outside, doubted
):
    server, feed, page = served
    ran = Run("before", {"panel.thickness_mm": 16.0}, np.array([0.0, 60.0]), {"top_1": np.full(2, 20.0)})
    feed.store.import_run(ran, "lab")
    page.add_init_script(f"localStorage.setItem('kerntemp-language', '{language}')")
    page.goto(server.url + "#/now")
    card = page.get_by_test_id("next-panel")
    material, thickness, start = (card.get_by_label(field) for field in fields)
    material.fill("unobtainium")
    card.get_by_role("button", name=save).click()
    for part in refused:
        expect(card.get_by_role("status")).to_contain_text(part)
    material.fill("MDF")
    thickness.fill("900")
    card.get_by_role("button", name=save).click()
    expect(card.get_by_role("status")).to_contain_text(outside)
    thickness.fill("190")
    start.fill("61")
    card.get_by_role("button", name=save).click()
    for part in doubted:
        expect(card.locator(".warning", has_text=part)).to_have_count(1)
    assert "panel." not in card.inner_text()
    page.screenshot(path=tmp_path / "card.png", full_page=True)


def test_what_is_typed_of_the_next_panel_stays_when_the_live_connection_comes(served):
    """It comes once the page is there, and again after each time that it was lost."""
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing(scans=30, batch=10)
    held = []
    page.route("**/api/v1/live*", lambda route: held.append(route))
    page.goto(server.url + "#/now")
    material = page.get_by_test_id("next-panel").get_by_label("Material")
    material.fill("MDF")
    expect(page.locator(".u-wrap").first).to_be_visible()
    before = page.locator(".u-wrap").first.element_handle()
    held.pop().continue_()
    expect(page.get_by_text("live", exact=True)).to_be_visible()
    page.wait_for_function("curves => !curves.isConnected", arg=before)  # drawn again
    expect(material).to_have_value("MDF")


def test_a_limit_of_drift_tells_what_the_control_chart_tells_from_that_size_on(served, write, tmp_path):
    server, feed, page = served
    began, one = datetime(2026, 3, 4, tzinfo=UTC), {"top_1": np.ones(2)}
    for i in range(27):
        header = {"recorded.started_utc": began + timedelta(hours=i)}
        feed.store.import_run(Run(f"lab-{i:02}", header, np.array([0.0, 60.0]), one), "lab")
        value = 700.0 + 10 * (i % 3) if i < 20 else 490.0
        known = {"value": value, "sd": value / 30, "ci95": [0.9 * value, 1.1 * value], "identifiable": True}
        fit = {"coefficients": {"h_pp_c": known}, "rmse_K": 0.3, "initial_rmse_K": 1.0, "warnings": []}
        feed.store.put_fit(f"lab-{i:02}", fit)
    page.add_init_script("localStorage.setItem('kerntemp-language', 'en')")
    page.goto(server.url + "#/alarms")
    limits = page.get_by_test_id("alarm-limits")
    expect(limits).to_contain_text("Drift is raised by a coefficient's control chart, once enough pressings")
    alarm = page.get_by_test_id("alarms").get_by_text("lab: h_pp_c is at 69 % of what it was since lab-20")
    for percent, times in (("40", 0), ("20", 1)):  # h_pp_c fell by 31 %
        limits.get_by_label("Drift of at least").fill(percent)
        limits.get_by_role("button", name="Save").click()
        expect(limits.get_by_label("Drift of at least")).to_have_value(percent)
        kept = "fetch('api/v1/alarms/thresholds').then((a) => a.json()).then((l) => l.items[0].thresholds)"
        comes(page, kept, f"(it) => it.drift_percent === {percent}")
        expect(limits).to_contain_text("by foreman")
        page.wait_for_timeout(2500 if not times else 0)
        expect(alarm).to_have_count(times)
    page.screenshot(path=tmp_path / "alarms.png", full_page=True)


def test_thirty_presses_stand_on_one_small_screen(served, browser, tmp_path):
    server, feed, _ = served
    for number in range(2, 31):
        feed.store.register_press(f"press-{number}", CHANNELS, LAB.read_text(encoding="utf-8"))
    page = browser.new_page(viewport={"width": 1366, "height": 768}, locale="de-DE", bypass_csp=True)
    page.goto(server.url)
    expect(page.locator(".press-tile")).to_have_count(30)
    page.screenshot(path=tmp_path / "presses.png", full_page=True)
    page.wait_for_function("document.querySelector('.presses').getBoundingClientRect().bottom <= innerHeight")
    page.wait_for_function("""[...document.querySelectorAll('.press-tile')].every((tile) => {
        const [light, state] = ['.light', '.pill'].map((one) => tile.querySelector(one).getBoundingClientRect());
        return state.top < light.bottom && light.top < state.bottom;  // beside it, not below
    })""")
    page.close()


@pytest.mark.parametrize("count", [3, 30])
def test_the_band_of_a_tile_is_whole_and_few_tiles_keep_their_size(served, browser, count, tmp_path):
    server, feed, _ = served
    for number in range(2, count + 1):
        name = f"press-{number}" if number > 2 else "Kurztaktpresse Halle Nord 2"
        feed.store.register_press(name, CHANNELS, LAB.read_text(encoding="utf-8"))
    append = feed.store.append_estimates
    hot = {"core_celsius": 107.3, "core_low_celsius": 104.2, "core_high_celsius": 110.4}
    feed.store.append_estimates = lambda press, estimates: append(
        press, [replace(one, **hot) for one in estimates]
    )
    feed.pause_s = 0.02
    writer = threading.Thread(target=feed.pressing, args=(60_000,), daemon=True)
    writer.start()
    page = browser.new_page(viewport={"width": 1280, "height": 800}, locale="de-DE")
    page.goto(f"{server.url}#/presses")
    band = page.locator(".press-tile .band").first
    expect(band).to_have_text("104,2 … 110,4 °C")
    page.wait_for_function(f"document.querySelector('.dense') {'=' if count == 3 else '!'}== null")
    page.screenshot(path=tmp_path / "presses.png")
    page.wait_for_function("(e) => e.scrollWidth <= e.clientWidth", arg=band.element_handle())
    name = page.locator(".press-tile b", has_text="Kurztakt")
    assert (
        name.evaluate("""(name) => {
        const word = document.createRange();
        word.setStart(name.firstChild, 0);
        word.setEnd(name.firstChild, "Kurztaktpresse".length);
        return word.getClientRects().length;
    }""")
        == 1
    )  # no word of it is broken
    page.close()
    feed.stop.set()
    writer.join(240)


def test_before_the_first_estimate_no_empty_axes_stand_on_the_wall_and_no_pressing_is_waited_for(served, tmp_path):
    server, feed, page = served
    append, feed.store.append_estimates = feed.store.append_estimates, lambda *_: None
    feed.shares, feed.pause_s = (0.0, 0.001, 0.999), 0.02
    writer = threading.Thread(target=feed.pressing, args=(60_000,), daemon=True)
    writer.start()
    page.route("**/samples*", lambda route: route.abort())
    page.goto(server.url + "#/now")
    expect(page.locator("h2", has_text="Running pressing lab-0000000")).to_be_visible()
    expect(page.get_by_test_id("lacking")).to_contain_text("cannot be loaded")
    expect(page.get_by_test_id("channels")).to_contain_text("platen_top")
    page.screenshot(path=tmp_path / "now.png")
    page.unroute("**/samples*")
    expect(page.get_by_test_id("lacking")).to_be_hidden()
    page.goto(server.url + "#/wall")
    expect(page.get_by_test_id("answer")).to_have_text("No prediction yet")
    expect(page.locator(".wall-chart .u-wrap")).to_have_count(1)
    page.screenshot(path=tmp_path / "wall.png")
    expect(page.locator(".wall-chart .u-wrap")).to_be_hidden()
    feed.store.append_estimates = append
    expect(page.locator(".wall-chart .u-wrap")).to_be_visible()
    feed.stop.set()
    writer.join(240)


@pytest.mark.parametrize(("closes", "counted"), [(9.0, "Time [s]"), (1 / 3, "Time from closing [s]")])
def test_the_time_axis_counts_from_closing_once_the_press_has_closed(served, closes, counted):
    server, feed, page = served
    feed.pause_s, feed.shares = 0.0, (0.0, closes, 9.0)
    feed.pressing(scans=60, batch=10)
    page.goto(f"{server.url}#/now")
    drawers = page.get_by_text("Numbers and downloads")
    expect(drawers).to_have_count(2)
    for i in range(2):
        drawers.nth(i).click()
    expect(page.get_by_role("columnheader", name=counted, exact=True)).to_have_count(2)


def test_a_bound_may_be_written_with_spaces_around_its_sign(served):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing()
    page.goto(f"{server.url}#/runs")
    bounds = page.get_by_placeholder("panel.thickness_mm=16 rmse_K<1")
    with page.expect_response(lambda answer: "press_time_s" in answer.url and "99" in answer.url) as met:
        bounds.fill("press_time_s > 0.5  press_time_s<= 99")
    assert met.value.status == 200
    expect(page.get_by_role("link", name="lab-0")).to_have_count(1)


def test_a_bound_on_a_number_that_no_run_has_yet_is_answered_in_a_sentence(served):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing()
    page.goto(f"{server.url}#/runs?where=panel.moisture_percent<9")
    expect(page.locator("main")).to_contain_text("No run has panel.moisture_percent yet.")
    page.get_by_placeholder("panel.thickness_mm=16 rmse_K<1").fill("panel.moisture_percnt<9")
    expect(page.get_by_role("alert").filter(has_text="'panel.moisture_percnt'")).to_be_visible()


def test_the_words_of_a_link_drawn_as_a_button_stand_in_its_middle_also_where_fingers_press_it(served, browser):
    server, feed, _ = served
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    context = browser.new_context(has_touch=True, is_mobile=True, viewport={"width": 768, "height": 1024})
    page = context.new_page()
    page.goto(server.url + "#/runs/lab-0000000")
    link = page.locator("a.button").first
    expect(link).to_be_visible()
    off = """(link) => {
        const words = document.createRange();
        words.selectNodeContents(link);
        const [inner, outer] = [words, link].map((one) => one.getBoundingClientRect());
        return [outer.height, Math.abs(inner.top + inner.bottom - outer.top - outer.bottom) / 2];
    }"""
    height, middle = link.evaluate(off)
    assert height >= 44
    assert middle <= 1
    context.close()


def test_a_number_that_only_some_runs_have_is_not_called_different(served):
    server, feed, page = served
    feed.pause_s = 0.0
    for _ in range(2):
        feed.pressing()
    first, second = (record.run for record in feed.store.runs(limit=2).items)
    feed.store.annotate_run(first, {"panel.moisture_percent": 8.0, "panel.thickness_mm": 16.0}, "test")
    feed.store.annotate_run(second, {"panel.thickness_mm": 18.0}, "test")
    page.goto(f"{server.url}#/runs/compare/{first}/{second}")
    rows = page.get_by_test_id("differences").locator("tbody tr")
    expect(rows.filter(has_text="Thickness [mm]")).to_contain_text("≠")
    expect(rows.first).to_contain_text("≠")  # what differs stands before what does not
    expect(rows.filter(has_text="Moisture")).to_have_count(1)
    expect(rows.filter(has_text="Moisture")).not_to_contain_text("≠")


def test_channels_of_several_presses_are_listed_with_their_press(served):
    server, feed, page = served
    feed.store.register_press("north press", CHANNELS, LAB.read_text(encoding="utf-8"))
    page.goto(server.url + "#/loggers")
    rows = page.get_by_test_id("loggers").get_by_role("row", name="platen_top")
    expect(rows).to_have_count(2)
    expect(rows.filter(has_text="lab")).to_have_count(1)
    expect(rows.filter(has_text="north press")).to_have_count(1)


def test_a_press_with_a_long_name_does_not_make_a_narrow_screen_scroll_sideways(served, browser, tmp_path):
    server, feed, _ = served
    name = "short-cycle press of the northern hall, line 4, upper floor"
    feed.store.register_press(name, CHANNELS, LAB.read_text(encoding="utf-8"))
    page = browser.new_page(viewport={"width": 375, "height": 812}, locale="de-DE")
    for view in ("now", "presses", "nights"):
        page.goto(f"{server.url}#/{view}")
        expect(page.locator("#press")).to_be_visible()
        page.locator("#press").select_option(name)
        expect(page.locator("main .card").first).to_be_visible()
        page.screenshot(path=tmp_path / f"{view}.png")
        page.wait_for_function("document.documentElement.scrollWidth <= 375")
    page.close()


def test_a_face_that_is_not_known_is_called_so_beside_the_next_panel(served):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing(scans=30, batch=10)
    faces = {"platen_top_C": None, "platen_bottom_C": None, "top_C": None, "bottom_C": 170.2}

    def answer(route):
        now = route.fetch().json()
        route.fulfill(json={**now, "items": [one | {"faces": faces} for one in now["items"]]})

    page.route(re.compile(r"/api/v1/press(\?.*)?$"), answer)
    page.add_init_script("localStorage.setItem('kerntemp-language', 'de')")
    page.goto(server.url + "#/now")
    card = page.get_by_test_id("next-panel")
    expect(card).to_contain_text("Die Flächen jetzt: oben unbekannt, unten 170,2 °C")
    faces["bottom_C"] = None
    expect(card.get_by_text("Die Flächen jetzt")).to_be_hidden()
