"""What the live sensor takes for likely before a run: parameters with their spread, and what may be missing.

Two kinds of uncertainty stand beside the coefficients. *Nuisances* bias the faces' readings but hardly move
the core; each is a Gaussian. *Suspected causes* are those of the catalogue that move the core by kelvins: most
runs have none, some have one. Which effect is what, how likely and how large, the catalogue says
(`softsensor.effects`); one of one's own is carried like the built-in ones.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq.press.press_file import BoundaryKind, Press
from daq.records import Array
from softsensor.effects import Effect, Need, Role, catalogue, find_effect, paper_layer
from softsensor.effects.parameters import SMALL_SHARE, Parameter
from softsensor.heat.model_file import FittedValue, MissingCauses, ModelFile
from softsensor.signals.instrument import GUESS_LOG, LEAST_SPREAD_LOG, PLATEN_TOTAL_K, START_K
from softsensor.signals.unknown import Unknown


@dataclass(frozen=True)
class CausePrior:
    """A cause of the catalogue that the model in force leaves out and that would move the core."""

    parameter: str
    sd: float
    """Size it has where it is present, and before a run has shown more how much that size may differ."""
    one_sided: bool
    chance: float
    """That a run has it, before anything is known of the press."""
    width: float = 0.01
    """What is left of it where it is absent, as a share of `sd`."""
    centre: float | None = None
    """Its size where it is present, as earlier runs show; None: about its absence."""

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.parameter.partition(".")[0]

    @property
    def neutral(self) -> float:
        """Value of its parameter where it is absent."""
        return _parameter(self.parameter).neutral

    @property
    def prior(self) -> Unknown:
        """Its parameter where it is present."""
        return Unknown(self.parameter, self.neutral if self.centre is None else self.centre, self.sd)

    @property
    def absent(self) -> float:
        """Where it lies if it is absent, in units of its prior."""
        return self.prior.deviation(self.neutral)


def prior_of(effect: Effect) -> CausePrior:
    """Return a cause as the catalogue has it."""
    first, live = effect.parameters[0], effect.live
    return CausePrior(effect.key(first.name), first.size, first.one_sided, effect.chance, live.absent)


SKIN = "skin.J_m2K"
SKIN_SD = paper_layer.EFFECT.parameters[1].typical
"""Heat capacity on the panel's faces, as paper has. [J/m²K]"""
TIMING = ("inserted_s", "closed_s", "opened_s")
"""Moments of the press as parameters: shifts of what the detector found. [s]"""

# Numbers without another source were set by hand, 2026-11.

LARGEST_SHIFT = 1.0
"""Of a coefficient's logarithm for a cause's typical size: beyond, contacts are no longer nearly linear."""
OWN_FILTER, OWN_FILTERS = 0.2, 2
"""A cause likelier than this gets a filter of its own, linearised where it is at work, up to so many."""
FARTHEST = 3.5
"""Prior standard deviations the point of linearisation may move from its start."""
LEAST_CHANCE = 1e-3
"""No cause is held less likely than this before a run. Set by hand, 2026-11."""


@dataclass(frozen=True)
class FilterPlan:
    """What one filter is to be made of. Where the press has states, the last priors are those of `TIMING`."""

    priors: tuple[Unknown, ...]
    causes: tuple[CausePrior, ...]
    chance: float
    """Of this filter with no suspected cause at work."""
    label: str
    """The cause this filter takes for granted, empty for none."""
    hidden: Mapping[str, Mapping[str, float]]
    """By effect: what coefficients' logarithms have taken upon themselves of its typical size."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Catalogue names its parameters belong to."""
        names = (p.name.partition(".") for p in self.priors)
        return tuple(dict.fromkeys(n for n, dot, _ in names if dot and n != SKIN.partition(".")[0]))

    @cached_property
    def start(self) -> Array:
        """Where to linearise first: suspected causes absent, everything else as expected then."""
        at = np.zeros(len(self.priors))
        names = [p.name for p in self.priors]
        for s in self.causes:
            at[names.index(s.parameter)] = s.absent
        return at + self.coupling @ (at - self.neutral)

    @cached_property
    def reach(self) -> tuple[Array, Array]:
        """Where the point of linearisation must stay: near its start, and where effects are physical (P), (P)."""
        start = self.start
        low, high = start - FARTHEST, start + FARTHEST
        for i, p in enumerate(self.priors):
            if _of_effect(p.name):
                own = _parameter(p.name)
                inner = 0.02 * (own.upper - own.lower)
                low[i] = max(low[i], p.deviation(own.lower))
                high[i] = min(high[i], p.deviation(own.upper - inner))
        return np.minimum(low, start), np.maximum(high, start)

    @cached_property
    def neutral(self) -> Array:
        """Where causes would be absent, in prior units; 0 for all else."""
        return np.array([p.deviation(_parameter(p.name).neutral) if _sized(p.name) else 0.0 for p in self.priors])

    @cached_property
    def coupling(self) -> Array:
        """How coefficients differ with the size of causes they were fitted without (P, P), in prior units."""
        names = [p.name for p in self.priors]
        lean = np.zeros((len(names), len(names)))
        for j, p in enumerate(self.priors):
            shifts = self.hidden.get(p.name.partition(".")[0]) if _sized(p.name) else None
            if not shifts:
                continue
            own = _parameter(p.name)
            for name, shift in shifts.items():
                if name in names:
                    i = names.index(name)
                    limited = min(max(shift, -LARGEST_SHIFT), LARGEST_SHIFT)
                    lean[i, j] = limited / (own.typical - own.neutral) * p.sd / self.priors[i].sd
        return lean


def spread_of(value: float, sd: float) -> float:
    """Return the standard deviation of the logarithm."""
    return float(np.sqrt(np.log1p((sd / value) ** 2)))


def coefficient_priors(press: Press, model: ModelFile | None) -> list[Unknown]:
    """Return the coefficients: from the model file, else the press file's guesses within a factor of two.

    Within a factor of two as well where nobody has looked what causes the model leaves out: its coefficients may
    have taken one upon themselves, and how far they then are off, their own `sd` does not say.
    """
    least = GUESS_LOG if model is None or model.missing is None else LEAST_SPREAD_LOG
    priors = []
    for name in press.coefficient_names:
        table = press.coefficient(name)
        known = None if model is None else model.coefficients.get(name)
        middle, sd = _known_or_guessed(table.guess, known)
        priors.append(Unknown(name, middle, 0.01 if table.fixed else max(sd, least), log=True))
    return priors


def _known_or_guessed(guess: float, known: FittedValue | None) -> tuple[float, float]:
    """Return a coefficient's logarithm and its standard deviation.

    What runs know less well than the guess does not replace it: the two are joined, each by its precision. Runs
    that no model describes, or in which a coefficient does not show, leave no more than the press file's limits.
    """
    about = float(np.log(guess))
    if known is None:
        return about, GUESS_LOG
    middle, sd = float(np.log(known.value)), spread_of(known.value, known.sd)
    if sd <= GUESS_LOG:
        return middle, sd
    weight = GUESS_LOG**2 / (GUESS_LOG**2 + sd**2)
    return weight * middle + (1.0 - weight) * about, sd * math.sqrt(weight)


def effect_priors(model: ModelFile | None) -> list[Unknown]:
    """Return the parameters of the effects that the model in force holds, with their spread between runs."""
    priors = []
    for name, table in () if model is None else model.effects:
        effect = find_effect(name)
        for p in effect.parameters:
            if p.fixed:
                continue
            known = table.get(p.name)
            value = p.typical if known is None else known.value
            reach = abs(value - p.neutral)
            sd = abs(p.typical - p.neutral) if known is None else known.sd
            sd = max(float(np.hypot(sd, p.spread * reach)), 0.02 * reach, 1e-3 * abs(p.typical), 1e-9)
            priors.append(Unknown(effect.key(p.name), value, sd))
    return priors


def nuisance_priors(
    press: Press, known: set[str], initial_sd: float, missing: MissingCauses | None = None
) -> list[Unknown]:
    """Return what else biases the faces' readings, but for effects the model in force already holds."""
    priors = [Unknown("initial_K", 0.0, initial_sd)]
    for side, boundary in press.boundary.ends:
        if boundary.kind is BoundaryKind.MEASURED:
            priors.append(Unknown(f"boundary_{side}_K", 0.0, PLATEN_TOTAL_K))
    for effect in catalogue().values():
        if effect.live.role is not Role.SCATTER or effect.measuring or effect.layers or effect.name in known:
            continue
        if _acts(effect, press):
            first = effect.parameters[0]
            about = _about(_informed(prior_of(effect), missing)) if effect.needs is Need.LOAD else None
            priors.append(about or Unknown(effect.key(first.name), first.neutral, effect.scatter_sd))
    if press.panel_layers and paper_layer.EFFECT.name not in known:
        priors.append(Unknown(SKIN, 0.0, SKIN_SD))
    return priors


def _about(cause: CausePrior) -> Unknown | None:
    """Return the Gaussian with the mean and variance of a cause that is there or not; None where nobody looked."""
    if cause.centre is None:
        return None
    chance, away = cause.chance, cause.centre - cause.neutral
    variance = (
        chance * (cause.sd**2 + away**2) - (chance * away) ** 2 + (1.0 - chance) * (cause.width * cause.sd) ** 2
    )
    return Unknown(cause.parameter, cause.neutral + chance * away, math.sqrt(variance))


def _acts(effect: Effect, press: Press) -> bool:
    """Return whether an effect can bend what is read of a press."""
    if effect.needs is Need.LOAD:
        return bool(press.load_references)
    return bool(press.panel_layers) and (press.has_states or not effect.live.with_states)


def plans_for(
    press: Press,
    model: ModelFile | None,
    moments_sd: Sequence[float],
    initial_sd: float = START_K,
    unowned: Sequence[Unknown] = (),
    stated: Collection[str] = (),
) -> list[FilterPlan]:
    """Return the filters to run side by side: the joint one, and one for each cause that needs its own.

    Parameters
    ----------
    moments_sd, initial_sd
        Of the moments of `TIMING`, 0 for one that is no parameter, and of the header's start temperature. [s, K]
    unowned
        Parameters that no effect owns, in every filter (`live.directions`).
    stated
        Keys of the header whose standard deviation stands beside them: a cause that says they are off is none.
    """
    own = {name for name, _ in model.effects} if model else set()
    missing = model.missing if model else None
    common = coefficient_priors(press, model) + effect_priors(model)
    common += [*nuisance_priors(press, own, initial_sd, missing), *unowned]
    moments = zip(TIMING, moments_sd, strict=True) if press.has_states else ()
    timing = [Unknown(name, 0.0, sd) for name, sd in moments if sd > 0.0]
    left_out = [e for e in catalogue().values() if press.panel_layers and e.name not in own]
    left_out = [e for e in left_out if e.of_constant not in stated or _contradicted(e, missing)]
    causes = tuple(_informed(prior_of(e), missing) for e in left_out if e.live.role is Role.HYPOTHESIS)
    apart = [_informed(prior_of(e), missing) for e in left_out if e.live.role is Role.OWN_FILTER]
    apart = [s for s in apart if not _ruled_out(s)]
    hidden = {name: d.absorbed for name, d in missing.causes.items()} if missing else {}
    chance = max(1.0 - sum(s.chance for s in (*causes, *apart)), LEAST_CHANCE)
    likely = sorted((s for s in causes if s.centre is not None and s.chance > OWN_FILTER), key=lambda s: -s.chance)
    alone = likely[:OWN_FILTERS]
    beside = tuple(s for s in causes if s not in alone)
    sizes = [s.prior for s in beside]
    plans = [FilterPlan((*common, *sizes, *timing), beside, chance, "", hidden)]
    plans += [FilterPlan((*common, s.prior, *timing), (), s.chance, s.effect, hidden) for s in alone]
    for s in apart:
        if s.chance > LEAST_CHANCE:
            plans.append(FilterPlan((*common, *_where_present(s), *timing), (), s.chance, s.effect, hidden))
    return plans


def _where_present(s: CausePrior) -> list[Unknown]:
    """Return a present cause's parameters: its size as earlier runs show, the rest as the catalogue has it."""
    effect = find_effect(s.effect)
    present = [Unknown(effect.key(p.name), *p.present) for p in effect.parameters]
    return present if s.centre is None else [s.prior, *present[1:]]


def _informed(s: CausePrior, missing: MissingCauses | None) -> CausePrior:
    """Return a cause as the runs behind the model have it; as the catalogue has it where nobody has looked."""
    if missing is None:
        return s
    earlier = missing.causes.get(s.effect)
    if earlier is None:
        return replace(s, chance=LEAST_CHANCE)
    known = earlier.parameters[s.parameter.partition(".")[2]]
    least = s.width * s.sd
    sd = max(known.sd, least)
    return replace(s, centre=known.value, sd=sd, width=least / sd, chance=max(earlier.chance, LEAST_CHANCE))


def _contradicted(effect: Effect, missing: MissingCauses | None) -> bool:
    """Return whether earlier runs hold it likelier that a stated constant is off than that nothing is missing."""
    return (
        missing is not None
        and effect.name in missing.causes
        and missing.causes[effect.name].chance > missing.nothing
    )


def _ruled_out(s: CausePrior) -> bool:
    """Return whether earlier runs leave no room for a size that matters."""
    usual = _parameter(s.parameter).size
    return s.centre is not None and s.chance < OWN_FILTER and s.centre + 2.0 * s.sd < SMALL_SHARE * usual


def panel_plan(
    model: ModelFile | None, effects: tuple[str, ...], initial_sd: float, unowned: Sequence[Unknown]
) -> FilterPlan:
    """Return the filter of the panel alone: start temperature, constants, and the effects inside it."""
    own = [p for p in effect_priors(model) if p.name.partition(".")[0] in effects]
    return FilterPlan((Unknown("initial_K", 0.0, initial_sd), *own, *unowned), (), 1.0, "", {})


def is_straight(name: str) -> bool:
    """Return whether readings follow an effect's parameter, or the skin, in a straight line (`Live.straight`)."""
    if name == SKIN:
        return True
    effect = find_effect(name.partition(".")[0])
    return effect.live.straight and name == effect.key(effect.parameters[0].name)


def _parameter(name: str) -> Parameter:
    """Return an effect's parameter as it is now: one of one's own may have been added once more."""
    effect = find_effect(name.partition(".")[0])
    return next(p for p in effect.parameters if effect.key(p.name) == name)


def _of_effect(name: str) -> bool:
    """Return whether a parameter is an effect's."""
    return "." in name and name != SKIN


def _sized(name: str) -> bool:
    """Return whether a parameter is the size of a cause, absent at a neutral value."""
    if not _of_effect(name):
        return False
    own = _parameter(name)
    return own.typical != own.neutral
