"""Alarms: raised once, acknowledged by somebody, and on their way to people. One transaction each.

An alarm and its deliveries, one for each way of every server over the store, are written together; a delivery
leaves the outbox only when its receiver has taken it: no restart loses one, whichever server raised it. A way that
nobody had for a week gets what stands when it is back, not what came and went meanwhile. A condition that stands
already is not raised again, servers look one after the other and by one clock (`shared_clock`), and a delivery in
the hands of a process is put off for the others: none is doubled, but for a process killed between the receiver's
word and its own note, where the receiver knows it by the alarm's number.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, Row, delete, exists, func, insert, or_, select, update

from daq.records import InputError
from daq.store.convert import known_utc, to_json, unix_of, utc_of
from daq.store.journal import journal_after
from daq.store.reading import newest_first
from daq.store.records import AT_ONCE, Delivery, Page, StandingAlarm, StoredAlarm, Thresholds
from daq.store.schema import ALARM, ALARM_DELIVERY, ALARM_POSITION, ALARM_THRESHOLD, ALARM_WAY, EVENT
from daq.store.upsert import insert_new, put
from daq.supervision import CALM_S, IN_USE_S
from daq.words import Message, say

# Numbers without another source were set by hand, 2026-11.

IN_HAND_S = 45.0
"""A delivery that a process has taken in hand is another's after this time: it was killed. [s]"""
LONGEST_WAIT_S = 600.0
"""Between two tries at a receiver that does not take it. [s]"""
FIRST_WAIT_S = 5.0
"""After the first try; doubled with each. [s]"""
JOURNAL = "journal"

NOTED_S = IN_USE_S / (7 * 24)
"""How often it is noted that a way is still there: hourly, each is a write. [s]"""


def watch(connection: Connection, standing: Sequence[StandingAlarm], ways: Sequence[str], now: datetime) -> int:
    """Take up what stands now and the journal's new alarms, end what no longer stands; return how many are new.

    Parameters
    ----------
    ways
        How this server can inform people; a new alarm gets one delivery for each way of every server.
    """
    at = unix_of(now)
    position = _turn(connection)
    ways = _ways(connection, ways, at)
    known = set(connection.execute(select(ALARM.c.key).where(ALARM.c.ended_unix_s.is_(None))).scalars())
    by_key = {alarm.key: alarm for alarm in standing}
    if known & set(by_key):
        connection.execute(update(ALARM).where(_stands(known & set(by_key))).values(seen_unix_s=at))
    ahead = (ALARM.c.ended_unix_s.is_(None), ALARM.c.seen_unix_s > at + CALM_S)
    # by a clock that was set back since, or by another server's, which sees it again if it still stands there
    connection.execute(update(ALARM).where(*ahead).values(seen_unix_s=at))
    over = (ALARM.c.ended_unix_s.is_(None), ALARM.c.seen_unix_s < at - CALM_S)
    connection.execute(update(ALARM).where(*over).values(ended_unix_s=ALARM.c.seen_unix_s))
    new = [_raise(connection, alarm, ways, at) for key, alarm in by_key.items() if key not in known]
    return len(new) + _take_up_journal(connection, position, ways, at)


def _turn(connection: Connection) -> int:
    """Wait until no other server looks; return up to which line of the journal its alarms are taken up."""
    query = select(ALARM_POSITION.c.event_id).with_for_update()
    if (position := connection.execute(query).scalar()) is None:  # the first look: what was before is history
        newest = connection.execute(select(func.max(EVENT.c.event_id))).scalar()
        insert_new(connection, ALARM_POSITION, {"journal": JOURNAL, "event_id": newest or 0})
        position = connection.execute(query).scalar_one()
    return int(position)


def _ways(connection: Connection, own: Sequence[str], at: float) -> list[str]:
    """Return the ways of every server there lately, `own` among them; by a new one goes what stands already."""
    last_seen = {row.way: row.seen_unix_s for row in connection.execute(select(ALARM_WAY)).all()}
    for way in own:
        silent_s = abs(at - last_seen.get(way, -math.inf))  # a clock set back is as good as a long silence
        if silent_s < NOTED_S:
            continue
        put(connection, ALARM_WAY, [{"way": way, "seen_unix_s": at}])
        if silent_s > IN_USE_S:
            gone_s = last_seen.get(way, math.inf)
            over = (ALARM.c.ended_unix_s.is_not(None), ALARM.c.raised_unix_s > gone_s)
            passed = select(ALARM.c.alarm_id).where(*over)
            stale = (ALARM_DELIVERY.c.way == way, ALARM_DELIVERY.c.alarm_id.in_(passed))
            connection.execute(delete(ALARM_DELIVERY).where(*stale))
            queued = exists().where(ALARM_DELIVERY.c.alarm_id == ALARM.c.alarm_id, ALARM_DELIVERY.c.way == way)
            standing = select(ALARM.c.alarm_id).where(ALARM.c.ended_unix_s.is_(None), ~queued)
            for number in connection.execute(standing).scalars().all():
                _send(connection, number, [way], at)
        last_seen[way] = at
    return [way for way, last in last_seen.items() if at - last <= IN_USE_S]


def _send(connection: Connection, number: int, ways: Sequence[str], at: float) -> None:
    outbox = [{"alarm_id": number, "way": w, "due_unix_s": at, "tries": 0, "problem": ""} for w in ways]
    if outbox:
        connection.execute(insert(ALARM_DELIVERY), outbox)


def _stands(keys: set[str]) -> Any:
    return ALARM.c.key.in_(keys) & ALARM.c.ended_unix_s.is_(None)


def _raise(
    connection: Connection, alarm: StandingAlarm, ways: Sequence[str], at: float, ended: float | None = None
) -> int:
    row = {
        "key": alarm.key,
        "press": alarm.press,
        "message_json": to_json(alarm.message.to_json()),
        "raised_unix_s": at,
        "seen_unix_s": at,
        "ended_unix_s": ended,
    }
    made = connection.execute(insert(ALARM), row).inserted_primary_key
    number = int(made[0]) if made is not None else 0
    _send(connection, number, ways, at)
    return number


def _take_up_journal(connection: Connection, position: int, ways: Sequence[str], now_s: float) -> int:
    """Raise the journal's alarms since the last look. They are over as they are raised: a line does not stand.

    They are due at once, whatever the clock of who wrote them showed.
    """
    entries = journal_after(connection, position, AT_ONCE)
    alarms = [entry for entry in entries if entry.level == "alarm"]
    for entry in alarms:
        at = unix_of(entry.utc)
        number = _raise(connection, StandingAlarm(f"event:{entry.number}", entry.press, entry.message), [], at, at)
        _send(connection, number, ways, now_s)
    if entries:
        connection.execute(update(ALARM_POSITION).values(event_id=entries[-1].number))
    return len(alarms)


def alarms(
    connection: Connection,
    *,
    press: str | None = None,
    cursor: str | None = None,
    limit: int = 50,
    pending: bool = False,
) -> Page[StoredAlarm]:
    """Return a page of alarms, newest first; `pending` ones stand, or nobody has acknowledged them."""
    if not pending:
        rows, following = newest_first(connection, ALARM, press, cursor, limit)
        return Page(tuple(_alarm(row) for row in rows), following)
    query = select(ALARM).where(or_(ALARM.c.ended_unix_s.is_(None), ALARM.c.acknowledged_unix_s.is_(None)))
    if press is not None:
        query = query.where(ALARM.c.press == press)
    if cursor is not None:
        query = query.where(ALARM.c.alarm_id < int(cursor))
    found = connection.execute(query.order_by(ALARM.c.alarm_id.desc()).limit(limit + 1)).all()
    return Page(
        tuple(_alarm(row) for row in found[:limit]), str(found[limit - 1].alarm_id) if len(found) > limit else None
    )


def _alarm(r: Row[Any]) -> StoredAlarm:
    return StoredAlarm(
        r.alarm_id,
        r.press,
        Message.from_json(json.loads(r.message_json)),
        known_utc(r.raised_unix_s),
        utc_of(r.ended_unix_s),
        utc_of(r.acknowledged_unix_s),
        r.acknowledged_by,
        r.key,
        known_utc(r.seen_unix_s),
    )


def acknowledge(connection: Connection, number: int, who: str) -> StoredAlarm:
    """Note who has taken an alarm on; the first one counts. Raises InputError where there is no such alarm."""
    own = ALARM.c.alarm_id == number
    now = {"acknowledged_unix_s": unix_of(datetime.now(UTC)), "acknowledged_by": who}
    connection.execute(update(ALARM).where(own, ALARM.c.acknowledged_unix_s.is_(None)).values(**now))
    row = connection.execute(select(ALARM).where(own)).first()
    if row is None:
        raise InputError(say("alarm-missing", number=number))
    return _alarm(row)


def shared_clock(connection: Connection) -> datetime:
    """Return what the clock shows by which alarms go: a server's own, one for all who meet there."""
    if connection.dialect.name == "sqlite":
        return datetime.now(UTC)
    shown: datetime = connection.execute(select(func.clock_timestamp())).scalar_one()
    return shown.astimezone(UTC)


def take_delivery(connection: Connection, ways: Sequence[str], now: datetime) -> Delivery | None:
    """Take the delivery that has waited longest in hand, None where none is due; others leave it alone so long.

    None waits longer than `LONGEST_WAIT_S`: what is due later was noted by a clock that has been set back since,
    or by another server's that is ahead, which may have it in hand.
    """
    at = unix_of(now)
    ahead = (ALARM_DELIVERY.c.delivered_unix_s.is_(None), ALARM_DELIVERY.c.due_unix_s > at + LONGEST_WAIT_S)
    connection.execute(update(ALARM_DELIVERY).where(*ahead).values(due_unix_s=at + IN_HAND_S))
    query = (
        select(ALARM_DELIVERY.c.way, ALARM_DELIVERY.c.tries, ALARM)
        .join(ALARM, ALARM.c.alarm_id == ALARM_DELIVERY.c.alarm_id)
        .where(ALARM_DELIVERY.c.delivered_unix_s.is_(None), ALARM_DELIVERY.c.due_unix_s <= at)
        .where(ALARM_DELIVERY.c.way.in_(ways))
        .order_by(ALARM_DELIVERY.c.due_unix_s, ALARM_DELIVERY.c.alarm_id)
        .limit(1)
    )
    row = connection.execute(query).first()
    if row is None:
        return None
    mine = (*_delivery(row.alarm_id, row.way), ALARM_DELIVERY.c.tries == row.tries)
    taken = update(ALARM_DELIVERY).where(*mine).values(due_unix_s=at + IN_HAND_S, tries=row.tries + 1)
    if connection.execute(taken).rowcount != 1:  # another process was faster
        return None
    return Delivery(_alarm(row), row.way, row.tries + 1)


def delivered(connection: Connection, delivery: Delivery, now: datetime) -> None:
    """Note that a receiver has taken an alarm."""
    own = _delivery(delivery.alarm.number, delivery.way)
    connection.execute(update(ALARM_DELIVERY).where(*own).values(delivered_unix_s=unix_of(now), problem=""))


def put_off(connection: Connection, delivery: Delivery, why: str, now: datetime) -> None:
    """Note why a receiver has not taken an alarm, and try again later."""
    wait_s = min(FIRST_WAIT_S * 2.0 ** (delivery.tries - 1), LONGEST_WAIT_S)
    own = _delivery(delivery.alarm.number, delivery.way)
    later = {"due_unix_s": unix_of(now) + wait_s, "problem": why[:500]}
    connection.execute(update(ALARM_DELIVERY).where(*own).values(**later))


def _delivery(number: int, way: str) -> tuple[Any, ...]:
    return (
        ALARM_DELIVERY.c.alarm_id == number,
        ALARM_DELIVERY.c.way == way,
        ALARM_DELIVERY.c.delivered_unix_s.is_(None),
    )


def thresholds(connection: Connection) -> dict[str, Thresholds]:
    """Return the limits set for each press."""
    rows = connection.execute(select(ALARM_THRESHOLD).order_by(ALARM_THRESHOLD.c.press)).all()
    return {r.press: Thresholds(r.press, known_utc(r.unix_s), r.who, json.loads(r.thresholds_json)) for r in rows}


def put_thresholds(connection: Connection, press: str, limits: Mapping[str, Any], who: str) -> None:
    """Replace the limits set for a press."""
    connection.execute(delete(ALARM_THRESHOLD).where(ALARM_THRESHOLD.c.press == press))
    row = {
        "press": press,
        "unix_s": unix_of(datetime.now(UTC)),
        "who": who,
        "thresholds_json": to_json(limits),
    }
    connection.execute(insert(ALARM_THRESHOLD), row)
