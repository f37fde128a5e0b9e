"""What the system found in a pressing of the virtual press against what truly happened."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.pressfile import Press
from daq.simulated.press import Cycle
from daq.store.records import RunRecord, StoredEstimate
from daq.store.store import Store
from softsensor.modelfile import ModelFile
from softsensor.observer import LiveSensor


@dataclass(frozen=True)
class Finding:
    """One pressing: found minus true, and residuals."""

    run: str
    scans: int
    closing_error_s: float
    opening_error_s: float
    rmse_before_K: float  # noqa: N815
    """Surface residual at the press file's guesses."""
    rmse_after_K: float  # noqa: N815
    """After the fit."""
    core_rmse_K: float  # noqa: N815
    """Live prediction against the true core, from insertion to removal."""
    core_worst_K: float  # noqa: N815
    inside_band: float
    """Share of the live predictions whose 95 % band holds the truth."""

    @property
    def line(self) -> str:
        """One line for the terminal."""
        return (
            f"Pressing {self.run}: {self.scans} scans, closing {self.closing_error_s:+.2f} s and opening "
            f"{self.opening_error_s:+.2f} s off, surface {self.rmse_before_K:.2f} -> {self.rmse_after_K:.2f} K, "
            f"core {self.core_rmse_K:.2f} K off"
        )


def compare(store: Store, record: RunRecord, cycle: Cycle, zero_virtual_s: float) -> Finding:
    """Compare a stored pressing with the virtual press's cycle.

    Parameters
    ----------
    zero_virtual_s
        Virtual time of the run's time 0. [s]
    """
    fit = store.fit(record.run) or {}
    rmse, worst, inside = _core(store.estimates(record.run), cycle, zero_virtual_s)
    last = record.last_scan if record.last_scan is not None else record.first_scan - 1
    truth = cycle.moments
    return Finding(
        run=record.run,
        scans=last - record.first_scan + 1,
        closing_error_s=record.moments.closed_s + zero_virtual_s - truth.closed_s,
        opening_error_s=record.moments.opened_s + zero_virtual_s - truth.opened_s,
        rmse_before_K=_number(fit.get("initial_rmse_K")),
        rmse_after_K=_number(fit.get("rmse_K")),
        core_rmse_K=rmse,
        core_worst_K=worst,
        inside_band=inside,
    )


def _core(
    estimates: Iterable[tuple[float, StoredEstimate]], cycle: Cycle, zero_virtual_s: float
) -> tuple[float, float, float]:
    rows = [
        (time_s + zero_virtual_s, e.core_celsius, e.core_low_celsius, e.core_high_celsius)
        for time_s, e in estimates
        if e.valid
    ]
    if not rows:
        return float("nan"), float("nan"), float("nan")
    at, core, low, high = np.array(rows).T
    true = np.interp(at - cycle.start, cycle.times, cycle.core_C, left=np.nan, right=np.nan)
    there = np.isfinite(true) & np.isfinite(core)
    if not there.any():
        return float("nan"), float("nan"), float("nan")
    error = (core - true)[there]
    inside = ((low <= true) & (true <= high))[there]
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()), float(inside.mean())


def replayed(
    store: Store, press: Press, model: ModelFile, record: RunRecord, cycle: Cycle, zero_virtual_s: float
) -> float:
    """Return the core error of a stored pressing taken through the live sensor again with another model. [K]"""
    run = store.load_run(record.run)
    hidden = set(press.sensors_of(run, "validation"))
    columns = {name: values.tolist() for name, values in run.columns.items() if name not in hidden}
    sensor = LiveSensor(press, record.header, model)
    said = []
    for i, time_s in enumerate(run.time_s.tolist()):
        e = sensor.update(time_s, {name: values[i] for name, values in columns.items()})
        bounds = (e.core_C, e.core_sd_K, e.core_low_C, e.core_high_C)
        said.append((time_s, StoredEstimate(i, time_s, e.state or "unknown", *bounds, e.valid, e.reason, "")))
    return _core(said, cycle, zero_virtual_s)[0]


def gain_line(findings: Sequence[Finding], after: Sequence[float]) -> str:
    """Say what a promoted model does for the core of the last pressings; `after` are their errors with it. [K]"""
    before = [f.core_rmse_K for f in findings[-len(after) :]]
    old, new = (float(np.sqrt(np.mean(np.square(errors)))) for errors in (before, after))
    return (
        f"Live core error on the last {len(after)} pressings: {old:.2f} K as it was told, "
        f"{new:.2f} K with the promoted model"
    )


def summary_lines(
    findings: Sequence[Finding], hidden: Sequence[str], diagnosis: Mapping[str, Any] | None
) -> list[str]:
    """Return the summary as lines of text."""
    lines = ["", f"Summary of {len(findings)} pressings on the virtual press"]
    rows = [
        ("run", "scans", "closing", "opening", "surface residual", "core error", "worst", "in band"),
        ("", "", "found-true", "found-true", "before -> after fit", "live, rms", "", "of 95 %"),
    ]
    rows += [
        (
            f.run,
            str(f.scans),
            f"{f.closing_error_s:+.2f} s",
            f"{f.opening_error_s:+.2f} s",
            f"{f.rmse_before_K:.2f} -> {f.rmse_after_K:.2f} K",
            f"{f.core_rmse_K:.2f} K",
            f"{f.core_worst_K:.2f} K",
            f"{100 * f.inside_band:.0f} %",
        )
        for f in findings
    ]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines += ["  " + "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    lines.append(f"Runs stored: {len(findings)}, scans stored: {sum(f.scans for f in findings)}")
    if hidden:
        lines += _diagnosis_lines(hidden, diagnosis)
    return lines


def pace_lines(findings: Sequence[Finding], speed: float, left_out: int, recorded: int, unseen: int) -> list[str]:
    """Return a warning where the machine could not keep up with the speed asked for, else nothing.

    Parameters
    ----------
    left_out, recorded
        Scans of the recorder.
    unseen
        Pressings that took place and were not found.
    """
    unfitted = sum(f.rmse_after_K != f.rmse_after_K for f in findings)
    troubles = [
        f"{left_out} of {left_out + recorded} scans were left out" if left_out > 0.02 * recorded else "",
        f"{unseen} pressings were not found" if unseen else "",
        f"{unfitted} pressings waited in vain for their fit" if unfitted else "",
    ]
    told = ", ".join(filter(None, troubles))
    if not told:
        return []
    return [f"This machine did not keep up with {speed:g} times real speed: {told}; give a lower --speed"]


def _diagnosis_lines(hidden: Sequence[str], diagnosis: Mapping[str, Any] | None) -> list[str]:
    lines = [f"Hidden in the virtual press: {', '.join(hidden)}"]
    if diagnosis is None:
        return [*lines, "The nightly job wrote no diagnosis."]
    named = [" or ".join(effect.get("set") or [effect["name"]]) for effect in diagnosis.get("effects", [])]
    lines.append(f"The nightly job says: {diagnosis.get('verdict')}, {' + '.join(named) or 'no cause named'}")
    before, after = diagnosis.get("base", {}), diagnosis.get("extended", {})
    if before.get("heldout_rmse_K") is not None and after.get("heldout_rmse_K") is not None:
        lines.append(
            f"Error on pressings that took no part: {before['heldout_rmse_K']:.3f} K with the plain model, "
            f"{after['heldout_rmse_K']:.3f} K with the extended one"
        )
    if diagnosis.get("next_measurement"):
        lines.append(f"Next measurement: {diagnosis['next_measurement']}")
    return lines


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")
