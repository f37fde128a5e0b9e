"""The page of symbols and equations: every name on it is one of the code."""

import importlib
import re
from pathlib import Path

import pytest

from daq.press.press_file import read_press
from softsensor.effects import BUILT_IN

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "deploy" / "guide" / "nomenclature.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`((?:softsensor|daq|api)(?:\.\w+)+)`", PAGE)))


def found(name):
    """What a dotted name stands for: a module, or what it holds, or a field of a class."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            here = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            fields = getattr(here, "__annotations__", {})
            here = getattr(here, part) if hasattr(here, part) else fields[part]
        return here
    raise AssertionError(name)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_on_the_page_of_symbols_stands_in_the_code(name):
    assert found(name) is not None


def test_the_page_of_symbols_has_the_equation_of_every_effect_of_the_catalogue():
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+?) \|", PAGE, re.MULTILINE))
    assert {e.name for e in BUILT_IN} <= set(rows)


def test_the_page_of_symbols_names_every_coefficient_of_the_laboratory_press():
    press = read_press(ROOT / "deploy" / "presses" / "lab.toml")
    assert all(f"`{name}`" in PAGE for name in press.coefficient_names)


CONSTANTS = re.findall(
    r"^\| .+? \| (.+?) \| (`.+`) \|$", PAGE.split("Their constants:")[1].split("\n## ")[0], re.MULTILINE
)


@pytest.mark.parametrize(("value", "names"), CONSTANTS)
def test_the_page_of_symbols_gives_the_constants_their_values(value, names):
    given = [float(number) for number in re.findall(r"\d[\d.]*(?:e-?\d+)?", value)]
    for name in re.findall(r"`([\w.]+)`", names):
        own = found(name)
        assert any(number in (pytest.approx(own), pytest.approx(own / 1e3)) for number in given), name
