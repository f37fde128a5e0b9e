"""`fit`: coefficients of each run and of the campaign."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.inputs import ConfigFile, PressFile, Runs, StoreUrl, load_runs
from api.outputs import as_json, check_writable, working, write_all

if TYPE_CHECKING:
    from softsensor.campaign import CampaignFit

ModelOut = Annotated[
    Path | None, typer.Option("--model", metavar="OUT", help="Write the campaign's model file here.")
]
JsonOut = Annotated[Path | None, typer.Option("--json", metavar="OUT", help="Write everything as JSON here.")]
HtmlOut = Annotated[Path | None, typer.Option("--html", metavar="OUT", help="Write a report to read here.")]


def fit(
    runs: Runs,
    press: PressFile,
    model: ModelOut = None,
    json: JsonOut = None,
    html: HtmlOut = None,
    store: StoreUrl = None,
    config: ConfigFile = None,
) -> None:
    """Fit the heat transfer coefficients of each run and of the campaign."""
    from daq.pressfile import read_press

    check_writable(model, json, html)
    described = read_press(press)
    loaded = load_runs(runs, store, config)
    with working(f"Fitting {len(loaded)} runs", len(loaded)) as done:
        from softsensor.campaign import fit_campaign

        found = fit_campaign(described, loaded, progress=count(done))
        outputs: dict[Path, str | bytes | Callable[[Path], None]] = {}
        if json is not None:
            outputs[json] = as_json(found.as_json())
        if model is not None:
            from softsensor.modelfile import model_text

            outputs[model] = model_text(found.model_file())
        write_all(outputs)
    for line in _lines(found):
        sys.stdout.write(line + "\n")


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
