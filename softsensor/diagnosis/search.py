"""The search for a cause: on top of a model settled on all runs, every candidate fitted for real.

Candidates are not ranked by a linear score alone: a secant of the wrong size leaves a remainder that
the next candidate then explains (facts measured with a prototype: up to 100 % spurious second names).
Every candidate starts from its secant, takes a few Gauss-Newton rounds together with all coefficients
and nuisances, and those that keep up with the best go on to convergence (successive halving).

Its numbers were set by hand in 2026-11, while campaigns of the virtual press were read. Only `LARGEST_SIZE` and
`LIMIT` decide on a name (`Claim.unphysical`); the others say how much work a candidate is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.diagnosis.directions import Direction, direction
from softsensor.diagnosis.extension import (
    ROUNDS,
    RunState,
    SharedFit,
    fit_campaign_model,
    held_out,
    unstuck,
)
from softsensor.diagnosis.extension_unknowns import is_shape, lay_out
from softsensor.diagnosis.gains import Gain
from softsensor.diagnosis.held import (
    SWITCHED,
    between_runs,
    closed_loads,
    held_gain,
    load_scores,
    loads,
    made_up_for,
    varies,
)
from softsensor.diagnosis.settling import LeftOut, SettledModel, finer, gain_of, scatter, whiten_all
from softsensor.effects import Effect, Need, catalogue
from softsensor.heat.model import ThermalModel
from softsensor.heat.timing import OPENING_RAMP, TIMINGS
from softsensor.signals.digest import Whitened
from softsensor.signals.unknown import Unknown

PROBE = 0.5
"""Secants are taken at this share of an effect's typical size."""
FRESH_SIZES = (1.3, -1.0)
"""Effects of the measuring chain are also tried from these sizes, in typical ones."""
FAR_OFF = 1.15
"""Cost per reading above which every candidate is fitted, whatever its secant promises."""
CLOCK_ERROR_S = 0.04
"""What no campaign can separate from a clock: skew within a scan, and where in its ramp a switch trips. By hand,
2026-11. [s]"""
NEAR = 0.35
"""Candidates below this share of the best gain after the first rounds are dropped."""
HOPELESS = 9.0
"""Sum of squares a candidate must promise, or save, to be worth more rounds."""
LARGEST_SIZE = 5.0
"""Of a physical effect's typical size; a larger one is something else. A measuring chain has no such limit."""
LIMIT = 0.01
"""An amplitude this close to a limit, as a share of its range, has reached it."""
KEPT = 0.3
"""A first fit that keeps less of what its secant promised is tried again from the guesses, if it is worth it."""
KEEP = 5
"""Candidates fitted to convergence, at most."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One more effect, fitted."""

    effect: Effect
    direction: Direction
    """Secant from the stage's fit."""
    fit: SharedFit
    gain: float
    """Sum of squares saved."""
    gains: Array
    """Sum of squares each run saves with shared numbers from the other runs (runs)."""
    refined: bool
    others: tuple[RunState, ...] = ()
    """Each run by numbers from the others."""
    held: Gain | None = None
    """What it saves on runs left out whose own numbers that make up for it are held (`made_up_for`)."""
    score: Array = field(default_factory=lambda: np.zeros(0))
    """Each run's score along the direction at the fitted size (runs)."""

    __repr__ = on_screen

    def among(self, stage: SettledModel, runs: np.ndarray) -> Candidate:
        """Return what some of the runs say for it."""
        gain = sum(stage.fit.runs[r].cost - self.fit.runs[r].cost for r in runs)
        gain += len(runs) * _narrower(stage.fit, self.fit)
        others = tuple(self.others[r] for r in runs) if self.others else ()
        fit = replace(self.fit, runs=tuple(self.fit.runs[r] for r in runs))
        return replace(
            self, fit=fit, gain=max(gain, 0.0), gains=self.gains[runs], others=others, score=self.score[runs]
        )

    @property
    def size(self) -> float:
        """Of its largest amplitude, in typical sizes."""
        return size_in(self.fit, self.effect)

    @property
    def too_large(self) -> bool:
        """Whether an amplitude has left what is physical: the data behave like this cause at most."""
        for p in self.effect.parameters:
            value, edge = self.fit.values[self.effect.key(p.name)], LIMIT * (p.upper - p.lower)
            ends = [abs(value - limit) < edge for limit in (p.lower, p.upper) if limit != p.neutral]
            huge = abs(value - p.neutral) > LARGEST_SIZE * abs(p.typical - p.neutral)
            if not is_shape(p) and (any(ends) or (huge and not self.effect.measuring)):
                return True
        return False

    @property
    def saves(self) -> Array:
        """Sum of squares each run, left out, saves; of a clock what the limit switch says alone (runs)."""
        if self.effect.needs != Need.SWITCH:
            return self.gains
        return np.asarray(np.sign(self.score.sum()) * self.score * np.abs(self.score))

    def heldout_gain(self, stage: SettledModel) -> Gain:
        """Return what it saves on runs left out."""
        if self.held or not self.others:
            return self.held or Gain(0.0, None)
        return gain_of(stage.data, LeftOut.of(stage.fit.runs), LeftOut.of(self.others))


def size_in(fit: SharedFit, effect: Effect) -> float:
    """Return the size of an effect's largest amplitude in a fit, in typical sizes."""
    values = fit.values
    sizes = [
        abs(values[effect.key(p.name)] - p.neutral) / abs(p.typical - p.neutral)
        for p in effect.parameters
        if not is_shape(p)
    ]
    return max(sizes, default=0.0)


def core_errors(fit: SharedFit, data: Sequence[Whitened]) -> Array:
    """Return how far a model is from core thermocouples, root mean square; NaN where none is (runs). [K]"""
    found = np.full(len(data), np.nan)
    for r, (run, d) in enumerate(zip(fit.runs, data, strict=True)):
        errors = np.array([v - run.validation[c] for c, v in d.digest.cores.items()])
        if np.isfinite(errors).any():
            found[r] = float(np.sqrt(np.nanmean(errors**2)))
    return found


def extend(stage: SettledModel, candidate: Candidate) -> SettledModel:
    """Take a candidate in: fit again with the spread and noise it leaves."""
    fit = candidate.fit
    digests = [d.digest for d in stage.data]
    noise, panel_sd = finer(stage.noise, replace(stage, fit=fit).misfit)
    data, population = whiten_all(digests, noise, panel_sd), scatter(fit)
    layout = lay_out(fit.layout.model, digests, population, fit.values)
    fit = unstuck(fit_campaign_model(layout, data, [r.eta for r in fit.runs], rounds=6), data)
    return SettledModel(fit, data, population, noise)


def candidates_for(stage: SettledModel) -> list[Effect]:
    """Return the catalogue's effects these runs can say something about."""
    digests = [d.digest for d in stage.data]
    press = stage.fit.layout.model.press
    pressures = [closed_loads(d) for d in digests]
    found = []
    for effect in catalogue().values():
        if not effect.parameters:
            continue
        if effect.needs == Need.PANEL and not press.panel_layers:
            continue
        if effect.needs == Need.SWITCH and not any(d.switch is not None for d in digests):
            continue
        if effect.needs == Need.LOAD and not varies(pressures):
            continue
        found.append(effect)
    return found


def search(stage: SettledModel, effects: Iterable[Effect], progress: Progress | None = None) -> list[Candidate]:
    """Fit every candidate on top of a stage; best first."""
    probes = []
    misfit = stage.misfit
    for effect in effects:
        if progress is not None:
            progress(effect.name)
        size, secant = best_secant(stage, effect)
        hopeless = secant.gain < HOPELESS and misfit < FAR_OFF
        if hopeless and not effect.measuring and not between_runs(effect, stage.data):
            fit = stage.fit
            zeros = np.zeros(len(stage.data))
            probes.append(Candidate(effect, secant, fit, 0.0, zeros, refined=False, score=secant.scores))
        else:
            probes.append(probe(stage, effect, size, secant, rounds=3))
    most = max(c.gain for c in probes)
    probes = [_from_guesses(stage, c) if c.direction.gain > max(most, HOPELESS) else c for c in probes]
    probes.sort(key=lambda c: -c.gain)
    best = probes[0].gain
    found = []
    for i, candidate in enumerate(probes):
        keeps_up = candidate.gain > max(NEAR * best, HOPELESS)
        if i < KEEP and keeps_up:
            if progress is not None:
                progress(f"{candidate.effect.name}, refined")
            candidate = refine(stage, candidate)
        found.append(candidate)
    return sorted(found, key=lambda c: (-c.gain, c.effect.name))


def best_secant(stage: SettledModel, effect: Effect) -> tuple[float, Direction]:
    """Return the size and sign of an effect whose direction promises most, and the direction."""
    model = stage.fit.layout.model.extended(effect)
    options = [_secant(stage, model, effect, size) for size in _sizes(effect)]
    forward = [o for o in options if o[1].amplitude > 0] or options[:1]
    return max(forward, key=lambda o: o[1].gain)


def probe(stage: SettledModel, effect: Effect, size: float, secant: Direction, rounds: int) -> Candidate:
    """Fit an effect on top of a stage from where its direction points, a few rounds."""
    model = stage.fit.layout.model.extended(effect)
    amplitude = float(np.clip(secant.amplitude, 0.02, 3.0))
    start = dict(stage.fit.values)
    for p in effect.parameters:
        reach = 1.0 if is_shape(p) else amplitude * size
        start[effect.key(p.name)] = float(np.clip(p.neutral + reach * (p.typical - p.neutral), p.lower, p.upper))
    digests = [d.digest for d in stage.data]
    layout = lay_out(model, digests, stage.population, start)
    etas = [
        _grown(layout.unknowns[i], r.eta + amplitude * o)
        for i, (r, o) in enumerate(zip(stage.fit.runs, secant.own, strict=True))
    ]
    fit = fit_campaign_model(layout, stage.data, etas, rounds=rounds, tolerance=1.0)
    if effect.needs == Need.SWITCH or (effect.measuring and stage.misfit > FAR_OFF):
        rounds = ROUNDS if effect.needs == Need.SWITCH else rounds + 1
        fit = min([fit, *_fresh_fits(stage, model, effect, rounds)], key=lambda f: f.cost)
    if between_runs(effect, stage.data):
        fit = _with_its_scatter(stage, fit)
    score = switch_scores(stage) if effect.needs == Need.SWITCH else secant.scores
    zeros = np.zeros(len(stage.data))
    return Candidate(effect, secant, fit, saved(stage.fit, fit), zeros, refined=False, score=score)


def _with_its_scatter(stage: SettledModel, fit: SharedFit) -> SharedFit:
    """Fit again with the scatter that a cause leaves of the contacts that follow it: it may be all they differ by.

    That of others is no evidence: learned again from estimates that the one before has drawn in, it only shrinks.
    """
    digests = [d.digest for d in stage.data]
    follow = set().union(*(loads(d) for d in digests))
    spread = {n: sd if n in follow else stage.population.get(n, sd) for n, sd in scatter(fit).items()}
    layout = lay_out(fit.layout.model, digests, spread, fit.values)
    return fit_campaign_model(layout, stage.data, [r.eta for r in fit.runs], rounds=4, tolerance=1.0)


def _narrower(before: SharedFit, after: SharedFit) -> float:
    """Return what less scatter of the coefficients adds to each run's likelihood, as a sum of squares."""
    pairs = zip(before.layout.unknowns[0], after.layout.unknowns[0], strict=False)
    return float(sum(2.0 * np.log(b.sd / a.sd) for b, a in pairs if b.shared))


def saved(before: SharedFit, after: SharedFit) -> float:
    """Return the sum of squares that a model saves over another, not less than nothing."""
    return max(before.cost - after.cost + len(before.runs) * _narrower(before, after), 0.0)


def _from_guesses(stage: SettledModel, candidate: Candidate) -> Candidate:
    """Fit again from the press file's guesses where a cause promises more than any fit has kept.

    The plain fit has bent coefficients and moments so far to make up for it that no way leads back.
    """
    if candidate.gain > KEPT * candidate.direction.gain:
        return candidate
    layout = lay_out(
        candidate.fit.layout.model, [d.digest for d in stage.data], stage.population, _kept_sizes(stage)
    )
    fit = fit_campaign_model(layout, stage.data, rounds=6, tolerance=1.0)
    if fit.cost >= candidate.fit.cost:
        return candidate
    return replace(candidate, fit=fit, gain=saved(stage.fit, fit))


def _kept_sizes(stage: SettledModel) -> dict[str, float]:
    """Return the effects a stage has already, at their fitted sizes."""
    return {key: stage.fit.values[key] for key in stage.fit.layout.effect_names}


def switch_scores(stage: SettledModel) -> Array:
    """Return how far each run's fitted moments lie behind the limit switch, in standard deviations (runs).

    Moments make up for a clock offset completely, so nothing of it is left in the temperatures. Every logger reads
    its channels one after the other and every switch trips somewhere in its ramp, by the same in all runs: that
    no clock is off means no more than `CLOCK_ERROR_S`, so what is tested is what lies beyond.
    """
    usual = float(np.clip(_behind_the_switch(stage), -CLOCK_ERROR_S, CLOCK_ERROR_S))
    scores = []
    for moments in _switched(stage):
        rest = [u.deviation(estimate - usual) for u, estimate in moments]
        scores.append(sum(rest) / max(len(rest), 1) ** 0.5)
    return np.asarray(scores, dtype=float)


def _fresh_fits(stage: SettledModel, model: ThermalModel, effect: Effect, rounds: int) -> Iterator[SharedFit]:
    """Fit from full sizes with the moments back at their priors.

    What the measuring chain does to a switch, the plain fit has made up for with moments and contacts;
    from there the way back is uphill at first. A clock's fit goes on until it has converged: broken off after four
    rounds it had saved nothing of the 300 that it saves in the end (12 runs, a clock 0.7 s late).
    """
    digests = [d.digest for d in stage.data]
    for sizes in _fresh_sizes(stage, effect):
        start = dict(stage.fit.values)
        for p in effect.parameters:
            start[effect.key(p.name)] = float(np.clip(sizes[p.name], p.lower, p.upper))
        layout = lay_out(model, digests, stage.population, start)
        etas = []
        for unknowns, run in zip(layout.unknowns, stage.fit.runs, strict=True):
            eta = _grown(unknowns, run.eta)
            timing = [j for j, u in enumerate(unknowns) if u.name in (*TIMINGS, OPENING_RAMP)]
            eta[timing] = [unknowns[j].centre for j in timing]
            etas.append(eta)
        yield fit_campaign_model(layout, stage.data, etas, rounds=rounds, tolerance=1.0)


def _fresh_sizes(stage: SettledModel, effect: Effect) -> Iterator[dict[str, float]]:
    """Yield the parameters to begin from: of a clock what its moments lie behind the switch."""
    if effect.needs == Need.SWITCH:
        yield {p.name: _behind_the_switch(stage) for p in effect.parameters}
        return
    for size in FRESH_SIZES:
        if size > 0 or any(p.lower < p.neutral for p in effect.parameters):
            yield {p.name: p.neutral + size * (p.typical - p.neutral) for p in effect.parameters}


def _behind_the_switch(stage: SettledModel) -> float:
    """Return how far the fitted moments lie behind the limit switch's, mean over runs. [s]"""
    rest = [estimate - u.centre for moments in _switched(stage) for u, estimate in moments]
    return float(np.mean(rest)) if rest else 0.0


def _switched(stage: SettledModel) -> list[list[tuple[Unknown, float]]]:
    """Return each run's moments that a limit switch gives, as fitted (runs)."""
    own = stage.fit.own(SWITCHED)
    return [moments if d.digest.switch is not None else [] for moments, d in zip(own, stage.data, strict=True)]


def _grown(unknowns: Sequence[object], eta: Array) -> Array:
    """Extend a run's numbers by zeros for the unknowns a further effect brings at the end."""
    return np.concatenate([eta, np.zeros(len(unknowns) - len(eta))])


def refine(stage: SettledModel, candidate: Candidate, rounds: int = 8) -> Candidate:
    """Fit a candidate to convergence and find out what it gains on runs left out."""
    etas = [r.eta for r in candidate.fit.runs]
    layout = candidate.fit.layout.begun(candidate.fit.theta)
    fit = fit_campaign_model(layout, stage.data, etas, rounds=rounds, tolerance=0.5)
    others = held_out(fit, stage.data, rounds=1)
    gains = np.array([a.cost - b.cost for a, b in zip(stage.fit.runs, others, strict=True)])
    gains += _narrower(stage.fit, fit)
    values = {key: fit.values[key] for key in layout.effect_names}
    if candidate.effect.needs == Need.SWITCH:
        score = switch_scores(stage)
    elif between_runs(candidate.effect, stage.data):
        score = load_scores(stage)
    else:
        score = direction(stage.fit, stage.data, layout.model, values).scores
    held = None
    if made_up_for(candidate.effect, stage.data):
        held = held_gain(stage, fit, candidate.effect)
    return replace(
        candidate,
        fit=fit,
        gain=saved(stage.fit, fit),
        gains=gains,
        refined=True,
        others=tuple(others),
        held=held,
        score=score,
    )


def _sizes(effect: Effect) -> tuple[float, ...]:
    return (PROBE,) if effect.one_sided else (PROBE, -PROBE)


def _secant(stage: SettledModel, model: ThermalModel, effect: Effect, size: float) -> tuple[float, Direction]:
    values = {
        effect.key(p.name): p.typical if is_shape(p) else p.neutral + size * (p.typical - p.neutral)
        for p in effect.parameters
    }
    return size, direction(stage.fit, stage.data, model, values)
