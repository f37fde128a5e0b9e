"""`fit`: coefficients of each run and of the campaign."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.inputs import ConfigFile, StoreUrl, files_read, load_runs
from api.outputs import as_json, check_writable, working, write_all
from daq.records import InputError

if TYPE_CHECKING:
    from daq.pressfile import Press
    from softsensor.campaign import CampaignFit
    from softsensor.dependence import Program


def named_folder(text: str) -> Path:
    """Return a folder by its name; an empty one would be the folder we are in. Raises `BadParameter`."""
    if not text.strip():
        raise typer.BadParameter("the folder's name is empty; give one, or . for the folder you are in")
    return Path(text)


Outputs = dict[Path, str | bytes | Callable[[Path], None]]
FitRuns = Annotated[
    list[str] | None, typer.Argument(metavar="RUN...", help="Run files, or ids of runs in the store.")
]
FitPress = Annotated[Path | None, typer.Option("--press", metavar="FILE", help="The press file.")]
Reproduce = Annotated[
    bool,
    typer.Option(
        "--reproduce-paper",
        help="Instead: why gradient least squares got stuck, on 20 virtual measurements; the table is printed, "
        "--json, --html and --svg keep it and the cost along one coefficient.",
    ),
]
MethodName = Annotated[
    str,
    typer.Option("--method", help="Or the paper's: least_squares, nelder_mead, nelder_mead_then_least_squares."),
]
Averages = Annotated[
    bool, typer.Option("--averages", help="With the paper's methods: top and bottom averages, not every sensor.")
]
Shared = Annotated[
    list[str] | None,
    typer.Option("--shared", metavar="NAME", help="A coefficient with one value in all runs; may be repeated."),
]
ProgramSettings = Annotated[
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
SvgOut = Annotated[
    Path | None,
    typer.Option(
        "--svg",
        metavar="FOLDER",
        parser=named_folder,
        help="Write every figure into this folder as SVG.",
    ),
]


def fit(  # noqa: PLR0913 - one argument an option
    runs: FitRuns = None,
    press: FitPress = None,
    model: ModelOut = None,
    json: JsonOut = None,
    html: HtmlOut = None,
    svg: SvgOut = None,
    store: StoreUrl = None,
    config: ConfigFile = None,
    method: MethodName = "default",
    averages: Averages = False,
    shared: Shared = None,
    program: ProgramSettings = None,
    reproduce_paper: Reproduce = False,
) -> None:
    """Fit the heat transfer coefficients of each run and of the campaign."""
    from daq.pressfile import read_press

    check_writable(model, json, html, inputs=files_read(*(runs or ()), press, store=store, config=config))
    check_folder(svg, model, json, html)
    if reproduce_paper:
        refuse_with_reproduce(
            {"RUN": runs, "--press": press, "--model": model, "--store": store, "--config": config}
            | {"--method": method != "default", "--averages": averages, "--shared": shared, "--program": program}
        )
        _reproduce(json, html, svg)
        return
    if not runs or press is None:
        raise InputError("fit needs run files and --press FILE (or --reproduce-paper alone)")
    chosen = check_method(method, averages=averages)
    settings = parse_program(program or [])
    described = read_press(press)
    check_shared(described, shared or [])
    loaded = load_runs(runs, store, config)
    with working(f"Fitting {runs_of(len(loaded))}", len(loaded)) as done:
        from softsensor.campaign import fit_campaign

        found = fit_campaign(
            described,
            loaded,
            shared=shared or (),
            profiles=json is not None or html is not None,
            progress=count(done),
            method=chosen,
        )
        told = predict_program(found, settings)
        write_all(contents(found, told, model=model, json=json, html=html, svg=svg))
    for line in _lines(found):
        sys.stdout.write(line + "\n")
    if told is not None:
        for line in told.lines:
            sys.stdout.write(line + "\n")


def contents(
    found: CampaignFit,
    told: Program | None,
    *,
    model: Path | None,
    json: Path | None,
    html: Path | None,
    svg: Path | None,
) -> Outputs:
    """Return what goes into each file that was asked for."""
    outputs: Outputs = {}
    if json is not None:
        outputs[json] = as_json(found.as_json() | ({"program": told.as_json()} if told else {}))
    if model is not None:
        from softsensor.adequacy import with_adequacy
        from softsensor.modelfile import model_text

        outputs[model] = model_text(with_adequacy(found.model_file(), found.runs))
    if html is not None:
        from softsensor.report import fit_report

        outputs[html] = fit_report(found, told)
    if svg is not None:
        from softsensor.figures import campaign_figures

        outputs |= into(svg, campaign_figures(found))
    return outputs


def refuse_with_reproduce(given: Mapping[str, object]) -> None:
    """Raise `InputError` for arguments that the reproduction of the paper would ignore."""
    if surplus := [name for name, value in given.items() if value]:
        raise InputError(
            f"--reproduce-paper makes its own measurements and does not take {', '.join(surplus)}; "
            "it goes with --json, --html and --svg"
        )


def check_folder(folder: Path | None, *others: Path | None) -> None:
    """Refuse a folder for figures that cannot be made, or other outputs that a figure in it might overwrite.

    Raises `InputError`, before any work is done.
    """
    if folder is None:
        return
    for path in others:
        if path is not None and path.suffix.lower() == ".svg" and path.absolute().parent == folder.absolute():
            raise InputError(f"{path}: lies among the figures of --svg {folder}; give it another place or ending")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--svg {folder}: is a file; give a folder")
    check_writable(folder / "figure.svg" if folder.is_dir() else folder)


def into(folder: Path, figures: Mapping[str, str]) -> dict[Path, str]:
    """Make the folder and return where each figure goes: its name, kept to what every file system takes."""
    folder.mkdir(exist_ok=True)
    return {folder / (re.sub(r"[^\w.-]+", "_", name) + ".svg"): text for name, text in figures.items()}


def check_shared(press: Press, shared: list[str]) -> None:
    """Raise `InputError` for a shared coefficient that the press file does not leave free."""
    free = [n for n in press.coefficient_names if not press.coefficient(n).fixed]
    if wrong := [name for name in shared if name not in free]:
        raise InputError(f"--shared {wrong[0]}: must be one of {', '.join(free) or 'none, all are fixed'}")


def parse_program(settings: list[str]) -> dict[str, float]:
    """Read ``KEY=VALUE`` settings. Raises `InputError` naming a wrong one."""
    from softsensor.dependence import SETTINGS

    found: dict[str, float] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        if key in found:
            raise InputError(f"--program {setting}: {key} is given twice; a program has one value of it")
        if key not in SETTINGS:
            raise InputError(f"--program {setting}: must be KEY=VALUE with KEY one of {', '.join(SETTINGS)}")
        try:
            found[key] = float(value)
        except ValueError:
            raise InputError(f"--program {setting}: {value!r} is no number") from None
        if not 0.0 < found[key] < 1e4:
            raise InputError(f"--program {setting}: must lie between 0 and 10000 {SETTINGS[key][0]}")
    return found


def predict_program(found: CampaignFit, settings: dict[str, float]) -> Program | None:
    """Return the coefficients of a program. Raises `InputError` where the campaign cannot tell."""
    if not settings:
        return None
    known = found.dependence.settings if found.dependence is not None else ()
    if found.dependence is None or (missing := [key for key in settings if key not in known]):
        unknown = ", ".join(missing if found.dependence is not None else settings)
        raise InputError(
            f"--program: {runs_of(len(found.runs))} cannot show what {unknown} does; give at least 8 runs that "
            "differ in it (6 where only one setting varies)"
        )
    return found.program(settings)


def check_method(method: str, *, averages: bool) -> str:
    """Return the method's full name; refuse an unknown one before any work."""
    from softsensor.paper import METHODS

    if method not in ("default", *METHODS):
        raise InputError(f"--method {method}: must be default, {', '.join(METHODS)}")
    if averages and method == "default":
        raise InputError("--averages goes with one of the paper's methods; give --method too")
    return f"{method}:averages" if averages else method


def _reproduce(json: Path | None, html: Path | None, svg: Path | None) -> None:
    """Compare solvers and slopes on virtual measurements; print the table, and keep it where asked."""
    from softsensor.paper_campaign import MEASUREMENTS, reproduce_paper

    with working(f"{MEASUREMENTS} virtual measurements, four ways each", MEASUREMENTS) as done:
        found = reproduce_paper(progress=done)
        outputs: Outputs = {}
        if json is not None:
            outputs[json] = as_json(found.as_json())
        if html is not None:
            from softsensor.report import paper_report

            outputs[html] = paper_report(found)
        if svg is not None:
            from softsensor.figures import roughness_figure
            from softsensor.figures import svg as picture

            outputs |= into(svg, {"cost": picture(roughness_figure(found))})
        write_all(outputs)
    for line in found.lines:
        sys.stdout.write(line + "\n")


def runs_of(number: int) -> str:
    """Return how many runs, in words that agree."""
    return "one run" if number == 1 else f"{number} runs"


def count(done: Callable[[int], None]) -> Callable[[str], None]:
    """Turn a progress bar into a function that is told each finished item's name."""
    finished: list[str] = []

    def one_more(name: str) -> None:
        finished.append(name)
        done(len(finished))

    return one_more


def _lines(found: CampaignFit) -> Iterator[str]:
    from softsensor.parameters import plain

    if found.shortfall:
        yield found.shortfall
    names = list(found.coefficients)
    rows = [["run", *names, "RMSE", "from"]]
    for run in found.runs:
        cells = [
            f"{plain(run.coefficients[n].value, 4)}{'' if run.coefficients[n].identifiable else '?'}"
            for n in names
        ]
        cells = cells if run.met else ["–" for _ in names]
        remark = "" if run.met else " not described"
        remark += "" if run.converged else " not converged"
        rows.append([run.run, *cells, f"{run.rmse_K:.3f} K", f"{run.initial_rmse_K:.2f} K{remark}"])
    summary = found.coefficients.values()
    known = [f"{plain(c.mean, 4)}{'' if c.runs else '?'}" for c in summary]
    if len(found.runs) > 1:
        rows.append(["mean", *known, "", ""])
        rows.append(["sd", *(f"± {plain(c.sd, 2)}" if c.runs > 1 and c.sd > 0.0 else "" for c in summary), "", ""])
        rows.append(["joint median", *(f"{plain(c.median, 4)}" for c in summary), "", ""])
        ends = [f"{plain(c.median_ci95[0], 3)} to {plain(c.median_ci95[1], 3)}" for c in summary]
        rows.append(["95 %", *ends, "", ""])
    else:
        spans = [found.runs[0].coefficients[n].ci95 for n in names]
        ends = [f"{plain(low, 3)} to {plain(high, 3)}" for low, high in spans]
        rows.append(["95 %", *ends, "", ""])
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        yield "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
    yield "W/m²K; ? marks what the run, or no run, can tell. Not fitted: what the press file fixes."
    if len(found.runs) > 1:
        yield "Mean and sd: over the runs that can tell. Joint median: all runs together, with its 95 % interval."
    if found.shared:
        yield f"One value in all runs, with one interval: {', '.join(found.shared)}."
    for run in found.runs:
        for warning in run.warnings:
            yield f"{run.run}: {warning}"
