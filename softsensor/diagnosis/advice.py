"""What to measure next, and what else a reader should know, as messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.press.header import panel_of
from daq.records import Array, Run
from daq.words import Message, say
from softsensor.diagnosis.decision import FEW_RUNS, Verdict
from softsensor.diagnosis.finding import Finding
from softsensor.diagnosis.selection import Round, cool_rim
from softsensor.effects import conductivity_offset, find_effect, heat_capacity_offset
from softsensor.effects.vocabulary import called
from softsensor.signals.doubt import one_product
from softsensor.signals.screen import ChannelFault
from softsensor.signals.spikes import SPIKE_K, Spikes

# Numbers without another source were set by hand, 2026-11.

CORE_OFF_K = 1.0
"""A core error worth a measurement where faces show nothing: well above what a buried thermocouple is off of its
own (`signals.instrument.BURIED_K`). [K]"""


@dataclass(frozen=True)
class AdviceBasis:
    """What the advice rests on beside the findings."""

    runs: int
    panel: bool
    """Whether there is a panel to sacrifice."""
    core_K: float | None = None  # noqa: N815
    """Error of the core by the plain model, None without a core thermocouple."""
    extended_core_K: float | None = None  # noqa: N815
    apart: int = 0
    """How many runs are not explained to their noise, where the others are."""
    cores_agree: bool = True
    """Core thermocouples do not show an error that the faces hide."""

    def words(self, of_panels: Message, of_rig: Message) -> Message:
        """Return which of two sentences fits: a rig of layers has no panel and no core."""
        return of_panels if self.panel else of_rig


def next_measurement(
    verdict: Verdict, findings: Sequence[Finding], basis: AdviceBasis, suspected: Sequence[Finding] = ()
) -> Message:
    """Return one sentence: the measurement that would help most."""
    core_K, extended_K = basis.core_K or 0.0, basis.extended_core_K or 0.0
    if verdict is Verdict.TOO_FEW_RUNS:
        more = max(FEW_RUNS - basis.runs, 1)
        panels = say("next-more-runs", more=more, least=FEW_RUNS)
        return basis.words(panels, say("next-more-runs-rig", more=more, least=FEW_RUNS))
    if verdict is Verdict.NOT_DESCRIBED:
        return basis.words(say("next-describe"), say("next-describe-rig"))
    several = next((f for f in findings if len(f.set) > 1), None)
    if several is not None:
        causes = tuple(map(called, several.set))
        return say("next-tell-apart", causes=causes, confirm=find_effect(several.set[0]).confirm)
    if verdict is Verdict.UNKNOWN_EFFECT:
        return _where_something_is_unknown(basis, suspected)
    if not findings:
        none = basis.words(say("next-none"), say("next-none-rig"))
        return say("next-constants", kelvin=core_K) if core_K > CORE_OFF_K else none
    if core_K > CORE_OFF_K and extended_K < 0.5 * core_K:
        return say("next-none-confirmed", before=core_K, after=extended_K)
    effect = find_effect(findings[0].name)
    if basis.panel and not core_K and not effect.measuring and not effect.confirmed_in_core:
        return say("next-confirm-and-core", confirm=effect.confirm)
    return effect.confirm


def _where_something_is_unknown(basis: AdviceBasis, suspected: Sequence[Finding]) -> Message:
    if suspected:
        return find_effect(suspected[0].name).confirm
    if basis.apart:
        return say("next-those-runs", more=max(FEW_RUNS - basis.apart, 0), least=FEW_RUNS)
    if not basis.cores_agree:
        return say("next-constants", kelvin=basis.core_K or 0.0)
    return basis.words(say("next-look-there"), say("next-look-there-rig"))


def notes(
    runs: Sequence[Run], faults: Sequence[tuple[ChannelFault, ...]], rounds: Sequence[Round]
) -> tuple[Message, ...]:
    """Return one line a faulty channel, however many runs it spoils, and one a cause that cores speak against."""
    spoilt: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for run, found in zip(runs, faults, strict=True):
        for f in found:
            spoilt.setdefault((f.column, f.kind), []).append((run.name, f.departure_K))
    remarks = []
    for (column, kind), where in sorted(spoilt.items()):
        worst = max(size for _, size in where)
        if len(where) == 1:
            remarks.append(say("note-channel", run=where[0][0], column=column, kind=kind, kelvin=worst))
        else:
            remarks.append(
                say(
                    "note-channel-in-runs",
                    count=len(where),
                    runs=len(runs),
                    column=column,
                    kind=kind,
                    kelvin=worst,
                )
            )
    refuted = dict.fromkeys(name for r in rounds for name in r.refuted)
    return (*remarks, *(say("note-refuted-by-cores", cause=called(name)) for name in refuted))


def thickness_notes(findings: Sequence[Finding], runs: Sequence[Run]) -> tuple[Message, ...]:
    """Say which thickness of the panels would show the same as constants of theirs that are off.

    Heat takes a time of d² ρc / k through a panel, and contacts that are fitted hide the rest, so that a wrong
    thickness and wrong constants look alike; not where panels of several thicknesses have the same constants.
    """
    conducts, stores = conductivity_offset.EFFECT.name, heat_capacity_offset.EFFECT.name
    ratios = {f.name: f.parameters["ratio"].value for f in findings if f.name in (conducts, stores)}
    given = [1000.0 * panel_of(run).thickness for run in runs if ratios]
    if not given or not one_product(min(given), max(given)):
        return ()
    slower = ratios.get(stores, 1.0) / ratios.get(conducts, 1.0)
    alike = float(np.mean(given) * np.sqrt(slower))
    return (say("note-thickness-alike", thickness=alike, given=float(np.mean(given))),)


def spike_notes(spikes: Sequence[tuple[Spikes, ...]]) -> tuple[Message, ...]:
    """Return one line a platen's channel of which single cells were left out, by run."""
    columns = sorted({one.column for of_run in spikes for one in of_run})
    counts = {name: [one.cells for of_run in spikes for one in of_run if one.column == name] for name in columns}
    return tuple(
        say("note-cells-jump", count=len(found), runs=len(spikes), column=name, cells=sum(found), kelvin=SPIKE_K)
        for name, found in counts.items()
    )


def rim_notes(falls: Array) -> tuple[Message, ...]:
    """Say by how much rim sensors fall against central ones, where they do beyond chance (runs). [K]"""
    return (say("note-rim-falls", kelvin=-float(np.nanmean(falls))),) if cool_rim(falls) else ()
