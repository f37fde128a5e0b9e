"""What the nightly job did, press by press."""

from __future__ import annotations

from api.answers.schemas import Night, UnfittedRun
from api.answers.words import message_answer
from daq.store.records import StoredNight
from daq.words import Message


def night_of(stored: StoredNight) -> Night:
    """Return a stored night as lists show it."""
    from softsensor.jobs.night_progress import nights_for  # and with it the compiler, for a second of a start

    content = {key: value for key, value in stored.night.items() if key != "drifts"}
    reason = Message.from_json(content.pop("reason"))
    left_out = [(entry["run"], Message.from_json(entry["why"])) for entry in content.pop("left_out")]
    return Night(
        id=str(stored.number),
        press=stored.press,
        started_utc=stored.started_utc,
        ended_utc=stored.ended_utc,
        left_out=[UnfittedRun(run=run, why=str(why), why_said=message_answer(why)) for run, why in left_out],
        reason=str(reason),
        reason_said=message_answer(reason),
        later_nights=nights_for(content["later"]),
        **content,
    )
