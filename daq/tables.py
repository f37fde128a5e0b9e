"""Tables that people write: TOML read within limits, unknown keys met with the nearest known one, faults in words.

One place for what configuration, press file, mapping, profile, calibration file and run header have in common.
"""

from __future__ import annotations

import difflib
import errno
import json
import os
import re
import socket
import sqlite3
import tomllib
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from daq.address import SECRET, hidden, masked
from daq.records import InputError
from daq.words import Message, say, spoken

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

DEEPEST = 16
"""Tables and lists within one another. Ours reach 5; Python's own reader gives up near 1000. (By hand, 2026-11)"""
MOST_DIGITS = 300
"""Of a whole number: longer ones are no number to a computer. (The largest of 64 bits is 1.8e308, IEEE 754)"""
LARGEST_BYTES = 1 << 24
"""Of a file that people write, and of a line: ours have some 20 kB; a wrong file, or a device, may have no end.
(By hand)"""
_LONG_NUMBER = re.compile(rf"[0-9][0-9_]{{{MOST_DIGITS},}}")
_DIGITS = re.compile(r"_?[0-9]+")
_UNSEEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Kinds of characters that nobody sees, or that turn their neighbours round. (Unicode Standard Annex 44)"""
_JOINERS = "\u200c\u200d"
"""Of these, those that shape the letters beside them, as in Persian. (Join_Control; Unicode Standard Annex 31)"""
_TYPING_SLIPS = 2
"""Letters by which a mistyped key differs, at most: one swapped pair, or one wrong and one missing."""


def at(place: object, what: Message, *, line: int | None = None, column: str | None = None) -> Message:
    """Return a message with the place it is about: a file or a port, and its line and column where known."""
    if column is not None:
        what = say("at-column", column=column, what=what)
    if line is not None:
        what = say("at-line", line=line, what=what)
    return say("at-place", place=place if isinstance(place, Message) else str(place), what=what)


def read_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text. Raises `InputError` with the reason, without the file."""
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_no_toml(text, str(error))) from error
    except ValueError as error:  # Python converts no integer of more than 4300 digits
        raise InputError(_too_long(text)) from error
    except RecursionError as error:
        raise InputError(say("toml-too-deep", deepest=DEEPEST)) from error
    for depth, value in _values(tree):
        if depth > DEEPEST:
            raise InputError(say("toml-too-deep", deepest=DEEPEST))
        if isinstance(value, int) and abs(value) >= 10**MOST_DIGITS:
            raise InputError(_too_long(text))
    return tree


def _no_toml(text: str, reason: str) -> Message:
    """Return what is wrong with a text that Python's reader refused: where, and whether something stands twice."""
    at = re.search(r"\(at line ([0-9]+), column ([0-9]+)\)$", reason)
    lines = text.split("\n")
    line, column = (int(at[1]), int(at[2])) if at else (len(lines), len(lines[-1]) + 1)
    if reason.startswith(("Cannot declare", "Cannot overwrite", "Cannot redefine", "Duplicate")):
        return say("toml-twice", line=line)
    return say("toml-invalid", line=line, column=column)


def text_in(path: Path) -> str:
    """Return what stands in a file that people write.

    Raises
    ------
    OSError
        Also for more than `LARGEST_BYTES`.
    UnicodeDecodeError
        For what is not UTF-8.
    """
    with path.open("rb") as file:
        found = file.read(LARGEST_BYTES + 1)
    if len(found) > LARGEST_BYTES:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    return found.decode().replace("\r\n", "\n").replace("\r", "\n")


def read_json(text: str) -> Any:
    """Return what a JSON text says. Raises `InputError` with the reason, without the file."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(reason_of(error)) from error
    except RecursionError as error:
        raise InputError(say("toml-too-deep", deepest=DEEPEST)) from error
    except ValueError as error:  # Python converts no integer of more than 4300 digits
        raise InputError(_too_long(text)) from error


def load_toml(path: Path, what: Message) -> dict[str, Any]:
    """Read a TOML file. Raises `InputError` naming it; `what` says which kind of file it should be."""
    try:
        return read_toml(text_in(path))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(at(path, say("file-cannot-read", what=what, reason=reason_of(error)))) from error
    except InputError as error:
        raise InputError(at(path, spoken(error))) from error


SYSTEM_FAULTS = {
    errno.EACCES: "system-not-allowed",
    errno.EADDRINUSE: "system-address-in-use",
    errno.EBUSY: "system-busy",
    errno.ECONNREFUSED: "system-connection-refused",
    errno.ECONNRESET: "system-connection-reset",
    errno.EHOSTUNREACH: "system-no-route",
    errno.EIO: "system-input-output",
    errno.ENETUNREACH: "system-no-network",
    errno.ENODEV: "system-no-such-device",
    errno.EPIPE: "system-broken-pipe",
    errno.ETIMEDOUT: "system-timed-out",
    errno.EADDRNOTAVAIL: "system-address-not-here",
    errno.EEXIST: "system-exists-already",
    errno.EFBIG: "system-too-large",
    errno.EISDIR: "system-is-a-folder",
    errno.ENAMETOOLONG: "system-name-too-long",
    errno.ENOENT: "system-no-such-file",
    errno.ENOSPC: "system-disk-full",
    errno.ENOTDIR: "system-not-a-folder",
    errno.EPERM: "system-not-allowed",
    errno.EROFS: "system-read-only",
}
"""Why the system does not do what it is asked, by its number for it."""
DATABASE_FAULTS = {
    sqlite3.SQLITE_BUSY: "database-busy",
    sqlite3.SQLITE_CANTOPEN: "database-not-opened",
    sqlite3.SQLITE_CORRUPT: "database-damaged",
    sqlite3.SQLITE_FULL: "database-full",
    sqlite3.SQLITE_IOERR: "database-disk-failed",
    sqlite3.SQLITE_LOCKED: "database-busy",
    sqlite3.SQLITE_NOTADB: "database-none",
    sqlite3.SQLITE_READONLY: "database-read-only",
}
"""Why SQLite does not do what it is asked, by its number for it."""
LIBRARY_FAULTS = {
    "unexpected end of data": "csv-quotation-open",
    "expected after": "csv-quotation-followed",
    "field larger than": "csv-cell-too-long",
    "new-line character": "csv-line-end",
    "Parquet file size is": "parquet-none",
    "Parquet magic bytes": "parquet-none",
    "CRC checksum": "parquet-page-damaged",
}
"""Why the readers of CSV and Parquet do not read a file, by a part of their words for it: they have no numbers."""


def reason_of(error: Exception) -> Message | str:
    """Return why something was not read or done: no UTF-8, no JSON, or what system, database or library answered.

    What stands in none of the tables above comes in its own words, so in English.
    """
    if isinstance(error, sqlite3.Error) and hasattr(error, "sqlite_errorcode"):
        code = DATABASE_FAULTS.get(error.sqlite_errorcode & 0xFF)
        return Message(code, {}) if code else str(error)
    if isinstance(error, socket.gaierror):
        return say("system-name-unknown")
    if isinstance(error, OSError):
        known = SYSTEM_FAULTS.get(errno.ETIMEDOUT if isinstance(error, TimeoutError) else error.errno or 0)
        return Message(known, {}) if known else error.strerror or str(error) or type(error).__name__
    for part, code in LIBRARY_FAULTS.items():
        if part in str(error):
            return Message(code, {})
    if isinstance(error, UnicodeDecodeError):
        return say("at-line", line=error.object.count(b"\n", 0, error.start) + 1, what=say("run-not-utf8"))
    if isinstance(error, json.JSONDecodeError):
        return say("json-invalid", line=error.lineno, column=error.colno)
    several = not isinstance(error, InputError) and "\n" in str(error)
    return str(error).partition("\n")[0] if several else spoken(error)


def unseen(name: str) -> bool:
    r"""Whether a name holds characters that nobody sees: it is compared, and typed again from what is seen.

    >>> unseen("lab\u200b-1"), unseen("\u202e1-bal"), unseen("Prüfung 7 (Süd)"), unseen("تخته\u200cها")
    (True, True, False, False)
    """
    return any(unicodedata.category(one) in _UNSEEN for one in name if one not in _JOINERS)


def nearest(key: str, known: Iterable[str]) -> str | None:
    """Return the known key that `key` was most likely meant to be: a slip of typing away, or without its unit.

    Keys that differ in digits alone are two keys.

    >>> known = ("panel.thickness_mm", "panel.density_kg_m3", "setting.platen_temperature_C")
    >>> nearest("panel.thicknes_mm", known), nearest("panel.density", known), nearest("panel.supplier", known)
    ('panel.thickness_mm', 'panel.density_kg_m3', None)
    >>> nearest("setting.platen_temperature_top_C", known)
    """
    spelt = {one.lower(): one for one in known if one != key}
    low = key.lower()
    for close in difflib.get_close_matches(low, spelt, n=3):
        letters, others = _DIGITS.sub("", low), _DIGITS.sub("", close)
        if (letters != others or low == close) and _slips(low, close) <= min(_TYPING_SLIPS, len(letters) // 4):
            return spelt[close]
    return next((full for short, full in spelt.items() if short.startswith(f"{low}_")), None)


def nearest_first(key: str, known: Iterable[str]) -> tuple[str, ...]:
    """Return what is known, what looks most like `key` first.

    >>> nearest_first("chipbord", ("MDF", "particleboard", "chipboard"))
    ('chipboard', 'particleboard', 'MDF')
    """
    return tuple(sorted(known, key=lambda one: -difflib.SequenceMatcher(None, key.lower(), one.lower()).ratio()))


def unknown_key(key: str, known: Iterable[str]) -> Message:
    """Return the message for a key that is refused, with the key that was meant where one is near."""
    meant = nearest(key, known)
    return say("key-unknown") if meant is None else say("key-unknown-meant", meant=meant)


def explained(error: ValidationError, model: type[BaseModel]) -> Message:
    """Return in one line what is wrong with a table: key, value, limit, and the key that was meant."""
    items = error.errors()
    own = [item for item in items if item["type"] != "too_short"]
    found = dict.fromkeys(_fault(item, model) for item in (own or items)[:3])
    return _joined(tuple(found))


def _joined(faults: tuple[Message, ...]) -> Message:
    first, *rest = faults
    return first if not rest else say("fault-and-more", first=first, rest=_joined(tuple(rest)))


_BRANCHES = ("At", "bool", "float", "int", "str")
_WRAPPED = ("function-", "constrained-", "tuple[")
"""What pydantic puts among keys for a value that may be of several kinds: no key of anybody's file."""


def _fault(item: Any, model: type[BaseModel]) -> Message:
    loc = [str(p) for p in item["loc"] if p not in _BRANCHES and not str(p).startswith(_WRAPPED)]
    key, value, kind = ".".join(loc), item.get("input"), item["type"]
    unknown = kind == "extra_forbidden"
    known = fields_at(model, loc[:-1]) if unknown else ()
    why = unknown_key(loc[-1], known) if unknown else why_of(item)
    if unknown and isinstance(value, str) and _holds_secrets(_table_at(model, loc[:-1])):
        return say("at-key", key=key, what=why)
    if not key:
        return why
    if kind != "missing" and isinstance(value, str | int | float | bool):
        return say("at-key-value", key=key, value=_shown(value, loc), what=why)
    return say("at-key", key=key, what=why)


def _shown(value: str | int | float | bool, loc: Sequence[str]) -> str:
    """Return a value as a refusal shows it: without the secrets of an address, also under a mistyped key."""
    if not isinstance(value, str):
        return repr(value)
    return masked(repr(hidden(value) if "store" in loc else value))


def why_of(item: Any) -> Message:
    """Return what is wrong with one value, from what pydantic found; what only it has words for stays English."""
    given, kind = item.get("ctx") or {}, item["type"]
    if kind == "value_error":
        return spoken(given["error"])
    limit = next((given[name] for name in ("gt", "ge", "lt", "le") if name in given), None)
    if limit is not None:
        return say(f"limit-{kind.replace('_', '-')}", limit=float(limit))
    if kind in ("literal_error", "enum"):
        return say("key-one-of", known=str(given["expected"]))
    if code := _KINDS.get(kind):
        return say(code)
    return say("plain-text", text=item["msg"])


_KINDS = {
    "extra_forbidden": "key-unknown",
    "missing": "key-missing",
    "float_type": "key-no-number",
    "float_parsing": "key-no-number",
    "int_type": "key-no-whole-number",
    "int_parsing": "key-no-whole-number",
    "int_from_float": "key-no-whole-number",
    "finite_number": "key-not-finite",
    "string_type": "key-no-text",
    "bool_type": "key-no-bool",
    "bool_parsing": "key-no-bool",
    "string_too_short": "key-empty",
    "too_short": "key-empty",
    "model_type": "key-no-table",
    "dict_type": "key-no-table",
    "tuple_type": "key-no-list",
    "datetime_type": "key-no-instant",
    "datetime_parsing": "key-no-instant",
    "datetime_from_date_parsing": "key-no-instant",
}
"""What pydantic finds wrong, by its own name, to the code of ours; anything else keeps its English."""


def fields_at(model: type[BaseModel], path: Iterable[str]) -> tuple[str, ...]:
    """Return the keys a table may hold, by its place in the tables of a model; empty where the keys are free."""
    here = _table_at(model, path)
    return () if here is None else tuple(field.alias or name for name, field in here.model_fields.items())


def _holds_secrets(model: type[BaseModel] | None) -> bool:
    """Whether a text under a key that nothing knows may be a secret: a key of its table leads to one."""
    return model is not None and any(SECRET in field.metadata for field in model.model_fields.values())


def _table_at(model: type[BaseModel], path: Iterable[str]) -> type[BaseModel] | None:
    here: type[BaseModel] | None = model
    for key in path:
        if here is None:
            return None
        names = {field.alias or name: field.annotation for name, field in here.model_fields.items()}
        if key in names:
            here = _model_in(names[key])  # a number or a free name stays in the table it chooses from
    return here


def _model_in(annotation: Any) -> type[BaseModel] | None:
    from pydantic import BaseModel

    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_in(part))), None)


def _slips(one: str, other: str) -> int:
    """Return by how many letters two keys differ."""
    changes = difflib.SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
    return sum(max(i2 - i1, j2 - j1) for tag, i1, i2, j1, j2 in changes if tag != "equal")


def _values(tree: Mapping[str, Any]) -> Iterator[tuple[int, Any]]:
    """Yield depth and value of everything in nested tables and lists, without recursion."""
    waiting: list[tuple[int, Any]] = [(0, tree)]
    while waiting:
        depth, value = waiting.pop()
        yield depth, value
        inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
        if depth <= DEEPEST:
            waiting += [(depth + 1, one) for one in inner]


def _too_long(text: str) -> Message:
    found = _LONG_NUMBER.search(text)
    line = text.count("\n", 0, found.start()) + 1 if found else 1
    return say("at-line", line=line, what=say("toml-integer-too-long", digits=MOST_DIGITS))
