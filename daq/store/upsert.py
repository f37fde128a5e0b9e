"""Rows that may be there already, in either engine's own SQL."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from sqlalchemy import Connection, Table


def put(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    """Insert rows; a row whose key is there already takes the new values."""
    statement = _insert(connection, table)
    keys = [c.name for c in table.primary_key]
    changed = {c.name: statement.excluded[c.name] for c in table.columns if c.name not in keys}
    connection.execute(statement.on_conflict_do_update(index_elements=keys, set_=changed), list(rows))


def insert_new(connection: Connection, table: Table, row: Mapping[str, Any]) -> None:
    """Insert a row, unless one with its key is there already."""
    connection.execute(_insert(connection, table).on_conflict_do_nothing(), [dict(row)])


def _insert(connection: Connection, table: Table) -> Any:
    dialect = import_module(f"sqlalchemy.dialects.{connection.dialect.name}")  # one costs a process 0.1 s to load
    return dialect.insert(table)
