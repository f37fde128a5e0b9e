"""The gallery: every notebook runs from top to bottom, is its script cell by cell, and shows what it says now."""

from __future__ import annotations

import ast
import copy
import os
import re
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient

import daq
import softsensor
from daq.shared import shared_files

GALLERY = shared_files() / "gallery"
REWRITE = "the notebook shows what the program no longer says; run: python deploy/figures/gallery_notebooks.py"
SCRIPTS = sorted(GALLERY.glob("*.py"))
CLEAR = """%reset -f
import softsensor.effects
for name in softsensor.effects.catalogue().keys() - {effect.name for effect in softsensor.effects.BUILT_IN}:
    del softsensor.effects.catalogue()[name]
%reset -f"""
"""What comes before every notebook: the effect one adds is to outlive neither its names nor its catalogue."""
every_notebook = pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    """One kernel for all of them, as starting one takes as long as running one."""
    folder = tmp_path_factory.mktemp("notebooks")
    client = NotebookClient(nbformat.v4.new_notebook(), timeout=800, resources={"metadata": {"path": str(folder)}})
    with client.setup_kernel(env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}):
        yield client
    assert not list(folder.iterdir())


def test_there_is_a_notebook_for_every_script():
    assert len(SCRIPTS) == 9
    assert [p.stem for p in sorted(GALLERY.glob("*.ipynb"))] == sorted(p.stem for p in SCRIPTS)


@every_notebook
def test_the_notebook_is_its_script(script):
    cells, written = jupytext.read(script).cells, nbformat.read(script.with_suffix(".ipynb"), as_version=4).cells
    assert [(c.cell_type, c.source) for c in written] == [(c.cell_type, c.source) for c in cells]


NAMES = {"daq": daq.__all__, "softsensor": softsensor.__all__}
PACKAGES = (*NAMES, "api")


def hidden_names(source):
    """Return what a text takes from our packages that is not public, the virtual press aside."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.partition(".")[0] in PACKAGES and a.name not in NAMES)
        elif isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] in PACKAGES:
            if not node.module.startswith("daq.simulated."):
                yield from (a.name for a in node.names if a.name not in NAMES.get(node.module, ()))
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in NAMES:
            yield from () if node.attr in NAMES[node.value.id] else (f"{node.value.id}.{node.attr}",)


@every_notebook
def test_only_public_names_are_used(script):
    assert list(hidden_names(script.read_text(encoding="utf-8"))) == []
    assert list(hidden_names("import daq.records\nfrom softsensor.heat import model\ndaq.face")) == [
        "daq.records",
        "model",
        "daq.face",
    ]


NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.(\d+))?(?:e[-+]?\d+)?")
LOOSE = 0.01
"""Of a number, where one figure in a hundred decides nothing: intervals are told to two digits (`rounded`), while
rounding of sums on another processor moves a fit by some 1e-6 of itself."""
TIMED = '"seconds"'
"""A cell that asks for it shows how long the machine took: its words alone are compared."""


def texts_of(cell):
    """Return what a cell printed and showed as text, pictures aside."""
    streams = [out.text for out in cell.get("outputs", []) if out.output_type == "stream"]
    shown = [out.data.get("text/plain", "") for out in cell.get("outputs", []) if "data" in out]
    return "".join(streams), [text for text in shown if not text.startswith("<Figure")]


def loosened(text):
    """Return a text's words with its numbers taken out, and these with the last digit that each shows."""
    numbers = [(float(n.group()), 10.0 ** -len(n.group(1) or "")) for n in NUMBER.finditer(text)]
    return NUMBER.sub("#", text).split(), numbers


def says_the_same(one, other, *, timed=False):
    """Return whether two texts say the same, their numbers alike to `LOOSE` or the last digit shown."""
    (words, numbers), (others, figures) = loosened(one), loosened(other)
    return words == others and (
        timed
        or all(
            abs(a - b) <= max(LOOSE * max(abs(a), abs(b)), 1.5 * max(digit, shown))
            for (a, digit), (b, shown) in zip(numbers, figures, strict=True)
        )
    )


def test_an_interval_that_has_grown_is_another_answer_and_a_last_digit_is_not():
    assert says_the_same("h_pp_o  0.73  29.1", "h_pp_o 0.73   29.12")
    assert not says_the_same("h_pp_o  0.73", "h_pp_o  6.98")
    assert not says_the_same("h_pp_o  6.98", "h_pp_c  6.98")


@pytest.mark.campaign
@every_notebook
def test_the_notebook_runs_and_says_what_it_is_shipped_with(script, kernel):
    written = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    cells = copy.deepcopy(written.cells)
    kernel.nb = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CLEAR), *cells])
    for number, cell in enumerate(kernel.nb.cells):
        kernel.execute_cell(cell, number)
    for kept, now in zip(written.cells, cells, strict=True):
        (printed, shown), (prints, shows) = texts_of(kept), texts_of(now)
        assert len(shown) == len(shows), kept.source
        for one, other in zip((printed, *shown), (prints, *shows), strict=True):
            assert says_the_same(one, other, timed=TIMED in kept.source), f"{REWRITE}\n{one}\nis now\n{other}"
