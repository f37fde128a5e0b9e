import re
import shlex
import subprocess
import sys
import time
from statistics import median

from playwright.sync_api import Page, expect

from tests.patience import wait_until


def wait_for_fitted_run(page: Page) -> None:
    """Wait until the first pressing is recorded and fitted."""
    count = "fetch('api/v1/coefficients').then((answer) => answer.json()).then((list) => list.items.length)"
    wait_until(lambda: page.evaluate(count) > 0, "no pressing was fitted")


def test_the_virtual_press_lays_in_the_panel_that_was_entered_by_a_token_the_demonstration_says_how_to_make(
    open_page, demo_lines, tmp_path
):
    page = open_page("#/now")
    while not (commands := [line for line in demo_lines if "kerntemp token" in line]):
        page.wait_for_timeout(100)
    command = shlex.split(commands[0][commands[0].index("kerntemp token") :])
    made = subprocess.run([sys.executable, "-m", "api", *command[1:]], capture_output=True, text=True, check=True)
    page.goto(page.url.replace("#/now", "#/access"))
    page.get_by_label("Access token").fill(made.stdout.strip())
    page.get_by_role("button", name="Use for this tab").click()
    card = page.get_by_test_id("next-panel")
    for label, value in (("Thickness", "22"), ("Moisture", "6.5"), ("Start temperature", "31"), ("Target", "55")):
        card.get_by_label(label).fill(value)
    state = "fetch('api/v1/press').then((answer) => answer.json()).then((list) => list.items[0].state)"
    wait_until(lambda: page.evaluate(state) == "open", "the press did not open")
    wait_until(lambda: page.evaluate(state) == "closed", "the press did not close")
    card.get_by_role("button", name="Save").click()  # at 20 times real speed 4 s before the next panel is inserted
    expect(card).to_contain_text("by operator")
    listed = "fetch('api/v1/runs?limit=3').then((answer) => answer.json()).then((list) => list.items)"
    script = "run => fetch(`api/v1/runs/${run}`).then((answer) => answer.json())"
    so, deadline = [], time.monotonic() + 240
    while len(so) < 2 or so[1]["ended_utc"] is None:
        assert time.monotonic() < deadline, so
        runs = [page.evaluate(script, run["run"]) for run in reversed(page.evaluate(listed))]
        so = [run for run in runs if run["header"].get("panel.thickness_mm") == 22]
        if so:  # it has seen a pressing open, and draws no curves while two more pass
            page.evaluate("location.hash = '#/access'")
        page.wait_for_timeout(200)
    first, second = so[:2]
    entered = {"panel.thickness_mm": 22, "panel.moisture_percent": 6.5, "setting.core_target_C": 55}
    for run in (first, second):
        assert {key: run["header"][key] for key in entered} == entered
    by_hand = [c for c in first["changes"] if c["field"] in (*entered, "panel.initial_temperature_C")]
    assert by_hand == []
    assert [change for change in second["changes"] if change["field"] in entered] == []
    assert first["header"]["panel.initial_temperature_C"] == 31
    assert second["header"]["panel.initial_temperature_C"] < 27  # the room's again
    faces = page.evaluate(
        "run => fetch(`api/v1/runs/${run}/samples?to=4&max_points=200`).then((answer) => answer.json())",
        first["run"],
    )["columns"]
    scans = zip(*(faces[f"top_{n}"] for n in range(1, 8)), strict=True)
    upper = [median(read) for scan in scans if (read := [value for value in scan if value is not None])]
    assert min(abs(value - 31) for value in upper) < 2, upper  # a room has some 22 °C; sensors take a moment
    page.evaluate("location.hash = '#/now'")
    expect(card).to_be_visible()
    page.screenshot(path=tmp_path / "next-panel.png", full_page=True)


def test_a_live_pressing_is_followed_from_closing_to_its_stored_run(open_page):
    page = open_page("#/now")
    expect(page.locator("#link")).to_have_text("live")
    expect(page.get_by_test_id("state")).to_have_text("closed")
    expect(page.get_by_test_id("core")).to_have_text(re.compile(r"\d+\.\d"))
    expect(page.get_by_test_id("band")).to_contain_text("95 % band")
    expect(page.get_by_test_id("channels").locator(".channel")).to_have_count(16)
    expect(page.locator(".chart canvas").first).to_be_attached()
    wait_for_fitted_run(page)
    page.get_by_role("link", name="Runs").click()
    page.locator("table a").last.click()
    expect(page.get_by_role("heading", name="Measured against simulated")).to_be_visible()
    expect(page.get_by_test_id("simulation")).to_contain_text("RMSE")
    expect(page.locator(".chart canvas").nth(2)).to_be_attached()
    for kind in ("CSV", "Parquet"):
        with page.expect_download() as download:
            page.get_by_role("link", name=kind, exact=True).click()
        assert download.value.path().stat().st_size > 1000


def test_coefficients_have_one_card_each_with_their_history(open_page):
    page = open_page("#/coefficients")
    wait_for_fitted_run(page)
    page.reload()
    for name in ("h_p_o", "h_p_c", "h_pp_o", "h_pp_c", "h_wa", "h_ap"):
        expect(page.get_by_role("heading", name=re.compile(rf"^{name} "))).to_be_visible()


def test_loggers_show_sixteen_good_channels_and_both_processes(open_page):
    page = open_page("#/loggers")
    channels = page.get_by_test_id("loggers").locator("tbody tr")
    expect(channels.filter(has_text="top_7")).to_have_count(1)
    expect(page.get_by_role("columnheader", name="Value")).to_be_visible()  # of a limit switch, too
    expect(channels).to_have_count(16)
    good: set[str] = set()
    deadline = time.monotonic() + 240  # the view asks every 3 s; on a busy machine an answer may be late just then
    while len(good) < 16 and time.monotonic() < deadline:
        found = channels.filter(has=page.locator(".pill.good")).locator("td:first-child").all_inner_texts()
        good |= set(found)
        page.wait_for_timeout(200)
    assert len(good) == 16, good
    for name in ("record", "sense"):
        expect(page.locator("tbody tr", has_text=name).first).to_contain_text("running")


def test_what_the_simulation_gets_wrong_says_that_there_is_no_diagnosis_yet(open_page):
    page = open_page("#/diagnosis")
    expect(page.locator("main")).to_contain_text("No diagnosis yet")


def test_the_page_speaks_german_and_goes_dark(open_page):
    page = open_page("#/now", locale="de-DE", color_scheme="dark")
    expect(page.locator("h1")).to_have_text("Kerntemperatur")
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.get_by_label("Sprache").select_option(label="English")
    expect(page.locator("h1")).to_have_text("Core temperature")


def test_a_narrow_screen_scrolls_down_only(open_page):
    page = open_page("#/now", viewport={"width": 375, "height": 780})
    expect(page.get_by_test_id("core")).to_be_visible()
    for view in ("now", "runs", "coefficients", "diagnosis", "loggers"):
        page.goto(page.url.split("#")[0] + f"#/{view}")
        expect(page.locator("main .card").first).to_be_visible()
        page.wait_for_function("document.documentElement.scrollWidth <= 375")


def test_every_view_is_reached_by_the_keyboard(open_page):
    page = open_page("#/now")
    expect(page.locator("#link")).to_have_text("live")
    reached = []
    for _ in range(12):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.textContent.trim()"))
    for name in (
        "Skip to content",
        "Press now",
        "Runs",
        "Coefficients",
        "What the simulation gets wrong",
        "Loggers",
    ):
        assert name in reached
    charts = page.locator(".chart")
    expect(charts).to_have_count(2)
    for chart in charts.all():
        expect(chart).to_have_attribute("tabindex", "0")
        expect(chart).to_have_attribute("aria-label", re.compile(r"\w"))


def test_the_api_page_describes_every_route_and_tries_one(open_page):
    page = open_page("docs")
    entry = page.locator("details", has_text="GET /api/v1/health").first
    entry.locator("summary").click()
    entry.get_by_role("button", name="Try").click()
    expect(entry.locator("pre")).to_contain_text('"processes"')
