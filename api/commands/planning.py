"""`plan`: the next pressings worth most, and what each would settle."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import typer

from api.commands.calling import taking
from api.commands.fitting import HtmlOut, JsonOut, Outputs
from api.commands.inputs import ConfigFile, PressFile, Runs, StoreUrl, files_read, load_runs
from api.commands.until import Until, shortened
from api.outputs import as_json, check_writable, spoken_language, working, write_all, write_line
from daq.records import InputError
from daq.words import say

RangesGiven = Annotated[list[str] | None, typer.Option("--range", metavar="NAME=LOW:HIGH", help="help-range")]
DIAGNOSING = 0.8
"""Share of the work that the diagnosis takes; measured on seven runs, 2026-11-22."""


@dataclass(frozen=True)
class PlanOptions:
    """What `plan` is called with."""

    runs: Runs
    press: PressFile
    json: JsonOut = None
    html: HtmlOut = None
    ranges: RangesGiven = None
    until: Until = None
    store: StoreUrl = None
    config: ConfigFile = None


@taking(PlanOptions)
def plan(options: PlanOptions) -> None:
    """Say which pressings are worth most next, and what each would settle."""
    from daq.press.press_file import read_press

    read = files_read(*options.runs, options.press, store=options.store, config=options.config)
    check_writable(options.json, options.html, inputs=read)
    ranges = parse_ranges(options.ranges or ())
    described = read_press(options.press)
    loaded = shortened(load_runs(options.runs, described, options.store, options.config), described, options.until)
    with working(say("terminal-progress-planning", runs=len(loaded)), 100) as done:
        from softsensor.diagnosis.verdict import diagnose
        from softsensor.planning.plan import plan as look_ahead
        from softsensor.planning.plan import ranges_of

        ranges_of(described, loaded, ranges)
        found = diagnose(described, loaded, progress=lambda _what, share: done(round(100 * DIAGNOSING * share)))
        rest = 1.0 - DIAGNOSING
        plan = look_ahead(
            described, found, ranges, progress=lambda _what, share: done(round(100 * (DIAGNOSING + rest * share)))
        )
        outputs: Outputs = {}
        if options.json is not None:
            outputs[options.json] = as_json(plan.as_json())
        if options.html is not None:
            from softsensor.report.planning_report import plan_report

            outputs[options.html] = plan_report(plan, spoken_language())
        write_all(outputs)
    from softsensor.planning.summary import plan_messages

    for line in plan_messages(plan):
        write_line(line)


def parse_ranges(given: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return ranges by factor's name. Raises `InputError` for one that cannot be read."""
    found = {}
    for text in given:
        name, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        try:
            found[name.strip()] = (float(low), float(high))
        except ValueError:
            raise InputError(say("plan-range-unreadable", given=text)) from None
    return found
