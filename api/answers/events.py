"""Lines of the journal, and what the presses did, as the API says them."""

from __future__ import annotations

from api.answers.schemas import EventRecord
from api.answers.words import message_answer
from daq.store.records import JournalEntry, StoredPressEvent
from daq.words import Message


def event_of(entry: JournalEntry) -> EventRecord:
    """Return a line of the journal; `run` is the one it is about, where it is about one."""
    run = entry.message.arguments.get("run") or (entry.detail or {}).get("run")
    return EventRecord(
        id=str(entry.number),
        utc=entry.utc,
        level=entry.level,
        process=entry.process,
        press=entry.press,
        run=run if isinstance(run, str) else None,
        message=str(entry.message),
        message_said=message_answer(entry.message),
        details=dict(entry.detail or {}),
    )


def press_event_of(event: StoredPressEvent, run: str | None) -> EventRecord:
    """Return what a press did as a line like those of the journal."""
    message = Message(f"journal-press-{event.kind}")
    return EventRecord(
        id=str(event.number),
        utc=event.utc,
        level="info",
        process="record",
        press=event.press,
        run=run,
        message=str(message),
        message_said=message_answer(message),
        details={"source": event.source},
    )
