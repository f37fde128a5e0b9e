"""The logging daemon: reads all loggers, finds press events, stores scans and runs, and keeps going.

Three kinds of threads: one a logger, one a press (schedule, events, runs), one that writes to the store.
No logger waits for another, and none waits for the store. A scan counts as recorded when its commit is
done; `record` then calls `acknowledged`. On start, runs that a crash left open become ``interrupted``.

What the operator reads on standard error and in the journal, once for each change of state:

=============================  ==================================================================================
what happened                  message (level), and what happens meanwhile
=============================  ==================================================================================
server away, also at start     ``store ...: connection refused; check that the database server runs and is
                               reachable; scans wait in .../kerntemp-buffer.sqlite, enough for N h`` (alarm);
                               back-filled in order, then ``store ... takes data again`` (info)
server silent                  ``connection given up: the server has been silent for 8 s and takes no other; check
                               that the database server runs and is reachable; scans wait in ...`` or
                               ``connection timeout expired; ...`` (alarm), within 15 s; then as above
store locked                   ``database is locked; another process holds it; close other programs that have the
                               file open; scans wait in memory, enough for N h`` (alarm)
disk full                      ``disk is full; free space on the disk; recording goes on by itself`` (alarm)
disk read-only                 ``unable to open ...; check that the folder exists, may be written, and its disk is
                               not mounted read-only`` or ``no permission to write; check owner and mount`` (alarm)
buffer's disk full too         ``buffer ...; free space on its disk; scans wait in memory`` (alarm)
buffer unusable at the start   ``buffer ...: ...; check its disk and folder, or give another file as buffer of
                               [store]; recording goes on, but while the store is away scans wait in
                               memory`` (alarm)
room used up                   ``N scans lost: the store was unreachable for longer than there was room``
                               (problem in /health)
store of a newer version       ``made by a newer version (schema X, this version knows Y); update Kerntemp or give
                               another store``: at start exit status 2; behind a server that came back, an alarm
file damaged                   ``the file is damaged; restore the newest backup with kerntemp backup --restore``
thread failed unexpectedly     ``writer: unexpected fault: ...; it is restarted`` (alarm); no watchdog meanwhile
page watch stands              ``the check of .../kerntemp.sqlite for damage does not come to an end; check the
                               disk`` (problem in /health); no watchdog meanwhile
buffer damaged or gone         ``buffer ... is damaged (...): set aside as ...; N entries could be read, M
                               are lost; recording goes on`` (alarm)
entry no store takes           ``the store does not take ...; set aside in ....set-aside.jsonl, everything else is
                               written`` (alarm)
server takes no changes        ``store ...: cannot execute INSERT in a read-only transaction; ...``
                               (alarm), scans wait; also without permission or a table; back-filled then
store restored meanwhile       ``store ...: its tables are missing or not all there, as while a backup is being
                               restored; ...; scans wait in ...`` (alarm), back-filled when they are there again
store on an older state        ``store ...: it has gone back to an older state, ...; scans N to M of press lab,
                               ..., were written and are not in it any more`` (alarm); recording goes on there
store without this press       ``store ...: press lab is not in it any more, ...`` (alarm); it is entered anew
name of a run taken            ``run ... is in the store already; this pressing is stored as ...`` (warning)
started within a pressing      ``press lab: recording begins with a panel that is hot already; ...`` (warning):
                               without a wire nobody knows its closing, its scans are kept without a run
recorder was killed            ``run ... was interrupted; its data are kept`` (warning), recording goes on
second recorder, same machine  ``press lab: another recorder writes it into ...; stop that one first`` or ``buffer
                               ...: another recorder uses it``: exit status 2, the first is not disturbed
two recorders on one press     ``scan N is there already with other values; another recorder writes to this
                               press: stop one of them`` (alarm); a minute after the other has ended ``what waited
                               here is stored behind its scans`` (warning)
clock set                      ``the clock of this machine was set by -3600.0 s; times within a run are not
                               affected`` (warning)
logger silent or unplugged     ``logger X does not answer: ...; recording goes on without it, trying again``
                               (warning), then ``logger X answers again`` (info)
switch against temperatures    ``press lab: the limit switch reports open, but the upper face is hot; check it``
                               (warning), at most every 10 minutes; the switch decides
machine too busy               ``press lab: 3 scans left out, this machine was too busy`` (info), at most every
                               minute; the journal's detail says before which scans; from one in twenty on, or
                               with 1000 scans waiting to be written, a problem in /health
calibration file not made yet  ``logger X: values are not corrected, X.toml is not there yet; kerntemp calibrate
                               --write makes it`` (warning); it is taken over once it is there
configuration changed          ``it takes effect between runs``, ``the changed configuration is in force`` (info)
configuration wrong            file, key and value; ``recording goes on with the previous configuration`` (warning)
configuration hangs            ``reading FILE, or a file it names, has stalled``, in /health; recording goes on
=============================  ==================================================================================
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

from daq.drivers import open_logger
from daq.process.config import Config, load_config, press_of
from daq.process.notify import Notifier
from daq.process.stopping import stop_on_signals
from daq.recording.config_watch import ConfigWatch
from daq.recording.press_line import Journal, Level, PressLine, Shared
from daq.store import Store, StoreUnavailable, open_store
from daq.store.file_rescue import damage_of
from daq.store.outbox import Outbox
from daq.store.process_lock import only_user, only_user_of_file
from daq.store.records import in_status
from daq.store.write_batch import Entry, WriteBatch
from daq.supervision import BEAT_S, Steps, SupervisedThread, unexpected
from daq.words import Message, say, spoken

LOG = logging.getLogger("kerntemp.record")
PROCESS = "record"

# Numbers without another source were set by hand, 2026-11.

_GATHER_S = 0.1
"""An accelerated recorder gathers scans this long for one commit. [s]"""
_MANY_WAITING = 1000
"""More scans than this wait only where the store is away or this machine does not keep up."""
_PAGES_S = 30.0
"""How often the file of an SQLite store is read through, where it is small. [s]"""
_REST = 50.0
"""So many times as long as reading it, or thinning a piece, took it is left alone: 2 % of a disk's time."""
_READING_S, _READING_BYTES_PER_S = 300.0, 1e6
"""A reading of that file that takes longer than this and what a slow disk needs beside has stopped; so has the
thinning of a piece, which is far less. [s]"""
_THIN_S = 600.0
"""How often old idle scans are thinned. [s]"""


def record(
    config: Config,
    *,
    stop: threading.Event | None = None,
    acknowledged: Callable[[WriteBatch], None] | None = None,
) -> None:
    """Record until stopped by `stop`, SIGTERM or SIGINT.

    Raises
    ------
    InputError
        For what is wrong in press files, profiles or the store's address, or where another recorder is at it.
    """
    stop = stop or threading.Event()
    stop_on_signals(stop)
    for settings in config.press:
        press_of(settings)
    loggers = {settings.name: [open_logger(x) for x in settings.logger] for settings in config.press}
    with open_store(config.store.url, later=True) as store, _sole_recorder(config, store):

        def journal(level: Level, message: Message, press: str | None = None, **detail: Any) -> None:
            _log(level, message)
            outbox.put(Entry(level, PROCESS, message, press, detail or None))

        outbox = _outbox(config, store, journal, acknowledged)
        shared = Shared(store, outbox, config.clock.speed, journal, stop)
        lines = [PressLine(one, config.text, loggers[one.name], shared) for one in config.press]
        outbox.start()
        for line in lines:
            line.start()
        pages = _watched_pages(store, journal, stop)
        watch = ConfigWatch(config, journal)
        _begin(watch.steps, partial(watch.work, lines, stop), journal)
        thinning = Steps("thinning")
        _begin(thinning, partial(_thin, store, config.store.keep_idle_days, stop, thinning), journal)
        presses = tuple(settings.name for settings in config.press)
        journal("info", say("recording-begins", presses=presses, where=outbox.capacity))
        notifier = Notifier()
        notifier.ready(str(say("recording-now", presses=presses)))
        try:
            _Recording(store, lines, outbox, notifier, journal, (thinning, watch), pages).watch(stop)
        finally:
            notifier.stopping()
            stop.set()
            for line in lines:
                line.join()
            outbox.beat(store.beats_as(PROCESS), _status(lines, outbox, "stopped"))
            journal("info", say("recording-ends"))
            outbox.close()


def _outbox(
    config: Config, store: Store, journal: Journal, acknowledged: Callable[[WriteBatch], None] | None
) -> Outbox:
    """Return the way of all scans to the store; a file on disk holds them while a server is away."""
    return Outbox(
        store,
        buffer=config.store.buffer if store.database.dialect != "sqlite" else None,
        per_second=config.scans_per_second,
        gather_s=_GATHER_S if config.clock.speed > 1 else 0.0,
        acknowledged=acknowledged,
        journal=journal,
    )


def _watched_pages(store: Store, journal: Journal, stop: threading.Event) -> PageWatch | None:
    """Begin to read the file of an SQLite store through, again and again; None for a server's."""
    if (path := store.database.path) is None:
        return None
    pages = PageWatch(path, journal)
    _begin(pages.steps, partial(pages.work, stop), journal)
    return pages


def _begin(steps: Steps, work: Callable[[], None], journal: Journal) -> None:
    """Start what goes on beside recording in a thread of its own, which bears the name of its steps."""
    SupervisedThread(steps.name, work, partial(journal, "alarm"), steps).start()


@contextmanager
def _sole_recorder(config: Config, store: Store) -> Iterator[None]:
    """Hold what no other recorder may use meanwhile; a second one is refused."""
    with ExitStack() as held:
        if (path := store.database.path) is not None:
            path = path.resolve()  # a link leads to the same file
            refusals = {p.name: say("press-recorded-already", press=p.name, store=str(path)) for p in config.press}
            held.enter_context(only_user({path.with_name(f"{path.name}.{p}"): r for p, r in refusals.items()}))
            held.enter_context(only_user_of_file(path, refusals))
        elif (buffer := config.store.buffer) is not None:
            held.enter_context(only_user({buffer.resolve(): say("buffer-used-already", file=str(buffer))}))
        yield


@dataclass(frozen=True)
class _Recording:
    """What a recorder consists of."""

    store: Store
    lines: Sequence[PressLine]
    outbox: Outbox
    notifier: Notifier
    journal: Journal
    beside: Sequence[Steps | ConfigWatch]
    """What recording goes on without, where it stands still."""
    pages: PageWatch | None = None

    def watch(self, stop: threading.Event) -> None:
        """Until stopped: signs of life; what takes longer, or reads files, has its own thread."""
        reported = None
        while not stop.wait(BEAT_S):
            try:
                self._give_sign_of_life()
                reported = None
            except Exception as error:  # noqa: BLE001 - who watches must not die of what it sees
                fault = say("thread-failed", thread="watch", why=unexpected(error))
                if fault != reported:
                    self.journal("alarm", fault)
                reported = fault

    def _give_sign_of_life(self) -> None:
        """Feed the watchdog only while presses have fresh scans, drivers come back, writer and page watch work.

        Thinning, or a look at the configuration, that stands still is reported; it is no reason to stop recording.
        """
        found = [*(line.stalled() for line in self.lines), self.outbox.stalled()]
        found += [self.pages.stalled()] if self.pages is not None else []
        stalled = [why for why in found if why is not None]
        standing = [*stalled, *(why for one in self.beside if (why := one.stalled()) is not None)]
        status = _status(self.lines, self.outbox, "running", standing)
        self.outbox.beat(self.store.beats_as(PROCESS), status)
        if stalled:
            self.notifier.status("; ".join(map(str, stalled)))
        else:
            self.notifier.alive(status["message"])


def _thin(store: Store, keep_days: float, stop: threading.Event, steps: Steps) -> None:
    """Until stopped: thin old idle scans now and then, resting after each piece; a store that is away has time."""
    while not stop.wait(_THIN_S):
        pieces = store.thin_idle(datetime.now(UTC) - timedelta(days=keep_days))
        try:
            left = True
            while left:
                began = time.monotonic()
                with steps.step(_READING_S):
                    left = next(pieces, None) is not None
                if stop.wait(_REST * (time.monotonic() - began)):
                    return
        except StoreUnavailable as error:
            LOG.info("%s", say("idle-not-thinned", why=spoken(error)))


class PageWatch:
    """Reads the store's file through now and then, and reports when its pages are damaged."""

    def __init__(self, path: Path, journal: Journal) -> None:
        self._path, self._journal = path, journal
        self._damage = ""
        self.steps = Steps("pages")

    def work(self, stop: threading.Event) -> None:
        """Until stopped: read the file and report damage."""
        pause_s = _PAGES_S
        while not stop.wait(pause_s):
            began = time.monotonic()
            with self.steps.step(_READING_S + _size_of(self._path) / _READING_BYTES_PER_S):
                found = damage_of(self._path)
            pause_s = max(_PAGES_S, _REST * (time.monotonic() - began))
            if found and found != self._damage:
                self._journal("alarm", say("store-damaged", store=str(self._path), error=found))
            self._damage = found

    def stalled(self) -> Message | None:
        """Return that a reading does not come to its end; None while it does."""
        return None if self.steps.stalled() is None else say("pages-stalled", store=str(self._path))


def _size_of(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _log(level: Level, message: Message) -> None:
    LOG.log({"info": logging.INFO, "warning": logging.WARNING}.get(level, logging.ERROR), "%s", message)


def _status(
    lines: Sequence[PressLine], outbox: Outbox, state: str, stalled: Sequence[Message] = ()
) -> dict[str, Any]:
    problems = [*stalled, *(p for line in lines for p in line.problems())]
    if outbox.trouble:
        problems.append(say("store-trouble", why=outbox.trouble, count=outbox.waiting))
    elif outbox.waiting > _MANY_WAITING:
        problems.append(say("scans-not-written", count=outbox.waiting))
    if outbox.lost:
        problems.append(say("scans-lost", count=outbox.lost))
    return {
        "state": state,
        "pid": os.getpid(),
        **in_status(problems, say("scans-recorded", count=outbox.written)),
        "acknowledged": outbox.written,
        "waiting": outbox.waiting,
        "room_for_waiting": str(outbox.capacity),
        "room_for_waiting_hours": round(outbox.hours_left, 1),
        "presses": [line.report() for line in lines],
        "loggers": [report for line in lines for report in line.logger_reports()],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Record by a configuration file, printing each commit: ``python -m daq.recording.recorder kerntemp.toml``."""
    import sys

    given = list(sys.argv[1:] if arguments is None else arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    config = load_config(Path(given[0] if given else "kerntemp.toml"))

    def acknowledged(batch: WriteBatch) -> None:
        if batch.scans:
            with suppress(OSError):
                sys.stdout.write(f"{batch.key.name} {batch.scans[-1].number}\n")
                sys.stdout.flush()

    record(config, acknowledged=acknowledged)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
