"""What the next pressing starts from: the promoted model, brought up to date by the runs since."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.store import RunRecord
from softsensor.diagnosis.missing_causes import stored_missing_causes
from softsensor.fitting.constants import THICKNESS, ConstantFit, with_constants_of
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.live.priors import spread_of
from softsensor.signals.instrument import GUESS_LOG, LEAST_SPREAD_LOG, SPREAD_LOG
from softsensor.signals.pressed import all_products, products

PRESS_FILE = "press file"
"""Version of the model before there is one."""

# Numbers without another source were set by hand, 2026-11.

NEWEST_RUNS = 12
"""Older runs say little about today's press."""
PRESSED_RUNS = 200
"""So many runs say which panels a press has: weeks of a busy one, and one page of the store."""
MODEL_RUNS = 8.0
"""How many runs a promoted model counts for."""


def up_to_date(press: Press, base: ModelFile | None, fits: Sequence[Mapping[str, Any]]) -> ModelFile | None:
    """Return the model the live sensor should start from, None where nothing is known.

    Parameters
    ----------
    base
        The promoted model.
    fits
        Entries of ``fit --json`` of the newest runs, newest first, made with the base's effects.
    """
    if base is None and not fits:
        return None
    fits = fits[:NEWEST_RUNS]
    version = (base.version if base is not None else PRESS_FILE) + (f"+{len(fits)}" if fits else "")
    return replace(combined_model(press, base, fits), version=version)


def combined_model(press: Press, base: ModelFile | None, fits: Sequence[Mapping[str, Any]]) -> ModelFile:
    """Return a base model's coefficients and those of runs taken together."""
    table = {}
    for name in press.coefficient_names:
        known = base.coefficients.get(name) if base is not None else None
        estimate = _combined(known, press.coefficient(name).guess, list(_values(name, fits)))
        if estimate is not None:
            table[name] = estimate
    seen = stored_missing_causes(fits)
    if base is None:
        return _with_constants(ModelFile(PRESS_FILE, press.name, table, missing=seen), fits)
    before = base.missing
    looked_at = 0 if seen is None else seen.runs or len(fits)  # runs not described settle nothing, yet say so
    if before is not None and looked_at < before.runs:
        seen = before
    return _with_constants(replace(base, coefficients=table, missing=seen), fits)


def with_stored_fits(model: ModelFile, fits: Sequence[Mapping[str, Any]]) -> ModelFile:
    """Return a model file with what runs fitted with its effects know of missing causes, constants and panels."""
    return _with_constants(replace(model, missing=stored_missing_causes(fits)), fits)


def with_pressed(model: ModelFile, headers: Iterable[Mapping[str, Any]]) -> ModelFile:
    """Return a model file that knows which panels a press has had, by the headers of its runs."""
    given = (header.get(THICKNESS) for header in headers)
    pressed = products(mm for mm in given if isinstance(mm, int | float) and mm > 0.0)
    return replace(model, panels=all_products(pressed, model.panels))


def _with_constants(model: ModelFile, fits: Iterable[Mapping[str, Any]]) -> ModelFile:
    constants = [{k: ConstantFit.from_json(c) for k, c in fit.get("constants", {}).items()} for fit in fits]
    return with_constants_of(model, constants)


def _values(name: str, fits: Iterable[Mapping[str, Any]]) -> Iterable[tuple[float, float]]:
    """Yield logarithm and its standard deviation for each fit in which the coefficient is known."""
    for fit in fits:
        entry = fit.get("coefficients", {}).get(name) or {}
        value, sd = entry.get("value"), entry.get("sd")
        if entry.get("identifiable", True) and value and sd and value > 0 and sd < value:
            yield math.log(value), spread_of(value, sd)


def _combined(known: FittedValue | None, guess: float, found: list[tuple[float, float]]) -> FittedValue | None:
    if not found:
        return known
    logs, errors = np.array(found).T
    spread = SPREAD_LOG if known is None else max(spread_of(known.value, known.sd), LEAST_SPREAD_LOG)
    if len(logs) >= 3:
        seen = max(float(logs.var(ddof=1)) - float(np.mean(errors**2)), 0.0)
        count = len(logs)
        spread = math.sqrt(max((4.0 * spread**2 + count * seen) / (4.0 + count), LEAST_SPREAD_LOG**2))
    weights = 1.0 / (spread**2 + errors**2)
    if known is None:
        centre, own = math.log(guess), 1.0 / GUESS_LOG**2
    else:
        centre, own = math.log(known.value), MODEL_RUNS / spread**2
    mean = (weights @ logs + own * centre) / (weights.sum() + own)
    sd = math.sqrt(spread**2 + 1.0 / (weights.sum() + own))
    value = math.exp(mean)
    return FittedValue(value, value * math.sqrt(math.expm1(sd**2)))


def fingerprint(record: RunRecord, press: Press, model: ModelFile | None) -> str:
    """Return what a fit rests on, as a short text that changes when any of it does."""
    effects = model.as_json()["effects"] if model is not None else []
    parts = [dict(record.header), record.first_scan, record.last_scan, press.model_dump(mode="json"), effects]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]
