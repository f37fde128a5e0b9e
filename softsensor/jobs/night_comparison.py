"""A candidate against the model in force: what runs that took no part leave with both.

There are two residuals: with a run's own contacts fitted to it, and of a run predicted from its header, its
moments and its platens alone. The prediction has a veto and, where it is surely better, suffices. Where there is a
core thermocouple, both models are held against the same scans of the core.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, InputError, Moments, Run
from daq.words import Message, say
from softsensor.effects.vocabulary import called
from softsensor.fitting.result import left_in
from softsensor.fitting.simulated_run import simulate_run
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.model_in_force import combined_model
from softsensor.jobs.night_basis import FEWEST_RUNS, NightBasis
from softsensor.live.replay import replay
from softsensor.signals.faces import measured_core
from softsensor.signals.moments import moments_of
from softsensor.signals.student import student
from softsensor.signals.unknown import ALPHA

# Numbers without another source were set by hand, 2026-11.

CORE_RUNS, CORE_SEARCHED = 6, 100
"""Runs with a core thermocouple that are replayed through the live sensor with both models; looked for among the
newest."""
LEAST_SHARE = 0.02
"""Of the residual with own contacts, which a model must save whose predictions are not surely better."""
CORE_TOLERANCE, CORE_SLACK_K = 1.02, 0.05
"""Factor by which a candidate may let the error of the live core grow, and how much more.
Set by hand, 2026-11. [-, K]"""
LEAST_VALID = 0.9
"""Of the scans with a core thermocouple that the model in force predicts: a candidate must dare as many."""
ONE_SIDED = 1.0 - ALPHA
"""Of Student's t where only one side counts."""


@dataclass(frozen=True)
class Comparison:
    """A candidate against the model in force."""

    reason: Message
    better: bool
    figures: Mapping[str, Any]
    """What the version says of itself: runs it was judged on and residuals with the model before and with it."""


def compare(
    night: NightBasis,
    report: Mapping[str, Any],
    candidate: ModelFile,
    fits: Mapping[str, Mapping[str, Any]],
    *,
    apart: bool,
    fewer: Sequence[str] = (),
) -> Comparison:
    """Say what the candidate gains on the judging runs, and whether that is enough.

    Where there are too few runs to keep the judging ones apart from the diagnosis, that is noted, and predictions
    are those of the diagnosis, each run by the others. `fewer` effects than before need no gain, only no loss,
    and neither does the first model of its own runs after one of its sisters'.
    """
    key, left = left_in([f[run] for f in (night.fits, fits) for run in fits])
    both = np.reshape(left, (2, -1))
    old, new = both[:, np.isfinite(both).all(axis=0)]
    ahead = _predictions(night, report, candidate, list(fits), apart=apart or bool(fewer))
    figures: dict[str, Any] = {
        "judged_runs": list(fits),
        "judged_runs_took_part": not apart,
        key: {"before": _mean(old), "after": _mean(new)},
    }
    if ahead is not None:
        figures["predicted_rmse_K"] = _both(ahead)
    if len(old) < FEWEST_RUNS:
        return Comparison(say("night-too-few-to-judge"), False, figures)
    core = _core_rmse(night, candidate)
    if core is not None:
        figures["core_rmse_K"] = _both(core)
    against = _against(old, new, ahead, core, fewer=bool(fewer) or night.of_sisters)
    reason = say(
        "night-compared",
        effects=tuple(called(name) for name, _ in candidate.effects),
        without=tuple(map(called, fewer)),
        kind="both" if candidate.effects and fewer else "without" if fewer else "with",
        before=_mean(old),
        after=_mean(new),
        runs=len(old),
        still="yes" if key == "rmse_still_K" else "no",
        apart="yes" if apart else "no",
        predicted=_change("night-compared-predicted", ahead),
        core=_change("night-compared-core", core),
        against="" if against is None else say("night-compared-against", what=Message(f"night-against-{against}")),
    )
    return Comparison(reason, against is None, figures)


class Against(StrEnum):
    """What speaks against a candidate."""

    STILL_HELPS = "still-helps"
    PREDICTS_WORSE = "predicts-worse"
    NOT_SIGNIFICANT = "not-significant"
    CORE_SILENCED = "core-silenced"
    CORE_WORSE = "core-worse"


def _against(
    old: Array, new: Array, ahead: _Predictions | None, core: _Core | None, *, fewer: bool
) -> Against | None:
    """Return what speaks against a candidate, None where nothing does: the first that applies.

    Residuals of the judging runs with the model before and with the candidate, own contacts fitted [K], and what
    both predict.
    """
    share = float(1.0 - np.mean(new) / np.mean(old))
    if fewer:
        if share < -LEAST_SHARE and surely_less(new, old):
            return Against.STILL_HELPS
    elif ahead is not None and ahead.after_K > ahead.before_K:
        return Against.PREDICTS_WORSE
    elif not (ahead is not None and ahead.surely) and (share < LEAST_SHARE or not surely_less(old, new)):
        return Against.NOT_SIGNIFICANT
    if core is not None and core.silenced:
        return Against.CORE_SILENCED
    if core is not None and not core.after_K <= CORE_TOLERANCE * core.before_K + CORE_SLACK_K:
        return Against.CORE_WORSE
    return None


def _change(code: str, errors: _Predictions | _Core | None) -> Message | str:
    return "" if errors is None else Message(code, _both(errors))


def _both(errors: _Predictions | _Core) -> dict[str, float]:
    return {"before": errors.before_K, "after": errors.after_K}


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def surely_less(old: Array, new: Array) -> bool:
    """Return whether residuals of the same runs have fallen: Student's one-sided test of their ratio, at 5 %. [K]

    Of the ratio, since one run that leaves much over would else decide alone how certain the rest is.
    """
    if len(old) < 2:  # one run has no scatter
        return False
    fell = np.log(np.maximum(old, 1e-9)) - np.log(np.maximum(new, 1e-9))
    error = max(float(fell.std(ddof=1)) / math.sqrt(len(fell)), 1e-9)
    return float(fell.mean()) / error > student(len(fell) - 1, ONE_SIDED)


@dataclass(frozen=True)
class _Predictions:
    """Root mean square error of runs predicted without their panel sensors, before and with the candidate. [K]"""

    before_K: float  # noqa: N815
    after_K: float  # noqa: N815
    surely: bool
    """Less in the runs beyond chance."""


def _predictions(
    night: NightBasis, report: Mapping[str, Any], candidate: ModelFile, runs: Sequence[str], *, apart: bool
) -> _Predictions | None:
    """Predict the judging runs with both models; where they took part, what the diagnosis predicted in turn."""
    if not apart:
        before, after = ((report.get(k) or {}).get("predicted_rmse_K") for k in ("base", "extended"))
        low = (report.get("predicted_gain_ci95") or (0.0,))[0]
        return None if before is None or after is None else _Predictions(float(before), float(after), low > 0.0)
    models = (night.base or combined_model(night.press, None, list(night.fits.values())), candidate)
    errors = np.array([_prediction_errors(night, run, models) for run in night.runs(runs)])
    errors = errors[np.isfinite(errors).all(axis=1)]
    if len(errors) < 2:
        return None
    old, new = errors.T
    before_K, after_K = (math.sqrt(_mean(values**2)) for values in (old, new))
    return _Predictions(before_K, after_K, surely_less(old, new))


def _prediction_errors(night: NightBasis, run: Run, models: Sequence[ModelFile]) -> list[float]:
    """Return by model how far a simulated run is from its panel sensors; NaN where it cannot be simulated. [K]"""
    try:
        moments = moments_of(run, night.press)
    except InputError:
        return [math.nan] * len(models)
    return [_prediction_error(night, run, moments, model) for model in models]


def _prediction_error(night: NightBasis, run: Run, moments: Moments, model: ModelFile) -> float:
    try:
        out = simulate_run(run, night.press, model.model(night.press), model.values, known=moments)
    except InputError:
        return math.nan
    squares = [(out.measured[place] - values) ** 2 for place, values in out.places.items()]
    finite = [s[np.isfinite(s)] for s in squares]
    return math.sqrt(_mean(np.concatenate(finite))) if any(len(s) for s in finite) else math.nan


@dataclass(frozen=True)
class _Core:
    """Root mean square error of the core before and with the candidate, where both are valid. [K]"""

    before_K: float  # noqa: N815
    after_K: float  # noqa: N815
    silenced: bool
    """The candidate calls many scans not valid that the model before predicts."""


def _core_rmse(night: NightBasis, candidate: ModelFile) -> _Core | None:
    """Replay runs with a core thermocouple through the live sensor with both models; None where there is none."""
    errors = list(_core_errors(night, candidate))
    if not errors:
        return None
    before, after = (np.concatenate(runs) for runs in zip(*errors, strict=True))
    both = np.isfinite(before) & np.isfinite(after)
    if not np.isfinite(before).any():
        return None
    silenced = int(both.sum()) < LEAST_VALID * int(np.isfinite(before).sum())
    old, new = (math.sqrt(_mean(errors[both] ** 2)) if both.any() else math.nan for errors in (before, after))
    return _Core(old, new, silenced)


def _core_errors(night: NightBasis, candidate: ModelFile) -> Iterator[tuple[Array, Array]]:
    """Yield both models' errors of the core scan by scan, NaN where there is no truth or no valid core. [K]"""
    count = 0
    for record in night.records[: -CORE_SEARCHED - 1 : -1]:
        if count >= CORE_RUNS:
            break
        run = night.run(record.run)
        if run is None:
            continue
        core = measured_core(night.press, run)
        if not np.isfinite(core).any():
            continue
        count += 1
        with suppress(InputError):  # a run without platens shows no core, whatever the model
            before, after = (_errors(night.press, run, model, core) for model in (night.base, candidate))
            yield before, after


def _errors(press: Press, run: Run, model: ModelFile | None, core: Array) -> Array:
    estimates = replay(press, run, model).estimates
    predicted: Array = np.array([e.core_C if e.valid else math.nan for e in estimates])
    return predicted - core
