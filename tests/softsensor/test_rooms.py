"""Inference works on what it is given: no file, terminal or input, which a linter of imports cannot see."""

import ast
from pathlib import Path

import pytest

import softsensor

ROOMS = Path(softsensor.__file__).parent
INFERENCE = ("effects", "heat", "signals", "fitting", "diagnosis", "live", "opening", "planning")
WORLD = {"open", "print", "input"}
"""Builtins that reach the world outside."""
ON_FILES = {"read_text", "read_bytes", "write_text", "write_bytes", "unlink", "mkdir", "savefig"}


def calls(source):
    """Return the names a module calls, and the methods of whatever it holds."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            yield getattr(node.func, "id", None) or getattr(node.func, "attr", None)


@pytest.mark.parametrize("room", INFERENCE)
def test_inference_touches_no_file_and_no_terminal(room):
    files = sorted((ROOMS / room).rglob("*.py"))
    assert files
    guilty = {f.name: found for f in files if (found := (WORLD | ON_FILES) & set(calls(f.read_text("utf-8"))))}
    assert guilty == {}


def test_a_call_of_a_file_is_seen():
    assert WORLD & set(calls("with open(name) as file: pass"))
    assert ON_FILES & set(calls("path.read_text()"))
