"""Which causes a model may leave out, as the runs it rests on see them: what the live sensor's band needs to know.

A good fit of the faces does not prove the core: coefficients absorb nearly every cause. What they cannot
absorb shows over several runs. For every cause of the catalogue, at its typical size, a run gives the
direction in which its readings would move, d, less what the run's own unknowns can imitate; with residual r,
both whitened,

    score U = d'r    power I = d'd    size a = sum U / sum I    gain = (sum U)^2 / (2 sum I)

The error of `a` is the larger of what the noise says and what the runs say by their scatter. Beside it goes
what the coefficients have taken upon themselves to hide the cause. Nothing here names a cause or changes a
model, that is the diagnosis' business: chances and sizes only make the band as wide as it has to be.

Chances (2026-11-21): directions are finite differences at one size and single causes only, so causes that
explain nearly as much as the best are not distinguished: their chance falls by a factor e for each `BLUR` share
of the best gain that they fall short.

The numbers below were set by hand in 2026-11, so that the live sensor's band holds what it promises on virtual
campaigns (`tests/benchmarks/test_live_sensor.py`); none of them names a cause.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.records import Array
from softsensor.effects import Effect, Need, Role, catalogue
from softsensor.effects.parameters import USUAL_SPREAD
from softsensor.fitting.constants import with_constants_of
from softsensor.fitting.problem import Evaluation, FitProblem, constants_among, inverse, normal_equations
from softsensor.fitting.result import left_in
from softsensor.heat.model_file import FittedValue, MissingCause, MissingCauses, ModelFile
from softsensor.signals.student import student
from softsensor.signals.unknown import BAND

if TYPE_CHECKING:
    from softsensor.fitting.result import RunFit

BLUR, BLUR_NATS = 0.12, 2.0
"""How much less a cause may explain than the best: a share of the best gain, and nats besides."""
BEFORE = 0.06
"""Chance of one cause before any run was seen."""
SIZE_FLOOR = 0.1
"""Directions are straight lines through a curved model: sizes are known to this share at best."""
STEEP_K = 0.05
"""Rows whose timing alone is worth more than this say nothing about what is left unexplained. [K]"""
USUAL_REST_K = 0.25
"""What noise and small faults leave of the residuals of a face. [K]"""


@dataclass(frozen=True)
class RunEvidence:
    """What one run says about one cause."""

    score: float
    power: float
    absorbed: Mapping[str, float]
    """Change of the coefficients' logarithms that imitates the cause's typical size best, with its sign turned."""
    rest_K: float  # noqa: N815
    """Residual that stays when the cause is given this run's own best size. [K]"""

    def as_json(self) -> dict[str, Any]:
        """Return it as a stored fit carries it."""
        shifts = {name: round(value, 4) for name, value in self.absorbed.items()}
        return {"score": self.score, "power": self.power, "absorbed": shifts, "rest_K": round(self.rest_K, 4)}

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> RunEvidence:
        """Read what `as_json` wrote."""
        return cls(float(entry["score"]), float(entry["power"]), dict(entry["absorbed"]), float(entry["rest_K"]))


CauseScores = Mapping[str, RunEvidence]
"""Of one run, by cause; the empty name is no cause at all."""


def run_evidence(problem: FitProblem, at: Evaluation) -> dict[str, RunEvidence]:
    """Return what a fitted run says about every cause its model leaves out.

    Parameters
    ----------
    problem, at
        The run as it was fitted, and the minimum.
    """
    matrix, pull = normal_equations(problem, at)
    free = np.diag(matrix) > 1e-9
    free[constants_among(problem)] = False  # the fit holds them
    inner = np.zeros_like(matrix)
    inner[np.ix_(free, free)] = inverse(matrix[np.ix_(free, free)])
    values = problem.merged(at.x)
    base = problem.model.solve(problem.case, values).sensors
    found = {"": RunEvidence(0.0, 0.0, {}, _rms(problem, list(at.residual)))}
    for effect in candidates(problem):
        moved = _moved(problem, effect, values, base)
        white = np.concatenate(
            [problem.whiten(i, np.column_stack([r, moved[i]]))[:, 1] for i, r in enumerate(at.residual)]
        )
        white = np.where(at.z == 0.0, 0.0, white)
        along = at.jacobian.T @ (at.weight * white)
        answer = -inner @ along
        score = float(white @ (at.weight * at.z) + answer @ pull)
        power = float(white @ (at.weight * white) + answer @ along)
        if power < 1e-6:
            continue
        size = score / power
        rest = [r - size * (m + d @ answer) for r, m, d in zip(at.residual, moved, at.derivative, strict=True)]
        shifts = {u.name: float(s) for u, s in zip(problem.unknowns, answer, strict=True) if u.log}
        found[effect.name] = RunEvidence(score, power, shifts, _rms(problem, rest))
    return found


def candidates(problem: FitProblem) -> list[Effect]:
    """Return the causes a run's model leaves out and that the run could show.

    Not those in whose place every run has unknowns of its own, nor one of the load where none is measured: only
    several runs show it then.
    """
    own = {e.name for e in problem.model.effects}
    panel = bool(problem.case.press.panel_layers)
    return [
        e
        for e in catalogue().values()
        if e.name not in own and e.parameters and (panel or e.needs != Need.PANEL)
        if e.live.role is not Role.OF_THE_RUN and (e.needs != Need.LOAD or problem.case.press.load_references)
    ]


def with_missing_causes(model: ModelFile, fits: Sequence[RunFit]) -> ModelFile:
    """Return a model file with what fitted runs, made with its effects, say about other causes.

    A run that the model does not describe says nothing about them; where it describes none, all that is known
    is how far off it is, and for that they count.
    """
    met = [fit for fit in fits if fit.met]
    missing = missing_causes([run_evidence(fit.problem, fit.minimum.evaluation) for fit in met or fits])
    return replace(model, missing=missing if met else _far_off(missing, [fit.rmse_still_K for fit in fits]))


def held_against(model: ModelFile, fits: Sequence[RunFit]) -> ModelFile:
    """Return a model file with all that fitted runs, made with its effects, know beside coefficients and effects.

    Causes it may leave out, how constants scatter, which panels there were; the last two from runs it describes.
    """
    return with_constants_of(with_missing_causes(model, fits), [fit.constants for fit in fits if fit.met])


def stored_missing_causes(fits: Sequence[Mapping[str, Any]]) -> MissingCauses | None:
    """Return what stored fits (entries of ``fit --json``) say, None where none carries evidence.

    Runs the model does not describe count as in `with_missing_causes`.
    """
    met = [fit for fit in fits if fit.get("met", True)]
    found = [fit["evidence"] for fit in met or fits if fit.get("evidence")]
    missing = missing_causes([{name: RunEvidence.from_json(e) for name, e in run.items()} for run in found])
    return missing if met else _far_off(missing, left_in(fits)[1].tolist())


def _far_off(missing: MissingCauses | None, left: Sequence[float]) -> MissingCauses | None:
    """Return the chances for runs the model describes none of: no cause takes anything of what is left."""
    known = [kelvins for kelvins in left if math.isfinite(kelvins)]
    if missing is None or not known:
        return missing
    return replace(missing, runs=0, unexplained_K=max(missing.unexplained_K, float(np.median(known))))


def _moved(problem: FitProblem, effect: Effect, values: Mapping[str, float], base: Array) -> list[Array]:
    """Return by place what the cause at its typical size adds to the readings (rows). [K]"""
    model, case = problem.model.extended(effect), problem.case
    there = dict(values) | {effect.key(p.name): p.typical for p in effect.parameters}
    if effect.layers:  # a mesh of its own, so compare like with like
        case = model.prepare(case.run, case.moments)
        base = model.solve(case, dict(values) | {effect.key(p.name): p.neutral for p in effect.parameters}).sensors
    moved = model.solve(case, there).sensors - base
    return [moved[:, case.columns.index(place.columns[0])] for place in problem.signals.places]


def _rms(problem: FitProblem, residual: Sequence[Array]) -> float:
    """Return the residual of the places' means, their own means taken out, away from steep slopes. [K]"""
    total, count = 0.0, 0
    for i, r in enumerate(residual):
        calm = problem.blur[i] < STEEP_K if problem.blur else True
        own = r[(problem.rows > 0) & np.isfinite(r) & calm]
        total += float(((own - own.mean()) ** 2).sum()) if len(own) else 0.0
        count += len(own)
    return math.sqrt(total / max(count, 1))


def missing_causes(runs: Sequence[CauseScores]) -> MissingCauses | None:
    """Put the evidence of runs together; None where there is none."""
    runs = [run for run in runs if run]
    if not runs:
        return None
    names = sorted({name for run in runs for name in run if name})
    sized = {name: _Size.of(name, [run[name] for run in runs if name in run]) for name in names}
    best = max([size.gain for size in sized.values()], default=0.0)
    blur = BLUR_NATS + BLUR * best
    odds = {name: BEFORE * math.exp((size.gain - best) / blur) * size.narrowing for name, size in sized.items()}
    nothing = max(1.0 - BEFORE * len(names), BEFORE) * math.exp(-best / blur)
    total = nothing + sum(odds.values())
    causes = {name: _missing_cause(name, sized[name], odds[name] / total) for name in names}
    rest = [min(e.rest_K for e in run.values()) for run in runs]
    unexplained = math.sqrt(max(float(np.median(rest)) ** 2 - USUAL_REST_K**2, 0.0))
    return MissingCauses(len(runs), nothing / total, unexplained, causes)


@dataclass(frozen=True)
class _Size:
    """A cause's size in units of its typical one."""

    mean: float
    sd: float
    gain: float
    narrowing: float
    """Occam's factor: how much the runs narrow the size."""
    absorbed: Mapping[str, float]

    @classmethod
    def of(cls, name: str, runs: Sequence[RunEvidence]) -> _Size:
        score, power = np.array([e.score for e in runs]), np.array([e.power for e in runs])
        size = float(score.sum() / power.sum())
        noise = 1.0 / math.sqrt(power.sum())
        count = len(runs)
        scattered = float(np.sqrt(((score - size * power) ** 2).sum()) / power.sum())
        scattered *= math.sqrt(count / max(count - 1, 1)) * student(max(count - 1, 2)) / BAND
        error = math.hypot(max(noise, scattered), SIZE_FLOOR * size)
        gain = 0.5 * (size / noise) ** 2
        if size < 0.0 and _one_sided(name):
            size, gain = 0.0, 0.0
        keep = 1.0 / (1.0 + error**2)
        names = sorted({key for e in runs for key in e.absorbed})
        absorbed = {key: float(np.median([e.absorbed.get(key, 0.0) for e in runs])) for key in names}
        return cls(size * keep, error * math.sqrt(keep), gain, min(error, 1.0), absorbed)


def _missing_cause(name: str, size: _Size, chance: float) -> MissingCause:
    effect = catalogue()[name]
    table = {}
    for p in effect.parameters:
        unit = p.typical - p.neutral
        between = size.mean * (p.spread or USUAL_SPREAD)
        table[p.name] = FittedValue(p.neutral + unit * size.mean, abs(unit) * math.hypot(size.sd, between))
        if unit == 0.0:
            table[p.name] = FittedValue(p.typical, 0.0)
    return MissingCause(chance, size.mean, table, size.absorbed)


def _one_sided(name: str) -> bool:
    return catalogue()[name].parameters[0].one_sided
