"""What a night may call by a name: only where the bets over all nights say that something is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daq.press.press_file import Press
from daq.store import RunRecord
from softsensor.diagnosis.advice import AdviceBasis, next_measurement
from softsensor.diagnosis.decision import Verdict
from softsensor.diagnosis.finding import Diagnosis
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.bets import Bets
from softsensor.jobs.run_reader import RunReader


def settled(
    bets: Bets, reader: RunReader, press: Press, base: ModelFile | None, records: Sequence[RunRecord]
) -> Bets:
    """Return the bets with those of some fitted runs settled that have not had their turn, oldest first.

    `records`: the newest runs, oldest first, new and old: all show how runs scatter.
    """
    fresh = [r for r in records if r.number > bets.counted]
    if bets.sure or not fresh:
        return bets
    from softsensor.diagnosis.run_scores import run_scores

    model = ThermalModel(press) if base is None else base.model(press)
    read = [(record, run) for record in records if (run := reader.read(record.run)) is not None]
    scores = run_scores(model, press, [run for _, run in read])
    beyond = {name: shown.beyond.tolist() for name, shown in scores.items()}
    for i, (record, _) in enumerate(read):
        if record in fresh:
            bets = bets.after(record.run, record.number, {name: s[i] for name, s in beyond.items()})
    return bets


def unsure_causes(found: Diagnosis, in_force: Sequence[str]) -> list[str]:
    """Return what a diagnosis names beyond the model in force and single faulty channels."""
    return [f.name for f in found.findings if not f.of_channels and f.name not in in_force]


def held_back(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis with what it names only suspected; as always, something is then called unknown."""
    plain = found.stages[0]
    causes = tuple(f for f in found.findings if not f.of_channels)
    channels = tuple(f for f in found.findings if f.of_channels)
    panel = bool(plain.fit.layout.model.press.panel_layers)
    basis = AdviceBasis(len(plain.data), panel, found.base.core_rmse_K, found.base.core_rmse_K)
    return replace(
        found,
        verdict=Verdict.UNKNOWN_EFFECT,
        findings=channels,
        suspected=(*causes, *found.suspected),
        extended=found.base,
        stages=found.stages[:1],
        remains=found.remains[:1],
        next_measurement=next_measurement(Verdict.UNKNOWN_EFFECT, channels, basis, causes),
    )
