"""The one answer, and the wall: told from one look ahead, and nothing told that rests on old readings."""

from __future__ import annotations

import re
import threading
import time
from dataclasses import replace

import pytest
from playwright.sync_api import Error, expect

from daq.records import PressEvent, PressEventKind
from daq.store.records import StoredEstimate
from tests.browser.conftest import ACROSS, CHANNELS, LAB, comes
from tests.patience import wait_until

AHEAD = {
    "open_in_s": 11.0,
    "open_earliest_s": 8.0,
    "open_latest_s": 15.0,
    "target_in_s": 26.0,
    "target_earliest_s": 23.0,
    "target_latest_s": 30.0,
    "peak_C": 70.0,
}
PAPER = {"cure_low": 0.814, "grade": "matt", "steam_high_kPa": 20.2}
"""What stands beside that where the press has a resin file, by whose limits the answer is then given."""
COURSE = [[0.0, 50.0, 48.0, 52.0], [20.0, 58.0, 54.0, 62.0], [40.0, 66.0, 60.0, 72.0]]


@pytest.fixture
def pressing(served):
    """A pressing with a target of which the sensor says when to open; the server, its page, the feed."""
    server, feed, page = served
    append = feed.store.append_estimates

    def foreseeing(press, estimates):
        beside = {**AHEAD, "forecast_age_s": 0.3, "course": COURSE, "left_out": {"top_3": -71.2}}
        append(press, [StoredEstimate(*_core_of(e), detail=beside) for e in estimates])

    feed.store.append_estimates = foreseeing
    beating = threading.Event()

    def beat():
        while not beating.wait(0.5):
            for process in ("record", "sense"):
                feed.store.beat(process, {"state": "running", "presses": []})

    heart = threading.Thread(target=beat, daemon=True)
    heart.start()
    feed.shares = (0.0, 0.001, 0.999)
    writer = threading.Thread(target=feed.pressing, args=(6000,), daemon=True)
    writer.start()
    while feed.store.open_run("lab") is None:
        time.sleep(0.01)
    run = feed.store.open_run("lab").run
    feed.store.annotate_run(run, {"setting.core_target_C": 60.0}, "test")
    yield server, page
    feed.stop.set()
    beating.set()
    writer.join(240)
    heart.join(240)


def _core_of(e):
    core = (e.core_celsius, e.core_sd_kelvin, e.core_low_celsius, e.core_high_celsius)
    return e.number, e.monotonic_s, e.state, *core, e.valid, e.reason, "1"


@pytest.mark.parametrize("view", ["#/now", "#/wall"])
def test_the_answer_is_one_line_and_nothing_beside_it_contradicts_it(pressing, view):
    server, page = pressing
    page.goto(server.url + view)
    answer = page.get_by_test_id("answer")
    expect(answer).to_have_text("open in 11 s (8 to 15)")
    expect(answer).to_have_class("answer open_in")
    expect(page.get_by_test_id("peak")).to_have_text("the core then peaks at 60 °C")  # though it is at 50 now
    expect(page.get_by_text("Peak if opened now")).to_have_count(0)
    expect(page.locator(".chart canvas").first).to_be_visible()


BROKEN = """(place) => {
    const text = place.firstChild.textContent, range = document.createRange(), found = [];
    for (const {index, 0: said} of text.matchAll(/\\d\\s(?:s|min|h|°C|K)(?![\\p{L}])|\\([^()]*\\)/gu)) {
        range.setStart(place.firstChild, index);
        range.setEnd(place.firstChild, index + said.length);
        const tops = [...range.getClientRects()].filter((r) => r.width > 0).map((r) => Math.round(r.top));
        found.push(Math.max(...tops) - Math.min(...tops));
    }
    return found;
}"""
"""How far apart number and unit, and begin and end of a band, stand in every place of a line. [px]"""


@pytest.mark.parametrize("language", ["en", "de"])
def test_no_line_of_the_answer_ends_between_a_number_and_its_unit(pressing, language):
    server, page = pressing
    page.add_init_script(f"localStorage.setItem('kerntemp-language', '{language}')")
    page.goto(server.url + "#/wall")
    answer = page.get_by_test_id("answer")
    expect(answer).to_contain_text("11 s")
    for width in (*range(320, 480, 12), *range(700, 1100, 24), 1366, 1920):
        page.set_viewport_size({"width": width, "height": 1080 if width > 1100 else 768})
        assert set(answer.evaluate(BROKEN)) == {0}, width


def test_a_channel_that_is_not_used_says_so_on_its_tile_and_is_not_called_good(pressing):
    server, page = pressing
    page.goto(server.url + "#/now")
    tile = page.locator(".channel", has_text="top_3")
    expect(tile).to_contain_text("lately 71 K below its neighbours, not used")
    expect(tile).not_to_contain_text("good")
    expect(page.locator(".channel", has_text="top_4")).to_contain_text("good")


def test_the_wall_says_which_pressing_it_shows_once_that_is_over(served, tmp_path):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    page.set_viewport_size({"width": 375, "height": 740})
    page.goto(server.url + "#/wall")
    expect(page.locator(".wall-head > .num")).to_have_text("Last pressing lab-0000000")
    expect(page.locator(".chart canvas")).to_be_visible()
    page.screenshot(path=tmp_path / "wall.png")
    page.wait_for_function("document.documentElement.scrollWidth <= 375")


@pytest.mark.parametrize("view", ["#/now", "#/wall"])
def test_the_time_from_closing_goes_on_while_the_core_does(pressing, view):
    server, page = pressing
    asked = []

    def answer(route):  # the first poll alone: all else comes by the stream
        asked.append(1)
        route.fallback() if len(asked) < 4 else route.abort()

    page.route("**/api/v1/press?*", answer)
    page.route("**/api/v1/press", answer)
    page.goto(server.url + view)
    expect(page.get_by_test_id("answer")).to_have_text("open in 11 s (8 to 15)")
    since = page.locator(".facts dd" if view == "#/now" else ".wall-head > .num").first
    expect(since).not_to_have_text("")
    while len(asked) < 6:
        page.wait_for_timeout(50)
    before = since.inner_text()
    expect(since).not_to_have_text(before)


IN_COLOUR = """
const {fillText: write, clearRect: clear} = CanvasRenderingContext2D.prototype;
CanvasRenderingContext2D.prototype.fillText = function (words, ...at) {
    (this.canvas.written ??= {})[words] = this.fillStyle;
    return write.call(this, words, ...at);
};
CanvasRenderingContext2D.prototype.clearRect = function (...at) {
    this.canvas.written = {};
    return clear.call(this, ...at);
};
"""
"""Keeps the words of each chart as it was last drawn, and their colours."""


@pytest.mark.parametrize("view", ["#/now", "#/wall"])
def test_without_readings_no_answer_stands_and_nothing_is_green(pressing, view):
    server, page = pressing
    page.add_init_script(IN_COLOUR)
    page.goto(server.url + view)
    answer = page.get_by_test_id("answer")
    expect(answer).to_have_text("open in 11 s (8 to 15)")
    written = "(document.querySelector('.chart canvas')?.written ?? {})"
    of = "getComputedStyle(document.documentElement).getPropertyValue('--{}').trim()"
    comes(page, written, f"(it) => it.open === {of.format('accent')}")
    server.stop_for_a_while()
    if view == "#/wall":
        expect(answer).to_contain_text("not known, because no reading for")
    else:
        expect(page.locator(".banner")).to_contain_text("No new reading since")
        expect(answer).to_have_text("not known")
    expect(page.get_by_test_id("peak")).to_be_hidden()
    expect(page.locator(".light.bad")).to_have_text(["no readings"] if view == "#/wall" else [])  # said once
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
    page.wait_for_function(f"({green})().length === 0")
    expect(page.locator(".faces-now:visible")).to_have_count(0)  # "now" was then
    expect(page.locator(".hero svg:visible")).to_have_count(0)  # nobody knows where the press stands
    comes(page, written, f"(it) => it['Target 60 °C'] === {of.format('faint')}")
    comes(page, written, f"(it) => it.open !== {of.format('accent')}")  # what was foreseen then
    server.go_on()
    expect(answer).to_have_text("open in 11 s (8 to 15)")
    page.wait_for_function(f"({green})().length > 0")


def test_no_green_light_stands_beside_an_answer_that_is_not_known(pressing, served):
    server, page = pressing
    store = served[1].store
    page.goto(server.url + "#/wall")
    light, answer, state = (page.locator(f".{part}").first for part in ("light", "answer", "pill"))
    expect(light).to_have_class("light good")
    expect(state).to_have_text("closed")
    append = store.append_estimates
    store.append_estimates = lambda *_: None  # the live sensor hangs, and goes on giving signs of life
    expect(answer).to_contain_text("not known, because the live sensor has given no estimate for")
    expect(light).to_have_class("light bad")
    expect(light).to_contain_text("the live sensor has given no estimate for")
    expect(state).to_have_text("closed")
    store.append_estimates = lambda press, estimates: append(
        press, [replace(e, valid=False, reason="band too wide") for e in estimates]
    )
    expect(answer).to_contain_text("not known, because core not observable")
    expect(light).to_have_class("light idle")
    expect(light).to_have_text("all runs, core not known")
    store.append_estimates = append
    expect(light).to_have_class("light good")


def test_what_is_sure_of_cure_and_steam_stands_beside_the_live_core(pressing, monkeypatch):
    server, page = pressing
    for key, value in PAPER.items():
        monkeypatch.setitem(AHEAD, key, value)
    page.goto(server.url + "#/now")
    expect(page.locator(".facts")).to_contain_text("≥\u00a081\u00a0%, matt")
    expect(page.locator(".facts")).to_contain_text("≤\u00a020\u00a0kPa")


def test_press_and_core_are_shown_in_one_state(pressing, served):
    server, page = pressing
    feed = served[1]
    page.goto(server.url + "#/wall")
    expect(page.get_by_test_id("state")).to_have_text("closed")
    page.route("**/api/v1/press*", lambda route: route.abort())  # so that the stream alone tells
    removed = PressEvent(PressEventKind.REMOVED, 1.0, 1.0)
    page.wait_for_timeout(300)
    feed.store.append_scans(feed.key, [], [removed])
    expect(page.get_by_test_id("state")).to_have_text("no panel")
    expect(page.get_by_test_id("band")).to_be_empty()
    expect(page.get_by_test_id("answer")).to_have_text("no panel in the press")
    expect(page.get_by_test_id("core")).to_have_text("–°C")


CUT = """(facts) => [...facts.querySelectorAll('dt, dd')].flatMap(({ firstChild: words }) => {
    const range = document.createRange();
    return [...(words.data ?? '').matchAll(/[^\\s-]+/gu)].filter(({ index, 0: word }) => {
        range.setStart(words, index);
        range.setEnd(words, index + word.length);
        return new Set([...range.getClientRects()].map((r) => Math.round(r.top))).size > 1;
    }).map(([word]) => word);
})"""
"""Words that are cut in two by the end of a line."""


@pytest.mark.parametrize("width", [375, 772, 1366, 1920])
def test_no_number_beside_the_core_leaves_its_card_and_no_word_is_cut(
    pressing, browser, monkeypatch, tmp_path, width
):
    server, _ = pressing
    for key, value in (
        ("band_from", {"suspected": 0.5, "start": 0.39}),
        ("energy_kJ_m2", 414.0),
        ("limited", True),
    ):
        monkeypatch.setitem(AHEAD, key, value)
    page = browser.new_page(viewport={"width": width, "height": 900}, locale="de-DE")  # the longest words
    page.goto(server.url + "#/now")
    facts = page.locator(".facts")
    expect(facts).to_contain_text("den Temperaturen von Start und Heizplatten")
    expect(facts).to_contain_text("Grenzen des Harzes, nicht 60\u00a0°C")
    expect(page.locator(".bench")).to_be_hidden()  # fills with the target, which does not count here
    assert facts.evaluate(CUT) == []
    page.screenshot(path=tmp_path / "now.png", full_page=True)
    page.wait_for_function("""() => {
        const card = document.querySelector('.hero'), inner = card.getBoundingClientRect();
        const end = inner.right - parseFloat(getComputedStyle(card).paddingRight);
        return [...card.querySelectorAll('dd, svg')].every((e) => e.getBoundingClientRect().right <= end + 1);
    }""")
    page.close()


def test_the_faces_beside_the_next_panel_are_those_of_the_tiles(pressing):
    """Faces gain 20 K a second while the press closes: what is asked for every two seconds was another truth."""
    server, page = pressing
    page.goto(server.url + "#/now")
    expect(page.locator(".faces-now")).to_contain_text("°C above")
    page.route("**/api/v1/press*", lambda route: route.abort())
    was = float(page.locator(".faces-now").text_content().split()[3])
    page.wait_for_function(
        f"() => parseFloat(document.querySelector('.faces-now').textContent.split(' ')[3]) > {was + 1.0}"
    )


def test_the_faces_beside_the_next_panel_are_those_of_the_tiles_while_the_live_sensor_is_silent(pressing, served):
    server, page = pressing
    page.goto(server.url + "#/now")
    expect(page.locator(".faces-now")).to_contain_text("°C above")
    served[1].store.append_estimates = lambda *_: None
    expect(page.get_by_test_id("answer")).to_contain_text("the live sensor has given no estimate for")
    page.route("**/api/v1/press*", lambda route: route.abort())
    was = float(page.locator(".faces-now").text_content().split()[3])
    page.wait_for_function(
        f"() => parseFloat(document.querySelector('.faces-now').textContent.split(' ')[3]) > {was + 1.0}"
    )


def test_what_stands_beside_the_core_is_of_the_last_estimate_too(pressing, served, monkeypatch):
    server, page = pressing
    feed, store = served[1], served[1].store
    monkeypatch.setitem(AHEAD, "energy_kJ_m2", 215.0)
    page.goto(server.url + "#/now")
    expect(page.locator(".facts")).to_contain_text("215")
    page.route("**/api/v1/press*", lambda route: route.abort())  # so that the stream alone tells
    page.wait_for_timeout(300)
    append = store.append_estimates
    store.append_estimates = lambda *_: None
    page.wait_for_timeout(1000)
    for energy in (216.0, 217.0):  # two within the time in which the numbers are written once
        monkeypatch.setitem(AHEAD, "energy_kJ_m2", energy)
        now = store.open_run("lab")
        scan = feed.number - 1
        append("lab", [StoredEstimate(scan, 1000.0 + 0.1 * scan, "closed", 50.0, 1.0, 48.0, 52.0, True)])
        page.wait_for_timeout(200)
    assert now is not None
    expect(page.locator(".facts")).to_contain_text("217", timeout=2_000)


def test_a_core_that_ends_before_the_readings_says_why(pressing, served):
    server, page = pressing
    store = served[1].store
    page.goto(server.url + "#/now")
    expect(page.locator(".chart canvas").first).to_be_visible()
    expect(page.get_by_test_id("behind")).to_be_hidden()
    append = store.append_estimates
    store.append_estimates = lambda *_: None
    expect(page.get_by_test_id("behind")).to_have_text(
        re.compile(r"The live sensor has not processed the last \d+\Ws of the readings: the core's curve ends")
    )
    store.append_estimates = append
    expect(page.get_by_test_id("behind")).to_be_hidden()


def test_the_time_axis_of_a_pressing_that_has_just_closed_has_whole_seconds(pressing, browser):
    server, _ = pressing
    page = browser.new_page(viewport={"width": 1920, "height": 1080}, locale="en-GB", bypass_csp=True)
    page.add_init_script(ACROSS)
    page.goto(server.url + "#/wall")
    written = "document.querySelector('.wall-chart canvas')?.across?.filter((words) => /\\d/.test(words))"
    page.wait_for_function(f"{written}?.length > 1")
    assert [words for words in page.evaluate(written) if "." in words] == []
    page.close()


SAID = (
    (
        "not_known",
        {"code": "advice-not-known", "arguments": {"why": {"code": "reason-estimate-behind-the-press"}}},
    ),
    ("open_in", {"code": "advice-open-in-between", "arguments": {"seconds": 111, "low": 80.0, "high": 150.0}}),
    ("open_now", {"code": "advice-open-now", "arguments": {}}),
    ("too_early", {"code": "advice-too-early", "arguments": {}}),
    ("opened", {"code": "advice-opened-peak", "arguments": {"peak_C": 112.0}}),
    ("not_known", {"code": "advice-not-known", "arguments": {"why": {"code": "advice-no-look-ahead"}}}),
)
"""Answers short and long: the longest stands in every row of tiles."""


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (1366, 768), (1920, 1080)])
def test_thirty_presses_with_long_names_and_answers_stand_on_one_screen(
    pressing, browser, tmp_path, width, height
):
    server, _ = pressing

    def thirty(route):
        try:
            content = route.fetch().json()
        except Error:  # the page or its server has been closed
            return
        one = content["items"][0]
        content["items"] = []
        for number in range(30):
            verdict, said = SAID[number % len(SAID)]
            advice = one["estimate"]["advice"] | {"verdict": verdict, "sentence_said": said}
            estimate = one["estimate"] | {"advice": advice, "valid": verdict != "not_known"}
            content["items"].append(
                one | {"press": f"Linie-{1 + number // 10}-Presse-{number}", "estimate": estimate}
            )
        route.fulfill(json=content)

    page = browser.new_page(viewport={"width": width, "height": height}, locale="de-DE", bypass_csp=True)
    page.route("**/api/v1/press", thirty)
    page.goto(server.url)
    expect(page.locator(".press-tile")).to_have_count(30)
    expect(page.locator(".press-tile .answer").nth(1)).to_have_text("öffnen in 111 s (80 bis 150)")
    page.screenshot(path=tmp_path / "presses.png", full_page=True)
    page.wait_for_function("document.querySelector('.presses').getBoundingClientRect().bottom <= innerHeight")
    beyond = """(tiles) => tiles.flatMap((tile) => {
        const {right} = tile.getBoundingClientRect();
        return [...tile.querySelectorAll('b, .pill, .band, .answer, .light')].filter((one) =>
            one.getBoundingClientRect().right > right || one.scrollWidth > one.clientWidth + 1
        ).map((one) => one.textContent);
    })"""
    assert page.locator(".press-tile").evaluate_all(beyond) == []
    page.unroute_all(behavior="ignoreErrors")
    page.close()


def test_the_names_of_the_phases_stand_clear_of_the_target(served):
    server, _, page = served
    page.goto(server.url)
    asked = "it.CoreChart.prototype.range.call({ target: 40 }, 20, 36)"
    low, high = page.evaluate(f"import('./static/views/answer.js').then((it) => {asked})")
    # The lowest chart, of 240 px, is 176 px without its axis; a name reaches 17 px down, a line is 2 px.
    assert (high - 40) / (high - low) > 19 / 176


DRAWN = """async (from) => {
    const { CoreChart } = await import('./static/views/answer.js');
    const place = document.body.appendChild(Object.assign(document.createElement('div'), {style: 'width: 700px'}));
    const across = CanvasRenderingContext2D.prototype.fillText, words = {};
    CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
        const {width, actualBoundingBoxAscent: up, actualBoundingBoxDescent: down} = this.measureText(text);
        const left = this.textAlign === 'right' ? x - width : x;
        words[text] = {left, right: left + width, top: y - up, bottom: y + down};
        return across.call(this, text, x, y);
    };
    const chart = new CoreChart(place, {height: 260, keep: false, letters: 24}), times = [...Array(61).keys()];
    const core = times.map((t) => 20 + 39 * t / 60), phases = [
        {state: 'open', from_s: 0, to_s: from}, {state: 'closed', from_s: from, to_s: null}];
    chart.show({times, core, low: core, high: core, phases, target: 60});
    await new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(drawn, 100))));
    CanvasRenderingContext2D.prototype.fillText = across;
    const { svgOf } = await import('./static/svg.js');
    place.insertAdjacentHTML('beforeend', svgOf(chart.chart, 5));
    const kept = Object.fromEntries([...place.querySelectorAll('svg text')].map((one) => {
        const {x, y, width, height} = one.getBBox();
        return [one.textContent, {left: x, right: x + width, top: y, bottom: y + height}];
    }));
    chart.close();
    place.remove();
    return [words, kept];
}"""
"""Where each word of a chart and of its SVG stands, drawn with the letters of the wall at 768 px."""


@pytest.mark.parametrize("closed_s", [0, 20, 35, 45])
def test_no_phases_name_touches_that_of_the_target(served, closed_s):
    server, _, page = served
    page.goto(server.url)
    expect(page.locator("main .card").first).to_be_visible()
    for words in page.evaluate(DRAWN, closed_s):
        target, phase = words["Target 60 °C"], words["closed"]
        beside = target["left"] >= phase["right"] or target["right"] <= phase["left"]
        assert beside or target["top"] >= phase["bottom"] or target["bottom"] <= phase["top"]


def test_every_tab_can_be_read_at_any_width(served, browser):
    server, feed, _ = served
    feed.store.register_press("north press", CHANNELS)
    page = browser.new_page(locale="de-DE")  # the longest words
    cut = """[...document.querySelectorAll('.tabs a, .tools > *')].filter((e) => {
        const at = e.getBoundingClientRect(), row = e.parentElement.getBoundingClientRect();
        const beyond = at.right > Math.min(row.right, innerWidth) + 1 || at.bottom > row.bottom + 1;
        return e.checkVisibility() && beyond;
    }).map((e) => e.textContent)"""
    page.goto(server.url + "#/now")
    for link in ("live", "keine Verbindung"):  # the bar's shortest and longest words
        if link != "live":
            page.route("**/api/v1/live*", lambda route: route.abort())
            page.reload()
        expect(page.locator("#link")).to_have_text(link)
        for width in (768, 1280, 1440, 1610, 1920):
            page.set_viewport_size({"width": width, "height": 600})
            assert page.evaluate(cut) == [], (link, width)
            assert page.evaluate("document.documentElement.scrollWidth") <= width, (link, width)
    page.close()


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (768, 1024), (375, 812)])
def test_the_wall_fills_the_screen_and_does_not_scroll(pressing, browser, width, height):
    server, _ = pressing
    page = browser.new_page(viewport={"width": width, "height": height}, locale="de-DE")
    page.goto(server.url + "#/wall")
    expect(page.get_by_test_id("answer")).to_have_text("öffnen in 11 s (8 bis 15)")
    expect(page.locator(".chart canvas")).to_be_visible()
    size = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    page.wait_for_function(f"{size}.join() === '{width},{height}'")
    foot = "document.querySelector('.chart .uplot').getBoundingClientRect().bottom"  # with its axis
    page.wait_for_function(f"{foot} <= {height}")
    letters = page.get_by_test_id("core").evaluate("e => parseFloat(getComputedStyle(e).fontSize)")
    assert letters >= 0.15 * min(width, height)
    page.close()


WRITTEN = """
const {fillText: written} = CanvasRenderingContext2D.prototype;
window.letters = [];
CanvasRenderingContext2D.prototype.fillText = function (words, ...at) {
    window.letters.push(parseFloat(this.font.match(/([\\d.]+)px/)[1]) / devicePixelRatio);
    return written.call(this, words, ...at);
};
"""


@pytest.mark.parametrize(("width", "height", "least"), [(1920, 1080, 22.0), (768, 1024, 16.0), (375, 812, 11.0)])
def test_the_letters_of_the_walls_chart_grow_with_the_screen(pressing, browser, tmp_path, width, height, least):
    server, _ = pressing
    page = browser.new_page(viewport={"width": width, "height": height}, locale="de-DE", bypass_csp=True)
    page.add_init_script(WRITTEN)
    page.goto(server.url + "#/wall")
    page.wait_for_function("window.letters.length > 20")
    page.screenshot(path=tmp_path / "wall.png")
    smallest = page.evaluate("Math.min(...window.letters)")
    page.close()
    assert smallest >= least


def test_a_number_of_three_digits_fits_at_the_right_end_of_the_walls_chart(pressing, browser):
    server, _ = pressing
    page = browser.new_page(viewport={"width": 1920, "height": 1080}, bypass_csp=True)
    page.add_init_script(WRITTEN)
    page.goto(server.url + "#/wall")
    page.wait_for_function("window.letters.length > 20")
    right, room = "getBoundingClientRect().right", "document.querySelector('.chart canvas')"
    room = page.evaluate(f"{room}.{right} - document.querySelector('.chart .u-over').{right}")
    letters = page.evaluate("Math.max(...window.letters)")
    page.close()
    assert room >= 1.5 * 0.55 * letters  # half of it; a digit is some 0.55 of its size wide


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1280, 860), (1024, 768), (768, 1024), (375, 812)])
def test_nothing_on_the_wall_covers_the_cores_unit(pressing, served, browser, width, height):
    server, _ = pressing
    store = served[1].store
    append = store.append_estimates
    store.append_estimates = lambda press, estimates: append(
        press, [replace(e, core_celsius=107.3, core_high_celsius=110.0) for e in estimates]
    )
    page = browser.new_page(viewport={"width": width, "height": height}, locale="en-GB")
    page.goto(server.url + "#/wall")
    core = page.get_by_test_id("core")
    expect(core).to_have_text("107.3°C")
    expect(page.get_by_test_id("answer")).to_have_class("answer open_in")
    page.wait_for_function("""() => {
        const core = document.querySelector('[data-testid=core]'), letters = document.createRange();
        letters.selectNodeContents(core);
        const [end, place] = [letters.getBoundingClientRect().right, core.getBoundingClientRect().right];
        return end <= place + 1;
    }""")
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
    drawer = page.locator("details.keep").first
    drawer.locator("summary").click()
    for curve in ("Core, predicted", "Core, forecast if the press stays closed"):  # each with bounds of its own
        expect(drawer.get_by_role("columnheader", name=f"{curve}: lower bound")).to_have_count(1)
    expect(drawer.locator(".newer")).to_contain_text("as of")
    rows = drawer.locator("tbody tr").count()
    drawer.get_by_role("button", name="Show newer").click()
    expect(drawer.locator("tbody tr").nth(rows - 1)).to_be_attached()


@pytest.mark.parametrize(("locale", "says"), [("en-GB", "hold Ctrl"), ("de-DE", "Strg halten")])
def test_who_turns_the_wheel_over_a_chart_is_shown_how_it_zooms_and_who_scrolls_past_is_not(
    served, browser, tmp_path, locale, says
):
    server, feed, _ = served
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    page = browser.new_page(viewport={"width": 1280, "height": 400}, locale=locale)
    page.goto(server.url + "#/now")
    chart = page.locator(".chart").first
    expect(chart.locator("canvas")).to_be_visible()
    hint = chart.locator(".wheel")
    chart.hover()
    page.evaluate("scrollTo(0, 0)")
    page.mouse.move(700, chart.bounding_box()["y"] - 50)  # which leaves the chart
    page.mouse.wheel(0, 120)  # the chart comes below the mouse, which nobody moved
    wait_until(lambda: page.evaluate("scrollY") == 120)
    page.mouse.wheel(0, 20)
    wait_until(lambda: page.evaluate("scrollY") == 140)
    assert hint.is_hidden()
    chart.hover()
    page.mouse.wheel(0, 10)
    expect(hint).to_be_visible()
    expect(hint).to_contain_text(says)
    page.screenshot(path=tmp_path / "hint.png")
    page.keyboard.down("Control")
    page.mouse.wheel(0, -120)
    expect(hint).to_be_hidden()
    expect(chart.locator(".follow")).to_be_visible()
    page.close()


def test_a_part_of_the_chart_stays_in_view_while_the_next_pressing_comes(served):
    server, feed, page = served
    feed.pause_s = 0.0
    feed.pressing(scans=60, batch=10)
    page.goto(server.url + "#/now")
    title = page.locator("h2", has_text="pressing lab-")
    expect(title).to_have_text("Last pressing lab-0000000")
    chart = page.locator(".chart").first
    chart.focus()
    page.keyboard.press("+")
    feed.pressing(scans=60, batch=10)
    expect(page.locator(".facts a")).to_have_text("lab-0000060")
    with page.expect_response("**/api/v1/press?*"):
        pass
    expect(title).to_have_text("Last pressing lab-0000000")
    follow = chart.get_by_role("button", name="Follow")
    expect(follow).to_be_visible()
    follow.click()
    expect(title).to_have_text("Last pressing lab-0000060")


@pytest.mark.parametrize("width", [375, 1280])
def test_a_charts_tip_holds_the_band_also_of_what_is_foreseen_and_stays_within_its_chart(pressing, browser, width):
    server, _ = pressing
    page = browser.new_page(viewport={"width": width, "height": 812}, locale="de-DE")  # the longest words
    page.goto(server.url + "#/now")
    chart = page.locator(".chart").first
    expect(chart.locator("canvas")).to_be_visible()
    over, tip = chart.locator(".u-over"), chart.locator(".chart-tip")

    def foreseen():
        box = over.bounding_box()
        over.hover(position={"x": box["width"] - 10, "y": 60})
        return tip.inner_text() if tip.is_visible() else ""

    wait_until(lambda: re.search(r"Vorhersage[^(]*\d,\d °C \(\d+,\d … \d+,\d\)", foreseen()))
    outside = """(tip) => {
        const own = tip.getBoundingClientRect(), all = tip.parentElement.getBoundingClientRect();
        return [Math.min(own.left - all.left, 0), Math.max(own.right - all.right, 0)];
    }"""
    assert tip.evaluate(outside) == [0, 0]
    page.close()


def test_machines_are_given_the_advice_the_page_shows(pressing):
    server, page = pressing
    page.goto(server.url + "#/now")
    asked = "fetch('api/v1/advice').then((answer) => answer.json()).then((told) => told.items[0])"
    counted = "it.press === 'lab' && it.advice.verdict === 'open_in' && it.advice.open_latest_s > 10"  # from now
    item = comes(page, asked, f"(it) => {counted}")
    assert item["advice"]["open_latest_s"] <= 15.0


@pytest.fixture
def idle(served):
    """A press without a panel whose recorder works; what its live sensor says of itself is put into the answer."""
    server, feed, page = served
    beats = {process: {"state": "running", "presses": []} for process in ("record", "sense")}
    feed.store.append_estimates, feed.shares = (lambda *_: None), (2.0, 3.0, 4.0)
    over = threading.Event()

    def beat():
        while not over.wait(0.5):
            for process, status in beats.items():
                feed.store.beat(process, status)

    threads = [threading.Thread(target=beat), threading.Thread(target=feed.pressing, args=(60_000,))]
    for thread in threads:
        thread.start()
    yield server, page, beats
    feed.stop.set()
    over.set()
    for thread in threads:
        thread.join(240)


@pytest.mark.parametrize("view", ["#/wall", "#/presses"])
def test_not_all_is_well_while_the_live_sensor_only_starts(idle, view):
    server, page, beats = idle
    beats["sense"] = {"state": "starting", "presses": []}
    page.goto(server.url + "#/now")
    starts = "the live sensor is starting; the first time this takes about a minute"
    expect(page.locator("#alarms")).to_have_text(starts)
    expect(page.locator("#alarms")).to_have_class("alarms calm")  # takes its time, and is no alarm
    page.goto(server.url + view)
    light = page.locator(".light")
    expect(light).to_have_text(starts)
    expect(light).to_have_class("light idle")
    beats["sense"] = {"state": "running", "presses": []}
    expect(light).to_have_text("all well")
    expect(page.locator("#alarms")).to_be_empty()


def test_an_alarm_of_one_press_is_not_shown_as_anothers(idle, served):
    server, page, beats = idle
    store = served[1].store
    store.register_press("north", CHANNELS, LAB.read_text(encoding="utf-8"))
    beats["sense"] = {"state": "running", "presses": [{"press": "north", "behind_scans": 9000}]}
    page.goto(server.url + "#/presses")
    expect(page.locator("#alarms")).to_contain_text("north")
    page.goto(server.url + "#/wall/lab")
    light = page.get_by_test_id("health")
    expect(light).to_have_text("all well")
    page.goto(server.url + "#/presses")
    tile = page.locator(".press-tile", has_text="lab").locator(".light")
    expect(tile).to_have_text("all well")
    beats["record"] = {
        **beats["record"],
        "problem_codes": [{"code": "health-nightly-job-overdue", "arguments": {"hours": 60.0}}],
    }
    expect(tile).to_have_text("degraded")  # it is of all presses; above the tiles it stands in full
    expect(tile).to_have_class("light bad")
    page.goto(server.url + "#/wall/lab")
    expect(light).to_contain_text("nightly job")
