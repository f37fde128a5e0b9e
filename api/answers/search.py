"""Finding runs: words in what is known of them, bounds on their numbers, any of these as the order. No web."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from api.answers.decimation import number_or_none
from api.answers.kept import Kept
from api.answers.records import is_described, run_summary
from api.answers.schemas import RunHit, SearchList
from daq.press.header import VERDICT, VERDICTS, is_number_key
from daq.records import InputError
from daq.store.records import AT_ONCE, Page, RunCore, RunRecord, RunStatus, every
from daq.store.store import Store
from daq.words import Message, say
from daq.words.message import ENGLISH, words

CORE = ("core_at_opening_C", "core_peak_C", "band_at_opening_K")
OWN = ("press_time_s", "rmse_K", *CORE)
"""Numbers of a run beside those of its header (`panel.thickness_mm`, `setting.pressure_N_cm2`)."""
COEFFICIENT = "h_"
"""How the names of heat transfer coefficients begin: a run's fit brings those that it determines."""
MOST_KEPT = 20_000
"""Runs whose numbers are kept in memory: some hundred bytes each."""
_CORES: Kept[tuple[str, str], RunCore] = Kept(MOST_KEPT)
_COMPARISONS = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt, "=": operator.eq}
_BOUND = re.compile(r"\s*([A-Za-z][\w.-]*)\s*(<=|>=|<|>|=)\s*([+-]?[0-9]+(?:[.,][0-9]+)?(?:[eE][+-]?[0-9]+)?)\s*")


@dataclass(frozen=True)
class Bound:
    """A number of a run held against a value."""

    name: str
    comparison: str
    value: float

    @classmethod
    def parse(cls, text: str) -> Bound:
        """Read ``core_at_opening_C>=95``. Raises `InputError`."""
        found = _BOUND.fullmatch(text)
        if found is None:
            raise InputError(say("api-search-bound", bound=text))
        name, comparison, value = found.groups()
        return cls(name, comparison, float(value.replace(",", ".")))

    def holds(self, numbers: Mapping[str, float]) -> bool:
        """Return whether a run has the number, and it lies where it should."""
        known = numbers.get(self.name, math.nan)
        return known == known and bool(_COMPARISONS[self.comparison](known, self.value))


@dataclass(frozen=True)
class Wanted:
    """What is looked for."""

    words: Sequence[str] = ()
    """Each must occur in name, press, remark, a text of the header or what its verdict is called; capitals do not
    matter."""
    bounds: Sequence[Bound] = ()
    press: str | None = None
    status: RunStatus | None = None
    since: datetime | None = None
    until: datetime | None = None
    """Started at or after the one and before the other."""
    verdict: str | None = None
    language: str = ENGLISH
    """In which the verdict is called something."""
    order: str = ""
    """A number's name, ``-`` before it for the largest first; empty: the newest first."""

    @property
    def numbers(self) -> set[str]:
        """The numbers that matter of every run, and not of those shown alone."""
        return {self.order.removeprefix("-"), *(bound.name for bound in self.bounds)}


def search_page(store: Store, wanted: Wanted, begin: int, limit: int) -> SearchList:
    """Return some of the runs looked for; the cursor of the next ones is how many are before them.

    Raises
    ------
    InputError
        For a bound on a number that none of them has and none may have: it is misspelt.
    """
    runs = every(lambda at: _page_at(store, wanted, at))
    called = {verdict: words(Message(f"page-panel-{verdict}"), wanted.language) for verdict in VERDICTS}
    records = [r for r in runs if _matches(r, wanted, called)]
    names = [r.run for r in records]
    errors = store.fit_errors(names) if "rmse_K" in wanted.numbers else {}
    fits = store.fits(names) if any(name.startswith(COEFFICIENT) for name in wanted.numbers) else {}
    cores = _cores_of(store, records) if wanted.numbers.intersection(CORE) else {}
    found = [(r, numbers_of(r, cores.get(r.run), errors.get(r.run), fits.get(r.run))) for r in records]
    fitted = [fit.get("coefficients", {}) for fit in fits.values()]
    lacking = lacking_of(wanted.bounds, [*(numbers for _, numbers in found), *fitted])
    found = [(r, numbers) for r, numbers in found if all(bound.holds(numbers) for bound in wanted.bounds)]
    if wanted.order:
        found = _ordered(found, wanted.order)
    page = [r for r, _ in found[begin : begin + limit]]
    following = str(begin + limit) if len(found) > begin + limit else None
    return SearchList(items=hits(store, page), next_cursor=following, lacking=lacking)


def _page_at(store: Store, wanted: Wanted, cursor: str | None) -> Page[RunRecord]:
    return store.runs(
        press=wanted.press,
        status=wanted.status,
        since=wanted.since,
        until=wanted.until,
        cursor=cursor,
        limit=AT_ONCE,
    )


def hits(store: Store, records: Sequence[RunRecord]) -> list[RunHit]:
    """Return runs with the numbers they are compared by."""
    cores = _cores_of(store, records)
    fits = store.fits([record.run for record in records])
    shown = []
    for record in records:
        fit = fits.get(record.run)
        summary = run_summary(store, record, fit)
        numbers = numbers_of(record, cores.get(record.run), summary.rmse_K, fit)
        shown_numbers = {name: number_or_none(value) for name, value in numbers.items()}
        recipe = str(record.header.get("recipe", ""))
        shown.append(RunHit(**summary.model_dump(), remark=record.remark, recipe=recipe, numbers=shown_numbers))
    return shown


def numbers_of(
    record: RunRecord,
    core: RunCore | None,
    rmse_K: float | None,  # noqa: N803
    fit: Mapping[str, Any] | None,
) -> dict[str, float]:
    """Return every number known of a run by its name; NaN where it is not known.

    Of the coefficients those that the run determines, and none where the model does not describe it.
    """
    found = fit or {}
    fitted = found.get("coefficients", {}) if is_described(found) else {}
    coefficients = {name: float(c["value"]) for name, c in fitted.items() if c.get("identifiable") is not False}
    given = {
        k: float(v) for k, v in record.header.items() if isinstance(v, int | float) and not isinstance(v, bool)
    }
    own = {
        "press_time_s": record.moments.opened_s - record.moments.closed_s,
        "rmse_K": math.nan if rmse_K is None else rmse_K,
        "core_at_opening_C": core.at_opening_celsius if core else math.nan,
        "core_peak_C": core.highest_celsius if core else math.nan,
        "band_at_opening_K": core.band_at_opening_kelvin if core else math.nan,
    }
    return given | coefficients | own


def _matches(record: RunRecord, wanted: Wanted, called: Mapping[str, str]) -> bool:
    """Return whether a run is one looked for; `called` is what each verdict is called."""
    verdict = record.header.get(VERDICT)
    if wanted.verdict and verdict != wanted.verdict:
        return False
    if not wanted.words:
        return True
    given = (value for value in record.header.values() if isinstance(value, str))
    text = "\n".join((record.run, record.press, record.remark, *given, called.get(str(verdict), ""))).casefold()
    return all(word.casefold() in text for word in wanted.words)


def _ordered(
    found: Iterable[tuple[RunRecord, dict[str, float]]], order: str
) -> list[tuple[RunRecord, dict[str, float]]]:
    """Sort by a number; runs without it come last either way, the newest first among equals."""
    name, sign = order.removeprefix("-"), -1.0 if order.startswith("-") else 1.0

    def key(one: tuple[RunRecord, dict[str, float]]) -> tuple[bool, float]:
        value = one[1].get(name, math.nan)
        return (True, 0.0) if value != value else (False, sign * value)

    return sorted(found, key=key)


def _cores_of(store: Store, records: Sequence[RunRecord]) -> dict[str, RunCore]:
    """Return the core of runs; of finished ones it is asked for once."""

    def look_up(lacking: list[tuple[str, str]]) -> dict[tuple[str, str], RunCore]:
        cores = store.run_cores([run for _, run in lacking])
        return {(store.label, run): core for run, core in cores.items()}

    done = [(store.label, record.run) for record in records if record.status is not RunStatus.OPEN]
    return {run: core for (_, run), core in _CORES.get_all(done, look_up).items()}


def lacking_of(bounds: Iterable[Bound], numbers: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the bounds' names that none of the runs has, whose `numbers` are given by name.

    Raises
    ------
    InputError
        For a name under which no run may have a number.
    """
    known = set().union(*numbers)
    lacking = sorted({bound.name for bound in bounds} - known) if numbers else []
    for name in lacking:
        if not is_number_key(name):
            raise InputError(say("api-search-unknown", name=name, known=tuple(sorted(known))))
    return lacking


def check_order(order: str) -> None:
    """Refuse an order by what no run could have. Raises `InputError`."""
    name = order.removeprefix("-")
    if name and name not in OWN and "." not in name and not name.startswith(COEFFICIENT):
        raise InputError(say("api-search-order", order=order, known=OWN))
