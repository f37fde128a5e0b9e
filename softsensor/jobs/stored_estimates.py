"""An estimate as the store keeps it: its numbers in columns, the rest beside it as JSON."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from daq.records import PressState, Scan
from daq.store import StoredEstimate
from softsensor.live.forecast import Forecast
from softsensor.live.leaving import Leave
from softsensor.live.sensor import Estimate, ScanSensor


def details_of(sensor: ScanSensor, estimate: Estimate) -> dict[str, Any]:
    """Return what goes beside an estimate, without what is not known.

    Forecast, profile and heat come out of the same estimate as the core: where that is not valid, none is given.
    """
    found: dict[str, Any] = {"suspected": estimate.suspected} if estimate.suspected else {}
    if left_out := sensor.left_out:
        found["left_out"] = {column: round(kelvin, 1) for column, kelvin in left_out.items()}
    if sensor.limited is not None:
        found["limited"] = sensor.limited
    if estimate.leave is not None:
        found |= _leaving(estimate.leave, open_now=estimate.open_now)
    if estimate.invalid is not None:
        return found | ({"reason_arguments": estimate.invalid.stored} if estimate.invalid.arguments else {})
    if (
        estimate.state is not PressState.IDLE
        and estimate.state is not None
        and (inside := sensor.inside) is not None
    ):
        found["profile_C"] = [round(v, 1) for v in inside.profile_C.tolist()]
        found["energy_kJ_m2"] = round(inside.energy_kJ_m2, 1)
    found["band_from"] = {kind: round(share, 3) for kind, share in sensor.band_from.items()}
    return found | _foreseen(sensor.forecast)


def _foreseen(forecast: Forecast) -> dict[str, Any]:
    """Return what is known of a forecast as it stands beside an estimate."""
    times = {one.name: getattr(forecast, one.name) for one in fields(forecast)}
    found: dict[str, Any] = {k: round(v, 1) for k, v in times.items() if isinstance(v, float) and v == v}
    if forecast.limits_blocking:
        found["limits_blocking"] = forecast.limits_blocking
    if forecast.warning is not None:
        found |= {"warning": str(forecast.warning), "warning_said": forecast.warning.to_json()}
    return found


def _leaving(leave: Leave, *, open_now: bool) -> dict[str, Any]:
    """Return cure, steam and leave to open as they stand beside an estimate."""
    digits = {"cure_top": 4, "cure_bottom": 4, "cure_low": 4, "steam_kPa": 1, "steam_high_kPa": 1}
    known = {name: round(value, n) for name, n in digits.items() if (value := getattr(leave, name)) == value}
    grade = {"grade": leave.grade} if leave.grade else {}
    return {**known, **grade, "open_now": open_now}


def stored_estimate(scan: Scan, estimate: Estimate, model: str, detail: dict[str, Any]) -> StoredEstimate:
    """Return the row of a scan's estimate. [°C, K, s]"""
    return StoredEstimate(
        number=scan.number,
        monotonic_s=scan.monotonic_s,
        state=estimate.state if estimate.state is not None else "unknown",
        core_celsius=estimate.core_C,
        core_sd_kelvin=estimate.core_sd_K,
        core_low_celsius=estimate.core_low_C,
        core_high_celsius=estimate.core_high_C,
        valid=estimate.valid,
        reason="" if estimate.reason is None else estimate.reason.value,
        model_version=model,
        detail=detail or None,
    )
