"""Pages that need no other file: templates filled in one language."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape
from markupsafe import Markup

from daq.words import Message, say
from daq.words.message import ENGLISH, sentences, words

UNIT = re.compile(r"(?<=\d) (?=(?:%|°C|K|kPa|mm|ms|s|min|h|W|N|kJ)(?!\w))|(?<=[±=<]) (?=\d)|(?<=\bp) (?=[=<] \d)")
"""Between a number and its unit no line ends, nor between it and its sign; on the page neither."""
MINUS = re.compile(r"(?<![\w.-])-(?=\d)")
"""A number's minus is no hyphen; one within a word or between two numbers is. On the page neither."""
TABLE = re.compile("<table.*?</table>", re.DOTALL)
CELL = re.compile("<t[hd][^>]*>(.*?)</t[hd]>", re.DOTALL)


def typeset(text: str) -> str:
    r"""Return words as a page shows them.

    >>> typeset("lab-2026-03-04-01 moves by -1.2 % (-2.0 … 0.5)")
    'lab-2026-03-04-01 moves by −1.2\xa0% (−2.0 … 0.5)'
    """
    return UNIT.sub("\N{NO-BREAK SPACE}", MINUS.sub("−", text))


def page(template: str, language: str = ENGLISH, **content: Any) -> str:
    """Return a template as HTML text. Messages among its content are put into words, wherever they are shown.

    In a template `say` makes a message of a code and its arguments, `together` one text of several sentences.

    Raises
    ------
    KeyError
        For a language that has no words.
    """

    def put(value: Any) -> Any:
        if isinstance(value, Markup) or not isinstance(value, Message | str):
            return value
        return typeset(words(value, language))

    pages = Environment(
        loader=PackageLoader("softsensor", "templates"),
        autoescape=select_autoescape(),
        trim_blocks=True,
        finalize=put,
    )
    pages.globals |= {"say": say, "together": partial(sentences, language=language), "language": language}
    pages.filters["labelled"] = labelled
    pages.filters["capital"] = lambda text: _capital(words(text, language))
    return pages.get_template(template).render(**content)


def labelled(text: str) -> Markup:
    """Return HTML text whose tables' cells carry the head of their column, for a screen too narrow for columns.

    >>> print(labelled("<table><tr><th>Run</th><th>K</th></tr><tr><td>a</td><td>0.3</td></tr></table>"))
    <table><tr><th>Run</th><th>K</th></tr><tr><td data-head="Run">a</td><td data-head="K">0.3</td></tr></table>
    """
    return Markup(TABLE.sub(_with_heads, text))


def _with_heads(table: re.Match[str]) -> str:
    head, *rows = re.split("(?=<tr)", table[0])[1:]
    if "<th" not in head:
        return table[0]
    heads = [Markup(cell).striptags() for cell in CELL.findall(head)]
    return "".join([table[0].partition("<tr")[0], head, *(_with_head(row, heads) for row in rows)])


def _with_head(row: str, heads: Sequence[str]) -> str:
    names = iter(heads)
    return re.sub("<td", lambda _: str(Markup('<td data-head="{}"').format(next(names, ""))), row)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def kelvins(value: float) -> Message:
    """Return a residual or an error, to a hundredth. [K]"""
    return say("kelvin-off", kelvin=round(value, 2) + 0.0)


def signed_kelvins(value: float) -> Message:
    """Return a difference with its sign, to a hundredth. [K]"""
    return say("kelvin-signed", sign="−" if value < 0 else "+", kelvin=abs(value))
