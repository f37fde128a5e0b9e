"""Addresses that may hold a password: whoever prints one prints none."""

from __future__ import annotations

import re
import tomllib
from urllib.parse import unquote, unquote_plus


class Address(str):
    """A database's address; printed, formatted or shown by `repr` it hides password and query."""

    __slots__ = ()

    def __str__(self) -> str:
        """Return it without its secrets."""
        return hidden(self)

    def __repr__(self) -> str:
        """Return it without its secrets."""
        return repr(hidden(self))

    def __format__(self, specification: str) -> str:
        """Format it without its secrets."""
        return format(hidden(self), specification)


def hidden(address: str) -> str:
    """Return an address without password and query; a path stays as it is.

    >>> hidden("postgresql://eva:a b@db.plant/kerntemp?password=x")
    'postgresql://eva:***@db.plant/kerntemp?***'
    """
    address = str.__str__(address)
    scheme, mark, rest = address.partition("://")
    if not mark or scheme.startswith("sqlite"):
        return address
    before, query, _ = rest.partition("?")
    if query and ("@" in before or re.fullmatch(r"[\w.-]*(:\d+)?(/[\w.-]*)?", before)):
        rest = before + "?***"
    who, at, place = rest.rpartition("@")
    user, colon, _ = who.partition(":")
    return f"{scheme}://{user}{':***' if colon else ''}{at}{place}"


def secrets_of(address: str) -> set[str]:
    """Return what an address holds that nobody may see: the password, and what its query says."""
    address = str.__str__(address)
    _, mark, rest = address.partition("://")
    if hidden(address) == address or not mark:
        return set()
    secrets = {value for part in rest.partition("?")[2].split("&") if (value := part.partition("=")[2])}
    password = rest.rpartition("@")[0].partition(":")[2]
    written = {password, *secrets}
    return {one for one in {*written, *map(unquote, written), *map(unquote_plus, written)} if len(one) > 2}


def text_without(text: str, address: str) -> str:
    """Return a TOML text without the secrets of an address in it, however it is written there."""
    if hidden(address) == address:
        return text
    text = text.replace(str.__str__(address), hidden(address))
    for secret in sorted(secrets_of(address), key=len, reverse=True):
        text = text.replace(secret, "***")
    if _store_url(text) == str.__str__(address):  # written with escapes
        text = re.sub(r"(?m)^(\s*url\s*=).*$", rf'\1 "{hidden(address)}"', text)
    return "" if _store_url(text) == str.__str__(address) else text


def _store_url(text: str) -> str:
    try:
        return str(tomllib.loads(text).get("store", {}).get("url", ""))
    except tomllib.TOMLDecodeError:
        return ""
