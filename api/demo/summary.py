"""What the system found in a pressing of the virtual press against what truly happened."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from api.outputs import in_words
from daq.press.press_file import Press
from daq.simulated.press import Cycle
from daq.store.records import RunRecord, StoredEstimate
from daq.store.store import Store
from daq.words import Message, say
from softsensor.effects.vocabulary import called

if TYPE_CHECKING:
    from softsensor.heat.model_file import ModelFile

_HEADS = (
    (
        "demo-column-run",
        "demo-column-scans",
        "demo-column-closing",
        "demo-column-opening",
        "demo-column-surface",
        "demo-column-core",
        "demo-column-worst",
        "demo-column-band",
    ),
    (
        "",
        "",
        "demo-column-found",
        "demo-column-found",
        "demo-column-surface-unit",
        "demo-column-core-unit",
        "",
        "demo-column-band-unit",
    ),
)


@dataclass(frozen=True)
class PressingCheck:
    """One pressing: found minus true, and residuals."""

    run: str
    scans: int
    closing_error_s: float
    opening_error_s: float
    rmse_before_K: float  # noqa: N815
    """Residual at rest (`RunFit.rmse_still_K`) at the press file's guesses: at many times real speed the rows amid
    the closing are off by what a scan's moment is, and are most of a whole run's."""
    rmse_after_K: float  # noqa: N815
    """After the fit."""
    core_rmse_K: float  # noqa: N815
    """Live prediction against the true core, from insertion to removal."""
    core_worst_K: float  # noqa: N815
    inside_band: float
    """Share of the live predictions whose 95 % band holds the truth."""

    @property
    def line(self) -> Message:
        """One line for the terminal."""
        known = np.isfinite(self.core_rmse_K)
        core = say("demo-core-off", kelvin=self.core_rmse_K) if known else say("demo-core-unknown")
        return say(
            "demo-pressing",
            run=self.run,
            scans=self.scans,
            closing=self.closing_error_s,
            opening=self.opening_error_s,
            before=self.rmse_before_K,
            after=self.rmse_after_K,
            core=core,
        )


def compare(store: Store, record: RunRecord, cycle: Cycle, zero_virtual_s: float) -> PressingCheck:
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
    return PressingCheck(
        run=record.run,
        scans=last - record.first_scan + 1,
        closing_error_s=record.moments.closed_s + zero_virtual_s - truth.closed_s,
        opening_error_s=record.moments.opened_s + zero_virtual_s - truth.opened_s,
        rmse_before_K=_number(fit.get("initial_rmse_still_K")),
        rmse_after_K=_number(fit.get("rmse_still_K")),
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
    from softsensor.live.sensor import ScanSensor  # loads slowly, and the processes wait to be started

    run = store.load_run(record.run)
    hidden = set(press.sensors_of(run, "validation"))
    columns = {name: values.tolist() for name, values in run.columns.items() if name not in hidden}
    sensor = ScanSensor(press, record.header, model)
    estimates = []
    for i, time_s in enumerate(run.time_s.tolist()):
        e = sensor.update(time_s, {name: values[i] for name, values in columns.items()})
        bounds = (e.core_C, e.core_sd_K, e.core_low_C, e.core_high_C)
        estimates.append((time_s, StoredEstimate(i, time_s, e.state or "unknown", *bounds, e.valid)))
    return _core(estimates, cycle, zero_virtual_s)[0]


def gain_line(findings: Sequence[PressingCheck], after: Sequence[float]) -> Message:
    """Say what a promoted model does for the core of the last pressings; `after` are their errors with it. [K]"""
    before = [f.core_rmse_K for f in findings[-len(after) :]]
    old, new = (float(np.sqrt(np.mean(np.square(errors)))) for errors in (before, after))
    return say("demo-gain", runs=len(after), before=old, after=new)


def summary_lines(
    findings: Sequence[PressingCheck], hidden: Sequence[str], diagnosis: Mapping[str, Any] | None
) -> list[Message | str]:
    """Return the summary as lines of text."""
    lines: list[Message | str] = ["", say("demo-summary", runs=len(findings))]
    rows = [tuple(code and in_words(Message(code)) for code in head) for head in _HEADS]
    rows += [
        (
            f.run,
            str(f.scans),
            f"{f.closing_error_s:+.2f} s",
            f"{f.opening_error_s:+.2f} s",
            f"{f.rmse_before_K:.2f}, {f.rmse_after_K:.2f} K",
            f"{f.core_rmse_K:.2f} K",
            f"{f.core_worst_K:.2f} K",
            f"{100 * f.inside_band:.0f} %",
        )
        for f in findings
    ]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines += ["  " + "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    lines.append(say("demo-stored", runs=len(findings), scans=sum(f.scans for f in findings)))
    if hidden:
        lines += diagnosis_lines(hidden, diagnosis)
    return lines


def pace_lines(
    findings: Sequence[PressingCheck], speed: float, left_out: int, recorded: int, unseen: int
) -> list[Message]:
    """Return a warning where the machine could not keep up with the speed asked for, else nothing.

    Parameters
    ----------
    left_out, recorded
        Scans of the recorder.
    unseen
        Pressings that took place and were not found.
    """
    unfitted = sum(f.rmse_after_K != f.rmse_after_K for f in findings)
    troubles = []
    if left_out > 0.02 * recorded:
        troubles.append(say("demo-scans-left-out", left_out=left_out, all=left_out + recorded))
    if unseen:
        troubles.append(say("demo-not-found", runs=unseen))
    if unfitted:
        troubles.append(say("demo-not-fitted", runs=unfitted))
    return [say("demo-too-slow", speed=speed, troubles=tuple(troubles))] if troubles else []


def diagnosis_lines(hidden: Sequence[str], diagnosis: Mapping[str, Any] | None) -> list[Message]:
    """Return what the nightly job named, after what was hidden."""
    lines = [say("demo-hidden", effects=tuple(hidden))] if hidden else []
    if diagnosis is None:
        return [*lines, say("demo-no-diagnosis")]
    verdict = Message(f"diagnosis-verdict-{diagnosis.get('verdict')}")
    effects = diagnosis.get("effects", [])
    named = tuple(called(name) for effect in effects for name in effect.get("set") or [effect["name"]])
    causes = say("demo-named", verdict=verdict, causes=named)
    lines.append(causes if named else say("demo-named-none", verdict=verdict))
    before, after = diagnosis.get("base", {}), diagnosis.get("extended", {})
    if before.get("heldout_rmse_K") is not None and after.get("heldout_rmse_K") is not None:
        plain, extended = f"{before['heldout_rmse_K']:.3f}", f"{after['heldout_rmse_K']:.3f}"
        lines.append(say("demo-heldout", plain=plain, extended=extended))
    if diagnosis.get("next_measurement"):
        lines.append(say("demo-next", what=stored_measurement(diagnosis)))
    return lines


def stored_measurement(diagnosis: Mapping[str, Any]) -> Message | str:
    """Return what a stored diagnosis would measure next; one of an older version says it in English only."""
    coded = diagnosis.get("next_measurement_said")
    return Message.from_json(coded) if coded else str(diagnosis["next_measurement"])


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")
