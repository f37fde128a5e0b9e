"""`backup`: a checked copy of the store while everything runs, and the way back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.commands.inputs import ConfigFile, StoreUrl, opened_store, store_address
from api.outputs import WorkFailed, working, write_line
from daq.records import InputError
from daq.words import Message, say, spoken


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="help-backup-file")],
    verify: Annotated[bool, typer.Option("--verify", help="help-verify")] = False,
    restore: Annotated[bool, typer.Option("--restore", help="help-restore")] = False,
    store: StoreUrl = None,
    config: ConfigFile = None,
) -> None:
    """Copy the store while others write to it; the copy is checked before it gets its name."""
    from daq.store import StoreUnavailable, upkeep

    archive = None
    if verify and restore:
        raise InputError(say("terminal-backup-one-only"))
    try:
        if verify:
            contents, done = upkeep.verify(file), "sound"
        elif restore:
            with working(say("terminal-progress-restoring", file=str(file))):
                contents, done = upkeep.restore(file, store_address(store, config)), "restored"
        else:
            with (
                opened_store(store, config) as opened,
                working(say("terminal-progress-copying", store=opened.label)),
            ):
                contents, done = opened.back_up(file), "written"
                archive = opened.archive()
    except StoreUnavailable as error:
        raise WorkFailed(spoken(error)) from error
    numbers = {"runs": contents.runs, "scans": contents.scans, "fits": contents.fits, "models": contents.models}
    held = say("terminal-backup-contents", **numbers)
    write_line(Message(f"terminal-backup-{done}", {"file": str(file), "contents": held}))
    if archive is not None and archive.runs:
        write_line(say("terminal-backup-archive", runs=archive.runs, folder=archive.folder))
