"""What the operator says of the next panels before they are pressed, and the recipes to choose from.

It stays for every pressing until it is changed, as a recipe does; only the start temperature is that of one panel
and is used once. A run that began before it was said is not touched by it. Each function works in one transaction.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update

from daq.records import InputError
from daq.store.convert import header_of, header_text, known_utc, unix_of
from daq.store.records import NextPanel
from daq.store.schema import NEXT_PANEL, RECIPE
from daq.words import say

RECIPE_KEY = "recipe"
"""Header key with the name of the recipe a run was pressed by."""
ONCE = "panel.initial_temperature_C"


def next_panel(connection: Connection, press: str) -> NextPanel | None:
    """Return what is said of the next panel of a press, None where nothing is."""
    row = connection.execute(select(NEXT_PANEL).where(NEXT_PANEL.c.press == press)).first()
    if row is None:
        return None
    return NextPanel(row.press, known_utc(row.unix_s), row.who, row.recipe, header_of(row.header_toml))


def put_next_panel(connection: Connection, press: str, header: Mapping[str, Any], recipe: str, who: str) -> None:
    """Say what the next panels of a press are; a recipe given with header keys is kept under its name.

    Raises
    ------
    InputError
        For a recipe without header keys that is not known.
    """
    kept = recipes(connection)
    if recipe and not header:
        if recipe not in kept:
            raise InputError(say("recipe-unknown", recipe=recipe, known=tuple(kept)))
        header = kept[recipe]
    elif recipe:
        lasting = {key: value for key, value in header.items() if key != ONCE}
        connection.execute(delete(RECIPE).where(RECIPE.c.name == recipe))
        connection.execute(insert(RECIPE), {"name": recipe, "header_toml": header_text(lasting)})
    connection.execute(delete(NEXT_PANEL).where(NEXT_PANEL.c.press == press))
    if not header:
        return
    now = unix_of(datetime.now(UTC))
    row = {"press": press, "unix_s": now, "who": who, "recipe": recipe, "header_toml": header_text(header)}
    connection.execute(insert(NEXT_PANEL), row)


def recipes(connection: Connection) -> dict[str, dict[str, Any]]:
    """Return the header keys of all recipes by name."""
    rows = connection.execute(select(RECIPE).order_by(RECIPE.c.name)).all()
    return {row.name: header_of(row.header_toml) for row in rows}


def take_next_panel(connection: Connection, press: str, noticed_unix_s: float) -> dict[str, Any]:
    """Return the header keys a run of a press begins with; what holds for one panel is forgotten.

    A panel noticed in the press before they were said is another one: its scans may have waited for the store.
    """
    said = next_panel(connection, press)
    if said is None or unix_of(said.utc) > noticed_unix_s:
        return {}
    lasting = {key: value for key, value in said.header.items() if key != ONCE}
    if len(lasting) < len(said.header):
        changed = update(NEXT_PANEL).where(NEXT_PANEL.c.press == press)
        connection.execute(changed.values(header_toml=header_text(lasting)))
    return {**said.header, **({RECIPE_KEY: said.recipe} if said.recipe else {})}
