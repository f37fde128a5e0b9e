"""Silence is put into words once, and alarms leave room for what they are about."""

from __future__ import annotations

import math
import re
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from playwright.sync_api import expect

from api.http.tokens import TokenFile
from daq.records import PressEvent, PressEventKind
from daq.store.records import NewRun, StoredEstimate, in_status
from daq.words import say
from tests.browser.conftest import CHANNELS, LAB, NOTIFICATIONS
from tests.patience import wait_until

TOLD = re.compile(r"(?:no|new) (?:new )?reading|no scan|silent|sign of life", re.IGNORECASE)
"""A sentence that says of a silence that it is one."""
CAUSE = "No sign of life of record; if it is not running, start kerntemp record"
OTHER = "an alarm about something else"
"""It stays on the bar whatever a view says itself."""


LINES_OF_ITS_TIME = """({ firstChild: words }) => {
    const range = document.createRange();
    range.setStart(words, words.data.lastIndexOf('·') + 2);
    range.setEnd(words, words.length);
    return new Set([...range.getClientRects()].map(({ top }) => Math.round(top))).size;
}"""


@pytest.fixture
def falling_silent(served):
    """A pressing on a watched press; what ends it, and what the signs of life then say is broken, if any come."""
    server, feed, page = served
    feed.shares = (0.0, 0.001, 0.999)
    feed.detail = {"energy_kJ_m2": 480.0}
    feed.store.log("alarm", "import", say("plain-text", text=OTHER))
    feed.store.put_alarm_thresholds("lab", {"silence_s": 5.0}, "foreman")
    over, dead, wrong = threading.Event(), set(), []

    def beat():
        while not over.wait(0.5):
            for process in {"record", "sense"} - dead:
                problems = in_status(wrong if process == "record" else [], say("scans-recorded", count=1))
                feed.store.beat(process, {"state": "running", "presses": [{"press": "lab"}], **problems})

    threads = [threading.Thread(target=beat), threading.Thread(target=feed.pressing, args=(60_000,))]
    for thread in threads:
        thread.start()

    def end(broken=()):
        wrong.extend(broken)
        dead.update(() if broken else ("record",))
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
    expect(page.locator(".facts")).to_contain_text("480 kJ/m²")
    expect(page.get_by_role("heading", name="Running pressing")).to_be_visible()
    end()
    banner, bar = page.locator(".banner"), page.locator("#alarms")
    expect(banner).to_have_text(re.compile(r"^No new reading since .*\(\d.* ago\)\. " + CAUSE + "$"))
    expect(page.get_by_test_id("answer")).to_have_text("not known")
    expect(bar).to_have_text(f"⚠ {OTHER}")
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")  # as it was then
    expect(page.get_by_test_id("band")).to_contain_text("as of")
    expect(page.get_by_role("heading", name="Last pressing")).to_be_visible()  # whether it still runs nobody knows
    expect(page.locator("main")).to_contain_text(re.compile(r"Channels\s*as of \d"))
    expect(page.locator(".facts")).not_to_contain_text("kJ/m²")  # nothing is foreseen from old readings
    room, facts = (page.locator(f".hero {part}").bounding_box() for part in (".beside", ".facts"))
    assert room == pytest.approx(facts, abs=1)  # the sketch that is not shown leaves no hole
    page.reload()  # and is so for who comes later
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    expect(page.get_by_test_id("band")).to_have_text(re.compile(r"^48\.0 … 52\.0\W°C · 95\W% band · as\Wof\W\d"))
    expect(banner).to_contain_text(CAUSE)
    assert page.get_by_test_id("band").evaluate(LINES_OF_ITS_TIME) == 1
    page.screenshot(path=tmp_path / "now.png", full_page=True)
    said = banner.inner_text().removesuffix(CAUSE)
    assert len(TOLD.findall(page.locator("body").inner_text())) == len(TOLD.findall(said)) + 1
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.goto(server.url + "#/runs")  # where nothing else says it
    expect(bar).to_contain_text("lab: no scan for more than 5 s")
    expect(bar).to_contain_text("record: silent for")
    page.goto(server.url + "#/alarms")
    expect(page.get_by_test_id("alarms").get_by_role("row", name="lab: no scan")).to_contain_text("stands")


def test_a_tile_and_the_wall_put_silence_into_words_once(falling_silent, browser, tmp_path):
    server, page, end = falling_silent
    page.goto(server.url + "#/presses")
    tile = page.locator(".press-tile")
    expect(tile.locator(".core")).to_have_text("50.0°C")
    wall = browser.new_page()
    wall.goto(server.url + "#/wall")
    expect(wall.get_by_test_id("core")).to_have_text("50.0°C")
    end()
    expect(tile).to_contain_text("not known, because no reading for")
    expect(tile.locator(".light")).to_have_class("light bad")
    expect(page.locator("#alarms")).to_have_text(re.compile(f"^⚠ {OTHER}⚠ record: silent for [^⚠]*$"))
    page.screenshot(path=tmp_path / "presses.png")
    assert len(TOLD.findall(tile.inner_text())) == 1
    page.goto(server.url + "#/wall")  # which never saw a core that it could keep
    for one in (page, wall):
        expect(one.get_by_test_id("answer")).to_contain_text("not known, because no reading for")
        expect(one.get_by_test_id("health")).to_have_text(CAUSE)
        expect(one.get_by_test_id("core")).to_have_text("50.0°C")
        expect(one.get_by_test_id("band")).to_contain_text("as of")
    wall.screenshot(path=tmp_path / "wall.png")
    server.end()  # from here on nobody knows
    expect(wall.get_by_test_id("health")).to_have_text("no readings")
    server.start()
    wall.close()


def test_a_silence_says_which_logger_is_broken_where_the_recorder_lives(falling_silent, tmp_path):
    server, page, end = falling_silent
    lost = say("logger-no-reply", place="10.0.0.9", timeout_s=2.0)
    broken = [say("logger-problem", press="lab", logger=name, why=lost) for name in ("presses", "platens")]
    words = [
        f"lab: logger {name}: 10.0.0.9: no reply in 2 s; check power, cable and address"
        for name in ("presses", "platens")
    ]
    page.goto(server.url + "#/wall")
    light = page.get_by_test_id("health")
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    end(broken)
    expect(page.get_by_test_id("answer")).to_contain_text("not known, because no reading for")
    expect(light).to_have_text(words[0])
    page.screenshot(path=tmp_path / "wall.png")
    light.get_by_role("link").click()
    expect(page.get_by_test_id("alarms")).to_contain_text(words[0])
    page.goto(server.url + "#/now")
    expect(page.locator(".banner")).to_contain_text(f" ago). {words[0]}")
    expect(page.locator("#alarms")).to_have_text(f"⚠ {OTHER}⚠ {words[1]}")  # what nothing else says


def test_behind_a_lost_link_the_bar_keeps_what_the_banner_does_not_say(falling_silent):
    server, page, end = falling_silent
    page.route("**/api/v1/live*", lambda route: route.abort())
    page.goto(server.url + "#/now")
    expect(page.locator("#link")).to_have_class("link lost")
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    end()
    bar = page.locator("#alarms")
    expect(bar).to_contain_text("record: silent for")
    expect(page.locator(".banner")).to_have_text(re.compile(r"^No new reading since .* ago\)$"))
    expect(bar).to_contain_text("record: silent for")  # also beside the banner
    expect(bar).not_to_contain_text("lab: no scan")


KEPT = """async (answers) => {
    const { LastCore } = await import('./static/views/answer.js');
    const kept = new LastCore();
    return answers.map(([now, stale]) => kept.of(now, stale)).map(({ estimate, old }) => [estimate.core_C, old]);
}"""
SEEN = {"state": "closed", "estimate": {"valid": True, "core_C": 31.0, "utc": "07:00"}, "last_core": None}
NO_SCANS = {"state": "unknown", "estimate": {"valid": False, "reason": "no scans", "core_C": None}}


def test_of_a_silence_the_server_knows_of_its_core_counts_and_what_the_tab_saw_bridges_a_lost_link(served):
    server, _, page = served
    page.goto(server.url)
    later = NO_SCANS | {"last_core": {"core_C": 52.0, "utc": "08:00"}}
    asked = [(SEEN, False), (SEEN, True), (later, True), (later, True), (NO_SCANS | {"last_core": None}, True)]
    seen, newer, none = [31.0, "07:00"], [52.0, "08:00"], [None, None]
    assert page.evaluate(KEPT, asked) == [[31.0, None], seen, newer, newer, none]


TAKEN = """async ([now, data]) => {
    const { LastCore, courseOf, take } = await import('./static/views/answer.js');
    const kept = new LastCore();
    kept.of(now, false);
    const good = { ...data, valid: true };
    const ahead = { ...good, course: [[2, 9]], time_s: 3 };
    const estimates = [data, { ...data, reason: 'live sensor silent' }, good, ahead];
    const courses = estimates.map((one) => courseOf(one, 'before'));
    return [take(now, data), now.state, kept.of(now, true).estimate.core_C, courses];
}"""
SHOWN = {"phases": [], "run": "a", "silent_after_s": 5.0} | SEEN


def test_the_stream_takes_no_late_estimate_for_one_of_now_and_a_silence_keeps_core_and_no_forecast(served):
    server, _, page = served
    page.goto(server.url)
    late = {"valid": False, "state": "idle", "age_s": 6.0, "run": "a", "reason": "no panel", "course": None}
    courses = [None, None, "before", [[5, 9]]]
    assert page.evaluate(TAKEN, [SHOWN, late]) == [False, "closed", 31.0, courses]
    silence = late | {"reason": "no scans", "state": "unknown"}
    assert page.evaluate(TAKEN, [SHOWN, silence]) == [True, "unknown", 31.0, courses]


HEARD = """() => {
    window.shown = new Set();
    const look = () => shown.add(document.querySelector('[data-testid=state]').textContent);
    const all = { subtree: true, childList: true, characterData: true };
    new MutationObserver(look).observe(document.querySelector('main'), all);
    window.heard = 0;
    const stream = new EventSource('./api/v1/live');
    stream.addEventListener('estimate', () => { heard += 1; });
    return new Promise((opened) => { stream.onopen = () => opened(true); });
}"""


@pytest.mark.parametrize("view", ["now", "wall"])
def test_a_live_sensor_that_catches_up_changes_nothing_of_now(served, view):
    """After a stop it writes what it should have said of a press that was empty then."""
    server, feed, page = served
    before = [replace(feed._scan(0.0, i), utc=datetime.now(UTC) - timedelta(seconds=20)) for i in range(3)]
    feed.store.append_scans(feed.key, before)
    inside = [feed._scan(0.0, i) for i in range(3, 6)]
    at = inside[0].monotonic_s
    events = [PressEvent(kind, at, at) for kind in (PressEventKind.INSERTED, PressEventKind.CLOSED)]
    feed.store.append_scans(feed.key, inside, events, NewRun("lab-1", inside[0].number, inside[0].utc, at, {}))
    page.goto(f"{server.url}#/{view}")
    expect(page.get_by_test_id("state")).to_have_text("closed")
    page.evaluate(HEARD)
    newest = feed._scan(0.0, 6)
    feed.store.append_scans(feed.key, [newest])
    none = (math.nan,) * 4
    late = [StoredEstimate(one.number, one.monotonic_s, "idle", *none, False, "no panel") for one in before]
    feed.store.append_estimates("lab", late)
    wait_until(lambda: page.evaluate("heard") == 3)
    now = StoredEstimate(newest.number, newest.monotonic_s, "closed", 50.0, 1.0, 48.0, 52.0, True)
    feed.store.append_estimates("lab", [now])
    expect(page.get_by_test_id("core")).to_have_text("50.0°C")
    assert page.evaluate("[...shown]") == ["closed"]


LOGGER = say("logger-problem", press="lab", logger="platens", why="off")
STORE = say("store-trouble", why="off", count=3)
FAILED = say("thread-failed", thread="logger platens", why="off")
BESIDE = [
    say("pages-stalled", store="kerntemp.sqlite"),
    say("configuration-stalled", file="kerntemp.toml"),
    say("thread-stalled", thread="thinning", seconds=60.0),
    say("of-press", press="east", what=FAILED),
    say("of-press", press="lab", what="off"),
    say("problem-of-press", press="lab", what="off"),
    say("logger-problem", press="east", logger="faces", why="off"),
    say("scans-not-written", count=3),
    say("scans-lost", count=3),
]
"""They stop no reading of this press."""
DEAD = say("health-process-silent", process="record@old", seconds=60.0, command="record")
ABOUT = """async ([alarms_said, processes]) => {
    const { isAbout } = await import('./static/silence.js');
    const health = { alarms_said, processes };
    return alarms_said.filter((one) => isAbout(one, health, 'lab', 'live')).map(({ code }) => code);
}"""


@pytest.mark.parametrize(
    ("problems", "cause"),
    [
        ([*BESIDE, STORE, LOGGER], "logger-problem"),
        ([*BESIDE, STORE, say("of-press", press="lab", what=FAILED)], "of-press"),
        ([*BESIDE, STORE], "store-trouble"),
        ([*BESIDE, say("thread-failed", thread="writer", why="off")], "thread-failed"),
        ([*BESIDE, say("writer-stalled", seconds=60.0)], "writer-stalled"),
        (BESIDE, "health-process-silent"),
    ],
)
def test_the_cause_of_a_silence_is_what_stops_its_readings(served, problems, cause):
    """A recorder of a former machine, which still names the press, is one where none that lives knows better."""
    server, _, page = served
    page.goto(server.url)
    of_lab, codes = [{"press": "lab"}], [one.to_json() for one in problems]
    processes = [
        {"name": "record@old", "alive": False, "details": {"presses": of_lab}},
        {"name": "record@new", "alive": True, "details": {"presses": of_lab, "problem_codes": codes}},
    ]
    assert page.evaluate(ABOUT, [[DEAD.to_json(), *codes], processes]) == [cause]


@pytest.fixture
def silent(served):
    """A press of which nothing was read since yesterday."""
    server, feed, page = served
    feed.store.put_alarm_thresholds("lab", {"silence_s": 5.0}, "foreman")
    yesterday = datetime.now(UTC) - timedelta(days=1)
    feed.store.append_scans(feed.key, [replace(feed._scan(0.0, 0), utc=yesterday)])
    return server, feed, page


@pytest.mark.parametrize("view", ["presses", "now"])
def test_a_view_that_was_left_before_its_answer_came_hides_no_alarm(silent, view):
    server, _, page = silent
    page.goto(server.url + "#/runs")
    bar, limit = page.locator("#alarms"), "lab: no scan for more than 5"
    expect(bar).to_contain_text(limit)
    held = []
    asked = re.compile(r"/api/v1/press(\?.*)?$")
    page.route(asked, lambda route: held.append(route))
    with page.expect_request(asked):
        page.evaluate(f"location.hash = '#/{view}'")
    page.evaluate("location.hash = '#/runs'")
    expect(page.locator("main .card").first).to_be_visible()
    with page.expect_response(asked):
        held[0].continue_()
    page.evaluate(FRAMES)
    assert limit in bar.inner_text()


FRAMES = "new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))"


def test_what_is_of_another_day_says_of_which(silent):
    server, _, page = silent
    page.goto(server.url + "#/now")
    expect(page.locator(".as-of")).to_have_text(re.compile(r"^as of \d+/\d+/\d+, \d"))
    says = "async (utc) => (await import('./static/dom.js')).asOf(utc)"
    today = page.evaluate("new Date().toISOString()")
    assert re.fullmatch(r"as of \d+:\d+:\d+.*", page.evaluate(says, today))


def test_a_light_is_not_good_while_a_limit_of_silence_is_crossed(served):
    server, feed, page = served
    feed.store.put_alarm_thresholds("lab", {"silence_s": 2.0}, "foreman")
    feed.pause_s = 3.5  # shorter than what the page calls silence
    slow = threading.Thread(target=feed.pressing, args=(60_000,))
    slow.start()
    page.goto(server.url + "#/wall")
    light = page.get_by_test_id("health")
    expect(light).to_have_text("lab: no scan for more than 2 s")
    expect(light).to_have_class("light bad")
    feed.stop.set()
    slow.join(240)


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
    more = bar.get_by_role("link", name="27 weitere Alarme")
    expect(more).to_be_visible()
    page.screenshot(path=tmp_path / "presses.png")
    assert bar.bounding_box()["height"] <= height / 4
    if width >= 1280:
        page.wait_for_function("document.querySelector('.presses').getBoundingClientRect().bottom <= innerHeight")
    bar.get_by_role("link").first.click()  # a line that is cut off on a small screen leads to the whole of it, too
    expect(page.get_by_test_id("alarms").get_by_text("Messzeilen im Rückstand")).to_have_count(30)
    page.close()
    over.set()
    heart.join()


def test_the_alarms_of_the_press_looked_at_come_first(served):
    server, feed, page = served
    names = ["lab", "east", "north", "west"]
    for name in names[1:]:
        feed.store.register_press(name, CHANNELS)
    yesterday = datetime.now(UTC) - timedelta(days=1)
    for name in names:
        feed.store.put_alarm_thresholds(name, {"silence_s": 5.0}, "foreman")
    for key in (feed.key, *(feed.store.register_press(name, CHANNELS) for name in names[1:])):
        feed.store.append_scans(key, [replace(feed._scan(0.0, 0), number=0, utc=yesterday)])
    first = page.locator("#alarms p").first
    for name in ("west", "lab"):
        page.goto(server.url + f"#/runs?press={name}")
        expect(first).to_have_text(f"⚠ {name}: no scan for more than 5 s")


ANNOUNCED = (
    NOTIFICATIONS
    + """
window.tones = 0;
window.OscillatorNode = class extends window.OscillatorNode {
  start(...at) { window.tones += 1; return super.start(...at); }
};
for (const way of ["sound", "notification"]) localStorage.setItem(`kerntemp-alarm-${way}`, "on");
"""
)


def test_of_two_tabs_one_gives_the_sound_and_the_notification_and_both_show_who_took_the_alarm_on(served, browser):
    server, feed, _ = served
    token = TokenFile(server.config.parent / "kerntemp-tokens.json").create("foreman", "write")
    context = browser.new_context(locale="en-GB")
    context.add_init_script(ANNOUNCED + f"sessionStorage.setItem('kerntemp-token', {token!r});")
    tabs = [context.new_page() for _ in range(2)]
    context.clock.install()
    tabs[1].route("**/alarms/thresholds*", lambda _: None)  # not answered as long as this lasts
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
    lists = re.compile(r"/alarms\?limit=100")
    tabs[0].route(lists, lambda route: route.abort())
    tabs[0].get_by_role("button", name="Acknowledge").click()
    expect(tabs[1].get_by_test_id("alarms")).to_contain_text("by foreman")
    tabs[0].unroute(lists)
    context.clock.run_for(4000)  # the next look shows what could not be loaded, though the button has the focus
    expect(tabs[0].get_by_test_id("alarms")).to_contain_text("by foreman")
    assert [one for tab in tabs for one in tab.evaluate("window.notified")].count("closed") == 1
    context.close()


REFUSED = "indexedDB.open = () => { throw new DOMException('not here', 'SecurityError'); };"
LOST = """async () => {
    for (const { name } of await indexedDB.databases()) {
        const gone = indexedDB.deleteDatabase(name);
        await new Promise((resolve, reject) => { gone.onsuccess = resolve; gone.onerror = reject; });
    }
}"""
LISTEN = "async () => (await import('./static/bell.js')).listen()"


@pytest.mark.parametrize("database", ["refused", "lost", "cleared", "full"])
def test_an_alarm_is_announced_once_also_without_the_browsers_database(served, browser, database):
    server, feed, _ = served
    context = browser.new_context(locale="en-GB")
    context.add_init_script(ANNOUNCED + (REFUSED if database == "refused" else ""))
    tab = context.new_page()
    tab.goto(server.url + "#/alarms")
    expect(tab.get_by_test_id("alarms")).to_contain_text("No alarm yet.")
    assert tab.evaluate("async () => (await import('./static/bell.js')).want('notification', true)")
    devtools, origin = context.new_cdp_session(tab), server.url.rstrip("/")
    if database == "lost":
        tab.evaluate(LOST)
    elif database == "cleared":
        devtools.send("Storage.clearDataForOrigin", {"origin": origin, "storageTypes": "indexeddb"})
    elif database == "full":
        devtools.send("Storage.overrideQuotaForOrigin", {"origin": origin, "quotaSize": 1})
    for number in (1, 2):
        feed.store.log("alarm", "record", say("store-trouble", why="nobody knows", count=number), "lab")
        expect(tab.get_by_test_id("alarms").get_by_role("row", name="nobody knows")).to_have_count(number)
        for _ in range(2):
            tab.evaluate(LISTEN)
        assert sum("nobody knows" in one for one in tab.evaluate("window.notified")) == number
    for one in feed.store.alarms().items:
        feed.store.acknowledge_alarm(one.number, "foreman")  # by another browser
    tab.evaluate(LISTEN)
    notified = tab.evaluate("window.notified")
    assert notified.count("closed") == len(notified) / 2
    context.close()


def test_a_browser_that_kept_the_newest_alarms_number_announces_what_came_since(served, browser):
    server, feed, before = served
    before.goto(server.url + "#/alarms")
    expect(before.get_by_test_id("alarms")).to_contain_text("No alarm yet.")
    feed.store.log("alarm", "record", say("store-trouble", why="nobody knows", count=1), "lab")
    expect(before.get_by_test_id("alarms").get_by_role("row", name="nobody knows")).to_have_count(1)
    context = browser.new_context(locale="en-GB")
    context.add_init_script(ANNOUNCED + "localStorage.setItem('kerntemp-alarm-newest', '0');")
    tab = context.new_page()
    tab.goto(server.url + "#/alarms")
    expect(tab.get_by_test_id("alarms")).to_contain_text("nobody knows")
    for _ in range(2):
        tab.evaluate(LISTEN)
    assert sum("nobody knows" in one for one in tab.evaluate("window.notified")) == 1
    assert tab.evaluate("localStorage.getItem('kerntemp-alarm-newest')") is None
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
