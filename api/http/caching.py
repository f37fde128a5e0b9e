"""ETag on every JSON answer: what has not changed is not sent again."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


def entity_tag(content: bytes | bytearray) -> str:
    """Return a weak entity tag: compressed or not, the content is the same."""
    return f'W/"{hashlib.blake2b(content, digest_size=12).hexdigest()}"'


def same_entity(if_none_match: str, tag: str) -> bool:
    """Whether `If-None-Match` knows a tag, compared weakly (RFC 9110, 13.1.2)."""
    known = {one.strip().removeprefix("W/") for one in if_none_match.split(",")}
    return "*" in known or tag.removeprefix("W/") in known


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
        self._known = known
        self._forward = send
        self._start: Message | None = None
        self._body = bytearray()

    async def send(self, message: Message) -> None:
        """Pass an answer on; hold JSON back until all of it is there and its tag known."""
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
        tag = entity_tag(self._body)
        headers = MutableHeaders(raw=start["headers"])
        headers["ETag"] = tag
        headers["Cache-Control"] = "no-cache"
        body = bytes(self._body)
        if same_entity(self._known, tag):
            start["status"] = 304
            body = b""
            del headers["content-length"]
        await self._forward(start)
        await self._forward({"type": "http.response.body", "body": body})
