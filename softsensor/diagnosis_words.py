"""A verdict in words a process engineer uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsensor.diagnosis import Diagnosis
from softsensor.diagnosis_jury import FEW_RUNS
from softsensor.effects import find_effect

FAR_OFF = 2.0
"""Times the noise from which a residual is called more than noise, whatever can be told of its cause."""


NOT_EXPLAINED = 1.5
"""Times the noise from which a plain model without a named cause is not said to explain the runs."""


@dataclass(frozen=True)
class CoreCost:
    """What the plain model's error means at the core when the press opens, over runs."""

    kelvin: float
    """Extended minus plain model. [K]"""
    kelvin_sd: float
    seconds: float
    """How much longer (above 0) the press must stay closed for the core the plain model promised. [s]"""
    largest: float
    """The largest difference at any time of a run, median over runs. [K]"""


def core_cost(found: Diagnosis) -> CoreCost | None:
    """Compare the core of plain and extended model at opening, or at the end; None without an extension."""
    if len(found.stages) < 2:
        return None
    plain, final = found.stages[0].fit.runs, found.final.fit.runs
    kelvins, seconds, largest = [], [], []
    for a, b, white in zip(plain, final, found.final.data, strict=True):
        d = white.digest
        at = d.moments.opened_s if np.isfinite(d.moments.opened_s) else float(d.time[-1])
        before, after = (float(np.interp(at, d.time, s.core)) for s in (a, b))
        rate = (after - float(np.interp(at - 5.0, d.time, b.core))) / 5.0
        kelvins.append(after - before)
        difference = b.core - a.core
        largest.append(float(difference[np.argmax(np.abs(difference))]))
        if rate > 0.02:
            seconds.append((before - after) / rate)
    sd = float(np.std(kelvins, ddof=1)) if len(kelvins) > 1 else 0.0
    longer = float(np.median(seconds)) if seconds else float("nan")
    return CoreCost(float(np.mean(kelvins)), sd, longer, float(np.median(largest)))


def sentence(found: Diagnosis) -> str:
    """Say the verdict in one or two sentences."""
    runs = len(found.stages[0].data)
    if found.verdict == "too_few_runs":
        off = found.base.rmse_K > FAR_OFF * found.noise_floor_K
        much = f", and {found.base.rmse_K:.2f} K off, {found.noise_floor_K:.2f} K of it noise" if off else ""
        return f"{_count(runs)}{much}: too few to tell a cause from chance."
    names = ", then ".join(_readable(f.name) for f in found.findings)
    if found.verdict == "no_effect" and found.base.rmse_K > NOT_EXPLAINED * found.noise_floor_K:
        return (
            f"No cause is common to these {runs} runs, yet the plain model is {found.base.rmse_K:.2f} K off and "
            f"noise alone is {found.noise_floor_K:.2f} K: what is missing differs from run to run."
        )
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
    faults = [f for f in found.findings if f.name == "sensor_fault"]
    said = []
    if faults:
        said.append(
            f"{', '.join(faults[0].parameters['columns'].value)}: loose, drifting or swapped, and left out."
        )
    causes = [find_effect(f.name).meaning for f in found.findings if f not in faults]
    if not causes:
        if runs < FEW_RUNS:
            too_few = f"{_count(runs)} {'is' if runs == 1 else 'are'} too few"
            return f"{said[0]} {too_few} to tell any other cause from chance."
        return f"{said[0]} Without, the plain model explains these {runs} runs to {found.base.rmse_K:.2f} K."
    return f"{' '.join(said + causes)} With it the residual falls {_fall(found)}."


def _count(runs: int) -> str:
    return f"{runs} run{'s' if runs > 1 else ''}"


def core_sentence(found: Diagnosis) -> str:
    """Say what the verdict means for the core, and what core thermocouples say to it."""
    if not found.final.fit.layout.model.press.panel_layers:
        return "There is no panel in this rig, so nothing is said about a core."
    cost, before, after = core_cost(found), found.base.core_rmse_K, found.extended.core_rmse_K
    if cost is None:
        text = "No cause was added, so the core estimate stays as it is."
        if before is None:
            return f"{text} Faces alone do not prove it: a few sacrificial panels with a core thermocouple would."
        return f"{text} Core thermocouples, which no fit has seen, are {before:.1f} K off it."
    presses = any(np.isfinite(d.digest.moments.opened_s) for d in found.final.data)
    when = "When the press opens" if presses else "At the end of a run"
    text = (
        f"{when}, the core is {_warmer(cost.kelvin)} than the plain model says "
        f"(± {cost.kelvin_sd:.1f} K from run to run), at most {_warmer(cost.largest)} in the course of a run."
    )
    if presses and np.isfinite(cost.seconds) and abs(cost.kelvin) > 0.2:
        verb = "longer" if cost.seconds > 0 else "shorter"
        text += f" For the core the plain model promised, press {abs(cost.seconds):.1f} s {verb} (median run)."
    if before is not None and after is not None:
        text += f" Core thermocouples, which no fit has seen: {before:.1f} K off before, {after:.1f} K after."
    return text


def _fall(found: Diagnosis) -> str:
    text = f"from {found.base.heldout_rmse_K:.2f} to {found.extended.heldout_rmse_K:.2f} K on runs left out"
    if found.extended.heldout_rmse_K > FAR_OFF * found.noise_floor_K:
        text += f" (noise alone: {found.noise_floor_K:.2f} K), so more is missing that these runs cannot name"
    return text


def _worst(found: Diagnosis) -> str:
    w = found.where[0]
    until = "on" if w["to_s"] is None else f"to {w['to_s']:g} s"
    return f"{w['residual_K']:+.2f} K at {w['signal']} from {w['from_s']:g} s {until} ({w['phase']})"


def _readable(name: str) -> str:
    return name.replace("_", " ")


def _warmer(kelvin: float) -> str:
    return f"{abs(kelvin):.1f} K {'hotter' if kelvin > 0 else 'cooler'}"


def plain(value: float) -> str:
    """Write a number to three digits, without a power of ten where a reader needs none."""
    if 1e-3 <= abs(value) < 1e6:
        return np.format_float_positional(value, precision=3, unique=False, fractional=False, trim="-")
    return f"{value:.3g}"
