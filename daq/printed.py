"""How a record prints: its name, then a line a field, on one screen, however large the arrays in it are."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

from daq.words import say

LINE, LINES = 120, 20
"""Characters of a line, and lines of a record: with its head they fit a terminal of 25 lines, none of them wrapped
on today's 120 columns."""


def on_screen(record: Any) -> str:
    """Return a dataclass or named tuple in short: stands in a class as ``__repr__ = on_screen``.

    >>> import numpy as np
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Curve:
    ...     name: str
    ...     core: np.ndarray
    ...     sd: np.ndarray
    ...     __repr__ = on_screen
    >>> Curve("a", np.linspace(20.0, 80.0, 400), np.array(0.25))
    Curve
    name = 'a'
    core = array (400,) from 20 to 80
    sd = 0.25
    """
    names = [one.name for one in fields(record)] if is_dataclass(record) else record._fields
    lines = [f"{name} = {_field(getattr(record, name))}" for name in names]
    return "\n".join([type(record).__name__, *lines_of(lines)])


def _field(value: Any) -> str:
    """Return a field's value on one line; of a record what its own fields are, which `lines_of` cuts."""
    if vars(type(value)).get("__repr__") is not on_screen:
        return in_short(value)
    head, *lines = repr(value).splitlines()
    return f"{head}({', '.join(lines)})"


def in_notebook(record: Any) -> str:
    """Return what a record prints as a notebook shows it: its name, then a table of what it holds.

    Stands in a class as ``_repr_html_ = in_notebook``.

    >>> in_notebook(3.5)
    '<p><b>3.5</b></p>'
    """
    return html_of(repr(record))


def html_of(printed: str) -> str:
    """Return what a record prints as a notebook shows it."""
    head, *lines = map(html.escape, printed.splitlines())
    rows = "".join(_html_row(line) for line in lines)
    return f"<p><b>{head}</b></p>" + (f"<table><tbody>{rows}</tbody></table>" if rows else "")


def _html_row(line: str) -> str:
    """Return a printed line as a row: what it is called, and its value where it has one."""
    name, sign, value = line.partition(" = ")
    return f"<tr><th>{name}</th><td>{value}</td></tr>" if sign else f'<tr><td colspan="2">{line}</td></tr>'


def lines_of(lines: Sequence[str]) -> list[str]:
    """Return lines cut to the screen's width; of many the first ones and how many more there are."""
    shown = [textwrap.shorten(line, LINE, placeholder=" ...") for line in lines[:LINES]]
    return [*shown, *([str(say("printed-more", count=len(lines) - LINES))] if len(lines) > LINES else [])]


def in_short(value: Any) -> str:
    """Return a value on one line: arrays by shape and range, many things by their number, records by head."""
    if hasattr(value, "dtype") and getattr(value, "ndim", False):
        return _array(value)
    if isinstance(value, Mapping):
        few = ", ".join(f"{key!r}: {in_short(one)}" for key, one in list(value.items())[:LINES])
        return "{" + few + (", ...}" if len(value) > LINES else "}")
    if isinstance(value, Sequence) and not isinstance(value, str | bytes) and not hasattr(value, "_fields"):
        few = ", ".join(in_short(one) for one in value[:LINES])
        return f"({few})" if len(few) <= LINE and len(value) <= LINES else f"{len(value)} {_kinds(value)}"
    if isinstance(value, Enum):
        return str(value.value)
    if hasattr(value, "dtype"):
        value = value.item()
    return f"{value:.6g}" if isinstance(value, float) else repr(value).partition("\n")[0]


_WRITTEN = (bool, dict, float, int, list, str, tuple, type(None))
"""Kinds of values that people write in a file."""


def quoted(value: Any) -> str:
    """Return a value that a refusal quotes: as it was written, and in short what nobody writes.

    >>> import numpy as np
    >>> quoted(-16.0), quoted("16,0"), quoted(np.array([16.0, 17.0]))
    ('-16.0', "'16,0'", 'array (2,) from 16 to 17')
    """
    return repr(value) if type(value) in _WRITTEN else in_short(value)


def _array(values: Any) -> str:
    """Return shape and range of an array, or that of what it holds."""
    head = f"array {values.shape}"
    if values.dtype.kind not in "iuf" or not values.size:
        return f"{head} of {values.dtype}"
    known = values[values == values]
    return f"{head} from {known.min():.6g} to {known.max():.6g}" if known.size else f"{head} of nan"


def _kinds(values: Sequence[Any]) -> str:
    return " and ".join(sorted({type(one).__name__ for one in values}))
