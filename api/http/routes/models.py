"""Coefficients, model versions, diagnoses and nights."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import HTMLResponse

from api.answers.drift import drift_of
from api.answers.nights import night_of
from api.answers.records import coefficient_points, diagnosis_of, model_summary
from api.answers.schemas import (
    CoefficientHistory,
    DiagnosisCurves,
    DiagnosisList,
    DriftList,
    ModelDetail,
    ModelList,
    NightList,
)
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import Cursor, PageSize, PressesDep, PressName, StoreDep, Writer
from daq.records import InputError
from daq.store.records import ModelRecord, Page, StoredDiagnosis, StoredNight
from daq.store.store import Store
from daq.words import say
from daq.words.message import ENGLISH, languages

_Row = TypeVar("_Row", StoredDiagnosis, StoredNight)
router = APIRouter(tags=["model"], responses=problem_responses())
Number = Annotated[int, Path(ge=1, le=2**31 - 2)]
"""Of a row; the next one is a cursor, and PostgreSQL counts in 32 bits."""
Language = Annotated[str, Query(description="Of the words in it.")]


@router.get("/coefficients", operation_id="list_coefficients", summary="History of the coefficients")
def list_coefficients(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 100
) -> CoefficientHistory:
    """Return the coefficients of each run's newest fit with their intervals, the run pressed last first."""
    page = store.coefficient_history(press=press, cursor=cursor, limit=limit)
    return CoefficientHistory(items=coefficient_points(store, page.items), next_cursor=page.next_cursor)


@router.get("/coefficients/drift", operation_id="list_drift", summary="Coefficients that have left what is usual")
def list_drift(store: StoreDep, presses: PressesDep) -> DriftList:
    """Return the changes the control charts over the fitted runs show now."""
    return DriftList(items=[drift for name in presses for drift in drift_of(store, name)])


@router.get("/models", operation_id="list_models", summary="Model versions, newest first")
def list_models(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 50
) -> ModelList:
    """Return one page of model versions."""
    return ModelList.of(store.models(press=press, cursor=cursor, limit=limit), model_summary)


@router.get(
    "/models/{version}",
    operation_id="get_model",
    summary="One model version",
    responses=problem_responses(404),
)
def get_model(store: StoreDep, version: str) -> ModelDetail:
    """Return a model version with its model file."""
    return _detail(_existing(store, version))


@router.post(
    "/models/{version}/promote",
    operation_id="promote_model",
    summary="Use a model version live",
    responses=problem_responses(404),
)
def promote_model(store: StoreDep, version: str, who: Writer) -> ModelDetail:
    """Make a version, newer or older, the live sensor's; needs a token with scope write."""
    _existing(store, version)
    store.promote_model(version, who, say("model-through-api"))
    return _detail(_existing(store, version))


@router.get("/diagnoses", operation_id="list_diagnoses", summary="What the simulation gets wrong, newest first")
def list_diagnoses(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 20
) -> DiagnosisList:
    """Return one page of diagnoses as `kerntemp diagnose --json` writes them."""
    return DiagnosisList.of(store.diagnoses(press=press, cursor=cursor, limit=limit), diagnosis_of)


@router.get("/nights", operation_id="list_nights", summary="What the nightly job did, newest first")
def list_nights(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 50
) -> NightList:
    """Return one page of nights: runs new, fitted and left out, time, memory, what was named and promoted."""
    return NightList.of(store.nights(press=press, cursor=cursor, limit=limit), night_of)


@router.get(
    "/diagnoses/{number}/curves",
    operation_id="get_diagnosis_curves",
    summary="A diagnosis as curves",
    responses=problem_responses(404),
)
def get_diagnosis_curves(store: StoreDep, number: Number) -> DiagnosisCurves:
    """Return one run measured and under both models, and what the models leave of all runs."""
    found = _numbered(store.diagnoses, number)
    if found is None or "curves" not in found.diagnosis:
        raise ProblemError(404, say("api-no-curves", number=number))
    return DiagnosisCurves(id=str(number), press=found.press, curves=found.diagnosis["curves"])


@router.get(
    "/nights/{number}/report",
    operation_id="get_night_report",
    summary="A night's page",
    response_class=HTMLResponse,
    responses=problem_responses(404),
)
def get_night_report(
    request: Request, store: StoreDep, number: Number, language: Language = ENGLISH
) -> HTMLResponse:
    """Return what the nightly job did and found for a press, with pictures, as a page of its own."""
    from softsensor.jobs.night_record import stored_night_record
    from softsensor.report.night_report import night_report

    if language not in languages():
        raise ProblemError(404, say("api-no-such-language", language=language, languages=languages()))
    found = _numbered(store.nights, number)
    if found is None:
        raise ProblemError(404, say("api-no-night", number=number))
    page = night_report(stored_night_record(store, found), language, str(request.base_url))
    return HTMLResponse(page, headers={"Content-Disposition": f'inline; filename="night-{number}.html"'})


def _numbered(pages: Callable[..., Page[_Row]], number: int) -> _Row | None:
    """Return the row of that number from a list that comes newest first, None where there is none."""
    return next((row for row in pages(cursor=str(number + 1), limit=1).items if row.number == number), None)


def _existing(store: Store, version: str) -> ModelRecord:
    try:
        return store.model(version)
    except InputError as error:
        raise ProblemError(404, say("api-model-unknown", version=version)) from error


def _detail(model: ModelRecord) -> ModelDetail:
    return ModelDetail(**model_summary(model).model_dump(), model=dict(model.model))
