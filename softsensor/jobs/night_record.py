"""What the store holds of a press after a night: what its page shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from typing import Any

from daq.store import JournalEntry, ModelRecord, RunRecord, Store, StoredNight, every
from daq.words import Message
from softsensor.jobs.night_judgement import NightOutcome

# Numbers without another source were set by hand, 2026-11.

SHOWN_RUNS, SHOWN_MODELS, SHOWN_ENTRIES = 30, 10, 20
"""Newest runs, model versions and journal entries that a page shows."""


@dataclass(frozen=True)
class NightRecord:
    """A press after a night."""

    outcome: NightOutcome
    written: datetime
    press_file: str
    """As the store keeps it, empty where it keeps none."""
    in_force: Mapping[str, Any] | None
    """The model file's content."""
    diagnosis: Mapping[str, Any] | None
    """The newest one."""
    models: Sequence[ModelRecord]
    runs: Sequence[tuple[RunRecord, Mapping[str, Any] | None]]
    """With their fits, newest first."""
    failures: Sequence[JournalEntry]


def night_record(store: Store, outcome: NightOutcome) -> NightRecord:
    """Return what the store holds of the press of an outcome, now."""
    return _record(store, outcome, datetime.now(UTC), None)


def stored_night_record(store: Store, night: StoredNight) -> NightRecord:
    """Return what the store holds of a night, without what came after it.

    Fits and the versions' standing are today's.
    """
    content = night.night
    outcome = NightOutcome(
        press=night.press,
        **{
            key: content[key]
            for key in ("runs", "fitted", "version", "verdict", "blind", "new", "later", "refused")
        },
        failed=content["not_fitted"],
        promoted=bool(content["promoted"]),
        reason=Message.from_json(content["reason"]),
        named=tuple(content["named"]),
        drifts=tuple((d["coefficient"], Message.from_json(d["said"])) for d in content.get("drifts", ())),
    )
    return _record(store, outcome, night.ended_utc, night.ended_utc)


def _record(
    store: Store,
    outcome: NightOutcome,
    written: datetime,
    until: datetime | None,
) -> NightRecord:
    press = outcome.press
    if until is None:
        active = store.active_model(press)
    else:
        active = store.model(outcome.version) if outcome.version else None
    diagnoses = every(lambda cursor: store.diagnoses(press=press, cursor=cursor, limit=1))
    models = every(lambda cursor: store.models(press=press, cursor=cursor, limit=SHOWN_MODELS))
    runs = every(lambda cursor: store.runs(press=press, cursor=cursor, limit=SHOWN_RUNS))
    failures = every(
        lambda cursor: store.journal(press=press, level="warning", cursor=cursor, limit=SHOWN_ENTRIES)
    )

    def there(utc: datetime | None) -> bool:
        return until is None or utc is None or utc <= until  # a run of an unknown date came in by a file

    diagnosis = next((d for d in diagnoses if there(d.created_utc)), None)
    return NightRecord(
        outcome=outcome,
        written=written,
        press_file=store.presses().get(press, ""),
        in_force=active.model if active else None,
        diagnosis=diagnosis.diagnosis if diagnosis else None,
        models=list(islice((m for m in models if there(m.created_utc)), SHOWN_MODELS)),
        runs=[(r, store.fit(r.run)) for r in islice((r for r in runs if there(r.started_utc)), SHOWN_RUNS)],
        failures=list(islice((e for e in failures if there(e.utc)), SHOWN_ENTRIES)),
    )
