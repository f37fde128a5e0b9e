"""Qualities beside a run's values: a text column ``quality`` that names what deviates, row by row.

A cell reads ``top_3=open bottom_1=stale``, is empty where every value is good, and ``*`` stands for every
column it does not name (``*=simulated``). Values that are not usable are missing in the run's columns.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from daq.records import Quality, Run
from daq.words import Message, say

QUALITY = "quality"
OTHERS = "*"
_PART = re.compile(rf"(?:^| )(\S.*?)=({'|'.join(Quality)})(?= |$)")

_PAIR = re.compile(r"([^\s;,=]+)=([^\s;,=]*)")
_QUALITIES = tuple(str(quality.value) for quality in Quality)


@dataclass(frozen=True)
class QualitySpan:
    """Consecutive rows in which a column's values were not simply good."""

    column: str
    """``*`` for every column that no other span names."""
    quality: Quality
    from_s: float
    to_s: float
    rows: int


def quality_text(faults: Mapping[str, str], columns: Iterable[str] | None = None) -> str:
    """Write what deviates in one row, of all columns or some.

    >>> quality_text({"top_3": "open", "bottom_1": "stale"})
    'top_3=open bottom_1=stale'
    """
    kept = None if columns is None else {OTHERS, *columns}
    return " ".join(f"{name}={quality}" for name, quality in faults.items() if kept is None or name in kept)


@lru_cache(maxsize=4096)
def faults_of(text: str) -> Mapping[str, Quality] | None:
    """Read what `quality_text` wrote; None where the text is something else.

    >>> faults_of("top_3=open")
    {'top_3': <Quality.OPEN: 'open'>}
    """
    found = {name: Quality(quality) for name, quality in _PART.findall(text)}
    return found if quality_text(found) == text.strip() else None


def row_faults(run: Run) -> list[Mapping[str, Quality]] | None:
    """Return what deviates in each row; None where the run has no such column.

    A column of that name which holds other remarks, or names a column that is not there, is such a case.
    """
    texts = run.texts.get(QUALITY)
    if texts is None:
        return None
    known = {OTHERS, *run.columns}
    read = {text: faults_of(text) for text in set(texts)}
    valid = {text: faults for text, faults in read.items() if faults is not None and known.issuperset(faults)}
    return [valid[text] for text in texts] if len(valid) == len(read) else None


def wrong_quality(texts: Sequence[str], columns: Collection[str]) -> tuple[int, Message] | None:
    """Return the first row whose cell does not read as qualities of these columns, and why; None for none.

    A column that nowhere says ``COLUMN=`` or ``=QUALITY`` holds other words, and nothing of it is wrong.

    >>> row, why = wrong_quality(["", "top_9=open"], ["top_1"])
    >>> row, str(why)
    (1, "'top_9=open' names column 'top_9', which is not there; correct the name")
    """
    pairs = {text: _PAIR.findall(text) for text in set(texts)}
    if not any(name in columns or quality in _QUALITIES for found in pairs.values() for name, quality in found):
        return None
    for text in dict.fromkeys(texts):
        faults = faults_of(text)
        unknown = [name for name in faults or () if name not in (OTHERS, *columns)]
        if faults is not None and not unknown:
            continue
        row = texts.index(text)
        if odd := [quality for _, quality in pairs[text] if quality not in _QUALITIES]:
            return row, say("quality-unknown", text=repr(text), quality=repr(odd[0]), known=_QUALITIES)
        if faults is None or any("=" in name for name in unknown):
            return row, say("quality-form", text=repr(text))
        return row, say("quality-no-such-column", text=repr(text), column=repr(unknown[0]))
    return None


def rows_alike(run: Run) -> list[tuple[Mapping[str, Quality], NDArray[np.intp]]]:
    """Return what deviates with the rows that say it, one entry a cell that differs; good rows are left out."""
    faults_by_row = row_faults(run)
    if faults_by_row is None or not any(faults_by_row):
        return []
    texts = run.texts[QUALITY]
    places = {text: place for place, text in enumerate(dict.fromkeys(texts))}
    cells = np.fromiter(map(places.__getitem__, texts), np.intp, len(texts))
    order = np.argsort(cells, kind="stable")
    groups = np.split(order, np.searchsorted(cells[order], np.arange(1, len(places))))
    return [(faults_by_row[rows[0]], rows) for rows in groups if faults_by_row[rows[0]]]


def without_unusable(run: Run) -> Run:
    """Take out the values that the run itself calls unusable."""
    alike = rows_alike(run)
    if not alike:
        return run
    columns = {name: np.array(values) for name, values in run.columns.items()}
    for faults, rows in alike:
        for name, values in columns.items():
            if not is_usable(faults, name):
                values[rows] = np.nan
    return replace(run, columns=columns)


def is_usable(faults: Mapping[str, Quality], column: str) -> bool:
    """Return whether a row in which this deviates has a usable value in a column.

    >>> is_usable({"top_1": Quality.OPEN, "*": Quality.SIMULATED}, "top_1")
    False
    """
    return faults.get(column, faults.get(OTHERS, Quality.GOOD)).usable


def spans_of(run: Run) -> Iterator[QualitySpan]:
    """Yield what deviates in a run as spans of time, by column, each column's in order."""
    faults_by_row, times = row_faults(run) or [], run.time_s.tolist()
    alike = [list(rows) for _, rows in groupby(range(len(faults_by_row)), key=lambda row: run.texts[QUALITY][row])]
    stretches = [(faults_by_row[rows[0]], rows[0], rows[-1]) for rows in alike]
    named = {name for faults, _, _ in stretches for name in faults}
    for column in (name for name in (OTHERS, *run.columns) if name in named):
        for quality, group in groupby(stretches, key=partial(_quality, column)):
            parts = list(group)
            first, last = parts[0][1], parts[-1][2]
            if quality is not None:
                yield QualitySpan(column, quality, times[first], times[last], last - first + 1)


def _quality(column: str, stretch: tuple[Mapping[str, Quality], int, int]) -> Quality | None:
    return stretch[0].get(column)
