"""A verdict in words a process engineer uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsensor.diagnosis import Diagnosis
from softsensor.effects import find_effect


@dataclass(frozen=True)
class CoreCost:
    """What the plain model's error means at the core when the press opens, over runs."""

    kelvin: float
    """Extended minus plain model. [K]"""
    kelvin_sd: float
    seconds: float
    """How much longer (above 0) the press must stay closed for the core the plain model promised. [s]"""


def core_cost(found: Diagnosis) -> CoreCost | None:
    """Compare the core of plain and extended model at opening; None without an extension or a pressing."""
    plain, final = found.stages[0].fit.runs, found.final.fit.runs
    kelvins, seconds = [], []
    for a, b, white in zip(plain, final, found.final.data, strict=True):
        d = white.digest
        at = d.moments.opened_s
        if not np.isfinite(at):
            continue
        before, after = (float(np.interp(at, d.time, s.core)) for s in (a, b))
        rate = (after - float(np.interp(at - 5.0, d.time, b.core))) / 5.0
        kelvins.append(after - before)
        if rate > 0.02:
            seconds.append((before - after) / rate)
    if len(found.stages) < 2 or not kelvins:
        return None
    sd = float(np.std(kelvins, ddof=1)) if len(kelvins) > 1 else 0.0
    return CoreCost(float(np.mean(kelvins)), sd, float(np.median(seconds)) if seconds else float("nan"))


def sentence(found: Diagnosis) -> str:
    """Say the verdict in one or two sentences."""
    runs = len(found.stages[0].data)
    if found.verdict == "too_few_runs":
        return f"{runs} runs are too few to tell a cause from chance."
    names = ", then ".join(_readable(f.name) for f in found.findings)
    if found.verdict == "no_effect":
        return (
            f"The plain model explains these {runs} runs to {found.base.rmse_K:.2f} K; "
            f"noise alone is {found.noise_floor_K:.2f} K."
        )
    if found.verdict == "unknown_effect":
        start = f"Found {names}, but something remains. " if names else ""
        return f"{start}All runs share a residual that no cause of the catalogue explains" + (
            f": {_worst(found)}." if found.where else "."
        )
    several = [f for f in found.findings if len(f.set) > 1]
    if several:
        sets = "; ".join(" or ".join(_readable(n) for n in f.set) for f in several)
        return f"These runs cannot tell {sets} apart; with it the residual falls {_fall(found)}."
    meaning = " ".join(find_effect(f.name).meaning for f in found.findings)
    return f"{meaning} With it the residual falls {_fall(found)}."


def _fall(found: Diagnosis) -> str:
    return f"from {found.base.heldout_rmse_K:.2f} to {found.extended.heldout_rmse_K:.2f} K on runs left out"


def _worst(found: Diagnosis) -> str:
    w = found.where[0]
    until = "on" if w["to_s"] is None else f"to {w['to_s']:g} s"
    return f"{w['residual_K']:+.2f} K at {w['signal']} from {w['from_s']:g} s {until} ({w['phase']})"


def _readable(name: str) -> str:
    return name.replace("_", " ")
