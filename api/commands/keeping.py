"""`backup`: a checked copy of the store while everything runs, and the way back."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from api.commands.inputs import ConfigFile, StoreUrl, opened_store, store_address
from api.outputs import WorkFailed, working


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The copy: a new SQLite file.")],
    verify: Annotated[bool, typer.Option("--verify", help="Only check an existing copy.")] = False,
    restore: Annotated[bool, typer.Option("--restore", help="Fill a new, empty store from the copy.")] = False,
    store: StoreUrl = None,
    config: ConfigFile = None,
) -> None:
    """Copy the store while others write to it; the copy is checked before it gets its name."""
    from daq.store import StoreUnavailable, upkeep

    if verify and restore:
        raise typer.BadParameter("--verify and --restore: give one of them; restoring checks the copy first")
    try:
        if verify:
            contents, done = upkeep.verify(file), "is sound"
        elif restore:
            with working(f"Restoring {file}"):
                contents, done = upkeep.restore(file, store_address(store, config)), "restored and compared"
        else:
            with opened_store(store, config) as opened, working(f"Copying {opened.label}"):
                contents, done = opened.back_up(file), "written and checked"
    except StoreUnavailable as error:
        raise WorkFailed(str(error)) from error
    held = f"{contents.runs} runs, {contents.scans} scans, {contents.fits} fits, {contents.models} models"
    sys.stdout.write(f"{file} {done}: {held}\n")
