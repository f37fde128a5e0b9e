"""From the store's records to the API's answers: plain functions, no web framework."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from api.answers.advice import advice_of
from api.answers.channels import channels_now, faces_now
from api.answers.decimation import number_or_none
from api.answers.kept import PRESSES, Kept
from api.answers.present import Present, age_of, is_of_now, leave_of, present_of, steps_of
from api.answers.schemas import (
    CoefficientFit,
    CoefficientPoint,
    DiagnosisRecord,
    EstimateNow,
    LastCore,
    ModelSummary,
    ParameterWords,
    Phase,
    PressNow,
    RunDetail,
    RunEdit,
    RunSummary,
    Said,
    Target,
)
from api.answers.words import message_answer
from daq.press.header import VERDICT, doubts
from daq.press.press_file import parse_press
from daq.records import InputError
from daq.store.records import (
    CoefficientRecord,
    ModelRecord,
    ModelStatus,
    RunRecord,
    RunStatus,
    StoredDiagnosis,
    StoredEstimate,
)
from daq.store.store import Store
from daq.supervision import SILENT_S
from daq.words import Message, spoken

TOLD_HERE = {"age_s", "valid_until_utc", "open_now", "advice"}
"""What of an estimate depends on when it is asked for."""
BESIDE = set(EstimateNow.model_fields) - set(StoredEstimate.__dataclass_fields__) - TOLD_HERE
"""What the sensor stores beside an estimate and the API hands on."""
BESIDE_INVALID = {"suspected", "reason_arguments", "left_out", "limited"}
"""What of it stands beside an estimate that is not valid: forecast, profile and heat rest on that estimate."""

_HIGHEST: Kept[tuple[str, str], tuple[int, float]] = Kept(PRESSES)
"""A run's highest core; more of them than a page of runs shows."""
_IN_USE: Kept[tuple[object, ...], dict[str, float]] = Kept(PRESSES)
"""A press's numbers in force."""
_DESCRIBED: Kept[str, dict[str, Any]] = Kept(PRESSES)
"""A press file as JSON, by its text."""


def phases_of(run: RunRecord) -> list[Phase]:
    """Return what the press did during a run, as the recorder found it live."""
    known = steps_of(run)
    ends = [*(at for at, _ in known[1:]), None][: len(known)]
    return [Phase(state=state, from_s=at, to_s=end) for (at, state), end in zip(known, ends, strict=True)]


NOT_DESCRIBED = "fit-not-described-check"
"""What the fit warns of where its model does not describe a run."""


def run_summaries(store: Store, runs: Sequence[RunRecord]) -> list[RunSummary]:
    """Return runs as lists show them."""
    fits = store.fits([run.run for run in runs])
    return [run_summary(store, run, fits.get(run.run)) for run in runs]


def is_described(fit: Mapping[str, Any]) -> bool:
    """Return whether the model describes the run that was fitted."""
    return all(warning["code"] != NOT_DESCRIBED for warning in fit.get("warnings_said", ()))


def run_summary(store: Store, run: RunRecord, fit: Mapping[str, Any] | None) -> RunSummary:
    """Return a run with its newest fit as lists show it."""
    duration = (run.ended_utc - run.started_utc).total_seconds() if run.started_utc and run.ended_utc else None
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
        rmse_K=(fit or {}).get("rmse_K"),
        fitted=fit is not None,
        described=None if fit is None else is_described(fit),
        verdict=run.header.get(VERDICT),
        damage=None if run.damage is None else str(run.damage),
        damage_said=None if run.damage is None else message_answer(run.damage),
    )


def run_detail(store: Store, run: RunRecord) -> RunDetail:
    """Return a run with everything known about it."""
    return RunDetail(
        **run_summaries(store, [run])[0].model_dump(),
        header={key: _plain(value) for key, value in run.header.items()},
        columns=list(store.columns_of(run.run)),
        phases=phases_of(run),
        remark=run.remark,
        changes=[
            RunEdit(utc=c.utc, who=c.who, field=c.field, before=_plain(c.before), after=_plain(c.after))
            for c in store.run_changes(run.run)
        ],
        **doubt_fields(doubts(run.header)),
    )


def doubt_fields(found: Sequence[Message]) -> dict[str, Any]:
    """Return what is doubtful in a header as answers carry it."""
    return {"doubts": [str(doubt) for doubt in found], "doubts_said": [message_answer(doubt) for doubt in found]}


def _plain(value: object) -> Any:
    """Return a header value as JSON carries it."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | list | dict | None) else str(value)


def _header_number(run: RunRecord, key: str) -> float | None:
    value = run.header.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def estimate_now(
    estimate: StoredEstimate, run: RunRecord | None, utc: datetime | None, now: datetime
) -> EstimateNow:
    """Return one estimate as the API shows it at `now`; its time counts from the run's first row.

    Whether it is `valid` is its own word, of `utc`; leave to open and advice are given while that is of now.
    """
    handed_on = BESIDE if estimate.valid else BESIDE_INVALID
    age_s = age_of(utc, now)
    answer = EstimateNow(
        run=run.run if run else None,
        number=estimate.number,
        utc=utc,
        age_s=None if age_s is None else round(age_s, 3),
        valid_until_utc=utc + timedelta(seconds=SILENT_S) if utc and estimate.valid else None,
        time_s=round(estimate.monotonic_s - run.zero_monotonic_s, 6) if run else None,
        state=str(estimate.state),
        core_C=number_or_none(estimate.core_celsius),
        core_sd_K=number_or_none(estimate.core_sd_kelvin),
        core_low_C=number_or_none(estimate.core_low_celsius),
        core_high_C=number_or_none(estimate.core_high_celsius),
        valid=estimate.valid,
        reason=estimate.reason,
        open_now=is_of_now(age_s) and leave_of(estimate),
        **{k: v for k, v in (estimate.detail or {}).items() if k in handed_on},
    )
    target_C = _header_number(run, "setting.core_target_C") if run else None  # noqa: N806
    return answer.model_copy(
        update={"advice": advice_of(answer, target_C, run.moments.opened_s if run else math.nan)}
    )


def estimate_of(present: Present, run: RunRecord | None, now: datetime) -> EstimateNow | None:
    """Return what the live sensor says of a press now as the API shows it, with `run` where it belongs to that."""
    estimate = present.estimate
    if estimate is None:
        return None
    return estimate_now(estimate, run_of_scan([run] if run else [], estimate.number), present.estimate_utc, now)


def run_of_scan(runs: Iterable[RunRecord], number: int) -> RunRecord | None:
    """Return the run a scan belongs to."""
    for run in runs:
        if run.first_scan <= number and (run.last_scan is None or number <= run.last_scan):
            return run
    return None


def target_of(store: Store, run: RunRecord | None, estimate: EstimateNow | None) -> Target | None:
    """Return the core temperature to reach (`setting.core_target_C`) and when, as the live sensor foresees it."""
    wanted = _header_number(run, "setting.core_target_C") if run else None
    if run is None or wanted is None:
        return None
    if highest_core(store, run) >= wanted:
        return Target(temperature_C=wanted, reached=True, time_to_target_s=0.0)
    usable = estimate is not None and estimate.valid and estimate.run == run.run
    ahead = estimate.target_in_s if estimate and usable else None
    if estimate and ahead is not None:
        ahead = round(max(ahead - (estimate.age_s or 0.0), 0.0), 1)
    return Target(temperature_C=wanted, reached=False, time_to_target_s=ahead)


def highest_core(store: Store, run: RunRecord) -> float:
    """Return the highest core temperature predicted in an open run so far, -inf before the first."""

    def look_on(known: tuple[int, float] | None) -> tuple[int, float]:
        last, highest = known or (run.first_scan - 1, -math.inf)
        while estimates := store.estimates_after(run.press, last, 2000):
            last = estimates[-1].number
            cores = [e.core_celsius for e in estimates if e.valid and math.isfinite(e.core_celsius)]
            highest = max([highest, *cores])
        return last, highest

    return _HIGHEST.renew((store.label, run.run), look_on)[1]


def press_now(store: Store, press: str, press_file: str, now: datetime) -> PressNow:
    """Return one press as it stands."""
    present = present_of(store, press, now)
    run, shown, scan, live = present.run, present.newest_run, present.scan, present.late is None
    estimate = estimate_of(present, shown, now)
    time_s = scan.monotonic_s - run.zero_monotonic_s if run and scan and live else math.nan
    closed_s = run.moments.closed_s if run else math.nan
    left_out = estimate.left_out if estimate else {}
    channels = channels_now(store, press, present.channels, scan, now, left_out)
    age_s = age_of(scan.utc if scan else None, now)
    return PressNow(
        press=press,
        state=present.state,
        since_utc=present.events[-1].utc if present.events else None,
        age_s=None if age_s is None else round(age_s, 3),
        silent_after_s=SILENT_S,
        run=shown.run if shown else None,
        run_status=str(shown.status) if shown else None,
        time_s=number_or_none(round(time_s, 3)),
        time_since_closing_s=number_or_none(round(time_s - closed_s, 3)),
        phases=phases_of(shown) if shown else [],
        channels=channels,
        faces=faces_now(channels if live else ()),
        estimate=estimate,
        last_core=last_core_of(present),
        target=target_of(store, run, estimate),
        coefficients=coefficients_in_use(store, press, press_file),
        description=press_description(press_file),
    )


def last_core_of(present: Present) -> LastCore | None:
    """Return the core when readings ended; None while they come, and where it was not known then."""
    before, utc = present.before_silence, present.estimate_utc
    if before is None or utc is None or not before.valid:
        return None
    return LastCore(
        utc=utc,
        core_C=before.core_celsius,
        core_low_C=before.core_low_celsius,
        core_high_C=before.core_high_celsius,
    )


def coefficients_in_use(store: Store, press: str, press_file: str) -> dict[str, float]:
    """Return what the live sensor starts from: the promoted model and the newest fits, else the guesses."""
    active = store.active_model(press)
    newest = store.newest_fit_number(press)
    key = (store.label, press, press_file, active.version if active else "", newest)
    return _IN_USE.get(key, lambda: _coefficients(store, press, press_file, active))


def _coefficients(store: Store, press: str, press_file: str, active: ModelRecord | None) -> dict[str, float]:
    from softsensor.heat.model_reading import parse_model
    from softsensor.jobs.model_in_force import NEWEST_RUNS, brought_up_to_date

    if not press_file:
        return {}
    try:
        described = parse_press(press_file)
        base = parse_model(active.model, f"model {active.version}") if active else None
    except InputError:
        return {}
    runs = store.runs(press=press, limit=NEWEST_RUNS + 1).items
    model = brought_up_to_date(store, described, base, [r.run for r in runs if r.status is not RunStatus.OPEN])
    guesses = {name: described.coefficient(name).guess for name in described.coefficient_names}
    return guesses | ({name: e.value for name, e in model.coefficients.items()} if model else {})


def press_description(press_file: str) -> dict[str, Any]:
    """Return the press file as JSON, empty where none was kept."""
    return _DESCRIBED.get(press_file, lambda: _described(press_file)) if press_file else {}


def _described(press_file: str) -> dict[str, Any]:
    try:
        return parse_press(press_file).model_dump(mode="json")
    except InputError as error:
        return {"error": str(error), "error_said": spoken(error).to_json()}


def coefficient_points(store: Store, records: Sequence[CoefficientRecord]) -> list[CoefficientPoint]:
    """Group coefficients by run, in the order given."""
    grouped: dict[str, list[CoefficientRecord]] = {}
    for record in records:
        grouped.setdefault(record.run, []).append(record)
    fits, records_of = store.fits(list(grouped)), store.run_records(list(grouped))
    points = []
    for run, entries in grouped.items():
        fit, home = fits.get(run, {}), records_of[run]
        given = {name: CoefficientFit(**c) for name, c in fit.get("coefficients", {}).items()}
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
        status=model.status.value,
        current=model.status is ModelStatus.PROMOTED,
        effects=[str(effect.get("name", effect)) for effect in model.model.get("effects", [])],
        reason=model.reason,
        reason_said=_why(model),
    )


def _why(model: ModelRecord) -> Said | None:
    """Return why a version is what it is, as a text where an earlier version wrote it."""
    kept = (model.model.get("basis") or {}).get("reason")
    if kept:
        return Said(**kept)
    return message_answer(spoken(model.reason)) if model.reason else None


def diagnosis_of(diagnosis: StoredDiagnosis) -> DiagnosisRecord:
    """Return a diagnosis as lists show it: its curves are asked for by themselves."""
    found = diagnosis.diagnosis
    return DiagnosisRecord(
        id=str(diagnosis.number),
        press=diagnosis.press,
        utc=diagnosis.created_utc,
        verdict=diagnosis.verdict,
        diagnosis={key: value for key, value in found.items() if key != "curves"},
        parameters=parameter_words(effect["name"] for effect in found.get("effects", ())),
        has_curves="curves" in found,
    )


def parameter_words(effects: Iterable[str]) -> dict[str, ParameterWords]:
    """Return how people are shown the parameters of some effects, by full name."""
    from softsensor.effects import known_effect

    found = {}
    for effect in filter(None, map(known_effect, effects)):
        for p in effect.parameters:
            called, unit = effect.parameter_called(p.name), p.shown_unit
            found[effect.key(p.name)] = ParameterWords(
                words=str(called),
                words_said=message_answer(called),
                factor=p.factor,
                unit=str(unit),
                unit_said=message_answer(unit),
            )
    return found


def utc_now() -> datetime:
    """Return the present instant."""
    return datetime.fromtimestamp(time.time(), UTC)
