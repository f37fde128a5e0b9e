"""`kerntemp demo`: the whole system on a virtual press, with nothing in it pretended but the press.

Simulated loggers in a process of their own speak Modbus TCP over a socket and ADAM-ASCII over a
serial line. `kerntemp record`, `sense` and `serve` run as they would in a plant, from a kerntemp.toml
written here, and meet only in the store. This process plays the operator, who writes down what is in
the press, and at the end compares what the system found with what the virtual press truly did.
"""

from __future__ import annotations

import shlex
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from api.demo.press import virtual_press_of
from api.demo.processes import FIT_S, JUDGED, KERNTEMP, SERVICES, USUAL_CYCLE_S, Children, DemoPlan, ended
from api.demo.summary import (
    PressingCheck,
    compare,
    diagnosis_lines,
    gain_line,
    pace_lines,
    replayed,
    summary_lines,
)
from api.outputs import WorkFailed
from daq.press.press_file import read_press
from daq.simulated.press import Cycle, VirtualPress
from daq.store.records import ModelStatus, RunRecord, RunStatus
from daq.store.store import Store, open_store
from daq.words import Message, say

if TYPE_CHECKING:
    from softsensor.heat.model_file import ModelFile

QUICK_S = 5.0
"""After so long a newcomer is shown what is being waited for. [s]"""
COMPILE_S = 600.0
"""Longest wait for the compiler. [s]"""
NIGHT_AFTER = 14
"""Pressings from one nightly job to the next while the demonstration goes on; in as many, causes were named."""
VIEWS = ("now", "wall", "runs", "coefficients", "diagnosis", "nights")
"""What a newcomer is shown first."""
PRESS = "lab"
"""The virtual press's name."""
LOOK_S = 0.05
"""How often is looked what the processes have done: a tenth of what a pressing takes at the highest speed. [s]"""


def run_demo(plan: DemoPlan, children: Children, show: Callable[[Message | str], None], *, kept: bool) -> None:
    """Run the demonstration to its end, once its loggers are started. Raises `WorkFailed` where a part breaks."""
    with ExitStack() as ending:
        demo = _Demo(replace(plan, folder=children.folder), children, show)
        demo.start(ending)
        try:
            demo.watch()
        except KeyboardInterrupt:
            if not demo.findings:
                raise
        demo.finish()
        places = {"folder": str(children.folder), "config": str(demo.config)}
        show(say("demo-kept", **places) if kept else say("demo-not-kept"))


class _Demo:
    def __init__(self, plan: DemoPlan, children: Children, show: Callable[[Message | str], None]) -> None:
        self.plan, self.children, self.show = plan, children, show
        self.started = time.monotonic()
        self.findings: list[PressingCheck] = []
        self._noted: set[str] = set()
        self._pressed: set[int] = set()
        """Which of the virtual press's pressings were found."""
        self._entered_panel: datetime | None = None
        """When it was entered what panels the press lays in, None for its own."""
        self._given = self._taken = 0
        """How often the loggers were given panels, and how often they said from which pressing on."""
        self._waiting: dict[str, float] = {}
        """Pressings that are over and wait for their fits, and since when. [s]"""
        self.config = plan.folder / "kerntemp.toml"
        self._night: subprocess.Popen[str] | None = None
        """The nightly job, while it runs."""
        self._judged = 0
        """How many pressings there were when it last began or ended."""
        self._compiling_noted = False

    def start(self, ending: ExitStack) -> None:
        """Wait for page, recorder and sensor; then let the press begin."""
        plan = self.plan
        self.truth: VirtualPress = virtual_press_of({**plan.press, "keep": plan.known_cycles})
        self.store: Store = ending.enter_context(open_store(str(plan.folder / "kerntemp.sqlite")))
        self.address = self.children.first_line("serve").split()[-1]
        self._greet(self.children.loggers)
        solved = self._loggers_answer()
        # an accelerated press would run away from a sensor that compiles
        self._wait_until(lambda: solved.is_set() and self._all_run(), ("loggers", *SERVICES))
        self.started = time.monotonic()
        self.children.send_to_loggers({"started_monotonic_s": self.started})
        self._before = self._recorded()
        self.truth.cycle(0.0)  # before the operator writes down the first panel

    def _greet(self, loggers: Mapping[str, Any]) -> None:
        """Say what is there to look at, and when there will be more."""
        plan = self.plan
        places = tuple(
            say("demo-logger", profile=t["profile"], place=str(t.get("port") or "{host}:{tcp_port}".format_map(t)))
            for t in loggers["loggers"]
        )
        if plan.pressings is None:
            self.show(say("demo-begins-without-end", speed=plan.speed))
        else:
            self.show(say("demo-begins", speed=plan.speed, pressings=plan.pressings))
        self.show(say("demo-loggers", places=places))
        self.show(say("demo-store", path=str(plan.folder / "kerntemp.sqlite")))
        self.show(say("demo-page", address=self.address))
        for view in VIEWS:
            address = self._view(view).ljust(len(self._view(max(VIEWS, key=len))))
            self.show(say("demo-view", address=address, name=Message(f"page-nav-{view}")))
        self.show(say("demo-token", config=shlex.quote(str(self.config))))
        if plan.pressings is None:
            minutes = max(round(NIGHT_AFTER * USUAL_CYCLE_S / plan.speed / 60.0), 1)
            self.show(say("demo-night-comes", pressings=NIGHT_AFTER, minutes=minutes))

    def _view(self, name: str) -> str:
        return f"{self.address}#/{name}"

    def _loggers_answer(self) -> threading.Event:
        """Return what is set once the loggers' process has solved its first pressing.

        From which pressing on panels are as somebody entered, it says afterwards; the truth takes it as well.
        """
        answering = threading.Event()

        def take(line: Mapping[str, Any]) -> None:
            answering.set()
            if "panel" in line:
                self.truth.set_panels(line["from"], line["panel"])
                self._taken += 1

        self.children.listen_to_loggers(take)
        return answering

    def _wait_until(self, ready: Callable[[], bool], processes: Sequence[str]) -> None:
        """Wait for processes that may have to compile; one that ends meanwhile is an error."""
        began = time.monotonic()
        while not ready():
            self.children.check()
            waited = time.monotonic() - began
            if waited > COMPILE_S:
                raise WorkFailed(say("demo-no-sign-of-life", processes=tuple(processes), seconds=COMPILE_S))
            if waited > QUICK_S and not self._compiling_noted:
                self._compiling_noted = True
                self.show(say("demo-compiling"))
            time.sleep(LOOK_S)

    def _all_run(self) -> bool:
        """Whether recorder and sensor do their work."""
        states = {name: process.status.get("state") for name, process in self.store.statuses().items()}
        return all(states.get(name) not in (None, "starting") for name in SERVICES)

    def watch(self) -> None:
        """Play the operator until the pressings asked for are recorded and fitted."""
        deadline = time.monotonic() + self.plan.patience_s
        while not self._enough:
            if self.plan.pressings is None:
                self._look_after_night()
            self.children.check()
            self._pass_on()
            for record in self._to_look_at():
                self._note(record)
                if not self._enough and self._finished(record):
                    self._conclude(record)
                    self._waiting.pop(record.run, None)
                    deadline = time.monotonic() + self.plan.patience_s
            if not self._waiting and time.monotonic() > deadline:
                if self.plan.pressings is not None and self.findings:
                    return  # the press has done what was asked; what was not found of it is shown
                raise WorkFailed(say("demo-no-pressing"))
            time.sleep(LOOK_S)

    def _to_look_at(self) -> list[RunRecord]:
        """Return the newest runs and those that wait for their fits, which come late on a busy machine."""
        newest = self.store.runs(limit=20).items
        named = {record.run for record in newest}
        older = [run for run in self._waiting if run not in named]
        known = self.store.run_records(older) if older else {}
        return [*(known[run] for run in older), *reversed(newest)]

    def _look_after_night(self) -> None:
        """Begin a nightly job after every `NIGHT_AFTER` pressings, and say when its diagnosis is there."""
        if self._night is not None:
            if self._night.poll() is not None:
                self._end_night()
        elif len(self.findings) - self._judged >= NIGHT_AFTER:
            self._begin_night()

    def _begin_night(self) -> None:
        self._judged = len(self.findings)
        command = [*KERNTEMP, "refit", "--config", str(self.config)]
        self._night = self.children.start("refit", command, stdout=subprocess.DEVNULL)
        self.show(say("demo-night"))

    def _end_night(self) -> None:
        """Wait for the nightly job. Raises `WorkFailed` where it failed."""
        if self._night is None:
            return
        status = self._night.wait()
        self._night = None
        self._judged = len(self.findings)
        del self.children.running["refit"]
        if status != 0:
            raise WorkFailed(ended("refit", status, self.children.last_words("refit")))
        for line in diagnosis_lines((), self._diagnosis):
            self.show(line)
        self.show(say("demo-diagnosis-there", diagnosis=self._view("diagnosis"), night=self._view("nights")))

    @property
    def _diagnosis(self) -> Mapping[str, Any] | None:
        found = self.store.diagnoses(limit=1).items
        return found[0].diagnosis if found else None

    @property
    def _enough(self) -> bool:
        return self.plan.pressings is not None and len(self.findings) >= self.plan.pressings

    def _pass_on(self) -> None:
        """Have the press lay in what somebody enters for the next panel.

        What the store forgets of it once a panel was begun with it is no other panel: at many times real speed
        that may be one that lay in the press before.
        """
        stated = self.store.next_panel(PRESS)
        entered = None if stated is None else stated.utc
        if entered != self._entered_panel:
            self._entered_panel = entered
            self._given += 1
            self.children.send_to_loggers({"panel": {} if stated is None else stated.header})

    def _note(self, record: RunRecord) -> None:
        """Write down, as soon as a pressing runs, what is in the press: what somebody entered was laid in."""
        if self._taken < self._given or record.run in self._noted or record.status is not RunStatus.OPEN:
            return
        self._noted.add(record.run)
        cycle = self._cycle(record, 0.0)
        known = {k: v for k, v in cycle.header.items() if k != "run" and record.header.get(k) != v}
        self.store.annotate_run(record.run, known, "operator")

    def _finished(self, record: RunRecord) -> bool:
        if record.status is RunStatus.OPEN or any(f.run == record.run for f in self.findings):
            return False
        if record.moments.closed_s != record.moments.closed_s:
            return True  # its closing was not seen: no fit will come
        since = self._waiting.setdefault(record.run, time.monotonic())
        whole = "fingerprint" in (self.store.fit(record.run) or {})  # not the fit made when the press opened
        return whole or time.monotonic() - since > FIT_S

    def _conclude(self, record: RunRecord) -> None:
        cycle = self._cycle(record, record.moments.closed_s)
        finding = compare(self.store, record, cycle, self._virtual(record))
        self.findings.append(finding)
        self._pressed.add(cycle.number)
        self.show(finding.line)

    def _virtual(self, record: RunRecord) -> float:
        """Return the virtual time of a run's time 0. [s]"""
        return record.zero_monotonic_s - self.started * self.plan.speed

    def _cycle(self, record: RunRecord, at_s: float) -> Cycle:
        return self.truth.cycle(max(self._virtual(record) + (at_s if at_s == at_s else 0.0), 0.0))

    def finish(self) -> None:
        """Let the nightly job run where something is hidden, and say what came out.

        Ctrl-C ends the wait for it; where nothing is hidden nobody waits for it.
        """
        with suppress(KeyboardInterrupt):
            if self.plan.hide and self._diagnosis is None:
                self._judge()
        if self._night is not None:
            self.show(say("demo-night-left"))
        for line in summary_lines(self.findings, self.plan.hide, self._diagnosis):
            self.show(line)
        left_out, recorded = (now - then for now, then in zip(self._recorded(), self._before, strict=True))
        unseen = (self.plan.pressings or max(self._pressed, default=0)) - len(self._pressed)
        for line in pace_lines(self.findings, self.plan.speed, left_out, recorded, unseen):
            self.show(line)
        if self.plan.hide:
            self._show_models()

    def _judge(self) -> None:
        if not self._judged:
            self._begin_night()
        if self._night is not None:
            self.show(say("demo-night-awaited"))
        self._end_night()

    def _show_models(self) -> None:
        """Say what the model in force gains by what was found, and why others are not in force."""
        from softsensor.heat.model_reading import parse_model  # compiled code, of which the beginning needs none

        active = self.store.active_model(PRESS)
        if active is not None and active.model.get("effects"):
            self.show(gain_line(self.findings, list(self._replays(parse_model(active.model, active.version)))))
        for left in self.store.models(press=PRESS).items:
            if left.status in (ModelStatus.REJECTED, ModelStatus.CANDIDATE):
                self.show(say("demo-not-promoted", version=left.version, why=left.reason))

    def _recorded(self) -> tuple[int, int]:
        """Return how many scans were left out and how many are in the store."""
        recorder = self.store.statuses()["record"].status
        return sum(int(press["missed_ticks"]) for press in recorder["presses"]), int(recorder["acknowledged"])

    def _replays(self, model: ModelFile) -> Iterator[float]:
        """Yield the core errors of the last pressings with a model. [K]"""
        press = read_press(self.plan.folder / "press.toml")
        for finding in self.findings[-JUDGED:]:
            record = self.store.run_record(finding.run)
            cycle = self._cycle(record, record.moments.closed_s)
            yield replayed(self.store, press, model, record, cycle, self._virtual(record))
