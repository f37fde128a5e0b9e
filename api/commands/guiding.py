"""`guide`: guide, gallery and reference as pages in a folder, to be read without a server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.outputs import WorkFailed, working, write_all, write_line
from daq.records import InputError
from daq.tables import reason_of
from daq.words import say


def guide(folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="help-guide-folder")]) -> None:
    """Write guide, gallery and reference of the Python packages as pages; no server and no network is needed."""
    from api.guide import guide_files

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(say("terminal-guide-folder", folder=str(folder)))
    with working(say("terminal-progress-guide")):
        files = {folder / name: text for name, text in guide_files().items()}
    try:
        for place in {path.parent for path in files}:
            place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WorkFailed(say("terminal-output-unwritable", path=str(folder), why=reason_of(error))) from error
    write_all(files)
    write_line(say("terminal-guide-written", page=str(folder / "index.html")))
