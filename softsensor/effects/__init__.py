"""The catalogue: one short module an effect. Users add theirs through the entry point group below.

All that is known of an effect stands in its own module; the diagnosis, the live sensor, reports and pages read it
there. Words of the built-in effects stand in the catalogues of `daq.words`, those of one's own in its `words`.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from daq.given import name_of
from daq.records import InputError
from daq.words import message as words
from daq.words import say
from softsensor.effects import (
    clock_offset,
    conductivity_offset,
    conductivity_temperature,
    contact_asymmetry,
    contact_buildup,
    contact_load,
    density_profile,
    edge_loss,
    heat_capacity_offset,
    heat_capacity_temperature,
    initial_press_state,
    moisture_evaporation,
    open_radiation,
    paper_layer,
    platen_offset,
    resin_cure,
    sensor_fault,
    thermocouple_footprint,
    thermocouple_lag,
    vapour_convection,
)
from softsensor.effects.effect import Conversion, Effect, Live, Need, Role, Scene, Source, Terms, on_panel
from softsensor.effects.free_law import laws
from softsensor.effects.own import check_effect

ENTRY_POINTS = "kerntemp.effects"
"""A package that declares an entry point of this group, naming an `Effect`, adds to the catalogue."""

BUILT_IN: tuple[Effect, ...] = tuple(
    module.EFFECT
    for module in (
        moisture_evaporation,
        vapour_convection,
        resin_cure,
        conductivity_temperature,
        heat_capacity_temperature,
        conductivity_offset,
        heat_capacity_offset,
        density_profile,
        contact_buildup,
        contact_load,
        contact_asymmetry,
        paper_layer,
        open_radiation,
        edge_loss,
        initial_press_state,
        thermocouple_lag,
        thermocouple_footprint,
        clock_offset,
        platen_offset,
        sensor_fault,
    )
)
_SHIPPED = frozenset(effect.name for effect in BUILT_IN)


@cache
def catalogue() -> dict[str, Effect]:
    """Return every effect by name: the built-in ones, then those of installed packages with their words.

    Raises InputError for an entry point that names no effect, one whose name is taken, or one without words.
    """
    effects = {effect.name: effect for effect in BUILT_IN}
    for point in entry_points(group=ENTRY_POINTS):
        effect = point.load()
        if not isinstance(effect, Effect):
            raise InputError(say("effect-entry-not-an-effect", name=point.name, value=point.value))
        if effect.name in effects and effect.name not in _SHIPPED:
            raise InputError(say("effect-exists-already", name=point.name, effect=effect.name))
        _add(effects, effect)
    return effects


def add_effect(effect: Effect) -> None:
    """Add an effect of one's own to the catalogue of this process, as an installed package's entry point does.

    One of the same name that was added before gives way to it, as where the cell of a notebook runs once more.
    Results keep their numbers; what is worked out from now on, also with an older model, is by the new one.

    Raises
    ------
    InputError
        For what is no `Effect`, one by the name of a shipped one, one whose names, chance or parameters cannot be,
        and one without words. Where its terms fail or are no numbers of the shapes that `Terms` has, whoever asks
        for them is refused with its name.

    Examples
    --------
    >>> from softsensor import Effect, Live, Need, Parameter, Role, Terms, on_panel
    >>> def terms(scene, values):
    ...     return Terms(exchange=on_panel(scene, values["W_m3K"] * (1.0 + scene.z), 0.0))
    >>> loss = Parameter("W_m3K", "W/m³K", neutral=0.0, typical=2e3, lower=0.0, upper=2e4, source="assumed")
    >>> words = {
    ...     "called": "a draught from above",
    ...     "meaning": "Air moves along the upper half of the rim.",
    ...     "symptom": "The upper face settles below the simulation.",
    ...     "confirmed-by": "Shield the rim for one pressing.",
    ...     "core": "A kelvin or two too low.",
    ...     "parameter-W_m3K": "heat lost at the rim",
    ... }
    >>> draught = Effect(
    ...     name="draught_above",
    ...     parameters=(loss,),
    ...     terms=terms,
    ...     source="assumed",
    ...     chance=0.02,
    ...     live=Live(Role.HYPOTHESIS),
    ...     needs=Need.PANEL,
    ...     words={"en": words},
    ... )
    >>> add_effect(draught)
    >>> find_effect("draught_above") is draught
    True
    >>> catalogue().pop("draught_above") is draught  # what else runs in this process is to know none of it
    True
    """
    _add(catalogue(), effect)


def _add(effects: dict[str, Effect], effect: Effect) -> None:
    check_effect(effect)
    if effect.name in _SHIPPED or effect.name in laws():
        raise InputError(say("effect-shipped", name=effect.name))
    learn_words(effect)
    effects[effect.name] = effect


SPOKEN = ("called", "meaning", "symptom", "confirmed-by", "core")
"""The texts of every effect; each parameter's stand beside it."""


def learn_words(effect: Effect) -> None:
    """Make the words of an effect of one's own known in every language that it brings.

    Raises InputError where English words are missing: other languages fall back to them.
    """
    wanted = {what: f"effect-{effect.name}-{what}" for what in SPOKEN}
    wanted |= {f"parameter-{p.name}": f"parameter-{effect.name}-{p.name}" for p in effect.parameters}
    if lacking := sorted(set(wanted) - set(effect.words.get(words.ENGLISH, {}))):
        raise InputError(say("effect-without-words", name=effect.name, lacking=tuple(lacking)))
    for language in words.languages():
        own = effect.words.get(language, {})
        known = words.catalogue_of(language)
        known.forget((f"effect-{effect.name}-", f"parameter-{effect.name}-"))
        known.learn({code: own[what] for what, code in wanted.items() if what in own})


def words_of_own_effects(language: str) -> dict[str, str]:
    """Return the words that installed effects bring, by code, for pages that read the catalogues by themselves."""
    catalogue()
    return dict(words.catalogue_of(language).learnt)


def known_effect(name: str) -> Effect | None:
    """Return the effect of that name, one of the catalogue or a law of a model file; None where there is none."""
    return catalogue().get(name) or laws().get(name)


def find_effect(name: str) -> Effect:
    """Return the effect of that name. Raises InputError with the known names.

    Examples
    --------
    >>> [f"{p.name} [{p.unit}]" for p in find_effect("edge_loss").parameters]
    ['W_m3K [W/m³K]']
    """
    effect = known_effect(name_of(name))
    if effect is None:
        raise InputError(say("effect-not-in-catalogue", name=repr(name), known=tuple(catalogue())))
    return effect


__all__ = [
    "BUILT_IN",
    "ENTRY_POINTS",
    "Conversion",
    "Effect",
    "Live",
    "Need",
    "Role",
    "Scene",
    "Source",
    "Terms",
    "add_effect",
    "catalogue",
    "find_effect",
    "known_effect",
    "learn_words",
    "on_panel",
    "words_of_own_effects",
]
