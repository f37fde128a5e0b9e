"""Presses in the store, the layouts of their channels, and a view of each for any SQL tool."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal

from sqlalchemy import Connection, func, insert, select, text, update

from daq.records import Channel
from daq.store.convert import unix_of
from daq.store.records import PressGone, PressKey
from daq.store.schema import LAYOUT, PRESS, RUN, SCAN
from daq.words import say

Kind = Literal["recorded", "imported"]


def register_press(
    connection: Connection, name: str, channels: Sequence[Channel], press_file: str = "", kind: Kind = "recorded"
) -> PressKey:
    """Return the press's key, made or brought up to date."""
    now = unix_of(datetime.now(UTC))
    row = connection.execute(select(PRESS).where(PRESS.c.name == name, PRESS.c.kind == kind)).first()
    if row is None:
        press_id = inserted(connection, PRESS, name=name, kind=kind, press_file=press_file, created_unix_s=now)
    else:
        press_id = int(row.press_id)
        if press_file and press_file != row.press_file:
            connection.execute(update(PRESS).where(PRESS.c.press_id == press_id).values(press_file=press_file))
    layout_id = (
        layout_of(connection, press_id, channels)
        if kind == "recorded"
        else _layout(connection, press_id, channels, now)
    )
    return PressKey(press_id, name, layout_id, tuple(channels), _next_number(connection, press_id))


def layout_of(connection: Connection, press_id: int, channels: Sequence[Channel]) -> int:
    """Return the number of a recorded press's layout, made where it is new; the press's view shows it."""
    layout_id = _layout(connection, press_id, channels, unix_of(datetime.now(UTC)))
    _make_view(connection, press_id, layout_id, channels)
    return layout_id


def with_layouts(connection: Connection, keys: Iterable[PressKey]) -> dict[PressKey, PressKey]:
    """Return keys by themselves with the layouts their channels have in the store now, made where they lack.

    A store that went back to an older state may lack a layout, or have given its number to another press.
    """
    asked = dict.fromkeys(keys)
    ids = {key.press_id for key in asked}
    newest = select(func.max(LAYOUT.c.layout_id), LAYOUT.c.press_id, LAYOUT.c.columns_json)
    grouped = newest.where(LAYOUT.c.press_id.in_(ids)).group_by(LAYOUT.c.press_id, LAYOUT.c.columns_json)
    there = {(press_id, columns): number for number, press_id, columns in connection.execute(grouped)}
    found = {}
    for key in asked:
        number = there.get((key.press_id, _columns(key.channels)))
        if number is None:
            number = layout_of(connection, key.press_id, key.channels)
        found[key] = replace(key, layout_id=number)
    return found


def _columns(channels: Sequence[Channel]) -> str:
    return json.dumps([[c.name, c.unit] for c in channels], ensure_ascii=False)


def _layout(connection: Connection, press_id: int, channels: Sequence[Channel], now: float) -> int:
    columns = _columns(channels)
    same = select(func.max(LAYOUT.c.layout_id)).where(
        LAYOUT.c.press_id == press_id, LAYOUT.c.columns_json == columns
    )
    found = connection.execute(same).scalar()
    if found is not None:
        return int(found)
    return inserted(connection, LAYOUT, press_id=press_id, columns_json=columns, created_unix_s=now)


def _next_number(connection: Connection, press_id: int) -> int:
    scan = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == press_id)).scalar()
    run = connection.execute(select(func.max(RUN.c.last_scan)).where(RUN.c.press_id == press_id)).scalar()
    return max(-1 if scan is None else scan, -1 if run is None else run) + 1


def _make_view(connection: Connection, press_id: int, layout_id: int, channels: Sequence[Channel]) -> None:
    """Make ``scan_of_<press>``: the newest layout's scans under real channel names, for any SQL tool."""
    view = _quoted(_view_name(connection, press_id))
    if connection.dialect.name == "sqlite":
        values = [f"json_extract(readings, '$[{i}]')" for i in range(len(channels))]
        utc = "strftime('%Y-%m-%dT%H:%M:%fZ', unix_s, 'unixepoch')"
    else:
        values = [f"(readings::json ->> {i})::double precision" for i in range(len(channels))]
        utc = "to_timestamp(unix_s) AT TIME ZONE 'UTC'"
    plain = [c.name + ("_celsius" if c.unit == "C" else "") for c in channels]
    titles = _distinct(plain, range(len(plain)), _OWN_COLUMNS)
    named = [f"{value} AS {_quoted(title)}" for title, value in zip(titles, values, strict=True)]
    columns = ", ".join([*_OWN_COLUMNS[:1], f"{utc} AS utc", "monotonic_s", *named, "faults"])
    connection.execute(text(f"DROP VIEW IF EXISTS {view}"))
    body = f"CREATE VIEW {view} AS SELECT {columns} FROM scan"
    connection.exec_driver_sql(
        f"{body} WHERE press_id = {press_id} AND layout_id = {layout_id}".replace("%", "%%")
        if connection.dialect.name == "postgresql"
        else f"{body} WHERE press_id = {press_id} AND layout_id = {layout_id}"
    )


_OWN_COLUMNS = ("number", "utc", "monotonic_s", "faults")
_LONGEST_NAME = 63
"""A server cuts longer names off without a word. [bytes] (PostgreSQL, NAMEDATALEN - 1)"""


def _view_name(connection: Connection, press_id: int) -> str:
    """Return the name of a press's view; of presses an engine takes for the same the first has the plain one."""
    recorded = select(PRESS.c.press_id, PRESS.c.name).where(PRESS.c.kind == "recorded").order_by(PRESS.c.press_id)
    rows = connection.execute(recorded).all()
    names = _distinct([_plain(row.name) for row in rows], [row.press_id for row in rows])
    place = [row.press_id for row in rows].index(press_id)
    return names[place]


def _plain(press: str) -> str:
    return "scan_of_" + "".join(c if c.isalnum() else "_" for c in press)


def _distinct(names: Sequence[str], numbers: Sequence[int], taken: Sequence[str] = ()) -> list[str]:
    """Return names that differ for every engine from one another and those taken; an earlier one stays plain."""
    used, distinct = set(taken), []
    for name, number in zip(names, numbers, strict=True):
        tries = itertools.chain([""], (f"_{number}" + "_" * more for more in itertools.count()))
        short = next(one for ending in tries if (one := _cut(name, ending)).casefold() not in used)
        used.add(short.casefold())
        distinct.append(short)
    return distinct


def _cut(name: str, ending: str = "") -> str:
    """Return a name with an ending, no longer than an engine keeps."""
    room = _LONGEST_NAME - len(ending.encode())
    return name.encode()[:room].decode("utf-8", "ignore") + ending


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def newest_of(connection: Connection, keys: Iterable[PressKey], store: str) -> dict[str, int]:
    """Return the number of the newest scan the store has of each press, by its name; -1 without one.

    Raises `PressGone` for those it does not have under that number and name: it may have another press under the
    number. `store` is for its message.
    """
    asked_for = list(dict.fromkeys(keys))
    if not asked_for:
        return {}
    newest = select(func.max(SCAN.c.number)).where(SCAN.c.press_id == PRESS.c.press_id).scalar_subquery()
    numbers = {key.press_id for key in asked_for}
    asked = select(PRESS.c.press_id, PRESS.c.name, newest.label("newest")).where(PRESS.c.press_id.in_(numbers))
    rows = {int(row.press_id): row for row in connection.execute(asked)}
    gone = [key for key in asked_for if key.press_id not in rows or rows[key.press_id].name != key.name]
    if gone:
        raise PressGone(say("store-press-gone", store=store, press=gone[0].name), gone)
    return {row.name: -1 if row.newest is None else int(row.newest) for row in rows.values()}


def inserted(connection: Connection, table: Any, **values: Any) -> int:
    """Insert a row; return its key."""
    key = connection.execute(insert(table), values).inserted_primary_key
    if key is None:
        raise AssertionError("insert gave no key")
    return int(key[0])
