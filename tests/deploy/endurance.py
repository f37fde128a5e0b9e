"""Pressing after pressing with random faults, and at the end a balance: due, there, and by which cause not.

    python -m tests.deploy.endurance --pressings 2016 --speed 20 --folder FOLDER

What is real: the loggers' protocols over a socket and a serial line, `kerntemp record` and `kerntemp sense` as
processes of their own, the store, SIGKILL. What is not: the press is simulated and its time runs `speed` times as
fast; a pressing takes about two minutes of it instead of five; the clock is stepped inside the recorder's process.
In the first half everything breaks; in the second half no process is killed, so that one of each lives long enough
to show whether its memory stays flat. SIGTERM or Ctrl-C ends the pressing early, with the balance so far.
`tests/deploy/balance.py` says how it is counted.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from daq.records import Moments
from daq.runfile import toml_value
from daq.simulated.campaign import press_toml
from daq.simulated.devices import simulated, wiring
from daq.simulated.devices_converter import Switches
from daq.simulated.press import PressSettings, VirtualPress
from daq.store import RunStatus, open_store
from tests.deploy.balance import Balance, Fault, Truth, take_balance

ROOT = Path(__file__).parents[2]
UPPER = ("platen_top", "platen_bottom", *(f"top_{i}" for i in range(1, 8)))
LOWER = tuple(f"bottom_{i}" for i in range(1, 8))
FAULTS = ("logger lost", "sensor dead", "recorder killed", "sensor process killed", "store away", "clock stepped")
CALM_FAULTS = tuple(kind for kind in FAULTS if "killed" not in kind)
STEPPING = """
import datetime as real, sys
from pathlib import Path
import daq.acquisition as acquisition
place = Path(sys.argv.pop(1))
class Stepped(real.datetime):
    @classmethod
    def now(cls, tz=None):
        step = float(place.read_text() or 0) if place.exists() else 0.0
        return real.datetime.now(tz) + real.timedelta(seconds=step)
acquisition.datetime = Stepped
from api.cli import main
sys.exit(main(sys.argv[1:]))
"""
"""`kerntemp record` with a wall clock that a file sets forward and back."""


class Endurance:
    """The plant, its processes, and the hand that breaks things."""

    def __init__(self, folder: Path, speed: float, rate_hz: float, seed: int, pressings: int) -> None:
        self.folder, self.speed, self.rate_hz, self.pressings = folder, speed, rate_hz, pressings
        self.chance = random.Random(seed)
        self.press = VirtualPress(PressSettings(between_s=(12.0, 16.0), keep=8), seed)
        self.switches = {"upper": Switches(), "lower": Switches()}
        self.faults: list[Fault] = []
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        self.memory: dict[str, list[tuple[int, float, int]]] = {"record": [], "sense": []}
        self.config, self.step_file = folder / "kerntemp.toml", folder / "step"
        self.url = str(folder / "plant.sqlite")
        self.began_s = 0.0
        self.ended_s = 0.0
        """When the recorder was asked to end. [s of the press]"""
        self.steps = 0
        self.pressed: dict[int, Moments] = {}
        """Each pressing's true moments. [s of the press]"""
        self.stop = threading.Event()

    def clock(self) -> float:
        """Return the press's time. [s]"""
        return (time.monotonic() - self.began_s) * self.speed if self.began_s else 0.0

    def inputs(self, columns: Sequence[str], count: int) -> Any:
        """Return what a logger's inputs read."""

        def temperatures(now_s: float) -> list[float]:
            shown = self.press.temperatures(max(now_s, 0.0))
            return [shown[name] for name in columns] + [self.press.ambient] * (count - len(columns))

        return temperatures

    def run(self) -> Balance:
        """Press, break, count."""
        with ExitStack() as stack:
            made = {"clock": self.clock}
            upper, lower = self.inputs(UPPER, 16), self.inputs(LOWER, 8)
            a = simulated("labjack-t7", upper, refresh_s=0.0, switches=self.switches["upper"], **made)
            b = simulated("adam-4118-ascii", lower, refresh_s=0.1, switches=self.switches["lower"], **made)
            tables = [
                wiring("labjack-t7", stack.enter_context(a), "upper", UPPER),
                wiring("adam-4118-ascii", stack.enter_context(b), "lower", LOWER),
            ]
            self._write(tables)
            stack.callback(self._kill_all)
            self.store = stack.enter_context(open_store(self.url))
            for name in ("record", "sense"):
                self._start(name)
            self._wait_for_scans()
            self.began_s = time.monotonic()
            self._press_and_break()
            self.ended_s = self.clock()
            self._end("record")
            self._let_sense_catch_up()
            self._end("sense")
            return self._balance()

    def _write(self, tables: Sequence[dict[str, Any]]) -> None:
        (self.folder / "lab.toml").write_text(press_toml())
        text = f'[store]\nurl = "plant.sqlite"\n[clock]\nspeed = {self.speed}\n[[press]]\nname = "lab"\n'
        text += f'file = "lab.toml"\nrate_hz = {self.rate_hz}\n'
        text += 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }\n'
        for table in tables:
            text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
        self.config.write_text(text)

    def _start(self, name: str) -> None:
        words = [sys.executable, "-m", "api"]
        if name == "record":
            words = [sys.executable, "-c", STEPPING, str(self.step_file)]
        with (self.folder / f"{name}.log").open("ab") as log:
            line = [*words, name, "--config", str(self.config)]
            child = subprocess.Popen(line, cwd=ROOT, stdout=log, stderr=log, start_new_session=True)
        self.children[name] = child

    def _kill(self, name: str) -> None:
        """Kill a process with its children, as systemd clears up after a service."""
        child = self.children[name]
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()

    def _kill_all(self) -> None:
        for name, child in self.children.items():
            if child.poll() is None:
                self._kill(name)

    def _wait_for_scans(self) -> None:
        deadline = time.monotonic() + 120
        while self.store.newest_scan_number("lab") < 5 or "sense" not in self.store.statuses():
            if time.monotonic() > deadline:
                raise RuntimeError("no scans in 120 s; the logs are beside the store")
            time.sleep(0.1)

    # --- pressing and breaking ----------------------------------------------------------------------

    def _press_and_break(self) -> None:
        waits = list(FAULTS)
        while self._pressing() <= self.pressings and not self.stop.is_set():
            self._rest(self.chance.uniform(2.0, 10.0))
            if not waits:
                kinds = FAULTS if self._pressing() <= self.pressings / 2 else CALM_FAULTS
                waits = [*kinds, self.chance.choice(kinds)]
            kind = waits.pop(self.chance.randrange(len(waits)))
            begin_s = time.monotonic()
            self._break(kind)
            self.faults.append(Fault(kind, begin_s, time.monotonic()))
        self._rest(3.0)

    def _pressing(self) -> int:
        """Return the pressing under way, and keep its true moments."""
        now = self.press.cycle(self.clock())
        self.pressed |= {cycle.number: cycle.moments for cycle in self.press.cycles if cycle.number <= now.number}
        return now.number

    def _rest(self, for_s: float) -> None:
        end = time.monotonic() + for_s
        while time.monotonic() < end:
            time.sleep(0.25)
            self._pressing()
            for name, child in self.children.items():
                if child.poll() is not None:
                    raise RuntimeError(
                        f"{name} ended by itself with {child.returncode}; see {self.folder}/{name}.log"
                    )
        for name, child in self.children.items():
            self.memory[name].append((child.pid, time.monotonic(), _resident(child.pid)))
        (self.folder / "progress").write_text(f"pressing {self._pressing()}, {len(self.faults)} faults\n")

    def _break(self, kind: str) -> None:
        if kind in ("recorder killed", "sensor process killed"):
            name = "record" if kind.startswith("recorder") else "sense"
            self._kill(name)
            time.sleep(self.chance.uniform(0.2, 3.0))
            before = self.store.newest_scan_number("lab")
            self._start(name)
            while name == "record" and self.store.newest_scan_number("lab") <= before:
                time.sleep(0.05)
        elif kind == "logger lost":
            one = self.switches[self.chance.choice(("upper", "lower"))]
            one.silent = True
            time.sleep(self.chance.uniform(1.0, 8.0))
            one.silent = False
        elif kind == "sensor dead":
            one = self.switches[self.chance.choice(("upper", "lower"))]
            one.open_inputs.add(self.chance.randrange(2, 7))
            time.sleep(self.chance.uniform(5.0, 20.0))
            one.open_inputs.clear()
        elif kind == "store away":
            with closing(sqlite3.connect(self.url, isolation_level=None)) as connection:
                connection.execute("BEGIN IMMEDIATE")
                time.sleep(self.chance.uniform(11.0, 15.0))
                connection.execute("ROLLBACK")
        else:
            self.steps += 1
            moved = self.chance.choice((-3600.0, -45.0, 45.0, 3600.0))
            self.step_file.write_text(str(moved if self.steps % 2 else 0.0))
            time.sleep(1.0)

    def _end(self, name: str) -> None:
        child = self.children[name]
        child.terminate()
        if child.wait(60) != 0:
            raise RuntimeError(f"{name} ended with {child.returncode}; see {self.folder}/{name}.log")

    def _let_sense_catch_up(self) -> None:
        """Give it five minutes for the last scans and fits."""
        deadline = time.monotonic() + 300
        while time.monotonic() < deadline:
            last = self.store.statuses()["sense"].status["presses"][0]["last_scan"]
            ended = [r for r in self.store.runs(limit=20).items if r.status is not RunStatus.OPEN]
            said = " ".join(e.message for e in self.store.journal(limit=100).items)
            fitted = all(
                "fingerprint" in (self.store.fit(r.run) or {}) or f"run {r.run} could not be fitted" in said
                for r in ended
                if r.moments.closed_s == r.moments.closed_s
            )
            if last >= self.store.newest_scan_number("lab") and fitted:
                return
            time.sleep(0.5)

    def _balance(self) -> Balance:
        zero_s = self.began_s * self.speed
        over = {n: t for n, t in self.pressed.items() if n <= self.pressings and t.removed_s < self.ended_s - 30.0}
        truth = Truth(
            "lab",
            self.speed,
            self.rate_hz,
            self.faults,
            {n: _moved(true, zero_s) for n, true in sorted(over.items())},
            self.steps,
        )
        balance = take_balance(self.store, truth)
        kinds = Counter(fault.kind for fault in self.faults)
        named = ", ".join(f"{count} x {kind}" for kind, count in sorted(kinds.items()))
        hours = self.ended_s / 3600.0
        title = f"{hours:.1f} h of pressing, {len(over) / hours:.1f} an hour, at {self.speed:g} times real speed"
        balance.lines[:0] = [f"{title}; faults: {named}"]
        for name, seen in self.memory.items():
            balance.weigh(name, seen)
        return balance


def _moved(moments: Moments, by_s: float) -> Moments:
    times = {f.name: getattr(moments, f.name) + by_s for f in fields(moments) if f.name in _MOMENTS}
    return replace(moments, **times)


_MOMENTS = ("inserted_s", "closed_s", "opened_s", "removed_s")


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it and print the balance; 1 where something is not accounted for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pressings", type=int, default=2016, help="a week at one in five minutes")
    parser.add_argument("--speed", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=1.0, help="scans per second of the press's time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, required=True)
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    plant = Endurance(given.folder, given.speed, given.rate, given.seed, given.pressings)
    for ending in (signal.SIGTERM, signal.SIGINT):
        signal.signal(ending, lambda *_: plant.stop.set())
    balance = plant.run()
    sys.stdout.write("\n".join(balance.lines) + "\n")
    return int(any(balance.unaccounted.values()))


if __name__ == "__main__":
    raise SystemExit(main())
