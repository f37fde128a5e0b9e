"""The processes of the demonstration, and what it is asked to do.

Of little weight: all of them are on their way before what judges them is loaded.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from api.outputs import WorkFailed
from daq.records import InputError
from daq.words import Message, say

START_S = 120.0
"""Longest wait for a process to come up. [s]"""
PATIENCE_S = 15.0
"""Longest wait for a process to end by itself. [s]"""
SCANS_PER_S = 30.0
"""An accelerated demonstration scans at most about this often in real time."""
FIT_S = 240.0
"""Longest wait for the last fit of a finished pressing: of a first start, also for what fits compile. [s]"""
LOGGERS_KEEP = 6
"""Pressings in the memory of the loggers' process, which only looks at the present."""
SHORTEST_CYCLE_S, USUAL_CYCLE_S = 90.0, 130.0
"""From one panel's removal to the next one's: at least, and on average over the ranges of `VirtualPressSettings`.
[s]"""
JUDGED = 10
"""Newest pressings on which a promoted model is held against the live estimates. Panels differ in what is hidden
in them by a quarter, so that four (2026-11) were too few to judge by; no fit and no diagnosis sees the core."""
TARGET_C = 60.0
"""What the demonstration's recipe asks of the core: what its panel reaches, taken out after some 50 s, the middle
of its press times. [°C]"""
SERVICES = ("record", "sense")
KERNTEMP = (sys.executable, "-m", "api")


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
    def press(self) -> dict[str, Any]:
        """Which virtual press it is, as `api.demo.press` is given it."""
        return {"hide": self.hide, "keep": LOGGERS_KEEP, "seed": self.seed}

    @property
    def rate_hz(self) -> float:
        """Scans per second of run time. [Hz]"""
        return round(min(10.0, max(SCANS_PER_S / self.speed, 0.5)), 3)

    @property
    def patience_s(self) -> float:
        """Longest wait for the next pressing to be recorded, while none waits for its fit. [s]"""
        return START_S + 3 * USUAL_CYCLE_S / self.speed

    @property
    def known_cycles(self) -> int:
        """How many pressings the truth is kept of: those to be judged, and those that go by meanwhile."""
        longest_s = max(self.patience_s, FIT_S)
        return (self.pressings or JUDGED) + 4 + math.ceil(longest_s * self.speed / SHORTEST_CYCLE_S)


@dataclass
class Children:
    """The processes of the demonstration; all of them end with it."""

    folder: Path
    running: dict[str, subprocess.Popen[str]] = field(default_factory=dict)
    loggers: Mapping[str, Any] = field(default_factory=dict)
    """How they are wired, as they say it."""
    _listeners: list[threading.Thread] = field(default_factory=list)

    @property
    def config(self) -> Path:
        """The configuration of the services."""
        return self.folder / "kerntemp.toml"

    def start(self, name: str, command: list[str], **options: Any) -> subprocess.Popen[str]:
        """Start a process whose messages go to a log file beside the store."""
        with (self.folder / f"{name}.log").open("w", encoding="utf-8") as log:
            child = subprocess.Popen(command, stderr=log, text=True, encoding="utf-8", **_APART, **options)
        self.running[name] = child
        return child

    def first_line(self, name: str) -> str:
        """Return what a process says first. Raises `WorkFailed` where it ends instead."""
        child = self.running[name]
        line = child.stdout.readline() if child.stdout is not None else ""
        if not line:
            child.wait(START_S)
            raise WorkFailed(say("demo-did-not-start", process=name, why=self.last_words(name)))
        return line.strip()

    def send_to_loggers(self, message: dict[str, Any]) -> None:
        """Send the loggers' process a line."""
        pipe = self.running["loggers"].stdin
        if pipe is None:
            raise WorkFailed("loggers: no pipe to the process")
        pipe.write(json.dumps(message) + "\n")
        pipe.flush()

    def listen_to_loggers(self, take: Callable[[Mapping[str, Any]], None]) -> None:
        """Hand on every line the loggers' process says from now on, in a thread of its own."""
        pipe = self.running["loggers"].stdout

        def listen() -> None:
            for line in pipe or ():
                take(json.loads(line))

        self._listeners.append(threading.Thread(target=listen, name="loggers' answers", daemon=True))
        self._listeners[-1].start()

    def check(self) -> None:
        """Raise `WorkFailed` with the last words of a process that ended by itself."""
        for name, child in self.running.items():
            if child.poll() is not None:
                raise WorkFailed(ended(name, child.returncode, self.last_words(name)))

    def last_words(self, name: str) -> str | Message:
        """Return the last line of a process's log."""
        lines = (self.folder / f"{name}.log").read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), say("demo-no-message"))

    def stop(self) -> None:
        """End the services at once, then the loggers they read; by force where asking does not help."""
        services = [child for child in self.running.values() if child.stdin is None]
        for child in services:
            if child.poll() is None:
                child.terminate()
        _wait_or_kill(services)
        fed = [child for child in self.running.values() if child.stdin is not None]
        for child in fed:
            if child.stdin is not None:
                child.stdin.close()
        _wait_or_kill(fed)
        for listener in self._listeners:
            listener.join(PATIENCE_S)
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


@contextmanager
def started(plan: DemoPlan, data: Path | None) -> Iterator[Children]:
    """Start the loggers, the page and the services; what runs then ends with the ``with`` statement.

    Raises
    ------
    InputError
        For a folder that holds a store already.
    WorkFailed
        Where the loggers do not come up.
    """
    with _folder(data) as folder:
        children = Children(folder)
        try:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            children.start("loggers", [sys.executable, "-m", "api.demo.press"], **pipes)
            children.send_to_loggers({**plan.press, "speed": plan.speed, "pressings": plan.pressings})
            _write_configuration(plan, children)
            web = [*KERNTEMP, "serve", "--config", str(children.config), "--port", str(plan.port)]
            children.start("serve", web, stdout=subprocess.PIPE)
            for name in SERVICES:
                command = [*KERNTEMP, name, "--config", str(children.config)]
                children.start(name, command, stdout=subprocess.DEVNULL)
            yield children
        finally:
            children.stop()


def _write_configuration(plan: DemoPlan, children: Children) -> None:
    """Write press file and configuration as soon as the loggers say how they are wired."""
    from api.demo.press import virtual_press_of  # loaded while they come up
    from daq.files.run_file import toml_line, toml_value
    from daq.simulated.campaign_pressfile import press_toml

    press = virtual_press_of(plan.press)
    (children.folder / "press.toml").write_text(press_toml(positions=True), encoding="utf-8")
    children.loggers = json.loads(children.first_line("loggers"))
    panel = press.panel
    header = {
        "panel.material": panel.material,
        "panel.thickness_mm": panel.thickness * 1000.0,
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
    for table in children.loggers["loggers"]:
        lines += ["", "[[press.logger]]", *(toml_line(key, value) for key, value in table.items())]
    children.config.write_text("\n".join(lines) + "\n", encoding="utf-8")


def ended(process: str, status: int, why: str | Message) -> Message:
    """Say that a process ended by itself."""
    return say("demo-ended", process=process, status=status, why=why)
