"""What a screen holds, and everything of ours that a result leads to by its public attributes."""

import html
import math
import re
from collections.abc import Mapping

ROWS, COLUMNS = 25, 120
"""A terminal's: one screen."""


def text_of(page):
    """Return the text of a report's file as a terminal writes it: without tags, with its own spaces and minus."""
    text = re.sub("<[^>]+>", "", html.unescape(page.read_text(encoding="utf-8")))
    return text.replace("\N{NO-BREAK SPACE}", " ").replace("\N{MINUS SIGN}", "-")


def rows_of(text):
    """Return how many rows of a screen a text takes, long lines wrapped."""
    return sum(max(1, math.ceil(len(line) / COLUMNS)) for line in text.splitlines())


def flooding(result):
    """Return by path what floods a screen, among a result and all of our kinds that it leads to."""
    found, todo, seen = {}, [("", result)], set()
    while todo:
        path, one = todo.pop()
        if type(one).__module__.partition(".")[0] in ("daq", "softsensor"):
            if type(one) in seen:
                continue
            seen.add(type(one))
            if (rows := rows_of(repr(one))) > ROWS:
                found[path] = rows
        todo += [(f"{path}{key}", part) for key, part in parts_of(one)]
    return found


def parts_of(one):
    """Return what an object leads to: its fields and properties, or what it holds."""
    if isinstance(one, Mapping):
        return [(f"[{key!r}]", part) for key, part in list(one.items())[:3]]
    if isinstance(one, (tuple, list)):
        return [(f"[{i}]", part) for i, part in enumerate(one[:3])]
    if type(one).__module__.partition(".")[0] not in ("daq", "softsensor"):
        return []
    names = [*getattr(one, "__dataclass_fields__", getattr(type(one), "model_fields", ()))]
    names += [n for n in dir(type(one)) if n[0] != "_" and isinstance(getattr(type(one), n), property)]
    return [(f".{name}", getattr(one, name)) for name in names if not name.startswith("_")]
