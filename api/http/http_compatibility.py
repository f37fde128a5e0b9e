"""What HTTP asks of every answer and the framework leaves out: HEAD, and no compression where it is refused."""

from __future__ import annotations

from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ENDLESS = "/api/v1/live"
"""A stream has no end to take a length from; HEAD stays refused there."""


@dataclass
class HttpCompatibility:
    """Answers HEAD as GET without the body (RFC 9110, 9.3.2) and heeds ``gzip;q=0`` (12.5.3)."""

    app: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on as the routes below understand it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if not takes_gzip(Headers(scope=scope).get("accept-encoding", "")):
            scope = {**scope, "headers": [(k, v) for k, v in scope["headers"] if k != b"accept-encoding"]}
        if scope["method"] != "HEAD" or scope["path"] == ENDLESS:
            await self.app(scope, receive, send)
            return

        async def without_body(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        await self.app({**scope, "method": "GET"}, receive, without_body)


def takes_gzip(accept_encoding: str) -> bool:
    """Whether `Accept-Encoding` allows gzip.

    Examples
    --------
    >>> [takes_gzip(header) for header in ("gzip, br", "br;q=1, gzip;q=0", "*", "gzip; q=0.5", "")]
    [True, False, True, True, False]
    """
    weights = {}
    for part in accept_encoding.lower().split(","):
        name, _, rest = part.partition(";")
        weights[name.strip()] = rest.replace(" ", "").removeprefix("q=") or "1"
    weight = weights.get("gzip", weights.get("*", "0"))
    return weight.strip("0.") != ""
