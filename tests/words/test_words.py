"""All codes in all languages: whatever the code says has its words, and the words fit its arguments."""

import ast
import errno
import json
import os
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from fluent.syntax import FluentParser
from fluent.syntax import ast as fluent

from api.cli import app
from api.commands.calling import PLACEHOLDER
from daq.tables import SYSTEM_FAULTS, reason_of
from daq.words import Message, say, spoken
from daq.words.message import catalogue_of, languages, words
from softsensor.diagnosis.decision import Verdict
from softsensor.jobs.night_basis import NOT_ASKED

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("daq", "softsensor", "api")
SETUP = ROOT / "deploy/kerntemp_setup.py"
"""It says its own with `words`, since it runs where nothing is installed; the catalogues are the same."""


def messages_in_the_code():
    """Every `say("code", name=...)` as (file:line, code, argument names, whether more come by `**`)."""
    for file in (*(f for package in PACKAGES for f in sorted((ROOT / package).rglob("*.py"))), SETUP):
        text = file.read_text(encoding="utf-8")
        says = "words" if file == SETUP else "say"
        if says == "say" and not re.search(
            r"^\s*from daq\.words(\.message)? import .*\bsay\b", text, re.MULTILINE
        ):
            continue
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.Call) or getattr(node.func, "id", "") != says:
                continue
            if node.args and isinstance(node.args[0], ast.Constant):
                names = {keyword.arg for keyword in node.keywords if keyword.arg}
                more = any(keyword.arg is None for keyword in node.keywords)
                yield f"{file.relative_to(ROOT)}:{node.lineno}", node.args[0].value, names, more


def patterns(language):
    """Every message of a catalogue by its code."""
    body = FluentParser().parse(catalogue_of(language).text).body
    assert not [entry.content for entry in body if isinstance(entry, fluent.Junk)]
    found = [entry for entry in body if isinstance(entry, fluent.Message)]
    codes = [entry.id.name for entry in found]
    assert len(codes) == len(set(codes)), (
        f"twice in {language}: {sorted({c for c in codes if codes.count(c) > 1})}"
    )
    return {entry.id.name: entry for entry in found}


def variables(node):
    """Every `$name` below a node of a pattern."""
    if isinstance(node, fluent.VariableReference):
        return {node.id.name}
    inner = node.__dict__.values() if isinstance(node, fluent.BaseNode) else node if isinstance(node, list) else ()
    return set().union(*(variables(one) for one in inner if isinstance(one, fluent.BaseNode | list)), set())


@pytest.mark.parametrize("language", languages())
def test_every_code_that_is_said_has_words_whose_variables_are_its_arguments(language):
    known = patterns(language)
    wrong = []
    for where, code, names, more in messages_in_the_code():
        if code not in known:
            wrong.append(f"{where}: {code} has no words in {language}")
        elif not more and (lacking := variables(known[code]) - names):
            wrong.append(f"{where}: {code} in {language} wants {sorted(lacking)}")
    assert not wrong, "\n".join(wrong)


def selections(node):
    """Every choice between variants below a node of a pattern."""
    inner = node.__dict__.values() if isinstance(node, fluent.BaseNode) else node
    below = [one for one in inner if isinstance(one, fluent.BaseNode | list)]
    own = [node] if isinstance(node, fluent.SelectExpression) else []
    return own + [found for one in below for found in selections(one)]


@pytest.mark.parametrize("language", languages())
def test_no_sentence_shows_the_code_it_chooses_by(language):
    bare = []
    for code, entry in patterns(language).items():
        for choice in selections(entry):
            (last,) = [v for v in choice.variants if v.default]
            shown = [x.expression for x in last.value.elements if isinstance(x, fluent.Placeable)]
            if len(last.value.elements) == len(shown) == 1 and shown[0].equals(choice.selector):
                bare.append(code)
    assert bare == []


@pytest.mark.parametrize("language", languages())
def test_a_night_has_words_of_its_own_for_every_verdict(language):
    values = {"press": "lab", "fits": "", "model": "none", "version": "", "reason": ""}
    verdicts = (*Verdict, NOT_ASKED, "of a newer version")
    lines = [words(say("night-outcome", **values, verdict=v), language) for v in verdicts]
    assert len(set(lines)) == len(Verdict) + 2
    for verdict, line in zip(Verdict, lines, strict=False):  # the same as on the page and in the reports
        assert words(Message(f"diagnosis-verdict-{verdict}"), language) in line


@pytest.mark.parametrize("language", languages())
def test_each_entry_read_alone_is_what_the_whole_file_says(language):
    """A sentence is read from its own lines; they must be the lines a reader of the whole file gives it."""
    alone = {c: FluentParser().parse_entry(f"{c} = {p}\n") for c, p in catalogue_of(language).entries().items()}
    whole = patterns(language)
    assert alone.keys() == whole.keys()
    assert not [code for code in whole if not alone[code].equals(whole[code], ignored_fields=["span", "comment"])]


@pytest.mark.parametrize("language", languages())
def test_every_command_and_option_has_its_help_in_every_language(language):
    top = typer.main.get_command(app)
    codes = [f"help-command-{name}" for name in ("kerntemp", *top.commands)]
    codes += [str(one.help) for command in (top, *top.commands.values()) for one in command.params]
    assert len(codes) > 80
    assert not set(codes) - set(catalogue_of(language).entries())


@pytest.mark.parametrize("language", languages())
def test_no_help_has_a_number_of_its_own(language):
    """Limits and stand-ins are arguments; examples are part of a word, and port 0 is any free one."""
    helps = {code: text for code, text in catalogue_of(language).entries().items() if code.startswith("help-")}
    alone = {code: re.findall(r"(?<![^\s(])\d[\d.,]*(?=[\s;.)]|$)", text) for code, text in helps.items()}
    assert {code: found for code, found in alone.items() if set(found) - {"0"}} == {}


@pytest.mark.parametrize("language", [one for one in languages() if one != "en"])
def test_a_language_has_the_words_of_all_codes_with_the_same_variables(language):
    english, other = patterns("en"), patterns(language)
    assert sorted(english) == sorted(other)
    assert not [c for c in english if variables(other[c]) - variables(english[c])]


@pytest.mark.parametrize("language", languages())
def test_a_translator_finds_the_same_sections_in_every_language_each_in_alphabetical_order(language):
    def sections(one):
        return [
            re.findall(r"^[\w-]+(?= =)|^## .*", s, re.MULTILINE) for s in catalogue_of(one).text.split("\n\n## ")
        ]

    own = sections(language)
    assert own == sections("en")
    assert [s for s in own if s != sorted(s)] == []


def test_no_words_are_kept_that_nobody_says():
    """A code stands in the sources as a word of its own: said there, or as the value of an enumeration.

    What only begins others (`page-panel-` before a value) is not said by that.
    """
    sources = SETUP.read_text(encoding="utf-8") + "\n".join(
        file.read_text(encoding="utf-8")
        for package in PACKAGES
        for ending in ("*.py", "*.js", "*.html")
        for file in (ROOT / package).rglob(ending)
        if "vendor" not in file.parts
    )
    used = set(re.findall(r"[a-z][a-z0-9_]*(?:-[a-z0-9_]+)+(?!\w|-[{$\"'])", sources))
    prefixes = tuple(sorted(set(re.findall(r"[\"'`]([a-z][a-z0-9_]*(?:-[a-z0-9_]+)*-)(?=[{$\"'])", sources))))
    unused = [c for c in patterns("en") if c not in used and not (prefixes and c.startswith(prefixes))]
    assert not unused, f"in the catalogue, never said: {unused}"


def test_german_sentences_speak_in_one_form_that_addresses_nobody():
    """Infinitives throughout ("Kabel prüfen"): what the press says to three people on one screen."""
    addressed = re.compile(r"\w+n Sie\b|\bIhre?[mnrs]?\b")
    assert not [c for c, pattern in catalogue_of("de").entries().items() if addressed.search(pattern)]


def test_english_sentences_do_without_the_words_readers_stumbled_over():
    stumbled = re.compile(
        r"\b(?:told|tells?|heard|coming|says?|said|speaks?|mend\w*|anew|foreseen|given up)\b", re.IGNORECASE
    )
    sentences = {c: re.sub(r"\{[^{}]*\}", "", pattern) for c, pattern in catalogue_of("en").entries().items()}
    assert not [c for c, sentence in sentences.items() if stumbled.search(sentence)]


def test_german_calls_a_pressing_pressung_and_only_the_nightly_job_lauf():
    wrong = re.findall(r".*(?<!ächtliche )(?<!ächtlicher )\b(?:Lauf|Laufs|Läufen?)\b.*", catalogue_of("de").text)
    assert wrong == []


def test_there_are_english_and_german():
    assert languages()[0] == "en"
    assert "de" in languages()


COUNTED = {
    "buffer-damaged": ("kept", "lost"), "buffer-damaged-uncounted": ("kept",), "buffer-emptied": ("count",),
    "buffer-gone": ("lost",), "demo-night-comes": ("pressings",), "events-lost": ("count",),
    "left-unwritten": ("count",), "night-archive": ("archived",), "night-too-few-runs": ("runs",),
    "page-archive-holds": ("runs", "unsound"), "steam-limit-no-marks": ("runs",),
    "terminal-backup-archive": ("runs",), "terminal-backup-contents": ("runs", "scans", "fits", "models"),
    "terminal-calibrate-added": ("entries",),
}  # fmt: skip
"""Sentences about so many of something that may well be a single one."""


@pytest.mark.parametrize("language", languages())
@pytest.mark.parametrize(("code", "of"), [(code, of) for code, several in COUNTED.items() for of in several])
def test_of_a_single_one_a_sentence_has_the_singular(code, of, language):
    others = dict.fromkeys(variables(patterns(language)[code]) - {of}, "x")
    one, several = (words(Message(code, others | {of: n}), language) for n in (1, 7))
    assert one != several.replace("7", "1")


def test_a_message_within_a_message_is_put_into_the_same_language():
    inner = say("plain-text", text="top_1")
    assert words(say("plain-text", text=inner), "de") == "top_1"


def test_numbers_keep_no_thousands_separator_and_take_the_languages_comma():
    assert words(Message("plain-text", {"text": 12345.5}), "en") == "12345.5"
    assert words(Message("plain-text", {"text": 12345.5}), "de") == "12345,5"


@pytest.mark.parametrize("language", languages())
@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_is_none_is_told_in_words_in_every_sentence(language, number):
    """Fluent's own NUMBER() would leave ``NUMBER()`` in the sentence."""
    own = catalogue_of(language)
    for code, entry in patterns(language).items():
        text = own.words(Message(code, dict.fromkeys(variables(entry), number)))
        assert "NUMBER" not in text, (code, text)


@pytest.mark.parametrize("number", [1e300, -1e25, 10**400], ids=["1e300", "-1e25", "10**400"])
@pytest.mark.parametrize("language", languages())
def test_every_sentence_can_be_said_of_a_number_of_any_size(language, number):
    for code, entry in patterns(language).items():
        text = words(Message(code, dict.fromkeys(variables(entry), number)), language)
        assert text, code
    assert words(say("list-of-names", names=(1e300, 10**400, -2.5e30)), language) == "1e+300, 1e+400, -2.5e+30"


def test_a_number_that_is_none_goes_into_json_as_the_words_for_it():
    message = Message("plain-text", {"text": float("nan")})
    assert words(message, "en") == "not known"
    assert words(Message.from_json(json.loads(json.dumps(message.to_json(), allow_nan=False))), "de") == (
        "nicht bekannt"
    )


def test_numbers_of_a_table_are_numbers_like_any_other():
    message = Message("plain-text", {"text": np.int64(1200), "x": np.float32(0.5)})
    assert words(message, "en") == "1200"
    assert message.to_json()["arguments"] == {"text": 1200, "x": 0.5}


@pytest.mark.parametrize("language", languages())
def test_of_a_text_too_long_for_a_sentence_the_beginning_is_shown(language):
    cell = say("at-column", column="time_s", what=say("at-key-value", key="x", value="7" * 5000, what="wrong"))
    values = words(cell, language)
    assert "777…: wrong" in values
    assert len(values) < 300
    names = words(say("at-column", column="time_s", what=say("list-of-names", names=["top_1"] * 5000)), language)
    assert "top_1, top_1" in names
    assert names.endswith("…")
    assert words(say("plain-text", text="a" * 2500), language) == "a" * 2500


def test_a_message_is_the_same_after_json_and_pickle():
    message = Message("a", {"names": ("x", "y"), "n": 3, "inner": say("plain-text", text="z")})
    assert Message.from_json(message.to_json()) == message
    assert pickle.loads(pickle.dumps(message)) == message
    assert hash(Message.from_json(message.to_json())) == hash(message)


def test_an_exception_says_its_message_in_english_and_keeps_it_for_the_face():
    error = ValueError(say("plain-text", text="no press"))
    assert str(error) == "no press"
    assert spoken(error).code == "plain-text"
    assert spoken(ValueError("typed by hand")) == say("plain-text", text="typed by hand")


def test_a_code_of_a_newer_version_is_shown_with_its_arguments():
    assert (
        words(Message("from-the-future", {"press": "lab", "n": 2}), "de") == "from-the-future: press = lab, n = 2"
    )


@pytest.mark.skipif(os.name != "posix", reason="what the system says is held against POSIX's words")
@pytest.mark.parametrize("number", SYSTEM_FAULTS)
def test_what_the_system_refuses_is_said_in_its_own_words_and_in_every_language(number):
    reason = reason_of(OSError(number, "not to be repeated", "file.csv"))
    english = {errno.EPERM: os.strerror(errno.EACCES)}.get(number, os.strerror(number))  # the same for a reader
    assert [words(reason, language) == english for language in languages()] == [one == "en" for one in languages()]


def test_what_the_system_says_that_no_catalogue_has_is_repeated():
    assert reason_of(OSError(errno.ENXIO, "No such device or address")) == "No such device or address"


@pytest.mark.parametrize("language", languages())
def test_whatever_stands_for_a_value_in_a_call_has_its_word(language):
    group = typer.main.get_command(app)
    params = [p for command in (group, *group.commands.values()) for p in command.params]
    placeholders = {word for p in params for word in PLACEHOLDER.findall(str(p.metavar or ""))}
    known = patterns(language)
    assert len(placeholders) > 20
    assert [
        w for w in placeholders | {"OPTIONS", "COMMAND", "ARGS"} if f"help-word-{w.lower()}" not in known
    ] == []


@pytest.mark.parametrize("language", languages())
def test_a_silence_is_told_as_people_put_it(language):
    text = words(
        Message("health-process-silent", {"process": "record", "seconds": 4399.2, "command": "record"}), language
    )
    assert "1 h 13 min" in text
    assert "4399" not in text


@pytest.mark.parametrize("language", languages())
def test_nought_is_written_0_as_any_other_whole_number(language):
    assert words(say("report-number", value=0.0), language) == "0"
    assert words(say("report-span", low=0.0, high=2700.0), language) == "0 – 2700"
