"""What the operator says of the next panels before they are pressed, and the recipes to choose from.

It stays for every pressing until it is changed, as a recipe does; only the start temperature is that of one panel
and is used once. A run that began before is not touched by it. Each function works in one transaction.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update

from daq.press.header import lasting_keys
from daq.records import InputError
from daq.store.convert import header_text, known_utc, unix_of
from daq.store.journal import log
from daq.store.records import NextPanel, ScansUnreadable
from daq.store.schema import NEXT_PANEL, RECIPE
from daq.store.sound_rows import printable, rows_with_damage, sound_header, store_label
from daq.words import Message, say, spoken

PROCESS = "record"

RECIPE_KEY = "recipe"
"""Header key with the name of the recipe a run was pressed by."""


def next_panel(connection: Connection, press: str) -> NextPanel | None:
    """Return what is stated of the next panel of a press, None where nothing is."""
    rows = rows_with_damage(connection, select(NEXT_PANEL).where(NEXT_PANEL.c.press == press))
    if not rows:
        return None
    (row,) = rows
    damaged = say("panel-next-damaged", press=press, store=store_label(connection.engine.url))
    header = _header(damaged, row.header_toml, row.recipe)
    return NextPanel(press, known_utc(row.unix_s), printable(row.who), row.recipe, header)


def put_next_panel(connection: Connection, press: str, header: Mapping[str, Any], recipe: str, who: str) -> None:
    """Say what the next panels of a press are; a recipe given with header keys is kept under its name.

    Raises
    ------
    InputError
        For a recipe without header keys that is not known.
    """
    if recipe and not header:
        kept = recipes(connection)
        if recipe not in kept:
            raise InputError(say("recipe-unknown", recipe=recipe, known=tuple(kept)))
        header = kept[recipe]
    elif recipe:
        lasting = lasting_keys(header)
        connection.execute(delete(RECIPE).where(RECIPE.c.name == recipe))
        connection.execute(insert(RECIPE), {"name": recipe, "header_toml": header_text(lasting)})
    connection.execute(delete(NEXT_PANEL).where(NEXT_PANEL.c.press == press))
    if not header:
        return
    now = unix_of(datetime.now(UTC))
    row = {"press": press, "unix_s": now, "who": who, "recipe": recipe, "header_toml": header_text(header)}
    connection.execute(insert(NEXT_PANEL), row)


def recipes(connection: Connection) -> dict[str, dict[str, Any]]:
    """Return the header keys of all recipes by name; raises `ScansUnreadable` where one is damaged."""
    kept, store = {}, store_label(connection.engine.url)
    for row in rows_with_damage(connection, select(RECIPE).order_by(RECIPE.c.name)):
        damaged = say("recipe-damaged", recipe=printable(row.name), store=store)
        kept[row.name] = _header(damaged, row.header_toml, row.name)
    return kept


def _header(damaged: Message, text: str, name: str) -> dict[str, Any]:
    """Return header keys as they were stated; raises `ScansUnreadable` where they or the name are damaged."""
    header = sound_header(text, name)
    if header is None:
        raise ScansUnreadable(damaged)
    return header


def take_next_panel(connection: Connection, press: str, noticed_unix_s: float) -> dict[str, Any]:
    """Return the header keys a run of a press begins with; what holds for one panel is forgotten.

    A panel noticed in the press before they were stated is another one: its scans may have waited for the store.
    Where they cannot be read any more the run begins without them, and an alarm says so.
    """
    try:
        stated = next_panel(connection, press)
    except ScansUnreadable as error:
        log(connection, "alarm", PROCESS, spoken(error), press, None)
        return {}
    if stated is None or unix_of(stated.utc) > noticed_unix_s:
        return {}
    lasting = lasting_keys(stated.header)
    if len(lasting) < len(stated.header):
        changed = update(NEXT_PANEL).where(NEXT_PANEL.c.press == press)
        connection.execute(changed.values(header_toml=header_text(lasting)))
    return {**stated.header, **({RECIPE_KEY: stated.recipe} if stated.recipe else {})}
