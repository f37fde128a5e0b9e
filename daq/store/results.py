"""What sensor, nightly job and every process write and read beyond scans: estimates, fits, models, the journal."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    Table,
    func,
    insert,
    literal_column,
    or_,
    select,
    update,
)

from daq.records import InputError, PressState
from daq.store.archived import archived_estimates
from daq.store.convert import known_utc, nan, null, to_json, unix_of, utc_of
from daq.store.estimate_file import EstimateRow
from daq.store.journal import log
from daq.store.nights import forget_unfitted
from daq.store.reading import cursor_number, newest_first, of_press, recorded_id, run_row
from daq.store.records import (
    CoefficientRecord,
    ModelRecord,
    ModelStatus,
    Page,
    ProcessStatus,
    StoredDiagnosis,
    StoredEstimate,
)
from daq.store.schema import COEFFICIENT, DIAGNOSIS, ESTIMATE, FIT, MODEL, NEWEST_FIT, PRESS, RUN, STATUS
from daq.store.upsert import put
from daq.words import Message, say


def _now() -> float:
    return unix_of(datetime.now(UTC))


def append_estimates(connection: Connection, press: str, estimates: Sequence[StoredEstimate]) -> None:
    """Write the live sensor's estimates; a second estimate of a scan replaces the first."""
    press_id = recorded_id(connection, press)
    if press_id is None or not estimates:
        return
    rows = [
        {
            "press_id": press_id,
            "number": e.number,
            "monotonic_s": e.monotonic_s,
            "state": str(e.state),
            "core_celsius": null(e.core_celsius),
            "core_sd_kelvin": null(e.core_sd_kelvin),
            "core_low_celsius": null(e.core_low_celsius),
            "core_high_celsius": null(e.core_high_celsius),
            "valid": int(e.valid),
            "reason": e.reason,
            "model_version": e.model_version,
            "detail_json": None if e.detail is None else to_json(e.detail),
        }
        for e in estimates
    ]
    put(connection, ESTIMATE, rows)


def _estimate(row: Row[Any] | EstimateRow) -> StoredEstimate:
    return StoredEstimate(
        row.number,
        row.monotonic_s,
        "unknown" if row.state not in set(PressState) else PressState(row.state),
        nan(row.core_celsius),
        nan(row.core_sd_kelvin),
        nan(row.core_low_celsius),
        nan(row.core_high_celsius),
        bool(row.valid),
        row.reason,
        row.model_version,
        None if row.detail_json is None else json.loads(row.detail_json),
    )


def estimates_after(
    connection: Connection, press: str, last_number: int, limit: int = 1000
) -> tuple[StoredEstimate, ...]:
    """Return the estimates of a recorded press that follow scan `last_number`."""
    query = (
        select(ESTIMATE)
        .where(ESTIMATE.c.press_id == recorded_id(connection, press), ESTIMATE.c.number > last_number)
        .order_by(ESTIMATE.c.number)
        .limit(limit)
    )
    return tuple(_estimate(row) for row in connection.execute(query).all())


def newest_estimate_number(connection: Connection, press: str) -> int:
    """Return the scan of the newest estimate, -1 where there is none."""
    newest = select(func.max(ESTIMATE.c.number)).where(ESTIMATE.c.press_id == recorded_id(connection, press))
    number = connection.execute(newest).scalar()
    return -1 if number is None else int(number)


def last_scan_followed(connection: Connection, press: str) -> int:
    """Return the scan of the newest estimate, or the one before the newest run where that lacks some till there.

    The sensor writes in order, but goes back when a run turns out to have begun before: a kill may come between.
    """
    newest, press_id = newest_estimate_number(connection, press), recorded_id(connection, press)
    first = select(func.max(RUN.c.first_scan)).where(RUN.c.press_id == press_id, RUN.c.first_scan <= newest)
    begun = connection.execute(first).scalar()
    if begun is None:
        return newest
    until = select(RUN.c.last_scan).where(RUN.c.press_id == press_id, RUN.c.first_scan == begun)
    end = min(newest, connection.execute(until).scalar() or newest)
    own = (ESTIMATE.c.press_id == press_id, ESTIMATE.c.number.between(begun, end))
    estimated = connection.execute(select(func.count()).where(*own)).scalar_one()
    return newest if estimated == end - begun + 1 else int(begun) - 1


def estimates_of(connection: Connection, run: str) -> tuple[tuple[float, StoredEstimate], ...]:
    """Return time in the run and estimate, for each scan of a run that has one."""
    row = run_row(connection, run)
    query = select(ESTIMATE).where(ESTIMATE.c.press_id == row.press_id, ESTIMATE.c.number >= row.first_scan)
    if row.last_scan is not None:
        query = query.where(ESTIMATE.c.number <= row.last_scan)
    archived = archived_estimates(connection, run)
    found = connection.execute(query.order_by(ESTIMATE.c.number)).all() if archived is None else archived
    return tuple((round(e.monotonic_s - row.zero_monotonic_s, 6), _estimate(e)) for e in found)


def put_fit(connection: Connection, run: str, fit: Mapping[str, Any], model_version: str = "") -> int:
    """Keep a run's fit, one entry of ``runs`` of ``fit --json``; the newest fit of a run counts."""
    press_id = run_row(connection, run).press_id
    row = {
        "run": run,
        "created_unix_s": _now(),
        "model_version": model_version,
        "converged": int(bool(fit.get("converged", False))),
        "rmse_kelvin": null(fit.get("rmse_K")),
        "fit_json": to_json(fit),
    }
    fit_id = _key(connection, FIT, row)
    put(connection, NEWEST_FIT, [{"press_id": press_id, "fit_id": fit_id}])
    coefficients = [
        {
            "fit_id": fit_id,
            "name": name,
            "value_w_m2k": null(value.get("value")),
            "sd_w_m2k": null(value.get("sd")),
            "low_w_m2k": null((value.get("ci95") or (None, None))[0]),
            "high_w_m2k": null((value.get("ci95") or (None, None))[1]),
            "identifiable": int(bool(value.get("identifiable", True))),
        }
        for name, value in fit.get("coefficients", {}).items()
    ]
    if coefficients:
        connection.execute(insert(COEFFICIENT), coefficients)
    forget_unfitted(connection, run)
    return fit_id


def fit_of(connection: Connection, run: str) -> dict[str, Any] | None:
    """Return the newest fit of a run as JSON, with ``model_version``; None where it was never fitted."""
    row = connection.execute(select(FIT).where(FIT.c.run == run).order_by(FIT.c.fit_id.desc()).limit(1)).first()
    return None if row is None else {**json.loads(row.fit_json), "model_version": row.model_version}


def fits_of(connection: Connection, runs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the newest fit of each run that has one, as `fit_of` does, by one query."""
    rows = connection.execute(_newest_fits((FIT,), runs)).all()
    return {r.run: {**json.loads(r.fit_json), "model_version": r.model_version} for r in rows}


def fit_errors(connection: Connection, runs: Sequence[str]) -> dict[str, float | None]:
    """Return ``rmse_K`` of the newest fit of each run that has one."""
    rows = connection.execute(_newest_fits((FIT.c.run, FIT.c.rmse_kelvin), runs)).all()
    return {r.run: r.rmse_kelvin for r in rows}


def _newest_fits(columns: Sequence[Any], runs: Sequence[str]) -> Any:
    newest = select(func.max(FIT.c.fit_id)).where(FIT.c.run.in_(runs)).group_by(FIT.c.run)
    return select(*columns).where(FIT.c.fit_id.in_(newest))


def coefficient_history(
    connection: Connection, *, press: str | None = None, cursor: str | None = None, limit: int = 200
) -> Page[CoefficientRecord]:
    """Return the coefficients of the newest fit of each run, the run pressed last first; `limit` counts runs.

    A cursor is the number of the last run of the page before. Runs that say the same start come as stored, those
    of unknown time last.
    """
    start = func.coalesce(RUN.c.started_unix_s, literal_column("-1.0"))  # as in the indexes by start
    newest = select(func.max(FIT.c.fit_id)).where(FIT.c.run == RUN.c.run).scalar_subquery()
    fitted = select(FIT.c.fit_id).where(FIT.c.run == RUN.c.run)
    query: Select[Any] = (
        select(RUN.c.run_number, RUN.c.run, RUN.c.started_unix_s, start.label("start"), newest.label("fit_id"))
        .where(fitted.exists())
        .order_by(start.desc(), RUN.c.run_number.desc())
        .limit(limit + 1)
    )
    if cursor is not None:
        number = cursor_number(cursor)
        last = select(start).where(RUN.c.run_number == number).scalar_subquery()
        query = query.where(start <= last, or_(start < last, RUN.c.run_number < number))
    if press is None:
        found = list(connection.execute(query).all())
    else:
        found = of_press(connection, query, RUN.c.press_id, press, lambda row: (row.start, row.run_number))
        found = found[: limit + 1]
    page = {run.fit_id: (run.run, utc_of(run.started_unix_s)) for run in found[:limit]}
    rows = connection.execute(
        select(COEFFICIENT, FIT.c.model_version)
        .join(FIT, FIT.c.fit_id == COEFFICIENT.c.fit_id)
        .where(*_of_fits(page))
        .order_by(COEFFICIENT.c.fit_id, COEFFICIENT.c.name)
    ).all()
    by_fit: dict[int, list[CoefficientRecord]] = {fit: [] for fit in page}
    for r in rows:
        values = (nan(r.value_w_m2k), nan(r.sd_w_m2k), nan(r.low_w_m2k), nan(r.high_w_m2k))
        own = CoefficientRecord(r.fit_id, *page[r.fit_id], r.name, *values, bool(r.identifiable), r.model_version)
        by_fit[r.fit_id].append(own)
    items = tuple(record for records in by_fit.values() for record in records)
    return Page(items, str(found[limit - 1].run_number) if len(found) > limit else None)


def _of_fits(fits: Collection[int]) -> list[ColumnElement[bool]]:
    """Return the condition for coefficients of these fits.

    Of the list alone, a server's own guess is to go through the whole table; a span says more where it is narrow.
    """
    low, high = min(fits, default=0), max(fits, default=0)
    narrow = high - low < 4 * len(fits)
    return [COEFFICIENT.c.fit_id.in_(fits), *([COEFFICIENT.c.fit_id.between(low, high)] if narrow else [])]


def newest_fit_number(connection: Connection, press: str | None = None, after: int = 0) -> int:
    """Return the number of the fit stored last, of a press or of all, 0 where none is newer than fit `after`."""
    query = select(func.max(FIT.c.fit_id))
    if press is not None:
        query = select(func.max(NEWEST_FIT.c.fit_id)).join(PRESS, PRESS.c.press_id == NEWEST_FIT.c.press_id)
        query = query.where(PRESS.c.name == press)
    newest = connection.execute(query).scalar() or 0
    return int(newest) if newest > after else 0


def fits_after(connection: Connection, number: int, limit: int = 200) -> tuple[tuple[int, str], ...]:
    """Return number and run of the newest fits of runs stored after fit `number`, oldest first."""
    newer = FIT.alias("newer")
    superseded = select(newer.c.fit_id).where(newer.c.run == FIT.c.run, newer.c.fit_id > FIT.c.fit_id)
    query = select(FIT.c.fit_id, FIT.c.run).where(FIT.c.fit_id > number, ~superseded.exists())
    rows = connection.execute(query.order_by(FIT.c.fit_id.desc()).limit(limit)).all()
    return tuple((row.fit_id, row.run) for row in reversed(rows))


def put_model(
    connection: Connection,
    press: str,
    version: str,
    model: Mapping[str, Any],
    *,
    status: ModelStatus = ModelStatus.CANDIDATE,
    reason: str = "",
) -> int:
    """Keep a model version; raises `InputError` where the version exists."""
    if connection.execute(select(MODEL.c.version).where(MODEL.c.version == version)).first():
        raise InputError(say("model-version-taken", version=version))
    row = {
        "version": version,
        "press": press,
        "created_unix_s": _now(),
        "status": ModelStatus(status).value,
        "reason": reason,
        "model_json": to_json(model),
    }
    return _key(connection, MODEL, row)


def promote_model(connection: Connection, version: str, who: str, reason: Message | str = "") -> None:
    """Make a version the one the live sensor uses; the one before is retired.

    The journal keeps who did it and why; the version's own reason, which is its evidence, stays.
    """
    press = connection.execute(select(MODEL.c.press).where(MODEL.c.version == version)).scalar()
    if press is None:
        raise InputError(say("model-version-missing", version=version))
    own = select(MODEL.c.model_number).where(MODEL.c.press == press).order_by(MODEL.c.model_number)
    connection.execute(own.with_for_update()).all()  # one after another: at most one is in force
    current = (MODEL.c.press == press, MODEL.c.status == ModelStatus.PROMOTED.value, MODEL.c.version != version)
    connection.execute(update(MODEL).where(*current).values(status=ModelStatus.RETIRED.value))
    connection.execute(update(MODEL).where(MODEL.c.version == version).values(status=ModelStatus.PROMOTED.value))
    detail: dict[str, Any] = {"reason": str(reason)}
    if isinstance(reason, Message):
        detail["reason_said"] = reason.to_json()
    log(connection, "info", who, say("model-promoted", version=version), press, detail)


def active_model(connection: Connection, press: str) -> ModelRecord | None:
    """Return the promoted model of a press, or None."""
    promoted = MODEL.c.press == press, MODEL.c.status == ModelStatus.PROMOTED.value
    row = connection.execute(select(MODEL).where(*promoted)).first()
    return None if row is None else _model(row)


def model(connection: Connection, version: str) -> ModelRecord:
    """Return one version; raises `InputError` where there is none."""
    row = connection.execute(select(MODEL).where(MODEL.c.version == version)).first()
    if row is None:
        raise InputError(say("model-version-missing", version=version))
    return _model(row)


def models(
    connection: Connection,
    *,
    press: str | None = None,
    cursor: str | None = None,
    limit: int = 50,
    until: datetime | None = None,
) -> Page[ModelRecord]:
    """Return a page of model versions, newest first; with `until` of those made before."""
    rows, following = newest_first(connection, MODEL, press, cursor, limit, until)
    return Page(tuple(_model(row) for row in rows), following)


def _model(r: Row[Any]) -> ModelRecord:
    created, content = known_utc(r.created_unix_s), json.loads(r.model_json)
    return ModelRecord(r.model_number, r.version, r.press, created, ModelStatus(r.status), r.reason, content)


def put_diagnosis(connection: Connection, press: str, diagnosis: Mapping[str, Any]) -> int:
    """Keep a diagnosis as ``diagnose --json`` writes it."""
    row = {
        "press": press,
        "created_unix_s": _now(),
        "verdict": str(diagnosis.get("verdict", "")),
        "diagnosis_json": to_json(diagnosis),
    }
    return _key(connection, DIAGNOSIS, row)


def diagnoses(
    connection: Connection,
    *,
    press: str | None = None,
    cursor: str | None = None,
    limit: int = 50,
    until: datetime | None = None,
) -> Page[StoredDiagnosis]:
    """Return a page of diagnoses, newest first; with `until` of those made before."""
    rows, following = newest_first(connection, DIAGNOSIS, press, cursor, limit, until)
    items = tuple(
        StoredDiagnosis(
            r.diagnosis_id, r.press, known_utc(r.created_unix_s), r.verdict, json.loads(r.diagnosis_json)
        )
        for r in rows
    )
    return Page(items, following)


def beat(connection: Connection, process: str, status: Mapping[str, Any]) -> None:
    """Write a process's sign of life."""
    put(connection, STATUS, [{"process": process, "unix_s": _now(), "status_json": to_json(status)}])


def statuses(connection: Connection) -> dict[str, ProcessStatus]:
    """Return the newest sign of life of each process."""
    rows = connection.execute(select(STATUS)).all()
    return {r.process: ProcessStatus(r.process, known_utc(r.unix_s), json.loads(r.status_json)) for r in rows}


def _key(connection: Connection, table: Table, row: Mapping[str, Any]) -> int:
    key = connection.execute(insert(table), dict(row)).inserted_primary_key
    if key is None:
        raise AssertionError("insert gave no key")
    return int(key[0])
