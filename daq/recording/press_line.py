"""One press in the recorder: its scanner, its detector, its runs, in a thread of its own."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

from daq.drivers import DataLogger, LoggerSettings, SuccessorLogger, uncorrected
from daq.press.events import PressEventDetector, columns_of
from daq.press.header import doubts
from daq.press.late_beginning import LateBeginning
from daq.press.press_file import Press
from daq.press.wires import CLOSED, Wires
from daq.process.config import PressSettings, press_of
from daq.recording.acquisition import ClockWatch, LoggerThread, Scanner
from daq.recording.run_keeper import Change, RunKeeper, RunNames, RunRules
from daq.records import Channel, PressEvent, Quality, Scan
from daq.store import PressKey, Store, StoreUnavailable
from daq.store.outbox import Outbox
from daq.store.write_batch import WriteBatch
from daq.supervision import ENDS_S, SILENT_S, SupervisedThread
from daq.tables import text_in
from daq.words import Message, say

LOG = logging.getLogger("kerntemp.record")

# Numbers without another source were set by hand, 2026-11.

_STUCK_AFTER_S = 20.0
"""Longer than any wait for devices on one bus: a driver that is still in its read hangs. [s]"""
_DISAGREEMENT_EVERY_S = 600.0
"""A limit switch that contradicts the temperatures is journalled at once, then at most this often. [s]"""
LEFT_OUT_EVERY_S = 60.0
"""Scans left out are journalled at once, then at most this often, and counted over as long. [s]"""
_TOO_MANY_LEFT_OUT = 0.05
"""Share of the scans; single ones go missing wherever a machine is busy for a moment."""

Level = Literal["info", "warning", "alarm"]


class Journal(Protocol):
    """Writes to log and journal."""

    def __call__(self, level: Level, message: Message, press: str | None = None, **detail: Any) -> None:
        """Write a message with its details."""


@dataclass(frozen=True)
class LoggerPlan:
    """A logger's settings with the state of the files they name: what differs needs the logger anew."""

    settings: LoggerSettings
    calibration: str
    profile: str
    lacking: Message | None
    """Remark on a calibration file that nobody has made yet."""


def plan_of(settings: LoggerSettings) -> LoggerPlan:
    """Return what a logger depends on."""
    own = Path(settings.profile) if settings.profile.endswith(".toml") else None
    return LoggerPlan(settings, _text(settings.calibration), _text(own), uncorrected(settings))


def _text(path: Path | None) -> str:
    return "" if path is None or not path.is_file() else text_in(path)


@dataclass(frozen=True)
class _Change:
    """All that changed settings name, read: a drive that hangs must not hold up the thread that records."""

    settings: PressSettings
    press: Press
    press_file: str
    rules: RunRules
    plans: tuple[LoggerPlan, ...]
    loggers: Mapping[str, DataLogger]
    """By name; only those that are new or differ will be asked, which the thread that records decides."""


class Shared(NamedTuple):
    """What all presses of a recorder have in common."""

    store: Store
    outbox: Outbox
    speed: float
    """Of the clock; 1 but on a virtual press."""
    journal: Journal
    stop: threading.Event


class PressLine:
    """One press: scans by the schedule, events, runs."""

    def __init__(
        self,
        settings: PressSettings,
        text: str,
        loggers: Sequence[DataLogger],
        shared: Shared,
    ) -> None:
        self.settings = settings
        store, outbox, speed, journal, stop = shared
        self._outbox, self._stop, self._journal, self._speed = outbox, stop, journal, speed
        press = press_of(settings)
        self._detector, self._late = _watchers(press)
        self._newest: Scan | None = None
        self._left_out: list[tuple[float, int]] = []
        """Scans before which ticks went by, by their times, and how many did: not in the journal yet."""
        self._left_out_journalled_s = self._disagreed_s = -math.inf
        self._gone_by: deque[tuple[float, int]] = deque(maxlen=1000)
        """When ticks went by lately, and how many. [s]"""
        self._fresh_s = time.monotonic()
        self._clock = ClockWatch(speed)
        self._changed: deque[_Change] = deque(maxlen=1)
        """The newest change that waits for the end of a run; put in by one thread and taken out by another."""
        self._press_file = text_in(settings.file)
        self._plans = tuple(plan_of(x) for x in settings.logger)
        threads = [self._thread_of(x, logger) for x, logger in zip(self._plans, loggers, strict=True)]
        channels = _channels(threads, self._detector.wires)
        outbox.expect(channels, settings.name, self._press_file)
        self._key, names = self._enter(store, channels)
        self._keeper = RunKeeper(_rules(settings, text, self._plans), names, _panel_places(press, channels))
        self._scanner = Scanner(threads, self._period_s, speed, self._key.next_number)
        self._handed_over = -1
        """The newest scan that is on its way to the store."""
        self._thread = SupervisedThread("scans", self._work, lambda fault: self._of_press("alarm", fault))
        for doubt in doubts(settings.header):
            self._of_press("warning", doubt)

    def _enter(self, store: Store, channels: tuple[Channel, ...]) -> tuple[PressKey, RunNames]:
        """Take a place in the store, at once or, where it is away or behind, later."""
        name = self.settings.name
        if not self._outbox.behind:
            with suppress(StoreUnavailable):  # the outbox will meet it too, and says so
                interrupted = store.interrupt_open_runs(name)
                key = store.register_press(name, channels, self._press_file)
                names = RunNames(name, store.unused_run_name(name, datetime.now(UTC)))
                for run in interrupted:
                    self._journal("warning", say("run-interrupted", run=run), name)
                return key, names
        return self._outbox.later_key(name, channels, self._press_file), RunNames(name, None)

    def _thread_of(self, plan: LoggerPlan, logger: DataLogger) -> LoggerThread:
        name = plan.settings.name
        if plan.lacking is not None:
            self._of_press("warning", plan.lacking, {"logger": name})
        return LoggerThread(name, logger, self._of_press)

    @property
    def _period_s(self) -> float:
        return 1.0 / (self.settings.rate_hz * self._speed)

    # --- a changed configuration ------------------------------------------------------------------------

    def change(self, settings: PressSettings, text: str) -> None:
        """Take over changed settings between runs. Raises `InputError` for what is wrong in them."""
        press, press_file = press_of(settings), text_in(settings.file)
        plans = tuple(plan_of(x) for x in settings.logger)
        loggers = {p.settings.name: SuccessorLogger(p.settings) for p in plans}
        rules = _rules(settings, text, plans)
        self._changed.append(_Change(settings, press, press_file, rules, plans, loggers))

    def _take_over(self) -> None:
        """Swap settings between two scans; loggers that stay do not notice."""
        if not self._changed or self._keeper.open_run is not None:
            return
        change = self._changed.pop()
        if (change.press_file, change.settings.limit_switch) != (self._press_file, self.settings.limit_switch):
            self._press_file = change.press_file
            self._detector, self._late = _watchers(change.press)
        self.settings = change.settings
        running = zip(self._plans, self._scanner.loggers, strict=True)
        kept = {plan.settings.name: thread for plan, thread in running if plan in change.plans}
        threads = [
            kept.get(name := x.settings.name) or self._thread_of(x, change.loggers[name]) for x in change.plans
        ]
        channels = _channels(threads, self._detector.wires)
        if channels != self._key.channels:
            self._key = replace(self._key, channels=channels)
            self._outbox.expect(channels, self.settings.name, self._press_file)
        self._keeper.change(change.rules, _panel_places(change.press, channels))
        self._scanner.change(threads, self._period_s, self._stop)
        self._plans = change.plans
        self._journal("info", say("configuration-in-force"), self.settings.name)

    # --- the thread -------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to record."""
        self._scanner.start(self._stop)
        self._thread.start()

    def join(self) -> None:
        """Wait for the end: a run under way is closed as interrupted."""
        self._thread.join(ENDS_S)
        self._scanner.join(ENDS_S)

    def _work(self) -> None:
        while (scan := self._scanner.scan(self._stop)) is not None:
            try:
                self._take(scan)
                self._take_over()
            except Exception as error:  # noqa: BLE001 - scans are stored whatever becomes of runs
                self._thread.failed(error)
                if scan.number > self._handed_over:
                    self._outbox.put(WriteBatch(self._key, (self._bare(scan),)))
            else:
                self._thread.worked()
        self._journal_left_out()
        end = self._keeper.stop()
        if end is not None:
            self._outbox.put(WriteBatch(self._key, end=end))

    def _take(self, scan: Scan) -> None:
        self._watch_clock(scan)
        self._watch_schedule(scan)
        usable = self._usable(scan)
        events = self._detector.update(scan.monotonic_s, usable)
        known = bool(events) or self._detector.closed_by_wire is not None
        if self._late.look(scan.monotonic_s, usable, known=known):
            self._journal("warning", say("scans-begin-late", press=self.settings.name), self.settings.name)
        self._watch_wires(scan)
        scan = self._with_closed(scan)
        changes = self._keeper.take(scan, events)
        self._newest, self._fresh_s = scan, time.monotonic()
        for batch in tuple(in_order(self._key, scan, events, changes)):
            self._outbox.put(batch)
        self._handed_over = scan.number
        for event in events:
            self._log(event)

    def _bare(self, scan: Scan) -> Scan:
        """Return a scan without what is worked out of it."""
        lacking = len(self._key.channels) - len(scan.values)
        values, qualities = (math.nan,) * lacking, (Quality.MISSING,) * lacking
        return replace(scan, values=(*scan.values, *values), qualities=(*scan.qualities, *qualities))

    def _log(self, event: PressEvent) -> None:
        run = self._keeper.open_run
        LOG.info("press %s: %s%s", self.settings.name, event.kind.value, f" (run {run})" if run else "")

    def _usable(self, scan: Scan) -> dict[str, float]:
        """Return what was read, NaN where it is not usable."""
        columns = zip(self._key.channels, scan.values, scan.qualities, strict=False)  # without what wires add
        return {channel.name: value if quality.usable else math.nan for channel, value, quality in columns}

    def _with_closed(self, scan: Scan) -> Scan:
        """Add the column ``closed``, where a wire of another name or kind shows it."""
        if len(self._key.channels) == len(scan.values):
            return scan
        columns, closed = self._detector.wires.columns, self._detector.closed_by_wire
        named = zip(self._key.channels, scan.qualities, strict=False)
        qualities = [quality for channel, quality in named if channel.name in columns]
        qualities = [quality for quality in qualities if quality.usable] or qualities
        value = math.nan if closed is None or not qualities[0].usable else float(closed)
        return replace(scan, values=(*scan.values, value), qualities=(*scan.qualities, qualities[0]))

    def _watch_wires(self, scan: Scan) -> None:
        """Journal that wire and temperatures contradict each other, now and then while they do."""
        disagreement = self._detector.disagreement
        if disagreement is None or scan.monotonic_s - self._disagreed_s < _DISAGREEMENT_EVERY_S:
            return
        self._disagreed_s = scan.monotonic_s
        self._of_press("warning", disagreement, {"scan": scan.number, "run": self._keeper.open_run})

    def _watch_clock(self, scan: Scan) -> None:
        step = self._clock.step(scan)
        if step is not None:
            self._journal(
                "warning",
                say("clock-set", sign="+" if step > 0 else "-", seconds=abs(step)),
                self.settings.name,
                step_s=step,
                scan=scan.number,
            )

    def _watch_schedule(self, scan: Scan) -> None:
        """Journal where scans begin and which ones were left out, so that none is missing without a word."""
        if self._newest is None:
            name, period_s = self.settings.name, self._scanner.period_s * self._speed
            begin = say("scans-begin", press=name)
            self._journal("info", begin, name, monotonic_s=scan.monotonic_s, period_s=period_s)
        if self._scanner.left_out:
            self._left_out.append((scan.monotonic_s, self._scanner.left_out))
            self._gone_by.append((time.monotonic(), self._scanner.left_out))
        if self._left_out and scan.monotonic_s - self._left_out_journalled_s > LEFT_OUT_EVERY_S:
            self._left_out_journalled_s = scan.monotonic_s
            self._journal_left_out()

    def _journal_left_out(self) -> None:
        if not self._left_out:
            return
        left_out, self._left_out = self._left_out, []
        count = sum(count for _, count in left_out)
        message = say("scans-left-out", press=self.settings.name, count=count)
        self._journal("info", message, self.settings.name, before_monotonic_s=left_out)

    def _of_press(self, level: Level, message: Message, detail: Mapping[str, Any] | None = None) -> None:
        name = self.settings.name
        self._journal(level, say("of-press", press=name, what=message), name, **(detail or {}))

    # --- how it is --------------------------------------------------------------------------------------

    def stalled(self) -> Message | None:
        """Return why this press must not count as alive; None while fresh scans come.

        A device that is off is no standstill: its driver comes back with that news, and goes on asking.
        """
        if faults := [x for x in (self._thread.fault, *(y.fault for y in self._scanner.loggers)) if x]:
            return say("of-press", press=self.settings.name, what=faults[0])
        now_s, periods_s = time.monotonic(), 2.0 / self.settings.rate_hz
        if now_s - self._fresh_s > SILENT_S + periods_s:
            return say("press-stalled", press=self.settings.name, seconds=now_s - self._fresh_s)
        stuck = [x.name for x in self._scanner.loggers if now_s - x.returned_s > _STUCK_AFTER_S + periods_s]
        return say("driver-stuck", press=self.settings.name, logger=stuck[0]) if stuck else None

    def problems(self) -> list[Message]:
        """Return what is wrong now."""
        name = self.settings.name
        problems = [
            say("logger-problem", press=name, logger=x.name, why=x.trouble)
            for x in self._scanner.loggers
            if x.lost and x.trouble
        ]
        if self._detector.disagreement:
            problems.append(say("problem-of-press", press=name, what=self._detector.disagreement))
        since_s = time.monotonic() - LEFT_OUT_EVERY_S
        gone_by = sum(count for at_s, count in tuple(self._gone_by) if at_s > since_s)
        if gone_by * self._period_s > _TOO_MANY_LEFT_OUT * LEFT_OUT_EVERY_S:
            problems.append(say("scans-left-out-lately", press=name, count=gone_by))
        return problems

    def report(self) -> dict[str, Any]:
        """Return what the heartbeat says about this press."""
        newest = self._newest
        return {
            "press": self.settings.name,
            "state": self._detector.state or "unknown",
            "open_run": self._keeper.open_run,
            "rate_hz": self.settings.rate_hz,
            "speed": self._speed,
            "newest_scan": None if newest is None else newest.number,
            "newest_utc": None if newest is None else newest.utc.isoformat(),
            "missed_ticks": self._scanner.missed_ticks,
        }

    def logger_reports(self) -> list[dict[str, Any]]:
        """Return what the heartbeat says about each logger."""
        return [{"press": self.settings.name, **x.report()} for x in self._scanner.loggers]


def _rules(settings: PressSettings, text: str, plans: Sequence[LoggerPlan]) -> RunRules:
    """Return how runs are cut; they keep the configuration with the calibrations in force."""
    used = {p.settings.calibration: p.calibration for p in plans if p.settings.calibration}
    for path, content in used.items():
        text += f"\n# {path}:\n" + "".join(f"#   {line}\n" for line in content.splitlines())
    s = settings
    return RunRules(s.name, s.pre_trigger_s, s.post_removal_s, s.longest_run_s, s.header, text)


def _panel_places(press: Press, channels: Sequence[Channel]) -> list[int]:
    faces = columns_of(press).of_face([c.name for c in channels])
    return [i for i, c in enumerate(channels) if c.name in (*faces[0], *faces[1])]


def _watchers(press: Press) -> tuple[PressEventDetector, LateBeginning]:
    return PressEventDetector(press), LateBeginning(press)


def _channels(threads: Sequence[LoggerThread], wires: Wires) -> tuple[Channel, ...]:
    """Return all channels, last what wires of other names say as ``closed``; a wire is no temperature."""
    every = [c for thread in threads for c in thread.channels]
    plain = tuple(Channel(c.name, wires.unit_of(c.name)) if c.name in wires.columns else c for c in every)
    return plain if wires.columns == (CLOSED,) else (*plain, Channel(CLOSED, ""))


def in_order(
    key: PressKey, scan: Scan, events: Sequence[PressEvent], changes: Sequence[Change]
) -> Iterator[WriteBatch]:
    """Yield a scan and all it brought about as the store must learn of it.

    An end that makes room for a new run goes before; the scan takes what follows; a batch holds one of each.
    """
    begins = next((i for i, (begin, _) in enumerate(changes) if begin is not None), 0)
    for _, end in changes[:begins]:
        yield WriteBatch(key, end=end)
    begin, end = changes[begins] if changes else (None, None)
    rest = list(changes[begins + 1 :])
    if begin is not None and rest and rest[0][0] is None:
        _, end = rest.pop(0)
    yield WriteBatch(key, (scan,), tuple(events), begin, end)
    for begin, end in rest:
        yield WriteBatch(key, begin=begin, end=end)
