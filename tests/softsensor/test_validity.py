"""Reasons for a core that is not valid: every one has words, and says the same after the store."""

import re

import pytest

from daq.words.message import catalogue_of, languages, words
from softsensor.live.validity import Invalid, InvalidReason, reason_message


@pytest.mark.parametrize("language", languages())
def test_every_reason_has_words_in_every_language(language):
    assert [r for r in InvalidReason if not catalogue_of(language).has(r.code)] == []


def test_a_reason_reads_the_same_from_the_store_as_when_it_was_found():
    found = Invalid(InvalidReason.START_TEMPERATURE_CONTRADICTED, {"measured_C": 31.2, "header_C": 20.8})
    again = reason_message(found.reason.value, found.stored)
    assert again == found.message
    assert words(again, "de").startswith("die Fühler zeigen 31 °C")


def test_a_sentence_of_an_older_store_stays_as_it_is():
    assert str(reason_message("model not valid: the run begins in the closed press")).startswith("model not valid")


def test_the_code_that_the_contract_fixes_is_the_first():
    assert next(iter(InvalidReason)) == "press state unknown"
    assert all(re.fullmatch(r"[a-z ]+", r) for r in InvalidReason)
