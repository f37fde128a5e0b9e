"""What the store keeps of a run's header, and who changed it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, insert, select, update

from daq.records import InputError
from daq.store.convert import header_of, header_text, known_utc, null, unix_of
from daq.store.origin import REMARK
from daq.store.reading import run_row
from daq.store.records import RunChange
from daq.store.schema import RUN, RUN_CHANGE
from daq.store.sound_rows import stored_header
from daq.words import say


def header_columns(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the row of a run has of its header."""
    thickness = header.get("panel.thickness_mm")
    material = header.get("panel.material")
    return {
        "panel_material": None if material is None else str(material),
        "panel_thickness_mm": null(thickness) if isinstance(thickness, int | float) else None,
        "header_toml": header_text({key: value for key, value in header.items() if key != REMARK}),
        "remark": str(header.get(REMARK, "")),
        "software_version": software_version(),
    }


def software_version() -> str:
    """Return the installed version, for the record."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("kerntemp")
    except PackageNotFoundError:
        return "uninstalled"


def annotate_run(connection: Connection, run: str, changes: Mapping[str, Any], who: str) -> None:
    """Change header keys (``panel.density_kg_m3``) or ``remark``; None removes a key. History is kept.

    Raises `InputError` where there is no such run, `ScansUnreadable` where its header is damaged.
    """
    row = run_row(connection, run)
    header, remark = stored_header(connection, row), row.remark
    if "run" in changes:
        raise InputError(say("store-run-renamed", run=run))
    now = unix_of(datetime.now(UTC))
    for field, after in changes.items():
        before = remark if field == "remark" else header.get(field)
        if field == "remark":
            remark = str(after)
        elif after is None:
            header.pop(field, None)
        else:
            header[field] = after
        connection.execute(
            insert(RUN_CHANGE),
            {
                "run": run,
                "unix_s": now,
                "who": who,
                "field": field,
                "before_toml": None if before is None else header_text({"value": before}),
                "after_toml": None if after is None else header_text({"value": after}),
            },
        )
    columns = {k: v for k, v in header_columns(header).items() if k != "software_version"}
    connection.execute(update(RUN).where(RUN.c.run == run).values({**columns, "remark": remark}))


def run_changes(connection: Connection, run: str) -> list[RunChange]:
    """Return the edits of a run's metadata, oldest first."""
    rows = connection.execute(
        select(RUN_CHANGE).where(RUN_CHANGE.c.run == run).order_by(RUN_CHANGE.c.run_change_id)
    ).all()
    return [
        RunChange(known_utc(r.unix_s), r.who, r.field, _value(r.before_toml), _value(r.after_toml)) for r in rows
    ]


def _value(content: str | None) -> Any:
    return None if content is None else header_of(content).get("value")
