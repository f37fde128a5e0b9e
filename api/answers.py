"""From the store's records to the API's answers: plain functions, no web framework."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from statistics import median
from typing import Any, Literal

from api.schemas import (
    ChannelNow,
    CoefficientFit,
    CoefficientPoint,
    EstimateNow,
    Faces,
    ModelSummary,
    Phase,
    PressNow,
    RunSummary,
    State,
    Target,
)
from daq.pressfile import parse_press
from daq.records import Array, Channel, InputError, Quality, Scan
from daq.store.records import (
    CoefficientRecord,
    ModelRecord,
    ProcessStatus,
    RunRecord,
    RunStatus,
    StoredEstimate,
    StoredPressEvent,
)
from daq.store.store import Store

STATE_AFTER: Mapping[str, State] = {
    "inserted": "open",
    "closed": "closed",
    "opened": "open",
    "removed": "idle",
}
TREND_S = 5.0
"""How far back the rate of heating is taken from. [s]"""

KEPT_MODELS = 16
_IN_USE: dict[tuple[object, ...], dict[str, float]] = {}
_IN_USE_LOCK = threading.Lock()

Role = Literal["platen", "top", "bottom", "core", "other"]
_ROLES: tuple[Role, ...] = ("platen", "top", "bottom", "core")


def number_or_none(value: float | None) -> float | None:
    """Return a number JSON can carry: None for NaN and infinities."""
    return None if value is None or not math.isfinite(value) else float(value)


def column_values(values: Array) -> list[float | None]:
    """Return a column for JSON, NaN as null, rounded to 0.1 mK."""
    return [None if not math.isfinite(v) else round(v, 4) for v in values.tolist()]


def role_of(channel: str) -> Role:
    """Tell platen, face and core channels apart by the contract's column names."""
    return next((role for role in _ROLES if channel.startswith(role)), "other")


def phases_of(run: RunRecord) -> list[Phase]:
    """Return what the press did during a run, as the recorder found it live."""
    moments = run.moments
    steps: list[tuple[float, State]] = [
        (moments.inserted_s, "open"),
        (moments.closed_s, "closed"),
        (moments.opened_s, "open"),
        (moments.removed_s, "idle"),
    ]
    known = [(at, state) for at, state in steps if math.isfinite(at)]
    ends = [*(at for at, _ in known[1:]), None][: len(known)]
    return [Phase(state=state, from_s=at, to_s=end) for (at, state), end in zip(known, ends, strict=True)]


def run_summary(store: Store, run: RunRecord) -> RunSummary:
    """Return a run as lists show it."""
    fit = store.fit(run.run)
    duration = (run.ended_utc - run.started_utc).total_seconds() if run.ended_utc else None
    newest = run.last_scan if run.last_scan is not None else store.newest_scan_number(run.press)
    return RunSummary(
        run=run.run,
        press=run.press,
        status=str(run.status),
        started_utc=run.started_utc,
        ended_utc=run.ended_utc,
        duration_s=duration,
        scans=max(newest - run.first_scan + 1, 0),
        material=str(run.header.get("panel.material", "")),
        thickness_mm=_header_number(run, "panel.thickness_mm"),
        platen_temperature_C=_header_number(run, "setting.platen_temperature_C"),
        closed_s=number_or_none(run.moments.closed_s),
        opened_s=number_or_none(run.moments.opened_s),
        rmse_K=fit.get("rmse_K") if fit else None,
        fitted=fit is not None,
    )


def remarks_of(store: Store, run: RunRecord) -> list[str]:
    """Return what people wrote about a run and changed in it."""
    written = [run.remark] if run.remark else []
    changes = [
        f"{change.utc:%Y-%m-%d %H:%M} {change.who}: {change.field} {change.before!r} → {change.after!r}"
        for change in store.run_changes(run.run)
        if change.field != "remark"
    ]
    return written + changes


def _header_number(run: RunRecord, key: str) -> float | None:
    value = run.header.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def estimate_now(estimate: StoredEstimate, run: RunRecord | None, utc: datetime | None) -> EstimateNow:
    """Return one estimate as the API shows it; its time counts from the run's first row."""
    return EstimateNow(
        run=run.run if run else None,
        number=estimate.number,
        utc=utc,
        time_s=round(estimate.monotonic_s - run.zero_monotonic_s, 6) if run else None,
        state=str(estimate.state),
        core_C=number_or_none(estimate.core_celsius),
        core_sd_K=number_or_none(estimate.core_sd_kelvin),
        core_low_C=number_or_none(estimate.core_low_celsius),
        core_high_C=number_or_none(estimate.core_high_celsius),
        valid=estimate.valid,
        reason=estimate.reason,
    )


def run_of_scan(runs: Iterable[RunRecord], number: int) -> RunRecord | None:
    """Return the run a scan belongs to."""
    for run in runs:
        if run.first_scan <= number and (run.last_scan is None or number <= run.last_scan):
            return run
    return None


def state_of(events: Sequence[StoredPressEvent], run: RunRecord | None) -> State:
    """Return the press's state: what its last event of the open run left it in."""
    if run is None or run.status is not RunStatus.OPEN:
        return "idle"
    return STATE_AFTER.get(events[-1].kind, "unknown") if events else "idle"


def target_of(run: RunRecord | None, recent: Sequence[StoredEstimate]) -> Target | None:
    """Return the core temperature to reach (`setting.core_target_C`) and when, at the present rate."""
    wanted = _header_number(run, "setting.core_target_C") if run else None
    if wanted is None:
        return None
    valid = [e for e in recent if e.valid and math.isfinite(e.core_celsius)]
    if not valid:
        return Target(temperature_C=wanted, reached=False, time_to_target_s=None)
    last = valid[-1]
    if any(e.core_celsius >= wanted for e in valid):
        return Target(temperature_C=wanted, reached=True, time_to_target_s=0.0)
    window = [e for e in valid if e.monotonic_s >= last.monotonic_s - TREND_S]
    elapsed = last.monotonic_s - window[0].monotonic_s
    rate = (last.core_celsius - window[0].core_celsius) / elapsed if elapsed > TREND_S / 5 else 0.0
    left = (wanted - last.core_celsius) / rate if rate > 0.01 else None
    return Target(temperature_C=wanted, reached=False, time_to_target_s=None if left is None else round(left, 1))


def press_now(store: Store, press: str, press_file: str, now: datetime) -> PressNow:
    """Return one press as it stands."""
    run = store.open_run(press)
    shown = run or next(iter(store.runs(press=press, limit=1).items), None)
    events = store.press_events(press, since_scan=run.first_scan) if run else []
    number = store.newest_scan_number(press)
    batch = store.scans_after(press, number - 1, 1)
    scan = batch.scans[-1] if batch.scans else None
    recent = store.estimates_after(press, number - 200, 400)
    time_s = scan.monotonic_s - run.zero_monotonic_s if run and scan else None
    closed_s = run.moments.closed_s if run else math.nan
    estimate = None
    if recent:
        newest = recent[-1]
        home = run_of_scan([shown] if shown else [], newest.number)
        estimate = estimate_now(newest, home, scan.utc if scan else None)
    channels = channels_now(store, press, batch.channels, scan, now)
    return PressNow(
        press=press,
        state=state_of(events, run),
        since_utc=events[-1].utc if events else None,
        run=shown.run if shown else None,
        run_status=str(shown.status) if shown else None,
        time_s=None if time_s is None else round(time_s, 3),
        time_since_closing_s=round(time_s - closed_s, 3)
        if time_s is not None and math.isfinite(closed_s)
        else None,
        phases=phases_of(shown) if shown else [],
        channels=channels,
        faces=faces_of(channels),
        estimate=estimate,
        target=target_of(run, recent),
        coefficients=coefficients_in_use(store, press, press_file),
        description=press_description(press_file),
    )


def faces_of(channels: Sequence[ChannelNow]) -> Faces:
    """Return the median of the good sensors at platens and faces."""

    def middle(start: str) -> float | None:
        good = [
            c.temperature_C
            for c in channels
            if c.name.startswith(start) and c.temperature_C is not None and Quality(c.quality).usable
        ]
        return round(median(good), 3) if good else None

    return Faces(
        platen_top_C=middle("platen_top"),
        platen_bottom_C=middle("platen_bottom"),
        top_C=middle("top"),
        bottom_C=middle("bottom"),
    )


def coefficients_in_use(store: Store, press: str, press_file: str) -> dict[str, float]:
    """Return what the live sensor starts from: the promoted model and the newest fits, else the guesses."""
    active = store.active_model(press)
    newest = store.coefficient_history(press=press, limit=1).items
    key = (store.label, press, press_file, active.version if active else "", newest[0].fit_number if newest else 0)
    with _IN_USE_LOCK:
        if key not in _IN_USE:
            _IN_USE[key] = _coefficients(store, press, press_file, active)
            while len(_IN_USE) > KEPT_MODELS:
                del _IN_USE[next(iter(_IN_USE))]
        return _IN_USE[key]


def _coefficients(store: Store, press: str, press_file: str, active: ModelRecord | None) -> dict[str, float]:
    from softsensor.modelfile import parse_model
    from softsensor.recent import NEWEST_RUNS, PRESS_FILE, up_to_date

    if not press_file:
        return {}
    try:
        described = parse_press(press_file)
        base = parse_model(active.model, f"model {active.version}") if active else None
    except InputError:
        return {}
    version = base.version if base else PRESS_FILE
    found = [store.fit(run.run) for run in store.runs(press=press, limit=NEWEST_RUNS + 1).items]
    fits = [fit for fit in found if fit is not None and fit.get("model_version") == version]
    model = up_to_date(described, base, fits[:NEWEST_RUNS])
    guesses = {name: described.coefficient(name).guess for name in described.coefficient_names}
    return guesses | ({name: e.value for name, e in model.coefficients.items()} if model else {})


def press_description(press_file: str) -> dict[str, Any]:
    """Return the press file as JSON, empty where none was kept."""
    if not press_file:
        return {}
    try:
        return parse_press(press_file).model_dump(mode="json")
    except InputError as error:
        return {"error": str(error)}


def channels_now(
    store: Store, press: str, channels: Sequence[Channel], scan: Scan | None, now: datetime
) -> list[ChannelNow]:
    """Return each channel's last value, and what the recorder says about its logger."""
    reported = channel_reports(store.statuses(), press)
    names = [channel.name for channel in channels or store.channels(press)]
    values = dict(zip(names, scan.values, strict=True)) if scan else {}
    qualities = dict(zip(names, scan.qualities, strict=True)) if scan else {}
    return [
        _channel(press, name, scan, values.get(name), qualities.get(name, Quality.MISSING), reported, now)
        for name in names
    ]


def _channel(
    press: str,
    name: str,
    scan: Scan | None,
    value: float | None,
    quality: Quality,
    reported: Mapping[str, Mapping[str, Any]],
    now: datetime,
) -> ChannelNow:
    report = reported.get(name, {})
    last_good = report.get("last_good_utc")
    if last_good is None and scan is not None and quality.usable:
        last_good = scan.utc
    counters = {k: int(v) for k, v in report.get("counters", {}).items() if isinstance(v, int | float)}
    return ChannelNow(
        press=press,
        name=name,
        logger=str(report.get("logger", "")),
        role=role_of(name),
        temperature_C=number_or_none(value),
        quality=str(quality),
        utc=scan.utc if scan else None,
        last_good_utc=last_good,
        age_s=round((now - scan.utc).total_seconds(), 3) if scan else None,
        counters=counters,
    )


def channel_reports(statuses: Mapping[str, ProcessStatus], press: str) -> dict[str, Mapping[str, Any]]:
    """Return what the recorder's heartbeat says about each channel of a press."""
    reports: dict[str, Mapping[str, Any]] = {}
    for status in statuses.values():
        for logger in status.status.get("loggers", []):
            if isinstance(logger, Mapping) and logger.get("press", press) == press:
                for channel in logger.get("channels", []):
                    reports[str(channel)] = {**logger, "logger": logger.get("name", "")}
    return reports


def coefficient_points(
    store: Store, records: Sequence[CoefficientRecord], presses: Mapping[str, RunRecord]
) -> list[CoefficientPoint]:
    """Group coefficients by run, in the order given."""
    grouped: dict[str, list[CoefficientRecord]] = {}
    for record in records:
        grouped.setdefault(record.run, []).append(record)
    points = []
    for run, entries in grouped.items():
        fit = store.fit(run) or {}
        given = {name: CoefficientFit(**c) for name, c in fit.get("coefficients", {}).items()}
        home = presses[run]
        points.append(
            CoefficientPoint(
                run=run,
                press=home.press,
                utc=entries[0].started_utc,
                coefficients=given,
                rmse_K=fit.get("rmse_K"),
                initial_rmse_K=fit.get("initial_rmse_K"),
                settings=_settings(home),
            )
        )
    return points


def _settings(run: RunRecord) -> dict[str, float]:
    return {
        key: float(value)
        for key, value in run.header.items()
        if key.startswith("setting.") and isinstance(value, int | float) and not isinstance(value, bool)
    }


def model_summary(model: ModelRecord) -> ModelSummary:
    """Return a model version as lists show it."""
    return ModelSummary(
        version=model.version,
        press=model.press,
        utc=model.created_utc,
        status=model.status,
        current=model.status == "promoted",
        effects=[str(effect.get("name", effect)) for effect in model.model.get("effects", [])],
        reason=model.reason,
    )


def utc_now() -> datetime:
    """Return the present instant."""
    return datetime.fromtimestamp(time.time(), UTC)
