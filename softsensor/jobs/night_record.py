"""What the store holds of a press after a night: what its page shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from typing import Any

from daq.store import JournalEntry, ModelRecord, RunRecord, Store, StoredNight, every
from daq.words import Message
from softsensor.jobs.night_basis import NightOutcome

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
    diagnoses = store.diagnoses(press=press, limit=1, until=until).items
    return NightRecord(
        outcome=outcome,
        written=written,
        press_file=store.presses().get(press, ""),
        in_force=active.model if active else None,
        diagnosis=diagnoses[0].diagnosis if diagnoses else None,
        models=store.models(press=press, limit=SHOWN_MODELS, until=until).items,
        runs=[(run, store.fit(run.run)) for run in _runs(store, press, until)],
        failures=store.journal(press=press, level="warning", limit=SHOWN_ENTRIES, until=until).items,
    )


def _runs(store: Store, press: str, until: datetime | None) -> Iterator[RunRecord]:
    """Yield the newest runs; with `until` those begun before, with what came in by a file without a date."""
    if until is None:
        yield from store.runs(press=press, limit=SHOWN_RUNS).items
        return
    begun = store.runs(press=press, limit=1, until=until).items
    newer = str(begun[0].number + 1) if begun else None
    runs = every(lambda cursor: store.runs(press=press, cursor=cursor or newer, limit=SHOWN_RUNS))
    yield from islice((r for r in runs if r.started_utc is None or r.started_utc < until), SHOWN_RUNS)
