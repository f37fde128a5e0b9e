"""Runs: the list, one run, its samples, estimates, fit, simulation and figure."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Depends, Header, Query
from fastapi.responses import FileResponse, JSONResponse, Response
from starlette.background import BackgroundTask

from api.answers.decimation import column_values, kept_rows, number_or_none
from api.answers.health import installed_version
from api.answers.records import run_detail, run_summaries
from api.answers.schemas import Estimates, Fit, RunDetail, RunList, SampleQuality, Samples
from api.http.caching import entity_tag, same_entity
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import BeganDep, PageDep, PressName, StoreDep, existing_run
from daq.files.qualities import spans_of
from daq.files.run_file import write_run
from daq.records import InputError, Run
from daq.store.records import RunRecord, RunStatus, ScansUnreadable, StoredEstimate
from daq.store.store import Store
from daq.words import say, spoken

router = APIRouter(tags=["runs"], responses=problem_responses(404))

MaxPoints = Annotated[
    int | None,
    Query(
        ge=2,
        le=1_000_000,
        description="At most this many rows, each as it was recorded: of every stretch of time those with the "
        "lowest and the highest value of each column. Every peak stays from two rows for each column on.",
    ),
]
FromTime = Annotated[
    float | None, Query(alias="from", allow_inf_nan=False, description="From this time of the run on. [s]")
]
ToTime = Annotated[
    float | None, Query(alias="to", allow_inf_nan=False, description="Up to this time of the run. [s]")
]


@dataclass(frozen=True)
class Part:
    """Which part of a run, and how finely."""

    from_s: FromTime = None
    to_s: ToTime = None
    max_points: MaxPoints = None


PartDep = Annotated[Part, Depends()]
MEDIA_TYPES = {"csv": "text/csv; charset=utf-8", "parquet": "application/vnd.apache.parquet"}


@router.get("/runs", operation_id="list_runs", summary="Runs, newest first")
def list_runs(
    store: StoreDep,
    began: BeganDep,
    part: PageDep,
    press: PressName = None,
    status: Annotated[RunStatus | None, Query(description="Only runs of this status.")] = None,
    material: Annotated[str | None, Query(description="Only panels of this material.", max_length=200)] = None,
) -> RunList:
    """Return one page of runs."""
    since, until = began.span
    page = store.runs(
        press=press,
        status=status,
        material=material or None,
        since=since,
        until=until,
        cursor=part.cursor,
        limit=part.limit,
    )
    return RunList(items=run_summaries(store, page.items), next_cursor=page.next_cursor)


@router.get("/runs/{run}", operation_id="get_run", summary="One run")
def get_run(store: StoreDep, run: str) -> RunDetail:
    """Return one run with its header, columns, phases, remark and every change of them."""
    return run_detail(store, existing_run(store, run))


@router.get(
    "/runs/{run}/samples",
    operation_id="get_samples",
    summary="The measured temperatures of a run",
    response_model=Samples,
    responses={
        200: {
            "content": {
                kind.partition(";")[0]: {"schema": {"type": "string", "format": "binary"}}
                for kind in MEDIA_TYPES.values()
            }
        }
    },
)
def get_samples(
    store: StoreDep,
    run: str,
    part: PartDep,
    format: Annotated[Literal["json", "csv", "parquet"], Query(description="How to answer.")] = "json",
    columns: Annotated[
        str | None, Query(description="Names of columns, comma between; all without.", max_length=4000)
    ] = None,
    if_none_match: Annotated[str, Header(include_in_schema=False)] = "",
) -> Response:
    """Return columns of a run between two times, decimated on request; CSV and Parquet are run files."""
    record = existing_run(store, run)
    names = [name.strip() for name in columns.split(",") if name.strip()] if columns else None
    if names == []:
        raise ProblemError(422, say("api-columns-empty", columns=str(columns)))
    tag = ""
    if format != "json":
        tag = _file_tag(store, record, (format, names, *astuple(part)))
        if same_entity(if_none_match, tag):
            return Response(status_code=304, headers={"ETag": tag, "Cache-Control": "no-cache"})
    try:
        load = store.load_run if format == "json" else store.run_for_file
        whole = load(run, names, part.from_s, part.to_s)
    except ScansUnreadable:
        raise
    except InputError as error:
        raise ProblemError(404, spoken(error)) from error
    shown = whole.at_rows(kept_rows(list(whole.columns.values()), len(whole.time_s), part.max_points))
    if format != "json":
        return _file_response(shown, format, tag)
    samples = Samples(
        run=run,
        rows=len(shown.time_s),
        decimated=len(shown.time_s) < len(whole.time_s),
        time_s=shown.time_s.tolist(),
        columns={name: column_values(values) for name, values in shown.columns.items()},
        quality=[SampleQuality(**asdict(span)) for span in spans_of(whole)],
    )
    return JSONResponse(samples.model_dump())


@router.get("/runs/{run}/estimates", operation_id="get_estimates", summary="What the live sensor said in a run")
def get_estimates(store: StoreDep, run: str, part: PartDep) -> Estimates:
    """Return the live core temperature and its band."""
    existing_run(store, run)
    low = -math.inf if part.from_s is None else part.from_s
    high = math.inf if part.to_s is None else part.to_s
    chosen = [(t, e) for t, e in _estimates_of(store, run) if low <= t <= high]
    rows = len(chosen)
    bands = np.array([(e.core_celsius, e.core_low_celsius, e.core_high_celsius) for _, e in chosen])
    chosen = [chosen[i] for i in kept_rows(list(bands.reshape(rows, 3).T), rows, part.max_points)]
    return _estimates(run, chosen, decimated=len(chosen) < rows)


@router.get("/runs/{run}/fit", operation_id="get_fit", summary="The coefficients of a run")
def get_fit(store: StoreDep, run: str) -> Fit:
    """Return the newest fit of a run, as `kerntemp fit --json` reports it."""
    existing_run(store, run)
    fit = store.fit(run)
    if fit is None:
        raise ProblemError(404, say("api-run-not-fitted", run=run))
    return Fit(**fit)


def _estimates_of(store: Store, run: str) -> Sequence[tuple[float, StoredEstimate]]:
    try:
        return store.estimates(run)
    except ScansUnreadable:
        raise
    except InputError as error:  # given up by rule
        raise ProblemError(404, spoken(error)) from error


def _estimates(run: str, chosen: Sequence[tuple[float, StoredEstimate]], *, decimated: bool) -> Estimates:
    details = [e.detail or {} for _, e in chosen]
    return Estimates(
        run=run,
        rows=len(chosen),
        decimated=decimated,
        time_s=[t for t, _ in chosen],
        state=[str(e.state) for _, e in chosen],
        core_C=[number_or_none(e.core_celsius) for _, e in chosen],
        core_sd_K=[number_or_none(e.core_sd_kelvin) for _, e in chosen],
        core_low_C=[number_or_none(e.core_low_celsius) for _, e in chosen],
        core_high_C=[number_or_none(e.core_high_celsius) for _, e in chosen],
        valid=[e.valid for _, e in chosen],
        cure_low=[d.get("cure_low") for d in details],
        grade=[str(d.get("grade", "")) for d in details],
        steam_high_kPa=[d.get("steam_high_kPa") for d in details],
    )


def _file_tag(store: Store, record: RunRecord, query: tuple[object, ...]) -> str:
    """Return the entity tag of a run file: the same as long as run, header and question are."""
    newest = record.last_scan if record.last_scan is not None else store.newest_scan_number(record.press)
    state = (installed_version(), record.run, record.first_scan, newest, str(record.status), record.moments)
    return entity_tag(repr((*state, sorted(record.header.items()), record.remark, query)).encode())


def _file_response(run: Run, kind: Literal["csv", "parquet"], tag: str) -> FileResponse:
    """Answer with a run file; it is written beside the memory and streamed from there."""
    folder = tempfile.TemporaryDirectory(prefix="kerntemp-")
    path = Path(folder.name) / f"run.{kind}"
    write_run(run, path)
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in run.name) or "run"
    answer = FileResponse(
        path,
        media_type=MEDIA_TYPES[kind],
        filename=f"{name}.{kind}",
        headers={"ETag": tag, "Cache-Control": "no-cache"},
        background=BackgroundTask(folder.cleanup),
        stat_result=path.stat(),
    )
    del answer.headers["last-modified"]  # of the file just written, not of the run
    return answer
