"""The table of a rehearsal, for terminal and report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from daq.words import Message, say
from softsensor.diagnosis.rehearsal import Hidden, Rate, Rehearsal
from softsensor.effects.vocabulary import called, parameters_shown

HEADS = ("report-cause", "rehearsal-size-head", "rehearsal-found", "rehearsal-alone", "rehearsal-wrong")
"""Of the columns."""


@dataclass(frozen=True)
class TableRow:
    """One hidden cause."""

    label: str
    cells: tuple[Message, ...]


def rehearsal_rows(rehearsal: Rehearsal) -> Iterator[TableRow]:
    """Yield the rows, a cell for each head."""
    for row in rehearsal.rows:
        rates = (rate_message(rate) for rate in (row.found, row.alone, row.wrong))
        yield TableRow(row.hidden.name, (called(row.hidden.name), size_message(row.hidden), *rates))


def none_message(rehearsal: Rehearsal) -> Message:
    """Say how often a cause was named where none was hidden."""
    return say("rehearsal-none", rate=rate_message(rehearsal.nothing))


def lost_messages(rehearsal: Rehearsal) -> tuple[Message, ...]:
    """Say how many campaigns are missing; nothing where all were finished."""
    return (say("rehearsal-lost", count=rehearsal.lost),) if rehearsal.lost else ()


def rate_message(rate: Rate) -> Message:
    """Say a count, out of how many, and the interval of its chance."""
    low, high = (100.0 * end for end in rate.ci95)
    return say("rehearsal-rate", count=rate.count, of=rate.of, low=low, high=high)


def size_message(hidden: Hidden) -> Message:
    """Say how large a hidden cause is; nothing of one without a size."""
    if not hidden.parameters:
        return say("plain-text", text="")
    first = parameters_shown(hidden.name, {name: {"value": value} for name, value in hidden.parameters})[0]
    return say("rehearsal-size-cell", value=first.value, unit=first.unit)
