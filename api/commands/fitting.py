"""`fit`: coefficients of each run and of the campaign."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.inputs import ConfigFile, StoreUrl, load_runs
from api.outputs import as_json, check_writable, working, write_all
from daq.records import InputError

if TYPE_CHECKING:
    from softsensor.campaign import CampaignFit

FitRuns = Annotated[
    list[str] | None, typer.Argument(metavar="RUN...", help="Run files, or ids of runs in the store.")
]
FitPress = Annotated[Path | None, typer.Option("--press", metavar="FILE", help="The press file.")]
Reproduce = Annotated[
    bool,
    typer.Option(
        "--reproduce-paper",
        help="Instead: why gradient least squares got stuck, on 20 virtual measurements; --html draws it.",
    ),
]
MethodName = Annotated[
    str,
    typer.Option("--method", help="Or the paper's: least_squares, nelder_mead, nelder_mead_then_least_squares."),
]
Averages = Annotated[
    bool, typer.Option("--averages", help="With the paper's methods: top and bottom averages, not every sensor.")
]
Program = Annotated[
    list[str] | None,
    typer.Option(
        "--program",
        metavar="KEY=VALUE",
        help="A press program never run, by its settings; its coefficients are predicted from the campaign's.",
    ),
]
ModelOut = Annotated[
    Path | None, typer.Option("--model", metavar="OUT", help="Write the campaign's model file here.")
]
JsonOut = Annotated[Path | None, typer.Option("--json", metavar="OUT", help="Write everything as JSON here.")]
HtmlOut = Annotated[Path | None, typer.Option("--html", metavar="OUT", help="Write a report to read here.")]


def fit(  # noqa: PLR0913 - one argument an option
    runs: FitRuns = None,
    press: FitPress = None,
    model: ModelOut = None,
    json: JsonOut = None,
    html: HtmlOut = None,
    store: StoreUrl = None,
    config: ConfigFile = None,
    method: MethodName = "default",
    averages: Averages = False,
    program: Program = None,
    reproduce_paper: Reproduce = False,
) -> None:
    """Fit the heat transfer coefficients of each run and of the campaign."""
    from daq.pressfile import read_press

    check_writable(model, json, html)
    if reproduce_paper:
        _reproduce(html)
        return
    if not runs or press is None:
        raise InputError("fit needs run files and --press FILE (or --reproduce-paper alone)")
    chosen = check_method(method, averages=averages)
    settings = parse_program(program or [])
    described = read_press(press)
    loaded = load_runs(runs, store, config)
    with working(f"Fitting {len(loaded)} runs", len(loaded)) as done:
        from softsensor.campaign import fit_campaign

        found = fit_campaign(described, loaded, progress=count(done), method=chosen)
        told = predict_program(found, settings)
        outputs: dict[Path, str | bytes | Callable[[Path], None]] = {}
        if json is not None:
            outputs[json] = as_json(found.as_json() | ({"program": told} if told else {}))
        if model is not None:
            from softsensor.modelfile import model_text

            outputs[model] = model_text(found.model_file())
        if html is not None:
            from softsensor.report import fit_report

            outputs[html] = fit_report(found)
        write_all(outputs)
    for line in _lines(found):
        sys.stdout.write(line + "\n")
    for name, values in told.items():
        sys.stdout.write(f"predicted {name} = {values['value']:.4g} ± {values['sd']:.2g} W/m²K\n")


def parse_program(settings: list[str]) -> dict[str, float]:
    """Read ``KEY=VALUE`` settings. Raises `InputError` naming a wrong one."""
    from softsensor.dependence import SETTINGS

    found: dict[str, float] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        if key not in SETTINGS:
            raise InputError(f"--program {setting}: must be KEY=VALUE with KEY one of {', '.join(SETTINGS)}")
        try:
            found[key] = float(value)
        except ValueError:
            raise InputError(f"--program {setting}: {value!r} is no number") from None
    return found


def predict_program(found: CampaignFit, settings: dict[str, float]) -> dict[str, dict[str, float]]:
    """Return the coefficients of a program. Raises `InputError` where the campaign cannot tell."""
    if not settings:
        return {}
    known = found.dependence.settings if found.dependence is not None else ()
    if missing := [key for key in settings if key not in known]:
        raise InputError(
            f"--program: these runs do not vary {', '.join(missing)} enough; give at least 6 runs that do"
        )
    told = found.dependence.predict(settings) if found.dependence is not None else {}
    return {name: {"value": e.value, "sd": e.sd} for name, e in told.items()}


def check_method(method: str, *, averages: bool) -> str:
    """Return the method's full name; refuse an unknown one before any work."""
    from softsensor.paper import METHODS

    if method not in ("default", *METHODS):
        raise InputError(f"--method {method}: must be default, {', '.join(METHODS)}")
    if averages and method == "default":
        raise InputError("--averages goes with one of the paper's methods; give --method too")
    return f"{method}:averages" if averages else method


def _reproduce(html: Path | None) -> None:
    """Compare solvers and slopes on virtual measurements; print the table, and draw it where asked."""
    from softsensor.paper_campaign import MEASUREMENTS, reproduce_paper

    with working(f"{MEASUREMENTS} virtual measurements, four ways each", MEASUREMENTS) as done:
        found = reproduce_paper(progress=done)
    for line in found.lines:
        sys.stdout.write(line + "\n")
    if html is not None:
        from softsensor.report import paper_report

        write_all({html: paper_report(found)})


def count(done: Callable[[int], None]) -> Callable[[str], None]:
    """Turn a progress bar into a function that is told each finished item's name."""
    finished: list[str] = []

    def one_more(name: str) -> None:
        finished.append(name)
        done(len(finished))

    return one_more


def _lines(found: CampaignFit) -> Iterator[str]:
    names = list(found.coefficients)
    rows = [["run", *names, "RMSE", "from"]]
    for run in found.runs:
        cells = [
            f"{run.coefficients[n].value:.4g}{'' if run.coefficients[n].identifiable else '?'}" for n in names
        ]
        rows.append([run.run, *cells, f"{run.rmse_K:.3f} K", f"{run.initial_rmse_K:.2f} K"])
    rows.append(["campaign", *(f"{found.coefficients[n].mean:.4g}" for n in names), "", ""])
    spreads = [f"± {found.coefficients[n].sd:.2g}" if found.coefficients[n].runs > 1 else "" for n in names]
    rows.append(["sd", *spreads, "", ""])
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        yield "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
    yield "W/m²K; ? marks what this run cannot tell. Not fitted: what the press file fixes."
    for run in found.runs:
        for warning in run.warnings:
            yield f"{run.run}: {warning}"
