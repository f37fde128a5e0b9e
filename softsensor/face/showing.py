"""Results as tables, lists and figures."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from daq.printed import LINES
from daq.words import Message, say

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from daq.records import Run


UNKNOWN = "–"
"""Stands in what is shown where a number is not known."""

WIDTH = 100
"""Characters of a line that print narrow, as a notebook beside its list of files. Set by hand, 2026-11."""
SCREEN, HEAD = LINES + 4, 2
"""Lines of what prints: a terminal's 25 but for that of its prompt; of these what stands above a table."""


def table_html(frame: pd.DataFrame, digits: str = "%.4g") -> str:
    """Return a table for a notebook, long ones shortened; a dash where a number is not known."""
    return str(frame.to_html(float_format=digits.__mod__, max_rows=24, na_rep=UNKNOWN))


def table_text(frame: pd.DataFrame, digits: str, rows: int = 8) -> str:
    """Return a table's first and last rows as they print, columns beyond the width below one another."""
    how: dict[str, Any] = {"float_format": digits.__mod__, "na_rep": UNKNOWN, "line_width": WIDTH}
    while True:
        text = str(frame.to_string(max_rows=rows, **how))
        if rows <= 2 or len(text.splitlines()) <= SCREEN - HEAD:
            return text
        rows -= 2


def lines_html(lines: Iterable[Message | str]) -> str:
    """Return sentences for a notebook, a paragraph each."""
    return "".join(f"<p>{html.escape(str(line))}</p>" for line in lines)


def head_html(line: Message | str) -> str:
    """Return what a result says first, for a notebook."""
    return f"<p><b>{html.escape(str(line))}</b></p>"


def printed(sentences: Iterable[Sequence[Message | str]], above: str = "") -> str:
    """Return sentences as they print below a text: wrapped, and as many as the screen holds.

    Sentences of one group stand together or not at all; groups that are left out are counted.
    """
    groups = [[row for line in group for row in wrap(str(line), WIDTH)] for group in sentences]
    lines = above.splitlines()
    for number, rows in enumerate(groups):
        last = number == len(groups) - 1
        if number and len(lines) + len(rows) + (not last) > SCREEN:
            return "\n".join([*lines, str(say("printed-more", count=len(groups) - number))])
        lines += rows
    return "\n".join(lines)


def about(run: Run, frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the header of the run it is about."""
    from daq.files.frames import attrs_of

    frame.attrs.update(attrs_of(run))
    return frame


def lists(frame: pd.DataFrame) -> str:
    """Return a table as JSON, a list a column; null where there is no value."""
    table = frame.reset_index().astype(object)
    return json.dumps(table.where(table.notna(), None).to_dict("list"))


def shown(figure: Figure) -> list[Axes]:
    """Hand a figure to pyplot, so that a notebook shows it and ``plt.show()`` does; return its axes."""
    from matplotlib import pyplot

    pyplot.figure(figure)
    return list(figure.axes)


def axes_over_time(title: str) -> Any:
    """Return axes of temperature over time, under a title given by its code."""
    from matplotlib.figure import Figure

    ax = Figure(figsize=(8.0, 4.0), layout="constrained").add_subplot()
    ax.set(title=str(Message(title)), xlabel=str(say("figure-time")), ylabel=str(say("figure-temperature")))
    return ax
