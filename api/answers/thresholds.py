"""What has crossed the limits an engineer set for a press."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from api.answers.channels import channel_role
from api.answers.drift import drift_of
from api.answers.present import present_of
from api.answers.schemas import AlarmLimits
from daq.records import Scan
from daq.store.records import StandingAlarm
from daq.store.store import Store
from daq.supervision import SILENT_S
from daq.words import Message, say

UNKNOWN = ("unknown_effect", "not_described")
"""Verdicts of a diagnosis that leaves something unexplained."""


def crossed(store: Store, now: datetime) -> list[StandingAlarm]:
    """Return the limits of all presses that are crossed now."""
    return [
        alarm
        for press, set_ in store.alarm_thresholds().items()
        for alarm in _crossed(store, press, AlarmLimits(**set_.limits), now)
    ]


def _crossed(store: Store, press: str, limits: AlarmLimits, now: datetime) -> Iterator[StandingAlarm]:
    number = store.newest_scan_number(press)
    batch = store.scans_after(press, number - 1, 1)
    scan = batch.scans[-1] if batch.scans else None
    if scan is not None:
        age_s = (now - scan.utc).total_seconds()
        if limits.silence_s is not None and age_s > limits.silence_s:
            yield _of("silence", press, say("alarm-silence", press=press, limit=limits.silence_s))
        if age_s <= SILENT_S:  # what is older says nothing of now, which is another alarm
            yield from _core(store, press, limits, now)
            yield from _platens(press, tuple(c.name for c in batch.channels), scan, limits)
    yield from _drifts(store, press, limits)
    found = store.diagnoses(press=press, limit=1).items if limits.verdict_unknown else ()
    if any(one.verdict in UNKNOWN for one in found):
        yield _of("verdict", press, say("alarm-verdict", press=press))


def _drifts(store: Store, press: str, limits: AlarmLimits) -> Iterator[StandingAlarm]:
    for drift in drift_of(store, press) if limits.drift_percent is not None else ():
        if 100.0 * abs(drift.factor - 1.0) >= (limits.drift_percent or 0.0):
            where = {"coefficient": drift.coefficient, "since": drift.since_run}
            message = say("alarm-drift", press=press, percent=100.0 * drift.factor, **where)
            yield _of(f"drift:{drift.coefficient}:{drift.since_run}", press, message)


def _core(store: Store, press: str, limits: AlarmLimits, now: datetime) -> Iterator[StandingAlarm]:
    if limits.core_above_C is None:
        return
    estimate = present_of(store, press, now).estimate
    if estimate is not None and estimate.valid and estimate.core_celsius > limits.core_above_C:
        yield _of("core", press, say("alarm-core-above", press=press, limit=limits.core_above_C))


def _platens(press: str, channels: tuple[str, ...], scan: Scan, limits: AlarmLimits) -> Iterator[StandingAlarm]:
    for channel, value, quality in zip(channels, scan.values, scan.qualities, strict=True):
        if channel_role(channel) != "platen" or not quality.usable:
            continue
        about = {"press": press, "channel": channel}
        if limits.platen_above_C is not None and value > limits.platen_above_C:
            message = say("alarm-platen-above", limit=limits.platen_above_C, **about)
            yield _of(f"above:{channel}", press, message)
        if limits.platen_below_C is not None and value < limits.platen_below_C:
            message = say("alarm-platen-below", limit=limits.platen_below_C, **about)
            yield _of(f"below:{channel}", press, message)


def _of(what: str, press: str, message: Message) -> StandingAlarm:
    return StandingAlarm(f"threshold:{press}:{what}", press, message)
