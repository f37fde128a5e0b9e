"""Who follows the press: its state, its moments as known by now, and why the run cannot be as the header says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from daq.press.detector import CHANGE_S
from daq.press.events import PressEventDetector
from daq.press.faces import BLIND_S
from daq.press.moments import REACH_S
from daq.records import LONGEST_WAIT_S, Array, Moments, PressEvent, PressEventKind, PressState
from softsensor.effects.parameters import uniform_sd
from softsensor.live.blocks import ScanArrays
from softsensor.live.consistency import (
    START_OFF_K,
    FaceReadings,
    Insertion,
    contradiction,
    first_error,
    hot_from,
    place_insertion,
    start_error,
)
from softsensor.live.passes import LEAST_WAIT_S, KnownMoments
from softsensor.live.setup import RunSetup
from softsensor.live.validity import Invalid, InvalidReason
from softsensor.signals.instrument import LIVE_MOMENT_S

LONGEST_GAP_S, MISSED_K = 7.0, 25.0
"""A press that closed in a longer gap has pressed for a time nobody knows; where both faces have moved by more in
a gap and no closing was found, one was missed. Set by hand, 2026-11. [s, K]"""
LATE_S = 2.0
"""Platens may be unknown for so long while a panel lies in the press for the first time. Set by hand. [s]"""
REOPENED_S = REACH_S
"""A press open for less than this has stayed closed: a bouncing switch, steam let out, or a fall that was no
opening (`PressEventDetector`). [s]"""
NOTICED_S = 2.0
"""After so long on the hot plate a panel is noticed, or its sensors came late. [s] By hand."""
OTHER_K = 40.0
"""Faces colder than expected by so much after the opening are another panel's. [K] By hand."""
UNCLEAR_S = 1.5
"""An insertion better known than this and before the first scan is taken to be with it. [s] By hand."""
HOTTEST_START_C = 80.0
"""A start temperature above was read from a panel that has been pressed: a recorder begun in between. [°C]
By hand."""


class PressFollower:
    """Follows one run's press, scan by scan.

    Parameters
    ----------
    setup
        The press with the run's overrides.
    scans
        The run's scans, which this reads, and averages anew where a panel came late.
    """

    def __init__(self, setup: RunSetup, scans: ScanArrays) -> None:
        self.state: PressState | None = None
        self.known = KnownMoments(initial_sd=setup.start_sd)
        self._setup, self._scans = setup, scans
        self._detector = PressEventDetector(setup.press)
        self._invalid: Invalid | None = None
        self._insertion: Insertion | None = None
        """When the panel came to lie in the press, until its start has been held against the header."""
        self._judged = 0
        """By how many faces."""
        self._lies_since = math.inf
        """When the panel came to lie in the press. [s]"""
        self._lower_read = self._face_read = -math.inf
        """When the lower face was read last, and any. [s]"""
        self._hot_C = hot_from(setup.start_C) if setup.press.panel_layers else math.inf
        self._hot_since = math.inf
        """Since when the lower face is too hot for a panel that is not in the press. [s]"""

    @property
    def pending(self) -> bool:
        """Whether the detector has a moment in view that it does not yet believe."""
        return self._detector.pending is not None

    @property
    def waiting(self) -> bool:
        """Whether the press stands empty before the pressing."""
        return self.state is PressState.IDLE and not math.isfinite(self.known.moments.removed_s)

    def detect(self, time_s: float, values: Mapping[str, float]) -> tuple[PressEventKind, ...]:
        """Follow the press; return which of its moments have become known."""
        if not self._setup.press.has_states:
            self.state = PressState.CLOSED
            return ()
        events = self._detector.update(time_s, values)
        self.state = self._detector.state
        if not self._setup.columns and self.state is PressState.IDLE:
            self.state = PressState.OPEN
        closed = next((e.monotonic_s for e in events if e.kind is PressEventKind.CLOSED), math.inf)
        for event in events:
            if event.kind is PressEventKind.INSERTED:
                self._note_insertion(event.monotonic_s, time_s, closed)
            else:
                self._note(event, time_s)
        return tuple(event.kind for event in events)

    def note_first_platens(self, time_s: float) -> None:
        """Note that the platens are known from now on."""
        if self.state is not PressState.IDLE and time_s - self._lies_since > LATE_S:
            self._invalid = Invalid(InvalidReason.PLATENS_MISSING_AT_INSERTION)

    def check_start(self) -> bool:
        """Hold each face, when first read in the press, against the header; return whether they disagree."""
        if self._insertion is None or not self._setup.columns:
            return False
        closed = self.known.moments.closed_s
        error = first_error(
            self._readings, self._setup.start_C, self._insertion, closed if math.isfinite(closed) else math.inf
        )
        if error.faces == len(self._setup.labels) or math.isfinite(closed):
            self._insertion = None
        if error.faces == self._judged:
            return False
        self._judged = error.faces
        self._invalid = self._invalid or contradiction(error.certain, self._setup.start_C)
        if abs(error.off) <= START_OFF_K:
            return False
        self.known = replace(self.known, initial_sd=math.hypot(self._setup.start_sd, error.off))
        return True

    def receive(self, time_s: float, expected: Array | None) -> None:
        """Note which faces the newest scan has: nothing else shows that a panel has come, is there, or has gone.

        `expected` is what the model says they read (M), None where it says nothing yet. [°C]
        """
        level = self._scans.level[-1].tolist()
        lower = self._setup.lower
        low = level[lower] if lower >= 0 else math.nan
        if any(face == face for face in level):
            self._face_read = time_s
        if low == low:
            self._lower_read = time_s
        self._hot_since = min(self._hot_since, time_s) if low >= self._hot_C else math.inf
        moments = self.known.moments
        if not math.isfinite(moments.opened_s) or math.isfinite(moments.removed_s):
            return
        if time_s - moments.opened_s > CHANGE_S and time_s - self._face_read > BLIND_S:
            self._invalid = Invalid(InvalidReason.PANEL_NOT_SEEN)
        elif expected is not None and (expected - self._scans.level[-1] > OTHER_K).any():
            self._invalid = Invalid(InvalidReason.OTHER_PANEL)

    def contradicted(self, missed_K: float) -> Invalid | None:
        """Return why the run cannot be as the header says, None where it may be.

        `missed_K` is by how much both faces have moved while they were not read.
        """
        invalid, start = self._invalid, self._setup.start_C
        if self.waiting:
            invalid = contradiction(start_error(self._scans.level[-1], start), start)
        if invalid is None and not math.isfinite(self.known.moments.closed_s) and missed_K > MISSED_K:
            invalid = Invalid(InvalidReason.JUMPED_IN_GAP)
        return invalid

    def unseen(self, time_s: float, *, overtaken: bool) -> Invalid | None:
        """Return why nobody knows whether or when a panel came, None where that is known.

        `overtaken` says that the pass which answers knows the press in a state it has left.
        """
        if self.waiting and time_s - self._lower_read > BLIND_S:
            return Invalid(InvalidReason.LOWER_FACE_SILENT)
        long_hot = self.waiting and time_s - self._hot_since > NOTICED_S
        if long_hot or (overtaken and self.known.inserted_sd > 0.0):
            return Invalid(InvalidReason.INSERTION_NOT_SEEN)
        return None

    @property
    def _readings(self) -> FaceReadings:
        return FaceReadings(self._scans.time, self._scans.level, self._setup.lower)

    def _placed(self, event: PressEvent, time_s: float) -> tuple[float, float]:
        """Return when a moment was, and how well that is known: a gap or a wire places it less well. [s]"""
        at = event.monotonic_s
        if event.source.is_wire:
            between = time_s - (float(self._scans.time[-1]) if len(self._scans) else time_s)
            return at - 0.5 * between, uniform_sd(between) + 0.1
        if (gap := self._scans.gap(at, time_s)) is not None:
            return 0.5 * (gap[0] + gap[1]), uniform_sd(gap[1] - gap[0])
        return at, LIVE_MOMENT_S

    def _note(self, event: PressEvent, time_s: float) -> None:
        """Keep a moment the detector found, and how well it is known."""
        known, (at, sd) = self.known, self._placed(event, time_s)
        moments = known.moments
        if event.kind is PressEventKind.CLOSED and at - moments.opened_s < REOPENED_S:
            self.known = replace(known, moments=replace(moments, opened_s=math.nan))
        elif event.kind is PressEventKind.CLOSED:
            self._invalid = self._why_not_followed(sd) or self._invalid
            closed = replace(moments, closed_s=at, opened_s=math.nan, removed_s=math.nan)
            self.known = replace(known, moments=closed, closed_sd=sd)
        elif event.kind is PressEventKind.OPENED:
            self.known = replace(known, moments=replace(moments, opened_s=at), opened_sd=sd)
        else:
            self.known = replace(known, moments=replace(moments, removed_s=at))

    def _why_not_followed(self, sd: float) -> Invalid | None:
        """Return why a press that has just closed cannot be followed; `sd` is how well that moment is placed."""
        if sd > uniform_sd(LONGEST_GAP_S):
            return Invalid(InvalidReason.CLOSED_IN_GAP)
        if not len(self._scans):
            return Invalid(InvalidReason.BEGINS_CLOSED)
        if math.isfinite(self.known.moments.opened_s) and not self._setup.columns:
            return Invalid(InvalidReason.CLOSED_AGAIN)
        return None

    def _note_insertion(self, at: float, time_s: float, closed: float) -> None:
        """Keep when the panel came, as the detector has it; `closed` where only the closing showed it. [s]"""
        scans, start = self._scans, self._setup.start_C
        self._invalid, insertion = None, Insertion(at)
        first = float(scans.time[0]) if len(scans) else math.nan
        if len(scans) and not self._setup.columns and time_s - first <= LONGEST_WAIT_S:
            insertion = Insertion(first)
        elif len(scans):
            opened = self.known.moments.opened_s
            opened = opened if math.isfinite(opened) else -math.inf
            insertion = place_insertion(self._readings, start, at, closed, time_s, opened)
            lower = self._setup.lower
            warm = lower >= 0 and scans.level[0, lower] >= self._hot_C
            if warm and insertion.at < first - UNCLEAR_S:
                self._invalid = Invalid(InvalidReason.BEGINS_ON_HOT_PLATE)
            if insertion.sd > UNCLEAR_S:  # before the first scan it could not be carried on
                insertion = replace(insertion, at=max(insertion.at, first + LEAST_WAIT_S))
        if start > HOTTEST_START_C:
            self._invalid = Invalid(InvalidReason.START_TEMPERATURE_TOO_HIGH, {"header_C": start})
        seen = len(scans) > 0 and insertion.at > first + 0.3
        self.known = replace(
            self.known,
            moments=Moments(inserted_s=insertion.at if seen else math.nan),
            inserted_sd=insertion.sd if seen else 0.0,
            initial_sd=self._setup.start_sd,
        )
        self._insertion, self._judged, self._lies_since = insertion, 0, insertion.at
        if seen:
            scans.average_anew(insertion.at)
