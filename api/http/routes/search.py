"""Runs by what is known of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import Field

from api.answers.schemas import SearchList, Verdict
from api.answers.search import COEFFICIENT, OWN, Bound, Wanted, check_order, search_page
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import BeganDep, PageDep, PressName, StoreDep
from daq.store.records import RunStatus
from daq.words import say
from daq.words.message import ENGLISH, languages

router = APIRouter(tags=["runs"], responses=problem_responses(404))

Words = Annotated[str, Query(max_length=500, description="Words that must all occur in remark, header or name.")]
_BOUND = r"^\s*([A-Za-z][A-Za-z0-9_.-]*\s*(<=|>=|<|>|=)\s*[+-]?[0-9]+([.,][0-9]+)?([eE][+-]?[0-9]+)?\s*)?$"
_ORDER = rf"^-?(|{'|'.join(OWN)}|{COEFFICIENT}[\s\S]*|[\s\S]*\.[\s\S]*)$"
Where = Annotated[
    list[Annotated[str, Field(json_schema_extra={"pattern": _BOUND})]],
    Query(
        max_length=20,
        description="Bounds such as `core_at_opening_C>=95` or `panel.thickness_mm=16`, each once more: all hold.",
    ),
]
Order = Annotated[
    str,
    Query(
        max_length=200,
        description="A number to sort by, `-` before it for the largest first: `press_time_s`, `rmse_K`, "
        "`core_at_opening_C`, `core_peak_C`, `band_at_opening_K`, a coefficient such as `h_pp_c`, or a header "
        "key. Without, the newest first.",
        json_schema_extra={"pattern": _ORDER},  # described, not checked here: `check_order` refuses in words
    ),
]


@dataclass(frozen=True)
class Search:
    """What runs are asked for by."""

    q: Words = ""
    verdict: Annotated[Verdict | None, Query(description="Only panels that became this.")] = None
    press: PressName = None
    status: Annotated[RunStatus | None, Query(description="Only runs of this status.")] = None
    language: Annotated[str, Query(description="In which `q` may call the verdict, beside its code.")] = ENGLISH
    sort: Order = ""


@router.get("/search", operation_id="search_runs", summary="Runs by words and numbers")
def search_runs(
    store: StoreDep,
    query: Annotated[Search, Depends()],
    began: BeganDep,
    page: PageDep,
    where: Where = [],  # noqa: B006
) -> SearchList:
    """Return the runs for which all that is asked holds, with the numbers to compare them by."""
    if query.language not in languages():
        raise ProblemError(404, say("api-no-such-language", language=query.language, languages=languages()))
    check_order(query.sort)
    bounds = [Bound.parse(one) for one in where if one.strip()]
    asked = (query.press, query.status, *began.span, query.verdict, query.language, query.sort)
    wanted = Wanted(query.q.split(), bounds, *asked)
    return search_page(store, wanted, int(page.cursor or 0), page.limit)
