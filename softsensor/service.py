"""The `sense` process: follows the store, runs the live sensor, refits each pressing.

It keeps nothing of its own. After a restart, or when the run's header or the promoted model changes, the
scans of the open run are taken from the store again; the live sensor is a function of the scans, so that
gives the estimates an uninterrupted process would have given. Fits run in a worker process, so that no
estimate waits for one.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context, parent_process
from typing import Any, Literal

import numpy as np

from daq.config import Config, PressSettings
from daq.notify import Notifier
from daq.pressfile import Press, read_press
from daq.records import InputError, PressState, Run, Scan
from daq.stopping import stop_on_signals
from daq.store import RunRecord, RunStatus, Store, StoredEstimate, StoreUnavailable
from daq.store.waiting import open_when_ready
from softsensor.drift import alarms_of
from softsensor.modelfile import ModelFile, parse_model
from softsensor.observer import Estimate, LiveSensor
from softsensor.recent import NEWEST_RUNS, PRESS_FILE, fingerprint, up_to_date
from softsensor.warming import warm_up

LOG = logging.getLogger("kerntemp.sense")
PROCESS = "sense"
POLL_S = 0.02
"""How often the store is asked for new scans. [s]"""
LOOK_S = 0.25
"""How often for a new run, a changed header, press events. [s]"""
BEAT_S = 1.0
MODEL_S = 1.0
BATCH = 400
IDLE_S = 1.0
"""Between pressings an estimate is written this often. [s]"""
HISTORY_RUNS = 200
"""Runs the control charts look back on."""
NO_PANEL = "no panel in the press"
Level = Literal["info", "warning", "alarm"]


def sense(config: Config, *, stop: threading.Event | None = None) -> None:
    """Follow all presses of a configuration until stopped by `stop`, SIGTERM or SIGINT.

    Raises
    ------
    InputError
        For what is wrong in press files or the store's address.
    """
    stop = stop or threading.Event()
    stop_on_signals(stop)
    presses = [(settings, read_press(settings.file)) for settings in config.press]
    store = open_when_ready(config.store.url, stop, LOG)
    if store is None:
        return
    with store, Fitter() as fitter:
        followers = [Follower(store, settings, press, fitter) for settings, press in presses]
        for _, press in presses:
            with suppress(InputError):  # a rig whose runs must say more: compiled when the first does
                warm_up(press)
        with suppress(StoreUnavailable):  # held for the moment: no reason to end
            _say(store, "info", f"following {', '.join(s.name for s, _ in presses)}")
        trouble, beat, notifier = "", -1e9, Notifier()
        notifier.ready("following the store")
        while not stop.is_set():
            worked = False
            try:
                for follower in followers:
                    worked = follower.step(time.monotonic()) or worked
                if time.monotonic() - beat > BEAT_S:
                    beat = time.monotonic()
                    status = _status(followers, "running")
                    store.beat(store.beats_as(PROCESS), status)
                    notifier.alive(str(status["message"]))
                trouble = ""
            except StoreUnavailable as error:
                if str(error) != trouble:
                    LOG.warning("%s; trying again", error)
                trouble = str(error)
                notifier.alive(trouble)  # a store that is away is no reason to begin anew
                stop.wait(0.5)
            if not worked:
                stop.wait(POLL_S)
        notifier.stopping()
        with suppress(StoreUnavailable):
            store.beat(store.beats_as(PROCESS), _status(followers, "stopped"))


def _say(store: Store, level: Level, sentence: str, press: str | None = None, **detail: Any) -> None:
    LOG.log(logging.INFO if level == "info" else logging.WARNING, "%s", sentence)
    store.log(level, PROCESS, sentence, press, detail or None)


def _status(followers: list[Follower], state: str) -> dict[str, Any]:
    problems = [f"{f.settings.name}: {f.problem}" for f in followers if f.problem]
    return {
        "state": state,
        "pid": os.getpid(),
        "message": "; ".join(problems) or ", ".join(f.message for f in followers),
        "problems": problems,
        "presses": [
            {
                "press": f.settings.name,
                "run": f.live.record.run if f.live else None,
                "last_scan": f.last,
                "behind_scans": f.behind,
                "model_version": f.model.version if f.model else "",
                "update_us": round(f.update_us, 1),
            }
            for f in followers
        ],
    }


class Fitter:
    """Fits runs in a worker process."""

    def __init__(self) -> None:
        self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_end_with_parent)
        self._warm = self._pool.submit(_warm_up)

    def __enter__(self) -> Fitter:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)

    def submit(self, press: Press, run: Run, model: ModelFile | None) -> Future[dict[str, Any]]:
        """Fit a run with the effects of a model; the result is an entry of ``fit --json``."""
        return self._pool.submit(fit_one, press, run, model)


def _end_with_parent() -> None:
    """End this worker when the process that started it is gone, also where that was killed."""

    def watch() -> None:
        if parent := parent_process():
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _warm_up() -> None:
    """Load the solver before the first fit is due."""
    from softsensor import campaign

    LOG.debug("fitter ready: %s", campaign.__name__)


def heard(press: Press, run: Run) -> bool:
    """Whether any panel sensor of a run has a value: without one, as in production, nothing can be fitted."""
    return any(bool(np.isfinite(run.columns[name]).any()) for name in press.sensors_of(run))


def fit_one(press: Press, run: Run, model: ModelFile | None) -> dict[str, Any]:
    """Fit one run as the live sensor does after a pressing, with what it says about causes left out.

    Raises InputError.
    """
    from softsensor.adequacy import run_evidence
    from softsensor.campaign import moments_of
    from softsensor.fit import fit_run
    from softsensor.model import ThermalModel

    thermal = model.model(press) if model is not None else ThermalModel(press)
    start = dict(model.values) if model is not None else None
    fitted = fit_run(thermal, run, moments_of(run, press), start=start)
    evidence = run_evidence(fitted.problem, fitted.minimum.evaluation)
    return fitted.as_json() | {"evidence": {name: e.as_json() for name, e in evidence.items()}}


@dataclass
class _Live:
    """The run being pressed and its sensor."""

    record: RunRecord
    sensor: LiveSensor
    model: str
    fitted_open: bool = False


@dataclass
class Follower:
    """One press: its open run, its sensor, its fits."""

    store: Store
    settings: PressSettings
    press: Press
    fitter: Fitter
    last: int = -2
    """Newest scan taken; -2 before the first step."""
    behind: int = 0
    live: _Live | None = None
    model: ModelFile | None = None
    problem: str = ""
    message: str = "waiting for scans"
    update_us: float = 0.0
    _base_version: str = "?"
    _rests_on: tuple[str, int] | None = None
    """Promoted model and newest fit behind `model`."""
    _fits: dict[str, Future[dict[str, Any]]] = field(default_factory=dict)
    _looked: float = -1e9
    _idle_said: float = -1e9
    _model_looked: float = -1e9
    _due: set[str] = field(default_factory=set)
    _alarmed: set[tuple[str, str]] = field(default_factory=set)
    _ended: list[RunRecord] = field(default_factory=list)
    """Pressings that are over and have scans this process has not seen yet, oldest first."""
    _unwritten: list[StoredEstimate] = field(default_factory=list)
    """Said and not in the store yet: no scan goes through the sensor twice because the store was away."""

    @property
    def name(self) -> str:
        """The press."""
        return self.settings.name

    def step(self, now: float) -> bool:
        """Do what there is to do; return whether there was anything."""
        if self.last == -2:
            last = self.store.last_scan_followed(self.name)
            if last == -1:
                last = self.store.newest_scan_number(self.name)
            self._fit_what_was_left(last)
            self.last = last
        if now - self._model_looked > MODEL_S:
            self._model_looked = now
            self._refresh_model()
        if now - self._looked > LOOK_S:
            self._looked = now
            self._look()
        self._collect()
        self._write()
        batch = self.store.scans_after(self.name, self.last, BATCH)
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

    def _write(self) -> None:
        """Store what was said; where the store refuses, it is tried again at the next step."""
        if self._unwritten:
            self.store.append_estimates(self.name, self._unwritten)
            self._unwritten = []

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
            self.message = "no panel in the press"
            return
        version = self.model.version if self.model else ""
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
            self._due.add(record.run)
            self._submit(record.run)

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
            self._begin(self._ended[0], self.model.version if self.model else "")

    def _leave(self, run: str) -> None:
        if self.live is not None and self.live.record.run == run:
            self._finish(self.live)
            self.live = None

    def _begin(self, record: RunRecord, version: str) -> None:
        """Start a sensor and give it the run's scans so far."""
        before = self.live
        same = before is not None and before.record.header == record.header
        fitted = before is not None and before.record.run == record.run and before.fitted_open
        self.live = _Live(record, LiveSensor(self.press, record.header, self.model), version, fitted)
        self.problem = ""
        try:
            self._catch_up(record, said_before=same)
        except StoreUnavailable:
            self.live = None  # to begin again from the first scan, not in the middle
            raise
        self.message = f"following {record.run}"

    def _catch_up(self, record: RunRecord, *, said_before: bool) -> None:
        """Give the sensor the run's scans so far."""
        number = record.first_scan - 1
        while number < self.last:
            batch = self.store.scans_after(self.name, number, BATCH)
            names = tuple(c.name for c in batch.channels)
            scans = [s for s in batch.scans if s.number <= self.last]
            if not scans:
                break
            estimates = [self._estimate(scan, names) for scan in scans]
            if not said_before:  # a new model does not rewrite what the old one said
                self.store.append_estimates(self.name, [e for e in estimates if e is not None])
            number = scans[-1].number

    def _estimate(self, scan: Scan, names: tuple[str, ...]) -> StoredEstimate | None:
        """Return what the sensor says at a scan; between pressings once a second."""
        live = self.live
        if live is None or scan.number < live.record.first_scan:
            if 0.0 <= scan.monotonic_s - self._idle_said < IDLE_S:
                return None
            self._idle_said = scan.monotonic_s
            return _stored(scan, Estimate(scan.monotonic_s, PressState.IDLE, reason=NO_PANEL), "", {})
        values = {
            name: value if quality.usable else float("nan")
            for name, value, quality in zip(names, scan.values, scan.qualities, strict=True)
        }
        time_s = round(scan.monotonic_s - live.record.zero_monotonic_s, 6)
        begun = time.perf_counter()
        try:
            said = live.sensor.update(time_s, values)
        except InputError as error:
            self.problem = str(error)
            said = Estimate(time_s, None, reason=self.problem)
        self.update_us += 0.02 * (1e6 * (time.perf_counter() - begun) - self.update_us)
        return _stored(scan, said, live.model, _details(live.sensor, said))

    # --- fits ---------------------------------------------------------------------------------------

    def _finish(self, live: _Live) -> None:
        """A run is over: fit all of it."""
        self._fit_whole(self.store.run_record(live.record.run))

    def _fit_what_was_left(self, last: int) -> None:
        """Fit those of the newest runs up to a scan that a process killed before this one has left."""
        records = self.store.runs(press=self.name, limit=HISTORY_RUNS).items
        fits = self.store.fits([r.run for r in records])
        said = [e.message for e in self.store.journal(limit=500).items]
        for record in reversed(records):
            seen = record.last_scan is not None and record.last_scan <= last
            told = any(message.startswith(f"run {record.run} ") for message in said)
            if seen and "fingerprint" not in fits.get(record.run, {}) and not told:
                self._fit_whole(record)

    def _fit_whole(self, record: RunRecord) -> None:
        if record.status is not RunStatus.OPEN and record.moments.closed_s == record.moments.closed_s:
            self._due.add(record.run)
            self._submit(record.run)

    def _submit(self, run: str) -> None:
        if run in self._fits or run not in self._due:
            return
        loaded = self.store.load_run(run)
        self._due.discard(run)
        if heard(self.press, loaded):
            self._fits[run] = self.fitter.submit(self.press, loaded, self.model)
        elif self.store.run_record(run).status is not RunStatus.OPEN:
            _say(self.store, "info", f"run {run} has no panel sensors: nothing to fit", self.name)

    def _collect(self) -> None:
        """Store finished fits and look at the control charts."""
        for run in [run for run, future in self._fits.items() if future.done()]:
            future = self._fits[run]  # kept until it is stored: the store may refuse now
            error = future.exception()
            if error is not None:
                _say(self.store, "warning", f"run {run} could not be fitted: {error}", self.name)
            else:
                self.store.put_fit(run, self._marked(run, future.result()), self._base_version)
                self._model_looked = -1e9
            del self._fits[run]
            if error is None:
                self._watch()
        for run in tuple(self._due):
            self._submit(run)

    def _marked(self, run: str, fit: dict[str, Any]) -> dict[str, Any]:
        """Return a fit of a whole run with what it rests on, so that the nightly job need not repeat it."""
        record = self.store.run_record(run)
        if record.status is RunStatus.OPEN or run in self._due:
            return fit
        return fit | {"fingerprint": fingerprint(record, self.press, self.model)}

    def _watch(self) -> None:
        """Write an alarm once for each coefficient that has left what is usual."""
        for alarm in alarms_of(self.store, self.name):
            if (alarm.coefficient, alarm.run) not in self._alarmed:
                self._alarmed.add((alarm.coefficient, alarm.run))
                _say(self.store, "warning", alarm.sentence, self.name, **alarm.__dict__)

    def _refresh_model(self) -> None:
        """Take the promoted model and the newest fits made with it."""
        active = self.store.active_model(self.name)
        rests_on = (active.version if active else "", self.store.newest_fit_number(self.name))
        if rests_on == self._rests_on:
            return
        self._rests_on = rests_on
        base = parse_model(active.model, f"model {active.version}") if active is not None else None
        version = base.version if base is not None else PRESS_FILE
        runs = self.store.runs(press=self.name, limit=NEWEST_RUNS + 1).items
        busy = self.live.record.run if self.live else ""
        fits = [self.store.fit(r.run) for r in runs if r.run != busy]
        good = [f for f in fits if f is not None and f.get("model_version") == version]
        if version != self._base_version:
            if self._base_version != "?":
                _say(self.store, "info", f"the live sensor takes model {version}", self.name)
            self._base_version = version
        self.model = up_to_date(self.press, base, good[:NEWEST_RUNS])


def _details(sensor: LiveSensor, said: Estimate) -> dict[str, Any]:
    """Return what goes beside an estimate, without what is not known.

    Outlook, profile and heat come out of the same belief as the core: where that is not valid, none is told.
    """
    found: dict[str, Any] = {"suspected": said.suspected} if said.suspected else {}
    if not said.valid:
        return found
    if said.state is not PressState.IDLE and said.state is not None and (inside := sensor.inside) is not None:
        found["profile_C"] = [round(v, 1) for v in inside.profile_C.tolist()]
        found["energy_kJ_m2"] = round(inside.energy_kJ_m2, 1)
    outlook = sensor.outlook
    for name, value in asdict(outlook).items():
        if isinstance(value, float) and value == value:
            found[name] = round(value, 1)
    if outlook.warning:
        found["warning"] = outlook.warning
    return found


def _stored(scan: Scan, said: Estimate, model: str, detail: dict[str, Any]) -> StoredEstimate:
    return StoredEstimate(
        number=scan.number,
        monotonic_s=scan.monotonic_s,
        state=said.state if said.state is not None else "unknown",
        core_celsius=said.core_C,
        core_sd_kelvin=said.core_sd_K,
        core_low_celsius=said.core_low_C,
        core_high_celsius=said.core_high_C,
        valid=said.valid,
        reason=said.reason,
        model_version=model,
        detail=detail or None,
    )
