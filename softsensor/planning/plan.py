"""The next pressings worth most: settings within the user's ranges, and what each would settle.

Settings are found by coordinate exchange (Meyer, Nachtsheim, Technometrics 37:60, 1995): from the settings within
the ranges that are nearest to the usual ones, one factor after the other goes to the end of its range that is
worth most, until a round changes nothing. Ends only: what a factor does to the readings grows with its distance
from the usual in all that was tried here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.printed import on_screen
from daq.records import InputError, Run
from softsensor.diagnosis.decision import Verdict
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.settling import SettledModel
from softsensor.planning.design_point import DesignPoint, design_point_of, planned_digest, with_core
from softsensor.planning.open_points import OpenPoint, Prospect, contested, open_causes, open_numbers
from softsensor.planning.program import Ranges, Settings, default_ranges, designed_run, settings_of
from softsensor.signals.digest import Digest
from softsensor.signals.moments import moments_seen

ROUNDS = 2
"""Rounds of the exchange; a third changed nothing on the campaigns of `tests/softsensor/test_planning.py`."""
LEAST_GAIN = 1.05
"""A factor is moved only if that is worth so much more: what changes nothing stays as it is. Set by hand."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class PlannedPressing:
    """One kind of pressing, and what it would bring to one open point."""

    settings: Settings
    """What is set, by name, units at the names' ends."""
    core: bool
    """Whether a thermocouple is buried in the core of a sacrificial panel."""
    changed: tuple[str, ...]
    """Factors that differ from the usual ones."""
    prospect: Prospect
    """What it would bring."""

    __repr__ = on_screen

    def as_json(self) -> dict[str, Any]:
        """Return the pressing's entry."""
        p = self.prospect
        return {
            "settings": {name: round(value, 4) for name, value in self.settings.items()},
            "changed": list(self.changed),
            "core_thermocouple": self.core,
            "worth": _rounded(p.worth),
            "chance": _rounded(p.chance),
            "runs": p.runs,
            "half_interval": _rounded(p.half_after),
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


@dataclass(frozen=True)
class PointAdvice:
    """One open point and the pressings for it."""

    point: OpenPoint
    """A set of causes not told apart, a suspected one, a coefficient or the core, and how well it is known."""
    repeated: PlannedPressing
    """The usual settings once more."""
    best: PlannedPressing
    """Within the ranges, the sensors as they are."""
    with_core: PlannedPressing | None
    """The best settings, or those nearest to the usual ones, with a thermocouple in the core besides; None without
    a panel."""

    __repr__ = on_screen

    def as_json(self) -> dict[str, Any]:
        """Return the point's entry."""
        return {
            "kind": self.point.kind.value,
            "name": self.point.name,
            "causes": list(self.point.names) if self.point.along is None else [],
            "suspected": self.point.suspected,
            "half_interval": _rounded(self.point.half_now),
            "half_interval_wanted": self.point.wanted or None,
            "best": self.best.as_json(),
            "with_core": None if self.with_core is None else self.with_core.as_json(),
            "repeated": self.repeated.as_json(),
        }


@dataclass(frozen=True)
class PressingPlan:
    """What the runs leave open and the next pressings worth most, most open first."""

    runs: int
    """How many it rests on."""
    verdict: str
    """Of their diagnosis."""
    usual: Settings
    """Of the run nearest to the middle, by name."""
    ranges: Ranges
    """What can be set, from and to, by name."""
    points: tuple[PointAdvice, ...]
    """What is open, and the pressings for it."""

    __repr__ = on_screen

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``plan --json``."""
        return {
            "runs": self.runs,
            "verdict": self.verdict,
            "usual": {name: round(value, 4) for name, value in self.usual.items()},
            "ranges": {name: [round(low, 4), round(high, 4)] for name, (low, high) in self.ranges.items()},
            "open": [advice.as_json() for advice in self.points],
        }


@dataclass
class _WorkedOut:
    """Pressings worked out once, by their settings."""

    press: Press
    stage: SettledModel
    like: Digest
    usual: Settings
    nearest: Settings
    """To the usual ones, within the ranges."""
    constants: tuple[str, ...]
    known: dict[tuple[tuple[tuple[str, float], ...], bool], DesignPoint | None] = field(default_factory=dict)

    def design(self, settings: Settings, core: bool) -> DesignPoint | None:
        """Return a pressing as a point of the design, None where the press cannot do it."""
        key = (tuple(sorted(settings.items())), core)
        if key not in self.known:
            try:
                self.known[key] = self._made(settings, core)
            except InputError:
                self.known[key] = None
        return self.known[key]

    def _made(self, settings: Settings, core: bool) -> DesignPoint:
        run, moments = designed_run(self.like.run, self.press, self.like.moments, settings)
        press = with_core(self.press, settings["thickness_mm"]) if core else self.press
        digest = planned_digest(press, run, moments, self.like)
        return design_point_of(press, digest, self.stage.fit)

    def pressing(self, point: OpenPoint, settings: Settings, core: bool = False) -> PlannedPressing | None:
        """Return what some settings would bring to an open point."""
        design = self.design(settings, core)
        if design is None:
            return None
        changed = tuple(name for name, value in settings.items() if value != self.usual[name])
        return PlannedPressing(dict(settings), core, changed, point.prospect(design, self.constants))


def plan(
    press: Press,
    found: Diagnosis,
    ranges: Ranges = MappingProxyType({}),
    progress: Progress | None = None,
    *,
    causes_alone: bool = False,
) -> PressingPlan:
    """Return the next pressings worth most after a diagnosis.

    What a pressing would bring is forecast by the campaign's model, so a campaign that it does not describe has
    no point open to a pressing.

    Parameters
    ----------
    found
        The diagnosis of the runs.
    ranges
        By factor what the user can set (`program.FACTORS`); the runs' own, modestly widened, where not given.
    progress
        Called with what is being done and the share done.
    causes_alone
        Leave out numbers known less well than wanted.

    Raises
    ------
    InputError
        For a range of something these runs do not set, or beyond its limits.
    """
    report = progress or (lambda what, share: None)
    stage = found.stages[0]
    digests = [d.digest for d in stage.data]
    settings = [settings_of(d.run, press, d.moments) for d in digests]
    allowed = default_ranges(settings, ranges)
    report("runs so far", 0.0)
    described = found.verdict is not Verdict.NOT_DESCRIBED
    idle = not described or (causes_alone and not contested(found))
    past = [] if idle else [design_point_of(press, d, stage.fit) for d in digests]
    constants = tuple(dict.fromkeys(key for design in past for key in design.shared))
    points = [] if idle else open_causes(found, past, constants)
    if described and not causes_alone:
        points += open_numbers(found.final, past, constants)
    middle = _middle(settings)
    usual = {name: round(settings[middle][name], 1) for name in allowed if name in settings[middle]}
    nearest = usual | {n: min(max(usual[n], low), high) for n, (low, high) in ranges.items() if n in usual}
    bench = _WorkedOut(press, stage, digests[middle], usual, nearest, constants)
    advised = []
    for i, point in enumerate(points):
        report(point.name, (i + 1) / (len(points) + 1))
        if (advice := _advice(bench, point, allowed)) is not None:
            advised.append(advice)
    return PressingPlan(len(digests), found.verdict.value, usual, allowed, tuple(advised))


def ranges_of(
    press: Press, runs: Iterable[Run], given: Ranges = MappingProxyType({})
) -> dict[str, tuple[float, float]]:
    """Return the ranges that a plan for some runs would keep to. Raises InputError as `plan` does."""
    return default_ranges([settings_of(run, press, moments_seen(run, press)) for run in runs], given)


def _middle(settings: Sequence[Settings]) -> int:
    """Return which of the runs that state most settings lies nearest to the middle of all, in shares of it."""

    def off(one: Settings) -> float:
        return sum(abs(one[n] - m) / max(abs(m), 1e-9) for n, m in middle.items() if n in one)

    names = dict.fromkeys(n for s in settings for n in s)
    middle = {n: float(np.median([s[n] for s in settings if n in s])) for n in names}
    return min(range(len(settings)), key=lambda i: (-len(settings[i]), off(settings[i])))


def _advice(bench: _WorkedOut, point: OpenPoint, ranges: Ranges) -> PointAdvice | None:
    repeated, best = (bench.pressing(point, settings) for settings in (bench.usual, bench.nearest))
    if repeated is None or best is None:
        return None
    for _ in range(ROUNDS):
        before = best
        for name in bench.usual:
            best = _best_level(bench, point, best, name, ranges[name])
        if best is before:
            break
    return PointAdvice(point, repeated, best, _with_core(bench, point, best))


def _with_core(bench: _WorkedOut, point: OpenPoint, best: PlannedPressing) -> PlannedPressing | None:
    """Return the best settings or those nearest to the usual, whichever is worth more with a core thermocouple."""
    if not bench.press.panel_layers:
        return None
    both = [bench.pressing(point, settings, core=True) for settings in (best.settings, bench.nearest)]
    return max((p for p in both if p is not None), key=lambda p: p.prospect.worth, default=None)


def _best_level(
    bench: _WorkedOut, point: OpenPoint, best: PlannedPressing, name: str, ends: tuple[float, float]
) -> PlannedPressing:
    for level in {*ends, bench.nearest[name]} - {best.settings[name]}:
        other = bench.pressing(point, {**best.settings, name: level})
        if other is not None and other.prospect.worth > LEAST_GAIN * best.prospect.worth:
            best = other
    return best
