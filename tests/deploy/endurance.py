"""Days of pressing with random faults, and at the end a balance: due, there, and by which cause not.

    python -m tests.deploy.endurance --days 7 --pressings 70 --folder FOLDER
    python -m tests.deploy.endurance --again --folder FOLDER

The second line only counts again what the first one left.

A working day is so many pressings one after the other, about two minutes of the press each, then an idle press
with hot platens until the next morning; the sixth and seventh day of a week are idle. Every second of these days
is recorded: the press's time runs fast while it presses, faster while it is idle, and never jumps. The recorder is
ended and begun anew where its pace changes, as `[clock] speed` asks for; idle hours have a rate of their own.

What is real: the loggers' protocols over a socket and a serial line, `kerntemp record` and `kerntemp sense` as
processes of their own, the store, SIGKILL. What is not: the press is simulated; the clock is stepped inside the
recorder's process. In the first half of the days everything breaks; in the second half no process is killed, so
that each lives long enough to show whether its memory stays flat. SIGTERM or Ctrl-C ends it early, with the
balance so far. `tests/deploy/balance.py` says how it is counted.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.files.run_file import toml_value
from daq.simulated.campaign import press_toml
from daq.simulated.devices import simulated, wiring
from daq.simulated.devices_converter import Switches
from daq.store import RunStatus, open_store
from tests.deploy.balance import NO_FIT, Balance, take_balance
from tests.deploy.truth import RESTARTED, Fault, PacedPress, PlantClock, Record, Shift

ROOT = Path(__file__).parents[2]
UPPER = ("platen_top", "platen_bottom", *(f"top_{i}" for i in range(1, 8)))
LOWER = tuple(f"bottom_{i}" for i in range(1, 8))
FAULTS = ("logger lost", "sensor dead", "recorder killed", "sensor process killed", "store away", "clock stepped")
CALM_FAULTS = tuple(kind for kind in FAULTS if "killed" not in kind)
STEPPING = """
import datetime as real, sys
from pathlib import Path
import daq.recording.acquisition as acquisition
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


@dataclass(frozen=True)
class Pace:
    """How fast the press's time runs, and how often it is recorded."""

    speed: float
    rate_hz: float
    """Scans per second of the press's time."""


@dataclass(frozen=True)
class Plan:
    """What is pressed when."""

    days: int
    pressings: int
    """Of a working day."""
    pressing: Pace
    idle: Pace
    day_s: float = 86400.0
    """Length of a day. [s of the press]"""

    def works_on(self, day: int) -> bool:
        """Whether panels are pressed on a day; days count from 0."""
        return day % 7 < 5


class Endurance:
    """The plant, its processes, and the hand that breaks things."""

    def __init__(self, folder: Path, plan: Plan, seed: int) -> None:
        self.folder, self.plan, self.seed = folder, plan, seed
        self.chance = random.Random(seed)
        self.clock = PlantClock()
        self.press = PacedPress(seed)
        self.switches = {"upper": Switches(), "lower": Switches()}
        self.faults: list[Fault] = []
        self.shifts: list[Shift] = []
        self.waits: list[str] = []
        """Kinds of faults still to come before any comes again."""
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        self.memory: dict[str, list[tuple[int, float, int]]] = {"record": [], "sense": []}
        self.config, self.step_file = folder / "kerntemp.toml", folder / "step"
        self.url = str(folder / "plant.sqlite")
        self.ended_s = 0.0
        """When the recorder was last asked to end, on the machine's monotonic clock. [s]"""
        self.steps = 0
        self.stop = threading.Event()

    def inputs(self, columns: Sequence[str], count: int) -> Any:
        """Return what a logger's inputs read."""

        def temperatures(now_s: float) -> list[float]:
            shown = self.press.temperatures(now_s)
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
                # a module of its own answers within 0.3 s; this one shares the processor with everything else
                wiring("adam-4118-ascii", stack.enter_context(b), "lower", LOWER)
                | {"timeout_s": 1.0, "drain_s": 0.3},
            ]
            self.tables = tables
            stack.callback(self._kill_all)
            self.store = stack.enter_context(open_store(self.url))
            self._write(self.plan.pressing)
            self._start("sense")
            self._record(self.plan.pressing)
            self._wait_for("sense")
            for day in range(self.plan.days):
                self._day(day)
            self.ended_s = time.monotonic()
            self._end("record")
            self._let_sense_catch_up()
            self._end("sense")
            return self._balance()

    def _write(self, pace: Pace) -> None:
        (self.folder / "lab.toml").write_text(press_toml())
        text = f'[store]\nurl = "plant.sqlite"\n[clock]\nspeed = {pace.speed}\n[[press]]\nname = "lab"\n'
        text += f'file = "lab.toml"\nrate_hz = {pace.rate_hz}\n'
        text += 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }\n'
        for table in self.tables:
            text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
        self.config.write_text(text)

    def _record(self, pace: Pace) -> None:
        """Begin to record at a pace; the plant's clock takes it over with the first scan."""
        last = self.store.newest_scan_number("lab") if self.shifts else -1
        self._write(pace)
        self.shifts.append(Shift(last + 1, pace.speed, pace.rate_hz))
        self._start("record")
        self._wait_for("record", last)
        self.clock.run(pace.speed)

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

    def _wait_for(self, name: str, last: int = -1) -> None:
        """Wait for a process's first sign of life, of the recorder a scan after the last one."""
        deadline = time.monotonic() + 300
        while name not in self.store.statuses() or (
            name == "record" and self.store.newest_scan_number("lab") <= last
        ):
            if time.monotonic() > deadline or self.children[name].poll() is not None:
                raise RuntimeError(f"{name} has ended, or gave no sign in 300 s; the logs are beside the store")
            time.sleep(0.02)

    # --- pressing and breaking ----------------------------------------------------------------------

    def _day(self, day: int) -> None:
        """Press, then stand idle until the next morning; what breaks, breaks in between."""
        kinds = FAULTS if day < self.plan.days / 2 else CALM_FAULTS
        if self.plan.works_on(day) and not self.stop.is_set():
            self._change(self.plan.pressing)
            self.press.go_on(self.clock(), self.plan.pressings)
            while not self.press.idle and not self.stop.is_set():
                self._rest(self.chance.uniform(2.0, 10.0))
                self._one_of(kinds)
        self._change(self.plan.idle)
        while (left_s := (day + 1) * self.plan.day_s - self.clock()) > 0.0 and not self.stop.is_set():
            rest_s = self.chance.uniform(10.0, 40.0)
            if rest_s + _LONGEST_FAULT_S > left_s / self.plan.idle.speed:
                self._rest(min(5.0, left_s / self.plan.idle.speed))
            else:
                self._rest(rest_s)
                self._one_of(kinds)

    def _change(self, pace: Pace) -> None:
        """End the recorder in order and begin it at another pace."""
        now = self.shifts[-1]
        if self.stop.is_set() or (now.speed, now.rate_hz) == (pace.speed, pace.rate_hz):
            return
        if pace.speed < now.speed:
            self.clock.run(pace.speed)
        begin_s = time.monotonic()
        self._end("record")
        self._record(pace)
        self.faults.append(Fault(RESTARTED, begin_s, time.monotonic()))

    def _one_of(self, kinds: Sequence[str]) -> None:
        self.waits = [kind for kind in self.waits if kind in kinds] or [*kinds, self.chance.choice(kinds)]
        self._break(self.waits.pop(self.chance.randrange(len(self.waits))))

    def _rest(self, for_s: float) -> None:
        end = time.monotonic() + for_s
        while time.monotonic() < end:
            time.sleep(0.25)
            for name, child in self.children.items():
                if child.poll() is not None:
                    raise RuntimeError(
                        f"{name} ended by itself with {child.returncode}; see {self.folder}/{name}.log"
                    )
        for name, child in self.children.items():
            self.memory[name].append((child.pid, time.monotonic(), _resident(child.pid)))
        text = f"{self.clock() / 3600.0:.1f} h, pressing {max(self.press.pressed)}, {len(self.faults)} faults\n"
        (self.folder / "progress").write_text(text)

    def _break(self, kind: str) -> None:
        columns: tuple[str, ...] = ()
        begin_s, end_s = time.monotonic(), 0.0
        if kind in ("recorder killed", "sensor process killed"):
            self._kill_and_start("record" if kind.startswith("recorder") else "sense")
        elif kind in ("logger lost", "sensor dead"):
            begin_s, end_s, columns = self._break_logger(kind)
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
        self.faults.append(Fault(kind, begin_s, end_s or time.monotonic(), columns))

    def _kill_and_start(self, name: str) -> None:
        self._kill(name)
        time.sleep(self.chance.uniform(0.2, 3.0))
        before = self.store.newest_scan_number("lab")
        self._start(name)
        while name == "record" and self.store.newest_scan_number("lab") <= before:
            time.sleep(0.05)

    def _break_logger(self, kind: str) -> tuple[float, float, tuple[str, ...]]:
        """Return when it was broken and when it was well again, as `Fault` has it, and the columns.

        The first answer after a fault may be to a question the recorder had asked before.
        """
        name, columns = self.chance.choice((("upper", UPPER), ("lower", LOWER)))
        switches = self.switches[name]
        begin_s = switches.answered_s
        if kind == "logger lost":
            switches.silent = True
            time.sleep(self.chance.uniform(1.0, 8.0))
            switches.silent = False
            well_s = time.monotonic()
        else:
            which = self.chance.randrange(2, 7)
            columns = columns[which : which + 1]
            switches.open_inputs.add(which)
            time.sleep(self.chance.uniform(5.0, 20.0))
            switches.open_inputs.clear()
        for _ in range(2):
            self._wait_for_answer(switches, time.monotonic())
        return begin_s, well_s if kind == "logger lost" else switches.answered_s, columns

    def _wait_for_answer(self, switches: Switches, after_s: float) -> None:
        while switches.answered_s <= after_s:
            if time.monotonic() > after_s + 30.0:
                raise RuntimeError(
                    f"a logger that is well again was not asked for 30 s; see {self.folder}/record.log"
                )
            time.sleep(0.002)

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
            messages = " ".join(str(e.message) for e in self.store.journal(limit=200).items)
            fitted = all(
                "fingerprint" in (self.store.fit(r.run) or {})
                or any(f"run {r.run} {why}" in messages for why in NO_FIT)
                for r in ended
                if r.moments.closed_s == r.moments.closed_s
            )
            if last >= self.store.newest_scan_number("lab") and fitted:
                return
            time.sleep(0.5)

    def _balance(self) -> Balance:
        mornings, knots = self.press.mornings, self.clock.knots
        kept = Record(self.seed, mornings, knots, self.shifts, self.faults, self.steps, self.ended_s)
        kept.write(self.folder / "truth.json")
        balance = take_balance(self.store, truth := kept.truth())
        kinds = Counter(fault.kind for fault in self.faults if fault.kind != RESTARTED)
        named = ", ".join(f"{count} x {kind}" for kind, count in sorted(kinds.items()))
        busy_s = sum(true.removed_s - true.inserted_s for true in truth.pressings.values())
        days, hours = divmod(self.clock.at(self.ended_s) / 3600.0, self.plan.day_s / 3600.0)
        plan = self.plan
        balance.lines[:0] = [
            f"{days:.0f} days of {plan.day_s / 3600.0:g} h and {hours:.1f} h of the press recorded, "
            f"{len(truth.pressings)} pressings: a panel in the press for {busy_s / 3600.0:.1f} h; pressing days "
            f"at {plan.pressing.speed:g} times real speed and {plan.pressing.rate_hz:g} Hz, idle hours at "
            f"{plan.idle.speed:g} times and {plan.idle.rate_hz:g} Hz",
            f"faults: {named}",
        ]
        for name, seen in self.memory.items():
            balance.weigh(name, seen, self.clock.at)
        return balance


_LONGEST_FAULT_S = 30.0


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it and print the balance; 1 where something is not accounted for, or memory not flat."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=7)
    parser.add_argument("--pressings", type=int, default=70, help="of a working day")
    parser.add_argument("--speed", type=float, default=25.0, help="while panels are pressed")
    parser.add_argument("--idle-speed", type=float, default=400.0)
    parser.add_argument("--idle-rate", type=float, default=0.5, help="scans per second of the press's time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--again", action="store_true", help="only take the balance of a finished run again")
    given = parser.parse_args(arguments)
    if given.again:
        with open_store(str(given.folder / "plant.sqlite")) as store:
            balance = take_balance(store, Record.read(given.folder / "truth.json").truth())
        sys.stdout.write("\n".join(balance.lines) + "\n")
        return int(any(balance.unaccounted.values()))
    given.folder.mkdir(parents=True, exist_ok=True)
    pressing, idle = Pace(given.speed, 1.0), Pace(given.idle_speed, given.idle_rate)
    plant = Endurance(given.folder, Plan(given.days, given.pressings, pressing, idle), given.seed)
    for ending in (signal.SIGTERM, signal.SIGINT):
        signal.signal(ending, lambda *_: plant.stop.set())
    balance = plant.run()
    sys.stdout.write("\n".join(balance.lines) + "\n")
    return int(not balance.sound)


if __name__ == "__main__":
    raise SystemExit(main())
