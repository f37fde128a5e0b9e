"""`kerntemp demo`: the whole system on a virtual press, with nothing in it pretended but the press.

Simulated loggers in a process of their own speak Modbus TCP over a socket and ADAM-ASCII over a
serial line. `kerntemp record`, `sense` and `serve` run as they would in a plant, from a kerntemp.toml
written here, and meet only in the store. This process plays the operator, who writes down what is in
the press, and at the end compares what the system found with what the virtual press truly did.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from api.demo.press import virtual_press_of
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
from daq.files.run_file import toml_line, toml_value
from daq.press.press_file import read_press
from daq.records import InputError
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.press import Cycle, VirtualPress
from daq.store.records import ModelStatus, RunRecord, RunStatus
from daq.store.store import Store, open_store
from daq.words import Message, say
from softsensor.heat.model_file import ModelFile, parse_model

SERVICES = ("record", "sense")
START_S = 120.0
"""Longest wait for a process to come up. [s]"""
QUICK_S = 5.0
"""After so long a newcomer is told what is being waited for. [s]"""
COMPILE_S = 600.0
"""Longest wait for the compiler. [s]"""
PATIENCE_S = 15.0
"""Longest wait for a process to end by itself. [s]"""
FIT_S = 240.0
"""Longest wait for the last fit of a finished pressing: of a first start, also for what fits compile. [s]"""
SCANS_PER_S = 30.0
"""An accelerated demonstration scans at most about this often in real time."""
TARGET_C = 40.0
"""What the demonstration's recipe asks of the core. [°C]"""
LOGGERS_KEEP = 6
"""Pressings in the memory of the loggers' process, which only looks at the present."""
SHORTEST_CYCLE_S = 90.0
"""From one panel's removal to the next one's, at least. [s]"""
NIGHT_AFTER = 14
"""Pressings from one nightly job to the next while the demonstration goes on; in as many, causes were named."""
VIEWS = ("now", "wall", "runs", "coefficients", "diagnosis", "nights")
"""What a newcomer is told to look at."""
USUAL_CYCLE_S = 130.0
"""From one panel's removal to the next one's, on average over the ranges of `PressSettings`. [s]"""
JUDGED = 10
"""Newest pressings on which a promoted model is held against what was told live. Panels differ in what is hidden
in them by a quarter, so that four (2026-11) were too few to judge by; no fit and no diagnosis sees the core."""


@dataclass(frozen=True)
class DemoPlan:
    """What the demonstration is asked to do."""

    speed: float = 1.0
    pressings: int | None = None
    hide: tuple[str, ...] = ()
    port: int = 0
    folder: Path = Path()
    seed: int = 1

    @property
    def rate_hz(self) -> float:
        """Scans per second of run time. [Hz]"""
        return round(min(10.0, max(SCANS_PER_S / self.speed, 0.5)), 3)

    @property
    def patience_s(self) -> float:
        """Longest wait for the next pressing, recorded and fitted. [s]"""
        return START_S + 400.0 / self.speed

    @property
    def known_cycles(self) -> int:
        """How many pressings the truth is kept of: those to be judged, and those that go by meanwhile."""
        return (self.pressings or JUDGED) + 4 + math.ceil(self.patience_s * self.speed / SHORTEST_CYCLE_S)


@dataclass
class Children:
    """The processes of the demonstration; all of them end with it."""

    folder: Path
    running: dict[str, subprocess.Popen[str]] = field(default_factory=dict)

    def start(self, name: str, command: list[str], **options: Any) -> subprocess.Popen[str]:
        """Start a process whose messages go to a log file beside the store."""
        with (self.folder / f"{name}.log").open("w", encoding="utf-8") as log:
            child = subprocess.Popen(command, stderr=log, text=True, encoding="utf-8", **_APART, **options)
        self.running[name] = child
        return child

    def check(self) -> None:
        """Raise `WorkFailed` with the last words of a process that ended by itself."""
        for name, child in self.running.items():
            if child.poll() is not None:
                raise WorkFailed(_ended(name, child.returncode, self.last_words(name)))

    def last_words(self, name: str) -> str | Message:
        """Return the last line of a process's log."""
        lines = (self.folder / f"{name}.log").read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), say("demo-no-message"))

    def stop(self) -> None:
        """End the services at once, then the loggers they read; by force where asking does not help."""
        asked = [child for child in self.running.values() if child.stdin is None]
        for child in asked:
            if child.poll() is None:
                child.terminate()
        _wait_or_kill(asked)
        fed = [child for child in self.running.values() if child.stdin is not None]
        for child in fed:
            if child.stdin is not None:
                child.stdin.close()
        _wait_or_kill(fed)
        for child in self.running.values():
            if child.stdout is not None:
                child.stdout.close()
        self.running.clear()


def _wait_or_kill(children: list[subprocess.Popen[str]]) -> None:
    """Give the processes `PATIENCE_S` together to end, then kill those that have not."""
    deadline = time.monotonic() + PATIENCE_S
    for child in children:
        try:
            child.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


_APART: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    _APART = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
"""Ctrl-C reaches this process only, which then ends the others in order."""


@contextmanager
def _folder(data: Path | None) -> Iterator[Path]:
    if data is None:
        with tempfile.TemporaryDirectory(prefix="kerntemp-demo-", ignore_cleanup_errors=True) as folder:
            yield Path(folder)
        return
    data.mkdir(parents=True, exist_ok=True)
    if (data / "kerntemp.sqlite").exists():
        raise InputError(say("terminal-demo-folder-taken", folder=str(data)))
    yield data.resolve()


def run_demo(plan: DemoPlan, data: Path | None, tell: Callable[[Message | str], None]) -> None:
    """Run the demonstration to its end. Raises `WorkFailed` where a part of it breaks."""
    with _folder(data) as folder, ExitStack() as ending:
        children = Children(folder)
        ending.callback(children.stop)
        demo = _Demo(replace(plan, folder=folder), children, tell)
        demo.start(ending)
        try:
            demo.watch()
        except KeyboardInterrupt:
            if not demo.findings:
                raise
        demo.finish()
        kept = {"folder": str(folder), "config": str(demo.config)}
        tell(say("demo-not-kept") if data is None else say("demo-kept", **kept))


class _Demo:
    def __init__(self, plan: DemoPlan, children: Children, tell: Callable[[Message | str], None]) -> None:
        self.plan, self.children, self.tell = plan, children, tell
        self.started = time.monotonic()
        self.findings: list[PressingCheck] = []
        self._noted: set[str] = set()
        self._pressed: set[int] = set()
        """Which of the virtual press's pressings were found."""
        self._ended: dict[str, tuple[float, int]] = {}
        self.config = plan.folder / "kerntemp.toml"
        self._night: subprocess.Popen[str] | None = None
        """The nightly job, while it runs."""
        self._judged = 0
        """How many pressings there were when it last began or ended."""
        self._told_of_compiling = False

    def start(self, ending: ExitStack) -> None:
        """Bring up loggers, recorder, sensor and page."""
        plan = self.plan
        settings = {"hide": plan.hide, "keep": LOGGERS_KEEP, "seed": plan.seed}
        self.truth: VirtualPress = virtual_press_of({**settings, "keep": plan.known_cycles})
        loggers = self._start_loggers({**settings, "speed": plan.speed, "pressings": plan.pressings})
        _write_configuration(self.config, plan, loggers, self.truth)
        self.store: Store = ending.enter_context(open_store(str(plan.folder / "kerntemp.sqlite")))
        web = [*_KERNTEMP, "serve", "--config", str(self.config), "--port", str(plan.port)]
        page = self.children.start("serve", web, stdout=subprocess.PIPE)
        self._start_service("sense")
        self.address = self._first_line("serve", page).split()[-1]
        self._greet(loggers)
        self._wait_until(self._loggers_answer().is_set, ("loggers",))
        self._start_service("record")
        self.truth.cycle(0.0)  # solved before its clock runs
        self._wait_until(self._all_run, SERVICES)  # an accelerated press would run away from a compiling sensor
        self.started = time.monotonic()
        self._send({"started_monotonic_s": self.started})

    def _start_service(self, name: str) -> None:
        command = [*_KERNTEMP, name, "--config", str(self.config)]
        self.children.start(name, command, stdout=subprocess.DEVNULL)

    def _greet(self, loggers: Mapping[str, Any]) -> None:
        """Say what is there to look at, and when there will be more."""
        plan = self.plan
        places = tuple(
            say("demo-logger", profile=t["profile"], place=str(t.get("port") or "{host}:{tcp_port}".format_map(t)))
            for t in loggers["loggers"]
        )
        if plan.pressings is None:
            self.tell(say("demo-begins-without-end", speed=plan.speed))
        else:
            self.tell(say("demo-begins", speed=plan.speed, pressings=plan.pressings))
        self.tell(say("demo-loggers", places=places))
        self.tell(say("demo-store", path=str(plan.folder / "kerntemp.sqlite")))
        self.tell(say("demo-page", address=self.address))
        for view in VIEWS:
            address = self._view(view).ljust(len(self._view(max(VIEWS, key=len))))
            self.tell(say("demo-view", address=address, name=Message(f"page-nav-{view}")))
        if plan.pressings is None:
            minutes = max(round(NIGHT_AFTER * USUAL_CYCLE_S / plan.speed / 60.0), 1)
            self.tell(say("demo-night-comes", pressings=NIGHT_AFTER, minutes=minutes))

    def _view(self, name: str) -> str:
        return f"{self.address}#/{name}"

    def _start_loggers(self, settings: dict[str, Any]) -> dict[str, Any]:
        command = [sys.executable, "-m", "api.demo.press"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        child = self.children.start("loggers", command, **pipes)
        self._send(settings)
        answer: dict[str, Any] = json.loads(self._first_line("loggers", child))
        return answer

    def _send(self, message: Mapping[str, Any]) -> None:
        pipe = self.children.running["loggers"].stdin
        if pipe is None:
            raise WorkFailed("loggers: no pipe to the process")
        pipe.write(json.dumps(message) + "\n")
        pipe.flush()

    def _loggers_answer(self) -> threading.Event:
        """Return what is set once the loggers' process has solved its first pressing."""
        answering, child = threading.Event(), self.children.running["loggers"]

        def listen() -> None:
            if child.stdout is not None and child.stdout.readline():
                answering.set()

        threading.Thread(target=listen, name="loggers' answer", daemon=True).start()
        return answering

    def _wait_until(self, ready: Callable[[], bool], processes: Sequence[str]) -> None:
        """Wait for processes that may have to compile; one that ends meanwhile is an error."""
        began = time.monotonic()
        while not ready():
            self.children.check()
            waited = time.monotonic() - began
            if waited > COMPILE_S:
                raise WorkFailed(say("demo-no-sign-of-life", processes=tuple(processes), seconds=COMPILE_S))
            if waited > QUICK_S and not self._told_of_compiling:
                self._told_of_compiling = True
                self.tell(say("demo-compiling"))
            time.sleep(0.05)

    def _all_run(self) -> bool:
        """Whether recorder and sensor do their work."""
        states = {name: told.status.get("state") for name, told in self.store.statuses().items()}
        return all(states.get(name) not in (None, "starting") for name in SERVICES)

    def _first_line(self, name: str, child: subprocess.Popen[str]) -> str:
        line = child.stdout.readline() if child.stdout is not None else ""
        if not line:
            child.wait(START_S)
            raise WorkFailed(say("demo-did-not-start", process=name, why=self.children.last_words(name)))
        return line.strip()

    def watch(self) -> None:
        """Play the operator until the pressings asked for are recorded and fitted."""
        deadline = time.monotonic() + self.plan.patience_s
        while not self._enough:
            if self.plan.pressings is None:
                self._look_after_night()
            self.children.check()
            for record in reversed(self.store.runs(limit=20).items):
                self._note(record)
                if not self._enough and self._finished(record):
                    self._conclude(record)
                    deadline = time.monotonic() + self.plan.patience_s
            if time.monotonic() > deadline:
                if self.plan.pressings is not None and self.findings:
                    return  # the press has done what was asked; what was not found of it is told
                raise WorkFailed(say("demo-no-pressing"))
            time.sleep(0.05)

    def _look_after_night(self) -> None:
        """Begin a nightly job after every `NIGHT_AFTER` pressings, and say when its diagnosis is there."""
        if self._night is not None:
            if self._night.poll() is not None:
                self._end_night()
        elif len(self.findings) - self._judged >= NIGHT_AFTER:
            self._begin_night()

    def _begin_night(self) -> None:
        self.tell(say("demo-night"))
        self._judged = len(self.findings)
        command = [*_KERNTEMP, "refit", "--config", str(self.config)]
        self._night = self.children.start("refit", command, stdout=subprocess.DEVNULL)

    def _end_night(self) -> None:
        """Wait for the nightly job. Raises `WorkFailed` where it failed."""
        if self._night is None:
            return
        status = self._night.wait()
        self._night = None
        self._judged = len(self.findings)
        del self.children.running["refit"]
        if status != 0:
            raise WorkFailed(_ended("refit", status, self.children.last_words("refit")))
        for line in diagnosis_lines((), self._diagnosis):
            self.tell(line)
        self.tell(say("demo-diagnosis-there", diagnosis=self._view("diagnosis"), night=self._view("nights")))

    @property
    def _diagnosis(self) -> Mapping[str, Any] | None:
        found = self.store.diagnoses(limit=1).items
        return found[0].diagnosis if found else None

    @property
    def _enough(self) -> bool:
        return self.plan.pressings is not None and len(self.findings) >= self.plan.pressings

    def _note(self, record: RunRecord) -> None:
        """Write down what the operator knows of a pressing as soon as it runs."""
        if record.run in self._noted or record.status is not RunStatus.OPEN:
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
        newest = self._fit_number(record.run)
        since, before = self._ended.setdefault(record.run, (time.monotonic(), newest))
        return newest > before or time.monotonic() - since > FIT_S

    def _fit_number(self, run: str) -> int:
        """Return the number of a run's newest fit, 0 without; one comes at opening, the last one at the end."""
        recent = self.store.coefficient_history(limit=5).items
        return max((c.fit_number for c in recent if c.run == run), default=0)

    def _conclude(self, record: RunRecord) -> None:
        cycle = self._cycle(record, record.moments.closed_s)
        finding = compare(self.store, record, cycle, self._virtual(record))
        self.findings.append(finding)
        self._pressed.add(cycle.number)
        self.tell(finding.line)

    def _virtual(self, record: RunRecord) -> float:
        """Return the virtual time of a run's time 0. [s]"""
        return record.zero_monotonic_s - self.started * self.plan.speed

    def _cycle(self, record: RunRecord, at_s: float) -> Cycle:
        return self.truth.cycle(max(self._virtual(record) + (at_s if at_s == at_s else 0.0), 0.0))

    def finish(self) -> None:
        """Let the nightly job run where something is hidden, and say what came out."""
        if self.plan.hide and not self._judged:
            self._begin_night()
        if self._diagnosis is None:
            self._end_night()
        for line in summary_lines(self.findings, self.plan.hide, self._diagnosis):
            self.tell(line)
        recorder = self.store.statuses()["record"].status
        left_out = sum(int(press["missed_ticks"]) for press in recorder["presses"])
        unseen = (self.plan.pressings or max(self._pressed, default=0)) - len(self._pressed)
        for line in pace_lines(self.findings, self.plan.speed, left_out, int(recorder["acknowledged"]), unseen):
            self.tell(line)
        if not self.plan.hide:
            return
        active = self.store.active_model("lab")
        if active is not None and active.model.get("effects"):
            self.tell(gain_line(self.findings, list(self._replays(parse_model(active.model, active.version)))))
        for left in self.store.models(press="lab").items:
            if left.status in (ModelStatus.REJECTED, ModelStatus.CANDIDATE):
                self.tell(say("demo-not-promoted", version=left.version, why=left.reason))

    def _replays(self, model: ModelFile) -> Iterator[float]:
        """Yield the core errors of the last pressings with a model. [K]"""
        press = read_press(self.plan.folder / "press.toml")
        for finding in self.findings[-JUDGED:]:
            record = self.store.run_record(finding.run)
            cycle = self._cycle(record, record.moments.closed_s)
            yield replayed(self.store, press, model, record, cycle, self._virtual(record))


def _ended(process: str, status: int, why: str | Message) -> Message:
    return say("demo-ended", process=process, status=status, why=why)


_KERNTEMP = [sys.executable, "-m", "api"]


def _write_configuration(path: Path, plan: DemoPlan, loggers: Mapping[str, Any], press: VirtualPress) -> None:
    (path.parent / "press.toml").write_text(press_toml(positions=True), encoding="utf-8")
    panel = press.panel
    header = {
        "panel.material": panel.material,
        "panel.thickness_mm": panel.thickness * 1000.0,
        "panel.density_kg_m3": panel.density,
        "panel.moisture_percent": panel.moisture_percent or 0.0,
        "panel.initial_temperature_C": round(press.ambient, 1),
        "ambient.temperature_C": round(press.ambient, 1),
        "setting.platen_temperature_C": press.settings.setpoint_C,
        "setting.core_target_C": TARGET_C,
    }
    lines = [
        "[store]",
        toml_line("url", "kerntemp.sqlite"),
        "",
        "[clock]",
        toml_line("speed", plan.speed),
        "",
        "[[press]]",
        toml_line("name", "lab"),
        toml_line("file", "press.toml"),
        toml_line("rate_hz", plan.rate_hz),
        "header = { " + ", ".join(f"{toml_value(k)} = {toml_value(v)}" for k, v in header.items()) + " }",
    ]
    for table in loggers["loggers"]:
        lines += ["", "[[press.logger]]", *(toml_line(key, value) for key, value in table.items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
