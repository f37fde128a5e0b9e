"""What presses of one kind teach one that has no model yet: coefficients, effects, and what may be missing.

Of one kind are presses whose press files have the same layers, boundaries and contacts. Three levels: a run's
coefficients scatter about its press's, a press's about its kind's, the kind's about the press file's guess. The
scatter between presses is learned with a weak prior (half-normal, as wide as a guess is unsure), so that one
sister alone says little; presses differ by Student's t, so that an odd one does not decide for the others. Only
sisters whose models hold the most common effects are asked. What may be missing is put together from one run of
each, and the catalogue counts as one more press: the new one may be the odd one.

References
----------
Gelman, Bayesian Analysis 1 (2006) 515 (a half-normal prior on the scatter of few groups); Lange, Little & Taylor,
J. Am. Stat. Assoc. 84 (1989) 881 (four degrees of freedom where too few groups are there to learn them).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import Press, parse_press
from daq.records import Array, InputError
from daq.store import Store
from daq.words import say
from softsensor.diagnosis.missing_causes import BEFORE
from softsensor.effects import catalogue, find_effect
from softsensor.heat.model_file import (
    FittedValue,
    MissingCause,
    MissingCauses,
    ModelFile,
    Sisters,
    SisterScatter,
)
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.model_in_force import (
    NEWEST_RUNS,
    known_values,
    next_version,
    spread_with,
    standing_fits,
    with_stored_fits,
)
from softsensor.signals.instrument import GUESS_LOG, SPREAD_LOG
from softsensor.signals.unknown import BAND, CENTRAL

DEGREES = 4.0
"""Of Student's t, by which presses differ: for few groups (Lange et al., J. Am. Stat. Assoc. 84 (1989) 881)."""
_REACH, _TAILS = 4.0, 6.0
"""The grid of a kind's centre goes so many scales either way, at least, and that of a further press as many more
as the second, beyond which Student's t of `DEGREES` holds less than 0.4 %."""
_SCATTERS = (0.05, 3.0)
"""Least and largest scatter between presses that the grid holds, in the scale of its half-normal prior."""


@dataclass(frozen=True)
class Sister:
    """A press of the same kind: its model in force and fits made with its effects, newest first."""

    name: str
    model: ModelFile
    fits: Sequence[Mapping[str, Any]]


def begin_with_sisters(store: Store, name: str, press: Press, who: str) -> ModelFile | None:
    """Promote what the sisters of a press know as its first model, where it has none; None where there is none.

    The night's press files count: those the store keeps.
    """
    learned = None if store.active_model(name) is not None else learned_from(press, sisters_of(store, name, press))
    if learned is None or learned.sisters is None:
        return None
    presses = learned.sisters.presses
    reason = say("model-from-sisters", sisters=presses, count=len(presses))
    model = replace(learned, version=next_version(store, name), press=name)
    content = {**model.as_json(), "basis": {"sisters": list(presses), "reason": reason.to_json()}}
    try:
        store.put_model(name, model.version, content, reason=str(reason))
    except InputError:  # sensor and nightly job began at the same moment, and the other one was there first
        return None
    store.promote_model(model.version, who, reason)
    return model


def sisters_of(store: Store, name: str, press: Press) -> list[Sister]:
    """Return the presses of a store that are of the same kind and have a model and fits of their own."""
    others = sorted((other, text) for other, text in store.presses().items() if other != name)
    return [sister for other, text in others if (sister := _sister(store, other, text, press)) is not None]


def _sister(store: Store, name: str, press_file: str, press: Press) -> Sister | None:
    """Return a press as a sister of another, None where it is none, or where what is kept of it cannot be read."""
    active = store.active_model(name)
    if active is None:
        return None
    try:
        own, model = parse_press(press_file), parse_model(active.model, f"model {active.version}")
    except InputError:
        return None
    if (own.layer, own.boundary, own.contact) != (press.layer, press.boundary, press.contact):
        return None
    records = store.pressings(name, limit=NEWEST_RUNS)
    fits = standing_fits(store, records, own, model)
    return Sister(name, model, [fits[r.run] for r in records if r.run in fits])


def learned_from(press: Press, sisters: Sequence[Sister]) -> ModelFile | None:
    """Return what a press without a model can start from, None where no sister knows anything."""
    alike = _with_the_most_common_effects([s for s in sisters if s.fits])
    if not alike:
        return None
    table, scatter = {}, {}
    for name in press.coefficient_names:
        runs = [list(known_values(name, sister.fits)) for sister in alike]
        found = _coefficient(press.coefficient(name).guess, [np.array(r).T for r in runs if r])
        if found is not None:
            table[name], scatter[name] = found
    effects = tuple((name, _parameters(name, alike)) for name, _ in alike[0].model.effects)
    known = Sisters(tuple(s.name for s in alike), scatter)
    model = with_stored_fits(ModelFile("", press.name, table, effects), [s.fits[0] for s in alike])
    return replace(model, missing=_of_one_more(model.missing, len(alike)), sisters=known)


def _with_the_most_common_effects(sisters: Sequence[Sister]) -> list[Sister]:
    """Return the sisters whose models hold what most hold; of equally common ones the fewest effects."""
    held = Counter(frozenset(name for name, _ in s.model.effects) for s in sisters)
    most = min(held, key=lambda names: (-held[names], len(names), sorted(names)), default=frozenset())
    return [s for s in sisters if {name for name, _ in s.model.effects} == most]


def _coefficient(guess: float, presses: Sequence[Array]) -> tuple[FittedValue, SisterScatter] | None:
    """Return a coefficient of a further press, by logarithms and their errors of presses' runs (2, runs)."""
    if not presses:
        return None
    variances = [logs.var(ddof=1) - np.mean(errors**2) for logs, errors in presses if len(logs) > 1]
    count = sum(len(logs) - 1 for logs, _ in presses)
    usual = max(float(np.median(variances)), 0.0) if variances else 0.0
    within = spread_with(SPREAD_LOG, usual, count)
    weights = [1.0 / (within**2 + errors**2) for _, errors in presses]
    means = np.array([w @ logs / w.sum() for w, (logs, _) in zip(weights, presses, strict=True)])
    errors = np.array([w.sum() ** -0.5 for w in weights])
    centre, between = one_more(means, errors, math.log(guess), GUESS_LOG)
    value, sd = math.exp(centre), math.hypot(within, between)
    return FittedValue(value, value * math.sqrt(math.expm1(sd**2))), SisterScatter(between, within)


def one_more(means: Array, errors: Array, centre: float, scale: float) -> tuple[float, float]:
    """Return what is expected of one more press, and its standard deviation, by what some are known to be.

    Presses lie about their kind's centre by Student's t, whose scale is half-normal with `scale`; the centre is
    normal about `centre` with the same. All on a grid; of what is expected the middle and the central 95 %.

    Parameters
    ----------
    means, errors
        Of presses (presses), in any unit.
    """
    z, e = (np.asarray(means) - centre) / scale, np.asarray(errors) / scale
    reach = max(_REACH, float(np.abs(z).max(initial=0.0)) + 1.0)
    mu = np.linspace(-reach, reach, 161)[:, None, None]
    tau = np.geomspace(*_SCATTERS, 25)[None, :, None]
    width2 = tau**2 + e**2
    log = -0.5 * np.log(width2) - 0.5 * (DEGREES + 1.0) * np.log1p((z - mu) ** 2 / (DEGREES * width2))
    chance = log.sum(axis=2) - 0.5 * mu[:, :, 0] ** 2 - 0.5 * tau[:, :, 0] ** 2 + np.log(tau[:, :, 0])
    chance = np.exp(chance - chance.max())
    chance /= chance.sum()
    at = np.linspace(-reach - _TAILS, reach + _TAILS, 241)
    from scipy.special import stdtr  # loads slowly, and the sensor is to be there at once

    below = np.array([(chance * stdtr(DEGREES, (x - mu[:, :, 0]) / tau[:, :, 0])).sum() for x in at])
    low, middle, high = np.interp([CENTRAL[0], 0.5, CENTRAL[1]], below, at)
    return centre + scale * float(middle), scale * float(high - low) / (2.0 * BAND)


def _parameters(effect: str, sisters: Sequence[Sister]) -> dict[str, FittedValue]:
    """Return an effect's parameters of a further press, by sisters that found them in runs of their own."""
    own = [s for s in sisters if s.model.sisters is None] or sisters
    tables = [dict(s.model.effects)[effect] for s in own]
    found = {}
    for p in find_effect(effect).parameters:
        known = [table[p.name] for table in tables if p.name in table]
        unit = abs(p.typical - p.neutral)
        if known and unit > 0.0:
            values, sds = np.array([(k.value, k.sd) for k in known]).T
            found[p.name] = FittedValue(*one_more(values, sds, p.typical, unit))
        elif known:
            found[p.name] = known[0]
    return found


def _of_one_more(missing: MissingCauses | None, presses: int) -> MissingCauses | None:
    """Return what one more press may miss: what the others do, or what the catalogue has, as one press more."""
    if missing is None:
        return None
    nothing = max(1.0 - BEFORE * len(missing.causes), BEFORE)
    causes = {name: _cause_of_one_more(name, cause, presses) for name, cause in missing.causes.items()}
    return replace(missing, nothing=(presses * missing.nothing + nothing) / (presses + 1), causes=causes)


def _cause_of_one_more(name: str, cause: MissingCause, presses: int) -> MissingCause:
    """Return a cause with the mean and variance of what it is in the others and what the catalogue has."""
    both = presses * cause.chance + BEFORE
    share = presses * cause.chance / both
    table = {}
    for p in catalogue()[name].parameters:
        known, unit = cause.parameters[p.name], p.typical - p.neutral
        value = p.neutral + share * (known.value - p.neutral)
        variance = share * (known.sd**2 + (known.value - value) ** 2)
        variance += (1.0 - share) * (unit**2 + (p.neutral - value) ** 2)
        table[p.name] = FittedValue(value, math.sqrt(variance)) if unit else known
    return replace(cause, chance=both / (presses + 1), parameters=table)
