"""What if: a run with other settings, in the band of all that is not known of it."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query

from api.answers.decimation import column_values
from api.answers.schemas import WhatIfAnswer, WhatIfOutcome, WhatIfSetting
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import ResinsDep, StoreDep, existing_run
from api.http.routes.simulation import RunModel, known_of
from daq.press.header import LIMITS, NumberLimits
from daq.press.press_file import parse_press
from daq.press.resin_file import Resin, read_resin
from daq.records import InputError
from daq.store.records import RunRecord, ScansUnreadable
from daq.store.store import Store
from daq.words import say, spoken
from softsensor.planning.program import FACTORS, Factor

if TYPE_CHECKING:
    from softsensor.heat.model_file import ModelFile
    from softsensor.planning.what_if import Band, LiveCore, Pressed, WhatIf

router = APIRouter(tags=["runs"], responses=problem_responses(404, 409))

WAIT_S = 20.0
"""One answer is worked out at a time, in about a second; who waits longer is asked to come again. By hand. [s]"""
_ONE = threading.Lock()


def _within(limits: Factor | NumberLimits) -> Any:
    """Return what a query says of a setting."""
    return Query(ge=limits.lower, le=limits.upper, allow_inf_nan=False, description="Instead of what it was.")


@dataclass(frozen=True)
class Settings:
    """What may be set otherwise; nothing stays as it was."""

    platen_temperature_C: Annotated[float | None, _within(FACTORS["platen_temperature_C"])] = None  # noqa: N815
    press_time_s: Annotated[float | None, _within(FACTORS["press_time_s"])] = None
    waiting_s: Annotated[float | None, _within(FACTORS["waiting_s"])] = None
    pressure_N_cm2: Annotated[float | None, _within(FACTORS["pressure_N_cm2"])] = None  # noqa: N815
    thickness_mm: Annotated[float | None, _within(FACTORS["thickness_mm"])] = None
    start_temperature_C: Annotated[float | None, _within(FACTORS["start_temperature_C"])] = None  # noqa: N815
    moisture_percent: Annotated[float | None, _within(LIMITS["panel.moisture_percent"])] = None


@router.get("/runs/{run}/what-if", operation_id="what_if", summary="The run with other settings")
def get_what_if(
    store: StoreDep,
    resins: ResinsDep,
    run: str,
    query: Annotated[Settings, Depends()],
) -> WhatIfAnswer:
    """Return core, and with a resin file cure and steam, that other settings would give; without any, as it was.

    The same panel between platens that follow the press as they did: with its own coefficients, what the live
    sensor told of it, and a band of all else that is not known.
    """
    settings = {name: value for name, value in asdict(query).items() if value is not None}
    return _worked_out(store, existing_run(store, run), resins, settings)


def _worked_out(
    store: Store, record: RunRecord, resins: Mapping[str, Path], settings: Mapping[str, float]
) -> WhatIfAnswer:
    from softsensor.planning.what_if import settings_known, what_if

    if not _ONE.acquire(timeout=WAIT_S):
        raise ProblemError(503, say("what-if-busy"), {"Retry-After": "5"})
    try:
        pressed = _pressed(store, record, resins.get(record.press))
        known = settings_known(pressed.run, pressed.press, pressed.moments)
        found = what_if(pressed, settings)
    except ScansUnreadable:
        raise
    except InputError as error:
        raise ProblemError(409, spoken(error)) from error
    finally:
        _ONE.release()
    shown = {
        name: WhatIfSetting(value=round(settings.get(name, was), 3), was=round(was, 3), lower=lower, upper=upper)
        for name, (was, lower, upper) in known.items()
    }
    return _answer(record.run, pressed, found, shown)


def _answer(run: str, pressed: Pressed, found: WhatIf, settings: dict[str, WhatIfSetting]) -> WhatIfAnswer:
    return WhatIfAnswer(
        run=run,
        settings=settings,
        time_s=[round(t, 3) for t in found.run.time_s.tolist()],
        closed_s=_number(found.moments.closed_s),
        opened_s=_number(found.moments.opened_s),
        core_C=column_values(found.core.middle),
        core_low_C=column_values(found.core.low),
        core_high_C=column_values(found.core.high),
        cure=column_values(found.cure.middle),
        cure_low=column_values(found.cure.low),
        steam_kPa=column_values(found.steam.middle),
        steam_high_kPa=column_values(found.steam.high),
        at_opening=_at_opening(found, pressed.resin),
    )


def _at_opening(found: WhatIf, resin: Resin | None) -> WhatIfOutcome | None:
    if not math.isfinite(found.moments.opened_s):
        return None
    row = int(np.abs(found.run.time_s - found.moments.opened_s).argmin())

    def at(band: Band) -> tuple[float | None, float | None, float | None]:
        low, middle, high = (_number(float(x[row])) for x in (band.low, band.middle, band.high))
        return low, middle, high

    cured = at(found.cure)[0]
    grade = resin.grades.grade(cured) if resin is not None and cured is not None else ""
    bands = {"core_C": at(found.core), "cure": at(found.cure), "steam_kPa": at(found.steam)}
    return WhatIfOutcome.model_validate({**bands, "grade": grade})


def _number(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None


def _pressed(store: Store, record: RunRecord, resin: Path | None) -> Pressed:
    from softsensor.planning.what_if import Pressed
    from softsensor.signals.moments import moments_of

    text = store.presses().get(record.press, "")
    if not text:
        raise ProblemError(404, say("api-run-without-press-file", run=record.run))
    press, run, known = (
        parse_press(text, say("place-press", press=record.press)),
        store.load_run(record.run),
        known_of(store, record),
    )
    found = moments_of(run, press)
    moments = replace(
        found,
        closed_s=known.moments.get("closed_s", found.closed_s),
        opened_s=known.moments.get("opened_s", found.opened_s),
    )
    cures = None if resin is None else read_resin(resin)
    live = _live_core(store, record, moments.opened_s)
    return Pressed(run, press, _own_model(store, record, known), moments, live, cures)


def _live_core(store: Store, record: RunRecord, opened_s: float) -> LiveCore | None:
    from softsensor.planning.what_if import LiveCore

    estimates = [(t, e) for t, e in store.estimates(record.run) if e.valid and not t > opened_s]
    return (
        LiveCore(estimates[-1][0], estimates[-1][1].core_celsius, estimates[-1][1].core_sd_kelvin)
        if estimates
        else None
    )


def _own_model(store: Store, record: RunRecord, known: RunModel) -> ModelFile:
    """Return the model a run was fitted with, with the run's own coefficients; where it has none, what they are.

    Where nothing is known of how coefficients differ from run to run, their doubt is that of the run's fit.
    """
    from softsensor.heat.model_file import FittedValue, ModelFile
    from softsensor.heat.model_reading import parse_model

    fit: dict[str, Any] = (store.fit(record.run) or {}).get("coefficients", {})
    if known.model is None and not fit:
        raise ProblemError(404, say("what-if-no-model", run=record.run))
    own = {name: FittedValue(float(c["value"]), float(c.get("sd") or 0.0)) for name, c in fit.items()}
    if known.model is None:
        model = ModelFile("", record.press, own)
    else:
        file = parse_model(known.model.model, say("place-model", version=known.model.version))
        model = replace(file, coefficients={**file.coefficients, **own})
    if model.names:
        return model
    spread = {name: c.sd / c.value for name, c in own.items() if c.sd > 0.0}
    return replace(model, names=tuple(spread), covariance=np.diag(np.square(list(spread.values()))))
