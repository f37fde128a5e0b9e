"""`fit`: coefficients of each run and of the campaign."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.calling import taking
from api.commands.inputs import ConfigFile, StoreUrl, files_read, load_runs, stored_runs
from api.commands.until import Until, shortened
from api.outputs import as_json, check_writable, in_words, spoken_language, working, write_all, write_line
from daq.records import InputError
from daq.words import Message, say

if TYPE_CHECKING:
    from softsensor.fitting.campaign import CampaignFit
    from softsensor.fitting.dependence import Program
    from softsensor.fitting.result import RunFit


HEADS = ("run", "from", "mean", "sd", "joint-median")
"""What begins the rows and columns of the table at the terminal, by their codes ``terminal-fit-…``."""


def named_folder(text: str) -> Path:
    """Return a folder by its name; an empty one would be the folder we are in. Raises `InputError`."""
    if not text.strip():
        raise InputError(say("terminal-folder-name-empty"))
    return Path(text)


MOST_OF_A_SETTING = 1e4
"""No thickness, pressure or temperature of a press program reaches it, in the unit of its key."""
Outputs = dict[Path, str | bytes | Callable[[Path], None]]
FitRuns = Annotated[list[str] | None, typer.Argument(metavar="RUN", help="help-runs", autocompletion=stored_runs)]
FitPress = Annotated[Path | None, typer.Option("--press", metavar="FILE", help="help-press")]
Reproduce = Annotated[
    bool,
    typer.Option(
        "--reproduce-paper",
        help="help-reproduce-paper",
    ),
]


def method_names(incomplete: str) -> list[str]:
    """Return the methods of a fit that begin as typed, for Tab."""
    from softsensor.fitting.paper.procedures import METHODS

    return [name for name in ("default", *METHODS) if name.startswith(incomplete)]


MethodName = Annotated[
    str,
    typer.Option("--method", metavar="NAME", help="help-method", autocompletion=method_names),
]
Averages = Annotated[bool, typer.Option("--averages", help="help-averages")]
Shared = Annotated[
    list[str] | None,
    typer.Option("--shared", metavar="NAME", help="help-shared"),
]
ProgramSettings = Annotated[
    list[str] | None,
    typer.Option(
        "--program",
        metavar="KEY=VALUE",
        help="help-program",
    ),
]
ModelOut = Annotated[Path | None, typer.Option("--model", metavar="OUT", help="help-model-out")]
JsonOut = Annotated[Path | None, typer.Option("--json", metavar="OUT", help="help-json")]
HtmlOut = Annotated[Path | None, typer.Option("--html", metavar="OUT", help="help-html")]
SvgOut = Annotated[
    Path | None,
    typer.Option(
        "--svg",
        metavar="FOLDER",
        parser=named_folder,
        help="help-svg",
    ),
]


@dataclass(frozen=True)
class FitOptions:
    """What `fit` is called with."""

    runs: FitRuns = None
    press: FitPress = None
    model: ModelOut = None
    json: JsonOut = None
    html: HtmlOut = None
    svg: SvgOut = None
    store: StoreUrl = None
    config: ConfigFile = None
    method: MethodName = "default"
    averages: Averages = False
    shared: Shared = None
    program: ProgramSettings = None
    until: Until = None
    reproduce_paper: Reproduce = False


@taking(FitOptions)
def fit(options: FitOptions) -> None:
    """Fit the heat transfer coefficients of each run and of the campaign."""
    from daq.press.press_file import read_press

    check_writable(
        options.model,
        options.json,
        options.html,
        inputs=files_read(*(options.runs or ()), options.press, store=options.store, config=options.config),
    )
    check_folder(options.svg, options.model, options.json, options.html)
    if options.reproduce_paper:
        refuse_with_reproduce(options)
        _reproduce(options)
        return
    if not options.runs or options.press is None:
        raise InputError(say("terminal-fit-needs-runs"))
    from softsensor.fitting.options import check_shared, full_method

    described = read_press(options.press)
    chosen = full_method(options.method, averages=options.averages, dashes="--")
    settings = parse_program(options.program or [])
    check_shared(described, options.shared or [], dashes="--")
    loaded = shortened(load_runs(options.runs, described, options.store, options.config), described, options.until)
    with working(say("terminal-progress-fitting", runs=len(loaded)), len(loaded)) as done:
        from softsensor.jobs.campaign import fit_campaign

        found = fit_campaign(
            described,
            loaded,
            shared=options.shared or (),
            profiles=options.json is not None or options.html is not None,
            progress=count(done),
            method=chosen,
        )
        program = predict_program(found, settings)
        write_all(contents(found, program, options))
    for line in _lines(found):
        write_line(line)
    for row in program.lines if program is not None else ():
        write_line(row)


def contents(found: CampaignFit, program: Program | None, options: FitOptions) -> Outputs:
    """Return what goes into each file that was asked for."""
    outputs: Outputs = {}
    if options.json is not None:
        outputs[options.json] = as_json(found.as_json() | ({"program": program.as_json()} if program else {}))
    if options.model is not None:
        from softsensor.diagnosis.missing_causes import with_missing_causes
        from softsensor.heat.model_file import model_text

        outputs[options.model] = model_text(with_missing_causes(found.model_file(), found.runs))
    if options.html is not None:
        from softsensor.report.fit_report import fit_report

        outputs[options.html] = fit_report(found, program, spoken_language())
    if options.svg is not None:
        from softsensor.report.fit_figures import campaign_figures

        outputs |= into(options.svg, campaign_figures(found, spoken_language()))
    return outputs


def refuse_with_reproduce(options: FitOptions) -> None:
    """Raise `InputError` for arguments that the reproduction of the paper would ignore."""
    ignored = (f for f in fields(options) if f.name not in ("json", "html", "svg", "reproduce_paper"))
    surplus = [f.name for f in ignored if (value := getattr(options, f.name)) and value != f.default]
    if surplus:
        given = tuple("RUN" if name == "runs" else f"--{name}" for name in surplus)
        raise InputError(say("terminal-reproduce-alone", surplus=given))


def check_folder(folder: Path | None, *others: Path | None) -> None:
    """Refuse a folder for figures that cannot be made, or other outputs that a figure in it might overwrite.

    Raises `InputError`, before any work is done.
    """
    if folder is None:
        return
    for path in others:
        if path is not None and path.suffix.lower() == ".svg" and path.absolute().parent == folder.absolute():
            raise InputError(say("terminal-file-among-figures", path=str(path), folder=str(folder)))
    if folder.exists() and not folder.is_dir():
        raise InputError(say("terminal-folder-is-a-file", folder=str(folder)))
    check_writable(folder / "figure.svg" if folder.is_dir() else folder)


def into(folder: Path, figures: Mapping[str, str]) -> dict[Path, str]:
    """Make the folder and return where each figure goes: its name, kept to what every file system takes."""
    folder.mkdir(exist_ok=True)
    return {folder / (re.sub(r"[^\w.-]+", "_", name) + ".svg"): text for name, text in figures.items()}


def parse_program(settings: list[str]) -> dict[str, float]:
    """Read ``KEY=VALUE`` settings. Raises `InputError` naming a wrong one."""
    found: dict[str, float] = {}
    if not settings:
        return found
    from softsensor.fitting.dependence import SETTINGS  # loads slowly

    for setting in settings:
        key, _, value = setting.partition("=")
        if key in found:
            raise InputError(say("terminal-program-key-twice", setting=setting, key=key))
        if key not in SETTINGS:
            raise InputError(say("terminal-program-unknown-key", setting=setting, known=tuple(SETTINGS)))
        try:
            found[key] = float(value)
        except ValueError:
            raise InputError(say("terminal-program-no-number", setting=setting, value=value)) from None
        if not 0.0 < found[key] < MOST_OF_A_SETTING:
            most, unit = MOST_OF_A_SETTING, SETTINGS[key][0]
            raise InputError(say("terminal-program-out-of-range", setting=setting, most=most, unit=unit))
    return found


def predict_program(found: CampaignFit, settings: dict[str, float]) -> Program | None:
    """Return the coefficients of a program. Raises `InputError` where the campaign cannot show them."""
    if not settings:
        return None
    known = found.dependence.settings if found.dependence is not None else ()
    if found.dependence is None or (missing := [key for key in settings if key not in known]):
        unknown = tuple(missing if found.dependence is not None else settings)
        raise InputError(say("terminal-program-not-known", runs=len(found.runs), settings=unknown))
    return found.program(settings)


def _reproduce(options: FitOptions) -> None:
    """Compare solvers and slopes on virtual measurements; print the table, and keep it where asked."""
    from softsensor.fitting.paper.virtual_runs import MEASUREMENTS, reproduce_paper

    with working(say("terminal-progress-reproducing", runs=MEASUREMENTS), MEASUREMENTS) as done:
        found = reproduce_paper(clock=time.perf_counter, progress=done)
        outputs: Outputs = {}
        if options.json is not None:
            outputs[options.json] = as_json(found.as_json())
        if options.html is not None:
            from softsensor.report.fit_report import paper_report

            outputs[options.html] = paper_report(found, spoken_language())
        if options.svg is not None:
            from softsensor.report.fit_figures import roughness_figure
            from softsensor.report.fit_figures import svg as picture

            outputs |= into(options.svg, {"cost": picture(roughness_figure(found, spoken_language()))})
        write_all(outputs)
    heads = [in_words(say(f"report-paper-{column}")) for column in found.rows[0]]
    for line in aligned([heads, *([in_words(cell) for cell in row.values()] for row in found.rows)]):
        write_line(line)
    write_line(found.message)


def count(done: Callable[[int], None]) -> Callable[[str], None]:
    """Turn a progress bar into a function that takes each finished item's name."""
    finished: list[str] = []

    def one_more(name: str) -> None:
        finished.append(name)
        done(len(finished))

    return one_more


def aligned(rows: list[list[str]]) -> Iterator[str]:
    """Yield the lines of a table, its cells to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _figure(value: float, digits: int) -> str:
    """Return a number with so many significant digits: 2, 3 or 4."""
    return in_words(Message("report-number" if digits == 4 else f"report-number-{digits}", {"value": value}))


def _decimals(value: float, digits: int) -> str:
    return in_words(say("report-decimals", value=value, digits=digits))


def _lines(found: CampaignFit) -> Iterator[str]:
    if found.shortfall:
        yield in_words(found.shortfall)
    names = list(found.coefficients)
    heads = {name: in_words(say(f"terminal-fit-{name}")) for name in HEADS}
    rows = [[heads["run"], *names, "RMSE", heads["from"]]]
    for run in found.runs:
        cells = [
            f"{_figure(run.coefficients[n].value, 4)}{'' if run.coefficients[n].identifiable else '?'}"
            for n in names
        ]
        cells = cells if run.met else ["–" for _ in names]
        remark = "" if run.met else f" {in_words(say('report-not-described'))}"
        remark += "" if run.converged else f" {in_words(say('report-not-converged'))}"
        rows.append(
            [run.run, *cells, f"{_decimals(run.rmse_K, 3)} K", f"{_decimals(run.initial_rmse_K, 2)} K{remark}"]
        )
    summary = found.coefficients.values()
    known = [f"{_figure(c.mean, 4)}{'' if c.runs else '?'}" for c in summary]
    if len(found.runs) > 1:
        rows.append([heads["mean"], *known, "", ""])
        rows.append(
            [heads["sd"], *(f"± {_figure(c.sd, 2)}" if c.runs > 1 and c.sd > 0.0 else "" for c in summary), "", ""]
        )
        rows.append([heads["joint-median"], *(_figure(c.median, 4) for c in summary), "", ""])
        spans = [c.median_ci95 for c in summary]
    else:
        spans = [found.runs[0].coefficients[n].ci95 for n in names]
    rows.append(["95 %", *(f"{_figure(low, 3)} … {_figure(high, 3)}" for low, high in spans), "", ""])
    yield from aligned(rows)
    yield in_words(say("terminal-fit-legend"))
    if len(found.runs) > 1:
        yield in_words(say("terminal-fit-legend-campaign"))
    if found.shared:
        yield in_words(say("terminal-fit-shared", names=found.shared))
    yield from remark_lines(found.runs)


def remark_lines(runs: Sequence[RunFit]) -> Iterator[str]:
    """Yield what is to be remarked on runs; what several have in common takes one line, and one run for all."""
    from softsensor.fitting.remarks import remarks_together

    remarks = tuple(remarks_together({run.run: run.warnings for run in runs}))
    yield from map(in_words, remarks)
    if any(remark.code == "terminal-fit-remark-of" for remark in remarks):
        yield in_words(say("terminal-fit-remarks-kept"))
