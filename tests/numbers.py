"""The numbers of the code, and which of them were set by hand."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator
from pathlib import Path

REMARK = re.compile("by hand", re.IGNORECASE)
REMARK_OF_MODULE = re.compile(
    "(?:Numbers|Thresholds) without another source were set by hand|numbers (?:below )?were set by hand"
)
SOURCE = re.compile(
    r"\b(?:CODATA|Handbook|ISO|IEC|IAPWS|NIST|NAMEDATALEN|doi|et al|TR-BDF2|by definition|half[- ]space|seeds?|"
    r"default)\b"
)
"""Names a table, a paper, a definition, a closed solution, or a calibration with what it was drawn with."""


def is_number(value: ast.expr) -> bool:
    """Say whether an expression is a number, or a tuple of numbers, as it stands."""
    if isinstance(value, ast.Tuple):
        return all(is_number(one) for one in value.elts)
    called = {
        node.func.attr
        for node in ast.walk(value)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
    }
    if called - {"array", "log", "radians", "sqrt"}:
        return False  # computed, as nodes of a quadrature
    names = {node.id for node in ast.walk(value) if isinstance(node, ast.Name)} - {"np", "math"}
    kinds = {type(node.value) for node in ast.walk(value) if isinstance(node, ast.Constant)}
    return not names and bool(kinds) and kinds <= {int, float}


def numbers_in(path: Path) -> Iterator[tuple[str, ast.expr, int, str]]:
    """Yield name, value, line and words of each number at module level; a comment above it counts as words."""
    text = path.read_text(encoding="utf-8")
    lines, body = text.split("\n"), ast.parse(text).body
    for node, after in zip(body, [*body[1:], None], strict=False):
        if not isinstance(node, ast.Assign) or not is_number(node.value):
            continue
        said = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        above, own = lines[node.lineno - 2], lines[node.lineno - 1].partition("#")[2]
        words = str(said) + own + (above if above.startswith("#") else "")
        for target in node.targets:
            ones = target.elts if isinstance(target, ast.Tuple) else [target]
            several = len(ones) > 1 and isinstance(node.value, ast.Tuple)
            for one, value in zip(ones, node.value.elts if several else [node.value] * len(ones), strict=True):
                yield one.id, value, node.lineno, words


def numbers_of(path: Path) -> Iterator[tuple[str, ast.expr]]:
    """Yield name and value of each number at module level that was set by hand.

    A remark in a comment or the docstring of a module holds for what stands below it and names no source, one in
    the docstring of a number for that number.
    """
    text = path.read_text(encoding="utf-8")
    below = text.count("\n", 0, found.start()) if (found := REMARK_OF_MODULE.search(text)) else math.inf
    for name, value, line, words in numbers_in(path):
        if REMARK.search(words) or (line > below and not SOURCE.search(words)):
            yield name, value
