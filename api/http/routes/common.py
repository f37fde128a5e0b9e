"""What every route needs: the store, the page size, and leave to change something."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, Query, Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from pydantic import AfterValidator, BeforeValidator, Field

from api.http.gate import token_of
from api.http.problems import ProblemError
from daq.store.records import AT_ONCE, RunRecord
from daq.store.store import Store
from daq.words import say

MAX_PAGE = AT_ONCE
"""Items in one page: some 100 kB."""


PressName = Annotated[str | None, Query(description="Only this press.", max_length=200)]


def get_store(request: Request) -> Store:
    """Return the store this application serves."""
    store = request.app.state.store
    if not isinstance(store, Store):
        raise TypeError("the application was made without a store")
    return store


def get_presses(request: Request, press: PressName = None) -> Mapping[str, str]:
    """Return the press files by name: of one press, or of all."""
    return {name: text for name, text in get_store(request).presses().items() if press in (None, name)}


def get_resins(request: Request) -> Mapping[str, Path]:
    """Return the resin files of the configuration by press."""
    resins: Mapping[str, Path] = request.app.state.resins
    return resins


def get_headers(request: Request) -> Mapping[str, Mapping[str, Any]]:
    """Return what the configuration says of the runs of each press."""
    headers: Mapping[str, Mapping[str, Any]] = request.app.state.headers
    return headers


def get_writer(request: Request) -> str:
    """Return who makes a change. Refuses without a token of scope write."""
    token = token_of(request.scope)
    if token is None:
        raise ProblemError(
            401,
            say("api-change-needs-token"),
            {"WWW-Authenticate": 'Bearer realm="kerntemp"'},
        )
    if not token.allows("write"):
        raise ProblemError(403, say("api-token-reads-only", name=token.name))
    return token.name


def only_known_queries(request: Request) -> None:
    """Refuse a query the route does not know: a misspelt filter would answer with everything."""
    route = request.scope.get("route")
    known = list(_queries_of(route.dependant)) if isinstance(route, APIRoute) else []
    for name in request.query_params:
        if name not in known:
            of_none = say("api-query-unknown-of-none", name=name)
            raise ProblemError(422, say("api-query-unknown", name=name, known=tuple(known)) if known else of_none)


def _queries_of(dependant: Dependant) -> Iterator[str]:
    """Yield the names of a route's queries, its own and those of what it depends on."""
    yield from (query.alias for query in dependant.query_params)
    for one in dependant.dependencies:
        yield from _queries_of(one)


_KEPT = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$"
Words = Annotated[str, Field(max_length=4000, pattern=_KEPT)]
"""Any text but control characters, which no database keeps and no reader sees. Lines and tabs may be, and marks of
direction, which Arabic and Hebrew with figures need; names alone are held to `daq.tables.unseen`."""
StoreDep = Annotated[Store, Depends(get_store)]
PressesDep = Annotated[Mapping[str, str], Depends(get_presses)]
ResinsDep = Annotated[Mapping[str, Path], Depends(get_resins)]
HeadersDep = Annotated[Mapping[str, Mapping[str, Any]], Depends(get_headers)]
Writer = Annotated[str, Depends(get_writer)]
PageSize = Annotated[int, Query(ge=1, le=MAX_PAGE, description="Items in one page.")]
Cursor = Annotated[
    str | None,
    Query(description="`next_cursor` of the page before; empty for the first.", pattern="^[0-9]{0,18}$"),
    AfterValidator(lambda cursor: cursor or None),
]


def _no_number(value: str) -> str:
    """Refuse a number, such as a year or a day without hyphens: pydantic takes it for seconds since 1970."""
    try:
        float(value)
    except ValueError:
        return value
    raise ValueError(say("key-no-instant"))


Instant = Annotated[datetime, BeforeValidator(_no_number)]
Since = Annotated[Instant | None, Query(alias="from", description="Started at or after this instant.")]
Until = Annotated[Instant | None, Query(alias="to", description="Started before this instant.")]


@dataclass(frozen=True)
class PagePart:
    """Which page of a list."""

    cursor: Cursor = None
    limit: PageSize = 50


@dataclass(frozen=True)
class Began:
    """Between which instants what is asked for began."""

    since: Since = None
    until: Until = None

    @property
    def span(self) -> tuple[datetime | None, datetime | None]:
        """Both instants. Refuses one without a time zone."""
        return aware(self.since), aware(self.until)


PageDep = Annotated[PagePart, Depends()]
BeganDep = Annotated[Began, Depends()]


def existing_run(store: Store, run: str) -> RunRecord:
    """Return a run's record or refuse: with 404 where there is none, with 503 where it is damaged."""
    if not store.has_run(run):
        raise ProblemError(404, say("api-run-unknown", run=run))
    return store.run_record(run)


def existing_press(store: Store, press: str) -> str:
    """Return a press's name or refuse with 404."""
    known = tuple(store.presses())
    if press not in known:
        raise ProblemError(404, say("api-press-unknown", press=press, known=known))
    return press


def aware(instant: datetime | None) -> datetime | None:
    """Return an instant of a query, if there is one, as `zoned` does."""
    return None if instant is None else zoned(instant)


def zoned(instant: datetime) -> datetime:
    """Return an instant of a query. Refuses one without a time zone."""
    if instant.tzinfo is None:
        raise ProblemError(422, say("api-instant-without-zone", instant=instant.isoformat()))
    return instant
