"""Write the gallery's notebooks anew from its scripts, with what their cells print and draw.

    python deploy/figures/gallery_notebooks.py [NAME...]

Needs the extra ``test``. A test holds every notebook against its script, runs it, and holds what it says against
what is kept: whoever changes how a result prints, or what a fit finds, runs this once more.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

GALLERY = Path(__file__).parents[1] / "gallery"


def executed(script: Path) -> nbformat.NotebookNode:
    """Return a script as a notebook that has been run; the same but for its numbers each time."""
    notebook = nbformat.v4.new_notebook(cells=jupytext.read(script).cells)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook, timeout=900, resources={"metadata": {"path": folder}}, record_timing=False
        ).execute()
    for number, cell in enumerate(notebook.cells):
        cell["id"], cell["metadata"] = f"cell-{number}", {}
    notebook.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return notebook


def main(names: list[str]) -> None:
    """Write those named, all without a name."""
    for script in sorted(GALLERY.glob("*.py")):
        if not names or script.stem in names:
            nbformat.write(executed(script), script.with_suffix(".ipynb"))
            sys.stdout.write(f"{script.stem}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
