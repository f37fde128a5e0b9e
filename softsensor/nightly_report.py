"""The nightly job's page: what was fitted, what drifts, what the diagnosis said, which model is in force."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, select_autoescape

from daq.pressfile import parse_press
from daq.records import InputError
from daq.store import Store
from softsensor.drift import alarms_of
from softsensor.effects import find_effect
from softsensor.parameters import plain
from softsensor.vocabulary import coefficient_words, in_words, parameters_told, readable

if TYPE_CHECKING:
    from softsensor.nightly_judge import Outcome

SHOWN_RUNS, SHOWN_MODELS, SHOWN_ENTRIES = 30, 10, 20


def nightly_report(store: Store, outcome: Outcome) -> str:
    """Return the page as HTML text; it needs no other file."""
    press = outcome.press
    diagnoses = store.diagnoses(press=press, limit=1).items
    pages = Environment(
        loader=PackageLoader("softsensor", "templates"), autoescape=select_autoescape(), trim_blocks=True
    )
    return pages.get_template("nightly_report.html").render(
        press=press,
        written=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        outcome=outcome,
        models=store.models(press=press, limit=SHOWN_MODELS).items,
        reason=in_words(outcome.reason),
        in_words=in_words,
        in_force=_in_force(store, press),
        diagnosis=_found(diagnoses[0].diagnosis if diagnoses else None),
        alarms=_alarms(store, press),
        runs=list(_runs(store, press)),
        failures=store.journal(press=press, level="warning", limit=SHOWN_ENTRIES).items,
    )


def write_report(store: Store, outcome: Outcome, folder: Path) -> Path:
    """Write the page as ``PRESS-DATE.html`` and return where; a page of the same night is replaced as a whole.

    Raises
    ------
    InputError
        Where the folder cannot be written.
    """
    path = folder / f"{outcome.press}-{datetime.now(UTC):%Y-%m-%d}.html"
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(nightly_report(store, outcome), encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot write the report: {error.strerror}; see [refit] reports") from error
    return path


def _in_force(store: Store, press: str) -> list[dict[str, str]]:
    """Return every parameter of the model in force with its spread and unit, as text."""
    active = store.active_model(press)
    if active is None:
        return []
    words = _coefficient_words(store, press)
    found = [
        _row(name, words(name), (1.0, "W/m²K"), entry)
        for name, entry in active.model.get("coefficients", {}).items()
    ]
    for effect in active.model.get("effects", []):
        known = {p.name: p for p in find_effect(effect["name"]).parameters}
        found += [
            _row(f"{effect['name']}.{n}", _belonging(effect["name"], known[n].words), known[n].scale, entry)
            for n, entry in effect.get("parameters", {}).items()
        ]
    return found


def _belonging(effect: str, words: str) -> str:
    """Return a parameter's words after its effect's, where they do not begin with them."""
    return words if words.startswith(readable(effect)) else f"{readable(effect)}: {words}"


def _coefficient_words(store: Store, press: str) -> Callable[[str], str]:
    """Return what calls a coefficient by the bodies it couples, as the press file kept in the store has them."""
    try:
        described = parse_press(store.presses().get(press, ""))
    except InputError:  # kept by an earlier version, or by hand: short names will do
        return lambda name: name
    return lambda name: coefficient_words(described, name) or name


def _row(name: str, words: str, scale: tuple[float, str], entry: Mapping[str, float]) -> dict[str, str]:
    factor, unit = scale
    value, sd = with_spread(factor * float(entry["value"]), factor * float(entry.get("sd") or 0.0))
    return {"name": name, "words": words, "value": value, "sd": sd, "unit": unit}


def _found(diagnosis: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the newest diagnosis in words."""
    if diagnosis is None:
        return None
    return {
        "verdict": diagnosis["verdict"].replace("_", " "),
        "next": diagnosis.get("next_measurement", ""),
        "effects": [
            {
                "name": readable(e["name"]),
                "others": [readable(n) for n in e["set"][1:]],
                "parameters": parameters_told(e["name"], e["parameters"]),
                "worth": e.get("worth", ""),
            }
            for e in diagnosis.get("effects", ())
        ],
    }


def with_spread(value: float, sd: float) -> tuple[str, str]:
    """Return a value and its standard deviation as text, both to the deviation's second digit, without exponents.

    Examples
    --------
    >>> with_spread(712.43, 110.2), with_spread(0.2034, 0.0312), with_spread(17043.0, 1234.0)
    (('710', '110'), ('0.203', '0.031'), ('17000', '1200'))
    >>> with_spread(0.00042, 0.0)
    ('0.00042', '–')
    """
    if not (sd > 0.0 and math.isfinite(sd)):
        return plain(value, 4), "–"
    digits = 1 - math.floor(math.log10(float(f"{sd:.2g}")))
    return f"{round(value, digits):.{max(digits, 0)}f}", f"{round(sd, digits):.{max(digits, 0)}f}"


def _alarms(store: Store, press: str) -> list[str]:
    words = _coefficient_words(store, press)
    return [f"{words(alarm.coefficient)}: {alarm.sentence}" for alarm in alarms_of(store, press)]


def _runs(store: Store, press: str) -> Iterator[dict[str, Any]]:
    for record in store.runs(press=press, limit=SHOWN_RUNS).items:
        fit = store.fit(record.run)
        yield {"run": record.run, "started": f"{record.started_utc:%Y-%m-%d %H:%M}", "fit": fit}
