"""Every view with stored pressings: nothing for axe to find, metadata changed by hand, files taken by token."""

from __future__ import annotations

import re
import threading
import time
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from importlib import resources
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from api.http.tokens import TokenFile
from daq.simulated.campaign import Plan, make_campaign
from daq.store import StoredNight
from daq.words import Message, say
from daq.words.message import words
from tests.browser.conftest import ACROSS, CHANNELS, NOTIFICATIONS, PATIENT_MS, comes
from tests.curves import CURVES

VIEWS = (
    "#/now",
    "#/wall",
    "#/runs",
    "#/runs/campaign-1",
    "#/runs/day",
    "#/runs/blisters",
    "#/runs/scatter",
    "#/coefficients",
    "#/diagnosis",
    "#/nights",
    "#/alarms",
    "#/journal",
    "#/presses",
    "#/loggers",
    "#/access",
    "docs",
)
LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
EFFECT = {
    "name": "moisture_evaporation",
    "set": ["moisture_evaporation"],
    "parameters": {"moisture_percent": {"value": 3.2, "ci95": [2.3, 4.0]}},
    "p_value": 0.0005,
    "heldout_gain_K": 0.58,
    "explained_share": 0.98,
    "worth": "lowers the residual by 0.58 K on a typical run left out (geometric mean over the runs)",
    "worth_said": say("worth-saves", gain=0.58).to_json(),
}
WHERE = {
    "signal": "panel.top",
    "state": "open",
    "phase": "after opening",
    "phase_said": say("phase-after-opening").to_json(),
    "from_s": 8.0,
    "to_s": 16.0,
    "residual_K": 0.66,
    "low_C": 154.2,
    "high_C": 165.9,
}
DIAGNOSIS = {
    "verdict": "named",
    "effects": [EFFECT],
    "base": {"rmse_K": 1.05, "heldout_rmse_K": 1.06, "core_rmse_K": None},
    "extended": {"rmse_K": 0.47, "heldout_rmse_K": 0.47, "core_rmse_K": None},
    "noise_floor_K": 0.38,
    "where": [WHERE],
    "candidates": [{"name": "moisture_evaporation", "score": 9.0, "p_value": 0.0005, "heldout_gain_K": 0.65}],
    "next_measurement": "Weigh the panel before and after pressing, or press one dried to zero moisture.",
    "next_measurement_said": say("effect-moisture_evaporation-confirmed-by").to_json(),
    "curves": CURVES,
}
LAW = {
    "kind": "heat",
    "variable": "temperature_C",
    "curve": [[80.0, 0.0, -40.0, 40.0], [100.0, 900.0, 700.0, 1100.0], [120.0, 20.0, -60.0, 100.0]],
    "unit": "kJ/m3K",
    "heldout_gain_K": 0.84,
    "heldout_gain_ci95": [0.5, 1.1],
    "set": ["heat"],
    "resembles": "moisture_evaporation",
}
LAW_SENTENCE = say("law-resembles", cause=Message("effect-moisture_evaporation-called"))
PROSPECT = say("plan-settles", percent=64.0, runs=say("plan-runs", runs=2))
BEST = say("plan-best", settings=(say("plan-set-press_time_s", value=165.0),), prospect=PROSPECT)
OPEN = say("plan-open-suspected", causes=(Message("effect-resin_cure-called"),))


def sentence(message: Message) -> dict[str, Any]:
    """Return a sentence as the store keeps it."""
    return {"sentence": words(message), "sentence_said": message.to_json()}


NOTE = say("note-thickness-alike", thickness=12.1, given=10.0)
BEYOND = {
    "warnings": [words(NOTE)],
    "warnings_said": [NOTE.to_json()],
    "verdict": "unknown_effect",
    "effects": [],
    "law": LAW,
    "law_sentences": [sentence(LAW_SENTENCE)],
    "plan": {"open": [sentence(OPEN) | {"pressings": [sentence(BEST)]}], "sentences": []},
}
NIGHT_BEGAN = datetime(2026, 3, 5, 1, 0, tzinfo=UTC)
NIGHT = {
    "runs": 1204,
    "new": 3,
    "fitted": 2,
    "not_fitted": 1,
    "blind": 0,
    "later": 800,
    "left_out": [{"run": "campaign-1", "why": say("run-fit-killed", run="campaign-1").to_json()}],
    "seconds": 46.8,
    "memory_bytes": 412_000_000,
    "verdict": "named",
    "named": ["moisture_evaporation"],
    "promoted": "lab-2026-03-05-1",
    "refused": "",
    "version": "lab-2026-03-05-1",
    "reason": say("night-diagnosis-confirms").to_json(),
}


@pytest.fixture
def plant(served) -> tuple[str, Page, str]:
    """A server over a pressing with its fit, a diagnosis and two models; address, page, token that may write."""
    server, feed, page = served
    run, _ = make_campaign(7, 1, plan=Plan(rate_hz=2.0, closed_column=False, thickness_mm=16.0))[0]
    store = feed.store
    store.import_runs([replace(run, name="campaign-1")], "lab", LAB.read_text(encoding="utf-8"))
    coefficient = {"value": 600.0, "sd": 20.0, "ci95": [560.0, 640.0], "identifiable": True}
    fit = {"run": "campaign-1", "converged": True, "coefficients": {"h_pp_c": coefficient}, "warnings": []}
    store.put_fit("campaign-1", fit | {"rmse_K": 0.3, "initial_rmse_K": 2.0}, "")
    why = say("model-from-sisters", count=2, sisters=("left", "right")).to_json()
    for version, status in (("1", "retired"), ("2", "promoted"), (NIGHT["version"], "candidate")):
        model = {"version": version, "effects": [], "basis": {"reason": why}}
        store.put_model("lab", version, model, status=status)
    store.put_diagnosis("lab", DIAGNOSIS)
    ended = datetime.now(UTC)
    store.put_night(StoredNight("lab", ended - timedelta(seconds=47), ended, NIGHT, {}))
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    token = TokenFile(server.config.parent / "kerntemp-tokens.json").create("foreman", "write")
    return server.url, page, token


def with_token(page: Page, token: str) -> None:
    page.add_init_script(f"sessionStorage.setItem('kerntemp-token', {token!r})")


def tip_says(chart: Locator, text: str) -> None:
    """Point at a chart until its tip says something: one that is drawn anew forgets where the pointer is."""
    tip, tries = chart.locator(".chart-tip"), PATIENT_MS // 4_000
    for number in range(tries):
        chart.locator(".u-over").hover(position={"x": 300 + 5 * (number % 4), "y": 60})
        with suppress(AssertionError):
            expect(tip).to_contain_text(re.compile(text, re.DOTALL), timeout=4_000)
            return
    raise AssertionError(f"{tip.inner_text()!r} instead of {text!r}")


def violations(page: Page) -> list[dict[str, Any]]:
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [{"rule": v["id"], "where": v["nodes"][0]["target"]} for v in found]


FEW_ROWS = "document.querySelectorAll('details.keep tbody tr:nth-child(n+6)').forEach((row) => row.remove())"
"""The numbers behind charts are hundreds of rows of one make; axe looks at each cell."""


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (375, "dark")])
def test_axe_finds_nothing_that_would_keep_anybody_out(plant, browser, width, scheme):
    address, _, _ = plant
    axe = (resources.files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")
    size = {"width": width, "height": 800}
    context = browser.new_context(viewport=size, color_scheme=scheme, locale="en-GB", bypass_csp=True)
    page, complaints = context.new_page(), []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    for view in VIEWS:
        page.goto(address + view)
        expect(page.locator("main .card, main .wall").first).to_be_visible()
        page.wait_for_load_state("networkidle") if view == "docs" else page.wait_for_timeout(300)
        page.evaluate("document.querySelectorAll('details.keep').forEach((part) => { part.open = true; })")
        page.wait_for_timeout(300)
        page.evaluate(FEW_ROWS)
        page.evaluate(axe)
        assert violations(page) == [], view
        assert complaints == [], view
    context.close()


def test_a_remark_and_a_header_key_are_changed_by_hand_and_their_history_is_shown(plant):
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "#/runs/campaign-1")
    card = page.get_by_test_id("metadata")
    card.get_by_role("button", name="Change").click()
    card.get_by_label("Remark").fill("Dent, top left.")
    card.get_by_label("panel.thickness_mm").fill("-3")
    card.get_by_role("button", name="Save").click()
    expect(card.get_by_role("alert")).to_contain_text("from 0.1 to 500")
    card.get_by_label("panel.thickness_mm").fill("15.8")
    card.get_by_role("button", name="Save").click()
    expect(page.locator("main")).to_contain_text("Dent, top left.")
    page.get_by_test_id("metadata").get_by_text("Changes (2)").click()
    expect(page.get_by_test_id("metadata").get_by_role("row", name="Thickness [mm]")).to_contain_text("15.8")
    expect(page.get_by_test_id("metadata")).to_contain_text("panel.thickness_mm: 16 → 15.8")
    expect(page.get_by_test_id("metadata")).to_contain_text("foreman")


# Where a word of an element stands. [px]
PLACE = """(element, word) => {
  const texts = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  for (let node; (node = texts.nextNode());) {
    const at = node.data.indexOf(word), range = document.createRange();
    if (at < 0) continue;
    range.setStart(node, at);
    range.setEnd(node, at + word.length);
    const { left, right } = range.getBoundingClientRect();
    return [left, right];
  }
}"""


def test_a_remark_keeps_its_marks_of_direction_and_they_turn_nothing_beside_it(plant):
    """Texts in Arabic or Hebrew with figures need them; what stands behind one that nobody closed was turned."""
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "#/runs/campaign-1")
    arabic = "\u2067لوح 16 mm\u2069"
    for remark in ("\u202emonday", "friday", arabic):
        card = page.get_by_test_id("metadata")
        card.get_by_role("button", name="Change").click()
        card.get_by_label("Remark").fill(remark)
        card.get_by_role("button", name="Save").click()
        expect(page.locator("main p[dir=auto]")).to_contain_text(remark.strip("\u202e\u2067\u2069"))
    assert page.locator("main p[dir=auto]").evaluate("p => getComputedStyle(p).direction") == "rtl"
    page.get_by_test_id("metadata").get_by_text("Changes (3)").click()
    change = page.get_by_test_id("metadata").locator(".changes li", has_text="monday").first
    (_, monday), (arrow, end), (friday, _) = (change.evaluate(PLACE, one) for one in ("monday", "→", "friday"))
    assert monday <= arrow < end <= friday


def test_nothing_that_is_missing_is_written_as_null(plant):
    address, page, _ = plant
    for view in (*VIEWS[:-1], "#/runs/compare/campaign-1/lab-0000000"):
        page.goto(address + view)
        expect(page.locator("main .card, main .wall").first).to_be_visible()
        page.wait_for_timeout(500)
        assert not re.search(r"\b(null|undefined|NaN)\b", page.locator("main").inner_text()), view


def test_a_model_that_its_sisters_taught_says_so_beside_the_coefficients(plant):
    address, page, _ = plant
    page.goto(address + "#/coefficients")
    expect(page.locator("main")).to_contain_text("learned from 2 presses of the same kind: left, right.")


def test_without_a_token_a_change_says_what_is_missing(plant):
    address, page, _ = plant
    page.goto(address + "#/runs/campaign-1")
    card = page.get_by_test_id("metadata")
    card.get_by_role("button", name="Change").click()
    card.get_by_label("Remark").fill("x")
    card.get_by_role("button", name="Save").click()
    expect(card.get_by_role("alert")).to_contain_text("needs a token with scope write")
    expect(card.get_by_role("link", name="Give an access token")).to_be_visible()


def test_files_are_taken_with_the_token_of_the_tab(plant):
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "#/runs/campaign-1")
    for kind in ("CSV", "Parquet"):
        with page.expect_download() as download:
            page.get_by_role("link", name=kind, exact=True).click()
        assert download.value.suggested_filename == f"campaign-1.{kind.lower()}"
        assert download.value.path().stat().st_size > 1000


def test_the_numbers_behind_a_chart_are_reached_by_key_and_taken_as_csv_and_picture(plant, tmp_path):
    address, page, _ = plant
    page.goto(address + "#/runs/campaign-1")
    drawer = page.locator("details.keep").first
    drawer.locator("summary").focus()
    page.keyboard.press("Enter")
    heads = drawer.get_by_role("columnheader")
    expect(heads.nth(1)).to_contain_text("[°C]")
    with page.expect_download() as taken:
        drawer.get_by_role("button", name="CSV").press("Enter")
    lines = Path(taken.value.path()).read_text(encoding="utf-8").splitlines()
    assert taken.value.suggested_filename.endswith(".csv")
    rows = [[float(cell) if cell else None for cell in line.split(",")] for line in lines[1:]]
    assert len(rows) > 60
    assert {len(row) for row in rows} == {heads.count()}
    first = drawer.locator("tbody tr").first.locator("td").all_inner_texts()
    assert [f"{value:,.1f}" if value is not None else "–" for value in rows[0]] == [
        t.replace("−", "-") for t in first
    ]
    with page.expect_download() as taken:
        drawer.get_by_role("button", name="SVG").click()
    drawn = ElementTree.parse(taken.value.path()).getroot()
    space = "{http://www.w3.org/2000/svg}"
    lines = [
        p.get("d")
        for p in drawn.iterfind(f"./{space}g[@clip-path]/{space}path")
        if p.get("stroke-width") in ("1", "2", "2.6")
    ]
    shown = [sum(row[k] is not None for row in rows) for k in range(1, len(rows[0]))]
    assert [len(re.findall("[ML]", line)) for line in lines] == [count for count in shown if count]
    assert "nan" not in ElementTree.tostring(drawn, "unicode").lower()
    written = [t.text for t in drawn.iter(f"{space}text")]
    assert {"0", "100"} <= set(written)
    assert written[-3:] == ["Platens", "Panel, top", "Panel, bottom"]  # each group once
    taken.value.save_as(tmp_path / "chart.svg")
    with page.expect_download() as taken:
        drawer.get_by_role("button", name="PNG").click()
    picture = Image.open(taken.value.path())
    assert (picture.format, picture.height) == ("PNG", int(drawn.get("height")))
    below = picture.crop((0, picture.height - 20, picture.width, picture.height))
    assert len(below.getcolors(1 << 16)) > 1  # the legend
    taken.value.save_as(tmp_path / "chart.png")
    page.screenshot(path=tmp_path / "keep.png")


def test_a_chart_taken_away_names_the_phases_as_the_page_does_and_has_its_legend(plant, tmp_path):
    address, page, _ = plant
    page.goto(address + "#/runs/lab-0000000")
    drawer = page.locator("details.keep").first
    drawer.locator("summary").click()
    with page.expect_download() as taken:
        drawer.get_by_role("button", name="SVG").click()
    drawn = ElementTree.parse(taken.value.path()).getroot()
    named = [t.text for t in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert [name for name in named if name in ("open", "closed")] == ["open", "closed", "open"]
    assert named[-5:] == ["Platens", "Panel, top", "Panel, bottom", "Core, predicted", "95\xa0% band"]
    taken.value.save_as(tmp_path / "chart.svg")
    with page.expect_download() as taken:
        drawer.get_by_role("button", name="PNG").click()
    taken.value.save_as(tmp_path / "chart.png")


def test_a_model_version_is_rolled_back_by_hand(plant):
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "#/diagnosis")
    expect(page.get_by_test_id("diagnosis")).to_contain_text("Evaporating moisture")
    page.on("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Roll back to this").click()
    expect(page.locator("tbody tr", has_text="in use").locator("td").first).to_have_text("1")


@pytest.mark.parametrize(
    ("state", "says"),
    [
        ({"age_s": 0.5, "left_out_K": -71.2}, "lately 71 K below its neighbours, not used"),
        ({"age_s": 900.0}, "good"),
        ({"age_s": 0.5}, "good"),
    ],
    ids=["left out", "old", "read"],
)
def test_a_channel_among_the_loggers_is_green_only_while_it_is_read_and_used(plant, state, says):
    address, page, _ = plant

    def answer(route):
        channels = route.fetch().json()["items"]
        route.fulfill(json={"items": [one | {"age_s": 0.5, "quality": "good"} | state for one in channels]})

    page.route("**/api/v1/channels*", answer)
    page.goto(address + "#/loggers")
    tones = {"lately": "bad", "good": "idle" if state["age_s"] > 1.0 else "good"}
    pills = page.get_by_test_id("loggers").locator("tbody .pill")
    expect(pills.first).to_have_text(says)
    expect(pills.first).to_have_class(f"pill wraps {tones[says.split()[0]]}")


@pytest.mark.parametrize(
    ("language", "headline", "longest"),
    [
        (
            "en-GB",
            "Steam that carries heat or heat capacity that changes with temperature",
            "The longest bar, evaporating moisture, is not the cause named",
        ),
        (
            "de-DE",
            "Dampf, der Wärme trägt, oder Wärmekapazität, die von der Temperatur abhängt",
            "Der längste Balken, verdampfende Feuchte, ist nicht die genannte Ursache",
        ),
    ],
)
def test_causes_that_are_not_told_apart_are_one_line_and_a_longer_bar_of_another_is_explained(
    plant, served, browser, language, headline, longest, tmp_path
):
    names = ["vapour_convection", "heat_capacity_temperature"]
    effect = EFFECT | {"name": names[0], "set": names, "parameters": {}}
    weaker = {"name": names[0], "score": 12.0, "p_value": 0.0005, "heldout_gain_K": 0.4}
    candidates = [weaker, *DIAGNOSIS["candidates"]]
    found = DIAGNOSIS | {"verdict": "ambiguous", "effects": [effect], "candidates": candidates}
    page = browser.new_page(locale=language)
    page.goto(plant[0] + "#/diagnosis")
    expect(page.locator("p.verdict")).not_to_be_empty()
    expect(page.locator(".bars + p")).to_have_count(0)  # the longest bar is the cause named
    served[1].store.put_diagnosis("lab", found)
    page.reload()
    expect(page.locator("p.verdict")).to_have_text(headline)
    expect(page.locator(".bars + p")).to_contain_text(longest)
    page.screenshot(path=tmp_path / "diagnosis.png", full_page=True)
    page.close()


@pytest.mark.parametrize(
    ("locale", "law", "best", "note"),
    [
        ("en-GB", "agrees with the curve of a known cause: evaporating moisture", "press time 165 s", "12.1 mm"),
        ("de-DE", "mit der Kurve einer bekannten Ursache", "Presszeit 165 s", "12,1 mm"),
    ],
)
def test_a_law_without_a_name_and_the_pressings_that_would_decide_are_shown(
    plant, served, browser, locale, law, best, note, tmp_path
):
    address = plant[0]
    page = browser.new_page(locale=locale)
    page.goto(address + "#/diagnosis")
    expect(page.get_by_test_id("diagnosis")).to_be_visible()
    expect(page.get_by_test_id("law")).to_have_count(0)  # an earlier version's diagnosis has neither
    expect(page.get_by_test_id("plan")).to_have_count(0)
    served[1].store.put_diagnosis("lab", DIAGNOSIS | BEYOND)
    page.reload()
    expect(page.get_by_test_id("law")).to_contain_text(law)
    chart = page.get_by_test_id("law").locator(".chart")
    tip_says(chart, r"kJ/m³K \(.* … ")
    expect(page.get_by_test_id("plan")).to_contain_text(best)
    expect(page.get_by_test_id("plan")).to_contain_text("64")
    expect(page.get_by_test_id("diagnosis")).to_contain_text(note)
    page.evaluate((resources.files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8"))
    assert violations(page) == []
    page.screenshot(path=tmp_path / "beyond.png", full_page=True)
    page.close()


def test_the_buttons_of_a_verdict_fill_their_card_beside_a_taller_one(plant, browser):
    address, _, _ = plant
    page = browser.new_page(viewport={"width": 1920, "height": 1080}, locale="de-DE")
    page.goto(address + "#/now")
    expect(page.locator(".verdict-button")).to_have_count(4)
    page.wait_for_function("""() => {
        const card = document.querySelector('[data-testid=verdict]'), end = card.getBoundingClientRect().bottom;
        const free = end - document.querySelector('.verdicts').getBoundingClientRect().bottom;
        return free < 60 && card.getBoundingClientRect().height > 150;
    }""")
    page.close()


def test_the_diagnosis_is_shown_in_german(plant, browser):
    address, _, _ = plant
    context = browser.new_context(locale="de-DE")
    page = context.new_page()
    page.goto(address + "#/diagnosis")
    expect(page.get_by_test_id("diagnosis")).to_contain_text("Verdampfende Feuchte")
    expect(page.get_by_role("row", name="Wasser, das verdampft 3,2 % der Trockenmasse 2,3 … 4")).to_be_visible()
    expect(page.get_by_test_id("diagnosis")).to_contain_text("Die Platte vor und nach dem Pressen wiegen")
    expect(page.get_by_test_id("diagnosis")).to_contain_text(
        "Senkt das Residuum einer typischen ausgelassenen Pressung um 0,58 K (geometrisches Mittel"
    )
    expect(page.locator(".gain")).to_contain_text("ausgelassen, eigene Kontakte angepasst, quadratisches Mittel")
    where = page.get_by_role("row", name="Platte oben +0,66 K nach dem Öffnen 8 … 16 s 154 … 166 °C")
    expect(where).to_be_visible()
    context.close()


@pytest.mark.parametrize(
    ("language", "parts"),
    [
        (
            "en-GB",
            [
                "1204 stored",
                "Evaporating moisture",
                "800 older ones follow in the next 4 nights",
                "401 fitted before",
            ],
        ),
        (
            "de-DE",
            [
                "1204 gespeichert",
                "Verdampfende Feuchte",
                "800 ältere folgen in den nächsten 4 Nächten",
                "401 schon ausgewertet",
            ],
        ),
    ],
)
def test_a_night_says_what_it_did_and_what_it_left_out(plant, browser, language, parts, tmp_path):
    address, _, _ = plant
    context = browser.new_context(locale=language, viewport={"width": 1280, "height": 700})
    page = context.new_page()
    page.goto(address + "#/nights")
    nights = page.get_by_test_id("nights")
    for part in parts:
        expect(nights).to_contain_text(part)
    nights.locator("summary").click()
    expect(nights.get_by_role("link", name="campaign-1")).to_be_visible()
    expect(nights).to_contain_text("lab-2026-03-05-1")
    expect(nights).to_contain_text("412")
    page.screenshot(path=tmp_path / "nights.png")
    context.close()


@pytest.mark.parametrize(
    ("language", "width", "scheme", "says"),
    [
        ("en-GB", 1920, "light", "Diagnosis"),
        ("de-DE", 375, "dark", "Diagnose"),
        ("de-DE", 1920, "light", "Diagnose"),
        ("en-GB", 375, "dark", "Diagnosis"),
    ],
)
def test_the_report_of_a_night_opens_from_the_page_and_leads_back_to_a_run(
    plant, browser, language, width, scheme, says, tmp_path
):
    address, _, _ = plant
    context = browser.new_context(
        locale=language, viewport={"width": width, "height": 900}, color_scheme=scheme, bypass_csp=True
    )
    page = context.new_page()
    page.goto(address + "#/nights")
    with context.expect_page() as opened:
        page.get_by_test_id("nights").locator("a[href*='/report']").first.click()
    report = opened.value
    expect(report.locator("figure svg").first).to_be_visible()
    assert report.locator("html").get_attribute("lang") == language[:2]
    expect(report.get_by_role("heading", name=says, exact=True)).to_be_visible()
    assert report.evaluate("document.documentElement.scrollWidth <= innerWidth")
    report.evaluate((resources.files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8"))
    assert violations(report) == []
    report.screenshot(path=tmp_path / "night.png", full_page=True)
    report.get_by_role("link", name="campaign-1").click()
    expect(report).to_have_url(address + "#/runs/campaign-1")
    context.close()


@pytest.mark.parametrize(
    ("language", "heads"),
    [
        ("en-GB", ("Measured and simulated: campaign-1", "extended model")),
        ("de-DE", ("Gemessen und simuliert: campaign-1", "erweitert")),
    ],
)
def test_a_diagnosis_shows_measured_plain_extended_and_residual_curves(plant, browser, language, heads, tmp_path):
    address, _, _ = plant
    context = browser.new_context(locale=language)
    page = context.new_page()
    page.goto(address + "#/diagnosis")
    card = page.get_by_test_id("curves")
    for head in heads:
        expect(card).to_contain_text(head)
    expect(card.locator(".chart canvas")).to_have_count(4)  # two places, residuals below each
    page.wait_for_function("""() => [...document.querySelectorAll("[data-testid=curves] canvas")].every((canvas) =>
        canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((v) => v > 0))""")
    page.screenshot(path=tmp_path / "diagnosis.png", full_page=True)
    context.close()


@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("en-GB", ("69 scans left out", "2 times in", "The press closes", "Note at lab", "Keep note", "warning")),
        ("de-DE", ("69 Messzeilen", "2-mal in", "Die Presse schließt", "Notiz zu lab", "Notieren", "Warnung")),
    ],
)  # fmt: skip
def test_the_journal_groups_what_repeats_and_holds_press_events_and_notes(plant, served, browser, language, words):
    address, _, token = plant
    feed = served[1]
    for count in (40, 29):
        feed.store.log("warning", "record", say("scans-left-out", press="lab", count=count), "lab")
    feed.store.log("info", "sense", say("sense-following", presses=("lab",)))
    context = browser.new_context(locale=language)
    page = context.new_page()
    with_token(page, token)
    page.goto(address + "#/journal")
    journal = page.get_by_test_id("journal")
    for part in words[:3]:
        expect(journal).to_contain_text(part)
    expect(link := journal.get_by_role("link", name="lab-0000000").first).to_be_visible()
    page.set_viewport_size({"width": 375, "height": 812})
    cell = "link => link.closest('td').offsetWidth > 180"  # a name of 18 letters is not broken
    page.wait_for_function(cell, arg=link.element_handle())
    page.get_by_label(words[3]).fill("steam at the left")
    page.get_by_role("button", name=words[4]).click()
    expect(journal.get_by_role("row", name="steam at the left")).to_contain_text("foreman")
    page.locator("main select").first.select_option(label=words[5])
    expect(journal).not_to_contain_text("steam at the left")
    expect(journal).to_contain_text(words[0])
    assert "level=warning" in page.url
    feed.store.log("info", "import", say("sense-following", presses=("lab",)))  # no process that runs
    page.goto(address + "#/journal")
    by_process = page.locator("main select").nth(1)
    by_process.select_option("import")
    expect(journal.get_by_role("row")).to_have_count(1)
    page.reload()
    expect(by_process).to_have_value("import")
    expect(journal.get_by_role("row")).to_have_count(1)
    context.close()


def test_a_note_stands_on_the_time_axis_of_the_pressing_it_was_made_in(served, browser):
    server, feed, _ = served
    page = browser.new_context(bypass_csp=True, locale="en-GB").new_page()
    feed.pause_s = 0.02
    writer = threading.Thread(target=feed.pressing, args=(3000,), daemon=True)
    writer.start()
    while feed.store.open_run("lab") is None:
        pass
    run = feed.store.open_run("lab").run
    feed.store.note("lab", "a very long remark about steam at the left edge", "foreman")
    page.add_init_script(
        """const draw = CanvasRenderingContext2D.prototype.fillText;
        window.written = new Set();
        CanvasRenderingContext2D.prototype.fillText = function (words, ...at) {
          window.written.add(words); draw.call(this, words, ...at); };"""
    )
    for view in ("#/now", f"#/runs/{run}"):
        page.goto(server.url + view)
        page.wait_for_function("[...window.written].some((one) => one.startsWith('a very long remark'))")
        page.evaluate("window.written.clear()")
    expect(page.get_by_test_id("metadata")).to_contain_text("Changes (1)")
    feed.stop.set()
    writer.join(240)
    page.context.close()


@pytest.mark.parametrize(
    ("language", "says"), [("en-GB", "no recorder, files only"), ("de-DE", "keine Aufzeichnung, nur Dateien")]
)
def test_a_press_of_files_alone_is_a_quiet_tile_and_no_alarm(served, browser, language, says, tmp_path):
    server, feed, _ = served
    run, _ = make_campaign(7, 1, plan=Plan(rate_hz=2.0, thickness_mm=16.0))[0]
    feed.store.import_runs([replace(run, name="archived-1")], "archive", LAB.read_text(encoding="utf-8"))
    page = browser.new_page(viewport={"width": 1920, "height": 1080}, locale=language)
    page.goto(server.url + "#/presses")
    tiles = page.get_by_test_id("presses").locator(".press-tile")
    expect(tiles.filter(has_text="archive").locator(".light.idle")).to_have_text(says)
    expect(tiles.filter(has_text="lab").locator(".light.bad")).to_have_count(1)  # has a recorder that never sent
    dots = [tiles.filter(has_text=press).locator(".light") for press in ("archive", "lab")]
    quiet, red = (dot.evaluate("e => getComputedStyle(e, '::before').backgroundColor") for dot in dots)
    assert quiet != red
    page.screenshot(path=tmp_path / "presses.png")
    page.close()


@pytest.mark.parametrize("width", [1280, 375])
def test_the_nights_of_all_presses_stand_in_one_table_that_names_each_press(served, browser, width, tmp_path):
    server, feed, _ = served
    feed.store.register_press("north", CHANNELS, LAB.read_text(encoding="utf-8"))
    for number, press in enumerate(("lab", "north", "lab")):
        began = NIGHT_BEGAN + timedelta(days=number)
        feed.store.put_night(StoredNight(press, began, began + timedelta(seconds=47), NIGHT, {}))
    page = browser.new_page(viewport={"width": width, "height": 900}, locale="en-GB")
    page.goto(server.url + "#/nights?press=lab")
    rows = page.get_by_test_id("nights").locator("tbody tr")
    expect(rows).to_have_count(2)
    page.get_by_test_id("nights-of").select_option(label="all")
    expect(rows).to_have_count(3)
    for row, press in enumerate(("lab", "north", "lab")):
        expect(rows.nth(row).get_by_text(press, exact=True)).to_be_visible()
    page.screenshot(path=tmp_path / "nights.png")
    page.reload()
    expect(rows).to_have_count(3)
    page.get_by_test_id("nights-of").select_option(label="lab")
    expect(rows).to_have_count(2)
    page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    page.close()


def test_thirty_presses_stand_on_one_screen_and_a_tile_leads_to_its_press(served, browser, tmp_path):
    server, feed, _ = served
    text = LAB.read_text(encoding="utf-8")
    for number in range(2, 31):
        feed.store.register_press(f"press-{number}", CHANNELS, text)
    feed.pause_s = 0.02
    writer = threading.Thread(target=feed.pressing, args=(3000,), daemon=True)
    writer.start()
    page = browser.new_page(viewport={"width": 1920, "height": 1080}, locale="de-DE")
    page.goto(server.url)
    tiles = page.get_by_test_id("presses").locator(".press-tile")
    expect(tiles).to_have_count(30)
    page.wait_for_function("document.querySelector('.presses').getBoundingClientRect().bottom <= 1080")
    page.wait_for_function(  # room for tiles that tell all they can
        "document.querySelector('[data-testid=presses]').getBoundingClientRect().width > 1800"
    )
    lab = tiles.filter(has_text="lab")
    expect(lab.locator(".core")).to_have_text("50,0°C")
    expect(tiles.filter(has_text="press-30").locator(".light.bad")).to_have_text("")  # why, the answer says
    expect(tiles.filter(has_text="press-30").locator(".answer")).to_contain_text("noch keine Messung")
    page.screenshot(path=tmp_path / "presses.png")
    tiles.filter(has_text="press-30").click()
    expect(page.locator("#press")).to_have_value("press-30")
    expect(page.locator("h1")).to_have_text("Kerntemperatur")
    page.locator("#press").select_option("press-29")  # though the address still names the tile's
    expect(page.locator("h1")).to_have_text("Kerntemperatur")
    expect(page.locator("#press")).to_have_value("press-29")
    feed.stop.set()
    writer.join(240)
    page.close()


def test_the_journal_read_to_its_end_holds_every_line_once(served, browser):
    server, feed, _ = served
    feed.stop.clear()
    feed.pause_s = 0.0
    feed.pressing(30)
    for _ in range(230):
        feed.store.log("info", "import", say("scans-left-out", press="lab", count=1), "lab")
    page = browser.new_page(locale="en-GB")
    page.goto(server.url + "#/journal")
    more, journal = page.get_by_role("button", name="More"), page.get_by_test_id("journal")
    expect(journal).to_contain_text("100 scans left out")
    while more.is_visible():
        before = journal.inner_text()
        more.click()
        page.wait_for_function(
            "(old) => document.querySelector('[data-testid=journal]').innerText !== old", arg=before
        )
    expect(journal).to_contain_text("230 scans left out")
    stored = page.request.get(f"{server.url}api/v1/events?kind=press&limit=500").json()["items"]
    closings = [one for one in stored if one["message_said"]["code"] == "journal-press-closed"]
    assert 0 < journal.inner_text().count("The press closes") == len(closings)
    page.close()


ANNOUNCED = (
    NOTIFICATIONS
    + """
window.AudioContext = class extends window.AudioContext {
  constructor() { super(); window.rung = (window.rung ?? 0) + 1; }
};
"""
)


@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("en-GB", ("Acknowledge", "Core above", "Save", "Sound when", "Notify when", "the core is above 40")),
        ("de-DE", ("Quittieren", "Kern über", "Speichern", "einen Ton", "Alarm benach", "der Kern ist über 40")),
    ],
)  # fmt: skip
def test_limits_are_set_and_alarms_are_told_and_acknowledged_by_hand(
    plant, served, browser, language, words, tmp_path
):
    take, core, save, sound, notify, text = words
    address, _, token = plant
    feed = served[1]
    context = browser.new_context(locale=language, viewport={"width": 1280, "height": 900}, bypass_csp=True)
    page = context.new_page()
    page.add_init_script(ANNOUNCED)
    with_token(page, token)
    page.goto(address + "#/alarms")
    limits = page.get_by_test_id("alarm-limits")
    page.get_by_label(sound).check()
    page.get_by_label(notify).check()
    limits.get_by_label(core).fill("forty")
    limits.get_by_role("button", name=save).click()
    expect(limits.get_by_role("status")).to_contain_text(core)
    limits.get_by_label(core).fill("1e9")
    limits.get_by_role("button", name=save).click()
    expect(limits.get_by_role("status")).to_contain_text(re.compile(f"^{core}: .*1000"))
    limits.get_by_label(core).fill("40")
    limits.get_by_role("button", name=save).click()
    expect(limits).to_contain_text("foreman")
    feed.pause_s = 0.05
    writer = threading.Thread(target=feed.pressing, args=(3000,), daemon=True)
    writer.start()
    row = page.get_by_test_id("alarms").get_by_role("row", name=text)
    page.wait_for_function(f"window.notified.some((one) => one.includes({text!r}))")
    row.get_by_role("button", name=take).click()
    expect(row).to_contain_text("foreman")
    page.wait_for_function("window.rung > 0")
    assert page.evaluate("[window.notified.filter((one) => one.includes('40')).length, window.rung]") == [1, 1]
    page.screenshot(path=tmp_path / "alarms.png")
    feed.stop.set()
    writer.join(240)
    context.close()


@pytest.mark.parametrize("view", ["runs", "wall"])
def test_a_page_opened_anew_says_that_its_sound_waits_for_a_click(served, view):
    """A script that looks at a page counts as a click: the page itself must report what it shows."""
    server, _, page = served
    page.add_init_script("""
        localStorage.setItem('kerntemp-alarm-sound', 'on');
        setInterval(() => {
            const muted = document.getElementById('muted');
            if (muted?.checkVisibility()) console.log(`muted: ${muted.textContent}`);
        }, 50);""")
    with page.expect_console_message(lambda one: "muted: " in one.text) as said:
        page.goto(f"{server.url}#/{view}")
    assert "a click or a key" in said.value.text
    page.mouse.click(300, 300)
    expect(page.locator("#muted")).to_be_hidden()


def test_a_core_nobody_updates_any_more_gives_way_to_the_reason(served):
    server, feed, page = served
    feed.pause_s = 0.01
    append = feed.store.append_estimates
    writer = threading.Thread(target=feed.pressing, args=(3000,), daemon=True)
    writer.start()
    page.goto(server.url + "#/now")
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    feed.store.append_estimates = lambda *_: None
    expect(page.get_by_test_id("answer")).to_contain_text("the live sensor has given no estimate for")
    expect(page.get_by_test_id("band")).to_be_empty()  # why is told once
    expect(page.get_by_test_id("core")).to_have_text("–°C")
    feed.store.append_estimates = append
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    feed.stop.set()
    writer.join(240)


def test_refusals_and_alarms_are_put_into_the_words_of_the_chosen_language(plant):
    address, page, _ = plant
    page.goto(address + "#/runs/campaign-1")
    expect(page.locator("#alarms")).to_contain_text("record: never seen; start kerntemp record")
    page.get_by_label("Language").select_option(label="Deutsch")
    expect(page.locator("#alarms")).to_contain_text("record: noch nie gesehen; kerntemp record starten")
    card = page.get_by_test_id("metadata")
    card.get_by_role("button", name="Ändern").click()
    card.get_by_label("Bemerkung").fill("x")
    card.get_by_role("button", name="Speichern").click()
    expect(card.get_by_role("alert")).to_contain_text("eine Änderung braucht ein Zugangstoken mit Schreibrecht")
    page.reload()
    expect(page.locator("#alarms")).to_contain_text("noch nie gesehen")


def test_numbers_lists_and_messages_within_messages_are_shown_as_the_server_shows_them(served):
    server, _, page = served
    page.add_init_script("localStorage.setItem('kerntemp-language', 'de')")
    page.goto(server.url)
    expect(page.locator("#link")).to_have_text("live")
    field = say("api-field-invalid", field="press_s", why=say("plain-text", text=12345.5))
    for message in (
        say("health-scans-behind", press="lab", scans=12345),
        say("api-no-such-language", language="fr", languages=("en", "de")),
        say("api-request-invalid", problems=(field, say("api-body-not-json"))),
        say("health-nightly-job-overdue", hours=51.4),
        say("health-nightly-job-overdue", hours=float("nan")),
        Message("from-the-future", {"press": "lab"}),
    ):
        shown = page.evaluate(
            "m => import('/static/words.js').then((words) => words.text(m.code, m.arguments))", message.to_json()
        )
        assert shown.replace("\u00a0", " ") == words(message, "de").replace("\u00a0", " ")


def test_a_page_whose_server_does_not_answer_at_the_start_says_so_and_comes_up_later(served):
    server, _, page = served
    page.route("**/api/v1/messages/*", lambda route: route.abort())
    page.goto(server.url)
    expect(page.locator("main")).to_contain_text("The server does not answer. · Der Server antwortet nicht.")
    page.unroute("**/api/v1/messages/*")
    expect(page.locator("main h1")).to_have_text("Core temperature")


def test_the_skip_link_reaches_the_content_and_stays_in_the_view(plant):
    address, page, _ = plant
    page.goto(address + "#/runs")
    expect(page.get_by_role("heading", name="Runs")).to_be_visible()
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator("#view")).to_be_focused()
    assert page.url.endswith("#/runs")
    page.evaluate("location.hash = '#view'")
    expect(page.get_by_role("heading", name="Runs")).to_be_visible()


LOADING = "() => getComputedStyle(document.querySelector('main .stack'), '::after').content === '\"loading …\"'"


def test_before_the_first_answer_the_page_is_loading_and_not_cut_off(served):
    server, _, page = served
    page.route("**/api/v1/press*", lambda _: None)  # never answered
    page.goto(server.url)
    expect(page.locator("#link")).to_have_text("connecting …")
    page.wait_for_function(LOADING)


@pytest.mark.parametrize("view", ["presses", "loggers"])
def test_before_its_first_answer_a_view_is_loading_and_not_empty(served, view):
    server, _, page = served
    page.route("**/api/v1/health*", lambda _: None)  # never answered
    page.goto(f"{server.url}#/{view}")
    expect(page.locator("#link")).to_have_text("live")
    page.wait_for_function(LOADING)


def test_a_change_is_tried_from_the_api_page_with_a_body(plant):
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "docs")
    entry = page.locator("details", has_text="PATCH /api/v1/runs/{run}").first
    entry.locator("summary").click()
    entry.get_by_label("run", exact=True).fill("campaign-1")
    entry.get_by_label("body").fill('{"header": {"order": "A-17"}}')
    entry.get_by_role("button", name="Try").click()
    expect(entry.locator("pre")).to_contain_text('"order": "A-17"')


def test_metadata_are_german_several_are_added_at_once_and_the_name_stays(plant):
    address, page, token = plant
    with_token(page, token)
    page.add_init_script("localStorage.setItem('kerntemp-language', 'de')")
    page.goto(address + "#/runs/campaign-1")
    card = page.get_by_test_id("metadata")
    card.get_by_role("button", name="Ändern").click()
    expect(card.get_by_label("run", exact=True)).to_have_count(0)
    for i, name in enumerate(("setting.speed_mm_s", "setting.batch")):
        card.get_by_label("Neuer Name").nth(i).fill(name)
        card.get_by_label("Wert").nth(i).fill("2,5")
    card.get_by_role("button", name="Speichern").click()
    for name in ("setting.speed_mm_s", "setting.batch"):
        expect(card.get_by_role("row", name=f"{name} 2,5")).to_be_visible()
    marking = {"Authorization": f"Bearer {token}"}
    mark = f"{address}api/v1/runs/campaign-1/verdict"
    assert page.request.put(mark, data={"verdict": "scrap"}, headers=marking).ok
    page.reload()
    expect(card.get_by_role("row", name="Platte wurde")).to_contain_text("Ausschuss")
    card.locator("summary").click()
    expect(card.locator(".changes")).to_contain_text("panel.verdict: – → Ausschuss")
    assert page.request.put(mark, data={"verdict": None}, headers=marking).ok
    expect(page.get_by_test_id("simulation")).to_contain_text("Platte oben")


def test_the_next_panel_is_entered_with_large_fields_and_the_last_one_is_judged(plant):
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "#/now")
    card = page.get_by_test_id("next-panel")
    card.get_by_label("Thickness").fill("19,5")
    card.get_by_label("Target").fill("85")
    card.get_by_label("Keep as recipe").fill("MDF 19")
    heights = "controls => controls.map((control) => control.getBoundingClientRect().height)"
    assert (
        min(card.locator("input:visible, select:visible, button:visible").evaluate_all(heights)) >= 48.0
    )  # a glove
    card.get_by_role("button", name="Save").click()
    expect(card).to_contain_text("by foreman")
    answer = page.evaluate("fetch('api/v1/press/next').then((answer) => answer.json())")
    assert answer["recipes"]["MDF 19"] == {"panel.thickness_mm": 19.5, "setting.core_target_C": 85}
    page.get_by_test_id("verdict").get_by_role("button", name="blister").click()
    chosen = page.get_by_test_id("verdict").get_by_role("button", pressed=True)
    expect(chosen).to_have_text("blister")
    run = page.evaluate("fetch('api/v1/press').then((answer) => answer.json())")["items"][0]["run"]
    answer = f"fetch('api/v1/runs/{run}/verdict').then((answer) => answer.json())"
    comes(page, answer, "(it) => it.verdict === 'blister' && it.who === 'foreman'")


def test_the_next_panel_is_shown_anew_when_a_pressing_took_what_was_said_unless_somebody_types(served):
    server, feed, page = served
    feed.pause_s = 0.0
    token = TokenFile(server.config.parent / "kerntemp-tokens.json").create("foreman", "write")
    with_token(page, token)
    feed.pressing(scans=40, batch=10)
    page.goto(server.url + "#/now")
    card = page.get_by_test_id("next-panel")
    start, target = card.get_by_label("Start temperature"), card.get_by_label("Target")
    start.fill("31")
    target.fill("85")
    card.get_by_role("button", name="Save").click()
    expect(card).to_contain_text("by foreman")
    page.mouse.click(1, 1)  # nobody is in the card
    feed.pressing(scans=40, batch=10)
    expect(start).to_have_value("")
    expect(target).to_have_value("85")
    target.fill("90")
    feed.pressing(scans=40, batch=10)
    expect(page.get_by_role("link", name="lab-0000080").first).to_be_visible()
    expect(target).to_have_value("90")


def test_what_somebody_begins_to_type_while_the_next_panel_is_asked_for_anew_stays(served):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing(scans=40, batch=10)
    page.goto(server.url + "#/now")
    target = page.get_by_test_id("next-panel").get_by_label("Target")
    expect(target).to_be_visible()
    expect(page.get_by_role("link", name="lab-0000000").first).to_be_visible()
    asked = []
    page.route("**/press/next?*", lambda route: asked.append(route))
    feed.pressing(scans=40, batch=10)
    deadline = time.monotonic() + PATIENT_MS / 1000.0
    while not asked:
        assert time.monotonic() < deadline, "the page never asked for the next panel"
        page.wait_for_timeout(20)
    target.fill("90")
    page.mouse.click(1, 1)
    with page.expect_response("**/press/next?*") as answered:
        asked[0].continue_()
    answered.value.finished()
    expect(page.get_by_role("link", name="lab-0000040").first).to_be_visible()
    expect(target).to_have_value("90")


@pytest.mark.parametrize("upright", [False, True], ids=["side by side", "one above the other"])
def test_two_fingers_zoom_about_the_place_between_them(plant, browser, upright):
    address, _, _ = plant
    context = browser.new_context(viewport={"width": 1024, "height": 768}, has_touch=True)
    page = context.new_page()
    page.goto(address + "#/runs/campaign-1")
    chart = page.locator(".chart").first
    chart.scroll_into_view_if_needed()
    over = chart.locator(".u-over")
    box = over.bounding_box()
    touch = context.new_cdp_session(page)

    def seconds_at(share):
        over.hover(position={"x": share * box["width"], "y": 40})
        tip = chart.locator(".chart-tip tr").first
        expect(tip).to_contain_text(" s")
        return float(tip.inner_text().split()[0])

    def two_fingers(kind, apart):
        x, y = box["x"] + 0.2 * box["width"], box["y"] + box["height"] / 2
        away = (0.0, apart / 2) if upright else (apart / 2, 0.0)
        points = [{"x": x + way * away[0], "y": y + way * away[1]} for way in (-1, 1)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    between, wide = seconds_at(0.2), seconds_at(0.9) - seconds_at(0.1)
    two_fingers("touchStart", 40.0)
    for apart in (50.0, 60.0, 70.0, 80.0):
        two_fingers("touchMove", apart)
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    expect(chart.locator("button.follow")).to_be_visible()
    assert seconds_at(0.9) - seconds_at(0.1) == pytest.approx(wide / 2, rel=0.1)
    assert seconds_at(0.2) == pytest.approx(between, abs=0.05 * wide)
    context.close()


def test_a_finger_reads_a_chart_and_two_move_the_part_shown(plant, browser):
    address, _, _ = plant
    context = browser.new_context(
        viewport={"width": 375, "height": 812}, has_touch=True, is_mobile=True, locale="en-GB"
    )
    page = context.new_page()
    page.goto(address + "#/runs/campaign-1")
    chart = page.locator(".chart").first
    chart.scroll_into_view_if_needed()
    over, tip = chart.locator(".u-over"), chart.locator(".chart-tip")
    touch = context.new_cdp_session(page)

    def fingers(kind, *shares):
        box = over.bounding_box()
        y = box["y"] + box["height"] / 2
        points = [{"x": box["x"] + share * box["width"], "y": y, "id": i} for i, share in enumerate(shares)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def seconds_at(share):
        fingers("touchStart", share)
        fingers("touchEnd")
        expect(tip).to_contain_text(" s")
        return float(tip.locator("tr").first.inner_text().split()[0])

    begin, end = seconds_at(0.3), seconds_at(0.7)
    assert end > begin
    over.dispatch_event("mouseleave")  # browsers send one behind a finger
    expect(tip).to_be_visible()
    fingers("touchStart", 0.3)
    fingers("touchMove", 0.5)
    fingers("touchEnd")
    expect(tip.locator("tr").first).to_have_text(re.compile(r"^[\d.]+ s"))
    assert begin < float(tip.locator("tr").first.inner_text().split()[0]) < end
    page.get_by_role("heading", level=1).tap()
    expect(tip).to_be_hidden()

    fingers("touchStart", 0.4, 0.6)
    fingers("touchMove", 0.3, 0.7)  # twice as large
    fingers("touchMove", 0.5, 0.9)  # and moved to the right: what was in the middle is now at 0.7
    fingers("touchEnd")
    whole = chart.get_by_role("button", name="Show all")
    expect(whole).to_be_visible()
    near = 0.1 * (end - begin)
    assert [seconds_at(0.3), seconds_at(0.7)] == pytest.approx([begin, (begin + end) / 2], abs=near)
    whole.tap()
    expect(whole).to_be_hidden()
    assert [seconds_at(0.3), seconds_at(0.7)] == pytest.approx([begin, end], abs=near)
    context.close()


def test_on_a_touch_screen_every_field_of_the_next_panel_is_large_enough_for_a_glove(plant, browser):
    address, _, _ = plant
    context = browser.new_context(viewport={"width": 768, "height": 1024}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(address + "#/now")
    controls = page.get_by_test_id("next-panel").locator("input:visible, select:visible, button:visible")
    expect(controls).to_have_count(8)
    assert min(controls.evaluate_all("all => all.map((one) => one.getBoundingClientRect().height)")) >= 56.0
    context.close()


def test_runs_are_found_by_what_is_typed_sorted_by_a_column_and_kept_in_the_address(plant):
    address, page, _ = plant
    page.goto(address + "#/runs")
    rows = page.locator("tbody tr")
    expect(rows).to_have_count(2)
    page.get_by_label("Values").fill("panel.thickness_mm=16")
    expect(rows).to_have_count(1)
    expect(rows).to_contain_text("campaign-1")
    page.get_by_label("Values").fill("panel.thickness_mm>")
    expect(page.get_by_role("alert").filter(has_text="is no bound")).to_be_visible()
    page.get_by_label("Values").fill("")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("lab-0000000")  # the newest
    page.get_by_role("button", name="Thickness").click()
    expect(rows.first).to_contain_text("campaign-1")  # the other has none
    assert page.url.endswith("#/runs?sort=-panel.thickness_mm")
    page.reload()
    expect(page.get_by_role("button", name="Thickness ↓")).to_be_visible()
    expect(rows.first).to_contain_text("campaign-1")
    page.get_by_role("link", name="One number over another").click()
    scatter = page.get_by_test_id("scatter")
    expect(scatter).to_contain_text("of 2 runs")
    expect(scatter).to_contain_text("h_pp_c: plate – panel, closed [W/m²K]")
    page.locator("label", has_text=re.compile("^up")).get_by_role("combobox").select_option("panel.thickness_mm")
    expect(page).to_have_url(re.compile(r"\?sort=-panel\.thickness_mm&x=press_time_s&y=panel\.thickness_mm$"))


@pytest.mark.parametrize(
    ("language", "alone", "says"),
    [
        ("en", "all sensors: plain model", "Not looked for"),
        ("de", "alle Fühler: einfaches Modell", "Nicht gesucht"),
    ],
)
def test_a_diagnosis_without_verdict_promises_no_second_number_and_does_not_say_that_all_is_noise(
    plant, served, language, alone, says, tmp_path
):
    address, page, _ = plant
    lost = {**DIAGNOSIS, "verdict": "not_described", "effects": [], "where": [], "extended": DIAGNOSIS["base"]}
    served[1].store.put_diagnosis("lab", lost)
    page.add_init_script(f"localStorage.setItem('kerntemp-language', '{language}')")
    page.goto(address + "#/diagnosis")
    expect(page.get_by_test_id("diagnosis")).to_contain_text(alone)
    expect(page.locator("main")).to_contain_text(says)
    page.screenshot(path=tmp_path / "diagnosis.png", full_page=True)
    assert "→" not in page.get_by_test_id("diagnosis").inner_text()


def test_no_row_of_the_metadata_is_headed_by_the_key_of_the_runs_own_name(plant):
    address, page, _ = plant
    page.goto(address + "#/runs/campaign-1")
    card = page.get_by_test_id("metadata")
    expect(card).to_contain_text("Thickness [mm]")
    assert "run" not in card.locator("tbody td:first-child").all_inner_texts()


@pytest.mark.parametrize(
    ("language", "says"),
    [
        ("en", "Shows 1 of 2 runs; one has no value for one of the two numbers."),
        ("de", "Zeigt 1 von 2 Pressungen; bei einer fehlt eine der beiden Zahlen."),
    ],
)
def test_a_scatter_says_how_many_runs_it_shows_and_how_many_lack_a_number(plant, language, says, tmp_path):
    address, page, _ = plant
    page.add_init_script(f"localStorage.setItem('kerntemp-language', '{language}')")
    page.goto(address + "#/runs/scatter?x=rmse_K&y=panel.thickness_mm")
    expect(page.get_by_test_id("scatter")).to_contain_text(says)
    page.screenshot(path=tmp_path / "scatter.png")
    page.goto(address + "#/runs/compare/campaign-1/lab-0000000")
    expect(page.get_by_test_id("scatter").get_by_role("status")).to_be_visible()


def test_a_time_of_an_hour_and_more_is_put_in_hours_as_the_server_puts_it(plant):
    address, page, _ = plant
    page.goto(address)
    expect(page.locator("#link")).to_have_text("live")
    texts = page.evaluate("""import('./static/dom.js').then((dom) =>
        [9.94, 125, 3679, 5400, 100000].map((s) => dom.duration(s).replaceAll('\u00a0', ' ')))""")
    assert texts == ["9.9 s", "2 min 5 s", "1 h 1 min", "1 h 30 min", "1 d 3 h"]


def test_two_runs_are_compared_against_one_of_them(plant):
    address, page, _ = plant
    page.goto(address + "#/runs/compare/campaign-1/lab-0000000")
    table = page.get_by_test_id("differences")
    expect(table).to_contain_text("Thickness [mm]")
    page.get_by_label("Quantity").select_option(label="Panel, top")
    chart = page.locator(".chart").first
    page.locator("label", has_text=re.compile("^Minus")).get_by_role("combobox").select_option("campaign-1")
    tip_says(chart, r"campaign-1\s*0\.00 K")
    page.get_by_label("Quantity").select_option(label="Residual: measured minus simulated, Panel, top")
    page.locator("label", has_text=re.compile("^Minus")).get_by_role("combobox").select_option("")
    expect(page.locator("main")).to_contain_text("Not known for lab-0000000")  # too short for a simulation
    expect(page.locator("main")).to_contain_text("Closing not known; drawn from the first scan: campaign-1")
    tip_says(chart, r"campaign-1\s*[−-]?\d+\.\d\d K")
    page.get_by_label("Quantity").select_option(label="Heat taken up")
    expect(chart.locator(".u-axis, .uplot").first).to_be_visible()
    tip_says(chart, r"campaign-1\s*[\d,]+\.\d kJ/m²")
    page.get_by_role("checkbox").first.uncheck()
    chart.locator(".u-over").hover(position={"x": 320, "y": 60})
    expect(chart.locator(".chart-tip")).not_to_contain_text("campaign-1")
    expect(page.get_by_test_id("scatter").locator("canvas")).to_be_visible()
    page.set_viewport_size({"width": 375, "height": 780})
    page.wait_for_function("document.documentElement.scrollWidth <= 375")


@pytest.mark.parametrize(("language", "line"), [("en", "Panel became.*blister"), ("de", "Platte wurde.*Blase")])
def test_what_became_of_the_panels_compared_is_in_the_words_it_is_marked_with(plant, served, language, line):
    address, page, _ = plant
    _, feed, _ = served
    feed.store.annotate_run("campaign-1", {"panel.verdict": "blister", "recipe": "16 mm"}, "operator")
    page.goto(address + "#/runs/compare/campaign-1/lab-0000000")
    page.locator("#language").select_option(language)
    table = page.get_by_test_id("differences")
    expect(table.get_by_role("row", name=re.compile(line))).to_be_visible()
    expect(table).not_to_contain_text("recipe")


def test_a_run_the_model_does_not_describe_is_red_and_has_no_intervals(plant, served):
    address, page, _ = plant
    fit = page.locator("[data-testid=fit]")
    page.goto(address + "#/runs/campaign-1")
    expect(fit.locator(".pill").first).to_have_text("converged")
    expect(fit).to_contain_text("560 … 640")
    warned = say("fit-not-described-check", misfit=say("plain-text", text="off by 9 K")).to_json()
    coefficient = {"value": 600.0, "sd": 20.0, "ci95": [560.0, 640.0], "identifiable": True}
    found = {"run": "campaign-1", "converged": True, "coefficients": {"h_pp_c": coefficient}, "warnings": []}
    rmse = {"rmse_K": 9.0, "initial_rmse_K": 20.0, "warnings_said": [warned]}
    served[1].store.put_fit("campaign-1", found | rmse, "")
    page.reload()
    expect(fit.locator(".pill.bad").first).to_have_text("not described by the model")
    expect(fit).not_to_contain_text("…")
    expect(page.locator("h1 + .pill")).to_have_class("pill idle")  # a complete record is no good fit


def test_a_fit_is_further_off_than_its_guesses_only_where_nothing_moves(plant, served):
    address, page, _ = plant
    fit = page.locator("[data-testid=fit]")
    found = {"run": "campaign-1", "converged": True, "coefficients": {}, "warnings": [], "warnings_said": []}
    amid_closing = {"rmse_K": 2.22, "initial_rmse_K": 0.9}
    for still, pill in ((0.39, "converged"), (0.61, "further off than its guesses")):
        rest = {"rmse_still_K": still, "initial_rmse_still_K": 0.55}
        served[1].store.put_fit("campaign-1", found | amid_closing | rest, "")
        page.goto(address + "#/runs/campaign-1")
        page.reload()
        expect(fit.locator(".pill").first).to_have_text(pill)
        expect(fit).to_contain_text("RMSE 0.90 K at the guesses → 2.22 K")
        expect(fit).to_contain_text(f"0.55 K at the guesses → {still} K")


def test_a_run_the_model_does_not_describe_is_marked_in_the_list(served):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    feed.pressing(scans=60, batch=10)
    good, bad = sorted(run.run for run in feed.store.runs(limit=10).items)
    warned = say("fit-not-described-check", misfit=say("plain-text", text="off by 9 K")).to_json()
    for run, rmse, warnings in ((good, 0.3, []), (bad, 14.0, [warned])):
        feed.store.put_fit(run, {"run": run, "coefficients": {}, "rmse_K": rmse, "warnings_said": warnings}, "")
    for width in (1280, 375):
        page.set_viewport_size({"width": width, "height": 800})
        page.goto(server.url + "#/runs")
        expect(page.locator("tr", has_text=bad).locator(".pill.bad")).to_have_text("not described by the model")
        expect(page.locator("tr", has_text=good).locator(".pill.bad")).to_have_count(0)
        expect(page.locator("tr", has_text=good).get_by_text("0.30 K")).to_be_visible()
        page.get_by_role("button", name="RMSE").click()
        expect(page.locator("tbody tr").first).to_contain_text(bad)
        expect(page.locator("tr", has_text=bad).get_by_text("14.00 K")).to_be_visible()


@pytest.mark.parametrize("width", [772, 1366])
def test_no_column_of_the_list_of_runs_is_cut_off(plant, served, browser, width, tmp_path):
    address, _, _ = plant
    warned = say("fit-not-described-check", misfit=say("plain-text", text="off by 9 K")).to_json()
    fit = {"run": "campaign-1", "coefficients": {}, "rmse_K": 14.0, "warnings_said": [warned]}
    served[1].store.put_fit("campaign-1", fit, "")
    page = browser.new_page(viewport={"width": width, "height": 900}, locale="de-DE")
    page.goto(address + "#/runs")
    expect(page.locator("tbody .pill.bad")).to_have_text("vom Modell nicht beschrieben")
    page.wait_for_function(  # a table too wide for its place becomes cards once its size is known
        "(([node, ...others]) => node && !others.length && node.scrollWidth === node.clientWidth)"
        "(document.querySelectorAll('.scroll'))"
    )
    page.screenshot(path=tmp_path / f"runs-{width}.png")
    page.close()


def test_a_tip_of_a_run_tells_each_face_once_and_a_double_click_shows_all_again(plant):
    address, page, _ = plant
    page.goto(address + "#/runs/campaign-1")
    chart = page.locator(".chart").first
    tip_says(chart, "Panel, top.*Panel, bottom")
    expect(chart.locator(".chart-tip tr")).to_have_count(4)  # the time, platens, two faces
    chart.focus()
    page.keyboard.press("+")
    expect(chart.locator(".follow")).to_be_visible()
    chart.locator(".u-over").dblclick(position={"x": 300, "y": 60})
    expect(chart.locator(".follow")).to_be_hidden()


def test_no_time_in_the_list_of_runs_reaches_into_the_number_beside_it(plant, browser):
    address, _, _ = plant
    page = browser.new_page(viewport={"width": 772, "height": 900}, locale="en-GB")
    page.goto(address + "#/runs")
    expect(page.locator("table.stacked thead")).to_have_attribute("data-label", "Sort by")
    page.wait_for_function("""() => [...document.querySelectorAll('tbody td .when .num')].every(
        (e) => e.getBoundingClientRect().right <= e.closest('td').getBoundingClientRect().right + 1)""")
    page.close()


def test_a_coefficient_that_the_newest_fit_does_not_know_says_whose_value_stands_in_its_card(plant, served):
    address, page, _ = plant
    unknown = {"value": 50.8, "sd": 30.0, "ci95": [1.0, 110.0], "identifiable": False}
    fit = {"run": "lab-0000000", "converged": True, "coefficients": {"h_pp_c": unknown}, "warnings": []}
    served[1].store.put_fit("lab-0000000", fit | {"rmse_K": 0.3, "initial_rmse_K": 2.0}, "")
    page.goto(address + "#/coefficients")
    card = page.locator("section", has=page.get_by_role("heading", name="h_pp_c"))
    expect(card).to_contain_text("600 W/m²K · last identifiable, campaign-1")
    expect(page.get_by_role("row", name="h_pp_c")).to_contain_text("50.8")
    card.get_by_text("Numbers and downloads").click()
    expect(card.get_by_role("cell", name="51", exact=True)).to_be_visible()  # though drawn at the picture's edge


def test_a_number_below_zero_has_a_minus_wherever_the_page_writes_it(plant):
    address, page, _ = plant
    page.goto(address)
    written = page.evaluate("""async () => {
        const [dom, words] = await Promise.all([import('./static/dom.js'), import('./static/words.js')]);
        const told = [words.text('page-sentence', { a: -3 }), words.text('page-x', { r: 'lab-07' })];
        return [dom.number(-2.5, 1), dom.figure(-0.12), dom.plain(-12300), ...told];
    }""")
    assert written == ["−2.5", "−0.12", "−12300", "page-sentence: a = −3", "page-x: r = lab-07"]


def test_a_loose_sensor_has_its_own_curve_and_says_so(plant):
    address, page, _ = plant
    warned = say("channel-loose", column="top_2", kelvin=19.1)

    def answer(route):
        content = route.fetch().json()
        route.fulfill(json={**content, "warnings": [str(warned)], "warnings_said": [warned.to_json()]})

    page.route("**/runs/campaign-1/fit", answer)
    page.goto(address + "#/runs/campaign-1")
    heading = page.get_by_role("heading", name="Measured, and the core as predicted live")
    card = page.locator("section", has=heading)
    expect(card.locator(".key")).to_contain_text("top_2: not used, does not follow its face")
    tip_says(card.locator(".chart").first, "top_2: not used, does not follow its face")


def test_channels_that_missed_the_same_share_a_line(plant):
    address, page, _ = plant
    spans = [
        {"column": column, "quality": "late", "rows": rows, "from_s": 8.7, "to_s": 83.3}
        for column, rows in (("top_1", 7), ("top_2", 7), ("bottom_1", 5))
    ]

    def answer(route):
        route.fulfill(json={**route.fetch().json(), "quality": spans})

    page.route("**/runs/campaign-1/samples*", answer)
    page.goto(address + "#/runs/campaign-1")
    lines = page.get_by_test_id("left-out").locator("li")
    expect(lines).to_have_text(
        ["top_1, top_2: late, 7 scans, 8.7 – 83.3 s", "bottom_1: late, 5 scans, 8.7 – 83.3 s"]
    )


def test_no_number_stands_twice_below_a_chart_of_one_run(plant, served, browser):
    served[1].store.annotate_run("campaign-1", {"panel.moisture_percent": 0.4}, "test")
    page = browser.new_page(viewport={"width": 1280, "height": 900}, locale="en-GB", bypass_csp=True)
    page.add_init_script(ACROSS)
    page.goto(plant[0] + "#/runs/scatter?q=campaign-1&x=panel.moisture_percent&y=panel.thickness_mm")
    canvas = page.get_by_test_id("scatter").locator("canvas")
    expect(canvas).to_be_visible()
    page.wait_for_function("document.querySelector('[data-testid=scatter] canvas').across?.length > 3")
    written = [words for words in canvas.evaluate("canvas => canvas.across") if words[0].isdigit()]
    page.close()
    assert len(written) == len(set(written)) > 2, written


TICKS = """
const {fillText: written, clearRect: cleared} = CanvasRenderingContext2D.prototype;
window.ticks = new Map();
CanvasRenderingContext2D.prototype.fillText = function (words, ...at) {
    if (this.textAlign === 'right') window.ticks.get(this.canvas)?.add(words);
    return written.call(this, words, ...at);
};
CanvasRenderingContext2D.prototype.clearRect = function (...at) {
    window.ticks.set(this.canvas, new Set());
    return cleared.call(this, ...at);
};
"""
"""Keeps what stands beside the upward axis of each chart as it was last drawn."""


def test_a_low_charts_axis_tells_more_than_one_step(plant, browser):
    page = browser.new_page(viewport={"width": 1280, "height": 900}, locale="en-GB")
    page.add_init_script(TICKS)

    def answer(route):
        content = route.fetch().json()
        for place in content["curves"]["places"]:
            for model in ("plain", "extended"):
                count = len(place[f"{model}_residual_K"])
                place[f"{model}_residual_K"] = [1.752 if i % 2 else -4.178 for i in range(count)]
        route.fulfill(json=content)

    page.route("**/diagnoses/*/curves", answer)
    page.goto(plant[0] + "#/diagnosis")
    expect(page.get_by_test_id("curves").locator("canvas").nth(1)).to_be_visible()
    page.wait_for_function("""() => [...document.querySelectorAll('[data-testid=curves] canvas')].every(
        (canvas) => (window.ticks.get(canvas)?.size ?? 0) > 1)""")
    page.close()


def test_a_fit_that_ended_further_off_than_its_guesses_is_amber(plant):
    address, page, _ = plant
    fit = page.locator("[data-testid=fit]")
    changes = {}

    def answer(route):
        route.fulfill(json={**route.fetch().json(), **changes})

    page.route("**/runs/campaign-1/fit", answer)
    for first, left, tone, says in (
        (0.5, 0.9, "warn", "further off than its guesses"),
        (0.9, 0.5, "good", "converged"),
    ):
        changes.update(initial_rmse_K=first, rmse_K=left)
        page.goto(address + "#/runs")
        page.goto(address + "#/runs/campaign-1")
        expect(fit.locator(".head .pill")).to_have_text(says)
        expect(fit.locator(".head .pill")).to_have_class(f"pill {tone}")
        expect(fit).to_contain_text(f"{first:.2f}")


def test_a_days_pressings_are_marked_by_the_clock_where_a_press_runs_faster_than_it(plant):
    address, page, _ = plant
    page.goto(address)
    run = {"run": "a", "started_utc": "2026-03-04T00:00:10Z", "ended_utc": "2026-03-04T00:00:20Z"}
    runs = [run | {"closed_s": 20.0, "opened_s": 100.0}]
    marked = page.evaluate(
        "told => import('./static/views/day.js').then((day) => day.phasesOf(told, '2026-03-04T00:00:00Z', 20))",
        runs,
    )
    assert [(p["state"], p["from_s"], p["to_s"]) for p in marked] == [("open", 10, 20), ("closed", 11, 15)]


def test_a_run_says_what_was_sure_of_the_cure_at_opening_and_nothing_without_a_resin(plant):
    address, page, _ = plant
    page.goto(address + "#/runs/lab-0000000")
    expect(page.get_by_role("heading", name="lab-0000000")).to_be_visible()
    expect(page.get_by_test_id("at-opening")).to_have_count(0)

    def answer(route):
        content = route.fetch().json()
        route.fulfill(
            json=content | {"cure_low": [0.6] * content["rows"], "grade": ["undercured"] * content["rows"]}
        )

    page.route("**/runs/lab-0000000/estimates*", answer)
    page.reload()
    expect(page.get_by_test_id("at-opening")).to_contain_text("≥\u00a060\u00a0%, undercured")


def test_a_runs_page_asks_what_if_only_when_that_is_unfolded(plant, browser):
    address, *_ = plant
    page = browser.new_context(locale="de-DE", viewport={"width": 375, "height": 812}).new_page()
    asked = []
    page.on("request", lambda request: asked.append(request.url) if "what-if" in request.url else None)
    page.goto(address + "#/runs/campaign-1")
    card = page.get_by_test_id("what-if")
    card.locator("summary").first.click()
    card.locator("#what-if-platen_temperature_C").fill("170,5")
    card.locator("form button").click()
    expect(card.locator("table").first).to_contain_text("Mit diesen Einstellungen")
    expect(card.locator("table").first).to_contain_text("Wie es war, simuliert")  # live it was another number
    assert asked == [f"{address}api/v1/runs/campaign-1/what-if{q}" for q in ("", "?platen_temperature_C=170.5")]
    page.wait_for_function("document.documentElement.scrollWidth <= 375")
    drawer = card.locator("details.keep").first
    drawer.locator("summary").click()
    bounds = drawer.get_by_role("columnheader").filter(has_text="Grenze")
    expect(bounds).to_have_text([re.compile("^Mit diesen Einstellungen:")] * 2)  # drawn once it is unfolded
    card.locator("#what-if-platen_temperature_C").fill("-3")
    card.locator("form button").click()
    expect(card.get_by_role("alert")).to_have_text("Heizplatten [°C]: muss mindestens 60 sein")
    page.context.close()


def test_before_the_first_core_its_chart_reaches_from_a_room_to_the_target(plant):
    address, page, _ = plant
    page.goto(address)
    low, high = page.evaluate(
        "import('./static/views/answer.js').then((it) => it.CoreChart.prototype.range.call({ target: 40 }))"
    )
    assert low < 20 < 40 < high


def test_a_day_shows_readings_in_and_between_pressings_a_part_finer_and_leads_to_its_runs(plant):
    address, page, _ = plant
    page.goto(address + "#/runs")
    page.get_by_role("link", name="Whole days").click()
    day = page.get_by_test_id("day")
    drawer = day.locator("details.keep")
    drawer.locator("summary").click()
    with page.expect_download() as taken:
        drawer.get_by_role("button", name="CSV").click()
    rows = [line.split(",")[1:] for line in Path(taken.value.path()).read_text(encoding="utf-8").splitlines()[1:]]
    assert len(rows) == 600
    assert {"20", "25.9"} <= {cell for row in rows for cell in row}  # the coldest and the hottest that were fed
    expect(drawer.get_by_role("columnheader", name="Panel, top: highest")).to_have_count(1)
    chart = day.locator(".chart")
    chart.focus()
    with page.expect_response(re.compile(r"/scans\?.*points=600")) as finer:
        page.keyboard.press("+")
    assert finer.value.json()["step_s"] < 120
    day.get_by_role("button", name="Whole day").click()
    expect(day.get_by_role("button", name="Whole day")).to_be_hidden()
    expect(page.get_by_test_id("day-runs").get_by_role("link", name="lab-0000000")).to_be_visible()
    page.get_by_label("The day before").click()
    expect(page.get_by_test_id("day-runs").get_by_role("link")).to_have_count(0)
    page.go_back()
    page.get_by_test_id("day-runs").get_by_role("link", name="lab-0000000").click()
    expect(page.get_by_role("heading", name="lab-0000000")).to_be_visible()
