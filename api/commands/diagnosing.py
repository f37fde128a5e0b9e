"""`diagnose`: what the simulation gets wrong, the cause by name, the extended model, the gain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.calling import taking
from api.commands.fitting import HtmlOut, JsonOut, ModelOut, Outputs, aligned
from api.commands.inputs import ConfigFile, PressFile, Runs, StoreUrl, effect_names, files_read, load_runs
from api.commands.until import Until, shortened
from api.outputs import (
    WorkFailed,
    as_json,
    check_writable,
    in_words,
    spoken_language,
    working,
    write_all,
    write_line,
)
from daq.records import InputError
from daq.tables import reason_of
from daq.words import say

if TYPE_CHECKING:
    from daq.press.press_file import Press
    from softsensor.diagnosis.finding import Diagnosis
    from softsensor.diagnosis.rehearsal import Rehearsal
    from softsensor.jobs.rehearsals import RehearsalPlan

FreeLaw = Annotated[bool, typer.Option("--law", help="help-law")]
Rehearse = Annotated[bool, typer.Option("--rehearse", help="help-rehearse")]
RehearseCampaigns = Annotated[
    int | None, typer.Option("--rehearse-campaigns", metavar="N", min=1, max=1000, help="help-rehearse-campaigns")
]
RehearseEffects = Annotated[
    list[str] | None,
    typer.Option(
        "--rehearse-effect", metavar="NAME[=SIZE]", help="help-rehearse-effect", autocompletion=effect_names
    ),
]
RehearseFile = Annotated[Path | None, typer.Option("--rehearse-file", metavar="FILE", help="help-rehearse-file")]
Dask = Annotated[str, typer.Option("--dask", metavar="ADDRESS", help="help-rehearse-dask")]

PLANNED = 2
"""Open causes of which the best pressing is shown, at most."""


@dataclass(frozen=True)
class DiagnoseOptions:
    """What `diagnose` is called with."""

    runs: Runs
    press: PressFile
    model: ModelOut = None
    json: JsonOut = None
    html: HtmlOut = None
    until: Until = None
    store: StoreUrl = None
    config: ConfigFile = None
    law: FreeLaw = False
    rehearse: Rehearse = False
    rehearse_campaigns: RehearseCampaigns = None
    rehearse_effect: RehearseEffects = None
    rehearse_file: RehearseFile = None
    dask: Dask = ""


@taking(DiagnoseOptions)
def diagnose(options: DiagnoseOptions) -> None:
    """Say what the simulation gets wrong, why, what that costs, and what to measure next."""
    from daq.press.press_file import read_press

    check_writable(
        options.model,
        options.json,
        options.html,
        options.rehearse_file,
        inputs=files_read(*options.runs, options.press, store=options.store, config=options.config),
    )
    _check_rehearsal(options)
    described = read_press(options.press)
    loaded = shortened(load_runs(options.runs, described, options.store, options.config), described, options.until)
    with working(say("terminal-progress-diagnosing", runs=len(loaded)), 100) as done:
        from softsensor.diagnosis.verdict import diagnose as look

        found = look(
            described,
            loaded,
            progress=lambda _what, share: done(round(100 * share)),
            law=True if options.law else None,
        )
    with working(say("terminal-progress-writing")):
        ahead = list(_ahead(described, found))
    for line in (*_lines(found), *ahead):
        write_line(line)
    rehearsal = None
    try:
        if options.rehearse:
            rehearsal = _rehearsed(found, _rehearsal_plan(found, options), options.dask)
    finally:  # a rehearsal that breaks off takes no diagnosis with it
        with working(say("terminal-progress-writing")):
            write_all(_contents(found, rehearsal, options))
    for line in _rehearsal_lines(rehearsal) if rehearsal is not None else ():
        write_line(line)


def _contents(found: Diagnosis, rehearsal: Rehearsal | None, options: DiagnoseOptions) -> Outputs:
    """Return what goes into each file that was asked for."""
    outputs: Outputs = {}
    if options.json is not None:
        rehearsed = {} if rehearsal is None else {"rehearsal": rehearsal.as_json()}
        outputs[options.json] = as_json(found.as_json() | rehearsed)
    if options.model is not None:
        from softsensor.heat.model_file import model_text
        from softsensor.jobs.campaign import diagnosed_model

        outputs[options.model] = model_text(diagnosed_model(found))
    if options.html is not None:
        from softsensor.report.diagnosis_report import diagnosis_report

        outputs[options.html] = diagnosis_report(found, spoken_language(), rehearsal)
    return outputs


def _check_rehearsal(options: DiagnoseOptions) -> None:
    """Refuse options without a rehearsal, effects that do not exist and a file of something else, before any work.

    Raises `InputError`.
    """
    alone = (options.rehearse_campaigns, options.rehearse_effect, options.rehearse_file, options.dask)
    if any(alone) and not options.rehearse:
        raise InputError(say("rehearsal-options-alone"))
    if options.rehearse_effect:
        from softsensor.diagnosis.rehearsal import sized

        for one in options.rehearse_effect:
            sized(one)
    if options.rehearse_file is not None:
        from softsensor.jobs.rehearsals import check_file

        check_file(options.rehearse_file)


def _rehearsal_plan(found: Diagnosis, options: DiagnoseOptions) -> RehearsalPlan:
    """Lay out what is to be rehearsed. Raises `InputError`."""
    from softsensor.diagnosis.rehearsal import campaign_of, hidden_of
    from softsensor.jobs.rehearsals import CAMPAIGNS, plan_rehearsal

    campaign = campaign_of(found)
    hidden = hidden_of(campaign, options.rehearse_effect or [])
    return plan_rehearsal(campaign, hidden, options.rehearse_campaigns or CAMPAIGNS, options.rehearse_file)


def _rehearsed(found: Diagnosis, plan: RehearsalPlan, dask: str) -> Rehearsal:
    """Rehearse, and say before how long it takes. Raises `WorkFailed` where finished campaigns cannot be kept."""
    from softsensor.jobs.rehearsals import local_workers, rehearse

    workers, total = local_workers(plan), len(plan.tasks) + len(plan.done)
    begin = say("rehearsal-begins", campaigns=len(plan.tasks), done=len(plan.done), runs=len(plan.campaign.runs))
    write_line(begin)
    if plan.tasks and not dask:
        minutes = max(1.0, round(plan.minutes(found.seconds - (found.law_seconds or 0.0), workers)))
        write_line(say("rehearsal-takes", minutes=minutes, workers=workers))
    with working(say("terminal-progress-rehearsing", campaigns=total), total) as done:
        done(len(plan.done))
        try:
            return rehearse(plan, done, dask)
        except OSError as error:
            if plan.file is None:
                raise
            problem = say("terminal-output-unwritable", path=str(plan.file), why=reason_of(error))
            raise WorkFailed(problem) from error


def _rehearsal_lines(rehearsal: Rehearsal) -> Iterator[str]:
    """Yield the table of power and false names."""
    from softsensor.report.rehearsal_rows import HEADS, lost_messages, none_message, rehearsal_rows

    yield in_words(say("rehearsal-title", runs=rehearsal.runs))
    heads = [in_words(say(code)) for code in HEADS]
    cells = [[in_words(cell) for cell in row.cells] for row in rehearsal_rows(rehearsal)]
    if cells:
        yield from aligned([heads, *cells])
    yield in_words(none_message(rehearsal))
    yield from map(in_words, lost_messages(rehearsal))
    yield in_words(say("rehearsal-own-model"))


def _ahead(press: Press, found: Diagnosis) -> Iterator[str]:
    """Say what pressings would settle of causes, where one is open."""
    from softsensor.planning.plan import plan
    from softsensor.planning.summary import best_message, point_message

    points = plan(press, found, causes_alone=True).points
    if points:
        yield in_words(say("diagnosed-plan"))
    for advice in points[:PLANNED]:
        yield f"  {in_words(point_message(advice.point))}. {in_words(best_message(advice))}"


def _lines(found: Diagnosis) -> Iterator[str]:
    from softsensor.diagnosis.summary import (
        core_messages,
        law_messages,
        sureness,
        verdict_messages,
        where_message,
        worth,
    )
    from softsensor.effects.vocabulary import parameters_shown

    runs = len(found.stages[0].data)
    yield f"{found.verdict}: {in_words(*verdict_messages(found))}"
    for f in found.findings:
        if f.of_channels:
            continue
        line = say("diagnosed-cause", name=f.name, worth=worth(found, f), sureness=sureness(f, runs))
        if len(f.set) > 1:
            line = say("diagnosed-causes", others=f.set[1:], **line.arguments)
        yield f"  {in_words(line)}"
        for p in parameters_shown(f.name, {name: i.as_json() for name, i in f.parameters.items()}):
            yield f"    {in_words(p.line)}"
    yield f"  {in_words(say('diagnosed-residual', base=found.base.rmse_K, extended=found.extended.rmse_K))}"
    if found.where:
        yield in_words(*where_message(found))
    yield from map(in_words, law_messages(found))
    yield in_words(*core_messages(found))
    yield in_words(say("diagnosed-next", sentence=found.next_measurement))
    yield from map(in_words, found.warnings)
