"""What the store holds of a press after a night: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from daq.store import JournalEntry, ModelRecord, RunRecord, Store
from softsensor.jobs.drift import Alarm, alarms_of
from softsensor.jobs.night_judgement import Outcome

# Numbers without another source were set by hand, 2026-11.

SHOWN_RUNS, SHOWN_MODELS, SHOWN_ENTRIES = 30, 10, 20
"""Newest runs, model versions and journal entries that a page shows."""


@dataclass(frozen=True)
class NightRecord:
    """A press after a night."""

    outcome: Outcome
    written: datetime
    press_file: str
    """As the store keeps it, empty where it keeps none."""
    in_force: Mapping[str, Any] | None
    """The model file's content."""
    diagnosis: Mapping[str, Any] | None
    """The newest one."""
    models: Sequence[ModelRecord]
    alarms: Sequence[Alarm]
    runs: Sequence[tuple[RunRecord, Mapping[str, Any] | None]]
    """With their fits, newest first."""
    failures: Sequence[JournalEntry]


def night_record(store: Store, outcome: Outcome) -> NightRecord:
    """Return what the store holds of the press of an outcome."""
    press = outcome.press
    active, diagnoses = store.active_model(press), store.diagnoses(press=press, limit=1).items
    return NightRecord(
        outcome=outcome,
        written=datetime.now(UTC),
        press_file=store.presses().get(press, ""),
        in_force=active.model if active else None,
        diagnosis=diagnoses[0].diagnosis if diagnoses else None,
        models=store.models(press=press, limit=SHOWN_MODELS).items,
        alarms=alarms_of(store, press),
        runs=[(r, store.fit(r.run)) for r in store.runs(press=press, limit=SHOWN_RUNS).items],
        failures=store.journal(press=press, level="warning", limit=SHOWN_ENTRIES).items,
    )
