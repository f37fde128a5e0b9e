"""Every word the page looks up has its English and German: causes of lost readings, qualities."""

import ast
import re
from pathlib import Path

import pytest

from daq.drivers.link import _WHY_NOT
from daq.records import Quality

ROOT = Path(__file__).parents[2]
RAISED = ("NoReply", "BadFrame", "LinkLost", "_failed")
ENTRY = re.compile(r'^  (\w+): \["((?:[^"\\]|\\.)+)", "((?:[^"\\]|\\.)+)"\],$', re.MULTILINE)


def entries():
    return {key: (en, de) for key, en, de in ENTRY.findall((ROOT / "api/page/text.js").read_text("utf-8"))}


def causes():
    """Every cause that the sources give a lost reading, beside those of a port that does not open."""
    found = {cause for _, cause, _ in _WHY_NOT} | {"port lost"}
    for file in (*(ROOT / "daq/drivers").glob("*.py"), ROOT / "daq/acquisition.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if not isinstance(node, ast.Call) or len(node.args) < 2:
                continue
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in RAISED and isinstance(node.args[1], ast.Constant):
                found.add(node.args[1].value)
    return sorted(found)


def test_the_sources_are_searched_where_causes_are():
    assert {"silent", "crc", "wrong id", "connection refused", "driver fault", "closed"} <= set(causes())


@pytest.mark.parametrize("key", [f"cause_{c.replace(' ', '_')}" for c in causes()])
def test_every_cause_of_a_lost_reading_has_its_words_on_the_page(key):
    assert key in entries(), f"api/page/text.js lacks {key}"


@pytest.mark.parametrize("key", [f"quality_{q}" for q in Quality])
def test_every_quality_has_its_words_on_the_page(key):
    assert key in entries(), f"api/page/text.js lacks {key}"
