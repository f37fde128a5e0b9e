"""Alarms as lists show them."""

from __future__ import annotations

from collections.abc import Mapping

from api.answers.schemas import Alarm, AlarmLimits, AlarmThresholds
from api.answers.words import message_answer
from daq.store.records import StoredAlarm, Thresholds
from daq.words import Message


def alarm_of(stored: StoredAlarm, standing: Mapping[str, Message] | None = None) -> Alarm:
    """Return a stored alarm. `standing`: what stands now by its key, in words of now; None: as stored."""
    stands = stored.ended_utc is None and (standing is None or stored.key in standing)
    message = standing[stored.key] if stands and standing is not None else stored.message
    return Alarm(
        id=str(stored.number),
        press=stored.press,
        message=str(message),
        message_said=message_answer(message),
        raised_utc=stored.raised_utc,
        ended_utc=None if stands else stored.ended_utc or stored.seen_utc,
        stands=stands,
        acknowledged_utc=stored.acknowledged_utc,
        acknowledged_by=stored.acknowledged_by,
    )


def thresholds_of(press: str, kept: Thresholds | None) -> AlarmThresholds:
    """Return the limits set for a press, none where nobody has set any."""
    limits = AlarmLimits(**(kept.limits if kept else {}))
    return AlarmThresholds(
        press=press, thresholds=limits, who=kept.who if kept else None, utc=kept.utc if kept else None
    )
