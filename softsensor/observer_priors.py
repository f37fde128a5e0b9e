"""What the live sensor believes before a run: parameters with their spread, and what may be missing.

Two kinds of uncertainty stand beside the coefficients. *Nuisances* bend the faces' readings but hardly move
the core; each is a Gaussian. *Suspects* are causes of the catalogue that move the core by kelvins: most
runs have none, some have one. Sizes are those of effects known from practice (sources in the effects' own
modules); the chances are a judgement, calibrated so that the band holds what it promises on virtual
campaigns with and without a hidden effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq.pressfile import Press
from softsensor.effects import find_effect
from softsensor.modelfile import ModelFile

COEFFICIENT_SD = 0.7
"""Of the logarithm of a coefficient no fit has seen: a factor of two."""
COEFFICIENT_FLOOR = 0.05
"""Of the logarithm, where a fit promises more. Pressings differ."""
INITIAL_K = 0.3
"""Start temperature in the header against the true one."""
PLATEN_K = 0.8
"""Platen channels: class 1 thermocouples are good to 1.5 K."""


@dataclass(frozen=True)
class Prior:
    """One parameter of the filter: x = (value - centre) / sd, or its logarithm where `logarithmic`."""

    name: str
    centre: float
    sd: float
    logarithmic: bool = False


@dataclass(frozen=True)
class Suspect:
    """A cause of the catalogue that the model in force leaves out and that would move the core."""

    parameter: str
    sd: float
    """Size it has where it is present."""
    one_sided: bool
    chance: float
    """That a run has it, before anything is known of the press."""
    spike: float = 0.03
    """What is left of it where it is absent, as a share of `sd`."""

    @property
    def effect(self) -> str:
        """Name in the catalogue."""
        return self.parameter.partition(".")[0]


SUSPECTS = (
    Suspect("vapour_convection.W_m3K", 1.2e4, True, 0.10),
    Suspect("conductivity_temperature.per_100_K", 0.2, False, 0.03),
    Suspect("heat_capacity_temperature.per_100_K", 0.2, False, 0.02),
    Suspect("edge_loss.W_m3K", 1400.0, True, 0.02),
    Suspect("density_profile.amplitude", 0.22, True, 0.02),
    Suspect("conductivity_offset.ratio", 0.15, False, 0.035, 0.06),
    Suspect("heat_capacity_offset.ratio", 0.15, False, 0.035, 0.06),
)

NUISANCES: Mapping[str, float] = {
    "contact_asymmetry.ratio": 0.2,
    "contact_buildup.deficit": 0.3,
    "open_radiation.emissivity": 0.3,
    "initial_press_state.offset_K": 5.0,
    "resin_cure.heat_kJ_m2": 10.0,
}
"""Standard deviation of effects that hardly touch the core."""
SKIN = "skin.J_m2K"
SKIN_SD = 500.0
"""Heat capacity on the panel's faces, as paper has. [J/m²K]"""
LAG_SD, FOOTPRINT_SD = 0.3, 0.05
TIMING = ("closed_s", "opened_s")
EVAPORATION = ("moisture_evaporation.moisture_percent", "moisture_evaporation.temperature_C")
EVAPORATION_CHANCE = 0.03


@dataclass(frozen=True)
class Plan:
    """What one filter is to be made of. The last priors are those of `TIMING`, where the press has states."""

    priors: tuple[Prior, ...]
    suspects: tuple[Suspect, ...]
    chance: float
    """Of this filter with no suspect at work."""
    label: str
    """The cause this filter takes for granted, empty for none."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Catalogue names its parameters belong to."""
        names = (p.name.partition(".") for p in self.priors)
        return tuple(dict.fromkeys(n for n, dot, _ in names if dot and n != SKIN.partition(".")[0]))


def spread_of(value: float, sd: float) -> float:
    """Return the standard deviation of the logarithm."""
    return float(np.sqrt(np.log1p((sd / value) ** 2)))


def coefficient_priors(press: Press, model: ModelFile | None) -> list[Prior]:
    """Return the coefficients: from the model file, else the press file's guesses within a factor of two."""
    priors = []
    for name in press.coefficient_names:
        table = press.coefficient(name)
        known = model.coefficients.get(name) if model is not None else None
        value = table.guess if known is None else known.value
        sd = COEFFICIENT_SD if known is None else max(spread_of(value, known.sd), COEFFICIENT_FLOOR)
        if table.fixed:
            sd = 0.01
        priors.append(Prior(name, float(np.log(value)), sd, logarithmic=True))
    return priors


def effect_priors(model: ModelFile | None) -> list[Prior]:
    """Return the parameters of the effects that the model in force holds, with their spread between runs."""
    priors = []
    for name, table in () if model is None else model.effects:
        effect = find_effect(name)
        for p in effect.parameters:
            known = table.get(p.name)
            value = p.typical if known is None else known.value
            reach = abs(value - p.neutral)
            sd = abs(p.typical - p.neutral) if known is None else known.sd
            sd = max(float(np.hypot(sd, p.spread * reach)), 0.02 * reach, 1e-3 * abs(p.typical), 1e-9)
            priors.append(Prior(effect.key(p.name), value, sd))
    return priors


def nuisance_priors(press: Press, known: set[str], initial: bool) -> list[Prior]:
    """Return what else bends the faces' readings, but for effects the model in force already holds."""
    priors = [Prior("initial_K", 0.0, INITIAL_K)] if initial else []
    for side, boundary in (("bottom", press.boundary.bottom), ("top", press.boundary.top)):
        if boundary.kind == "measured":
            priors.append(Prior(f"boundary_{side}_K", 0.0, PLATEN_K))
    if not press.panel_layers:
        return priors
    for parameter, sd in NUISANCES.items():
        effect = find_effect(parameter.partition(".")[0])
        if effect.name not in known and (press.has_states or effect.name == "resin_cure"):
            priors.append(Prior(parameter, _neutral(parameter), sd))
    if "paper_layer" not in known:
        priors.append(Prior(SKIN, 0.0, SKIN_SD))
    return priors


def plans_for(press: Press, model: ModelFile | None, closed_sd: float, opened_sd: float) -> list[Plan]:
    """Return the filters to run side by side: the joint one, and one for evaporation if it is not diagnosed."""
    own = {name for name, _ in model.effects} if model else set()
    common = coefficient_priors(press, model) + effect_priors(model)
    common += nuisance_priors(press, own, initial=True)
    timing = [Prior("closed_s", 0.0, closed_sd), Prior("opened_s", 0.0, opened_sd)] if press.has_states else []
    suspects = tuple(s for s in SUSPECTS if press.panel_layers and s.effect not in own)
    doubted = [Prior(s.parameter, _neutral(s.parameter), s.sd) for s in suspects]
    wet = bool(press.panel_layers) and "moisture_evaporation" not in own
    chance = 1.0 - sum(s.chance for s in suspects) - (EVAPORATION_CHANCE if wet else 0.0)
    plans = [Plan((*common, *doubted, *timing), suspects, chance, "")]
    if wet:
        water = [Prior(EVAPORATION[0], 4.0, 2.0), Prior(EVAPORATION[1], 102.0, 3.0)]
        firm = [Prior(s.parameter, 1.0, s.sd * s.spike) for s in suspects if s.parameter.endswith(".ratio")]
        plans.append(Plan((*common, *water, *firm, *timing), (), EVAPORATION_CHANCE, "moisture_evaporation"))
    return plans


def panel_plan(model: ModelFile | None, effects: tuple[str, ...]) -> Plan:
    """Return the filter of the panel alone: start temperature, constants, and the effects inside it."""
    own = [p for p in effect_priors(model) if p.name.partition(".")[0] in effects]
    firm = [
        Prior(s.parameter, 1.0, s.sd * s.spike)
        for s in SUSPECTS
        if s.parameter.endswith(".ratio") and s.effect not in effects
    ]
    return Plan((Prior("initial_K", 0.0, INITIAL_K / 2), *own, *firm), (), 1.0, "")


def _neutral(parameter: str) -> float:
    effect = find_effect(parameter.partition(".")[0])
    return next(p.neutral for p in effect.parameters if effect.key(p.name) == parameter)
