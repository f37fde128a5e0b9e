"""From a diagnosis to the model file that `simulate` and `predict` use."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daq.records import Array
from softsensor.diagnosis.extension_unknowns import logarithm_of
from softsensor.diagnosis.settling import SettledModel
from softsensor.heat.model_file import FittedValue, ModelFile


def model_of(
    stage: SettledModel, version: str = "", kept: Mapping[str, Mapping[str, FittedValue]] | None = None
) -> ModelFile:
    """Return a stage as a model file: what a further pressing will be like, and how sure that is.

    The covariance is that of the campaign's numbers plus the scatter from run to run. Effects in `kept` stand in
    the file with other numbers than they were fitted by, and without a share in the covariance.
    """
    kept = kept or {}
    fit, model = stage.fit, stage.fit.layout.model
    names = fit.layout.names
    covariance = fit.covariance + _scatter(stage)
    sd = dict(zip(names, np.sqrt(np.maximum(np.diag(covariance), 0.0)), strict=True))
    free = model.press.free_coefficients
    coefficients = {}
    for name in model.press.coefficient_names:
        if name in free:
            value = float(np.exp(fit.values[logarithm_of(name)]))
            coefficients[name] = FittedValue(value, float(value * sd[logarithm_of(name)]))
        else:
            coefficients[name] = FittedValue(model.press.coefficient(name).guess, 0.0)
    effects = tuple(
        (
            e.name,
            kept.get(e.name)
            or {p.name: FittedValue(fit.values[e.key(p.name)], float(sd[e.key(p.name)])) for p in e.parameters},
        )
        for e in model.effects
    )
    shared = [n for n in fit.layout.effect_names if n.partition(".")[0] not in kept]
    at = [names.index(n) for n in (*map(logarithm_of, free), *shared)]
    return ModelFile(
        version=version or "+".join(["diagnosed", *stage.effects]),
        press=model.press.name,
        coefficients=coefficients,
        effects=effects,
        names=(*free, *shared),
        covariance=covariance[np.ix_(at, at)],
    )


def _scatter(stage: SettledModel) -> Array:
    """Variance from run to run of every shared number (n, n)."""
    layout = stage.fit.layout
    variance = []
    for s, value in zip(layout.shared, stage.fit.theta, strict=True):
        if s.name in layout.coefficients:
            variance.append(stage.population.get(layout.coefficients[s.name], 0.0) ** 2)
        else:
            variance.append((layout.spreads.get(s.name, 0.0) * (value - s.centre)) ** 2)
    return np.diag(np.array(variance))
