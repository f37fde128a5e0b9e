"""Whether there is a law, and of which kind: runs that took no part decide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.records import Array
from softsensor.diagnosis.decision import FEW_RUNS, NEGLIGIBLE_K
from softsensor.diagnosis.extension import held_out
from softsensor.diagnosis.gains import HARDLY, Gain, paired_gain
from softsensor.diagnosis.laws.curve import band, curve_of, resembles, two_sided
from softsensor.diagnosis.laws.fitting import FittedLaw, tried
from softsensor.diagnosis.laws.kinds import kinds
from softsensor.diagnosis.settling import SettledModel, run_errors
from softsensor.effects.effect import LawOf
from softsensor.effects.free_law import STRENGTH
from softsensor.heat.model_file import FittedValue


@dataclass(frozen=True)
class Law:
    """What is missing as a free function."""

    kind: LawOf
    variable: str
    unit: str
    curve: Array
    """x, value, low and high with 95 % (points, 4)."""
    gain: Gain
    """On runs left out."""
    set: tuple[str, ...]
    """Kinds that runs left out do not distinguish, the best first."""
    resembles: str | None
    """The cause of the catalogue whose curve lies in the band."""
    stage: SettledModel
    """The fit with it."""
    kept: Mapping[str, FittedValue]
    """What a model file keeps of it, by the parameters of `effects.free_law`."""

    def as_json(self) -> dict[str, Any]:
        """Return the contract's table."""
        return {
            "kind": self.kind,
            "variable": self.variable,
            "curve": [[float(f"{v:.5g}") for v in row] for row in self.curve],
            "unit": self.unit,
            "heldout_gain_K": self.gain.value_K,
            "heldout_gain_ci95": None if self.gain.ci95 is None else list(self.gain.ci95),
            "set": list(self.set),
            "resembles": self.resembles,
        }


def free_law(stage: SettledModel) -> Law | None:
    """Return the law that a settled model lacks, None where runs left out do not gain surely by any.

    Needs at least as many runs as a p-value does (`decision.FEW_RUNS`).
    """
    if len(stage.data) < FEW_RUNS:
        return None
    before = run_errors(stage.data, held_out(stage.fit, stage.data))
    found = [law for kind in kinds(stage) if (law := tried(stage, kind)) is not None]
    if not found:
        return None
    fell = np.stack([np.log(before / t.errors) for t in found])
    best = int(np.argmax(fell.mean(axis=1)))
    unseen = [_chosen_without(fell, r) for r in range(len(before))]
    after = np.array([found[k].errors[r] for r, k in enumerate(unseen)])
    gain = paired_gain(before, after)
    if not _saves(before, after) or gain.value_K < HARDLY * float(np.sqrt(np.mean(before**2))):
        return None
    law = found[best]
    alike = [t for t in found if t is not law and not _saves(t.errors, law.errors)]
    alike = [t for t in alike if paired_gain(before, t.errors).sure]
    curve = curve_of(law)
    names = tuple(t.kind.name for t in (law, *alike))
    return Law(
        kind=law.kind.name,
        variable=law.kind.variable,
        unit=law.kind.unit,
        curve=curve,
        gain=gain,
        set=names,
        resembles=resembles(law.kind.name, curve),
        stage=replace(stage, fit=law.fit),
        kept=_kept(law),
    )


def _saves(before: Array, after: Array) -> bool:
    """Whether errors of the same runs surely fall, by what counts as a pattern at all (runs). [K]"""
    fallen = float(np.mean(before**2 - after**2))
    return paired_gain(before, after).sure and fallen >= NEGLIGIBLE_K**2


def _kept(law: FittedLaw) -> dict[str, FittedValue]:
    """Return a law's numbers for a model file; its strength is as unsure as the curve is, root mean square."""
    value, low, high = band(law)
    doubt = float(np.sqrt(np.mean(((high - low) / 2.0) ** 2) / np.mean(value**2))) / two_sided(law)
    numbers = law.kind.kept(law.fit.theta[law.places])
    return {STRENGTH: FittedValue(1.0, doubt)} | {name: FittedValue(v, 0.0) for name, v in numbers.items()}


def _chosen_without(fell: Array, run: int) -> int:
    """Return the kind that the other runs choose."""
    others = np.delete(fell, run, axis=1)
    return int(np.argmax(others.mean(axis=1)))
