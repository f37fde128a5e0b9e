"""Alarms as lists show them."""

from __future__ import annotations

from api.answers.schemas import Alarm, AlarmLimits, AlarmThresholds
from api.answers.words import said_of
from daq.store.records import StoredAlarm, Thresholds


def alarm_of(stored: StoredAlarm) -> Alarm:
    """Return a stored alarm."""
    return Alarm(
        id=str(stored.number),
        press=stored.press,
        message=str(stored.message),
        message_said=said_of(stored.message),
        raised_utc=stored.raised_utc,
        ended_utc=stored.ended_utc,
        stands=stored.ended_utc is None,
        acknowledged_utc=stored.acknowledged_utc,
        acknowledged_by=stored.acknowledged_by,
    )


def thresholds_of(press: str, kept: Thresholds | None) -> AlarmThresholds:
    """Return the limits set for a press, none where nobody has set any."""
    limits = AlarmLimits(**(kept.limits if kept else {}))
    return AlarmThresholds(
        press=press, thresholds=limits, who=kept.who if kept else None, utc=kept.utc if kept else None
    )
