"""What a cause saves on runs left out, with what a run's own numbers could do in its place held.

A run's moments make up for a clock, its platens' errors for platens that are off in all runs, its panel's
constants for other constants, its contacts for the pressure that they follow. Fitted to a run left out, they would
leave such a cause nothing to save.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq.records import Array
from softsensor.diagnosis.extension import RunState, SharedFit, each_run, fit_run_to, from_the_others, held_out
from softsensor.diagnosis.extension_unknowns import start_eta
from softsensor.diagnosis.gains import Gain
from softsensor.diagnosis.settling import LeftOut, SettledModel, gain_of
from softsensor.effects import Effect, Need, clock_offset
from softsensor.heat.timing import OPENING_RAMP_S
from softsensor.signals.digest import Digest, Whitened

SWITCHED = clock_offset.EFFECT.made_up_by
HELD = 1e-6
"""A number known so well stays where it is held, whatever the readings say: a moment [s], a logarithm."""


def made_up_for(effect: Effect, data: Sequence[Whitened]) -> bool:
    """Whether a run's own numbers can do the same: its contacts only where its pressure stays as it is."""
    if effect.needs == Need.LOAD:
        return between_runs(effect, data)
    return bool(effect.made_up_by or effect.of_constant)


def between_runs(effect: Effect, data: Sequence[Whitened]) -> bool:
    """Whether an effect shows in nothing but what the runs' contacts differ by: all are fitted, loads constant."""
    return effect.needs == Need.LOAD and all(_contacts_make_up(d.digest) for d in data)


def _contacts_make_up(digest: Digest) -> bool:
    case = digest.cases[False]
    fitted = case.press.free_coefficients
    return not varies([closed_loads(digest)]) and all(case.press.contact[m].closed in fitted for m in case.load)


def closed_loads(digest: Digest) -> dict[int, Array]:
    """Return the pressure over its reference by contact, in each step while closed: an open press has none."""
    case, moments = digest.cases[False], digest.moments
    middle = 0.5 * (case.edges[1:] + case.edges[:-1])
    shut = ~(middle <= moments.closed_s + moments.ramp_s) & ~(middle > moments.opened_s - OPENING_RAMP_S)
    return {m: load[shut] for m, load in case.load.items()}


def varies(loads: Sequence[Mapping[int, Array]]) -> bool:
    """Whether pressures (by contact, in each step) differ enough that something could follow them."""
    values = [v for load in loads for series in load.values() if len(series) for v in (series.min(), series.max())]
    return bool(values) and max(values) > 1.05 * min(values)


def held_gain(stage: SettledModel, fit: SharedFit, effect: Effect) -> Gain:
    """Return what an effect, fitted on top of a stage, saves on runs left out.

    Moments are held at the limit switch, and steep ones count whole; platens at their readings; contacts that
    follow a load at what the other runs give; a panel's constants at those given.
    """
    before, after = (LeftOut.of(_held(f, stage.data, effect)) for f in (stage.fit, fit))
    data = [d.as_given for d in stage.data] if effect.of_constant else stage.data
    return gain_of(data, before, after, whole=effect.needs == Need.SWITCH)


def _held(fit: SharedFit, data: Sequence[Whitened], effect: Effect) -> list[RunState]:
    thetas = from_the_others(fit, data)
    if effect.of_constant:
        return held_out(fit, [d.as_given for d in data], rounds=3, thetas=thetas)
    names = [_made_up_by(d.digest, effect) for d in data]
    unknowns = tuple(
        tuple(replace(u, sd=HELD) if u.name in held else u for u in of_run)
        for of_run, held in zip(fit.layout.unknowns, names, strict=True)
    )
    layout = replace(fit.layout, unknowns=unknowns)

    def left_out(r: int) -> RunState:
        own = np.array([u.name not in names[r] for u in unknowns[r]])
        begin = np.where(own, fit.runs[r].eta, start_eta(layout, r, thetas[r]))
        return fit_run_to(layout, r, data[r], thetas[r], begin)

    return each_run(left_out, len(data))


def _made_up_by(digest: Digest, effect: Effect) -> Sequence[str]:
    """Return a run's own numbers that can do what an effect does."""
    if effect.needs == Need.SWITCH and digest.switch is None:
        return ()
    if effect.needs != Need.LOAD:
        return effect.made_up_by
    return list(loads(digest))


def loads(digest: Digest) -> dict[str, float]:
    """Return the mean logarithm of the pressure while closed by closed contact that follows one."""
    contact = digest.cases[False].press.contact
    shut = closed_loads(digest).items()
    return {contact[m].closed: float(np.mean(np.log(load))) for m, load in shut if len(load)}


def load_scores(stage: SettledModel) -> Array:
    """Return how far each run's contacts lie off where its pressure does, in standard deviations (runs).

    Contacts fitted to each run make up for its pressure completely, so nothing of it is left in the temperatures.
    The products of both deviations have the correlation as their mean; Fisher's transformation makes a normal
    number of it, which is not bounded by how many runs there are (Fisher, Metron 1, 3, 1921).
    """
    scores = np.zeros(len(stage.data))
    by_run = [loads(d.digest) for d in stage.data]
    for name in sorted(set().union(*by_run)):
        own = [[estimate for _, estimate in of_run] for of_run in stage.fit.own((name,))]
        there = [r for r, of_run in enumerate(by_run) if name in of_run and own[r]]
        if (count := len(there)) > 3:
            both = _standard([own[r][0] for r in there]) * _standard([by_run[r][name] for r in there])
            r = float(np.clip(both.mean(), 1.0 / count - 1.0, 1.0 - 1.0 / count))
            scores[there] += both * (np.arctanh(r) / r if r else 1.0) * (1.0 - 3.0 / count) ** 0.5  # Metron 1921
    return scores


def _standard(values: Sequence[float]) -> Array:
    off = np.array(values) - np.mean(values)
    return np.asarray(off / max(float(np.std(off)), np.finfo(float).tiny))
