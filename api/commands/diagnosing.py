"""`diagnose`: what the simulation gets wrong, the cause by name, the extended model, the gain."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from api.commands.fitting import HtmlOut, JsonOut, ModelOut
from api.commands.inputs import ConfigFile, PressFile, Runs, StoreUrl, Until, files_read, load_runs, rows_until
from api.outputs import as_json, check_writable, working, write_all

if TYPE_CHECKING:
    from softsensor.diagnosis import Diagnosis


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
    from daq.pressfile import read_press

    check_writable(model, json, html, inputs=files_read(*runs, press, store=store, config=config))
    described = read_press(press)
    loaded = load_runs(runs, store, config)
    if until is not None:
        loaded = [rows_until(run, until) for run in loaded]
    with working(f"Diagnosing {len(loaded)} runs", 100) as done:
        from softsensor.diagnosis import diagnose as look

        found = look(described, loaded, progress=lambda _what, share: done(round(100 * share)))
        outputs: dict[Path, str | bytes | Callable[[Path], None]] = {}
        if json is not None:
            outputs[json] = as_json(found.as_json())
        if model is not None:
            from softsensor.adequacy import checked_on
            from softsensor.modelfile import model_text

            outputs[model] = model_text(checked_on(found.model_file(), described, loaded))
        if html is not None:
            from softsensor.diagnosis_report import diagnosis_report

            outputs[html] = diagnosis_report(found)
        write_all(outputs)
    for line in _lines(found):
        sys.stdout.write(line + "\n")


def _lines(found: Diagnosis) -> Iterator[str]:
    from softsensor.diagnosis_words import core_sentence, sentence, sureness, where_sentence, worth
    from softsensor.vocabulary import parameters_told

    runs = len(found.stages[0].data)
    yield f"{found.verdict}: {sentence(found)}"
    for f in found.findings:
        if f.name == "sensor_fault":
            continue
        alternatives = f" (not told from {', '.join(f.set[1:])})" if len(f.set) > 1 else ""
        yield f"  {f.name}{alternatives}: {worth(found, f)}; {sureness(f, runs)}"
        for p in parameters_told(f.name, {name: i.as_json() for name, i in f.parameters.items()}):
            yield f"    {p.line}"
    yield f"  residual {found.base.rmse_K:.3f} K, extended model {found.extended.rmse_K:.3f} K"
    if found.where:
        yield where_sentence(found)
    yield core_sentence(found)
    yield f"Next: {found.next_measurement}"
    yield from found.warnings
