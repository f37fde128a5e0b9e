"""What the store keeps of a diagnosis, for page and report: the contract's answer and its sentences as codes."""

from __future__ import annotations

from typing import Any

from daq.press.press_file import Press
from daq.words import Message
from daq.words.message import words
from softsensor.diagnosis.curves import curves_of
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.summary import law_messages, worth
from softsensor.planning.plan import plan
from softsensor.planning.summary import point_message, pressing_messages, standing_messages


def stored_diagnosis(press: Press, found: Diagnosis) -> dict[str, Any]:
    """Return the JSON of a diagnosis with curves, what each cause is worth, a free law in words, and a plan."""
    content = found.as_json() | {"curves": curves_of(found)}
    for entry, finding in zip(content["effects"], found.findings, strict=True):
        entry |= _sentence(worth(found, finding), "worth")
    law = [_sentence(message) for message in law_messages(found)]
    return content | {"law_sentences": law, "plan": _plan(press, found)}


def _plan(press: Press, found: Diagnosis) -> dict[str, Any]:
    """Return what ``plan --json`` would, and beside each open point what it is and its pressings, as sentences."""
    ahead = plan(press, found)
    content = ahead.as_json()
    for entry, advice in zip(content["open"], ahead.points, strict=True):
        entry |= _sentence(point_message(advice.point))
        entry["pressings"] = [_sentence(message) for message in pressing_messages(advice)]
    return content | {"sentences": [_sentence(message) for message in standing_messages(ahead)]}


def _sentence(message: Message, key: str = "sentence") -> dict[str, Any]:
    """Return a message as everywhere in JSON: English words, and the code that other languages are made of."""
    return {key: words(message), f"{key}_said": message.to_json()}
