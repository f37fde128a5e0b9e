"""The answer of a diagnosis: the named causes, and the numbers before and after."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from daq.printed import lines_of, on_screen
from daq.records import Array
from daq.words import Message, say
from daq.words.message import words
from softsensor.diagnosis.decision import Remains, Verdict
from softsensor.diagnosis.extended_model import model_of
from softsensor.diagnosis.gains import Gain, paired_gain
from softsensor.diagnosis.laws.choice import Law
from softsensor.diagnosis.numbers import Errors, Interval, rms
from softsensor.diagnosis.search import Candidate
from softsensor.diagnosis.settling import SettledModel
from softsensor.effects import sensor_fault
from softsensor.heat.model_file import ModelFile
from softsensor.signals.screen import ChannelFault


@dataclass(frozen=True)
class Contest:
    """The models between which a search decided, as it left them."""

    stage: SettledModel
    """The model on top of which the causes were fitted."""
    causes: tuple[Candidate, ...]
    """The set, the cause itself first."""

    __repr__ = on_screen


@dataclass(frozen=True, eq=False)
class Finding:
    """One named cause."""

    name: str
    set: tuple[str, ...]
    """With causes these runs cannot distinguish from it; one named beside it is no alternative to it."""
    parameters: dict[str, Interval]
    p_value: float
    gain: Gain
    """On runs left out, each with its own contacts fitted."""
    predicted: Gain
    """On runs predicted from header and other runs alone."""
    explained_share: float
    against: tuple[tuple[str, float], ...] = ()
    """Runners-up outside the set and by how many standard errors the runs prefer the name."""
    saves: Array = field(default_factory=lambda: np.zeros(0), compare=False)
    """Sum of squares each run, left out in turn, saves by it (runs); none of a fault of channels."""
    contest: Contest | None = None
    """What the next pressings may decide (`softsensor.planning`); None where no fit stands behind it."""

    __repr__ = on_screen

    def as_json(self) -> dict[str, Any]:
        """Return the contract's table."""
        return {
            "name": self.name,
            "set": list(self.set),
            "parameters": {k: i.as_json() for k, i in self.parameters.items()},
            "p_value": self.p_value,
            "heldout_gain_K": self.gain.value_K,
            "heldout_gain_ci95": _edges(self.gain),
            "predicted_gain_K": self.predicted.value_K,
            "predicted_gain_ci95": _edges(self.predicted),
            "explained_share": self.explained_share,
        }

    @property
    def votes(self) -> tuple[int, int]:
        """How many runs, each left out in turn, fit better with it, and how many there are."""
        return int((self.saves > 0.0).sum()), len(self.saves)

    @property
    def of_channels(self) -> bool:
        """Whether single channels are at fault, which comparison finds and no model term stands for."""
        return self.name == sensor_fault.EFFECT.name


def _edges(gain: Gain) -> list[float] | None:
    return None if gain.ci95 is None else list(gain.ci95)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer."""

    verdict: Verdict
    """What it comes to."""
    findings: tuple[Finding, ...]
    """Causes that are named, in the order in which they were added."""
    suspected: tuple[Finding, ...]
    """What the search chose and the evidence does not earn a name."""
    base: Errors
    """What the plain model leaves."""
    extended: Errors
    """What is left with the causes named."""
    noise_floor_K: float  # noqa: N815
    """What scatters in the readings themselves. [K]"""
    where: tuple[dict[str, Any], ...]
    """Signals and times that the plain model misses most."""
    candidates: tuple[dict[str, Any], ...]
    """What else was tried, with its score."""
    next_measurement: Message
    """What would settle most of what is open."""
    seconds: float
    """How long it took, the law included. [s]"""
    faults: dict[str, tuple[ChannelFault, ...]]
    """Faulty channels by run."""
    stages: tuple[SettledModel, ...]
    """Fits: the plain model, then with each cause."""
    remains: tuple[Remains, ...]
    """What each of these fits leaves."""
    rivals: tuple[tuple[str, Array], ...]
    """The first cause and the runners-up, with what each run, left out, saves by them."""
    remarks: tuple[Message, ...] = ()
    """What is to be known of runs and channels, whatever is named."""
    law: Law | None = None
    """What is missing as a free function, where runs left out gain by it."""
    law_seconds: float | None = None
    """How long it took to look for that, None where nobody did. [s]"""

    def __repr__(self) -> str:
        """Return on one screen the verdict, the causes named and suspected, and the residual. [K]"""
        head = f"Diagnosis: {self.verdict}, {self.base.rmse_K:.2f} K before, {self.extended.rmse_K:.2f} K after"
        lines = [f"named: {f.name}, p = {f.p_value:.2g}" for f in self.findings]
        lines += [f"suspected: {f.name}, p = {f.p_value:.2g}" for f in self.suspected]
        return "\n".join([head, *lines_of(lines)])

    @property
    def final(self) -> SettledModel:
        """The last fit."""
        return self.stages[-1]

    @property
    def left(self) -> Remains:
        """What the last fit leaves."""
        return self.remains[-1]

    @property
    def warnings(self) -> tuple[Message, ...]:
        """In which runs more than noise is left, where it is not in all, and the remarks."""
        off = list(self.left.off)
        if not off:
            return self.remarks
        each, runs = self.extended.weighed, [white.digest.run.name for white in self.stages[0].data]
        there, elsewhere = rms(each[off]), rms(np.delete(each, off))
        names = tuple(runs[i] for i in off)
        in_runs = say(
            "note-left-in-runs", count=len(off), runs=len(runs), names=names, kelvin=there, rest=elsewhere
        )
        return (in_runs, *self.remarks)

    @property
    def predicted_gain(self) -> Gain:
        """What all named causes together save on predicted runs."""
        return paired_gain(self.base.predicted, self.extended.predicted)

    def model_file(self, version: str = "") -> ModelFile:
        """Return the extended model, with the law where one was found (the plain one where nothing was)."""
        if self.law is None:
            return model_of(self.final, version)
        return model_of(self.law.stage, version, {f"law_{self.law.kind}": self.law.kept})

    def as_json(self) -> dict[str, Any]:
        """Return the contract's JSON content."""
        return {
            "verdict": self.verdict,
            "effects": [f.as_json() for f in self.findings],
            "suspected": [f.as_json() for f in self.suspected],
            "law": None if self.law is None else self.law.as_json(),
            "base": self.base.as_json(),
            "extended": self.extended.as_json(),
            "noise_floor_K": self.noise_floor_K,
            "where": list(self.where),
            "candidates": list(self.candidates),
            "next_measurement": words(self.next_measurement),
            "next_measurement_said": self.next_measurement.to_json(),
            "warnings": [words(one) for one in self.warnings],
            "warnings_said": [one.to_json() for one in self.warnings],
            "seconds": self.seconds,
        }
