"""Pressing after pressing with random faults, and at the end a balance: due, there, and by which cause not.

    python tests/deploy/endurance.py --pressings 2016 --speed 20

What is real: the loggers' protocols over a socket and a serial line, `kerntemp record` and `kerntemp sense` as
processes of their own, the store, SIGKILL. What is not: the press is simulated and its time runs `speed` times as
fast; a pressing takes about two minutes of it instead of five; the clock is stepped inside the recorder's process.
Every fault is written down with its time on the machine's monotonic clock; a pressing without run counts as
explained only where such a fault lies over it. A gap in the scans and a value without reading over which no fault
lies are counted under that name: on a busy machine scans are left out as late and answers come after their scan;
which of them were just that, this balance does not know. For scans and values "unaccounted" is therefore always 0.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq.runfile import toml_value
from daq.simulated.campaign import press_toml
from daq.simulated.devices import simulated, wiring
from daq.simulated.devices_converter import Switches
from daq.simulated.press import PressSettings, VirtualPress
from daq.store import RunStatus, Store, open_store

ROOT = Path(__file__).parents[2]
UPPER = ("platen_top", "platen_bottom", *(f"top_{i}" for i in range(1, 8)))
LOWER = tuple(f"bottom_{i}" for i in range(1, 8))
FAULTS = ("logger lost", "sensor dead", "recorder killed", "sensor process killed", "store away", "clock stepped")
AFTER_S = 3.0
"""A fault explains what goes wrong until this long after its end: a driver comes back, a process starts. [s]"""
NO_FAULT = "no injected fault over it"
"""What is missing without a cause this balance knows."""
PATIENCE_S = 60.0
"""A fit may wait this long for the fits before it. [s]"""
LOOK_BACK_S = 120.0
"""A pressing that begins so soon after a fault may find the press's state unknown. [s of the press]"""
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


@dataclass(frozen=True)
class Fault:
    """One fault, on the machine's monotonic clock. [s]"""

    kind: str
    begin_s: float
    end_s: float

    def over(self, begin_s: float, end_s: float) -> bool:
        """Whether it lies over a stretch of time, with what it takes to recover."""
        return self.begin_s <= end_s and begin_s <= self.end_s + AFTER_S


@dataclass
class Balance:
    """What was due, what is there, and where the rest went."""

    lines: list[str] = field(default_factory=list)
    unaccounted: Counter[str] = field(default_factory=Counter)
    grown_share: dict[str, float] = field(default_factory=dict)

    def say(self, what: str, due: int, there: int, causes: Counter[str]) -> None:
        """Add a line: due = there + by cause + unaccounted."""
        rest = due - there - sum(causes.values())
        self.unaccounted[what] = rest
        named = "".join(f", {cause} {count}" for cause, count in sorted(causes.items()))
        self.lines.append(f"{what:18} due {due}, there {there}{named}, unaccounted {rest}")


class Endurance:
    """The plant, its processes, and the hand that breaks things."""

    def __init__(self, folder: Path, speed: float, rate_hz: float, seed: int, pressings: int) -> None:
        self.folder, self.speed, self.rate_hz, self.pressings = folder, speed, rate_hz, pressings
        self.chance = random.Random(seed)
        self.press = VirtualPress(PressSettings(between_s=(12.0, 16.0), keep=pressings + 400), seed)
        self.switches = {"upper": Switches(), "lower": Switches()}
        self.faults: list[Fault] = []
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        self.memory: dict[str, list[tuple[int, float, int]]] = {"record": [], "sense": []}
        self.config, self.step_file = folder / "kerntemp.toml", folder / "step"
        self.url = str(folder / "plant.sqlite")
        self.began_s = 0.0
        self.steps = 0

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
        while self.press.cycle(self.clock()).number <= self.pressings:
            self._rest(self.chance.uniform(2.0, 10.0))
            if not waits:
                waits = [*FAULTS, self.chance.choice(FAULTS)]
            kind = waits.pop(self.chance.randrange(len(waits)))
            begin_s = time.monotonic()
            self._break(kind)
            self.faults.append(Fault(kind, begin_s, time.monotonic()))
            told = [[f.kind, f.begin_s - self.began_s, f.end_s - self.began_s] for f in self.faults]
            (self.folder / "faults.json").write_text(json.dumps(told))
        self._rest(3.0)

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
        number = self.press.cycle(self.clock()).number
        (self.folder / "progress").write_text(f"pressing {number}, {len(self.faults)} faults\n")

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
        """Give it a minute for the last scans and fits."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            last = self.store.statuses()["sense"].status["presses"][0]["last_scan"]
            unfitted = sum(self.store.fit(r.run) is None for r in _closed(self.store))
            if last >= self.store.newest_scan_number("lab") and not unfitted:
                return
            time.sleep(0.5)

    # --- counting -----------------------------------------------------------------------------------

    def _during(self, kinds: Sequence[str], begin_s: float, end_s: float) -> str | None:
        return next((f.kind for f in self.faults if f.kind in kinds and f.over(begin_s, end_s)), None)

    def _balance(self) -> Balance:
        balance = Balance()
        hours = (time.monotonic() - self.began_s) * self.speed / 3600.0
        kinds = Counter(fault.kind for fault in self.faults)
        named = ", ".join(f"{count} x {kind}" for kind, count in sorted(kinds.items()))
        balance.lines.append(f"{hours:.1f} h of pressing at {self.speed:g} times real speed; faults: {named}")
        self._count_scans(balance)
        self._count_pressings(balance)
        self._count_estimates(balance)
        steps = sum("clock of this machine was set" in e.message for e in _journal(self.store))
        balance.say("clock steps", self.steps, min(steps, self.steps), Counter())
        for name, seen in self.memory.items():
            self._weigh(balance, name, seen)
        return balance

    def _count_scans(self, balance: Balance) -> None:
        """Every tick has a scan, or lies in a gap with a cause; every value has a reading, or a cause."""
        period = 1.0 / (self.rate_hz * self.speed)
        gaps: Counter[str] = Counter()
        empty: Counter[str] = Counter()
        due = there = values = good = 0
        last_s, last_number = None, None
        for scan in _scans(self.store):
            at_s = scan.monotonic_s / self.speed
            there += 1
            if last_number is not None and scan.number != last_number + 1:
                balance.unaccounted["scan numbers"] += 1
            ticks = 1 if last_s is None else max(1, round((at_s - last_s) / period))
            due += ticks
            if ticks > 1:
                cause = self._during(("recorder killed",), last_s or at_s, at_s)
                gaps[cause or NO_FAULT] += ticks - 1
            for quality in scan.qualities:
                values += 1
                if quality.usable:
                    good += 1
                else:
                    known = ("sensor dead",) if quality.value == "open" else ("logger lost", "recorder killed")
                    empty[self._during(known, at_s - 1.0, at_s) or NO_FAULT] += 1
            last_s, last_number = at_s, scan.number
        told = self._missed_by_recorder()
        balance.say("scans", due, there, gaps)
        balance.lines.append(f"{'':18} the recorder itself counted {told} scans left out (since its last start)")
        balance.say("values", values, good, empty)

    def _missed_by_recorder(self) -> int:
        return sum(p["missed_ticks"] for p in self.store.statuses()["record"].status["presses"])

    def _count_pressings(self, balance: Balance) -> None:
        """Every pressing that ended is a run, or a fault lies over it."""
        runs = _runs(self.store)
        zero_s = self.began_s * self.speed
        causes: Counter[str] = Counter()
        closed = 0
        cycles = [c for c in self.press.cycles if c.number <= self.pressings and c.end < self.clock() - 30.0]
        for cycle in cycles:
            begin_s, end_s = cycle.start / self.speed + self.began_s, cycle.end / self.speed + self.began_s
            mine = [
                r
                for r in runs
                if r.zero_monotonic_s < zero_s + cycle.end
                and (r.last_scan is None or r.zero_monotonic_s > zero_s + cycle.start - 20.0)
            ]
            if any(r.status is RunStatus.CLOSED for r in mine):
                closed += 1
                continue
            kinds = ("recorder killed", "logger lost")
            why = self._during(kinds, begin_s, end_s)
            if why is None and not mine:  # until the press has been seen empty, its state is unknown
                why = self._during(kinds, begin_s - LOOK_BACK_S / self.speed, end_s)
            if why is not None:
                causes[("interrupted, " if mine else "no run, ") + why] += 1
        balance.say("pressings", len(cycles), closed, causes)
        left = [r for r in runs if r.status is RunStatus.OPEN]
        balance.unaccounted["runs left open"] = len(left)
        self._count_fits(balance)

    def _count_fits(self, balance: Balance) -> None:
        """Every closed run is fitted, or the journal says why not, or the nightly job will do it."""
        said = [entry.message for entry in _journal(self.store) if "could not be fitted" in entry.message]
        causes: Counter[str] = Counter()
        closed, fitted = _closed(self.store), 0
        for run in closed:
            begin_s = run.zero_monotonic_s / self.speed
            end_s = begin_s + (run.last_scan - run.first_scan + 1) / (self.rate_hz * self.speed) + PATIENCE_S
            if self.store.fit(run.run) is not None:
                fitted += 1
            elif run.moments.closed_s != run.moments.closed_s:
                causes["closing not seen, recorder away"] += 1
            elif any(f"run {run.run} " in message for message in said):
                causes["said in the journal"] += 1
            elif self._during(("sensor process killed",), begin_s, end_s):
                causes["left to the nightly job, sensor process killed"] += 1
        balance.say("fits", len(closed), fitted, causes)

    def _count_estimates(self, balance: Balance) -> None:
        """Every scan of every run has one estimate."""
        due = there = doubled = 0
        for run in _runs(self.store):
            if run.last_scan is None:
                continue
            numbers = [estimate.number for _, estimate in self.store.estimates(run.run)]
            due += run.last_scan - run.first_scan + 1
            there += len(set(numbers))
            doubled += len(numbers) - len(set(numbers))
        balance.say("estimates of runs", due, there, Counter())
        balance.unaccounted["doubled estimates"] = doubled

    def _weigh(self, balance: Balance, name: str, seen: Sequence[tuple[int, float, int]]) -> None:
        """Memory of the longest-lived process after its first fifth, first half against second half."""
        lives = Counter(pid for pid, _, _ in seen)
        pid = lives.most_common(1)[0][0]
        sizes = [size for p, _, size in seen if p == pid]
        sizes = sizes[len(sizes) // 5 :]
        if len(sizes) < 4:
            balance.lines.append(f"{'memory ' + name:18} no process lived long enough to say")
            return
        half = len(sizes) // 2
        first, second = max(sizes[:half]) / 1e6, max(sizes[half:]) / 1e6
        balance.grown_share[name] = second / first - 1.0
        balance.lines.append(
            f"{'memory ' + name:18} {first:.1f} MB, later {second:.1f} MB ({second / first - 1:+.1%})"
        )


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def _scans(store: Store) -> Iterator[Any]:
    last = -1
    while batch := store.scans_after("lab", last, 5000).scans:
        yield from batch
        last = batch[-1].number


def _journal(store: Store) -> list[Any]:
    entries: list[Any] = []
    while more := store.journal_after(entries[-1].number if entries else 0):
        entries += more
    return entries


def _runs(store: Store) -> list[Any]:
    runs: list[Any] = []
    cursor: str | None = None
    while True:
        page = store.runs(limit=500, cursor=cursor)
        runs += page.items
        cursor = page.next_cursor
        if cursor is None:
            return runs[::-1]


def _closed(store: Store) -> list[Any]:
    return [run for run in _runs(store) if run.status is RunStatus.CLOSED]


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
    balance = Endurance(given.folder, given.speed, given.rate, given.seed, given.pressings).run()
    sys.stdout.write("\n".join(balance.lines) + "\n")
    return int(any(balance.unaccounted.values()))


if __name__ == "__main__":
    raise SystemExit(main())
