"""`simulate` and `predict`: one run in, one table out."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.inputs import ConfigFile, OneRun, PressFile, StoreUrl, files_read, load_run
from api.outputs import check_writable, working, write_all
from daq.records import InputError

if TYPE_CHECKING:
    from daq.pressfile import Press
    from daq.records import Run
    from softsensor.modelfile import ModelFile

OutCsv = Annotated[Path, typer.Option("--out", metavar="CSV", help="Where to write the table.")]
Model = Annotated[
    Path | None, typer.Option("--model", metavar="FILE", help="A model file, as `fit` and `diagnose` write it.")
]


def simulate(
    run: OneRun,
    press: PressFile,
    out: OutCsv,
    coefficients: Annotated[
        Path | None, typer.Option("--coefficients", metavar="JSON", help="A flat {NAME: value}.")
    ] = None,
    model: Model = None,
    store: StoreUrl = None,
    config: ConfigFile = None,
) -> None:
    """Simulate a run, open loop, from its platen temperatures."""
    from daq.pressfile import press_for_run, read_press

    if coefficients is not None and model is not None:
        raise InputError("--coefficients and --model exclude each other; give one")
    check_writable(out, inputs=files_read(run, press, coefficients, model, store=store, config=config))
    described = read_press(press)
    loaded = load_run(run, store, config)
    own = press_for_run(described, loaded)
    with working(f"Simulating {loaded.name}"):
        from api.simulation import simulate_run
        from softsensor.admission import load_remarks
        from softsensor.model import ThermalModel
        from softsensor.modelfile import read_model

        if model is not None:
            content = read_model(model)
            _check_model((described, own), content, model)
            thermal, values = content.model(described), content.values
        else:
            given = _read_coefficients(coefficients, (described, own)) if coefficients else {}
            thermal, values = ThermalModel(described), ThermalModel(own).guesses | given
        result = simulate_run(loaded, described, thermal, values)
    columns: dict[str, Any] = {"time_s": result.time_s, "state": [str(s) for s in result.state]}
    columns |= dict(result.places) | {"core_C": result.core}
    write_all({out: _csv(columns)})
    for remark in load_remarks(own, loaded):
        sys.stderr.write(f"kerntemp: {remark}\n")


def predict(
    run: OneRun,
    press: PressFile,
    out: OutCsv,
    model: Model = None,
    without: Annotated[
        str,
        typer.Option("--without", metavar="COLUMNS", help="Columns to hide, comma between; patterns allowed."),
    ] = "",
    store: StoreUrl = None,
    config: ConfigFile = None,
) -> None:
    """Replay a run scan by scan through the live sensor, causally."""
    from daq.pressfile import press_for_run, read_press

    check_writable(out, inputs=files_read(run, press, model, store=store, config=config))
    described = read_press(press)
    loaded = load_run(run, store, config)
    hidden = _hidden(loaded, without) | set(described.sensors_of(loaded, "validation"))
    seen = {name: values for name, values in loaded.columns.items() if name not in hidden}
    with working(f"Predicting {loaded.name}", len(loaded.time_s)) as done:
        from softsensor.modelfile import read_model
        from softsensor.observer import LiveSensor

        _check_run(described, loaded, seen)
        known = read_model(model) if model is not None else None
        if known is not None:
            _check_model((described, press_for_run(described, loaded)), known, model)
        sensor = LiveSensor(described, loaded.header, known)
        rows = []
        for i, time_s in enumerate(loaded.time_s.tolist()):
            rows.append(sensor.update(time_s, {name: float(values[i]) for name, values in seen.items()}))
            done(i + 1)
    columns: dict[str, Any] = {
        "time_s": [row.time_s for row in rows],
        "state": ["unknown" if row.state is None else str(row.state) for row in rows],
    }
    for name in ("core_C", "core_sd_K", "core_low_C", "core_high_C"):
        columns[name] = [getattr(row, name) for row in rows]
    columns["valid"] = ["1" if row.valid else "0" for row in rows]
    columns["reason"] = [row.reason for row in rows]
    write_all({out: _csv(columns)})


def _check_run(press: Press, run: Run, seen: Mapping[str, Any]) -> None:
    """Refuse a run that this press cannot predict: no platen reading, no panel. Raises `InputError`."""
    from daq.pressfile import panel_of, press_for_run

    own = press_for_run(press, run)
    for end in ("bottom", "top"):
        boundary = getattr(own.boundary, end)
        if boundary.kind == "measured" and boundary.column not in seen:
            raise InputError(
                f"{run.source or run.name}: column {boundary.column!r} is missing; boundary.{end} of press "
                f"{press.name!r} needs it (used are {', '.join(seen)})"
            )
    if own.panel_layers:
        panel_of(run)


def _check_model(presses: tuple[Press, Press], model: ModelFile, path: Path | None) -> None:
    """Refuse coefficients the press does not have, raising `InputError`; warn of another press's model."""
    _check_names(presses, model.coefficients, str(path))
    if model.press not in ("", presses[0].name):
        sys.stderr.write(
            f"kerntemp: {path} is of press {model.press!r}, the press file is of {presses[0].name!r}: "
            "coefficients of another press make a wrong core look certain; fit this press's own runs\n"
        )


def _hidden(run: Run, without: str) -> set[str]:
    """Return the columns a comma-separated list of patterns names. Raises `InputError` where one names none."""
    hidden: set[str] = set()
    for pattern in filter(None, (part.strip() for part in without.split(","))):
        found = run.matching([pattern])
        if not found:
            raise InputError(f"--without {pattern}: run {run.name!r} has none; it has {', '.join(run.columns)}")
        hidden |= set(found)
    return hidden


def _read_coefficients(path: Path, presses: tuple[Press, Press]) -> dict[str, float]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the coefficients: {error.strerror}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: must be an object {{NAME: value}}")
    for name, value in content.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e9:
            raise InputError(f"{path}: {name} = {value!r}: must be a number above 0 in W/m²K")
    _check_names(presses, content, str(path))
    return {name: float(value) for name, value in content.items()}


def _check_names(presses: tuple[Press, Press], given: Mapping[str, Any], where: str) -> None:
    """Refuse a coefficient that neither the press file nor the run's own press has. Raises `InputError`."""
    names = dict.fromkeys(name for press in presses for name in press.coefficient_names)
    if unknown := [name for name in given if name not in names]:
        raise InputError(
            f"{where}: {unknown[0]}: press {presses[0].name!r} has no such coefficient; it has {', '.join(names)}"
        )


def _csv(columns: Mapping[str, Any]) -> str:
    """Return a table as CSV; a value that is missing is an empty cell."""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns)]
    lines += [",".join(_cell(value) for value in row) for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"' if "," in value or '"' in value else value
    number = float(value)
    return repr(round(number, 6)) if math.isfinite(number) else ""
