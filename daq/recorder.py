"""The logging daemon: reads all loggers, finds press events, stores scans and runs, and keeps going.

Three kinds of threads: one a logger, one a press (schedule, events, runs), one that writes to the store.
No logger waits for another, and none waits for the store. A scan counts as recorded when its commit is
done; `record` then calls `acknowledged`. On start, runs that a crash left open become ``interrupted``.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from daq.acquisition import ClockWatch, LoggerThread, Scanner
from daq.config import Config, PressSettings, load_config
from daq.drivers import open_logger
from daq.press_events import PressEventDetector, columns_of
from daq.pressfile import Press, read_press
from daq.records import Channel, InputError, PressEvent, Scan
from daq.runkeeper import RunKeeper, RunNames, RunRules
from daq.store import PressKey, Store, StoreUnavailable, open_store
from daq.store.outbox import Outbox
from daq.store.parcels import Entry, Parcel

LOG = logging.getLogger("kerntemp.record")
PROCESS = "record"
_BEAT_S = 1.0
_GATHER_S = 0.1
"""An accelerated recorder gathers scans this long for one commit. [s]"""
_HOLD_S = 1.5
"""The detector may use a channel's last value this long: some loggers are slower than the scans. [s]"""
_TIDY_S = 600.0
"""How often old idle scans are thinned. [s]"""

Level = Literal["info", "warning", "alarm"]


def record(
    config: Config,
    *,
    stop: threading.Event | None = None,
    acknowledged: Callable[[Parcel], None] | None = None,
) -> None:
    """Record until stopped by `stop`, SIGTERM or SIGINT.

    Raises
    ------
    InputError
        For what is wrong in press files, profiles or the store's address.
    """
    stop = stop or threading.Event()
    _stop_on_signals(stop)
    presses = [(settings, read_press(settings.file)) for settings in config.press]
    loggers = {settings.name: [open_logger(x) for x in settings.logger] for settings, _ in presses}
    store = _store_when_ready(config.store.url, stop)
    if store is None:
        return
    with store:
        server = store.database.dialect != "sqlite"
        outbox = Outbox(
            store,
            buffer=config.store.buffer if server else None,
            gather_s=_GATHER_S if config.clock.speed > 1 else 0.0,
            acknowledged=acknowledged,
            say=_log,
        )
        lines = [
            _PressLine(config, settings, press, loggers[settings.name], store, outbox, stop)
            for settings, press in presses
        ]
        outbox.start()
        for line in lines:
            line.start()
        _say(outbox, "info", f"recording {', '.join(s.name for s, _ in presses)}", None)
        try:
            _watch(config, store, lines, outbox, stop)
        finally:
            stop.set()
            for line in lines:
                line.join()
            outbox.beat(PROCESS, _status(lines, outbox, "stopped"))
            _say(outbox, "info", "recording ends", None)
            outbox.close()


def _watch(
    config: Config, store: Store, lines: Sequence[_PressLine], outbox: Outbox, stop: threading.Event
) -> None:
    """Until stopped: signs of life, changes of the configuration, thinning of old idle scans."""
    watch, tidied = _ConfigWatch(config, outbox), time.monotonic()
    while not stop.wait(_BEAT_S):
        outbox.beat(PROCESS, _status(lines, outbox, "running"))
        watch.look(lines)
        if time.monotonic() - tidied > _TIDY_S:
            tidied = time.monotonic()
            _tidy(store, config.store.keep_idle_days)


def _stop_on_signals(stop: threading.Event) -> None:
    if threading.current_thread() is not threading.main_thread():
        return
    for name in ("SIGTERM", "SIGINT", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: stop.set())


def _store_when_ready(url: str, stop: threading.Event) -> Store | None:
    """Open the store; a server that is away now is asked again until it comes."""
    said = False
    while True:
        try:
            return open_store(url)
        except StoreUnavailable as error:
            if not said:
                LOG.warning("%s; trying again", error)
                said = True
        if stop.wait(2.0):
            return None


def _tidy(store: Store, keep_days: float) -> None:
    try:
        store.thin_idle(datetime.now(UTC) - timedelta(days=keep_days))
    except StoreUnavailable as error:
        LOG.info("idle scans are not thinned now: %s", error)


class _ConfigWatch:
    """Notices a changed configuration; each press takes it over between its runs."""

    def __init__(self, config: Config, outbox: Outbox) -> None:
        self._config, self._outbox = config, outbox
        self._seen = self._stamp()

    def _stamp(self) -> tuple[int, ...]:
        files = [self._config.path, *(p.file for p in self._config.press)]
        return tuple(f.stat().st_mtime_ns if f is not None and f.exists() else 0 for f in files)

    def look(self, lines: Sequence[_PressLine]) -> None:
        """Hand a changed configuration to the presses; a wrong one is told once and left."""
        if self._config.path is None or self._stamp() == self._seen:
            return
        self._seen = self._stamp()
        try:
            fresh = load_config(self._config.path)
            for line in lines:
                line.change(fresh.press_named(line.settings.name), fresh.text)
        except InputError as error:
            _say(self._outbox, "warning", f"{error}; recording goes on with the configuration before", None)
            return
        self._config = fresh
        self._seen = self._stamp()
        _say(self._outbox, "info", "configuration changed; it takes effect between runs", None)


def _log(level: str, sentence: str) -> None:
    LOG.log({"info": logging.INFO, "warning": logging.WARNING}.get(level, logging.ERROR), "%s", sentence)


def _say(outbox: Outbox, level: Level, sentence: str, press: str | None, **detail: Any) -> None:
    _log(level, sentence)
    outbox.put(Entry(level, PROCESS, sentence, press, detail or None))


def _status(lines: Sequence[_PressLine], outbox: Outbox, state: str) -> dict[str, Any]:
    problems = [p for line in lines for p in line.problems()]
    if outbox.trouble:
        problems.append(f"{outbox.trouble} ({outbox.waiting} waiting)")
    if outbox.lost:
        problems.append(f"{outbox.lost} scans lost: the store was away for longer than memory lasts")
    return {
        "state": state,
        "pid": os.getpid(),
        "message": "; ".join(problems) or f"{outbox.written} scans recorded",
        "problems": problems,
        "acknowledged": outbox.written,
        "waiting": outbox.waiting,
        "presses": [line.report() for line in lines],
        "loggers": [report for line in lines for report in line.logger_reports()],
    }


class _PressLine:
    """One press: its scanner, its detector, its runs, in a thread of its own."""

    def __init__(
        self,
        config: Config,
        settings: PressSettings,
        press: Press,
        loggers: Sequence[Any],
        store: Store,
        outbox: Outbox,
        stop: threading.Event,
    ) -> None:
        self.settings = settings
        self._outbox, self._stop = outbox, stop
        self._detector = PressEventDetector(press)
        self._held: dict[str, tuple[float, float]] = {}
        self._rates: Counter[str] = Counter()
        self._newest: Scan | None = None
        self._clock = ClockWatch(config.clock.speed)
        threads = [
            LoggerThread(x.name, logger, self._logger_said)
            for x, logger in zip(settings.logger, loggers, strict=True)
        ]
        channels = tuple(c for t in threads for c in _with_units(t.channels))
        self._changed: tuple[PressSettings, str] | None = None
        self._press_file = settings.file.read_text(encoding="utf-8")
        interrupted = store.interrupt_open_runs(settings.name)
        self._key: PressKey = store.register_press(settings.name, channels, self._press_file)
        for run in interrupted:
            _say(outbox, "warning", f"run {run} was interrupted; its data are kept", settings.name)
        names = RunNames(settings.name, store.unused_run_name(settings.name, datetime.now(UTC)))
        faces = columns_of(press).of_face([c.name for c in channels])
        panel = [i for i, c in enumerate(channels) if c.name in (*faces[0], *faces[1])]
        self._keeper = RunKeeper(_rules(settings, config.text), names, panel)
        period = 1.0 / (settings.rate_hz * config.clock.speed)
        self._scanner = Scanner(threads, period, config.clock.speed, self._key.next_number)
        self._thread = threading.Thread(target=self._work, name=f"press {settings.name}", daemon=True)

    def change(self, settings: PressSettings, text: str) -> None:
        """Take over changed settings before the next run. Raises `InputError` for what needs a new start."""
        if settings.logger != self.settings.logger or settings.rate_hz != self.settings.rate_hz:
            raise InputError(
                f"press {settings.name}: changed loggers or rate_hz need a new start of kerntemp record"
            )
        self._changed = (settings, text)

    def _take_over(self) -> None:
        """Swap settings between two scans; nothing is lost, the loggers do not notice."""
        if self._changed is None or self._keeper.open_run is not None:
            return
        (settings, text), self._changed = self._changed, None
        press_file = settings.file.read_text(encoding="utf-8")
        if press_file != self._press_file:
            self._press_file = press_file
            self._detector = PressEventDetector(read_press(settings.file))
        self.settings = settings
        self._keeper.rules = _rules(settings, text)

    def start(self) -> None:
        """Begin to record."""
        self._scanner.start(self._stop)
        self._thread.start()

    def join(self) -> None:
        """Wait for the end: a run under way is closed as interrupted."""
        self._thread.join(10.0)
        self._scanner.join(5.0)

    def _work(self) -> None:
        while True:
            try:
                scan = self._scanner.scan(self._stop)
                if scan is None:
                    break
                self._take(scan)
            except Exception:
                LOG.exception("press %s: a fault in the recorder; recording goes on", self.settings.name)
                if self._stop.wait(1.0):
                    break
        end = self._keeper.stop()
        if end is not None:
            self._outbox.put(Parcel(self._key, end=end))

    def _take(self, scan: Scan) -> None:
        self._watch_clock(scan)
        self._take_over()
        events = self._detector.update(scan.monotonic_s, self._usable(scan))
        changes = self._keeper.take(scan, events)
        self._newest = scan
        begins = [c for c in changes if c[0] is not None]
        first = begins[0][0] if begins else None
        for begin, end in changes:
            if end is not None and (begin is None and first is not None and end.last_scan < first.first_scan):
                self._outbox.put(Parcel(self._key, end=end))
        ends = [end for _, end in changes if end is not None and (first is None or end.run == first.run)]
        self._outbox.put(Parcel(self._key, (scan,), tuple(events), first, ends[0] if ends else None))
        for event in events:
            self._tell(event)

    def _tell(self, event: PressEvent) -> None:
        run = self._keeper.open_run
        LOG.info("press %s: %s%s", self.settings.name, event.kind.value, f" (run {run})" if run else "")

    def _usable(self, scan: Scan) -> dict[str, float]:
        """Return the usable values, for a slow logger's channels the last ones for a moment longer."""
        now: dict[str, float] = {}
        for channel, value, quality in zip(self._key.channels, scan.values, scan.qualities, strict=True):
            if quality.usable and value == value:
                self._held[channel.name] = (scan.monotonic_s, value)
                now[channel.name] = value
            else:
                at, held = self._held.get(channel.name, (float("-inf"), float("nan")))
                now[channel.name] = held if scan.monotonic_s - at <= self._hold_s else float("nan")
        return now

    @property
    def _hold_s(self) -> float:
        return max(_HOLD_S, 1.5 / self.settings.rate_hz)

    def _watch_clock(self, scan: Scan) -> None:
        step = self._clock.step(scan)
        if step is not None:
            _say(
                self._outbox,
                "warning",
                f"the clock of this machine was set by {step:+.1f} s; times within a run are not affected",
                self.settings.name,
                step_s=step,
                scan=scan.number,
            )

    def _logger_said(self, level: str, sentence: str, detail: Mapping[str, Any]) -> None:
        known: Level = "warning" if level == "warning" else "info"
        _say(self._outbox, known, f"press {self.settings.name}: {sentence}", self.settings.name, **detail)

    def problems(self) -> list[str]:
        """Return what is wrong now, in sentences."""
        said = [
            f"{self.settings.name}: logger {x.name}: {x.message or 'no answer yet'}"
            for x in self._scanner.loggers
            if x.lost
        ]
        if self._detector.disagreement:
            said.append(f"{self.settings.name}: {self._detector.disagreement}")
        return said

    def report(self) -> dict[str, Any]:
        """Return what the heartbeat says about this press."""
        newest = self._newest
        return {
            "press": self.settings.name,
            "state": self._detector.state or "unknown",
            "open_run": self._keeper.open_run,
            "rate_hz": self.settings.rate_hz,
            "newest_scan": None if newest is None else newest.number,
            "newest_utc": None if newest is None else newest.utc.isoformat(),
            "missed_ticks": self._scanner.missed_ticks,
        }

    def logger_reports(self) -> list[dict[str, Any]]:
        """Return what the heartbeat says about each logger."""
        return [{"press": self.settings.name, **x.report()} for x in self._scanner.loggers]


def _rules(settings: PressSettings, text: str) -> RunRules:
    return RunRules(
        settings.name,
        settings.pre_trigger_s,
        settings.post_removal_s,
        settings.longest_run_s,
        settings.header,
        text,
    )


def _with_units(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """A limit switch is no temperature."""
    return tuple(Channel(c.name, "") if c.name == "closed" else c for c in channels)


def main(arguments: Sequence[str] | None = None) -> int:
    """Record by a configuration file, printing each commit: ``python -m daq.recorder kerntemp.toml``."""
    import sys

    given = list(sys.argv[1:] if arguments is None else arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    config = load_config(Path(given[0] if given else "kerntemp.toml"))

    def acknowledged(parcel: Parcel) -> None:
        if parcel.scans:
            with suppress(OSError):
                sys.stdout.write(f"{parcel.key.name} {parcel.scans[-1].number}\n")
                sys.stdout.flush()

    record(config, acknowledged=acknowledged)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
