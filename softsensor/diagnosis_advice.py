"""What to measure next, and what else a reader should know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from daq.records import Array, Run
from softsensor.channels import ChannelFault
from softsensor.diagnosis_jury import FEW_RUNS, Round, cool_rim
from softsensor.effects import find_effect
from softsensor.vocabulary import readable

if TYPE_CHECKING:
    from softsensor.diagnosis import Finding

SACRIFICE = "two or three sacrificial panels with a core thermocouple would settle the core temperature"
CORE_OFF_K = 1.0
"""A core error that is worth telling where faces show nothing. [K]"""


def next_measurement(
    verdict: str, findings: tuple[Finding, ...], cores: tuple[float | None, float | None], runs: int, panel: bool
) -> str:
    """One sentence: the measurement that would help most.

    `cores`: errors of the core before and after, if known; `panel`: whether there is one to sacrifice.
    """
    core_K, extended_K = (c or 0.0 for c in cores)
    if verdict == "too_few_runs":
        return (
            f"Press at least {max(FEW_RUNS + 1 - runs, 1)} more panels, with different press times and, "
            f"if possible, thicknesses: below {FEW_RUNS} runs chance cannot be told from a cause."
        )
    several = next((f for f in findings if len(f.set) > 1), None)
    if several is not None:
        names = " from ".join(name.replace("_", " ") for name in several.set)
        return f"To tell {names}: {_first_lower(find_effect(several.set[0]).confirm)}"
    if verdict == "unknown_effect":
        return "Press three sacrificial panels with a core thermocouple and look at the times and places listed."
    if not findings and core_K > CORE_OFF_K:
        return (
            f"Measure the panel's conductivity and heat capacity: faces fit, but core thermocouples are off by "
            f"{core_K:.1f} K, so something is wrong that faces do not show."
        )
    if not findings:
        return "None needed; a core thermocouple in one sacrificial panel a month would confirm the core."
    if core_K > CORE_OFF_K and extended_K < 0.5 * core_K:
        return f"None needed: core thermocouples confirm it ({core_K:.1f} K off before, {extended_K:.1f} K after)."
    effect = find_effect(findings[0].name)
    sentence = effect.confirm
    asks_already = "core thermocouple" in sentence or "in its middle" in sentence
    if panel and not core_K and not effect.measuring and not asks_already:
        sentence = f"{sentence.rstrip('.')}; {SACRIFICE}."
    return sentence


def _first_lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def notes(
    runs: Sequence[Run], faults: Sequence[tuple[ChannelFault, ...]], rounds: Sequence[Round]
) -> tuple[str, ...]:
    """Return one line a faulty channel, however many runs it spoils, and one a cause that cores speak against."""
    spoilt: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for run, found in zip(runs, faults, strict=True):
        for f in found:
            spoilt.setdefault((f.column, f.kind), []).append((run.name, f.departure_K))
    found_notes = []
    for (column, kind), where in sorted(spoilt.items()):
        worst = max(size for _, size in where)
        name = where[0][0] if len(where) == 1 else f"{len(where)} of {len(runs)} runs"
        found_notes.append(f"{name}: {column} is {kind} ({worst:.1f} K rms) and was left out")
    refuted = dict.fromkeys(name for r in rounds for name in r.refuted)
    found_notes += [
        f"core thermocouples speak against {readable(name)}, though the faces would fit" for name in refuted
    ]
    return tuple(found_notes)


def rim_notes(falls: Array) -> tuple[str, ...]:
    """Say by how much rim sensors fall against central ones, where they do beyond chance (runs). [K]"""
    if not cool_rim(falls):
        return ()
    size = -float(np.nanmean(falls))
    return (f"rim sensors fall by {size:.1f} K against central ones in the course of a run: heat leaves there",)
