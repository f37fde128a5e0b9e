"""An effect of one's own, held against what an effect is: when it is added, and each time its terms are asked for.

What is wrong with it is refused in words that name it. The shipped effects' terms are asked as they are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from math import isfinite
from typing import Any

import numpy as np

from daq.given import number_of, refused
from daq.printed import in_short
from daq.records import InputError
from daq.words import Message, say
from softsensor.effects.effect import BENDS_C, Conversion, Effect, Scene, Source, Terms
from softsensor.effects.parameters import Parameter

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""What files, keys with a dot, and codes of words take."""
_SHIPPED = __name__.partition(".")[0] + "."

BY_CELL = ("conductivity", "conductivity_slope", "capacity", "capacity_slope", "exchange")
"""Terms that are a number, or one for each cell."""
BY_BEND = ("conductivity_bend", "contact_bend")
"""Terms that are a number, or one for each of `BENDS_C`."""
NUMBERS = ("emissivity", "convection", "plates_offset", "lag", "footprint", "clock")
"""Terms that are one number."""


def check_effect(effect: object) -> None:
    """Refuse what is no effect, and one with a name, a chance or a parameter that cannot be. Raises InputError.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from softsensor.effects import find_effect
    >>> check_effect(replace(find_effect("edge_loss"), chance=2.0))
    Traceback (most recent call last):
    daq.records.InputError: effect edge_loss: chance = 2: it is a probability from 0 to 1
    """
    if not isinstance(effect, Effect) or not callable(effect.terms):
        raise refused(effect, "given-no-effect")
    _check_name(effect, effect.name)
    if not 0.0 <= number_of(effect.chance) <= 1.0:
        raise InputError(say("effect-chance-impossible", name=effect.name, value=in_short(effect.chance)))
    own = effect.parameters
    if not isinstance(own, tuple) or not own or not all(isinstance(one, Parameter) for one in own):
        raise InputError(say("effect-parameters-missing", name=effect.name))
    for number, parameter in enumerate(own):
        _check_name(effect, parameter.name)
        if parameter.name in (one.name for one in own[:number]):
            raise InputError(say("effect-parameter-twice", name=effect.name, parameter=parameter.name))
        if not parameter.fixed:
            _check_parameter(effect.name, parameter)
    if own[0].size == 0.0:
        raise InputError(say("effect-parameter-without-size", name=effect.name, parameter=own[0].name))


def _check_name(effect: Effect, name: object) -> None:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InputError(say("effect-name-impossible", effect=str(effect.name), name=in_short(name)))


def _check_parameter(effect: str, parameter: Parameter) -> None:
    """Refuse a parameter whose limits are none, or whose values lie outside them. Raises InputError."""
    limits = {"lower": in_short(parameter.lower), "upper": in_short(parameter.upper)}
    which = {"name": effect, "parameter": parameter.name, **limits}
    low, high = number_of(parameter.lower), number_of(parameter.upper)
    if not (isfinite(low) and isfinite(high) and low < high):
        raise InputError(say("effect-parameter-limits", **which))
    for what in ("neutral", "typical"):
        value = getattr(parameter, what)
        if not low <= number_of(value) <= high:
            raise InputError(say("effect-parameter-outside", what=what, value=in_short(value), **which))


def terms_of(effect: Effect, scene: Scene, values: Mapping[str, Any]) -> Terms:
    """Return an effect's terms in a scene.

    Raises
    ------
    InputError
        Where one's own fail, or are no numbers of the shape that `Terms` has.
    """
    if str(getattr(effect.terms, "__module__", "")).startswith(_SHIPPED):
        return effect.terms(scene, values)
    try:
        found = effect.terms(scene, values)
    except InputError:
        raise
    except Exception as error:
        problem, known = f"{type(error).__name__}: {error}", tuple(values)
        raise InputError(say("effect-terms-fail", name=effect.name, problem=problem, known=known)) from error
    if not isinstance(found, Terms):
        raise InputError(say("effect-terms-none", name=effect.name, found=in_short(found)))
    for wrong in _wrong(found, scene):
        raise InputError(say("effect-terms-wrong", name=effect.name, what=wrong))
    return found


def _wrong(terms: Terms, scene: Scene) -> Iterator[Message]:
    """Yield what is wrong with terms."""
    cells, steps = len(scene.z), len(scene.step_start)
    closes = not np.isnan(scene.closed_s)  # else what acts in the closed press alone may be no number
    for names, size in ((BY_CELL, cells), (BY_BEND, len(BENDS_C)), (NUMBERS, 0)):
        for name in names:
            yield from _odd(name, getattr(terms, name), size)
    for name, pair in (("paper", terms.paper), ("boundary_offset", terms.boundary_offset)):
        if pair is not None:
            yield from _odd_pair(name, pair)
    yield from _odd_contacts(terms.closed_contact, scene.contacts, steps, finite=closes)
    yield from _odd_kinds("conversions", terms.conversions, Conversion)
    yield from _odd_kinds("sources", terms.sources, Source)
    for one in terms.conversions:
        yield from _odd("Conversion.heat", one.heat, cells, alone=False)
        for part in ("kind", "a", "b", "c", "own"):
            yield from _odd(f"Conversion.{part}", getattr(one, part))
    for source in terms.sources:
        yield from _odd("Source.heat", source.heat, cells)
        yield from _odd("Source.course", source.course, steps, finite=closes)


def _odd(name: str, value: Any, size: int = 0, *, alone: bool = True, finite: bool = True) -> Iterator[Message]:
    """Yield what is wrong with a term: a number, where it may stand alone, or so many of them."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of several lengths
        array = np.asarray(None)
    shapes = [*([()] if alone else []), *([(size,)] if size else [])]
    if array.dtype.kind not in "biufc":
        yield say("effect-terms-no-number", term=name, found=in_short(value))
    elif array.shape not in shapes:
        wanted = tuple(str(shape) for shape in shapes)
        yield say("effect-terms-shape", term=name, found=str(array.shape), wanted=wanted)
    elif finite and not np.isfinite(array).all():
        yield say("effect-terms-not-finite", term=name)


def _odd_pair(name: str, pair: Any) -> Iterator[Message]:
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        yield say("effect-terms-no-pair", term=name, found=in_short(pair))
    else:
        for value in pair:
            yield from _odd(name, value)


def _odd_contacts(given: Any, contacts: int, steps: int, *, finite: bool) -> Iterator[Message]:
    if not isinstance(given, Mapping) or not set(given) <= set(range(contacts)):
        yield say("effect-terms-contacts", found=in_short(given), most=contacts - 1)
    else:
        for number, factor in given.items():
            yield from _odd(f"closed_contact[{number}]", factor, steps, finite=finite)


def _odd_kinds(name: str, given: Any, kind: Callable[..., Any]) -> Iterator[Message]:
    if not isinstance(given, tuple) or not all(type(one) is kind for one in given):
        yield say("effect-terms-kinds", term=name, kind=kind.__name__, found=in_short(given))
