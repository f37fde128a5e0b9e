"""`blisters`: the steam that panels bear, learned from those marked good or blistered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from api.commands.calling import taking
from api.commands.fitting import JsonOut
from api.commands.inputs import ConfigFile, PressFile, Runs, StoreUrl, files_read, load_runs
from api.commands.simulating import Model
from api.outputs import as_json, check_writable, working, write_all, write_line
from daq.words import say


@dataclass(frozen=True)
class BlistersOptions:
    """What `blisters` is called with."""

    runs: Runs
    press: PressFile
    resin: Annotated[Path, typer.Option("--resin", metavar="FILE", help="help-advice-resin")]
    model: Model = None
    json: JsonOut = None
    store: StoreUrl = None
    config: ConfigFile = None


@taking(BlistersOptions)
def blisters(options: BlistersOptions) -> None:
    """Learn from marked panels how much steam they bear."""
    from daq.press.press_file import read_press
    from daq.press.resin_file import read_resin

    read = (*options.runs, options.press, options.resin, options.model)
    check_writable(options.json, inputs=files_read(*read, store=options.store, config=options.config))
    described, paper = read_press(options.press), read_resin(options.resin)
    loaded = load_runs(options.runs, described, options.store, options.config)
    with working(say("terminal-progress-blisters", runs=len(loaded))):
        from softsensor.face.learning import learn_steam_limit
        from softsensor.jobs.model_files import read_model
        from softsensor.opening.blisters import limit_messages

        known = read_model(options.model) if options.model is not None else None
        found = learn_steam_limit(loaded, described, known, resin=paper)
        write_all({} if options.json is None else {options.json: as_json(found.as_json())})
    for line in limit_messages(found):
        write_line(line)
