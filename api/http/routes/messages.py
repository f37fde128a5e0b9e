"""The words of all messages, for pages and programs that show them."""

from __future__ import annotations

from fastapi import APIRouter

from api.answers.schemas import Messages
from api.answers.words import messages_of
from api.http.problems import ProblemError, problem_responses
from daq.words import say
from daq.words.message import languages

router = APIRouter(tags=["system"], responses=problem_responses(404))


@router.get("/messages/{language}", operation_id="get_messages", summary="The catalogue of words")
def get_messages(language: str) -> Messages:
    """Return what every code says in a language, in the syntax of Project Fluent; it needs no token."""
    if language not in languages():
        raise ProblemError(404, say("api-no-such-language", language=language, languages=languages()))
    return messages_of(language)
