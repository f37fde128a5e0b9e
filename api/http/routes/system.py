"""Health, the journal, and numbers for Prometheus."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, ConfigDict, Field

from api.answers.events import event_of, press_event_of
from api.answers.health import health_of
from api.answers.records import utc_now
from api.answers.schemas import EventList, EventRecord, Health
from api.http.metrics import metrics_text
from api.http.problems import problem_responses
from api.http.routes.common import PageDep, PressName, StoreDep, Words, Writer, existing_press

router = APIRouter(tags=["system"], responses=problem_responses(404))
metrics_router = APIRouter(tags=["system"])


@router.get("/health", operation_id="get_health", summary="Whether the system does its work")
def get_health(store: StoreDep) -> Health:
    """Return processes, store and alarms; the status is `degraded` while something needs a person."""
    return health_of(store, utc_now())


@router.get("/events", operation_id="list_events", summary="The journal, newest first")
def list_events(
    store: StoreDep,
    part: PageDep,
    press: PressName = None,
    level: Annotated[Literal["info", "warning", "alarm"] | None, Query(description="Only this level.")] = None,
    process: Annotated[
        str | None, Query(max_length=200, description="Only what this process or person wrote.")
    ] = None,
    kind: Annotated[
        Literal["journal", "press"],
        Query(description="`press`: closings and openings, with cursors of their own."),
    ] = "journal",
) -> EventList:
    """Return alarms, losses, changes of state, notes, and who changed what; or what the presses did."""
    if kind == "press":
        return EventList.of(store.press_journal(press, part.cursor, part.limit), lambda one: press_event_of(*one))
    page = store.journal(press=press, level=level, process=process, cursor=part.cursor, limit=part.limit)
    return EventList.of(page, event_of)


class Note(BaseModel):
    """What somebody noticed at a press."""

    model_config = ConfigDict(extra="forbid")

    press: Annotated[str, Field(max_length=200)]
    text: Annotated[Words, Field(min_length=1, max_length=2000)]


@router.post("/events", operation_id="add_note", summary="Write a note into the journal", status_code=201)
def add_note(store: StoreDep, note: Note, who: Writer) -> EventRecord:
    """Keep a note; while a pressing is recorded it belongs to it, at its time."""
    existing_press(store, note.press)
    return event_of(store.note(note.press, note.text, who))


@metrics_router.get("/metrics", response_class=PlainTextResponse, include_in_schema=False)
def get_metrics(store: StoreDep) -> PlainTextResponse:
    """Return the present numbers in Prometheus' text format."""
    return PlainTextResponse(metrics_text(store, utc_now()), media_type="text/plain; version=0.0.4")
