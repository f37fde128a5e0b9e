"""A run's header: the keys there are, the limits of their numbers, and the panel they describe.

One set of limits for import, `check`, a change by the API and the recorder. A key that nothing knows but that
looks like a slip of typing is refused with the one that was meant; any other is kept, and `doubts` says so.
``KEY.sd`` beside a number is its standard deviation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from daq.given import number_of
from daq.materials import MATERIALS, Constant, find_material
from daq.press.press_file import SD, Press
from daq.printed import quoted
from daq.records import InputError, Nonphysical, Panel, Run
from daq.tables import at, nearest, nearest_first, unseen
from daq.words import Message, say


@dataclass(frozen=True)
class NumberLimits:
    """Between which values a header's number can be one."""

    lower: float
    upper: float
    unit: str
    source: str


_ROOM = "coldest inhabited place (Oymyakon, -68 °C); a room at 100 °C is no room"
_MATTER = "no solid at room temperature lies outside (aerogel, osmium, diamond composites aside)"
_HAND = "set by hand, 2026-11: far beyond any press we know"
_MOISTURE = NumberLimits(0.0, 200.0, "%", "green wood holds at most twice its dry mass")
LIMITS: Mapping[str, NumberLimits] = {
    "panel.thickness_mm": NumberLimits(0.1, 500.0, "mm", _HAND),
    "panel.density_kg_m3": NumberLimits(5.0, 25000.0, "kg/m³", _MATTER),
    "panel.conductivity_W_mK": NumberLimits(0.005, 500.0, "W/mK", _MATTER),
    "panel.heat_capacity_J_kgK": NumberLimits(50.0, 10000.0, "J/kgK", _MATTER),
    "panel.moisture_percent": _MOISTURE,
    "panel.moisture_before_percent": _MOISTURE,
    "panel.moisture_after_percent": _MOISTURE,
    "panel.mass_before_g": NumberLimits(0.0, 1e6, "g", _HAND),
    "panel.mass_after_g": NumberLimits(-1e3, 1e6, "g", "a balance's zero drifts below nothing; above: " + _HAND),
    "panel.initial_temperature_C": NumberLimits(-60.0, 400.0, "°C", "wood chars above 400 °C"),
    "ambient.temperature_C": NumberLimits(-70.0, 100.0, "°C", _ROOM),
    "setting.platen_temperature_C": NumberLimits(-70.0, 2000.0, "°C", "as a reading of a thermocouple"),
    "setting.pressure_N_cm2": NumberLimits(0.0, 100000.0, "N/cm²", _HAND),
    "setting.press_time_s": NumberLimits(0.0, 1e6, "s", _HAND),
    "setting.core_target_C": NumberLimits(-70.0, 2000.0, "°C", "as a reading of a thermocouple"),
    "setting.core_limit_C": NumberLimits(-70.0, 2000.0, "°C", "as a reading of a thermocouple"),
}
GOOD, BLISTER = "good", "blister"
VERDICTS = (GOOD, BLISTER, "undercured", "scrap")
"""What became of a panel, as the operator saw it."""
VERDICT = "panel.verdict"
"""The key it stands under."""
START = "panel.initial_temperature_C"
CONSTANTS = ("panel.density_kg_m3", "panel.conductivity_W_mK", "panel.heat_capacity_J_kgK")
"""What the material table has of a panel."""
USUAL_PANEL: Mapping[str, Any] = MappingProxyType({"panel.material": "MDF", "panel.thickness_mm": 16.0})
"""What is reckoned with where nothing is stated of the panel."""
TABLES = ("panel.conductivity_W_mK", "panel.heat_capacity_J_kgK")
"""Numbers in whose place a table in temperature may stand: rows of °C and value."""
TEMPERATURE = "setting.platen_temperature_C"
"""Whose limits those temperatures keep."""
_NAMES = ("run", "recipe", "panel.material", VERDICT)
_TEXTS = (*_NAMES, "remark")
_RECORDED = "recorded"
"""What a recorder wrote of a run: `daq.store.origin` knows these keys."""
_TABLES = tuple(name for name in Press.model_fields if name != "sd")
_FREE = (_RECORDED, "setting", *_TABLES)
"""First parts of keys that need no warning: a plant's own settings, and overrides, which the press file checks."""
_RECKONED = ("panel.", "ambient.", "setting.")
"""What keys begin with whose numbers fits, drift and the live sensor reckon with; any other is kept as it is."""
_TABLES_OF_RUN = ("panel", "ambient", "setting", _RECORDED)
"""First parts of keys that are of a run and of nothing else."""
_ROOTS = ("panel", "ambient", "setting", *_TABLES)


def flat_keys(tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Walk nested tables as dotted keys, which are what a header has.

    >>> dict(flat_keys({"run": "a", "panel": {"material": "MDF", "thickness_mm": 16.0}}))
    {'run': 'a', 'panel.material': 'MDF', 'panel.thickness_mm': 16.0}
    """
    waiting = [(str(key), value) for key, value in tree.items()][::-1]
    while waiting:
        key, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [(f"{key}.{one}", inner) for one, inner in value.items()][::-1]
        else:
            yield key, value


def stated_keys(header: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield a header's dotted keys as they are written: those that have a value."""
    return ((key, value) for key, value in flat_keys(header) if value is not None)


def flat_header(tree: Mapping[str, Any], place: object = None) -> dict[str, Any]:
    """Return a header's keys, also those that were given as tables.

    Raises
    ------
    InputError
        For a key that is given in both ways, naming `place` where there is one.
    """
    header: dict[str, Any] = {}
    for key, value in flat_keys(tree):
        if key in header:
            problem = say("header-key-twice", key=key)
            raise InputError(problem if place is None else at(place, problem))
        header[key] = value
    return header


def flat_attrs(attrs: Mapping[str, Any], place: object = None) -> dict[str, Any]:
    """Return the keys of a table's `attrs`, where pandas keeps anything: tables that are no run's stay whole."""
    foreign = {k: v for k, v in attrs.items() if isinstance(v, Mapping) and k not in _TABLES_OF_RUN}
    return flat_header({k: v for k, v in attrs.items() if k not in foreign}, place) | foreign


def flat_if_tables(given: Any) -> Any:
    """Return what may be a header as `flat_header` does, anything else as it is, for others to refuse."""
    return flat_header(given) if isinstance(given, Mapping) else given


def check_header(header: Mapping[str, Any], place: object) -> None:
    """Refuse a header whose numbers cannot be, or whose keys are mistyped.

    Raises
    ------
    InputError
        Naming `place`, key, value and limit, or the key that was meant.
    """
    for key, value in header.items():
        if (meant := _meant(key) or _meant_as_sd(key, value)) is not None:
            raise InputError(at(place, say("header-key-meant", key=key, meant=meant)))
        _check_words(key, value, place)
        if key.endswith(SD):
            _check_sd(key, value, place)
        elif key in TABLES and isinstance(value, list | tuple):
            checked_table(key, value, place)
        elif key in LIMITS and value is not None:
            checked_number(key, value, place)
        elif key.startswith(_RECKONED) and isinstance(value, float) and not math.isfinite(value):
            raise Nonphysical(at(place, say("header-not-finite", key=key, value=quoted(value))))


def _check_words(key: str, value: object, place: object) -> None:
    if isinstance(value, str) and key in _NAMES and unseen(value):
        raise InputError(at(place, say("header-unseen", key=key, value=quoted(value))))
    if key == VERDICT and value not in (*VERDICTS, None):
        raise InputError(at(place, say("header-verdict", key=key, value=quoted(value), known=VERDICTS)))


def checked_table(key: str, value: Sequence[Any], place: object) -> tuple[tuple[float, float], ...]:
    """Return a table of the header: rows of a temperature, rising, and a number within the key's limits.

    Raises
    ------
    InputError
        For anything else.
    """
    if not value or not all(isinstance(row, list | tuple) and len(row) == 2 for row in value):
        raise InputError(at(place, say("header-table-rows", key=key, value=quoted(value))))
    rows = [(checked_number(TEMPERATURE, t, place), checked_number(key, v, place)) for t, v in value]
    if any(after <= before for (before, _), (after, _) in itertools.pairwise(rows)):
        raise InputError(at(place, say("header-table-not-rising", key=key)))
    return tuple(rows)


def checked_number(key: str, value: object, place: object) -> float:
    """Return a header's number. Raises `Nonphysical` for what is none, or lies outside its limits."""
    limits = LIMITS[key]
    number = number_of(value)
    if not limits.lower <= number <= limits.upper:
        problem = say(
            "header-number-outside",
            key=key,
            value=quoted(value),
            lower=limits.lower,
            upper=limits.upper,
            unit=limits.unit,
        )
        raise Nonphysical(at(place, problem))
    return number


def doubts(header: Mapping[str, Any]) -> tuple[Message, ...]:
    """Return what is to be asked about a header that is taken.

    Keys nobody knows, a material of which a constant is nowhere, constants far from the table.
    """
    unlisted = _unlisted(header) if header.get("panel.material") is not None else ()
    return (*_unknown(header), *unlisted, *_far(header))


def is_number_key(key: str) -> bool:
    """Whether a header may have a number under a key: one with limits, or of the plant's own settings.

    Examples
    --------
    >>> [is_number_key(k) for k in ("panel.moisture_percent", "setting.speed", "panel.mositure_percent", "rmse")]
    [True, True, False, False]
    """
    base = key.removesuffix(SD)
    return base in LIMITS or (base.startswith("setting.") and _meant(key) is None)


def new_doubts(header: Mapping[str, Any], before: Mapping[str, Any]) -> tuple[Message, ...]:
    """Return what is to be asked about a header that was not about the one before it."""
    earlier = doubts(before)
    return tuple(doubt for doubt in doubts(header) if doubt not in earlier)


def lasting_keys(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return what header keys entered for the next panel say of those after it: all but its start temperature."""
    return {key: value for key, value in header.items() if key not in (START, START + SD)}


def panel_of(run: Run) -> Panel:
    """Return the panel a run's header describes, completed from the material table.

    Raises
    ------
    InputError
        For a missing or nonphysical key.
    """
    header, where = run.header, run.source or run.name
    material = str(header.get("panel.material", ""))
    known = find_material(material) if material else None

    def number(key: str, listed: str = "") -> float:
        """Return a number of the header, or of the material table where `listed` names its constant."""
        full = f"panel.{key}"
        value = header.get(full, getattr(known, listed).value if known and listed else None)
        if isinstance(value, list | tuple) and full in TABLES:
            return checked_table(full, value, where)[0][1]
        if value is not None:
            return checked_number(full, value, where)
        problem = say("header-missing", key=full)
        if listed and known is None:
            problem = say(
                "header-missing-material", key=full, material=material, known=nearest_first(material, MATERIALS)
            )
        raise InputError(at(where, problem))

    def table(key: str) -> tuple[tuple[float, float], ...]:
        value = header.get(f"panel.{key}")
        return checked_table(f"panel.{key}", value, where) if isinstance(value, list | tuple) else ()

    moisture = header.get("panel.moisture_percent")
    return Panel(
        material=material,
        thickness=number("thickness_mm") / 1000.0,
        density=number("density_kg_m3", "density"),
        conductivity=number("conductivity_W_mK", "conductivity"),
        heat_capacity=number("heat_capacity_J_kgK", "heat_capacity"),
        initial_temperature=number("initial_temperature_C"),
        moisture_percent=None if moisture is None else number("moisture_percent"),
        conductivity_table=table("conductivity_W_mK"),
        heat_capacity_table=table("heat_capacity_J_kgK"),
    )


def check_material(header: Mapping[str, Any], place: object) -> None:
    """Refuse a material of which neither the table nor the header knows a constant. Raises InputError."""
    for problem in _unlisted(header):
        raise InputError(at(place, problem))


def _meant(key: str) -> str | None:
    """Return the key that a mistyped one was meant to be; None for one that is known, free or of its own."""
    base = key.removesuffix(SD)
    root, _, rest = base.partition(".")
    if base in _TEXTS and base != key:  # a text has no standard deviation
        return base
    if base in LIMITS or base in _TEXTS or root == _RECORDED or root in _TABLES:
        return None
    known = (*LIMITS, *_TEXTS)
    if (near := nearest(base, known)) is not None:
        return near
    if not rest:  # "thickness_mm": the name without its table
        return next((key for key in known if key.lower().endswith(f".{root.lower()}")), None)
    near_root = nearest(root, _ROOTS) if root not in _ROOTS else None
    return near_root and f"{near_root}.{rest}"


def _meant_as_sd(key: str, value: object) -> str | None:
    """Return the key of the deviation that a number below another one was meant to be: "….std", "….uncertainty".

    A text there, as where a number comes from, is a remark.
    """
    number, _, name = key.rpartition(".")
    known = key in LIMITS or f".{name}" == SD or key.partition(".")[0] in _FREE
    return f"{number}{SD}" if number in LIMITS and not known and not math.isnan(number_of(value)) else None


def _check_sd(key: str, value: object, place: object) -> None:
    if not 0.0 < number_of(value) < math.inf:
        raise InputError(at(place, say("header-sd-not-positive", key=key, value=quoted(value))))
    base = key.removesuffix(SD)
    limits = LIMITS.get(base)
    if limits is not None and number_of(value) > (most := limits.upper - limits.lower):
        problem = say("header-sd-too-wide", key=key, value=quoted(value), base=base, most=most, unit=limits.unit)
        raise Nonphysical(at(place, problem))


def _unknown(header: Mapping[str, Any]) -> Iterator[Message]:
    for key in header:
        base = key.removesuffix(SD)
        root, _, rest = base.partition(".")
        if base not in LIMITS and base not in _TEXTS and not (rest and root in _FREE):
            yield say("header-key-unknown", key=key)


def _unlisted(header: Mapping[str, Any]) -> Iterator[Message]:
    material = str(header.get("panel.material", ""))
    missing = tuple(key for key in CONSTANTS if header.get(key) is None)
    if missing and find_material(material) is None:
        yield say(
            "header-material-unknown", material=material, known=nearest_first(material, MATERIALS), missing=missing
        )


def listed_constants(header: Mapping[str, Any]) -> dict[str, Constant]:
    """Return by key of the header what the table has of its panel's material; empty for an unknown one."""
    known = find_material(str(header.get("panel.material", "")))
    if known is None:
        return {}
    return dict(zip(CONSTANTS, (known.density, known.conductivity, known.heat_capacity), strict=True))


def _far(header: Mapping[str, Any]) -> Iterator[Message]:
    material = str(header.get("panel.material", ""))
    for key, constant in listed_constants(header).items():
        value = header.get(key)
        if isinstance(value, int | float) and constant.off(value):
            yield say(
                "header-far-from-table",
                key=key,
                value=float(value),
                material=material,
                table=constant.value,
                unit=LIMITS[key].unit,
            )
