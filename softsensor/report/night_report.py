"""The nightly job's page: what was fitted, what drifts, what the diagnosis found, which model is in force."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from daq.press.press_file import parse_press
from daq.records import InputError
from daq.tables import reason_of
from daq.words import Message, say
from daq.words.message import ENGLISH
from softsensor.effects import find_effect
from softsensor.effects.vocabulary import called, coefficient_words, parameters_shown
from softsensor.jobs.model_in_force import PRESS_FILE
from softsensor.jobs.night_record import NightRecord
from softsensor.report.diagnosis_figures import diagnosis_pictures
from softsensor.report.page import kelvins, page


def night_report(night: NightRecord, language: str = ENGLISH, link: str = "") -> str:
    """Return the page as HTML text; it needs no other file. Runs are linked to the page at the address `link`."""
    bodies = _bodies(night.press_file)
    return page(
        "nightly_report.html",
        language,
        press=night.outcome.press,
        written=f"{night.written:%Y-%m-%d %H:%M} UTC",
        outcome=_outcome(night),
        fits=night.outcome.fits_line,
        models=[_version(m.version, m.status, m.model, m.reason) for m in night.models],
        in_force=_in_force(night.in_force or {}, bodies),
        diagnosis=_found(night.diagnosis),
        pictures=_pictures(night.diagnosis, language),
        drifts=[
            say("night-drift", coefficient=bodies(name), what=message) for name, message in night.outcome.drifts
        ],
        runs=[_run(r.run, r.started_utc, fit) | {"link": _link(link, r.run)} for r, fit in night.runs],
        failures=[entry.message for entry in night.failures],
    )


def write_report(night: NightRecord, folder: Path, language: str = ENGLISH, link: str = "") -> Path:
    """Write the page as ``PRESS-DATE.html`` and return where; a page of the same night is replaced as a whole.

    Raises
    ------
    InputError
        Where the folder cannot be written.
    """
    path = folder / f"{night.outcome.press}-{night.written:%Y-%m-%d}.html"
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(night_report(night, language, link), encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise InputError(say("night-cannot-write", path=str(path), why=reason_of(error))) from error
    return path


def _pictures(diagnosis: Mapping[str, Any] | None, language: str) -> dict[str, str]:
    """Return the pictures of the newest diagnosis; none of one that a version before 2026-11-23 stored."""
    curves = (diagnosis or {}).get("curves")
    return diagnosis_pictures(curves, (diagnosis or {}).get("law"), language) if curves else {}


def _link(page: str, run: str) -> str:
    return f"{page}#/runs/{quote(run, safe='')}" if page else ""


def _outcome(night: NightRecord) -> Message:
    outcome = night.outcome
    reason = outcome.reason
    if outcome.promoted:
        return say("night-promoted", version=outcome.version, reason=reason)
    if outcome.version:
        return say("night-stays", version=outcome.version, reason=reason)
    return say("night-no-model", reason=reason)


def _version(version: str, status: str, model: Mapping[str, Any], reason: Message | str) -> dict[str, Any]:
    effects = tuple(called(effect["name"]) for effect in model.get("effects", ()))
    return {
        "version": version,
        "status": Message(f"night-status-{status}"),
        "effects": say("list-of-names", names=effects) if effects else say("night-no-effects"),
        "reason": Message.from_json(kept) if (kept := (model.get("basis") or {}).get("reason")) else reason,
    }


def _run(name: str, started_utc: datetime | None, fit: Mapping[str, Any] | None) -> dict[str, Any]:
    started = f"{started_utc:%Y-%m-%d %H:%M}" if started_utc is not None else say("page-date-unknown")
    if not fit:
        return {"run": name, "started": started, "rmse": "–", "guesses": "–", "with": say("night-not-fitted")}
    rmse, guesses = kelvins(fit["rmse_K"]), kelvins(fit["initial_rmse_K"])
    if any(warning["code"] == "fit-not-described-check" for warning in fit.get("warnings_said", ())):
        rmse = say("night-run-not-described", rmse=rmse)
    version = fit["model_version"]
    shown = say("night-with-press-file") if version == PRESS_FILE else version
    return {"run": name, "started": started, "rmse": rmse, "guesses": guesses, "with": shown}


def _in_force(model: Mapping[str, Any], bodies: Callable[[str], Message | str]) -> list[dict[str, Any]]:
    """Return every parameter of the model in force with its spread and unit."""
    rows = [_row(name, bodies(name), (1.0, "W/m²K"), e) for name, e in model.get("coefficients", {}).items()]
    for table in model.get("effects", []):
        effect = find_effect(table["name"])
        known = {p.name: p for p in effect.parameters}
        for name, entry in table.get("parameters", {}).items():
            if known[name].fixed:
                continue
            scale = (known[name].factor, known[name].shown_unit)
            row = _row(effect.key(name), effect.parameter_called(name), scale, entry)
            rows.append(row | {"short": effect.called})
    return rows


def _bodies(press_file: str) -> Callable[[str], Message | str]:
    """Return what calls a coefficient by the bodies it couples, as the press file kept in the store has them."""
    try:
        described = parse_press(press_file)
    except InputError:  # kept by an earlier version, or by hand: short names will do
        return lambda name: name

    def words(name: str) -> Message | str:
        bodies = coefficient_words(described, name)
        return bodies if str(bodies) else name

    return words


def _row(
    name: str, words: Message | str, scale: tuple[float, Message | str], entry: Mapping[str, float]
) -> dict[str, Any]:
    factor, unit = scale
    value, sd = with_spread(factor * float(entry["value"]), factor * float(entry.get("sd") or 0.0))
    short = "" if words == name else name
    return {"name": name, "words": words, "short": short, "value": value, "sd": sd, "unit": unit}


def _found(diagnosis: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the newest diagnosis in words."""
    if diagnosis is None:
        return None
    return {
        "verdict": Message(f"diagnosis-verdict-{diagnosis['verdict']}"),
        "next": _sentence(diagnosis, "next_measurement"),
        "law": [_sentence(one, "sentence") for one in diagnosis.get("law_sentences", ())],
        "plan": _planned(diagnosis.get("plan")),
        "notes": [Message.from_json(one) for one in diagnosis.get("warnings_said", ())],
        "effects": [
            {
                "name": say("list-of-names", names=tuple(called(n) for n in e["set"])),
                "worth": _sentence(e, "worth"),
                "parameters": parameters_shown(e["name"], e["parameters"]),
            }
            for e in diagnosis.get("effects", ())
        ],
    }


def _planned(plan: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Return what is open with its pressings in words; a version before 2026-11-30 stored no plan."""
    points = (plan or {}).get("open", ())
    return [
        {
            "point": _sentence(point, "sentence"),
            "pressings": [_sentence(one, "sentence") for one in point["pressings"]],
        }
        for point in points
    ]


def _sentence(content: Mapping[str, Any], key: str) -> Message | str:
    """Return a sentence of a stored diagnosis, the English text where an earlier version stored no code."""
    coded = content.get(f"{key}_said")
    return Message.from_json(coded) if coded else str(content.get(key, ""))


def with_spread(value: float, sd: float) -> tuple[Message, Message | str]:
    """Return a value and its standard deviation, both to the deviation's second digit, without exponents.

    Examples
    --------
    >>> [tuple(map(str, with_spread(*row))) for row in ((712.43, 110.2), (0.2034, 0.0312), (17043.0, 1234.0))]
    [('710', '110'), ('0.203', '0.031'), ('17000', '1200')]
    >>> tuple(map(str, with_spread(0.00042, 0.0)))
    ('0.00042', '–')
    """
    if not (sd > 0.0 and math.isfinite(sd)):
        return say("report-number", value=value), "–"
    digits = 1 - math.floor(math.log10(float(f"{sd:.2g}")))
    return _decimals(value, digits), _decimals(sd, digits)


def _decimals(value: float, digits: int) -> Message:
    return say("report-decimals", value=round(value, digits), digits=max(digits, 0))
