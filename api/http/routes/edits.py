"""What people write down: of a run, with every change kept, and of the next panel before there is a run."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictFloat, StrictInt

from api.answers.records import doubt_fields, run_detail
from api.answers.schemas import NextPanelNow, RunDetail, RunVerdict, Verdict
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import (
    MAX_PAGE,
    HeadersDep,
    PressName,
    StoreDep,
    Words,
    Writer,
    existing_press,
    existing_run,
)
from daq.press.detector import HAND_C
from daq.press.header import VERDICT, check_header, check_material, doubts, new_doubts, panel_of
from daq.press.press_file import SD, overridden, parse_press, press_for_run
from daq.records import InputError, Run
from daq.store.convert import header_of, header_text
from daq.store.records import RunRecord
from daq.store.store import Store
from daq.words import Message, say
from daq.words.message import LARGEST_EXACT
from softsensor.signals.doubt import nearest_of, one_product

router = APIRouter(tags=["runs"], responses=problem_responses(404))

NUMBERS = ("setting.", "ambient.")
"""Header keys that begin so are numbers: fits, drift and the live sensor reckon with them."""
THICKNESS = "panel.thickness_mm"
START = "panel.initial_temperature_C"
Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*$", max_length=200)]
Value = (
    StrictBool
    | Annotated[StrictInt, Field(ge=-LARGEST_EXACT, le=LARGEST_EXACT)]
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
    changed = store.run_record(run)
    for doubt in new_doubts(changed.header, record.header):
        store.log("warning", who, say("of-run", run=run, what=doubt), record.press)
    return run_detail(store, changed)


class VerdictChange(BaseModel):
    """What became of a panel; null takes it back."""

    model_config = ConfigDict(extra="forbid")

    verdict: Verdict | None


def _marked(run: str, verdict: Verdict | None) -> Message:
    if verdict is None:
        return say("api-panel-unmarked", run=run)
    return say("api-panel-marked", run=run, verdict=Message(f"page-panel-{verdict}"))


@router.get("/runs/{run}/verdict", operation_id="get_verdict", summary="What became of the panel")
def get_verdict(store: StoreDep, run: str) -> RunVerdict:
    """Return what became of a panel, who said so last, and when; null where nobody has."""
    record = existing_run(store, run)
    changes = [change for change in store.run_changes(run) if change.field == VERDICT]
    last = changes[-1] if changes else None
    verdict = record.header.get(VERDICT)
    return RunVerdict(run=run, verdict=verdict, who=last.who if last else None, utc=last.utc if last else None)


@router.put("/runs/{run}/verdict", operation_id="put_verdict", summary="Say what became of the panel")
def put_verdict(store: StoreDep, run: str, change: VerdictChange, who: Writer) -> RunVerdict:
    """Mark a panel good, blistered, undercured or scrap. It is kept with the run, in its files and its history."""
    record = existing_run(store, run)
    if record.header.get(VERDICT) != change.verdict:
        store.annotate_run(run, {VERDICT: change.verdict}, who)
        store.log("info", who, _marked(run, change.verdict), record.press)
    return get_verdict(store, run)


class NextPanelChange(BaseModel):
    """What the next panels are: a recipe's name, header keys, or both to keep them under that name."""

    model_config = ConfigDict(extra="forbid")

    recipe: Annotated[Words, Field(max_length=100)] = ""
    header: dict[Key, Value] = Field(
        default_factory=dict,
        description="Header keys as in a run file, such as `panel.thickness_mm`, `setting.core_target_C`.",
        max_length=100,
        json_schema_extra=_as_property_names,
    )


@router.get("/press/next", operation_id="get_next_panel", summary="The next panel's data and recipe")
def get_next_panel(store: StoreDep, press: PressName = None) -> NextPanelNow:
    """Return what is said of the panels to come at a press, and the recipes to choose from."""
    return _next_panel(store, _one_press(store, press))[0]


@router.put("/press/next", operation_id="put_next_panel", summary="Say what the next panels are")
def put_next_panel(
    store: StoreDep, headers: HeadersDep, change: NextPanelChange, who: Writer, press: PressName = None
) -> NextPanelNow:
    """Replace what is said of the panels to come; runs begin with it until it is changed, an empty one ends it."""
    name = _one_press(store, press)
    if reserved := {"run", "remark", "recipe", VERDICT} & set(change.header):
        raise ProblemError(422, say("api-header-key-fixed", key=min(reserved)))
    where = say("place-press", press=name)
    check_header({"recipe": change.recipe}, where)
    if change.header:
        check_keys(change.header, change.header, where)
        if text := store.presses().get(name, ""):
            overridden(parse_press(text, where), change.header, where)
        if "panel.material" in change.header:
            check_material({**headers.get(name, {}), **change.header}, where)
    store.put_next_panel(name, change.header, change.recipe, who)
    store.log(
        "info", who, say("api-next-panel", press=name, fields=tuple(change.header), recipe=change.recipe), name
    )
    now, found = _next_panel(store, name)
    for doubt in found:
        store.log("warning", who, say("of-press", press=name, what=doubt), name)
    return now


def _next_panel(store: Store, press: str) -> tuple[NextPanelNow, tuple[Message, ...]]:
    """Return what is stated of the panels to come, and what is to be asked about it."""
    stated, recipes = store.next_panel(press), store.recipes()
    if stated is None:
        return NextPanelNow(press=press, recipe="", header={}, who=None, utc=None, recipes=recipes), ()
    header = dict(stated.header)
    found = _doubts(store, press, header)
    now = NextPanelNow(
        press=press,
        recipe=stated.recipe,
        header=header,
        who=stated.who,
        utc=stated.utc,
        recipes=recipes,
        **doubt_fields(found),
    )
    return now, found


def _doubts(store: Store, press: str, header: Mapping[str, Any]) -> tuple[Message, ...]:
    """Return what is to be asked about the panels to come."""
    found = list(doubts(header))
    if isinstance(start := header.get(START), int | float) and start > HAND_C:
        found.append(say("header-start-hot", key=START, value=start, limit=HAND_C))
    if isinstance(thickness := header.get(THICKNESS), int | float):
        pressed = [run.header.get(THICKNESS) for run in store.runs(press=press, limit=MAX_PAGE).items]
        known = [mm for mm in pressed if isinstance(mm, int | float)]
        if known and not any(one_product(thickness, mm) for mm in known):
            found.append(say("panel-not-pressed-before", key=THICKNESS, **nearest_of([thickness, *known])))
    return tuple(found)


def _one_press(store: Store, press: str | None) -> str:
    """Return the press that is meant: the one named, or the only one."""
    known = list(store.presses())
    if press is None and len(known) == 1:
        return known[0]
    return existing_press(store, press or "")


def _check(store: Store, record: RunRecord, wanted: Mapping[str, Any]) -> None:
    """Refuse a header that could not be read again, or that press file and panel would not take."""
    if not wanted:
        return
    merged = {**record.header, **wanted}
    header = {key: value for key, value in merged.items() if value is not None}
    check_keys(header, wanted, record.run)
    imagined = Run(record.run, header, np.zeros(0), {}, source=record.run)
    text = store.presses().get(record.press, "")
    if text:
        press_for_run(parse_press(text, say("place-press", press=record.press)), imagined)
    try:
        panel_of(imagined)
    except InputError:
        touched = any(key.startswith("panel.") for key in wanted)
        if touched or _has_panel(Run(record.run, record.header, np.zeros(0), {})):
            raise  # what was missing before may stay missing while something else is written down


def check_keys(header: Mapping[str, Any], wanted: Mapping[str, Any], where: str | Message) -> None:
    """Refuse header keys that could not be read again, or whose values cannot be.

    Parameters
    ----------
    header
        All keys as they will be.
    wanted
        Those that are new; None removes one.
    where
        Whose they are, for the refusal.
    """
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
    check_header({key: value for key, value in wanted.items() if value is not None}, where)


def _has_panel(run: Run) -> bool:
    try:
        panel_of(run)
    except InputError:
        return False
    return True
