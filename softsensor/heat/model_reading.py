"""A model file's content, read and checked: what is written by hand is held to what `fit` and `diagnose` write.

One set of limits, whether a model was fitted, edited by hand or made in Python. Coefficients keep to what a heat
transfer coefficient can be at all, as in the press file, and an effect's parameters to what a diagnosis searches:
nothing outside is ever written by one, and draws about a model are held to the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from daq.given import number_of
from daq.press.header import LIMITS
from daq.press.press_file import HEAT_TRANSFER, Press
from daq.printed import in_short
from daq.records import Array, InputError
from daq.tables import at, nearest
from daq.words import Message, say, spoken
from softsensor.effects import Effect, find_effect
from softsensor.heat.model_file import (
    FittedValue,
    MissingCause,
    MissingCauses,
    ModelFile,
    PressedPanel,
    Scatter,
    Sisters,
    SisterScatter,
    check_fitted,
)
from softsensor.heat.run_checks import LARGEST

_ROUNDING = 1e-6
"""By how much a covariance may miss being symmetric, and correlations may exceed 1: what rounding leaves."""
_KEYS = ("version", "press", "coefficients", "effects", "covariance", "adequacy", "scatter", "panels", "sisters")
"""What a model file holds; a store keeps more beside it, under names of its own."""
_THICKNESS = LIMITS["panel.thickness_mm"]


def parse_model(content: Any, source: str | Message) -> ModelFile:
    """Check a model file's content. Raises InputError naming `source`, and key and value where they are wrong."""
    if not isinstance(content, dict):
        raise InputError(say("model-file-no-coefficients", file=source))
    for key in content:
        if key not in _KEYS and (meant := nearest(key, _KEYS)) is not None:
            raise InputError(say("model-file-key-meant", file=source, key=key, meant=meant))
    if "coefficients" not in content:
        raise InputError(say("model-file-no-coefficients", file=source))
    covariance = content.get("covariance") or {"names": (), "matrix": ()}
    model = ModelFile(
        version=str(content.get("version", "")),
        press=str(content.get("press", "")),
        coefficients=_estimates(content["coefficients"], source, "coefficients"),
        effects=tuple(_effects(content.get("effects", ()), source)),
        names=_part("covariance", source, lambda: tuple(map(str, covariance["names"]))),
        covariance=_part("covariance", source, lambda: _square(covariance["matrix"])),
        missing=_optional("adequacy", content, source, lambda table: _missing_causes(table, source)),
        scatter=_optional("scatter", content, source, _scatter) or {},
        panels=_optional("panels", content, source, _panels) or (),
        sisters=_optional("sisters", content, source, _sisters),
    )
    check_model(model, source)
    return model


Found = TypeVar("Found")


def _part(key: str, source: str | Message, read: Callable[[], Found]) -> Found:
    """Return what a part of the file says. Raises `InputError` with its key where it is another thing."""
    try:
        return read()
    except InputError:
        raise
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
        raise InputError(say("model-file-part", file=source, key=key)) from None


def _optional(
    key: str, content: Mapping[str, Any], source: str | Message, read: Callable[[Any], Found]
) -> Found | None:
    """Return what an optional part says, None where the file has none."""
    return _part(key, source, lambda: read(content[key])) if content.get(key) else None


def _square(rows: Any) -> Array:
    """Return a matrix. Raises `TypeError` or `ValueError` for anything else."""
    matrix = np.array([[_number(one) for one in row] for row in rows], dtype=float)
    return matrix if matrix.size else np.zeros((0, 0))


def _number(value: Any) -> float:
    """Return a number, NaN for one that is not known. Raises `TypeError` for a text, or true and false."""
    if isinstance(value, bool) or not isinstance(value, int | float | None):
        raise TypeError(value)
    return math.nan if value is None else float(value)


def _within(value: Any, least: float, most: float = math.inf) -> float:
    """Return a number between limits. Raises `ValueError` for any other."""
    if not least <= (number := _number(value)) <= most or math.isinf(number):
        raise ValueError(value)
    return number


_TINY = np.nextafter(0.0, 1.0)
"""The least number above nothing."""


def _effects(entries: Any, source: str | Message) -> Iterator[tuple[str, Mapping[str, FittedValue]]]:
    if not isinstance(entries, list | tuple):
        raise InputError(say("model-file-part", file=source, key="effects"))
    for number, entry in enumerate(entries):
        if not isinstance(entry, dict) or "name" not in entry:
            raise InputError(say("model-file-effect-unnamed", file=source, number=number))
        name = str(entry["name"])
        yield name, _estimates(entry.get("parameters", {}), source, f"effects.{number}.parameters")


def _sisters(entry: Any) -> Sisters:
    scatter = {
        name: SisterScatter(_within(s["between"], _TINY), _within(s["within"], _TINY))
        for name, s in entry["scatter"].items()
    }
    return Sisters(tuple(map(str, entry["presses"])), scatter)


def _panels(table: Any) -> tuple[PressedPanel, ...]:
    lower, upper = _THICKNESS.lower, _THICKNESS.upper
    found = (PressedPanel(_within(p["thickness_mm"], lower, upper), int(_within(p["runs"], 1))) for p in table)
    return tuple(sorted(found, key=lambda p: p.thickness_mm))


def _scatter(table: Any) -> dict[str, Scatter]:
    found = {}
    for key, entry in table.items():
        sd = _within(entry["sd"], _TINY)
        found[key] = Scatter(sd, int(_within(entry["runs"], 0)), _within(entry.get("panel", sd), _TINY, sd))
    return found


def _estimates(table: Any, source: str | Message, where: str) -> dict[str, FittedValue]:
    """Return values with their standard deviations by name; one without is known exactly."""
    if not isinstance(table, dict):
        raise InputError(say("model-file-no-table", file=source, place=where))
    found = {}
    for name, entry in table.items():
        try:
            known = entry.get("sd") if "sd" in entry or len(entry) == 1 else entry["sd"]
            found[name] = FittedValue(_number(entry["value"]), 0.0 if known is None else _number(known))
        except (AttributeError, KeyError, OverflowError, TypeError):
            place, value = f"{where}.{name}", in_short(entry)
            raise InputError(say("model-file-no-numbers", file=source, place=place, value=value)) from None
    return found


def _missing_causes(entry: Any, source: str | Message) -> MissingCauses:
    causes = {
        name: MissingCause(
            chance=_within(d["chance"], 0.0, 1.0 + _ROUNDING),
            size=_within(d["size"], -math.inf),
            parameters=_estimates(d["parameters"], source, f"adequacy.causes.{name}.parameters"),
            absorbed={key: _within(shift, -math.inf) for key, shift in d["absorbed"].items()},
        )
        for name, d in entry["causes"].items()
    }
    nothing, unexplained = _within(entry["nothing"], 0.0, 1.0 + _ROUNDING), _within(entry["unexplained_K"], 0.0)
    return MissingCauses(int(_within(entry["runs"], 0)), nothing, unexplained, causes)


def check_model(model: ModelFile, source: str | Message) -> None:
    """Refuse a model that no matter has. Raises `InputError`, naming the source, key, value and limit."""
    for name, found in model.coefficients.items():
        _check_numbers(found, source, f"coefficients.{name}")
        check_coefficient(f"coefficients.{name}.value", found.value, source)
    keys = list(model.coefficients)
    for number, (name, table) in enumerate(model.effects):
        try:
            effect = find_effect(name)
        except InputError as error:
            raise InputError(at(source, spoken(error))) from None
        if name in [before for before, _ in model.effects[:number]]:
            raise InputError(say("model-file-effect-twice", file=source, number=number, effect=name))
        _check_parameters(effect, table, number, source)
        keys += map(effect.key, table)
    _check_covariance(model.names, model.covariance, keys, source)
    for key, scatter in model.scatter.items():
        limits = LIMITS.get(key)
        most = limits.upper / limits.lower - 1.0 if limits is not None and limits.lower > 0.0 else LARGEST
        if not 0.0 < number_of(scatter.sd) <= most:
            value = in_short(scatter.sd)
            raise InputError(say("model-file-scatter", file=source, key=key, value=value, most=most))


def check_coefficient(name: str, value: object, where: str | Message) -> float:
    """Return a heat transfer coefficient. Raises `InputError` for what is no number, or can be none. [W/m²K]"""
    least, most = HEAT_TRANSFER
    number = number_of(value)
    if not least <= number <= most:
        problem = say(
            "coefficient-impossible", where=where, name=name, value=in_short(value), lower=least, upper=most
        )
        raise InputError(problem)
    return number


def check_coefficient_names(given: Mapping[str, Any], presses: Sequence[Press], where: str | Message) -> None:
    """Refuse a coefficient that neither the press file nor the run's own press has. Raises `InputError`."""
    names = dict.fromkeys(name for press in presses for name in press.coefficient_names)
    if unknown := [name for name in given if name not in names]:
        press, known = presses[0].name, tuple(names)
        raise InputError(say("coefficient-unknown", where=where, name=str(unknown[0]), press=press, known=known))


def check_press(model: ModelFile, presses: Sequence[Press], where: str | Message) -> Message | None:
    """Return the doubt about a model of another press, None for one of this. Raises `InputError`.

    Parameters
    ----------
    presses
        As the press file describes it, and as the run's header does: a coefficient of one of them is enough.
    """
    check_coefficient_names(model.coefficients, presses, where)
    if model.press in ("", presses[0].name):
        return None
    return say("model-file-of-another-press", path=where, other=model.press, press=presses[0].name)


def _check_parameters(
    effect: Effect, table: Mapping[str, FittedValue], number: int, source: str | Message
) -> None:
    known = {p.name: p for p in effect.parameters}
    place: dict[str, Any] = {"file": source, "number": number, "effect": effect.name}
    if unknown := sorted(set(table) - set(known)):
        raise InputError(say("model-file-parameter-unknown", **place, name=unknown[0], known=tuple(known)))
    if known and not table:
        raise InputError(say("model-file-effect-without-size", **place, known=tuple(known)))
    for name, found in table.items():
        p = known[name]
        _check_numbers(found, source, f"effects.{number}.parameters.{name}")
        value = number_of(found.value)
        if not (p.lower <= value <= p.upper and math.isfinite(value)):
            unit = p.shown_unit if p.factor == 1.0 else ""  # the file has the number without the factor
            limits: dict[str, Any] = {"lower": p.lower, "upper": p.upper, "unit": unit}
            problem = say("model-file-effect-outside", **place, name=name, value=in_short(found.value), **limits)
            raise InputError(problem)
    if wrong := effect.wrong_together({name: number_of(found.value) for name, found in table.items()}):
        raise InputError(say("model-file-effect-wrong", **place, what=wrong))


def _check_numbers(found: FittedValue, source: str | Message, place: str) -> None:
    """Refuse what is not a value with a standard deviation."""
    check_fitted(found, source, place)
    if not 0.0 <= number_of(found.sd) < math.inf:
        raise InputError(say("model-file-sd", file=source, place=place, value=in_short(found.sd)))


def _check_covariance(names: Sequence[str], matrix: Any, keys: Sequence[str], source: str | Message) -> None:
    """Refuse a matrix that is no covariance of numbers of the model."""
    if unknown := [name for name in names if name not in keys]:
        raise InputError(say("model-file-covariance-of", file=source, name=str(unknown[0]), known=tuple(keys)))
    square = np.asarray(matrix, dtype=float)
    if square.shape != (len(names), len(names)):
        shape = " x ".join(map(str, square.shape))
        raise InputError(say("model-file-covariance-shape", file=source, shape=shape, names=len(names)))
    sd = np.sqrt(np.maximum(np.diag(square), 0.0))
    within = (1.0 + _ROUNDING) * np.outer(sd, sd) + _ROUNDING**2
    symmetric = np.abs(square - square.T) <= _ROUNDING * (within + _ROUNDING)
    wrong = np.argwhere(~(np.isfinite(square) & symmetric & (np.abs(square) <= within)))
    if len(wrong):
        i, j = map(int, wrong[0])
        place = {"row": names[i], "column": names[j], "value": f"{square[i, j]:g}"}
        raise InputError(say("model-file-covariance", file=source, **place))
