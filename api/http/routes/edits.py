"""What people write down about a run: remark and header keys, with every change kept."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictFloat, StrictInt

from api.answers.records import run_detail
from api.answers.schemas import RunDetail
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import StoreDep, Writer, existing_run
from daq.press.header import check_header, panel_of
from daq.press.press_file import SD, parse_press, press_for_run
from daq.records import InputError, Run
from daq.store.convert import header_of, header_text
from daq.store.records import RunRecord
from daq.store.store import Store
from daq.words import say

router = APIRouter(tags=["runs"], responses=problem_responses(404))

NUMBERS = ("setting.", "ambient.")
"""Header keys that begin so are numbers: fits, drift and the live sensor reckon with them."""
EXACT = 2**53
"""Whole numbers up to here are the same in JSON, TOML and a float."""


Words = Annotated[str, Field(max_length=4000, pattern=r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
"""Any text but control characters, which no database keeps and no reader sees; lines and tabs may be."""
Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*$", max_length=200)]
Value = (
    StrictBool
    | Annotated[StrictInt, Field(ge=-EXACT, le=EXACT)]
    | Annotated[StrictFloat, Field(allow_inf_nan=False)]
    | Words
)


def _as_property_names(schema: dict[str, Any]) -> None:
    """Say the keys' pattern so that a schema refuses other keys and client generators still see the values."""
    [(pattern, value)] = schema.pop("patternProperties").items()
    schema |= {"propertyNames": {"pattern": pattern, "maxLength": 200}, "additionalProperties": value}


class RunChanges(BaseModel):
    """What to change in a run; what is not named stays as it is."""

    model_config = ConfigDict(extra="forbid")

    remark: Words | None = Field(None, description="Replaces the remark; an empty text removes it.")
    header: dict[Key, Value | None] = Field(
        default_factory=dict,
        description="Header keys as in a run file, such as `panel.density_kg_m3`; null removes a key.",
        max_length=100,
        json_schema_extra=_as_property_names,
    )


@router.patch("/runs/{run}", operation_id="change_run", summary="Change a run's remark or metadata")
def change_run(store: StoreDep, run: str, changes: RunChanges, who: Writer) -> RunDetail:
    """Change what people know about a run; `changes` of the answer keeps what was there before, and by whom."""
    record = existing_run(store, run)
    known = {**record.header, "remark": record.remark}
    wanted: dict[str, Any] = dict(changes.header)
    if reserved := {"run", "remark"} & set(wanted):
        raise ProblemError(422, say("api-header-key-fixed", key=reserved.pop()))
    if changes.remark is not None:
        wanted["remark"] = changes.remark
    wanted = {key: value for key, value in wanted.items() if known.get(key) != value}
    _check(store, record, {key: value for key, value in wanted.items() if key != "remark"})
    if wanted:
        store.annotate_run(run, wanted, who)
        store.log("info", who, say("api-run-changed", run=run, fields=tuple(wanted)), record.press)
    return run_detail(store, store.run_record(run))


def _check(store: Store, record: RunRecord, wanted: Mapping[str, Any]) -> None:
    """Refuse a header that could not be read again, or that press file and panel would not take."""
    if not wanted:
        return
    merged = {**record.header, **wanted}
    header = {key: value for key, value in merged.items() if value is not None}
    for key in wanted:
        if key.startswith(NUMBERS) and isinstance(header.get(key, 0), bool | str):
            raise ProblemError(422, say("api-header-not-a-number", key=key, value=repr(header[key])))
    parent = next((a for a in header for b in header if b.startswith(f"{a}.") and b != f"{a}{SD}"), None)
    try:
        written = header_text(header)
        unreadable = parent is not None or header_text(header_of(written)) != written
    except tomllib.TOMLDecodeError:
        unreadable = True
    if unreadable:
        raise ProblemError(422, say("api-header-key-twice", key=parent or next(iter(wanted))))
    check_header({key: value for key, value in wanted.items() if value is not None}, f"run {record.run}")
    imagined = Run(record.run, header, np.zeros(0), {}, source=f"run {record.run}")
    text = store.presses().get(record.press, "")
    if text:
        press_for_run(parse_press(text, f"press {record.press}"), imagined)
    try:
        panel_of(imagined)
    except InputError:
        touched = any(key.startswith("panel.") for key in wanted)
        if touched or _has_panel(Run(record.run, record.header, np.zeros(0), {})):
            raise  # what was missing before may stay missing while something else is written down


def _has_panel(run: Run) -> bool:
    try:
        panel_of(run)
    except InputError:
        return False
    return True
