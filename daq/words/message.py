"""A message, a code with its arguments, and the catalogues that put it into words: one file a language, read once.

A message needs the catalogues for its English text, a catalogue needs messages for its arguments: one module holds
both. fluent is imported with the first catalogue, so nothing is slower to start for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Context
from functools import cache, partial
from importlib import resources
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any, TypeAlias, Union

from daq.address import without_secrets

Argument: TypeAlias = Union[str, int, float, "Message", tuple["Argument", ...]]
"""Texts are shown as they are (names, columns, paths), numbers in the language's way, messages in its words."""
ENGLISH = "en"
"""The language of logs, of SQL and of whoever asks for none; every message has it."""
_LONGEST = 2500
"""Characters of an argument that fluent puts into a sentence (its MAX_PART_LENGTH)."""
_BEGINNING = 200
"""Characters kept of a text that is longer, so that what to do, behind it, is still read. (By hand, 2026-11)"""
LARGEST_EXACT = 2**53
"""Whole numbers up to here are the same in a double (IEEE 754), JSON and TOML. Those beyond are shown by their
power of ten: there is no digit for each, and fluent fails at more than 28 of them."""


@dataclass(frozen=True)
class Message:
    """A text for people, as a code with arguments: words come from the catalogues."""

    code: str
    """A message's name in the catalogues, such as ``logger-lost``."""
    arguments: Mapping[str, Argument] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Freeze the arguments: lists become tuples, no number the words for that, passwords three stars."""
        frozen = {name: _frozen(value) for name, value in self.arguments.items()}
        object.__setattr__(self, "arguments", MappingProxyType(frozen))

    def __str__(self) -> str:
        """Return it in the language that is read here: English but where a notebook chose another (`choose`)."""
        return words(self, chosen())

    def __format__(self, specification: str) -> str:
        """Format it as its text."""
        return format(str(self), specification)

    def __hash__(self) -> int:
        """Hash by code and arguments."""
        return hash((self.code, tuple(sorted(self.arguments.items(), key=lambda item: item[0]))))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as code and arguments."""
        return Message, (self.code, dict(self.arguments))

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON carries it: ``{"code", "arguments"}``, messages within likewise."""
        return {"code": self.code, "arguments": {name: _plain(value) for name, value in self.arguments.items()}}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Message:
        """Undo `to_json`."""
        return Message(str(data["code"]), {name: _rebuilt(value) for name, value in data["arguments"].items()})


def say(code: str, **arguments: Argument) -> Message:
    """Make the `Message` of a code and its arguments, not yet in words; a test holds calls against all catalogues.

    Examples
    --------
    >>> str(say("list-of-names", names=("top_1", "top_2")))
    'top_1, top_2'
    """
    return Message(code, arguments)


def spoken(reason: object) -> Message:
    """Return the message that an exception carries; a plain text becomes one that shows it as it is."""
    inner = reason.args[0] if isinstance(reason, BaseException) and len(reason.args) == 1 else reason
    return inner if isinstance(inner, Message) else Message("plain-text", {"text": str(inner)})


class Catalogue:
    """The words of one language, each read when it is first used: a refusal waits for its own words alone."""

    def __init__(self, language: str, text: str) -> None:
        from fluent.runtime import FluentBundle, FluentResource
        from fluent.runtime.types import fluent_number

        self.language = language
        self.text = text
        self.learnt: dict[str, str] = {}
        """Words that came later (`learn`), by code."""
        self._patterns = _patterns(text)
        functions: dict[str, Any] = {"NUMBER": _number_or_words, "SPAN": _span}
        self._new_bundle: Any = partial(FluentBundle, [language], use_isolating=False, functions=functions)
        self._bundle = self._new_bundle()
        self._resource, self._number = FluentResource, fluent_number

    def entries(self) -> dict[str, str]:
        """Return the pattern of every code of the file, in the catalogue's own syntax."""
        return dict(self._patterns)

    def learn(self, entries: Mapping[str, str]) -> None:
        """Take in words by code, each a pattern of one line, as an effect of one's own brings them.

        A code that is known keeps its words.
        """
        self.learnt |= {code: pattern for code, pattern in entries.items() if not self.has(code)}

    def forget(self, beginnings: tuple[str, ...]) -> None:
        """Let go of what was learnt under codes that begin so, before it is learnt otherwise."""
        kept = {code: one for code, one in self.learnt.items() if not code.startswith(beginnings)}
        if len(kept) < len(self.learnt):
            self.learnt, self._bundle = kept, self._new_bundle()  # a bundle keeps whatever it once formatted

    def has(self, code: str) -> bool:
        """Return whether this language has words for a code."""
        return code in self._patterns or code in self.learnt

    def words(self, message: Message) -> str:
        """Return a message in this language, in English where this one lacks it.

        A code that no language knows, from a newer version's store say, is shown with its arguments.
        """
        pattern = self._pattern(message.code)
        if pattern is None:
            if self.language != ENGLISH:
                return catalogue_of(ENGLISH).words(message)
            shown = ", ".join(f"{name} = {self._argument(value)}" for name, value in message.arguments.items())
            return f"{message.code}: {shown}" if shown else message.code
        arguments = {name: self._argument(value) for name, value in message.arguments.items()}
        text, _ = self._bundle.format_pattern(pattern, arguments)
        return str(text)

    def _pattern(self, code: str) -> Any:
        source = self._patterns.get(code, self.learnt.get(code))
        if source is not None and not self._bundle.has_message(code):
            self._bundle.add_resource(self._resource(f"{code} = {source}"))
        return self._bundle.get_message(code).value if self._bundle.has_message(code) else None

    def _argument(self, value: Argument) -> Any:
        if isinstance(value, Message):
            return _shortened(self.words(value), _LONGEST)
        if isinstance(value, tuple):
            return _shortened(", ".join(str(self._argument(one)) for one in value), _LONGEST)
        if isinstance(value, str):
            return _shortened(value, _BEGINNING)
        if abs(value) > LARGEST_EXACT:
            return str(Context(prec=6).create_decimal(value).normalize()).lower()
        return self._number(value, useGrouping=False)


def _shortened(text: str, kept: int) -> str:
    """Return a text that fluent takes: of one too long its beginning, else it would put ``{???}`` there."""
    return text if len(text) <= _LONGEST else text[: kept - 1] + "…"


def _patterns(text: str) -> dict[str, str]:
    """Return the pattern of every code: what follows its ``=``, up to the next line that begins at the margin."""
    found: dict[str, str] = {}
    code = ""
    for line in text.splitlines():
        if line[:1].isalpha():
            code, _, pattern = line.partition("=")
            code = code.rstrip()
            found[code] = pattern.strip()
        elif code and line[:1] in (" ", "}"):
            found[code] += "\n" + line
        else:
            code = ""
    return found


def languages() -> tuple[str, ...]:
    """Return the languages there are words for, English first."""
    found = {file.name.removesuffix(".ftl") for file in _folder().iterdir() if file.name.endswith(".ftl")}
    return (ENGLISH, *sorted(found - {ENGLISH}))


@cache
def catalogue_of(language: str) -> Catalogue:
    """Return the words of a language. Raises `KeyError` for one that has no file."""
    if language not in languages():
        raise KeyError(language)
    return Catalogue(language, (_folder() / f"{language}.ftl").read_text(encoding="utf-8"))


_CHOSEN = [ENGLISH]
"""The language that is read in this process, in one place for all its threads and a notebook's cells."""


def choose(language: str) -> None:
    """Choose the language of ``str(message)``; services never do, since logs and SQL are English."""
    catalogue_of(language)
    _CHOSEN[0] = language


def chosen() -> str:
    """Return the language that is read in this process."""
    return _CHOSEN[0]


def words(message: Message | str, language: str = ENGLISH) -> str:
    """Return a message in a language; a plain text as it is."""
    return message if isinstance(message, str) else catalogue_of(language).words(message)


def sentences(messages: Iterable[Message | str], language: str = ENGLISH) -> str:
    """Return messages that are whole sentences one after the other in a language."""
    return " ".join(words(one, language) for one in messages)


def _frozen(value: Any) -> Argument:
    if isinstance(value, list | tuple):
        return tuple(_frozen(one) for one in value)
    if isinstance(value, Message):
        return value
    if isinstance(value, str):
        return without_secrets(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        return str(value)
    if isinstance(value, Integral):
        return int(value)
    number = float(value)
    if math.isinf(number):
        return "∞" if number > 0.0 else "-∞"
    return Message("number-unknown") if math.isnan(number) else number


def _number_or_words(value: Any, **how: Any) -> Any:
    """Format a number; what stands for one that is not known is words already."""
    from fluent.runtime.types import fluent_number

    if isinstance(value, str):
        return value
    if value == 0 and "maximumSignificantDigits" in how:
        how = {"maximumFractionDigits": 0}  # nought has no significant digits, and Babel writes 0.0
    return fluent_number(value, **how)


def _span(value: Any) -> Any:
    """Put seconds as people do, in two units at most; what stands for a number not known is words already.

    >>> _span(4399), _span(42.4), _span(90000.0), _span(119.6)
    ('1 h 13 min', '42 s', '1 d 1 h', '2 min')
    """
    if isinstance(value, str):
        return value
    seconds = round(float(value))
    for large, small, size, part in (("d", "h", 86400, 3600), ("h", "min", 3600, 60), ("min", "s", 60, 1)):
        if seconds >= size:
            whole, rest = divmod(seconds, size)
            return f"{whole} {large}" + (f" {rest // part} {small}" if rest >= part else "")
    return f"{seconds} s"


def _plain(value: Argument) -> Any:
    if isinstance(value, Message):
        return value.to_json()
    return [_plain(one) for one in value] if isinstance(value, tuple) else value


def _rebuilt(value: Any) -> Argument:
    if isinstance(value, Mapping):
        return Message.from_json(value)
    return tuple(_rebuilt(one) for one in value) if isinstance(value, list) else value


def _folder() -> Any:
    return resources.files("daq.words")
