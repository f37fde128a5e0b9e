"""The numbers of the code, and which of them were set by hand."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Container, Iterator
from pathlib import Path

REMARK = re.compile(r"\b(?:by hand|unverified|assumed)\b", re.IGNORECASE)
REMARK_OF_MODULE = re.compile(
    "(?:Numbers|Thresholds) without another source were set by hand|numbers (?:below )?were set by hand"
)
SOURCE = re.compile(
    r"\b(?:CODATA|Handbook|Metron|Simpson|EN \d{3,5}(?:-\d)?|"
    r"ISO|IEC|IAPWS|NIST|NAMEDATALEN|doi|et al|TR-BDF2|by definition|half[- ]space|seeds?|"
    r"default)\b"
)
"""Names a table, a paper, a definition, a closed solution, or a calibration with what it was drawn with."""


PLAIN = (0.0, 0.5, 1.0, 2.0)
"""Of a formula, not of a press: none, half, all, both."""
GUARD = 1e-6
"""So small a number keeps a division, a root or a logarithm from nothing, and moves no answer."""
OF_UNITS = (1e-3, 10.0, 60.0, 100.0, 1e3, 3600.0, 86400.0, 1e6, 1e9)
"""A factor or divisor that turns a unit into another, a share into percent."""
SHARES = "report"
"""A call that says what share of a work is done."""
DRAWING = (
    "softsensor/report/",
    "softsensor/face/showing.py",
    "softsensor/face/predicting.py",
    "api/answers/figure.py",
)
"""Where numbers are places, widths and shades of a picture."""


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
        words = _words(node, after, lines)
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


def numbers_elsewhere(path: Path) -> Iterator[tuple[str, int]]:
    """Yield name and line of each other number that was set by hand: in a table, a field or an argument's default.

    A table or a formula counts once, by the rule of `numbers_of`; a call within it that has a source of its own
    counts by that instead. Of fields and defaults those count that have no words at all, too. Only numbers with a
    point are meant, and none of `PLAIN` or `GUARD`.
    """
    text = path.read_text(encoding="utf-8")
    lines, tree = text.split("\n"), ast.parse(text)
    below = text.count("\n", 0, found.start()) if (found := REMARK_OF_MODULE.search(text)) else math.inf
    for owner in (tree, *(node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))):
        within = owner.name + "." if isinstance(owner, ast.ClassDef) else ""
        for node, after in zip(owner.body, [*owner.body[1:], None], strict=False):
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            if isinstance(node, ast.Assign) and not within and is_number(node.value):
                continue  # `numbers_of` has it
            name = within + ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
            sourced = {n: s for n in ast.walk(node.value) if isinstance(n, ast.Call) and (s := _source_of(n))}
            yield from ((name, n.lineno) for n, s in sourced.items() if REMARK.search(s) and _bare(n, sourced))
            words = _words(node, after, lines)
            by_hand = REMARK.search(words) or (node.lineno > below and not SOURCE.search(words))
            if node.value in sourced or not _bare(node.value, sourced):
                continue
            if by_hand or (within and not words.strip()):
                yield name, node.lineno
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = (*node.args.defaults, *node.args.kw_defaults)
            yield from ((f"{node.name}()", default.lineno) for default in given if default and _bare(default, {}))


def _source_of(call: ast.Call) -> str:
    """Return what a call says in ``source=``, its texts put together."""
    return " ".join(ast.unparse(keyword.value) for keyword in call.keywords if keyword.arg == "source")


def _words(node: ast.stmt, after: ast.stmt | None, lines: list[str]) -> str:
    """Return what stands of a statement in the docstring below it, in its comment and in one above it."""
    remark = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
    above, own = lines[node.lineno - 2], lines[node.lineno - 1].partition("#")[2]
    return str(remark) + own + (above if above.lstrip().startswith("#") else "")


def _bare(value: ast.AST, sourced: Container[ast.AST]) -> bool:
    """Say whether a number stands in an expression, calls within it that have a source of their own aside."""
    if isinstance(value, ast.Constant):
        return isinstance(value.value, float) and value.value not in PLAIN and value.value > GUARD
    inner = [n for n in ast.iter_child_nodes(value) if n not in sourced]
    if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult | ast.Div):
        inner = [n for n in inner if not (isinstance(n, ast.Constant) and n.value in OF_UNITS)]
    return any(_bare(n, sourced) for n in inner)


def numbers_in_functions(path: Path) -> Iterator[tuple[float, int]]:
    """Yield value and line of each number that stands bare in a function: what it is and whence nobody says.

    Numbers with a point are meant; without one they count rows, digits, axes and the statuses of HTTP. None of
    these: `PLAIN`, guards, numbers `OF_UNITS` where they multiply or divide, shares of a work that is reported,
    and those on whose line a comment names their source.
    """
    text = path.read_text(encoding="utf-8")
    lines, tree = text.split("\n"), ast.parse(text)
    functions = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda))
    bodies = (n.body if isinstance(n.body, list) else [n.body] for n in functions)
    inside = {node for body in bodies for statement in body for node in ast.walk(statement)}
    factors = {
        side
        for node in inside
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div)
        for side in (node.left, node.right)
    }
    calls = (n for n in inside if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == SHARES)
    reported = {node for call in calls for node in ast.walk(call)}
    for node in inside - reported:
        if not (isinstance(node, ast.Constant) and isinstance(node.value, float)):
            continue
        if SOURCE.search(lines[node.lineno - 1].partition("#")[2]):
            continue
        if node.value in PLAIN or node.value <= GUARD or (node in factors and node.value in OF_UNITS):
            continue
        yield node.value, node.lineno
