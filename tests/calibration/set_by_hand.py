"""What depends on the numbers that were set by hand: ``python -m tests.calibration.set_by_hand WORK [ROOM ...]``.

Each number that stands under the remark "set by hand" in a module of the rooms is taken half as large again and a
third smaller, and the work is done anew: a fit or the live core of sample run 7, or the diagnosis of all ten.
That takes some 6, 5 and 45 minutes of processor time; rooms named behind it take less.

Printed is how far the answer moves, in units of what it claims to know itself, largest first. A number that moves
nothing may be anything within these limits; one that moves an answer by more than a standard deviation deserves a
calibration of its own.

Numbers that are compiled in (``*_steps.py``, ``*_terms.py``) are left out. What became part of another number when
its module was loaded, or is the default of an argument, does not follow.
"""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import daq
import softsensor
from tests.numbers import numbers_of

ROOT = Path(__file__).parents[2]
FACTORS = (1.5, 1.0 / 1.5)
SAMPLES = daq.shared_files() / "samples"
PRESS = softsensor.read_press(daq.shared_files() / "presses/lab.toml")
RUNS = [softsensor.read_run(SAMPLES / f"2026-03-04-{n:02d}.csv") for n in range(1, 11)]
ROOMS = {
    "fit": ("softsensor/fitting", "softsensor/heat", "softsensor/signals", "daq/press"),
    "live": ("softsensor/live", "softsensor/heat", "softsensor/signals", "daq/press"),
    "diagnosis": ("softsensor/diagnosis", "softsensor/signals"),
}


def fit_answer() -> dict[str, Any]:
    """Return logarithms of what the runs know, with standard deviations, and what they do not know."""
    found: dict[str, Any] = {}
    for run in (RUNS[6],):
        for name, c in softsensor.fit(run, PRESS).campaign.runs[0].coefficients.items():
            known = c.identifiable
            found[f"{run.name} {name}"] = (math.log(c.value), c.sd / c.value) if known else str(c.verdict)
    return found


def live_answer() -> dict[str, Any]:
    """Return the core of one run, scan by scan, with its standard deviation, or why there is none."""
    frame = softsensor.predict(RUNS[6], PRESS).frame()
    rows = zip(frame["core_C"], frame["core_sd_K"], frame["valid"], frame["reason"], strict=True)
    return {f"scan {i}": (core, sd) if valid else reason for i, (core, sd, valid, reason) in enumerate(rows)}


def diagnosis_answer() -> dict[str, Any]:
    """Return verdict and names, and the parameters named or suspected with their standard deviations."""
    content = softsensor.diagnose(RUNS, PRESS).content
    found: dict[str, Any] = {"verdict": content["verdict"], "named": str([e["name"] for e in content["effects"]])}
    for effect in content["effects"]:
        for name, p in effect["parameters"].items():
            found[f"{effect['name']}.{name}"] = (p["value"], (p["ci95"][1] - p["ci95"][0]) / 4.0)
    return found


WORKS: dict[str, Callable[[], dict[str, Any]]] = {
    "fit": fit_answer,
    "live": live_answer,
    "diagnosis": diagnosis_answer,
}


def moved(before: dict[str, Any], after: dict[str, Any]) -> tuple[float, float, int]:
    """Return the largest shift in standard deviations, their largest change, as a share, and what else is new."""
    shift, wider, other = 0.0, 0.0, len(before.keys() ^ after.keys())
    for key in before.keys() & after.keys():
        old, new = before[key], after[key]
        if isinstance(old, str) or isinstance(new, str):
            other += old != new
        else:
            shift = max(shift, abs(new[0] - old[0]) / old[1])
            wider = max(wider, abs(new[1] / old[1] - 1.0))
    return shift, wider, other


def numbers(rooms: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield module and name of each number of the rooms that was set by hand."""
    files = (p for room in rooms for p in (ROOT / room).glob("*.py") if not p.stem.endswith(("_steps", "_terms")))
    for path in sorted(files):
        for name, _ in numbers_of(path):
            yield ".".join(path.relative_to(ROOT).with_suffix("").parts), name


def changed(value: Any, factor: float) -> Any:
    """Return a number, or each of a tuple, times the factor; None for anything else."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return max(1, math.ceil(value * factor) if factor > 1.0 else math.floor(value * factor))
    if isinstance(value, float):
        return value * factor
    if isinstance(value, np.ndarray):
        return value * factor
    if isinstance(value, tuple) and all(isinstance(v, int | float) for v in value):
        return tuple(changed(v, factor) for v in value)
    return None


def put(module: str, name: str, value: Any) -> None:
    """Set a number where it stands and wherever it was imported, and forget what was made of the old one."""
    old = getattr(importlib.import_module(module), name)
    for one in list(sys.modules.values()):
        if one.__name__.partition(".")[0] not in ("daq", "softsensor"):
            continue
        if vars(one).get(name) is old:
            setattr(one, name, value)
        for found in vars(one).values():
            if hasattr(found, "cache_clear"):
                found.cache_clear()


def main(work: str, *rooms: str) -> None:
    """Do the work with each number changed, and print what that does."""
    answer = WORKS[work]
    before = answer()
    rows = []
    for module, name in numbers(rooms or ROOMS[work]):
        value = getattr(importlib.import_module(module), name)
        for factor in FACTORS:
            other = changed(value, factor)
            if other is None or np.array_equal(other, value):
                continue
            put(module, name, other)
            try:
                rows.append((*moved(before, answer()), f"{module}.{name}", factor))
                print(*rows[-1], flush=True)
            except (ValueError, ArithmeticError, IndexError) as fault:
                rows.append((math.inf, math.inf, 0, f"{module}.{name}: {type(fault).__name__}", factor))
            finally:
                put(module, name, value)
    rows.sort(key=lambda row: (row[2], row[0], row[1]), reverse=True)
    still = sum(max(row[:3]) < 1e-9 for row in rows)
    much = sum(row[0] > 0.5 or row[2] > 0 for row in rows)
    print(
        f"{len(rows)} changes: {still} move nothing, {much} by more than half a standard deviation or otherwise."
    )
    print("shift [sd], change of sd [share], other answers, of which number, and times what")
    for shift, wider, other, what, factor in rows:
        print(f"  {shift:8.3f} {wider:8.3f} {other:4d}  {what} x {factor:.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
