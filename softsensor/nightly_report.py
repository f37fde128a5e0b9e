"""The nightly job's page: what was fitted, what drifts, what the diagnosis said, which model is in force."""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, select_autoescape

from daq.records import InputError
from daq.store import Store
from softsensor.drift import RunValue, watch_all

if TYPE_CHECKING:
    from softsensor.nightly import Outcome

HISTORY_RUNS = 200
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
        in_force=_in_force(store, press),
        diagnosis=diagnoses[0].diagnosis if diagnoses else None,
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


def _in_force(store: Store, press: str) -> list[dict[str, Any]]:
    """Return every parameter of the model in force with its spread."""
    active = store.active_model(press)
    if active is None:
        return []
    tables = [("", active.model.get("coefficients", {}))]
    tables += [(f"{e['name']}.", e.get("parameters", {})) for e in active.model.get("effects", [])]
    return [{"name": f"{before}{name}", **entry} for before, table in tables for name, entry in table.items()]


def _alarms(store: Store, press: str) -> list[str]:
    history: dict[str, list[RunValue]] = {}
    for c in reversed(store.coefficient_history(press=press, limit=HISTORY_RUNS).items):
        if c.identifiable:
            history.setdefault(c.name, []).append(RunValue(c.run, c.value, c.sd))
    return [alarm.sentence for alarm in watch_all(history)]


def _runs(store: Store, press: str) -> Iterator[dict[str, Any]]:
    for record in store.runs(press=press, limit=SHOWN_RUNS).items:
        fit = store.fit(record.run)
        yield {"run": record.run, "started": f"{record.started_utc:%Y-%m-%d %H:%M}", "fit": fit}
