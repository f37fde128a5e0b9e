"""Alarms: what somebody should know, who has taken it on, and the limits an engineer sets."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query

from api.answers.alarms import alarm_of, thresholds_of
from api.answers.health import NEVER_SEEN, standing_alarms
from api.answers.records import utc_now
from api.answers.schemas import Alarm, AlarmLimits, AlarmList, AlarmThresholds, AlarmThresholdsList
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import (
    MAX_PAGE,
    Cursor,
    PageSize,
    PressesDep,
    PressName,
    StoreDep,
    Writer,
    existing_press,
)
from daq.records import InputError
from daq.store.store import Store
from daq.words import Message, say

router = APIRouter(tags=["alarms"], responses=problem_responses(404))

Pending = Annotated[bool, Query(description="Only those that stand or that nobody has acknowledged.")]
Number = Annotated[str, Path(pattern="^[0-9]{1,18}$")]


@router.get("/alarms", operation_id="list_alarms", summary="Alarms, newest first")
def list_alarms(
    store: StoreDep, press: PressName = None, pending: Pending = False, cursor: Cursor = None, limit: PageSize = 50
) -> AlarmList:
    """Return one page of alarms: limits crossed, processes silent, alarms of the journal; each one once."""
    standing = _raised_now(store)
    page = store.alarms(press=press, pending=pending, cursor=cursor, limit=limit)
    items = [alarm_of(alarm, standing) for alarm in page.items]
    shown = [one for one in items if not pending or one.stands or one.acknowledged_utc is None]
    return AlarmList(items=shown, next_cursor=page.next_cursor)


def _raised_now(store: Store) -> dict[str, Message]:
    """Return what stands now by its key, by the same look as `/health`; what nobody has raised yet is raised."""
    now = utc_now()
    standing = standing_alarms(store, now)
    due = [alarm for alarm in standing if alarm.message.code != NEVER_SEEN]
    pending = store.alarms(pending=True, limit=MAX_PAGE).items
    known = {alarm.key for alarm in pending if alarm.ended_utc is None}
    if not known.issuperset(alarm.key for alarm in due):
        store.watch_alarms(due, (), store.alarm_clock())
    return {alarm.key: alarm.message for alarm in standing}


@router.get("/alarms/thresholds", operation_id="list_thresholds", summary="The limits set for each press")
def list_thresholds(store: StoreDep, presses: PressesDep) -> AlarmThresholdsList:
    """Return the limits of every press, who set them last and when; null where there is no limit."""
    kept = store.alarm_thresholds()
    return AlarmThresholdsList(items=[thresholds_of(name, kept.get(name)) for name in presses])


@router.put("/alarms/thresholds/{press}", operation_id="put_thresholds", summary="Set the limits of a press")
def put_thresholds(store: StoreDep, press: str, limits: AlarmLimits, who: Writer) -> AlarmThresholds:
    """Replace the limits of a press; needs a token with scope write."""
    existing_press(store, press)
    below, above = limits.platen_below_C, limits.platen_above_C
    if below is not None and above is not None and not below < above:
        raise ProblemError(422, say("alarm-limits-crossed", below_C=float(below), above_C=float(above)))
    given = limits.model_dump()
    store.put_alarm_thresholds(press, given, who)
    fields = tuple(name for name, value in given.items() if value not in (None, False))
    store.log("info", who, say("alarm-thresholds-set", press=press, fields=fields), press, given)
    return thresholds_of(press, store.alarm_thresholds()[press])


@router.post("/alarms/{alarm}/acknowledge", operation_id="acknowledge_alarm", summary="Take an alarm on")
def acknowledge_alarm(store: StoreDep, alarm: Number, who: Writer) -> Alarm:
    """Say that you have taken an alarm on; the first one counts. Needs a token with scope write."""
    try:
        return alarm_of(store.acknowledge_alarm(int(alarm), who), _raised_now(store))
    except InputError as error:
        raise ProblemError(404, say("alarm-missing", number=int(alarm))) from error
