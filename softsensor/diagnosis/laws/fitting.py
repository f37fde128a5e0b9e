"""A kind of law fitted beside everything else, its strength learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.records import Array, Nonphysical
from softsensor.diagnosis.extension import SharedFit, fit_campaign_model, from_the_others, held_out
from softsensor.diagnosis.extension_unknowns import Unknowns, lay_out
from softsensor.diagnosis.laws.kinds import LawKind
from softsensor.diagnosis.settling import SettledModel, run_errors

STRENGTHS = np.geomspace(0.02, 10.0, 19)
"""Tried standard deviations of the weights, in units of the kind."""


@dataclass(frozen=True)
class FittedLaw:
    """A kind fitted to all runs."""

    kind: LawKind
    fit: SharedFit
    errors: Array
    """Of each run by the others' law (runs). [K]"""
    readings: int

    @property
    def places(self) -> list[int]:
        """Where its numbers stand among the fit's."""
        names = self.fit.layout.names
        return [names.index(self.kind.effect.key(p.name)) for p in self.kind.effect.parameters]


def tried(stage: SettledModel, kind: LawKind) -> FittedLaw | None:
    """Fit a kind beside everything else; None where the runs drive it to what no matter has."""
    try:
        return _fitted(stage, kind)
    except Nonphysical:
        return None


def _fitted(stage: SettledModel, kind: LawKind) -> FittedLaw:
    """Fit a kind beside everything else, its strength learned twice on the way.

    Runs begin at the middle of their priors, not where the settled model has them: moments and contacts have made
    up for what that lacks. From there a law of contacts that break at a temperature came to rest at up to four
    times the cost (6 campaigns on seeds from 24200, 2026-11-29); other laws end alike from either.
    """
    model = stage.fit.layout.model.extended(kind.effect)
    names = [kind.effect.key(p.name) for p in kind.effect.parameters]
    start = dict(stage.fit.values) | dict.fromkeys(names, 0.0)
    layout = lay_out(model, [d.digest for d in stage.data], stage.population, start)
    etas, strength = None, 1.0
    for rounds in (4, 4, 6):
        layout = _strong(layout, names, strength)
        fit = fit_campaign_model(layout, stage.data, etas, rounds=rounds, tolerance=0.5)
        strength, etas = learned_strength(fit, names), [r.eta for r in fit.runs]
        layout = layout.begun(fit.theta)
    others = held_out(fit, stage.data, thetas=from_the_others(fit, stage.data))
    readings = sum(int(d.digest.valid.sum()) for d in stage.data)
    return FittedLaw(kind, fit, run_errors(stage.data, others), readings)


def _strong(layout: Unknowns, names: Sequence[str], strength: float) -> Unknowns:
    """Return the layout with a prior of this width on the law's numbers."""
    shared = tuple(
        replace(s, sd=strength, step=2.0 * max(strength, 0.5)) if s.name in names else s for s in layout.shared
    )
    return replace(layout, shared=shared)


def learned_strength(fit: SharedFit, names: Sequence[str]) -> float:
    """Return the prior's standard deviation of the law's numbers under which the runs are likeliest.

    Laplace's marginal likelihood from the curvature H and slope g of the data's half cost, all other numbers of
    the campaign integrated with their own priors: with P the priors' precision,
    -1/2 min(...) - 1/2 log|H + P| + 1/2 log|P|, over a grid.
    """
    own = np.isin(fit.layout.names, names)
    hessian, slope = sum(fit.hessians), sum(fit.gradients)
    centre, fixed = fit.layout.priors
    found = []
    for strength in STRENGTHS:
        precision = np.where(own, strength**-2.0, fixed**-2.0)
        away = fit.theta - centre
        curved = hessian + np.diag(precision)
        pull = slope + precision * away
        least = 0.5 * float(away @ (precision * away)) - 0.5 * float(pull @ np.linalg.solve(curved, pull))
        found.append(-least - 0.5 * float(np.linalg.slogdet(curved)[1]) + 0.5 * float(np.log(precision).sum()))
    return float(STRENGTHS[int(np.argmax(found))])
