"""Second thoughts about a first cause, once a second one is known.

The first was chosen while the second was still missing, and where the plain model is far off a cause's own fit may
not have found its way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsensor.diagnosis.directions import direction
from softsensor.diagnosis.extension import fit_campaign_model
from softsensor.diagnosis.extension_unknowns import lay_out
from softsensor.diagnosis.search import Candidate, best_secant, extend, probe, refine, saved, size_in
from softsensor.diagnosis.settling import SettledModel
from softsensor.effects import Effect

CLEARLY = 10.0
"""Sum of squares two causes must save over the two found first to take their place. Set by hand, 2026-11-21."""


def fit_alone(base: SettledModel, effect: Effect, both: SettledModel) -> Candidate:
    """Fit an effect on top of the plain model, from the numbers a larger model ended at."""
    model = base.fit.layout.model.extended(effect)
    digests = [d.digest for d in base.data]
    layout = lay_out(model, digests, base.population, both.fit.values)
    etas = [
        np.array([dict(zip([u.name for u in theirs], run.eta, strict=True))[u.name] for u in own])
        for own, theirs, run in zip(layout.unknowns, both.fit.layout.unknowns, both.fit.runs, strict=True)
    ]
    fit = fit_campaign_model(layout, base.data, etas, rounds=4)
    zeros = np.zeros(len(base.data))
    values = {key: fit.values[key] for key in layout.effect_names}
    secant = direction(base.fit, base.data, model, values)
    return refine(base, Candidate(effect, secant, fit, saved(base.fit, fit), zeros, refined=False))


def exchange(
    stages: Sequence[SettledModel], first: Sequence[Candidate], least: float
) -> tuple[list[SettledModel], Candidate] | None:
    """Try others in the place of the first of two causes; None if it stays, else the second as fitted beside it.

    The first cause was chosen while the second was still unknown. `least` is the smallest size of a cause.
    """
    base, last = stages[0], stages[-1]
    second = last.fit.layout.model.effects[1]
    best: tuple[float, SettledModel, SettledModel, Candidate] | None = None
    for other in [c for c in first if c.refined and c.effect.name not in last.effects][:2]:
        middle = extend(base, other)
        middle = _resettled(middle, last)
        found = refine(middle, probe(middle, second, *best_secant(middle, second), rounds=4))
        if size_in(found.fit, other.effect) < least:
            continue
        if found.fit.cost < (best[0] if best else last.fit.cost - CLEARLY):
            best = (
                found.fit.cost,
                extend(base, other),
                SettledModel(found.fit, last.data, last.population, last.noise),
                found,
            )
    return None if best is None else ([base, best[1], best[2]], best[3])


def _resettled(stage: SettledModel, like: SettledModel) -> SettledModel:
    """Fit a stage's model with another's noise and spread, to compare costs."""
    layout = lay_out(stage.fit.layout.model, [d.digest for d in like.data], like.population, stage.fit.values)
    fit = fit_campaign_model(layout, like.data, [r.eta for r in stage.fit.runs], rounds=6)
    return SettledModel(fit, like.data, like.population, like.noise)
