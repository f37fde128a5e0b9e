"""A run against the model: simulated curves, residual, the profile through the panel, and a figure."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Response

from api.answers.decimation import column_values, decimate
from api.answers.kept import Kept
from api.answers.records import phases_of
from api.answers.schemas import SimulatedRun
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import StoreDep, existing_run
from daq.press.press_file import parse_press, press_for_run
from daq.records import InputError
from daq.store.records import ModelRecord, RunRecord, ScansUnreadable
from daq.store.store import Store
from daq.words import say, spoken
from daq.words.message import ENGLISH, languages

if TYPE_CHECKING:
    from softsensor.fitting.simulated_run import Simulated

router = APIRouter(tags=["runs"], responses=problem_responses(404))

SHOWN_POINTS = 1500
"""Of a curve: more than a wide screen has pixels for."""
MOMENTS = ("inserted_s", "closed_s", "opened_s", "ramp_s")
"""Those of a run that a fit refines."""
KEPT = 32
"""Simulations kept in memory; a run is simulated again when its data, header, press file or fit change."""


@dataclass(frozen=True)
class RunModel:
    """What a run is simulated with: its own fit and the model it was fitted with, else the model in force."""

    version: str | None
    model: ModelRecord | None
    values: Mapping[str, float]
    """Coefficients of the run's fit, empty without one."""
    moments: Mapping[str, float] = field(default_factory=dict)
    """As the fit refined them. [s]"""
    rmse: Mapping[str, float] = field(default_factory=dict)
    """What the fit left at each place. [K]"""


_KEPT: Kept[tuple[str, ...], Simulated] = Kept(KEPT)


def _simulated(store: Store, record: RunRecord) -> tuple[Simulated, RunModel]:
    """Return the simulation of a run as it stands, and what it was simulated with."""
    known = known_of(store, record)
    newest = record.last_scan if record.last_scan is not None else store.newest_scan_number(record.press)
    fitted = (known.version, sorted(known.values.items()), sorted(known.moments.items()))
    press_file = store.presses().get(record.press, "")
    state = repr((newest, record.moments, sorted(record.header.items()), fitted))
    key = (store.label, record.run, press_file, state)
    return _KEPT.get(key, lambda: _simulate(store, record, known)), known


@router.get(
    "/runs/{run}/simulation", operation_id="get_simulation", summary="The run simulated with its coefficients"
)
def get_simulation(store: StoreDep, run: str) -> SimulatedRun:
    """Return simulated and measured temperatures at each sensor position, and the profile over time."""
    from softsensor.heat.step_terms import BOILING_C  # loads slowly

    simulated, known = _simulated(store, existing_run(store, run))
    table = {f"s {k}": v for k, v in simulated.places.items()}
    table |= {f"m {k}": v for k, v in simulated.measured.items()} | {"core": simulated.core}
    time_s, kept = decimate(simulated.time_s, table, SHOWN_POINTS)
    return SimulatedRun(
        run=run,
        model_version=known.version,
        time_s=[round(t, 3) for t in time_s.tolist()],
        positions={k: column_values(kept[f"s {k}"]) for k in simulated.places},
        measured={k: column_values(kept[f"m {k}"]) for k in simulated.places},
        core_C=column_values(kept["core"]),
        rmse_K={k: round(v, 4) for k, v in {**simulated.rmse, **known.rmse}.items()},
        profile_time_s=[round(t, 3) for t in simulated.profile_time_s.tolist()],
        profile_depth_mm=[round(d, 3) for d in simulated.profile_depth_mm.tolist()],
        profile_C=[[round(v, 2) for v in row] for row in simulated.profile.tolist()],
        boiling_C=BOILING_C,
        profile_heat_kJ_m2=[round(q / 1000.0, 2) for q in simulated.profile_heat.tolist()],
    )


@router.get(
    "/runs/{run}/figure.svg",
    operation_id="get_figure",
    summary="The run as a picture",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {"schema": {"type": "string"}}}}},
)
def get_figure(
    store: StoreDep, run: str, language: Annotated[str, Query(description="Of the words in it.")] = ENGLISH
) -> Response:
    """Return measured against simulated temperatures and the residual, as SVG."""
    from api.answers.figure import Curves, run_figure

    if language not in languages():
        raise ProblemError(404, say("api-no-such-language", language=language, languages=languages()))
    record = existing_run(store, run)
    simulated, _ = _simulated(store, record)
    last = float(simulated.time_s[-1])
    phases = [(p.state, p.from_s, last if p.to_s is None else p.to_s) for p in phases_of(record)]
    material = str(record.header.get("panel.material", ""))
    picture = run_figure(
        Curves(
            **_recorded(store, run),
            title=f"{record.run}  {material}",
            time_s=simulated.time_s,
            simulated=simulated.places,
            measured=simulated.measured,
            core=simulated.core,
            phases=phases,
        ),
        language,
    )
    return Response(picture, media_type="image/svg+xml")


def _recorded(store: Store, run: str) -> dict[str, Any]:
    """Return what the picture shows beside the simulation: the platens, and the core as it was estimated live."""
    try:
        whole = store.load_run(run)
        estimates = [(t, e) for t, e in store.estimates(run) if e.valid]
    except ScansUnreadable:
        raise
    except InputError as error:  # given up by rule
        raise ProblemError(404, spoken(error)) from error
    cells = np.array([(e.core_celsius, e.core_low_celsius, e.core_high_celsius) for _, e in estimates]).reshape(
        -1, 3
    )
    return {
        "platens": {name: values for name, values in whole.columns.items() if name.startswith("platen")},
        "platen_time_s": whole.time_s,
        "live": dict(zip(("core", "low", "high"), cells.T, strict=True)) if estimates else {},
        "live_time_s": np.array([t for t, _ in estimates]),
    }


def known_of(store: Store, record: RunRecord) -> RunModel:
    """Return what a run is simulated with."""
    active = store.active_model(record.press)
    fit = store.fit(record.run)
    if fit is None:
        return RunModel(active.version if active else None, active, {})
    version = fit.get("model_version") or None
    behind = active if active and active.version == version else None
    if behind is None and version:
        with suppress(InputError):
            behind = store.model(version)
    values = {name: float(c["value"]) for name, c in fit.get("coefficients", {}).items()}
    moments = {name: fit[name] for name in MOMENTS if fit.get(name) is not None}
    left = {place: value for place, value in fit.get("rmse_places_K", {}).items() if value is not None}
    return RunModel(version, behind, values, moments, left)


def _simulate(store: Store, record: RunRecord, known: RunModel) -> Simulated:
    from softsensor.fitting.simulated_run import simulate_run
    from softsensor.heat.model import ThermalModel
    from softsensor.heat.model_reading import parse_model

    text = store.presses().get(record.press, "")
    if not text:
        raise ProblemError(404, say("api-run-without-press-file", run=record.run))
    try:
        press = parse_press(text, say("place-press", press=record.press))
        file = (
            parse_model(known.model.model, say("place-model", version=known.model.version))
            if known.model
            else None
        )
        model = file.model(press) if file else ThermalModel(press)
        run = store.load_run(record.run)
        guesses = replace(model, press=press_for_run(press, run)).guesses
        given = (file.values if file else {}) | dict(known.values)
        values = guesses | {name: value for name, value in given.items() if name in guesses}
        return simulate_run(run, press, model, values, known.moments)
    except ScansUnreadable:
        raise
    except InputError as error:
        raise ProblemError(404, say("api-run-not-simulated", run=record.run, why=spoken(error))) from error
