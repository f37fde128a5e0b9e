"""Every error leaves the API as a problem document (RFC 9457): what is wrong and what to do."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import Match, Mount

from api.answers.schemas import Problem
from api.answers.words import message_answer
from api.http.http_compatibility import ENDLESS
from daq.records import InputError
from daq.store.records import ScansUnreadable, StoreUnavailable
from daq.tables import why_of
from daq.words import Message, say, spoken

MEDIA_TYPE = "application/problem+json"
MOST_FIELDS = 5
"""Of a request with more wrong fields the first ones are named."""
LOG = logging.getLogger("kerntemp.serve")


class ProblemError(HTTPException):
    """An error with a status and a message about what to do."""

    def __init__(self, status: int, message: Message, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(status_code=status, detail=str(message), headers=dict(headers or {}))
        self.message = message


def problem_response(
    status: int, message: Message, instance: str = "", headers: Mapping[str, str] | None = None
) -> JSONResponse:
    """Return the answer for an error."""
    title = HTTPStatus(status).phrase
    problem = Problem(
        title=title, status=status, detail=str(message), detail_said=message_answer(message), instance=instance
    )
    content = problem.model_dump()
    return JSONResponse(content, status, dict(headers or {}), MEDIA_TYPE)


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe the errors of a route for OpenAPI; 401, 403, 422, 429 and 503 can come from any."""
    described: dict[int | str, dict[str, Any]] = {}
    for status in sorted({*statuses, 400, 401, 403, 422, 429, 503}):
        schema = {"$ref": "#/components/schemas/Problem"}
        described[status] = {
            "description": HTTPStatus(status).phrase,
            "content": {MEDIA_TYPE: {"schema": schema}},
        }
    return described


def install(app: FastAPI) -> None:
    """Turn every error of `app` into a problem document."""
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(InputError, _input)
    app.add_exception_handler(StoreUnavailable, _store)
    app.add_exception_handler(ScansUnreadable, _store)
    app.add_exception_handler(Exception, _unexpected)


def _http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    message = error.message if isinstance(error, ProblemError) else spoken(error.detail)
    headers = dict(error.headers or {})
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(methods_of(request))
    return problem_response(error.status_code, message, request.url.path, headers)


def methods_of(request: Request) -> list[str]:
    """Return what a request's path has (RFC 9110, 15.5.6); the framework names one route's methods only."""
    routes = [route for route in request.app.routes if not isinstance(route, Mount)]
    scopes = {method: {**request.scope, "method": method} for method in ("GET", "POST", "PUT", "PATCH", "DELETE")}
    found = {m for m, scope in scopes.items() if any(r.matches(scope)[0] is Match.FULL for r in routes)}
    found = found or {"GET"}  # the page's files
    return sorted(found | ({"HEAD"} if "GET" in found and request.url.path != ENDLESS else set()))


def _invalid(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    wrong = error.errors()[:MOST_FIELDS]
    found = [_field(item) for item in wrong]
    if wrong[0]["loc"][0] == "body" and "json" not in request.headers.get("content-type", ""):
        found.append(say("api-body-not-json"))
    return problem_response(422, say("api-request-invalid", problems=tuple(found)), request.url.path)


def _field(item: Mapping[str, Any]) -> Message:
    """Return what is wrong with a field; what only the checking library has words for stays English."""
    *above, last = (str(part) for part in item["loc"])
    if last == "[key]" and item["type"] == "string_pattern_mismatch":
        return say("api-field-name-invalid", field=".".join(above))
    return say("api-field-invalid", field=".".join((*above, last)), why=why_of(item))


def _input(request: Request, error: Exception) -> JSONResponse:
    return problem_response(422, spoken(error), request.url.path)


def _store(request: Request, error: Exception) -> JSONResponse:
    return problem_response(503, spoken(error), request.url.path, {"Retry-After": "2"})


def _unexpected(request: Request, error: Exception) -> JSONResponse:
    LOG.error("%s %s: %s: %s", request.method, request.url.path, type(error).__name__, error)
    return problem_response(500, say("api-server-failed"), request.url.path)
