"""`advise`: press time, platens and pressure for a panel not pressed yet, under limits at a wanted probability."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.calling import taking
from api.commands.fitting import HtmlOut, JsonOut, Outputs
from api.commands.inputs import PressFile
from api.commands.planning import parse_ranges
from api.outputs import as_json, check_writable, spoken_language, working, write_all, write_line
from daq.records import USUAL_WAIT_S, InputError
from daq.words import say
from softsensor.planning.wishes import OPEN_S, PRICE, USUAL_OPEN_S, WAITING_S

if TYPE_CHECKING:
    from softsensor.planning.advise import ProgrammeAdvice

KnownModel = Annotated[Path, typer.Option("--model", metavar="FILE", help="help-model")]
ResinFile = Annotated[Path | None, typer.Option("--resin", metavar="FILE", help="help-advice-resin")]
PanelKeys = Annotated[list[str] | None, typer.Option("--panel", metavar="KEY=VALUE", help="help-panel")]
GoalName = Annotated[str, typer.Option("--goal", metavar="NAME", help="help-goal")]
Price = Annotated[
    float | None, typer.Option("--price", metavar="EUR", min=PRICE[0], max=PRICE[1], help="help-price")
]
Waiting = Annotated[
    float, typer.Option("--waiting", metavar="S", min=WAITING_S[0], max=WAITING_S[1], help="help-waiting")
]
OpenFor = Annotated[float, typer.Option("--open", metavar="S", min=OPEN_S[0], max=OPEN_S[1], help="help-open")]
CoreLeast = Annotated[float | None, typer.Option("--core-least", metavar="C", help="help-core-least")]
CoreMost = Annotated[float | None, typer.Option("--core-most", metavar="C", help="help-core-most")]
Probability = Annotated[float | None, typer.Option("--probability", metavar="P", help="help-probability")]
Settable = Annotated[list[str] | None, typer.Option("--range", metavar="NAME=LOW:HIGH", help="help-advice-range")]
SvgFile = Annotated[Path | None, typer.Option("--svg", metavar="OUT", help="help-advice-svg")]


@dataclass(frozen=True)
class AdviseOptions:
    """What `advise` is called with."""

    press: PressFile
    model: KnownModel
    resin: ResinFile = None
    panel: PanelKeys = None
    ranges: Settable = None
    goal: GoalName = "time"
    core_least: CoreLeast = None
    core_most: CoreMost = None
    probability: Probability = None
    price: Price = None
    waiting: Waiting = USUAL_WAIT_S
    open_for: OpenFor = USUAL_OPEN_S
    json: JsonOut = None
    svg: SvgFile = None
    html: HtmlOut = None


@taking(AdviseOptions)
def advise(options: AdviseOptions) -> None:
    """Work out press time and platen temperature for a panel not pressed yet."""
    from softsensor.face.advising import advise as look

    given = [path for path in (options.press, options.model, options.resin) if path is not None and path.is_file()]
    check_writable(options.json, options.svg, options.html, inputs=given)
    ranges, header = parse_ranges(options.ranges or ()), parse_panel(options.panel or ())
    limits = {
        "core_least_C": options.core_least,
        "core_most_C": options.core_most,
        "probability": options.probability,
    }
    with working(say("terminal-progress-advising"), 100) as done:
        found = look(
            options.press,
            options.model,
            options.resin,
            panel=header,
            ranges=ranges,
            limits={key: value for key, value in limits.items() if value is not None},
            goal=options.goal,
            price_per_kWh=options.price,
            waiting_s=options.waiting,
            open_s=options.open_for,
            progress=lambda _what, share: done(round(100 * share)),
        ).advised
        write_all(_outputs(options, found))
    from softsensor.planning.summary import advice_messages

    for line in advice_messages(found):
        write_line(line)


def _outputs(options: AdviseOptions, found: ProgrammeAdvice) -> Outputs:
    """Return what is written to each file asked for."""
    outputs: Outputs = {}
    if options.json is not None:
        outputs[options.json] = as_json(found.as_json())
    if options.svg is not None:
        from softsensor.report.advice_figure import advice_figure
        from softsensor.report.fit_figures import svg as drawn

        outputs[options.svg] = drawn(advice_figure(found, spoken_language()))
    if options.html is not None:
        from softsensor.report.planning_report import advice_report

        outputs[options.html] = advice_report(found, spoken_language())
    return outputs


def parse_panel(given: Iterable[str]) -> dict[str, Any]:
    """Return keys of a run's header. Raises `InputError` for one that cannot be read."""
    found: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise InputError(say("advise-panel-unreadable", given=text))
        try:
            found[key.strip()] = float(value)
        except ValueError:
            found[key.strip()] = value.strip()
    return found
