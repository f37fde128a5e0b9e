"""The balance of an endurance run: what was due, what is in the store, and by which stored cause the rest is not.

The causes come from what the recorder and the live sensor themselves wrote: where scans begin after a start,
which ticks were left out, each value's quality, each run's status and moments, the journal. What was broken on
purpose is only held against them: where values stop without such a fault, a recorder begins that nobody had
killed or ended, or scans stop before it was, the store's word does not count. What neither explains is unaccounted
for.

A scan carries what its loggers answered since the scan before, or once, late, an answer to the tick before; its
stamp lies within a period and a half of its tick, or later where the machine was busy. Which of its answers were
spoiled the simulated device knows: so a value not there is a fault's, if the fault overlaps the time from the
second scan before to the second scan after. A logger that was lost is then still to be found again, connected
and set up: until its first good value its driver may take the time it promises, and no longer.

A good value is held against what the thermocouples truly gave around its scan, and none may come from a logger
that was silent or a sensor that was dead. A late value is believed without a fault only while most of its
channel's values come in time. The press's moments, the state and the core temperature of the estimates are held
against the simulated press; the moments where nobody could see them are left to what hid them.
"""

from __future__ import annotations

import bisect
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from daq.recording.press_line import LEFT_OUT_EVERY_S
from daq.records import Moments, PressEventKind, PressState, Quality
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from daq.store import RunStatus, Store, every
from softsensor.live.validity import InvalidReason
from tests.deploy.truth import KILLED, RESTARTED, STAMP_S, Truth

START = "panel.initial_temperature_C"
BLIND_S = 3.0
"""A face unseen this long, or scans this far apart, can hide a moment of the press. [s of the press]"""
MARGIN_S = 10.0
"""How far from a moment the scans lie that show it. [s of the press]"""
NEIGHBOURS = 2
"""How many scans before and after a value's own may hold its answer's moment."""
SETTLED = 25
"""Scans at each end of a recorder's life whose median tells its schedule."""
EDGE, JITTER_TICKS = 3, 1.5
"""The outermost of these scans, and how far stamps of the same schedule may lie apart."""
MOST_LATE, LATE_OVER = 0.5, 500
"""So often in so many scans a channel may be late; more often only by as many ticks as were left out there."""
OFF_K, OVERSHOOT = 3.0, 0.5
"""How far a good value may lie outside the true ones around its scan: so much, and a share of their range. [K]"""
WAY_S = 0.5
"""How long an answer from before or after a fault may be on its way into a scan. [s]"""
MOMENT_S = 3.0
"""How far a moment of the press may lie from the true one. [s of the press]"""
BAND_K = 25.0
"""A valid core's band is no wider to either side, the live sensor says. [K]"""
CORE_K = 10.0
"""How far outside its own band an estimate may lie: the start temperature is read from sensors in the air. [K]"""
MOST_GROWN = 0.2
"""Memory that grows by more than this share is not flat."""
AWAY = "recorder away"
NO_FIT = ("could not be fitted", "has no panel sensors")
"""What the journal says of a run that has no fit."""


@dataclass
class Balance:
    """What was due, what is there, and where the rest went."""

    lines: list[str] = field(default_factory=list)
    unaccounted: Counter[str] = field(default_factory=Counter)
    grown_share: dict[str, float] = field(default_factory=dict)

    @property
    def sound(self) -> bool:
        """Whether nothing is unaccounted for, and memory was seen long enough to be called flat."""
        flat = [self.grown_share.get(name, np.inf) < MOST_GROWN for name in ("record", "sense")]
        return all(flat) and not any(self.unaccounted.values())

    def say(self, what: str, due: int, there: int, causes: Mapping[str, int], where: Sequence[Any] = ()) -> None:
        """Add a line: due = there + by cause + unaccounted; `where` names the first places of the latter."""
        rest = due - there - sum(causes.values())
        self.unaccounted[what] = rest
        named = "".join(f", {cause} {count}" for cause, count in sorted(causes.items()))
        at = f" ({'; '.join(str(x) for x in where[:6])})" if rest and where else ""
        self.lines.append(f"{what:18} due {due}, there {there}{named}, unaccounted {rest}{at}")

    def weigh(self, name: str, sizes: Sequence[tuple[int, float, int]], plant_s: Callable[[float], float]) -> None:
        """Add a line on the memory of the longest-lived process: after its first fifth, first half against second.

        Parameters
        ----------
        sizes
            Process id, machine's monotonic time [s], resident memory [bytes], as they were seen.
        plant_s
            The plant's clock at a moment of the machine's.
        """
        pid = Counter(pid for pid, _, _ in sizes).most_common(1)[0][0]
        lived = [(at_s, size) for p, at_s, size in sizes if p == pid]
        later = [size for _, size in lived[len(lived) // 5 :]]
        if len(later) < 4:
            self.lines.append(f"{'memory ' + name:18} no process lived long enough to say")
            return
        first, second = max(later[: len(later) // 2]) / 1e6, max(later[len(later) // 2 :]) / 1e6
        self.grown_share[name] = second / first - 1.0
        minutes = (lived[-1][0] - lived[0][0]) / 60.0
        self.lines.append(
            f"{'memory ' + name:18} {first:.1f} MB, later {second:.1f} MB ({second / first - 1:+.1%}), "
            f"one process over {minutes:.0f} min, {(plant_s(lived[-1][0]) - plant_s(lived[0][0])) / 3600.0:.1f} h "
            "of the press"
        )


@dataclass(frozen=True)
class _Scans:
    """All scans of the press, as arrays, cut where a recorder began."""

    numbers: Any
    stamps: Any
    """As stored: monotonic times the speed of its recorder. [s]"""
    real_s: Any
    """On the machine's monotonic clock. [s]"""
    times: Any
    """On the plant's clock. [s]"""
    periods: Any
    """From tick to tick. [s of the press]"""
    ticks_s: Any
    """From tick to tick, on the machine's clock. [s]"""
    qualities: list[tuple[Quality, ...]]
    values: Any
    """As stored, a row each scan. [°C]"""
    good: Any
    """Whether a value says to be."""
    left_out: Any
    """Ticks journalled as left out before each."""
    columns: tuple[str, ...]
    begins: Any
    """Index of each recorder's first scan."""

    @property
    def sessions(self) -> list[slice]:
        ends = [*self.begins[1:], len(self.times)]
        return [slice(int(a), int(b)) for a, b in zip(self.begins, ends, strict=True)]


def take_balance(store: Store, truth: Truth) -> Balance:
    """Count everything."""
    return _Count(store, truth).balance


class _Count:
    def __init__(self, store: Store, truth: Truth) -> None:
        self.store, self.truth, self.balance = store, truth, Balance()
        self.journal = _journal(store)
        self.runs = _runs(store)
        self.scans = self._load()
        self.blind = list(self._blind())
        self.changes = list(_changes(truth.pressings.values()))
        self._count_scans()
        self._count_values()
        low, high, self.true_core = self._true()
        self._count_readings(low, high)
        self._count_pressings()
        self._count_runs()
        self._count_moments()
        self._count_fits()
        self._count_estimates()
        self._count_cores()
        steps = sum("clock of this machine was set" in str(e.message) for e in self.journal)
        self.balance.say("clock steps", truth.clock_steps, steps, {})

    def _load(self) -> _Scans:
        left_out = {at: count for e in self.journal if "left out" in str(e.message) for at, count in _pairs(e)}
        begun = {e.detail["monotonic_s"] for e in self.journal if "scans begin" in str(e.message)}
        numbers, stamps, qualities, values, good = [], [], [], [], []
        for scan in _scans(self.store, self.truth.press):
            numbers.append(scan.number)
            stamps.append(scan.monotonic_s)
            qualities.append(scan.qualities)
            values.append(np.array(scan.values, np.float32))
            good.append([quality.usable for quality in scan.qualities])
        begins = [i for i, at in enumerate(stamps) if i == 0 or at in begun]
        columns = tuple(c.name for c in self.store.channels(self.truth.press))
        which = self._shifts_of(numbers)
        speeds = np.array([shift.speed for shift in self.truth.shifts])[which]
        real_s = np.array(stamps) / speeds
        times = np.array([self.truth.plant_s(at) for at in real_s.tolist()])
        periods = np.array([1.0 / shift.rate_hz for shift in self.truth.shifts])[which]
        numbers, stamps, begins = np.array(numbers), np.array(stamps), np.array(begins)
        return _Scans(
            numbers,
            stamps,
            real_s,
            times,
            periods,
            periods / speeds,
            qualities,
            np.array(values),
            np.array(good),
            np.array([left_out.get(at, 0) for at in stamps.tolist()]),
            columns,
            begins,
        )

    def _shifts_of(self, numbers: Sequence[int]) -> Any:
        firsts = [shift.first_scan for shift in self.truth.shifts]
        return np.searchsorted(firsts, numbers, side="right") - 1

    def _plant_s(self, stamp_s: float, scan_number: int) -> float:
        """Return a stored time near a scan on the plant's clock. [s]"""
        shift = self.truth.shifts[int(self._shifts_of([scan_number])[0])]
        return self.truth.plant_s(stamp_s / shift.speed)

    # --- scans and values ---------------------------------------------------------------------------

    def _count_scans(self) -> None:
        """Every tick of the schedule has its scan, or was journalled as left out, or no recorder was there."""
        causes: Counter[str] = Counter()
        scans, silent, where = self.scans, 0, []
        for number, session in enumerate(scans.sessions):
            times, period_s = scans.stamps[session], scans.periods[session][0]
            left_out = np.cumsum(scans.left_out[session])
            ahead = (times - times[0]) / period_s - np.arange(len(times)) - left_out
            lost = _grown(ahead)
            causes["left out, as journalled"] += int(left_out[-1])
            if number + 1 < len(scans.sessions) and self._ending(session.stop - 1) == KILLED:
                early = _grown(ahead[times < times[-1] - LEFT_OUT_EVERY_S])
                causes["left out in the minute before a kill, not journalled any more"] += lost - early
                lost = early
            silent += lost
            where += [f"{lost} in the session from {times[0]:.1f} s"] if lost else []
        for i in scans.begins[1:].tolist():
            ticks = round((scans.times[i] - scans.times[i - 1]) / scans.periods[i]) - 1
            last_s, next_s = float(scans.real_s[i - 1]), float(scans.real_s[i])
            end, until_s = self.truth.wrote_until(last_s, next_s) or ("", next_s)
            lost = ticks if not end else self._unwritten(i - 1, until_s)
            causes[f"{end}, away until it began anew"] += ticks - lost
            silent += lost
            where += [f"{lost} from {last_s:.1f} s on, before the recorder went"] if lost else []
        if lost := self._unwritten(-1, self.truth.ended_s - STAMP_S):
            silent += lost
            where.append(f"{lost} from {scans.real_s[-1]:.1f} s to the end")
        there = len(scans.times)
        self.balance.say("scans", there + sum(causes.values()) + silent, there, +causes, where)
        self.balance.unaccounted["scan numbers"] = int((np.diff(scans.numbers) != 1).sum())
        kills = sum(f.kind in (KILLED, RESTARTED) for f in self.truth.faults)
        self.balance.say("recorder starts", kills + 1, len(scans.sessions), {})

    def _ending(self, i: int) -> str | None:
        """Return how the recorder ended after a scan."""
        end = self.truth.wrote_until(float(self.scans.real_s[i]), float(self.scans.real_s[i + 1]))
        return end[0] if end else None

    def _unwritten(self, i: int, until_s: float) -> int:
        """Return how many ticks there were from a scan to a moment of the machine's clock."""
        return max(0, int((until_s - self.scans.real_s[i]) / self.scans.ticks_s[i]))

    def _count_values(self) -> None:
        """Every value is good, or its quality fits a fault that lies over it, or it is late now and then."""
        causes: Counter[str] = Counter()
        good, where = 0, []
        due = 0
        late = np.zeros_like(self.scans.good)
        real_s = self.scans.real_s.tolist()
        good_s: dict[str, float] = {}
        for i, qualities in enumerate(self.scans.qualities):
            due += len(qualities)
            for k, (column, quality) in enumerate(zip(self.scans.columns, qualities, strict=True)):
                if quality.usable:
                    good += 1
                    good_s[column] = real_s[i]
                elif (kind := self._fault_of(quality, column, i, real_s)) is not None:
                    causes[f"{quality.value}, {kind}"] += 1
                elif self.truth.finding_again(column, real_s[i], good_s.get(column, -np.inf)):
                    causes[f"{quality.value}, logger not found again yet"] += 1
                elif quality is Quality.LATE:
                    late[i, k] = True
                else:
                    where.append(f"{column} {quality.value} at {real_s[i]:.3f} s")
        worst = 0.0
        for part in itertools.chain.from_iterable(_parts(session) for session in self.scans.sessions):
            worst = max(worst, late[part].mean(axis=0).max())
            few = max(MOST_LATE * len(part), SETTLED)  # a recorder ended at once may have seen late answers alone
            believed = late[part].sum(axis=0) <= few + self.scans.left_out[part].sum()
            causes["late, machine busy"] += int(late[part][:, believed].sum())
            names = np.array(self.scans.columns)[~believed]
            where += [f"{name} mostly late from {real_s[part[0]]:.3f} s on" for name in names]
        self.balance.say("values", due, good, +causes, sorted(set(where)))
        self.balance.lines.append(
            f"{'late':18} without a fault {late.sum() / max(due, 1):.1%} of all values, "
            f"at most {worst:.0%} of a channel's in {LATE_OVER} scans"
        )

    def _true(self) -> tuple[Any, Any, Any]:
        """Return between what a scan's thermocouples were around its moment, and the core then. [°C]"""
        scans = self.scans
        true, core = np.empty_like(scans.values), np.empty(len(scans.times))
        halfway = np.empty_like(true)  # from the scan before
        before_s = float(scans.times[0])
        for i, at_s in enumerate(scans.times.tolist()):
            for kept, asked_s in ((halfway, 0.5 * (before_s + at_s)), (true, at_s)):
                gave = self.truth.temperatures(asked_s)
                kept[i] = [gave[name] for name in scans.columns]
            core[i] = self.truth.core(at_s)
            before_s = at_s
        low, high = np.minimum(true, halfway), np.maximum(true, halfway)
        for bound, of in ((low, np.minimum), (high, np.maximum)):
            own = bound.copy()
            for k in range(1, NEIGHBOURS + 1):
                bound[k:] = of(bound[k:], own[:-k])
                bound[:-k] = of(bound[:-k], own[k:])
        return low, high, core

    def _count_readings(self, low: Any, high: Any) -> None:
        """Every good value is near what its thermocouple gave, and its logger was there to answer."""
        scans = self.scans
        spare = OFF_K + OVERSHOOT * (high - low)
        right = (scans.values >= low - spare) & (scans.values <= high + spare)
        for fault in self.truth.faults:
            first, last = np.searchsorted(scans.real_s, (fault.begin_s + WAY_S, fault.end_s - WAY_S))
            right[first:last, [name in fault.columns for name in scans.columns]] = False
        where = [
            f"{scans.columns[k]} {scans.values[i, k]:.1f} for {low[i, k]:.1f} to {high[i, k]:.1f} °C "
            f"at {scans.real_s[i]:.3f} s"
            for i, k in np.argwhere(scans.good & ~right)[:6]
        ]
        self.balance.say("good values right", int(scans.good.sum()), int((scans.good & right).sum()), {}, where)

    def _fault_of(self, quality: Quality, column: str, i: int, real_s: Sequence[float]) -> str | None:
        # an ADAM in ASCII shows an open input as -0000, under range
        kind = "sensor dead" if quality in (Quality.OPEN, Quality.UNDER) else "logger lost"
        begin_s = real_s[max(i - NEIGHBOURS, 0)]
        end_s = real_s[min(i + NEIGHBOURS, len(real_s) - 1)]
        return kind if self.truth.during(kind, begin_s, end_s, column) else None

    # --- pressings, runs ------------------------------------------------------------------------------

    def _blind(self) -> Iterator[tuple[float, float, str]]:
        """Yield the stretches in which, by the stored scans, a moment of the press could not be seen."""
        scans = self.scans
        first = set(scans.begins.tolist())
        for i, (before, after) in enumerate(pairwise(scans.times.tolist()), 1):
            if i in first:
                yield before, after, AWAY
            elif after - before > max(BLIND_S, 1.5 * scans.periods[i]):
                yield before, after, "scans left out"
        for face in ("platen", "top", "bottom"):
            places = [i for i, name in enumerate(scans.columns) if name.startswith(face)]
            since, why = None, ""
            for at, qualities in zip(scans.times.tolist(), scans.qualities, strict=True):
                if any(qualities[i].usable for i in places):
                    if since is not None and at - since > BLIND_S:
                        yield since, at, f"{face} sensors {why}"
                    since, why = at, ""
                else:
                    why = qualities[places[0]].value

    def _blind_over(self, begin_s: float, end_s: float) -> str | None:
        found = [cause for a, b, cause in self.blind if a <= end_s and begin_s <= b]
        return min(found, key=lambda cause: cause != AWAY) if found else None

    def _apart(self, at_s: float) -> float:
        """Return by how much more than their period scans around a moment lie apart on a busy machine. [s]"""
        scans = self.scans
        first, last = np.searchsorted(scans.times, (at_s - MARGIN_S, at_s + MARGIN_S))
        surplus = np.diff(scans.times[first:last]) - np.asarray(scans.periods)[first + 1 : last]
        return float(surplus.max(initial=0.0))

    def _span(self, run: Any) -> tuple[float, float]:
        """Return the times of a run's first and last scan. [s]"""
        first = self.scans.numbers[0]
        times = self.scans.times
        last = len(times) - 1 if run.last_scan is None else int(run.last_scan - first)
        return float(times[int(run.first_scan - first)]), float(times[last])

    def _run_over(self, begin_s: float, end_s: float) -> list[Any]:
        return [r for r in self.runs if (span := self._span(r))[0] <= end_s and begin_s <= span[1]]

    def _count_pressings(self) -> None:
        """Every pressing is a finished run, or the store shows why not: nobody saw its insertion or closing."""
        causes: Counter[str] = Counter()
        closed, where = 0, []
        for number, true in self.truth.pressings.items():
            mine = self._run_over(true.closed_s, true.opened_s)
            if any(r.status is RunStatus.CLOSED for r in mine):
                closed += 1
            elif mine and (why := self._blind_over(true.inserted_s - MARGIN_S, true.removed_s + MARGIN_S)):
                causes[f"interrupted, {why}"] += 1
            elif not mine and (why := self._blind_over(true.inserted_s - MARGIN_S, true.closed_s + MARGIN_S)):
                causes[f"no run, {why} over insertion or closing"] += 1
            else:
                where.append(f"pressing {number} closing at {true.closed_s:.1f} s")
        self.balance.say("pressings", len(self.truth.pressings), closed, causes, where)

    def _count_runs(self) -> None:
        """Every run holds one pressing, or the store shows why it holds none or two."""
        causes: Counter[str] = Counter()
        single, where = 0, []
        runs = self._runs_due()
        for run in runs:
            begin_s, end_s = self._span(run)
            held = len(self._held(run))
            if held == 1 and run.status is not RunStatus.OPEN:
                single += 1
            elif run.status is not RunStatus.OPEN and (
                why := self._blind_over(begin_s - MARGIN_S, end_s + MARGIN_S)
            ):
                causes[f"{held} pressings in it, {why}"] += 1
            else:
                where.append(f"{run.run} {run.status.value}, {held} pressings")
        self.balance.say("runs", len(runs), single, causes, where)

    def _runs_due(self) -> list[Any]:
        """Return the runs that begin before the last pressing of all was over."""
        last_s = max((true.removed_s for true in self.truth.pressings.values()), default=0.0)
        return [r for r in self.runs if self._span(r)[0] < last_s]

    def _held(self, run: Any) -> list[Moments]:
        """Return the pressings a run lies over."""
        begin_s, end_s = self._span(run)
        return [t for t in self.truth.pressings.values() if t.closed_s <= end_s and begin_s <= t.opened_s]

    def _count_moments(self) -> None:
        """Every pressing has its four events, every run of one pressing its four moments, at the true times."""
        found: dict[str, list[float]] = {kind: [] for kind in PressEventKind}
        for event in _events(self.store, self.truth.press):
            found[event.kind].append(self._plant_s(event.monotonic_s, event.scan_number))
        pressings = list(self.truth.pressings.values())
        matched = self._say_moments("press events", [(true, found) for true in pressings])
        last_s = max((true.removed_s for true in pressings), default=0.0) + MOMENT_S
        strange = [
            f"{kind} at {at_s:.1f} s"
            for kind, times in found.items()
            for at_s in times
            if at_s < last_s and (kind, at_s) not in matched
            if not self._blind_over(at_s - MARGIN_S, at_s + MARGIN_S)
        ]
        self.balance.unaccounted["press events of no pressing"] = len(strange)
        if strange:
            self.balance.lines.append(f"{'':18} of no pressing {len(strange)} ({'; '.join(strange[:6])})")
        due = []
        for run in self._runs_due():
            held = self._held(run)
            if len(held) == 1:
                own = {kind: run.zero_monotonic_s + at_s for kind, at_s in _moments(run.moments)}
                due.append((held[0], {kind: [self._plant_s(at_s, run.first_scan)] for kind, at_s in own.items()}))
        self._say_moments("moments of runs", due)

    def _say_moments(
        self, what: str, due: Sequence[tuple[Moments, Mapping[str, Sequence[float]]]]
    ) -> set[tuple[str, float]]:
        """Hold true moments against those found of their kind, and return which of these are right.

        What hid a pressing's moment explains that its later ones were not looked for either.
        """
        causes: Counter[str] = Counter()
        where, matched = [], set()
        for true, found in due:
            hidden = None
            for kind, true_s in _moments(true):
                hidden = self._blind_over(true_s - MARGIN_S, true_s + MARGIN_S) or hidden
                at_s = min(found[kind], key=lambda at_s, true_s=true_s: abs(at_s - true_s), default=np.nan)
                if abs(at_s - true_s) <= MOMENT_S + self._apart(true_s):
                    matched.add((kind, at_s))
                    hidden = None
                elif hidden:
                    causes[f"not seen, {hidden}"] += 1
                else:
                    where.append(f"{kind.value} {true_s:.1f} s, found {at_s:.1f} s")
        all_due = 4 * len(due)
        self.balance.say(what, all_due, all_due - len(where) - sum(causes.values()), causes, where)
        return matched

    # --- what the live sensor made of them --------------------------------------------------------------

    def _count_fits(self) -> None:
        """Every run that ended has a fit of the whole, or its record or the journal says why not."""
        text = " ".join(str(e.message) for e in self.journal)
        causes: Counter[str] = Counter()
        fitted, where = 0, []
        ended = [r for r in self.runs if r.status is not RunStatus.OPEN]
        kept: Counter[str] = Counter(
            row.run
            for row in every(lambda cursor: self.store.coefficient_history(cursor=cursor))
            if row.name in BASE_COEFFICIENTS and np.isfinite(row.value)
        )
        whole: list[str] = []
        for run in ended:
            if _whole(self.store.fit(run.run) or {}):
                fitted += 1
                whole.append(run.run)
            elif run.moments.closed_s != run.moments.closed_s:
                causes["closing not seen, as stored"] += 1
            elif any(f"run {run.run} {why}" in text for why in NO_FIT):
                causes["not possible, as journalled"] += 1
            else:
                where.append(f"{run.run} {run.status.value}")
        self.balance.say("fits", len(ended), fitted, causes, where)
        each = len(BASE_COEFFICIENTS)
        where = [f"{run} {kept[run]}" for run in whole if kept[run] != each]
        self.balance.say("coefficients", each * fitted, sum(min(kept[run], each) for run in whole), {}, where)

    def _count_estimates(self) -> None:
        """Every scan of every run has one estimate."""
        due = there = doubled = 0
        where = []
        for run in self.runs:
            if run.last_scan is None:
                continue
            numbers = [estimate.number for _, estimate in self.store.estimates(run.run)]
            scans = run.last_scan - run.first_scan + 1
            due += scans
            there += len(set(numbers))
            doubled += len(numbers) - len(set(numbers))
            where += [f"{run.run} {len(numbers)} of {scans}"] if len(set(numbers)) != scans else []
        self.balance.say("estimates of runs", due, there, {}, where)
        self.balance.unaccounted["doubled estimates"] = doubled

    def _count_cores(self) -> None:
        """Every estimate tells the true state, and a core near the true one or why it has none."""
        causes: Counter[str] = Counter()
        due = right = 0
        where = []
        for run in self._runs_due():
            held = len(self._held(run))
            for time_s, estimate in self.store.estimates(run.run):
                due += 1
                why = self._judged(estimate, run)
                if why is None and held != 1:
                    causes[f"wrong, {held} pressings in the run"] += 1
                elif why is None:
                    core = f"{estimate.core_celsius:.1f} °C {estimate.reason}"
                    where.append(f"{run.run} {time_s:.1f} s {estimate.state} {core}")
                elif why:
                    causes[why] += 1
                else:
                    right += 1
        self.balance.say("estimates right", due, right, causes, where)

    def _judged(self, estimate: Any, run: Any) -> str | None:
        """Return why an estimate has no core, empty where its core is right, None where it is neither."""
        if estimate.reason == InvalidReason.RUN_REFUSED:
            return self._start_unknown(run)
        i = int(estimate.number - self.scans.numbers[0])
        begin_s, end_s = float(self.scans.times[i]) - MARGIN_S, float(self.scans.times[i]) + MARGIN_S
        true = self.true_core[i]
        states: set[str] = set(self._states(begin_s, end_s))
        if not all(quality.usable for quality in self.scans.qualities[i]):
            states.add("unknown")
        if estimate.state not in states and not self._blind_over(begin_s, end_s):
            return None
        if not estimate.valid:
            return re.split(r"[:\d]", estimate.reason)[0].strip() or None
        if np.isnan(true):
            return "" if np.isfinite(estimate.core_celsius) else None
        core, low, high = estimate.core_celsius, estimate.core_low_celsius, estimate.core_high_celsius
        near = max(low, core - BAND_K) - CORE_K <= true <= min(high, core + BAND_K) + CORE_K
        return "" if near and low <= core <= high else None

    def _start_unknown(self, run: Any) -> str | None:
        """Return what kept a run's start temperature from the recorder, None where nothing did."""
        begin_s, _ = self._span(run)
        why = self._blind_over(begin_s - MARGIN_S, begin_s + MARGIN_S)
        return f"start temperature not known, {why}" if why and START not in run.header else None

    def _states(self, begin_s: float, end_s: float) -> set[PressState]:
        """Return what the press truly did in a stretch of time."""
        first, end = (bisect.bisect(self.changes, at_s, key=lambda change: change[0]) for at_s in (begin_s, end_s))
        return {state for _, state in self.changes[first - 1 : end]}


def _grown(ahead: Any) -> int:
    """Return how many ticks were lost over scans that are so many ticks ahead of their count."""
    if not len(ahead):
        return 0
    first, last = np.median(ahead[:SETTLED]), np.median(ahead[-SETTLED:])
    edges = first - np.median(ahead[:EDGE]), np.median(ahead[-EDGE:]) - last
    return round(float(last - first + sum(lost for lost in edges if lost > JITTER_TICKS)))


def _parts(session: slice) -> list[Any]:
    """Return the places of a recorder's scans, in parts of at most `LATE_OVER`."""
    places = np.arange(session.start, session.stop)
    return np.array_split(places, -(-len(places) // LATE_OVER))


def _whole(fit: Mapping[str, Any]) -> bool:
    """Whether a stored fit is that of the whole run, with all that it found."""
    rest_K = fit.get("rmse_K")
    named = fit.get("coefficients", {}).keys() >= BASE_COEFFICIENTS.keys()
    return "fingerprint" in fit and named and rest_K is not None


def _moments(of: Moments) -> list[tuple[PressEventKind, float]]:
    return [(kind, getattr(of, f"{kind.value}_s")) for kind in PressEventKind]


def _changes(pressings: Iterable[Moments]) -> Iterator[tuple[float, PressState]]:
    """Yield from when on the press truly was in which state. [s of the press]"""
    yield -np.inf, PressState.IDLE
    for true in pressings:
        yield true.inserted_s, PressState.OPEN
        yield true.closed_s, PressState.CLOSED
        yield true.opened_s, PressState.OPEN
        yield true.removed_s, PressState.IDLE


def _events(store: Store, press: str) -> list[Any]:
    events: list[Any] = []
    while more := store.press_events(press, events[-1].number if events else 0):
        events += more
    return events


def _pairs(entry: Any) -> list[tuple[float, int]]:
    return [(float(at), int(count)) for at, count in entry.detail["before_monotonic_s"]]


def _scans(store: Store, press: str) -> Iterator[Any]:
    last = -1
    while batch := store.scans_after(press, last, 5000).scans:
        yield from batch
        last = batch[-1].number


def _journal(store: Store) -> list[Any]:
    entries: list[Any] = []
    while more := store.journal_after(entries[-1].number if entries else 0):
        entries += more
    return entries


def _runs(store: Store) -> list[Any]:
    return list(every(lambda cursor: store.runs(limit=500, cursor=cursor)))[::-1]
