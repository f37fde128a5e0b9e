"""The press at this moment: one state, one estimate, one leave to open, each held against the clock.

Whatever says how a press stands now asks here: REST, live events, MQTT, OPC UA, metrics, limits, and the page
through them. The state is the recorder's word, the core the live sensor's; what is older than `SILENT_S`, and an
estimate that is about another state, another panel or another clock, is not of now and says so in its `reason`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from statistics import median
from typing import Literal

from api.answers.schemas import State
from daq.press.detector import HAND_C
from daq.records import Channel, PressState, Scan
from daq.store.records import RunRecord, RunStatus, StoredEstimate, StoredPressEvent
from daq.store.store import Store
from daq.supervision import SILENT_S
from softsensor.live.validity import Invalid, InvalidReason

STATE_AFTER: Mapping[str, State] = {
    "inserted": "open",
    "closed": "closed",
    "opened": "open",
    "removed": "idle",
}


@dataclass(frozen=True)
class Present:
    """One press now."""

    scan: Scan | None
    """The newest, whatever its age."""
    channels: tuple[Channel, ...]
    newest_run: RunRecord | None
    """The one being recorded, else the newest that is over."""
    events: Sequence[StoredPressEvent]
    """Of the one being recorded."""
    late: Invalid | None
    """Why the newest scan is not of now."""
    state: State
    estimate: StoredEstimate | None
    """The newest, not valid where it is not of now; None before the first."""
    estimate_utc: datetime | None
    """Of its scan."""
    before_silence: StoredEstimate | None = None
    """The newest estimate as it counted at the newest scan, where nothing was read since."""

    @property
    def run(self) -> RunRecord | None:
        """The one being recorded."""
        newest = self.newest_run
        return newest if newest is not None and newest.status is RunStatus.OPEN else None

    @property
    def silent(self) -> bool:
        """Whether there was an estimate and none is of now, for the recorder or the live sensor is silent."""
        reason = self.estimate.reason if self.estimate is not None else ""
        return self.late is not None or reason == InvalidReason.LIVE_SENSOR_SILENT

    @property
    def open_now(self) -> bool:
        """Whether the press may open now; false where anything is not known."""
        return self.estimate is not None and leave_of(self.estimate)

    @property
    def known(self) -> bool:
        """Whether `open_now` rests on an estimate of now, or on there being no panel."""
        return self.estimate is not None and (self.estimate.valid or self.state == "idle") and self.late is None


def present_of(store: Store, press: str, now: datetime) -> Present:
    """Return how a press stands."""
    newest, events, channels, scan, found, estimated = store.standing(press)
    late = None if scan is None else _late(scan.utc, now)
    stood: State = "unknown"
    if scan is not None:
        reading = dict(zip((c.name for c in channels), scan.values, strict=True))
        left = newest is not None and left_inside(newest, reading)
        stood = "unknown" if left else state_of(events, newest)
    state: State = stood if late is None else "unknown"
    utc = None if estimated is None else estimated.utc
    estimate, before = None, None
    if found is not None:
        estimate = as_of_now(found, utc, state, newest, now, late)
    if found is not None and scan is not None and late is not None and late.reason is InvalidReason.NO_SCANS:
        before = as_of_now(found, utc, _state_at(scan, newest, stood), newest, scan.utc)
    return Present(scan, channels, newest, events, late, state, estimate, utc, before)


def state_of(events: Sequence[StoredPressEvent], run: RunRecord | None) -> State:
    """Return the press's state: what its last event of the open run left it in."""
    if run is None or run.status is not RunStatus.OPEN:
        return "idle"
    return STATE_AFTER.get(events[-1].kind, "unknown") if events else "idle"


def left_inside(before: RunRecord, reading: Mapping[str, float]) -> bool:
    """Return whether a panel may still be in the press that a stopped recorder left there, for a face is warm.

    Parameters
    ----------
    before
        The newest run.
    reading
        The newest scan by channel. [°C]
    """
    if before.status is not RunStatus.INTERRUPTED or math.isfinite(before.moments.removed_s):
        return False
    faces = ([v for n, v in reading.items() if n.startswith(face) and v == v] for face in ("top", "bottom"))
    return any(values and median(values) > HAND_C for values in faces)


def _state_at(scan: Scan, run: RunRecord | None, stood: State) -> State:
    """Return the state at the newest scan: a recorder that was stopped there left the press as its run has it."""
    if run is None or run.status is not RunStatus.INTERRUPTED or run.last_scan != scan.number:
        return stood
    steps = steps_of(run)
    return steps[-1][1] if steps else "idle"


def steps_of(run: RunRecord) -> list[tuple[float, State]]:
    """Return when the press changed its state during a run, and to which, as the recorder found it live. [s]"""
    steps = ((float(getattr(run.moments, f"{kind}_s")), state) for kind, state in STATE_AFTER.items())
    return [(at, state) for at, state in steps if math.isfinite(at)]


def leave_of(estimate: StoredEstimate) -> bool:
    """Return whether an estimate says that the press may open, at its own moment."""
    return estimate.valid and estimate.state == "closed" and (estimate.detail or {}).get("open_now") is True


def age_of(utc: datetime | None, now: datetime) -> float | None:
    """Return how long ago something was true, None where nobody knows. [s]"""
    return None if utc is None else (now - utc).total_seconds()


def is_of_now(age_s: float | None) -> bool:
    """Return whether something of this age is of now; a clock that runs ahead makes ages negative."""
    return age_s is not None and abs(age_s) <= SILENT_S


def _late(utc: datetime, now: datetime) -> Invalid | None:
    """Return why a scan is not of now."""
    age_s = (now - utc).total_seconds()
    if is_of_now(age_s):
        return None
    if age_s < 0.0:
        return Invalid(InvalidReason.CLOCK_AHEAD, {"ahead_s": round(-age_s)})
    return Invalid(InvalidReason.NO_SCANS, {"silent_s": round(age_s)})


def _silent(utc: datetime | None, now: datetime) -> Invalid | None:
    """Return why an estimate is not of now though scans are."""
    if utc is None:
        return Invalid(InvalidReason.NO_ESTIMATE_YET)
    age_s = (now - utc).total_seconds()
    return None if is_of_now(age_s) else Invalid(InvalidReason.LIVE_SENSOR_SILENT, {"silent_s": round(age_s)})


def _beside(estimate: StoredEstimate, state: State, run: RunRecord | None) -> Invalid | None:
    """Return why an estimate of now is not about the panel in the press as it stands."""
    if state == "idle":
        return Invalid(InvalidReason.NO_PANEL)
    if state == "unknown":
        return Invalid(InvalidReason.PRESS_STATE_UNKNOWN)
    if run is None or estimate.number < run.first_scan or estimate.state == "idle":
        return Invalid(InvalidReason.NO_ESTIMATE_YET)
    return Invalid(InvalidReason.ESTIMATE_BEHIND) if estimate.valid and estimate.state != state else None


def as_of_now(
    estimate: StoredEstimate,
    utc: datetime | None,
    state: State,
    run: RunRecord | None,
    now: datetime,
    late: Invalid | None = None,
) -> StoredEstimate:
    """Return the newest estimate, of a scan of `utc`, as it counts now: without numbers where it is not of now.

    Whether limits alone say when to open is of the resin file, and stays.

    Parameters
    ----------
    state, run
        What the recorder says of the press, and the run it records.
    late
        Why the newest scan is not of now.
    """
    why = late or _silent(utc, now) or _beside(estimate, state, run)
    stands: PressState | Literal["unknown"] = "unknown" if state == "unknown" else PressState(state)
    if why is None:
        return replace(estimate, state=stands)
    kept = {name: value for name, value in (estimate.detail or {}).items() if name == "limited"}
    told = {"reason_arguments": why.stored} if why.arguments else {}
    return replace(
        estimate,
        state=stands,
        core_celsius=math.nan,
        core_sd_kelvin=math.nan,
        core_low_celsius=math.nan,
        core_high_celsius=math.nan,
        valid=False,
        reason=why.reason.value,
        detail=kept | told or None,
    )
