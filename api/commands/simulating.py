"""`simulate` and `predict`: one run in, one table out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.calling import taking
from api.commands.inputs import ConfigFile, OneRun, PressFile, StoreUrl, files_read, load_runs
from api.outputs import check_writable, warn, working, write_all
from daq.records import InputError
from daq.tables import read_json, reason_of, text_in
from daq.words import say

if TYPE_CHECKING:
    from daq.press.press_file import Press
    from softsensor.heat.model_file import ModelFile

OutCsv = Annotated[Path, typer.Option("--out", metavar="CSV", help="help-out")]
ResinFile = Annotated[Path | None, typer.Option("--resin", metavar="FILE", help="help-resin")]
Model = Annotated[Path | None, typer.Option("--model", metavar="FILE", help="help-model")]


@dataclass(frozen=True)
class SimulateOptions:
    """What `simulate` is called with."""

    run: OneRun
    press: PressFile
    out: OutCsv
    coefficients: Annotated[
        Path | None, typer.Option("--coefficients", metavar="JSON", help="help-coefficients")
    ] = None
    model: Model = None
    store: StoreUrl = None
    config: ConfigFile = None


@taking(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """Simulate a run, open loop, from its platen temperatures."""
    from daq.press.press_file import press_for_run, read_press

    if options.coefficients is not None and options.model is not None:
        raise InputError(say("terminal-coefficients-or-model"))
    check_writable(
        options.out,
        inputs=files_read(
            options.run,
            options.press,
            options.coefficients,
            options.model,
            store=options.store,
            config=options.config,
        ),
    )
    described = read_press(options.press)
    (loaded,) = load_runs([options.run], described, options.store, options.config)
    own = press_for_run(described, loaded)
    with working(say("terminal-progress-simulating", run=loaded.name)):
        from softsensor.fitting.simulated_run import simulate_run
        from softsensor.heat.model import ThermalModel
        from softsensor.heat.run_checks import load_remarks
        from softsensor.jobs.model_files import read_model

        if options.model is not None:
            content = read_model(options.model)
            _check_model((described, own), content, options.model)
            thermal, values = content.model(described), ThermalModel(own).guesses | content.values
        else:
            given = _read_coefficients(options.coefficients, (described, own)) if options.coefficients else {}
            thermal, values = ThermalModel(described), ThermalModel(own).guesses | given
        result = simulate_run(loaded, described, thermal, values)
    columns: dict[str, Any] = {"time_s": result.time_s, "state": [str(s) for s in result.state]}
    columns |= dict(result.places) | {"core_C": result.core}
    write_all({options.out: table_text(columns)})
    for remark in load_remarks(own, loaded):
        warn(remark)


@dataclass(frozen=True)
class PredictOptions:
    """What `predict` is called with."""

    run: OneRun
    press: PressFile
    out: OutCsv
    model: Model = None
    without: Annotated[
        str,
        typer.Option("--without", metavar="COLUMNS", help="help-without"),
    ] = ""
    resin: ResinFile = None
    store: StoreUrl = None
    config: ConfigFile = None


@taking(PredictOptions)
def predict(options: PredictOptions) -> None:
    """Replay a run scan by scan through the live sensor, causally."""
    from daq.press.press_file import press_for_run, read_press
    from daq.press.resin_file import read_resin

    check_writable(
        options.out,
        inputs=files_read(
            options.run, options.press, options.model, options.resin, store=options.store, config=options.config
        ),
    )
    described = read_press(options.press)
    paper = read_resin(options.resin) if options.resin is not None else None
    (loaded,) = load_runs([options.run], described, options.store, options.config)
    with working(say("terminal-progress-predicting", run=loaded.name), len(loaded.time_s)) as done:
        from softsensor.jobs.first_start import WorkKind, compile_for
        from softsensor.jobs.model_files import read_model
        from softsensor.live.panels import panel_remark
        from softsensor.live.replay import replay

        compile_for(WorkKind.LIVE)
        known = read_model(options.model) if options.model is not None else None
        if known is not None:
            _check_model((described, press_for_run(described, loaded)), known, options.model)
        hidden = loaded.named(filter(None, (part.strip() for part in options.without.split(","))))
        columns = replay(described, loaded, known, hidden, done, paper).columns()
    write_all({options.out: table_text(columns)})
    if (remark := panel_remark(loaded.header, known)) is not None:
        warn(remark)
    if paper is not None:
        from softsensor.live.curing import resin_remarks

        for remark in resin_remarks(paper, loaded.header):
            warn(remark)


def _check_model(presses: tuple[Press, Press], model: ModelFile, path: Path | None) -> None:
    """Refuse coefficients the press does not have, raising `InputError`; warn of another press's model."""
    from softsensor.heat.model_reading import check_press

    if (doubt := check_press(model, presses, str(path))) is not None:
        warn(doubt)


def _read_coefficients(path: Path, presses: tuple[Press, Press]) -> dict[str, float]:
    try:
        content = read_json(text_in(path))
    except OSError as error:
        problem = say("terminal-coefficients-unreadable", path=str(path), why=reason_of(error))
        raise InputError(problem) from error
    except (UnicodeDecodeError, InputError) as error:
        raise InputError(say("terminal-coefficients-not-json", path=str(path), why=reason_of(error))) from error
    if not isinstance(content, dict):
        raise InputError(say("terminal-coefficients-no-object", path=str(path)))
    from softsensor.jobs.model_files import coefficients_of

    return coefficients_of(content, presses, str(path))


TEMPERATURE_DIGITS = 3
"""After the point [°C]: a hundredth of a logger's usual step of 0.1 K, so that slopes read off stay smooth."""
DIGITS = {"time_s": 6, "cure_top": 6, "cure_bottom": 6, "cure_low": 6}
"""Of columns that are no temperature or pressure: microseconds, and degrees of cure from 0 to 1."""


def table_text(columns: Mapping[str, Any]) -> str:
    """Return a table as CSV, each number with the digits it has; a value that is missing is an empty cell."""
    from daq.files.run_file import csv_cell

    def cell(name: str, value: Any) -> str:
        if isinstance(value, str):
            return csv_cell(value)
        if isinstance(value, int):
            return str(value)
        number = float(value)
        return repr(round(number, DIGITS.get(name, TEMPERATURE_DIGITS))) if math.isfinite(number) else ""

    rows = zip(*columns.values(), strict=True)
    lines = [",".join(map(csv_cell, columns)), *(",".join(map(cell, columns, row)) for row in rows)]
    return "\n".join(lines) + "\n"
