"""What a campaign leaves open, and how far a pressing would settle it: causes, coefficients, the core's band."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.diagnosis.advice import CORE_OFF_K
from softsensor.diagnosis.decision import beyond_chance
from softsensor.diagnosis.extension import SharedFit, evaluate
from softsensor.diagnosis.extension_unknowns import lay_out, logarithm_of, run_values, start_eta
from softsensor.diagnosis.finding import Contest, Diagnosis, Finding
from softsensor.diagnosis.settling import SettledModel
from softsensor.fitting.experiment_advice import WANTED
from softsensor.planning.design_point import DesignPoint, expected, information_of, opening_row, with_readings
from softsensor.planning.information import (
    ODDS,
    WANTED_CHANCE,
    RunInformation,
    covariance_after,
    evidence,
    further_runs,
    pseudo_inverse,
    runs_needed,
)
from softsensor.signals.unknown import BAND

NOTHING = ""
"""In the place of a cause: none at all."""


class PointKind(StrEnum):
    """What is open; names of the JSON."""

    CAUSE = "cause"
    COEFFICIENT = "coefficient"
    CORE_BAND = "core_band"


@dataclass(frozen=True)
class Prospect:
    """What pressings of one kind would bring to one open point."""

    worth: float
    """By which pressings are compared, in nats: expected log odds of one, or what its interval loses in width."""
    chance: float | None
    """That one such pressing settles it; None where it does not depend on chance."""
    runs: int | None
    """How many settle it, with `WANTED_CHANCE` where chance comes in; None: more than `MANY`, or never."""
    half_after: float | None = None
    """Half interval after one, of a coefficient's logarithm, of the core in K."""

    __repr__ = on_screen


@dataclass(frozen=True)
class Contender:
    """One explanation, and how well it is known."""

    name: str
    fit: SharedFit
    before: Array
    """Precision of its numbers and of the shared constants."""
    saves: Array
    """Sum of squares each run so far saves by it, its numbers from the other runs (runs)."""

    __repr__ = on_screen


@dataclass(frozen=True)
class Rivalry:
    """What pressings of one kind would decide between the first explanation and another one."""

    other: Contender
    run: RunInformation
    """What one says, read by the other while the first holds."""

    __repr__ = on_screen

    def evidence(self, runs: int) -> float:
        """Return by how much the other would fit worse after so many."""
        return evidence(self.other.before, self.run, runs)


@dataclass(frozen=True)
class OpenPoint:
    """One matter that the runs leave open.

    Of causes: the contenders. Of a number: one model, the direction asked about among its numbers and constants,
    and the half interval wanted along it.
    """

    kind: PointKind
    name: str
    """Of the cause found or suspected, or of the coefficient."""
    stage: SettledModel
    contenders: tuple[Contender, ...]
    suspected: bool = False
    along: Array | None = None
    wanted: float = 0.0
    """Half interval wanted, as `half_now`."""

    __repr__ = on_screen

    @property
    def names(self) -> tuple[str, ...]:
        """Of the causes; the empty name is none at all."""
        return tuple(c.name for c in self.contenders)

    @property
    def half_now(self) -> float | None:
        """Half of the 95 % interval now; of a coefficient's logarithm, of the core in K."""
        return None if self.along is None else self._half(pseudo_inverse(self.contenders[0].before))

    def _half(self, covariance: Array) -> float:
        along = np.asarray(self.along)
        return BAND * math.sqrt(max(float(along @ covariance @ along), 0.0))

    def prospect(self, design: DesignPoint, constants: Sequence[str]) -> Prospect:
        """Return what a pressing would bring."""
        if self.along is not None:
            return self._knowledge(design, constants)
        read = with_readings(design.digest, self.contenders[0].fit, self.stage.population)
        rivalries = [
            Rivalry(other, expected(design, other.fit, self.stage, read, constants))
            for other in self.contenders[1:]
        ]
        worth = min(r.evidence(1) for r in rivalries) / 2.0
        chance = self.chance(rivalries, 1)
        return Prospect(worth, chance, runs_needed(lambda n: self.chance(rivalries, n) >= WANTED_CHANCE))

    def chance(self, rivalries: Sequence[Rivalry], runs: int) -> float:
        """Return the chance that so many pressings leave the first explanation alone.

        Between causes by the diagnosis' own rule: the runs must agree, those so far among them, and one pressing,
        however clear, cannot outvote them. Against no cause at all by the odds that the further ones give.
        """
        first, settled = self.contenders[0], np.ones(1, dtype=bool)
        for i, r in enumerate(rivalries):
            worse = further_runs(first.saves - r.other.saves, r.evidence(runs), runs, i)
            if r.other.name == NOTHING:
                settled = settled & (worse[:, -runs:].sum(axis=1) > 2.0 * math.log(ODDS))
            else:
                settled = settled & beyond_chance(worse)
        return float(settled.mean())

    def _knowledge(self, design: DesignPoint, constants: Sequence[str]) -> Prospect:
        known = self.contenders[0]
        read = with_readings(design.digest, known.fit, self.stage.population)
        run = expected(design, known.fit, self.stage, read, constants)
        after, now = self._half(covariance_after(known.before, run, 1)), self.half_now or 0.0
        runs = runs_needed(lambda n: self._half(covariance_after(known.before, run, n)) <= self.wanted)
        return Prospect(math.log(max(now, 1e-12) / max(after, 1e-12)), None, runs, after)


def contender(
    name: str,
    fit: SharedFit,
    stage: SettledModel,
    past: Sequence[DesignPoint],
    constants: Sequence[str],
    saves: Array | None = None,
) -> Contender:
    """Return an explanation with what the runs so far say of its numbers and of the shared constants.

    `saves`: what each run saves by it, its numbers from the others (runs); None: nothing, as by no cause.
    """
    count = len(fit.theta) + len(constants)
    before = np.zeros((count, count))
    before[: len(fit.theta), : len(fit.theta)] = fit.prior_hessian
    before[len(fit.theta) :, len(fit.theta) :] = np.eye(len(constants))
    for r, (run, data, design) in enumerate(zip(fit.runs, stage.data, past, strict=True)):
        given = data.as_given  # the design holds what is not known of the panel's constants
        state = evaluate(fit.layout, r, given, fit.theta, run.eta)
        before += information_of(design, state, given, constants).information
    own = np.zeros(len(fit.runs)) if saves is None else saves
    return Contender(name, fit, before, own)


def open_causes(found: Diagnosis, past: Sequence[DesignPoint], constants: Sequence[str]) -> list[OpenPoint]:
    """Return the sets that the runs do not distinguish, and what is suspected, against none at all."""
    return [_of_causes(found, f, contest, past, constants) for f, contest in contested(found)]


def contested(found: Diagnosis) -> list[tuple[Finding, Contest]]:
    """Return the findings between whose causes, or a cause and none, a pressing could decide."""
    least = [(f, 2) for f in found.findings] + [(f, 1) for f in found.suspected]
    return [(f, f.contest) for f, n in least if f.contest is not None and len(f.contest.causes) >= n]


def _of_causes(
    found: Diagnosis, finding: Finding, contest: Contest, past: Sequence[DesignPoint], constants: Sequence[str]
) -> OpenPoint:
    suspected = any(finding is f for f in found.suspected)
    stage = contest.stage
    known = [contender(c.effect.name, c.fit, stage, past, constants, c.gains) for c in contest.causes]
    if suspected:
        known.append(contender(NOTHING, stage.fit, stage, past, constants))
    return OpenPoint(PointKind.CAUSE, finding.name, stage, tuple(known), suspected)


def open_numbers(stage: SettledModel, past: Sequence[DesignPoint], constants: Sequence[str]) -> list[OpenPoint]:
    """Return coefficients known less well than `WANTED`, and the core, where more than `CORE_OFF_K` is left of it.

    Of the core at the opening counts what the campaign's numbers and shared constants leave; panels scatter
    besides.
    """
    known = contender(NOTHING, stage.fit, stage, past, constants)
    names, press = stage.fit.layout.names, stage.fit.layout.model.press
    blank = OpenPoint(PointKind.COEFFICIENT, "", stage, (known,), along=np.zeros(len(known.before)), wanted=WANTED)
    points = []
    for coefficient in press.free_coefficients:
        along = np.zeros(len(known.before))
        along[names.index(logarithm_of(coefficient))] = 1.0
        points.append(replace(blank, name=coefficient, along=along))
    if press.panel_layers:
        along = _core_of_the_usual(stage, past, constants)
        points.append(replace(blank, kind=PointKind.CORE_BAND, name="core", along=along, wanted=CORE_OFF_K))
    return [p for p in points if (p.half_now or 0.0) > p.wanted]


def _core_of_the_usual(stage: SettledModel, past: Sequence[DesignPoint], constants: Sequence[str]) -> Array:
    """Return what shared numbers and constants do to the core at the opening, mean over runs (x). [K]"""
    total = np.zeros(len(stage.fit.theta) + len(constants))
    for design in past:
        layout = lay_out(stage.fit.layout.model, [design.digest], stage.population, stage.fit.values)
        values = run_values(layout, 0, stage.fit.theta, start_eta(layout, 0, stage.fit.theta))
        coefficients = stage.fit.layout.model.press.free_coefficients
        wanted = [stage.fit.layout.coefficients.get(name, name) for name in stage.fit.layout.names]
        solution = design.digest.solve(stage.fit.layout.model, values, wanted)
        row = opening_row(design.digest)
        for i, name in enumerate(wanted):
            total[i] += solution.d_core[name][row] * (values[name] if name in coefficients else 1.0)
        for i, key in enumerate(constants):
            total[len(wanted) + i] += design.core_K.get(key, 0.0) * (key in design.shared)
    return total / len(past)
