"""The catalogue of words as the API hands it out, and messages as its answers carry them."""

from __future__ import annotations

from functools import cache

from api.answers.schemas import Messages, Said
from daq.words import Message
from daq.words.message import catalogue_of, languages


@cache
def messages_of(language: str) -> Messages:
    """Return every code's pattern in a language, also of effects of one's own.

    Raises `KeyError` for a language without words.
    """
    from softsensor.effects import words_of_own_effects

    messages = catalogue_of(language).entries() | words_of_own_effects(language)
    return Messages(language=language, languages=list(languages()), messages=messages)


def message_answer(message: Message) -> Said:
    """Return a message as answers carry it beside its English."""
    return Said(**message.to_json())
