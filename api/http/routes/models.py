"""Coefficients, model versions, diagnoses and nights."""

from __future__ import annotations

from fastapi import APIRouter

from api.answers.drift import drift_of
from api.answers.nights import night_of
from api.answers.records import coefficient_points, model_summary, parameter_words
from api.answers.schemas import (
    CoefficientHistory,
    DiagnosisList,
    DiagnosisRecord,
    DriftList,
    ModelDetail,
    ModelList,
    NightList,
)
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import Cursor, PageSize, PressName, StoreDep, Writer
from daq.records import InputError
from daq.store.records import ModelRecord
from daq.store.store import Store
from daq.words import say

router = APIRouter(tags=["model"], responses=problem_responses())


@router.get("/coefficients", operation_id="list_coefficients", summary="History of the coefficients")
def list_coefficients(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 100
) -> CoefficientHistory:
    """Return the coefficients of each run's newest fit with their intervals, the run pressed last first."""
    page = store.coefficient_history(press=press, cursor=cursor, limit=limit)
    return CoefficientHistory(items=coefficient_points(store, page.items), next_cursor=page.next_cursor)


@router.get("/coefficients/drift", operation_id="list_drift", summary="Coefficients that have left what is usual")
def list_drift(store: StoreDep, press: PressName = None) -> DriftList:
    """Return the changes the control charts over the fitted runs show now."""
    chosen = store.presses() if press is None else [press]
    return DriftList(items=[drift for name in chosen for drift in drift_of(store, name)])


@router.get("/models", operation_id="list_models", summary="Model versions, newest first")
def list_models(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 50
) -> ModelList:
    """Return one page of model versions."""
    page = store.models(press=press, cursor=cursor, limit=limit)
    return ModelList(items=[model_summary(model) for model in page.items], next_cursor=page.next_cursor)


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
    page = store.diagnoses(press=press, cursor=cursor, limit=limit)
    items = [
        DiagnosisRecord(
            id=str(d.number),
            press=d.press,
            utc=d.created_utc,
            verdict=d.verdict,
            diagnosis=dict(d.diagnosis),
            parameters=parameter_words(e["name"] for e in d.diagnosis.get("effects", ())),
        )
        for d in page.items
    ]
    return DiagnosisList(items=items, next_cursor=page.next_cursor)


@router.get("/nights", operation_id="list_nights", summary="What the nightly job did, newest first")
def list_nights(
    store: StoreDep, press: PressName = None, cursor: Cursor = None, limit: PageSize = 50
) -> NightList:
    """Return one page of nights: runs new, fitted and left out, time, memory, what was named and promoted."""
    page = store.nights(press=press, cursor=cursor, limit=limit)
    return NightList(items=[night_of(night) for night in page.items], next_cursor=page.next_cursor)


def _existing(store: Store, version: str) -> ModelRecord:
    try:
        return store.model(version)
    except InputError as error:
        raise ProblemError(404, say("api-model-unknown", version=version)) from error


def _detail(model: ModelRecord) -> ModelDetail:
    return ModelDetail(**model_summary(model).model_dump(), model=dict(model.model))
