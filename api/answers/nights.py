"""What the nightly job did, press by press."""

from __future__ import annotations

from api.answers.schemas import LeftOut, Night
from api.answers.words import said_of
from daq.store.records import StoredNight
from daq.words import Message
from softsensor.jobs.night_progress import nights_for


def night_of(stored: StoredNight) -> Night:
    """Return a stored night as lists show it."""
    told = {key: value for key, value in stored.night.items() if key != "drifts"}
    reason = Message.from_json(told.pop("reason"))
    left_out = [(entry["run"], Message.from_json(entry["why"])) for entry in told.pop("left_out")]
    return Night(
        id=str(stored.number),
        press=stored.press,
        started_utc=stored.started_utc,
        ended_utc=stored.ended_utc,
        left_out=[LeftOut(run=run, why=str(why), why_said=said_of(why)) for run, why in left_out],
        reason=str(reason),
        reason_said=said_of(reason),
        later_nights=nights_for(told["later"]),
        **told,
    )
