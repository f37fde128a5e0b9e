"""Every word the page looks up is in every catalogue: what it names, and what it makes of a value."""

import re
from pathlib import Path

import pytest

from daq.drivers.protocol import Cause
from daq.press.header import VERDICTS
from daq.records import PressState, Quality
from daq.store.records import RunStatus
from daq.words.message import catalogue_of, languages
from softsensor.diagnosis.decision import Verdict
from softsensor.effects import BUILT_IN
from softsensor.live.validity import InvalidReason

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "api" / "page"
SOURCES = {
    file: file.read_text(encoding="utf-8")
    for file in (*PAGE.rglob("*.js"), PAGE / "index.html")
    if "vendor" not in file.parts
}


def causes():
    """Every cause that is given a lost reading, beside a driver that broke."""
    return sorted([*Cause, "driver fault"])


def looked_up():
    """Every code the page names in full, with where it does."""
    for file, source in SOURCES.items():
        for code in re.findall(r"[\"'`>](page-[a-z0-9_-]*[a-z0-9])[\"'`<]", source):
            yield code, file.name


def values():
    """Every code that the page puts together from a value the server sends."""
    yield from (f"page-quality-{quality}" for quality in Quality)
    yield from (f"cause-{cause.replace(' ', '-')}" for cause in causes())
    yield from (f"page-state-{state}" for state in (*PressState, "unknown"))
    yield from (f"page-run-{status}" for status in RunStatus)
    yield from (f"effect-{effect.name}-called" for effect in BUILT_IN)
    yield from (f"diagnosis-verdict-{verdict}" for verdict in Verdict)
    yield from (f"page-panel-{verdict}" for verdict in VERDICTS)
    yield from (f"page-level-{level}" for level in ("warning", "alarm"))
    yield from (f"page-health-{status}" for status in ("ok", "degraded", "down"))
    yield from (f"page-drift-{chart}" for chart in ("jump", "creep"))
    yield from (f"reason-{reason.value.replace(' ', '-')}" for reason in InvalidReason)


def test_the_sources_are_searched_and_the_causes_are_known():
    assert {"silent", "crc", "wrong id", "connection refused", "driver fault", "closed"} <= set(causes())
    assert len(dict(looked_up())) > 150


@pytest.mark.parametrize("language", languages())
def test_every_word_the_page_looks_up_is_there(language):
    known = catalogue_of(language).entries()
    assert not [(code, where) for code, where in looked_up() if code not in known]
    assert not [code for code in values() if code not in known]


@pytest.mark.parametrize("language", languages())
def test_what_the_page_puts_into_its_words_has_its_place_there(language):
    """`text("code", { name: ... })`: each name stands in the pattern, and the pattern wants no other."""
    known = catalogue_of(language).entries()
    wrong = []
    for file, source in SOURCES.items():
        for code, given in re.findall(r"text\(\"(page-[\w-]+)\"(?:, \{ ([^}]*) \})?\)", source):
            names = set(re.findall(r"(?:^|, )(\w+)(?=[:,]|$)", given))
            wanted = set(re.findall(r"\$(\w+)", known[code]))
            if names != wanted:
                wrong.append((file.name, code, names, wanted))
    assert not wrong


def test_no_line_of_the_page_holds_words_of_its_own():
    """But the name; a ``{page-code}`` is put into every language, for a reader whose words did not come."""
    shell = (PAGE / "index.html").read_text("utf-8")
    body = re.sub(r"<(script).*?</\1>|\{page-[a-z-]+\}", "", shell, flags=re.DOTALL)
    texts = [t.strip() for t in re.findall(r">([^<>]+)<", body) if re.search(r"[a-zA-Z]{3}", t)]
    assert texts == ["Kerntemp", "Skip to content", "Kerntemp", "/docs"]
