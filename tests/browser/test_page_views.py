"""Every view with stored pressings: nothing for axe to find, metadata changed by hand, files taken by token."""

from __future__ import annotations

import re
import threading
from dataclasses import replace
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from api.tokens import TokenFile
from daq.pressfile import read_press
from daq.simulated.campaign import Plan, make_campaign
from softsensor.diagnosis_advice import next_measurement
from softsensor.effects import BUILT_IN, find_effect
from softsensor.service import fit_one

VIEWS = ("#/now", "#/runs", "#/runs/campaign-1", "#/coefficients", "#/diagnosis", "#/loggers", "#/access", "docs")
LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
REASON = (
    "edge_loss + paper_layer: residual 0.470 -> 0.468 K on 5 runs, core 1.20 -> 1.30 K live; the core gets worse"
)
EFFECT = {
    "name": "moisture_evaporation",
    "set": ["moisture_evaporation"],
    "parameters": {"moisture_percent": {"value": 3.2, "ci95": [2.3, 4.0]}},
    "p_value": 0.0005,
    "heldout_gain_K": 0.58,
    "explained_share": 0.98,
    "worth": "hardly lowers the residual on runs left out (0.00 of 1.06 K); named because 8 of 10 runs, each left "
    "out in turn, are met better with it; it moves h_ap (plate – air, open) by -18 %, and the core by 0.2 K when "
    "the press opens",
}
WHERE = {
    "signal": "panel.top",
    "state": "open",
    "phase": "after opening",
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
    for version, status in (("1", "retired"), ("2", "promoted")):
        store.put_model("lab", version, {"version": version, "effects": []}, status=status)
    store.put_diagnosis("lab", DIAGNOSIS)
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    token = TokenFile(server.config.parent / "kerntemp-tokens.json").create("foreman", "write")
    return server.url, page, token


def with_token(page: Page, token: str) -> None:
    page.add_init_script(f"sessionStorage.setItem('kerntemp-token', {token!r})")


def violations(page: Page) -> list[dict[str, Any]]:
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [{"rule": v["id"], "where": v["nodes"][0]["target"]} for v in found]


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
        expect(page.locator("main .card").first).to_be_visible()
        page.wait_for_load_state("networkidle") if view == "docs" else page.wait_for_timeout(300)
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
    expect(page.get_by_test_id("metadata")).to_contain_text("panel.thickness_mm: 16 → 15.8")
    expect(page.get_by_test_id("metadata")).to_contain_text("foreman")


def test_nothing_that_is_missing_is_written_as_null(plant):
    address, page, _ = plant
    for view in (*VIEWS[:-1], "#/runs/compare/campaign-1/lab-0000000"):
        page.goto(address + view)
        expect(page.locator("main .card").first).to_be_visible()
        page.wait_for_timeout(500)
        assert not re.search(r"\b(null|undefined|NaN)\b", page.locator("main").inner_text()), view


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


def test_a_model_version_is_rolled_back_by_hand(plant):
    address, page, token = plant
    with_token(page, token)
    page.goto(address + "#/diagnosis")
    expect(page.get_by_test_id("diagnosis")).to_contain_text("Moisture evaporates")
    page.on("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Roll back to this").click()
    expect(page.locator("tbody tr", has_text="in use").locator("td").first).to_have_text("1")


def test_the_diagnosis_is_told_in_german_down_to_the_next_measurement(plant, browser):
    address, _, _ = plant
    context = browser.new_context(locale="de-DE")
    page = context.new_page()
    page.goto(address + "#/diagnosis")
    expect(page.get_by_test_id("diagnosis")).to_contain_text("Feuchte verdampft")
    expect(page.get_by_test_id("diagnosis")).to_contain_text("Wiegen Sie die Platte vor und nach dem Pressen")
    expect(page.get_by_role("row", name="Wasser, das verdampft 3,2 % der Trockenmasse 2,3 … 4")).to_be_visible()
    expect(page.get_by_test_id("diagnosis")).to_contain_text("es ändert h_ap (Presse – Luft) um -18 %")
    where = page.get_by_role("row", name="Platte oben +0,66 K nach dem Öffnen 8 … 16 s 154 … 166 °C")
    expect(where).to_be_visible()
    context.close()


def test_every_confirming_measurement_of_the_catalogue_has_its_german_sentence():
    told = (Path(__file__).parents[2] / "api" / "page" / "measurements.js").read_text(encoding="utf-8")
    for effect in BUILT_IN:
        for sentence in effect.confirm.removesuffix(".").split(". "):
            assert f'"{sentence}":' in told, f"{effect.name}: {sentence}"


def test_every_parameter_of_the_catalogue_has_its_german_words_and_unit():
    told = (Path(__file__).parents[2] / "api" / "page" / "parameters.js").read_text(encoding="utf-8")
    for effect in BUILT_IN:
        for parameter in effect.parameters:
            assert f'"{parameter.words}":' in told, effect.key(parameter.name)
            unit = parameter.scale[1]
            assert f'"{unit}":' in told or not re.search("[a-z]{3}", unit), unit


def test_what_a_real_fit_could_not_tell_is_said_in_german_to_the_last_clause(plant):
    address, page, _ = plant
    press = read_press(LAB)
    run, truth = make_campaign(7, 1, plan=Plan(rate_hz=2.0, closed_column=False, thickness_mm=16.0))[0]
    short = run.time_s < truth.moments.closed_s + 6.0
    columns = {name: values[short] for name, values in run.columns.items()}
    columns["top_3"] = columns["top_3"] * 0 + 55.0
    said = fit_one(press, replace(run, time_s=run.time_s[short], columns=columns), None)["warnings"]
    assert len(said) > 3
    page.add_init_script("localStorage.setItem('kerntemp-language', 'de')")
    page.goto(address)
    again = "edge_loss: residual 0.470 -> 0.468 K on 5 runs; like lab-2, which was rolled back"
    for english in (*said, REASON, again, "first model, coefficients of 8 runs"):
        german = page.evaluate("text => import('/static/sentences.js').then((m) => m.sentence(text))", english)
        assert german != english
        assert not re.search(r"\b(the|with|of|on|is|to|and)\b", german), german


SAID = (
    "saves 0.48 of 0.71 K on runs left out",
    "found by comparison with the channels beside it, and left out",
    "hardly lowers the residual on runs left out (0.00 of 0.23 K); it moves no coefficient by more than chance",
    "hardly lowers the residual on runs left out (0.01 of 0.23 K); named because 2 of 2 runs, each left out in "
    "turn, are met better with it; it moves h_1 (hot – cold) by +12 %, and the core by -0.1 K at the end of a run",
    "press lab: logger upper does not answer: 127.0.0.1:502 station 1: no reply in 0.3 s; check power, cable and "
    "address; recording goes on without it, trying again",
    "press lab: logger lower does not answer: cannot open /dev/kerntemp/bus: port in use; another program has it "
    "open; close that; recording goes on without it, trying again",
    "press lab: logger lower answers again",
    "press lab: scans begin",
    "press lab: 3 scans left out, this machine was too busy",
    "lab: 31 scans left out in the last minute, this machine is too busy",
    "1200 scans wait to be written, this machine is too busy",
    "lab: 700 scans behind, this machine is too busy",
    "record@pc-2: silent for 31 s; start kerntemp record",
    "refit: the nightly job has not come to its end for 51 h; see its log",
    "less than 2 GB left on the store's disk",
    "store lab.sqlite: database is locked; another process holds it; close other programs that have the file "
    "open; scans wait in memory, enough for 2.8 h",
    "store lab.sqlite takes data again; everything kept is written",
    "the changed configuration is in force",
    r"body.header.two words.[key]: String should match pattern '^[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*$'",
    "run campaign-1: header key layer.lid.thickness_mm: the press file has no such place",
    "header.setting.speed_mm_s = 'high': must be a number",
    "run campaign-1: header key panel.density_kg_m3 is missing and material 'Unobtainium' is not in the table "
    "(MDF, PB); add '# panel.density_kg_m3 = ...'",
    "token tablet created, scope read",
    "run lab-2026-11-21-341 could not be fitted: store: column 'platen_bottom' is empty for 69.0 s around "
    "time_s = 0; at most 10 s of boundary.bottom are bridged: cut the run there",
    "lab: 12 of 14 runs fitted, 2 could not be; diagnosis: unknown_effect; model lab-1 promoted: first model, "
    "coefficients of 12 runs; nothing changed",
    "lab: 3 of 3 runs fitted, 0 could not be; diagnosis: too_few_runs; model none stays: 3 runs fitted, "
    "6 are needed",
    f"lab: 9 of 9 runs fitted, 0 could not be; diagnosis: named; model lab-1 stays: lab-2 rejected, {REASON}",
    "lab: logger upper: cannot connect to 192.168.0.21:502: unreachable; nobody answers at this address; check "
    "power, cable and host",
    "lab: 12 of 40 runs fitted, 0 could not be; diagnosis: no_effect; model m-1 stays: too few runs to judge by",
    "a change needs a token with scope write; kerntemp token create makes one",
    "token 'tablet' may read only; a change needs scope write",
    "run 'x' does not exist; /api/v1/runs lists them",
    "run campaign-1: header key panel.thickness_mm = 5000: must be a number from 0.1 to 500",
    "h is not identifiable: it couples plate and panel while closed (60 s here); it moves together with closed_s "
    "(correlation +0.93). Log faster than the 1 Hz here, and log a limit switch as the column closed.",
    "h is not identifiable: it acts at the face of panel while open (5 s before closing and 70 s after opening "
    "here); its effect of 0.1 K drowns in the slow noise of the faces (0.2 K). Log the channels at panel.top too, "
    "which this run lacks, or take the joint estimate of these 8 runs.",
    "edge_loss.W_m3K is not identifiable: it is a parameter of an effect; it is known to a factor of 3.0 only; it "
    "moves together with h_ap (correlation +0.99). " + find_effect("heat_capacity_offset").confirm,
    "model not valid: sensors read 104 °C where the header has the panel start at 24 °C",
    "model not valid: the run begins in the closed press",
    "model not valid: the press has closed again on the same panel",
    "model not valid: the press closed while nothing was heard of it for long",
    "model not valid: both faces have leapt while they were not heard",
    "model not valid: platen temperatures were missing when the panel came to lie in the press",
    "the model does not describe this run: 9.1 K left of readings that span 120 K. Check its header, the press "
    "file, and that its rows show insertion and closing",
)
"""What the journal, the alarms, refusals and fits say; the forms stand in daq, api and softsensor."""


def test_what_the_plant_the_store_and_a_refusal_say_is_german_too(served):
    server, _, page = served
    page.add_init_script("localStorage.setItem('kerntemp-language', 'de')")
    page.goto(server.url)
    for english in (*SAID, *_next_measurements()):
        german = page.evaluate("text => import('/static/sentences.js').then((m) => m.sentence(text))", english)
        bare = re.sub(r"kerntemp [\w -]+|\bscans?_\w+", "", german)
        assert not re.search(r"\b(the|with|is|to|and|of|from|check|press|logger|run)\b", bare), german


def _next_measurements():
    """Return every sentence a diagnosis may end with."""
    effect = SimpleNamespace(name="edge_loss", set=("edge_loss", "open_radiation"))
    alone = SimpleNamespace(name="edge_loss", set=("edge_loss",))
    cases = [
        ("too_few_runs", (), (None, None)),
        ("ambiguous", (effect,), (None, None)),
        ("unknown_effect", (), (None, None)),
        ("no_effect", (), (2.5, 2.5)),
        ("no_effect", (), (None, None)),
        ("named", (alone,), (5.0, 0.8)),
        ("named", (alone,), (None, None)),
    ]
    return [next_measurement(verdict, found, cores, 8, True) for verdict, found, cores in cases]


def test_a_core_nobody_updates_any_more_gives_way_to_the_reason(served):
    server, feed, page = served
    feed.pause_s = 0.01
    said = feed.store.append_estimates
    writer = threading.Thread(target=feed.pressing, args=(3000,), daemon=True)
    writer.start()
    page.goto(server.url + "#/now")
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    feed.store.append_estimates = lambda *_: None
    expect(page.get_by_test_id("band")).to_contain_text("the live sensor has said nothing for")
    expect(page.get_by_test_id("core")).to_have_text("–°C")
    feed.store.append_estimates = said
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    feed.stop.set()
    writer.join(20)


def test_the_skip_link_reaches_the_content_and_stays_in_the_view(plant):
    address, page, _ = plant
    page.goto(address + "#/runs")
    expect(page.get_by_role("heading", name="Runs")).to_be_visible()
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "view"
    assert page.url.endswith("#/runs")
    page.evaluate("location.hash = '#view'")
    expect(page.get_by_role("heading", name="Runs")).to_be_visible()


def test_before_the_first_answer_the_page_is_loading_and_not_cut_off(served):
    server, _, page = served
    page.route("**/api/v1/press*", lambda _: None)  # never answered
    page.goto(server.url)
    expect(page.locator("#link")).to_have_text("connecting …")
    shown = "getComputedStyle(document.querySelector('main .stack'), '::after').content"
    assert page.evaluate(shown) == '"loading …"'


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
    expect(page.get_by_test_id("simulation")).to_contain_text("Platte oben")
