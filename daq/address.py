"""Addresses that may hold a password: whoever prints one prints none."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_plus

SECRET = "secret"
"""Annotates a key of a table that holds a secret, or names a file with one: its table's wrong keys may, too."""
_HIDDEN = "***"
_USER = re.compile(r"(\w:/+[^:@\n]*):[^\n]*@")
"""A user and what follows up to the line's last ``@``: a password may hold any sign, an ``@`` too."""
_PASSWORD = re.compile(r"(?i)((?:passw(?:or)?d|passphrase|pwd)[\"']?\s*=\s*)[^\n]+")
_BARE = re.compile(r"([^\s:@/=]+):\S*@(\S+)")
"""An address without its scheme, and nothing else."""
_BEHIND = re.compile(r"(?i)password=([^&;]+)")
_OF_AN_ADDRESS = re.compile(r"(?i)@|:$|\b(passw(or)?d|user|host(addr)?|dbname|service)\s*=")
"""What a part of a path holds where it was meant to be a server's address."""


class Address:
    """A database's address. It is no text: only `revealed` gives what it hides."""

    __slots__ = ("_whole",)

    def __init__(self, whole: str | Address) -> None:
        self._whole: str = whole.revealed() if isinstance(whole, Address) else whole

    def revealed(self) -> str:
        """Return all of it, for the connection alone: it may hold a password."""
        return self._whole

    @property
    def mistyped(self) -> bool:
        """Whether it is neither a URL nor a path, but what was meant to be a server's address."""
        return "://" not in self._whole and _mistyped(self._whole)

    def beside(self, folder: Path) -> Address:
        """Return a path as it is seen from a folder, a URL as it is."""
        return self if "://" in self._whole else Address(str(folder / Path(self._whole).expanduser()))

    def __str__(self) -> str:
        """Return it without its secrets."""
        return hidden(self._whole)

    def __repr__(self) -> str:
        """Return it without its secrets."""
        return f"Address({hidden(self._whole)!r})"

    def __eq__(self, other: object) -> bool:
        """Compare all of it, also with a text."""
        return isinstance(other, str | Address) and self._whole == Address(other).revealed()

    def __hash__(self) -> int:
        """Hash as the text it is equal to."""
        return hash(self._whole)

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: type, _handler: Callable[[Any], Any]) -> Any:
        """Read it from a text; in JSON it stands without its secrets."""
        from pydantic_core import core_schema

        written = core_schema.to_string_ser_schema()
        text = core_schema.str_schema(min_length=1)
        return core_schema.no_info_after_validator_function(cls, text, serialization=written)


def hidden(address: str) -> str:
    """Return an address without password and query; a path stays as it is.

    >>> hidden("postgresql://eva:a b@db.plant/kerntemp?password=x")
    'postgresql://eva:***@db.plant/kerntemp?***'
    """
    scheme, mark, rest = address.partition("://")
    if not mark:
        return _HIDDEN if _mistyped(address) else address
    if not re.fullmatch(r"[\w+.-]*", scheme):
        return _HIDDEN
    if scheme.startswith("sqlite"):
        return f"{scheme}://{_HIDDEN}" if "@" in rest and not rest.startswith("/") else address
    before, query, after = rest.partition("?")
    if "@" in after:  # in a password before it or in one behind it: nobody can know
        return f"{scheme}://{_HIDDEN}"
    who, at, place = before.rpartition("@")
    user, colon, _ = who.partition(":")
    return masked(f"{scheme}://{user}{':***' if colon else ''}{at}{place}{'?***' if query else ''}")


def masked(text: str) -> str:
    """Return a text without what looks like a password in it.

    >>> masked('# url = "postgresql://eva:a b@db/x"')
    '# url = "postgresql://eva:***@db/x"'
    """
    return _PASSWORD.sub(r"\1***", _USER.sub(r"\1:***@", text))


def without_secrets(text: str) -> str:
    """Return what somebody typed, or a library says, without what looks like a password in it.

    >>> without_secrets("postgresql://eva:secret@db: not found"), without_secrets("eva:secret@db/x")
    ('postgresql://eva:***@db: not found', 'eva:***@db/x')
    """
    if "@" not in text and "=" not in text:
        return text
    bare = _BARE.fullmatch(text)
    return masked(text) if bare is None else f"{bare[1]}:{_HIDDEN}@{bare[2]}"


def secrets_of(address: Address) -> set[str]:
    """Return what an address holds that nobody may see: the password, and what its query says."""
    whole = address.revealed()
    if hidden(whole) == whole:
        return set()
    rest = whole.partition("://")[2]
    written = {value for part in rest.partition("?")[2].split("&") if (value := part.partition("=")[2])}
    written |= {rest.rpartition("@")[0].partition(":")[2], *_BEHIND.findall(rest)}
    return {one for one in {*written, *map(unquote, written), *map(unquote_plus, written)} if len(one) > 2}


def text_without(text: str, address: Address) -> str:
    """Return a TOML text without an address's secrets, however written there, or others that look like one."""
    whole = address.revealed()
    if hidden(whole) == whole:
        return masked(text)
    text = text.replace(whole, hidden(whole))
    for secret in sorted(secrets_of(address), key=len, reverse=True):
        text = text.replace(secret, _HIDDEN)
    if _store_url(text) == whole:  # written with escapes
        text = re.sub(r"(?m)^(\s*url\s*=).*$", lambda found: f'{found[1]} "{hidden(whole)}"', text)
    return "" if _store_url(text) == whole else masked(text)


def _mistyped(path: str) -> bool:
    """Whether a part of a path looks like an address: its name, or a folder that is not there."""
    place = Path(path)
    suspects = [part for part in (place, *place.parents) if _OF_AN_ADDRESS.search(part.name)]
    return any(part == place or not _there(part) for part in suspects)


def _there(folder: Path) -> bool:
    try:
        return folder.is_dir()
    except OSError:
        return False


def _store_url(text: str) -> str:
    try:
        return str(tomllib.loads(text).get("store", {}).get("url", ""))
    except tomllib.TOMLDecodeError:
        return ""
