"""Who may come in, and with how much: loopback reads freely, everybody else needs a token.

Plain ASGI, so that streams pass through untouched. The page's own files hold no data and are open;
the gate stands before everything below ``/api`` and ``/metrics``.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import re
from dataclasses import dataclass
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as Event

from api.http.problems import problem_response
from api.http.tokens import Attempts, Token, TokenFile
from daq.records import InputError
from daq.tables import DEEPEST
from daq.words import Message, say, spoken

MAX_BODY_BYTES = 64 * 1024
"""No request of this API needs more."""
BODY_S = 10.0
"""A body has this long to arrive. [s]"""
SLOWED_S = 1.0
"""A wrong token from an address that sent too many is answered so late. Set by hand, 2026-11. [s]"""
MOST_SLOWED = 20
"""Answers held back at once; more are given without delay, or they would take the connections of others."""
LOG = logging.getLogger("kerntemp.serve")
OPEN = ("/api/v1/openapi.json", "/api/v1/messages/")
"""What needs no token: it holds no data, and the page cannot ask for a token without words."""
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]", "::1", "")


def is_loopback(address: str) -> bool:
    """Whether an address or host name means this machine only."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address.strip("[]")).is_loopback
    except ValueError:
        return False


@dataclass
class Gate:
    """Checks size, host, and token of each request, and notes the token for routes that change things."""

    app: ASGIApp
    tokens: TokenFile
    attempts: Attempts
    body_s: float = BODY_S
    _slowed: int = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request through or answer with a problem document."""
        if scope["type"] != "http" or not _guarded(scope["path"]):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is None and scope["method"] not in ("GET", "HEAD"):
            try:
                async with asyncio.timeout(self.body_s):
                    receive = await _whole_body(receive)
            except TimeoutError:
                refusal = 408, say("api-body-late", seconds=self.body_s), _CLOSE
            except _TooLargeError:
                refusal = _TOO_LARGE
            except InputError as error:
                refusal = 422, spoken(error), {}
        if refusal is not None:
            status, message, extra = refusal
            if status == HTTPStatus.TOO_MANY_REQUESTS:
                await self._slow_down()
            await problem_response(status, message, scope["path"], extra)(scope, receive, send)
            return
        await self.app(scope, receive, send)

    async def _slow_down(self) -> None:
        """Hold an answer back."""
        if self._slowed >= MOST_SLOWED:
            return
        self._slowed += 1
        try:
            await asyncio.sleep(SLOWED_S)
        finally:
            self._slowed -= 1

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, Message, dict[str, str]] | None:
        length = headers.get("content-length", "0")
        if not re.fullmatch(r"[0-9]{1,20}", length) or int(length) > MAX_BODY_BYTES:
            return _TOO_LARGE
        if "\0" in scope["path"] or b"%00" in scope["query_string"]:
            return 422, say("api-nul-character"), {}
        address = scope["client"][0] if scope.get("client") else ""
        local = is_loopback(address)
        presented = _bearer(headers)
        if presented is None:
            scope["kerntemp.token"] = None
            if not local:
                return 401, say("api-reading-needs-token"), _CHALLENGE
            if not _names_this_machine(headers.get("host", "")):
                return 403, say("api-only-loopback-names"), {}
            return None
        try:
            token = self.tokens.find(presented)
        except InputError as error:
            return 503, spoken(error), {}
        if token is None:
            return self._wrong_token(address)
        scope["kerntemp.token"] = token
        return None

    def _wrong_token(self, address: str) -> tuple[int, Message, dict[str, str]]:
        """Count it; only wrong ones are counted and slowed, so that nobody shuts out others behind one address."""
        if self.attempts.exhausted(address):
            return 429, say("api-too-many-wrong-tokens"), {"Retry-After": "60"}
        self.attempts.failed(address)
        if self.attempts.exhausted(address):
            LOG.warning("%s", say("api-slows-wrong-tokens", address=address))
        return 401, say("api-token-invalid"), _CHALLENGE


_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[\]{}]|[.]?[0-9]+', re.S)
"""Of JSON: a text, also one without an end, what opens and closes, the digits of a number."""
_MOST_DIGITS = 4300
"""Of a whole number; Python reads no more (`sys.int_info.default_max_str_digits`)."""
_CLOSE = {"Connection": "close"}
_TOO_LARGE = (413, say("api-body-too-large", bytes=MAX_BODY_BYTES), _CLOSE)
_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="kerntemp"'}


def token_of(scope: Scope) -> Token | None:
    """Return the token a request came with."""
    token = scope.get("kerntemp.token")
    return token if isinstance(token, Token) else None


def _guarded(path: str) -> bool:
    return path.startswith(("/api/", "/metrics")) and not path.startswith(OPEN)


def _bearer(headers: Headers) -> str | None:
    kind, _, value = headers.get("authorization", "").partition(" ")
    return value.strip() if kind.lower() == "bearer" else None


def _names_this_machine(host: str) -> bool:
    """Refuse foreign host names: a web page elsewhere may point its own name at 127.0.0.1."""
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
    return name in LOOPBACK_NAMES or is_loopback(name)


class _TooLargeError(Exception):
    """A body without a stated length grew beyond the limit."""


def _check_json(text: str) -> None:
    """Refuse what the JSON reader would give up on without saying where.

    Raises
    ------
    InputError
        Naming the limit, and the key where there is one.
    """
    depth, key = 0, ""
    for token in _TOKEN.findall(text):
        if token[0] == '"':
            key = token.strip('"')[:80]
        elif token[0] in "[{":
            depth += 1
        elif token[0] in "]}":
            depth -= 1
        elif token[0] != "." and len(token) > _MOST_DIGITS:
            raise InputError(say("api-body-number-too-long", key=key, count=len(token), digits=_MOST_DIGITS))
        if depth > DEEPEST:
            raise InputError(say("api-body-too-deep", key=key, deepest=DEEPEST))


async def _whole_body(receive: Receive) -> Receive:
    """Take the body in before anything works on it; returns a receive that hands it out once."""
    body, more = bytearray(), True
    while more:
        message = await receive()
        if message["type"] != "http.request":
            break
        body += message.get("body", b"")
        more = message.get("more_body", False)
        if len(body) > MAX_BODY_BYTES:
            raise _TooLargeError
    _check_json(body.decode("utf-8", "replace"))
    waiting: list[Event] = [{"type": "http.request", "body": bytes(body), "more_body": False}]

    async def replay() -> Event:
        return waiting.pop() if waiting else await receive()

    return replay
