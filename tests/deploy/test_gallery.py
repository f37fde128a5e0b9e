"""The gallery: every notebook runs from top to bottom, and is its script cell by cell."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient

import daq
import softsensor
from daq.shared import shared_files

GALLERY = shared_files() / "gallery"
SCRIPTS = sorted(GALLERY.glob("*.py"), key=lambda path: (path.stem == "own_effect", path.stem))
"""The one that adds to the catalogue comes last: its effect outlives the names that the next one clears."""
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
    assert len(SCRIPTS) == 8
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


@pytest.mark.campaign
@every_notebook
def test_the_notebook_runs(script, kernel):
    written = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    kernel.nb = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("%reset -f"), *written.cells])
    for number, cell in enumerate(kernel.nb.cells):
        kernel.execute_cell(cell, number)
