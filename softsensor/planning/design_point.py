"""A pressing that was not pressed, seen from a campaign's fit: what it would say about the campaign's numbers.

The diagnosis' own least squares (`softsensor.diagnosis.extension`) with readings that a model makes instead of
measured ones; the run's own numbers (contacts about the campaign's level, moments, start, platens, offsets) are
free as they are there. Beside them stand the constants' doubts (`softsensor.signals.doubt`), each by the change of
the readings for one standard deviation: what scatters from panel to panel is the run's own, what stays with press
or material is shared by all runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.press.press_file import At, Press, Sensor, press_for_run
from daq.records import Array, Moments, Run
from softsensor.diagnosis.extension import RunState, SharedFit, evaluate
from softsensor.diagnosis.extension_unknowns import (
    lay_out,
    logarithm_of,
    run_values,
    start_eta,
)
from softsensor.diagnosis.settling import SettledModel
from softsensor.fitting.constants import changed_run, fit_doubts
from softsensor.heat.model import ThermalModel
from softsensor.planning.information import RunInformation
from softsensor.signals.digest import STEP_S, Digest, Whitened, digest_run, slope_of
from softsensor.signals.doubt import PANEL_SCATTER, Doubt, Origin
from softsensor.signals.instrument import BURIED_K

CORE = "planned_in_the_core"
"""Column of a thermocouple in the core that is only planned; no pattern of a press file names it."""


@dataclass(frozen=True)
class DesignPoint:
    """One pressing with its constants' doubts, measured or not."""

    digest: Digest
    own: Mapping[str, Array]
    """By constant: what one standard deviation of its scatter from run to run does (bins, signals). [K]"""
    shared: Mapping[str, Array]
    """The same of what all runs have in common of its doubt. [K]"""
    core_K: Mapping[str, float]  # noqa: N815
    """By constant: what that does to the core at the opening. [K]"""


def with_core(press: Press, thickness_mm: float) -> Press:
    """Return the press with one more thermocouple, in the middle of its panel, that a fit may use."""
    buried = Sensor(columns=(CORE,), at=At(layer=press.panel_layers[0], depth_mm=thickness_mm / 2.0))
    return press.model_copy(update={"sensor": (*press.sensor, buried)})


def shares(key: str, doubt: Doubt) -> tuple[float, float]:
    """Return how much of a constant's doubt is the run's own and how much all runs share, in standard deviations.

    A number for all products of a name is off by the same in every panel of one product, but for the panels' own
    scatter; plates and gauges stay the same from run to run, a buried thermocouple comes with its panel.
    """
    if not key.startswith("panel."):
        return (1.0, 0.0) if key.startswith(("ambient.", "sensor.")) else (0.0, 1.0)
    if doubt.source not in (Origin.MATERIAL_TABLE, Origin.GUESS) or doubt.relative <= PANEL_SCATTER:
        return 1.0, 0.0
    own = PANEL_SCATTER / doubt.relative
    return own, math.sqrt(1.0 - own**2)


def design_point_of(press: Press, digest: Digest, fit: SharedFit) -> DesignPoint:
    """Return a pressing as a point of the design; constants change about the campaign's usual numbers."""
    run, case = digest.run, digest.cases[False]
    effects = tuple(e for e in fit.layout.model.effects if not e.layers)
    model = ThermalModel(press, effects)
    values = fit.values
    values |= {n: float(np.exp(values[logarithm_of(n)])) for n in press.free_coefficients}
    values = model.guesses | {n: v for n, v in values.items() if n in model.parameter_names}
    plain, row = model.solve(case, values), opening_row(digest)
    own, shared, core = {}, {}, {}
    for key, doubt in fit_doubts(run, press).items():
        if doubt.sd <= 0.0:
            continue
        changed = model.prepare(changed_run(run, press, key, -doubt.sd), digest.moments, max_step_s=STEP_S)
        read = replace(changed, run=case.run, columns=case.columns, place_of=case.place_of)
        moved = model.solve(read, values)
        step = digest.observed(plain) - digest.observed(moved)
        by_run, common = shares(key, doubt)
        core[key] = float(plain.core[row] - moved.core[row])
        if by_run > 0.0:
            own[key] = by_run * step
        if common > 0.0:
            shared[key] = common * step
    return DesignPoint(digest, own, shared, core)


def opening_row(digest: Digest) -> int:
    """Return the sample at which the press opens, the last where it stays closed."""
    opened = digest.moments.opened_s
    return int(np.searchsorted(digest.samples, opened)) - 1 if np.isfinite(opened) else -1


def planned_digest(press: Press, run: Run, moments: Moments, like: Digest) -> Digest:
    """Return the digest of a run not pressed, with the channels and offsets of a measured one, its readings empty.

    Raises InputError for a run that the press cannot be solved with.
    """
    channels = [c for names in like.channels.values() for c in names]
    planned = (CORE,) if any(CORE in s.columns for s in press.sensor) else ()
    filled = {c: np.zeros(len(run.time_s)) for c in (*channels, *planned)}
    excluded = frozenset(press_for_run(press, run).sensors_of(run)) - set(channels)
    digest = digest_run(press, replace(run, columns={**run.columns, **filled}), moments, excluded)
    known = {s: BURIED_K for s in digest.signals} | dict(zip(like.signals, like.offset_sd, strict=True))
    return replace(digest, offset_sd=np.array([known[s] for s in digest.signals]))


def with_readings(digest: Digest, fit: SharedFit, population: Mapping[str, float]) -> Digest:
    """Return a digest that reads what a fit expects of it."""
    layout = lay_out(fit.layout.model, [digest], population, fit.values)
    values = run_values(layout, 0, fit.theta, start_eta(layout, 0, fit.theta))
    y = digest.observed(digest.solve(layout.model, values))
    slope = np.stack([slope_of(digest.time, y[:, i]) for i in range(y.shape[1])], axis=1)
    return replace(digest, y=y, slope=slope)


def information_of(
    design: DesignPoint, state: RunState, data: Whitened, constants: Sequence[str]
) -> RunInformation:
    """Return what a run says about the campaign's numbers and the shared `constants` after them.

    Parameters
    ----------
    state
        The run as a fit sees it (`extension.evaluate`): its residual is what the fit does not explain.
    """

    def rows(steps: Sequence[Array]) -> Array:
        found = np.zeros((len(state.residual), len(steps)))
        if steps:
            white = data(np.stack(steps, axis=-1))
            found[: len(white)] = white
        return found

    nothing = np.zeros_like(design.digest.y)
    shared = np.hstack([state.shared_jacobian, rows([design.shared.get(key, nothing) for key in constants])])
    own = np.hstack([state.jacobian, rows(list(design.own.values()))])
    count = len(design.own)
    own = np.vstack([own, np.hstack([np.zeros((count, own.shape[1] - count)), np.eye(count)])])
    shared = np.vstack([shared, np.zeros((count, shared.shape[1]))])
    residual = np.concatenate([state.residual, np.zeros(count)])
    q, _ = np.linalg.qr(own)
    outer, rest = shared - q @ (q.T @ shared), residual - q @ (q.T @ residual)
    return RunInformation(outer.T @ outer, outer.T @ rest, float(rest @ rest))


def expected(
    design: DesignPoint, fit: SharedFit, stage: SettledModel, digest: Digest, constants: Sequence[str]
) -> RunInformation:
    """Return what a run with some readings says about a fit's numbers, its own at what the campaign expects."""
    data = Whitened.of(digest, stage.noise)
    layout = lay_out(fit.layout.model, [digest], stage.population, fit.values)
    state = evaluate(layout, 0, data, fit.theta, start_eta(layout, 0, fit.theta))
    return information_of(design, state, data, constants)
