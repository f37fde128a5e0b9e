"""ETag on every JSON answer: what has not changed is not sent again."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


@dataclass
class EntityTags:
    """Holds back JSON answers to GET until they are whole, tags them, and answers 304 where they match."""

    app: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass streams and everything that is not JSON through as it comes."""
        if scope["type"] != "http" or scope["method"] not in ("GET", "HEAD"):
            await self.app(scope, receive, send)
            return
        await self.app(scope, receive, _Tagged(Headers(scope=scope).get("if-none-match", ""), send).send)


class _Tagged:
    def __init__(self, known: str, send: Send) -> None:
        self._known = {tag.strip() for tag in known.split(",")}
        self._forward = send
        self._start: Message | None = None
        self._body = bytearray()

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            kind = Headers(raw=message["headers"]).get("content-type", "")
            if message["status"] == 200 and kind.startswith("application/json"):
                self._start = message
                return
            await self._forward(message)
        elif self._start is None:
            await self._forward(message)
        else:
            self._body += message.get("body", b"")
            if not message.get("more_body", False):
                await self._finish(self._start)

    async def _finish(self, start: Message) -> None:
        tag = f'W/"{hashlib.blake2b(self._body, digest_size=12).hexdigest()}"'
        headers = MutableHeaders(raw=start["headers"])
        headers["ETag"] = tag
        headers["Cache-Control"] = "no-cache"
        body = bytes(self._body)
        if tag in self._known or "*" in self._known:
            start["status"] = 304
            body = b""
            del headers["content-length"]
        await self._forward(start)
        await self._forward({"type": "http.response.body", "body": body})
