"""Docstrings of the physics give the units of the numbers that functions take and return.

A unit stands in brackets or ends the name (`time_s`); a number without one is called what it is: a share, say.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("heat", "opening")
NUMBER = re.compile(r"(?:float|Array)\b")
IN_NAME = re.compile(r"_(?:s|K|C|m|mm|kPa|W_m2K|percent)$")
PURE = re.compile(
    r"\[|\b(?:chance|share|factor|weight|correlation|probability|standard deviation|unit|whether|halves)",
    re.IGNORECASE,
)
"""A unit in brackets, or what has none."""


def numbers_of(function):
    """Names of a function's numbers whose unit no name says, its own for what it returns."""
    given = [one for one in (*function.args.args, *function.args.kwonlyargs) if one.annotation]
    found = [(one.arg, ast.unparse(one.annotation)) for one in given]
    found.append((function.name, ast.unparse(function.returns) if function.returns else ""))
    return [name for name, kind in found if NUMBER.match(kind) and not IN_NAME.search(name)]


def described(text):
    """What the section of a docstring says of each parameter."""
    _, _, section = text.partition("Parameters\n----------\n")
    section = re.split(r"\n\w+\n---", section)[0]
    for names, words in re.findall(r"^(\w.*)\n((?:    .*\n?|\n)*)", section, re.MULTILINE):
        yield from ((name.strip(), words) for name in names.split(","))


def without_units(path):
    """Yield line and name of each public function, and of each parameter described, that lacks a unit."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bodies = [tree.body, *(node.body for node in tree.body if isinstance(node, ast.ClassDef))]
    for function in (node for body in bodies for node in body if isinstance(node, ast.FunctionDef)):
        text, numbers = ast.get_docstring(function) or "", numbers_of(function)
        if function.name.startswith("_") or not numbers:
            continue
        if not PURE.search(text):
            yield f"{path.name}:{function.lineno} {function.name}"
        for name, words in described(text):
            if name in numbers and not PURE.search(words):
                yield f"{path.name}:{function.lineno} {function.name}: {name}"


@pytest.mark.parametrize("room", ROOMS)
def test_functions_of_the_physics_say_the_units_of_their_numbers(room):
    assert [one for path in sorted((ROOT / "softsensor" / room).glob("*.py")) for one in without_units(path)] == []


def test_a_number_without_a_unit_is_found(tmp_path):
    text = '''
def lag(time_s: float, heat: float) -> float:
    """Return what is left."""

def loss(area: float, depth_mm: float) -> float:
    """Return the flow. [W]

    Parameters
    ----------
    area
        Of the face.
    depth_mm
        Of the rim.
    """
'''
    (tmp_path / "one.py").write_text(text)
    assert list(without_units(tmp_path / "one.py")) == ["one.py:2 lag", "one.py:5 loss: area"]
