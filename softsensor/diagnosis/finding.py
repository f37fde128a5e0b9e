"""The answer of a diagnosis: the named causes, and the numbers before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from daq.records import Array
from daq.words import Message
from softsensor.diagnosis.decision import Step, Verdict
from softsensor.diagnosis.extended_model import model_of
from softsensor.diagnosis.numbers import Errors, Interval
from softsensor.diagnosis.search import SettledModel
from softsensor.diagnosis.sign_flips import PatternTest
from softsensor.effects import sensor_fault
from softsensor.heat.model_file import ModelFile
from softsensor.signals.screen import ChannelFault


@dataclass(frozen=True)
class Finding:
    """One named cause."""

    name: str
    set: tuple[str, ...]
    """With the causes these runs cannot tell from it; one that is named beside it is no alternative to it."""
    parameters: dict[str, Interval]
    p_value: float
    heldout_gain_K: float  # noqa: N815
    explained_share: float
    against: tuple[tuple[str, float], ...] = ()
    """Runners-up outside the set and by how many standard errors the runs prefer the name."""
    votes: tuple[int, int] = (0, 0)
    """How many runs, each left out in turn, fit better with it, and how many there are."""

    @property
    def of_channels(self) -> bool:
        """Whether single channels are at fault, which comparison finds and no model term stands for."""
        return self.name == sensor_fault.EFFECT.name


@dataclass(frozen=True)
class Diagnosis:
    """The answer."""

    verdict: Verdict
    stopped: Step
    """Why no further cause was looked for or named."""
    findings: tuple[Finding, ...]
    base: Errors
    extended: Errors
    noise_floor_K: float  # noqa: N815
    where: tuple[dict[str, Any], ...]
    candidates: tuple[dict[str, Any], ...]
    next_measurement: Message
    seconds: float
    faults: dict[str, tuple[ChannelFault, ...]]
    """Faulty channels by run."""
    stages: tuple[SettledModel, ...]
    """Fits: the plain model, then with each cause."""
    left: PatternTest
    """Of what the last fit leaves in common to the runs."""
    rivals: tuple[tuple[str, Array], ...]
    """The first cause and the runners-up, with what each run, left out, saves by them."""
    warnings: tuple[Message, ...] = ()

    @property
    def final(self) -> SettledModel:
        """The last fit."""
        return self.stages[-1]

    def model_file(self, version: str = "") -> ModelFile:
        """Return the extended model (the plain one where nothing was named)."""
        return model_of(self.final, version)

    def as_json(self) -> dict[str, Any]:
        """Return the contract's JSON content."""
        effects = [
            {
                "name": f.name,
                "set": list(f.set),
                "parameters": {k: i.as_json() for k, i in f.parameters.items()},
                "p_value": f.p_value,
                "heldout_gain_K": f.heldout_gain_K,
                "explained_share": f.explained_share,
            }
            for f in self.findings
        ]
        return {
            "verdict": self.verdict,
            "effects": effects,
            "base": self.base.as_json(),
            "extended": self.extended.as_json(),
            "noise_floor_K": self.noise_floor_K,
            "where": list(self.where),
            "candidates": list(self.candidates),
            "next_measurement": str(self.next_measurement),
            "next_measurement_said": self.next_measurement.to_json(),
            "warnings": [str(one) for one in self.warnings],
            "warnings_said": [one.to_json() for one in self.warnings],
            "seconds": self.seconds,
        }
