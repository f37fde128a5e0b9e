"""Health, the journal, and numbers for Prometheus."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from fastapi.responses import PlainTextResponse

from api.answers.health import health_of
from api.answers.records import utc_now
from api.answers.schemas import EventList, EventRecord, Health
from api.answers.words import said_of
from api.http.metrics import metrics_text
from api.http.problems import problem_responses
from api.http.routes.common import Cursor, PageSize, PressName, StoreDep

router = APIRouter(tags=["system"], responses=problem_responses())
metrics_router = APIRouter(tags=["system"])


@router.get("/health", operation_id="get_health", summary="Whether the system does its work")
def get_health(store: StoreDep) -> Health:
    """Return processes, store and alarms; the status is `degraded` while something needs a person."""
    return health_of(store, utc_now())


@router.get("/events", operation_id="list_events", summary="The journal, newest first")
def list_events(
    store: StoreDep,
    press: PressName = None,
    level: Annotated[Literal["info", "warning", "alarm"] | None, Query(description="Only this level.")] = None,
    cursor: Cursor = None,
    limit: PageSize = 50,
) -> EventList:
    """Return alarms, losses, changes of state, and who changed what."""
    page = store.journal(press=press, level=level, cursor=cursor, limit=limit)
    items = [
        EventRecord(
            id=str(entry.number),
            utc=entry.utc,
            level=entry.level,
            process=entry.process,
            press=entry.press,
            message=str(entry.message),
            message_said=said_of(entry.message),
            details=dict(entry.detail or {}),
        )
        for entry in page.items
    ]
    return EventList(items=items, next_cursor=page.next_cursor)


@metrics_router.get("/metrics", response_class=PlainTextResponse, include_in_schema=False)
def get_metrics(store: StoreDep) -> PlainTextResponse:
    """Return the present numbers in Prometheus' text format."""
    return PlainTextResponse(metrics_text(store, utc_now()), media_type="text/plain; version=0.0.4")
