"""`diagnose`: what the simulation gets wrong, the cause by name, the extended model, the gain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from api.commands.fitting import HtmlOut, JsonOut, ModelOut
from api.commands.inputs import ConfigFile, PressFile, Runs, StoreUrl, files_read, load_runs
from api.commands.until import Until, shortened
from api.outputs import as_json, check_writable, in_words, spoken_language, tell, working, write_all
from daq.words import say

if TYPE_CHECKING:
    from softsensor.diagnosis.finding import Diagnosis


def diagnose(
    runs: Runs,
    press: PressFile,
    model: ModelOut = None,
    json: JsonOut = None,
    html: HtmlOut = None,
    until: Until = None,
    store: StoreUrl = None,
    config: ConfigFile = None,
) -> None:
    """Say what the simulation gets wrong, why, what that costs, and what to measure next."""
    from daq.press.press_file import read_press

    check_writable(model, json, html, inputs=files_read(*runs, press, store=store, config=config))
    described = read_press(press)
    loaded = shortened(load_runs(runs, store, config), described, until)
    with working(say("terminal-progress-diagnosing", runs=len(loaded)), 100) as done:
        from softsensor.diagnosis.verdict import diagnose as look

        found = look(described, loaded, progress=lambda _what, share: done(round(100 * share)))
        outputs: dict[Path, str | bytes | Callable[[Path], None]] = {}
        if json is not None:
            outputs[json] = as_json(found.as_json())
        if model is not None:
            from softsensor.diagnosis.missing_causes import with_missing_causes
            from softsensor.heat.model_file import model_text
            from softsensor.jobs.campaign import fit_runs

            extended = found.model_file()
            fits = fit_runs(extended.model(described), loaded, start=extended.values, company=None)
            outputs[model] = model_text(with_missing_causes(extended, fits))
        if html is not None:
            from softsensor.report.diagnosis_report import diagnosis_report

            outputs[html] = diagnosis_report(found, spoken_language())
        write_all(outputs)
    for line in _lines(found):
        tell(line)


def _lines(found: Diagnosis) -> Iterator[str]:
    from softsensor.diagnosis.summary import core_said, sureness, verdict_said, where_said, worth
    from softsensor.effects.vocabulary import parameters_told

    runs = len(found.stages[0].data)
    yield f"{found.verdict}: {in_words(*verdict_said(found))}"
    for f in found.findings:
        if f.of_channels:
            continue
        said = say("diagnosed-cause", name=f.name, worth=worth(found, f), sureness=sureness(f, runs))
        if len(f.set) > 1:
            said = say("diagnosed-causes", others=f.set[1:], **said.arguments)
        yield f"  {in_words(said)}"
        for p in parameters_told(f.name, {name: i.as_json() for name, i in f.parameters.items()}):
            yield f"    {in_words(p.line)}"
    yield f"  {in_words(say('diagnosed-residual', base=found.base.rmse_K, extended=found.extended.rmse_K))}"
    if found.where:
        yield in_words(*where_said(found))
    yield in_words(*core_said(found))
    yield in_words(say("diagnosed-next", sentence=found.next_measurement))
    yield from map(in_words, found.warnings)
