"""What the next pressing starts from: the promoted model, brought up to date by the runs since."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.store import RunRecord, Store
from softsensor.diagnosis.missing_causes import stored_missing_causes
from softsensor.fitting.constants import THICKNESS, ConstantFit, with_constants_of
from softsensor.heat.model_file import FittedValue, ModelFile, SisterScatter
from softsensor.live.priors import spread_of
from softsensor.signals.instrument import GUESS_LOG, LEAST_SPREAD_LOG, LIVE_SPREAD_RUNS, SPREAD_LOG
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


def brought_up_to_date(
    store: Store, press: Press, base: ModelFile | None, runs: Sequence[str]
) -> ModelFile | None:
    """Return the model the live sensor should start from; of `runs`, newest first, the fits made with the base."""
    version = base.version if base is not None else PRESS_FILE
    fits = store.fits(runs[:NEWEST_RUNS])
    made = [fits[run] for run in runs if run in fits and fits[run].get("model_version") == version]
    return up_to_date(press, base, made)


def combined_model(press: Press, base: ModelFile | None, fits: Sequence[Mapping[str, Any]]) -> ModelFile:
    """Return a base model's coefficients and those of runs taken together."""
    table = {}
    for name in press.coefficient_names:
        known = base.coefficients.get(name) if base is not None else None
        kind = base.sisters.scatter.get(name) if base is not None and base.sisters is not None else None
        estimate = _combined(known, kind, press.coefficient(name).guess, list(known_values(name, fits)))
        if estimate is not None:
            table[name] = estimate
    missing = stored_missing_causes(fits)
    if base is None:
        return _with_constants(ModelFile(PRESS_FILE, press.name, table, missing=missing), fits)
    before = base.missing
    # runs that are not described settle nothing, yet say so
    looked_at = 0 if missing is None else missing.runs or len(fits)
    if before is not None and looked_at < before.runs:
        missing = before
    return _with_constants(replace(base, coefficients=table, missing=missing), fits)


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


def known_values(name: str, fits: Iterable[Mapping[str, Any]]) -> Iterable[tuple[float, float]]:
    """Yield logarithm and its standard deviation for each fit in which the coefficient is known."""
    for fit in fits:
        entry = fit.get("coefficients", {}).get(name) or {}
        value, sd = entry.get("value"), entry.get("sd")
        if entry.get("identifiable", True) and value and sd and value > 0 and sd < value:
            yield math.log(value), spread_of(value, sd)


def _combined(
    known: FittedValue | None, kind: SisterScatter | None, guess: float, found: list[tuple[float, float]]
) -> FittedValue | None:
    """Return a coefficient of what the model says of it, which may be its `kind`'s, and what runs found."""
    if not found:
        return known
    logs, errors = np.array(found).T
    if kind is not None:
        spread = kind.within
    else:
        spread = SPREAD_LOG if known is None else max(spread_of(known.value, known.sd), LEAST_SPREAD_LOG)
    if len(logs) >= 3:
        observed = max(float(logs.var(ddof=1)) - float(np.mean(errors**2)), 0.0)
        spread = spread_with(spread, observed, len(logs))
    weights = 1.0 / (spread**2 + errors**2)
    if known is None:
        centre, own = math.log(guess), 1.0 / GUESS_LOG**2
    else:
        own = MODEL_RUNS / spread**2 if kind is None else 1.0 / kind.between**2
        centre = math.log(known.value)
    mean = (weights @ logs + own * centre) / (weights.sum() + own)
    sd = math.sqrt(spread**2 + 1.0 / (weights.sum() + own))
    value = math.exp(mean)
    return FittedValue(value, value * math.sqrt(math.expm1(sd**2)))


def standing_fits(
    store: Store, records: Sequence[RunRecord], press: Press, base: ModelFile | None
) -> dict[str, dict[str, Any]]:
    """Return the fits that still stand, by run: same run, same press file, same effects, as its mark says."""
    found = store.fits([r.run for r in records])
    marks = {r.run: fingerprint(r, press, base) for r in records if r.run in found}
    return {run: found[run] for run, mark in marks.items() if found[run].get("fingerprint") == mark}


def next_version(store: Store, press: str) -> str:
    """Return a name of today that no version of a press has."""
    taken = {m.version for m in store.models(press=press, limit=200).items}
    day = f"{press}-{datetime.now(UTC):%Y-%m-%d}"
    return next(f"{day}-{i}" for i in range(1, 10_000) if f"{day}-{i}" not in taken)


def spread_with(before: float, variance: float, count: int) -> float:
    """Return how far a coefficient's logarithm scatters: as was likely before, and as `count` runs show it."""
    return math.sqrt(
        max((LIVE_SPREAD_RUNS * before**2 + count * variance) / (LIVE_SPREAD_RUNS + count), LEAST_SPREAD_LOG**2)
    )


def fingerprint(record: RunRecord, press: Press, model: ModelFile | None) -> str:
    """Return what a fit rests on, as a short text that changes when any of it does."""
    effects = model.as_json()["effects"] if model is not None else []
    parts = [dict(record.header), record.first_scan, record.last_scan, press.model_dump(mode="json"), effects]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]
