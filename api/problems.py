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

from api.schemas import Problem
from daq.records import InputError
from daq.store.records import StoreUnavailable

MEDIA_TYPE = "application/problem+json"
LOG = logging.getLogger("kerntemp.serve")


class ProblemError(HTTPException):
    """An error with a status and one sentence about what to do."""

    def __init__(self, status: int, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(status_code=status, detail=detail, headers=dict(headers or {}))


def problem_response(
    status: int, detail: str, instance: str = "", headers: Mapping[str, str] | None = None
) -> JSONResponse:
    """Return the answer for an error."""
    title = HTTPStatus(status).phrase
    content = Problem(title=title, status=status, detail=detail, instance=instance).model_dump()
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
    app.add_exception_handler(Exception, _unexpected)


def _http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    return problem_response(error.status_code, str(error.detail), request.url.path, error.headers)


def _invalid(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    found = [f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}" for item in error.errors()[:5]]
    if found[0].startswith("body") and "json" not in request.headers.get("content-type", ""):
        found.append("the body must be JSON, said so by Content-Type: application/json")
    return problem_response(422, "; ".join(found), request.url.path)


def _input(request: Request, error: Exception) -> JSONResponse:
    return problem_response(422, str(error), request.url.path)


def _store(request: Request, error: Exception) -> JSONResponse:
    return problem_response(503, str(error), request.url.path, {"Retry-After": "2"})


def _unexpected(request: Request, error: Exception) -> JSONResponse:
    LOG.error("%s %s: %s: %s", request.method, request.url.path, type(error).__name__, error)
    detail = "the server failed at this; its log says where"
    return problem_response(500, detail, request.url.path)
