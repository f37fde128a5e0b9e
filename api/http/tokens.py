"""Access tokens: made and revoked by `kerntemp token`, kept as hashes in a file beside the store.

A file and not a table (2026-11-21): the server then never writes to the store to let someone in, a
copy of the store that leaves the house carries no key to it, and file rights protect it.
The secrets are 256 random bits, so one SHA-256 is enough; a slow hash guards guessable passwords.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
import stat
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

from daq.records import InputError
from daq.tables import LARGEST_BYTES, reason_of
from daq.words import Message, say, spoken

Scope = Literal["read", "write"]
PREFIX = "kt"
ATTEMPTS = 10
"""Wrong tokens one address may present within `ATTEMPT_WINDOW_S` before further wrong ones are slowed."""
ATTEMPT_WINDOW_S = 60.0
"""Set by hand, 2026-11: a mistyped token is never slowed, a guessing program always. [s]"""


@dataclass(frozen=True)
class Token:
    """What is kept of a token: everything but the token."""

    id: str
    name: str
    scope: Scope
    sha256: str
    created_utc: str

    def allows(self, scope: Scope) -> bool:
        """Whether it opens `scope`; who may write may read."""
        return self.scope in ("write", scope)


class TokenFile:
    """The tokens on disk. Reading sees changes of the file at once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read: tuple[int, int] | None = None
        self._tokens: tuple[Token, ...] = ()
        self._lock = threading.Lock()

    def tokens(self) -> tuple[Token, ...]:
        """Return the tokens in force. Raises `InputError` for a file that cannot be read."""
        with self._lock:
            try:
                found = self.path.stat()
                if not stat.S_ISREG(found.st_mode) or found.st_size > LARGEST_BYTES:
                    raise InputError(say("api-tokens-no-file"))  # a pipe would hold up the server for good
                if self._read != (found.st_mtime_ns, found.st_size):
                    self._tokens = tuple(_token_of(entry) for entry in json.loads(self.path.read_text("utf-8")))
                    self._read = (found.st_mtime_ns, found.st_size)
            except FileNotFoundError:
                self._tokens, self._read = (), None
            except (OSError, ValueError, TypeError, RecursionError) as error:
                raise InputError(say("api-tokens-unreadable", path=str(self.path), why=_why(error))) from error
            return self._tokens

    def create(self, name: str, scope: Scope) -> str:
        """Add a token and return its text, which is shown once and kept nowhere."""
        if any(token.name == name for token in self.tokens()):
            raise InputError(say("api-token-exists", name=name))
        token_id, secret = secrets.token_hex(4), secrets.token_urlsafe(32)
        text = f"{PREFIX}_{token_id}_{secret}"
        created = datetime.now(UTC).isoformat(timespec="seconds")
        self._write((*self.tokens(), Token(token_id, name, scope, _digest(text), created)))
        return text

    def revoke(self, name: str) -> None:
        """Remove a token by its name or id."""
        kept = tuple(token for token in self.tokens() if name not in (token.name, token.id))
        if len(kept) == len(self.tokens()):
            known = tuple(token.name for token in kept)
            of_none = say("api-token-unknown-of-none", name=name)
            raise InputError(say("api-token-unknown", name=name, known=known) if known else of_none)
        self._write(kept)

    def find(self, text: str) -> Token | None:
        """Return the token that `text` is, in a time that does not depend on where they differ."""
        digest = _digest(text)
        found = None
        for token in self.tokens():
            if hmac.compare_digest(token.sha256, digest):
                found = token
        return found

    def _write(self, tokens: tuple[Token, ...]) -> None:
        draft = self.path.with_suffix(".new")
        draft.touch(mode=0o600)
        draft.write_text(json.dumps([asdict(token) for token in tokens], indent=2) + "\n", encoding="utf-8")
        draft.replace(self.path)
        with self._lock:
            self._read = None


@dataclass
class Attempts:
    """Counts wrong tokens by address and says when further ones are slowed."""

    now: Callable[[], float] = time.monotonic
    _failures: dict[str, deque[float]] = field(default_factory=dict)

    def exhausted(self, address: str) -> bool:
        """Whether `address` presented too many wrong tokens lately."""
        recent = self._failures.get(address)
        if recent is None:
            return False
        while recent and recent[0] < self.now() - ATTEMPT_WINDOW_S:
            recent.popleft()
        if not recent:
            del self._failures[address]
        return len(recent) >= ATTEMPTS

    def failed(self, address: str) -> None:
        """Note a wrong token; at most 10000 addresses are remembered."""
        if len(self._failures) >= 10_000 and address not in self._failures:
            self._failures.pop(next(iter(self._failures)))
        self._failures.setdefault(address, deque(maxlen=ATTEMPTS)).append(self.now())


def _token_of(entry: Any) -> Token:
    """Return a token from its entry in the file. Raises TypeError or InputError for anything else."""
    token = Token(**entry)
    if not all(isinstance(value, str) for value in asdict(token).values()):
        raise InputError(say("api-tokens-entry"))
    if token.scope not in get_args(Scope) or not re.fullmatch("[0-9a-f]{64}", token.sha256):
        raise InputError(say("api-tokens-no-scope", name=token.name))
    return token


def _why(error: Exception) -> Message | str:
    """Return what is wrong with the file; what is no list of tables with the keys of a token is no entry."""
    if isinstance(error, InputError):
        return spoken(error)
    known = isinstance(error, OSError | UnicodeDecodeError | json.JSONDecodeError)
    return reason_of(error) if known else say("api-tokens-entry")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
