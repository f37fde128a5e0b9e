"""One press that is followed: its open run, its sensor, its fits.

It keeps nothing of its own. After a restart, or when the run's header or the promoted model changes, the
scans of the open run are taken from the store again; the live sensor is a function of the scans, so that
gives the estimates an uninterrupted process would have given. Fits run in a worker process, so that no
estimate waits for one.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Literal

from daq.press.press_file import Press
from daq.press.resin_file import Resin, read_resin
from daq.process.config import PressSettings
from daq.records import InputError, PressState, Scan
from daq.store import RunRecord, ScanBatch, Store, StoredEstimate, StoreUnavailable
from daq.store.records import ScansUnreadable
from daq.supervision import Pending
from daq.words import Message, say, spoken
from softsensor.jobs.live_model import LiveModel
from softsensor.jobs.run_fits import RunFits, write_journal
from softsensor.jobs.stored_estimates import details_of, stored_estimate
from softsensor.live.panels import panel_remark
from softsensor.live.sensor import Estimate, ScanSensor
from softsensor.live.validity import Invalid, InvalidReason
from softsensor.signals.instrument import LAG_GONE_S

# Numbers without another source were set by hand, 2026-11.

LOOK_S = 0.25
"""How often for a new run, a changed header, press events. [s]"""
BATCH = 400
"""Scans taken from the store at once: 40 s at 10 Hz."""
IDLE_S = 1.0
"""Between pressings an estimate is written this often. [s]"""
UPDATE_SHARE = 0.02
"""Of the newest update in the mean shown by `/health`: over some 50. By hand, 2026-11."""


@dataclass
class _Live:
    """The run being pressed and its sensor."""

    record: RunRecord
    sensor: ScanSensor
    model: str
    fitted_open: bool = False
    course: object = ()
    """The forecast's course that was stored last: one goes beside the first estimate after it was found, once."""
    departs_since: dict[str, float] = field(default_factory=dict)
    """Channels that read something else than their neighbours, and since when. [s]"""


@dataclass
class Follower:
    """One press: its open run, its sensor, its fits."""

    store: Store
    settings: PressSettings
    press: Press
    fits: RunFits
    resin: Resin | None = None
    last: int = -2
    """Newest scan taken; -2 before the first step."""
    taking: int | None = None
    """Scan that is being taken, or is to be read next; None while something else is done."""
    passed: int = -1
    """All scans up to it are passed over: the sensor has failed at them again and again."""
    poisoned: set[int] = field(default_factory=set)
    """Scans that are passed over singly, for the same reason."""
    behind: int = 0
    live: _Live | None = None
    model: LiveModel = field(init=False)
    refused: Message | None = None
    """Why the run being pressed is not followed."""
    message: Message = field(default_factory=lambda: say("sense-waiting"))
    update_us: float = 0.0
    _looked: float = -math.inf
    _idle_s: float = -math.inf
    """When an estimate between pressings was last stored."""
    _ended: list[RunRecord] = field(default_factory=list)
    """Pressings that are over and have scans this process has not seen yet, oldest first."""
    _unwritten: list[StoredEstimate] = field(default_factory=list)
    """Estimated and not in the store yet: no scan goes through the sensor twice because the store was away."""
    _pending: Pending[tuple[Literal["warning", "alarm"], Message]] = field(init=False)
    """For the journal and not in it yet, for the same reason."""
    _departed: set[tuple[str, str]] = field(default_factory=set)
    """Runs and their channels reported to depart."""
    _damaged_in: str | None = None
    """The run (none: empty) for which an unreadable scan was reported."""

    def __post_init__(self) -> None:
        """Connect the journal and the model in force."""
        self._pending = Pending(lambda line: write_journal(self.store, *line, self.name))
        self.model = LiveModel(
            self.store, self.settings, self.press, lambda why: self._pending.add(("alarm", why))
        )

    @property
    def name(self) -> str:
        """The press."""
        return self.settings.name

    @property
    def run(self) -> str:
        """The run that is being pressed; none: empty."""
        return self.live.record.run if self.live else ""

    @property
    def problem(self) -> Message | None:
        """What keeps the sensor from saying what it should."""
        return self.refused or self.model.problem

    def step(self, now: float) -> bool:
        """Do what there is to do; return whether there was anything."""
        self.taking = None
        if self.last == -2:
            self._take_up()
        self.model.look(now, self.run)
        if now - self._looked > LOOK_S:
            self._looked = now
            self._look()
        if self.fits.collect(self.model.base, self.model.file):
            self.model.look_again()
        self._write()
        batch = self._read_after(self.last)
        if not batch.scans:
            self.behind = 0
            return False
        self.behind = len(batch.scans)
        names = tuple(c.name for c in batch.channels)
        if self.live is None or len(batch.scans) > 1 or batch.scans[-1].number < self.live.record.first_scan:
            self._look()  # a pressing may have begun and ended among scans that came together
        for scan in batch.scans:
            self._turn(scan.number)
            estimate = self._estimate(scan, names)
            self._unwritten += [] if estimate is None else [estimate]
            self.last = scan.number
        self._write()
        if self.live is not None and len(batch.scans) < BATCH:
            self.live.sensor.look_ahead()  # after the estimates: nobody waits for it
        return True

    def _take_up(self) -> None:
        """Go on behind the last scan that was followed; where none was, with the next to come."""
        last = self.store.last_scan_followed(self.name)
        if last == -1:
            last = self.store.newest_scan_number(self.name)
        last = max(last, self.passed)
        self.fits.take_up_what_was_left(last, self.model.file)
        self.last = last

    def _read_after(self, number: int) -> ScanBatch:
        self.taking = number + 1
        batch = self.store.scans_after(self.name, number, BATCH)
        if batch.damaged and self._damaged_in != self.run:  # once a run: the fit says so again
            self._damaged_in = self.run
            problem = say("store-scan-damaged", scan=batch.damaged[0], store=self.store.label)
            self._pending.add(("alarm", say("of-press", press=self.name, what=problem)))
        self.taking = None
        return batch

    def _write(self) -> None:
        """Store the estimates; where the store refuses, it is tried again at the next step."""
        if self._unwritten:
            self.store.append_estimates(self.name, self._unwritten)
            self._unwritten = []
        self._pending.hand_over()

    # --- runs ---------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Notice a new, changed or finished run."""
        # In this order: a run that ends between the two questions is in the answer to the second.
        record = self.store.open_run(self.name)
        self._ended = self.store.ended_runs_after(self.name, self.last, BATCH)
        if self._ended:
            return
        live = self.live
        if live is not None and (record is None or record.run != live.record.run):
            self._finish(live)
            self.live = live = None
        if record is None:
            self.message = Invalid(InvalidReason.NO_PANEL).message
            return
        version = self.model.version
        if live is None or live.record.header != record.header or live.model != version:
            self._begin(record, version)
        elif live.record.moments != record.moments:
            self.live = live = _Live(record, live.sensor, live.model, live.fitted_open)
        if (
            self.live is not None
            and not self.live.fitted_open
            and record.moments.opened_s == record.moments.opened_s
        ):
            self.live.fitted_open = True
            self.fits.submit(record.run, self.model.file)

    def _turn(self, number: int) -> None:
        """Begin and finish pressings that are over already where their scans begin and end."""
        while self._ended and number > (self._ended[0].last_scan or 0):
            self._leave(self._ended.pop(0).run)
            if not self._ended:
                self._look()  # the next pressing may have begun among these scans, and end before they are through
        if not self._ended or number < self._ended[0].first_scan:
            return
        if self.live is None or self.live.record.run != self._ended[0].run:
            self._leave(self.live.record.run if self.live else "")
            self._begin(self._ended[0], self.model.version)

    def _leave(self, run: str) -> None:
        if self.live is not None and self.live.record.run == run:
            self._finish(self.live)
            self.live = None

    def _begin(self, record: RunRecord, version: str) -> None:
        """Start a sensor and give it the run's scans so far."""
        before = self.live
        same = before is not None and before.record.header == record.header
        fitted = before is not None and before.record.run == record.run and before.fitted_open
        if before is None or before.record.run != record.run:
            self._read_resin()
        sensor = ScanSensor(self.press, record.header, self.model.file, self.resin)
        self.live = _Live(record, sensor, version, fitted)
        self.refused = None
        try:
            self._catch_up(record, estimated_before=same)
            if not same and (remark := panel_remark(record.header, self.model.file)) is not None:
                write_journal(self.store, "warning", say("of-run", run=record.run, what=remark), self.name)
        except StoreUnavailable:
            self.live = None  # to begin again from the first scan, not in the middle
            raise
        self.message = say("sense-follows-run", run=record.run)

    def _read_resin(self) -> None:
        """Take the resin file as it stands when a pressing begins; one that cannot be read changes nothing."""
        try:
            self.resin = resin_of(self.settings) or self.resin
        except InputError as error:
            self._pending.add(("alarm", say("sense-resin-not-taken", why=spoken(error))))

    def _catch_up(self, record: RunRecord, *, estimated_before: bool) -> None:
        """Give the sensor the run's scans so far."""
        number = max(record.first_scan - 1, self.passed)
        while number < self.last:
            batch = self._read_after(number)
            names = tuple(c.name for c in batch.channels)
            scans = [s for s in batch.scans if s.number <= self.last]
            if not scans:
                break
            estimates = [self._estimate(scan, names) for scan in scans]
            if not estimated_before:  # a new model does not rewrite the old one's estimates
                self.store.append_estimates(self.name, [e for e in estimates if e is not None])
            number = scans[-1].number

    def _estimate(self, scan: Scan, names: tuple[str, ...]) -> StoredEstimate | None:
        """Return the estimate of a scan; between pressings once a second."""
        live = self.live
        if live is None or scan.number < live.record.first_scan:
            if 0.0 <= scan.monotonic_s - self._idle_s < IDLE_S:
                return None
            self._idle_s = scan.monotonic_s
            return stored_estimate(
                scan, Estimate(scan.monotonic_s, PressState.IDLE, invalid=Invalid(InvalidReason.NO_PANEL)), "", {}
            )
        if scan.number in self.poisoned:
            failed = Estimate(scan.monotonic_s, None, invalid=Invalid(InvalidReason.CALCULATION_FAILED))
            return stored_estimate(scan, failed, live.model, {})
        self.taking = scan.number
        estimate = self._estimate_of(live, scan, names)
        self.taking = None
        return estimate

    def _estimate_of(self, live: _Live, scan: Scan, names: tuple[str, ...]) -> StoredEstimate:
        values = {
            name: value if quality.usable else float("nan")
            for name, value, quality in zip(names, scan.values, scan.qualities, strict=True)
        }
        time_s = round(scan.monotonic_s - live.record.zero_monotonic_s, 6)
        begun = time.perf_counter()
        try:
            if live.record.damage is not None:  # nobody knows which panel it is
                raise ScansUnreadable(live.record.damage)
            estimate = live.sensor.update(time_s, values)
        except InputError as error:
            problem = spoken(error)
            if self.refused is None:  # once a run: the estimates say the same at every scan
                self._pending.add(("warning", problem))
            self.refused = problem
            estimate = Estimate(time_s, None, invalid=Invalid(InvalidReason.RUN_REFUSED, {"problem": problem}))
        self.update_us += UPDATE_SHARE * (1e6 * (time.perf_counter() - begun) - self.update_us)
        details = details_of(live.sensor, estimate)
        course = live.sensor.forecast.course
        if estimate.valid and course and course is not live.course:
            live.course = course
            details["course"] = [[round(v, 1) for v in row] for row in course]
        self._report_departing(live, time_s)
        return stored_estimate(scan, estimate, live.model, details)

    def _report_departing(self, live: _Live, time_s: float) -> None:
        """Journal, once a run, the channels that depart for longer than a switch."""
        now = live.sensor.departing
        live.departs_since = {column: live.departs_since.get(column, time_s) for column in now}
        for column, kelvin in now.items():
            departure = (live.record.run, column)
            if time_s - live.departs_since[column] > LAG_GONE_S and departure not in self._departed:
                side = "below" if kelvin < 0.0 else "above"
                message = say("channel-departs", column=column, kelvin=abs(kelvin), side=side, run=live.record.run)
                self._pending.add(("warning", message))
                self._departed.add(departure)

    def _finish(self, live: _Live) -> None:
        """A run is over: fit all of it."""
        self.fits.submit_ended(live.record.run, self.model.file)


def resin_of(settings: PressSettings) -> Resin | None:
    """Return the resin of a press's settings, None without one. Raises `InputError`."""
    return None if settings.resin is None else read_resin(settings.resin)
