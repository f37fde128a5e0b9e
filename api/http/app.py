"""The web application: routes over one store, the page, and what stands around them.

From the outside in: HEAD and refused encodings (`http_compatibility`), response compression, access (`gate`),
entity tags, routes.
"""

from __future__ import annotations

import asyncio
import html
import logging
import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fastapi import Depends, FastAPI, HTTPException
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.answers.health import installed_version
from api.answers.kept import Kept
from api.answers.records import utc_now
from api.answers.schemas import Problem
from api.answers.words import messages_of
from api.guide import guide_page
from api.http import problems
from api.http.caching import EntityTags
from api.http.gate import Gate
from api.http.http_compatibility import HttpCompatibility
from api.http.live import MAX_LISTENERS, Hub
from api.http.metrics import metrics_text
from api.http.routes import alarms, edits, messages, models, press, runs, search, simulation, system, what_if
from api.http.routes.common import only_known_queries
from api.http.tokens import Attempts, TokenFile
from daq.store.records import StoreUnavailable
from daq.store.store import Store
from daq.supervision import BEHIND_S
from daq.words import say
from daq.words.message import ENGLISH, languages, words

LOG = logging.getLogger("kerntemp.serve")
PAGE = Path(__file__).parents[1] / "page"
DESCRIPTION = """Temperatures, core estimates, runs, coefficients and diagnoses of pressed panels.

Reading is free on loopback; from elsewhere it needs `Authorization: Bearer` with a token of scope `read`.
Every change needs scope `write`. Lists come in pages: hand `next_cursor` back as `cursor` until it is null.
Errors are problem documents (RFC 9457). Units stand in the field names; instants are UTC; missing is null.
"""
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}

ROUTERS = tuple(
    routes.router for routes in (press, runs, edits, search, simulation, what_if, models, messages, alarms, system)
)


def create_app(
    store: Store,
    tokens: TokenFile,
    max_listeners: int = MAX_LISTENERS,
    resins: Mapping[str, Path] = MappingProxyType({}),
    headers: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> FastAPI:
    """Make the application that serves `store`; the caller closes the store.

    `resins`: resin files by press; `headers`: what the configuration says of a press's runs.
    """
    hub = Hub(store, max_listeners)

    app = FastAPI(
        title="Kerntemp",
        version=installed_version(),
        description=DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        lifespan=lambda _app: _serving(store, hub),
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.store, app.state.hub, app.state.resins, app.state.headers = store, hub, resins, headers
    for router in ROUTERS:
        app.include_router(router, prefix="/api/v1", dependencies=[Depends(only_known_queries)])
    app.include_router(system.metrics_router)
    _add_page(app)
    problems.install(app)
    _add_description(app)
    _stand_around(app, tokens)
    return app


def _stand_around(app: FastAPI, tokens: TokenFile) -> None:
    """Put around the routes what the module's docstring names; the last added is the outermost."""
    app.add_middleware(EntityTags)
    app.add_middleware(Gate, tokens=tokens, attempts=Attempts())
    app.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=5)
    app.add_middleware(_SecurityHeaders)
    app.add_middleware(HttpCompatibility)


@asynccontextmanager
async def _serving(store: Store, hub: Hub) -> AsyncIterator[None]:
    """Load what readers need, and let go of them at the end."""
    await asyncio.to_thread(_warm_up, store)
    ends = asyncio.Event()
    behind = asyncio.create_task(_load_behind(ends))
    try:
        yield
    finally:
        hub.close()
        ends.set()
        await behind


def _warm_up(store: Store) -> None:
    """Load now what the first reader would have to wait for."""
    messages_of(ENGLISH)
    with suppress(StoreUnavailable):
        metrics_text(store, utc_now())


async def _load_behind(ends: asyncio.Event) -> None:
    """Load, once the page is there, what the first reader of coefficients or of what-if would have to wait for.

    That is half as much again as the page needs itself (0.3 s of processor time, 2026-11-30), and at a start every
    process is at work.
    """
    with suppress(TimeoutError):
        await asyncio.wait_for(ends.wait(), BEHIND_S)
        return
    try:
        for module in ("softsensor.jobs.drift", "softsensor.heat.model_file", "softsensor.jobs.model_in_force"):
            await asyncio.to_thread(import_module, module)
    except Exception:  # whoever asks for it gets the error
        LOG.exception("what coefficients and what-if need cannot be loaded")


@dataclass
class _SecurityHeaders:
    """Adds to every answer what browsers need to be careful."""

    app: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def careful(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, careful)


def _shell() -> str:
    """Return the page before it has the words of one language: its ``{page-code}`` stand in every one."""

    def in_every(found: re.Match[str]) -> str:
        lines = ((one, words(say(found[1]), one)) for one in languages())
        return " · ".join(f'<span lang="{one}">{html.escape(line)}</span>' for one, line in lines)

    return re.sub(r"\{(page-[a-z-]+)\}", in_every, (PAGE / "index.html").read_text(encoding="utf-8"))


def _add_page(app: FastAPI) -> None:
    """Serve the page at ``/`` and the API's own pages; nothing comes from another host."""
    shell = _shell()

    @app.get("/", include_in_schema=False)
    def page() -> HTMLResponse:
        return HTMLResponse(shell, headers={"Cache-Control": "no-cache"})

    @app.get("/docs", include_in_schema=False)
    def docs() -> FileResponse:
        return FileResponse(PAGE / "docs.html", headers={"Cache-Control": "no-cache"})

    @app.get("/guide/{path:path}", include_in_schema=False)
    def guide(path: str) -> HTMLResponse:
        found = guide_page(path)
        if found is None:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return HTMLResponse(found, headers={"Cache-Control": "no-cache"})

    app.mount("/static", StaticFiles(directory=PAGE), name="static")


def _add_description(app: FastAPI) -> None:
    """Serve what describes the API; few ask, so it is worked out for the first of them, beside the event loop."""
    kept: Kept[str, dict[str, Any]] = Kept(1)

    @app.get("/api/v1/openapi.json", include_in_schema=False)
    def description() -> JSONResponse:
        return JSONResponse(kept.get(app.version, lambda: _description(app)))


def _description(app: FastAPI) -> dict[str, Any]:
    """Return it with the schema the error answers refer to, which no route returns by itself."""
    described = app.openapi()
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    described["components"]["schemas"] |= problem.pop("$defs", {}) | {"Problem": problem}
    described["components"].setdefault("securitySchemes", {})["token"] = {"type": "http", "scheme": "bearer"}
    described["security"] = [{}, {"token": []}]
    for schema in ("HTTPValidationError", "ValidationError"):
        described["components"]["schemas"].pop(schema, None)
    for operation in (one for path in described["paths"].values() for one in path.values()):
        for parameter in operation.get("parameters", ()):
            _describe_no_nul(parameter["schema"])
    return described


def _describe_no_nul(schema: dict[str, Any]) -> None:
    """Say of a parameter's free text what `gate` holds every address to: no NUL character."""
    for one in (schema, *schema.get("anyOf", ()), schema.get("items", {})):
        if one.get("type") == "string" and not one.keys() & {"pattern", "format", "enum", "const"}:
            one["pattern"] = r"^[^\u0000]*$"
