"""A verdict in words a process engineer uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from softsensor.diagnosis import Diagnosis, Finding
from softsensor.diagnosis_jury import FEW_RUNS
from softsensor.diagnosis_search import Stage
from softsensor.effects import find_effect
from softsensor.extension_layout import free_coefficients
from softsensor.parameters import plain
from softsensor.vocabulary import coefficient_words, place_words, readable

FAR_OFF = 2.0
"""Times the noise from which a residual is called more than noise, whatever can be told of its cause."""
NOT_EXPLAINED = 1.5
"""Times the noise from which a plain model without a named cause is not said to explain the runs."""
HARDLY = 0.05
"""Share of the residual on runs left out below which saving it is not what a cause is worth."""
MOVES = 0.05
"""Logarithm by which a coefficient must differ, and standard deviations, to be told."""
MOVES_SD = 2.0
SURE_P = 1e-4
"""Smaller p-values are not told apart."""


@dataclass(frozen=True)
class CoreCost:
    """What the plain model's error means at the core when the press opens, over runs."""

    kelvin: float
    """Extended minus plain model. [K]"""
    kelvin_sd: float
    seconds: float
    """How much longer (above 0) the press must stay closed for the core the plain model promised. [s]"""
    largest: float
    """The largest difference at any time of a run, mean over runs. [K]"""


def core_cost(found: Diagnosis) -> CoreCost | None:
    """Compare the core of plain and extended model at opening, or at the end; None without an extension."""
    return None if len(found.stages) < 2 else _between(found.stages[0], found.final)


def _between(less: Stage, more: Stage) -> CoreCost:
    """Compare the core of two models."""
    kelvins, seconds, largest = [], [], []
    for a, b, white in zip(less.fit.runs, more.fit.runs, more.data, strict=True):
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
    return CoreCost(float(np.mean(kelvins)), sd, longer, float(np.mean(largest)))


def sentence(found: Diagnosis) -> str:
    """Say the verdict in one or two sentences."""
    runs = len(found.stages[0].data)
    if found.verdict == "too_few_runs":
        off = found.base.rmse_K > FAR_OFF * found.noise_floor_K
        much = f", and {found.base.rmse_K:.2f} K off, {found.noise_floor_K:.2f} K of it noise" if off else ""
        return f"{_count(runs)}{much}: too few to tell a cause from chance."
    names = ", then ".join(readable(f.name) for f in found.findings)
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
            f": {_stretch(found.where[0])}." if found.where else "."
        )
    several = [f for f in found.findings if len(f.set) > 1]
    if several:
        sets = "; ".join(_listed([readable(n) for n in f.set]) for f in several)
        sure = [f for f in found.findings if f not in several]
        known = "".join(f"{find_effect(f.name).meaning} " for f in sure if f.name != "sensor_fault")
        return f"{known}These runs cannot tell {sets} apart. With {'them' if known else 'it'} {_fall(found)}."
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
    return f"{' '.join(said + causes)} With it {_fall(found)}."


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}"


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
    presses = _opens(found.final)
    when = "When the press opens" if presses else "At the end of a run"
    text = (
        f"{when}, the core is {_warmer(cost.kelvin)} than the plain model says "
        f"(± {cost.kelvin_sd:.1f} K from run to run)"
    )
    earlier = abs(cost.largest) > abs(cost.kelvin) + 0.1
    text += f", and up to {_warmer(cost.largest)} in the course of a run." if earlier else "."
    if presses and np.isfinite(cost.seconds) and abs(cost.kelvin) > 0.2:
        verb = "longer" if cost.seconds > 0 else "shorter"
        text += f" For the core the plain model promised, press {abs(cost.seconds):.1f} s {verb} (median run)."
    if before is not None and after is not None:
        text += f" Core thermocouples, which no fit has seen: {before:.1f} K off before, {after:.1f} K after."
    return text


def _fall(found: Diagnosis) -> str:
    before, after = found.base.heldout_rmse_K, found.extended.heldout_rmse_K
    if before - after < HARDLY * before:
        return f"the residual hardly changes, {before:.2f} and {after:.2f} K on runs left out"
    text = f"the residual falls from {before:.2f} to {after:.2f} K on runs left out"
    if found.extended.heldout_rmse_K > FAR_OFF * found.noise_floor_K:
        text += f" (noise alone: {found.noise_floor_K:.2f} K), so more is missing that these runs cannot name"
    return text


def where_sentence(found: Diagnosis) -> str:
    """Say where and when the plain model is most kelvins off, and at which temperatures."""
    return f"Most off: {'; '.join(_stretch(w) for w in found.where[:3])}."


def _stretch(row: dict[str, Any]) -> str:
    until = "on" if row["to_s"] is None else f"to {row['to_s']:g} s"
    when = f"from {row['from_s']:g} s {until} ({row['phase']})"
    place = place_words(row["signal"])
    return f"{row['residual_K']:+.2f} K at {place}, {when}, where it measured {temperatures(row)}"


def temperatures(row: dict[str, Any]) -> str:
    """Write the temperatures measured in a stretch that is off."""
    low, high = f"{row['low_C']:.0f}", f"{row['high_C']:.0f}"
    return f"{low} °C" if low == high else f"{low} to {high} °C"


def chance(p_value: float) -> str:
    """Write a p-value.

    Examples
    --------
    >>> chance(0.0078125), chance(3e-6)
    ('p = 0.0078', 'p < 0.0001')
    """
    return f"p < {plain(SURE_P)}" if p_value < SURE_P else f"p = {plain(p_value, 2)}"


def sureness(finding: Finding, runs: int) -> str:
    """Write a p-value, and why a cause is named where so few runs cannot show a small one."""
    text = chance(finding.p_value)
    if runs >= FEW_RUNS:
        return text
    return (
        f"{text} ({_count(runs)} cannot show less than {plain(0.5 ** (runs - 1), 2)}; named because each one, "
        f"left out, gains by it and what is left more than halves)"
    )


def worth(found: Diagnosis, finding: Finding) -> str:
    """Say what a cause is worth: kelvins saved on runs left out, or why it is named though these hardly fall."""
    if finding.name == "sensor_fault":
        return "found by comparison with the channels beside it, and left out"
    before, gain = found.base.heldout_rmse_K, finding.heldout_gain_K
    if gain >= HARDLY * before:
        return f"saves {gain:.2f} of {before:.2f} K on runs left out"
    text = f"hardly lowers the residual on runs left out ({unsigned_zero(f'{gain:.2f}')} of {before:.2f} K)"
    if finding.votes is not None:
        better, runs = finding.votes
        text += f"; named because {better} of {runs} runs, each left out in turn, are met better with it"
    at = found.final.effects.index(finding.name)
    return f"{text}; {_mends(found.stages[at], found.stages[at + 1])}"


def as_stored(found: Diagnosis) -> dict[str, Any]:
    """Return the JSON with what each cause is worth beside it, for the pages that show a stored diagnosis."""
    content = found.as_json()
    told = [{**e, "worth": worth(found, f)} for e, f in zip(content["effects"], found.findings, strict=True)]
    return {**content, "effects": told}


def _mends(less: Stage, more: Stage) -> str:
    """Say which coefficient a cause moves most, and how the core."""
    press = more.fit.layout.model.press
    moved = []
    for name in free_coefficients(more.fit.layout.model):
        step = more.fit.values[f"log {name}"] - less.fit.values[f"log {name}"]
        if abs(step) > max(MOVES, MOVES_SD * max(_sd(s, name) for s in (less, more))):
            moved.append(
                (abs(step), f"{name} ({coefficient_words(press, name)}) by {100 * np.expm1(step):+.0f} %")
            )
    told = max(moved)[1] if moved else "no coefficient by more than chance"
    if not press.panel_layers:
        return f"it moves {told}"
    core = unsigned_zero(f"{_between(less, more).kelvin:+.1f}")
    when = "when the press opens" if _opens(more) else "at the end of a run"
    return f"it moves {told}, and the core by {core} K {when}"


def unsigned_zero(text: str) -> str:
    """Return a written number without the sign of a zero.

    Examples
    --------
    >>> unsigned_zero("-0.00"), unsigned_zero("+0.0"), unsigned_zero("-0.01")
    ('0.00', '0.0', '-0.01')
    """
    return text if text.strip("+-0.") else text.lstrip("+-")


def _opens(stage: Stage) -> bool:
    """Whether any of the runs shows the press opening."""
    return any(np.isfinite(white.digest.moments.opened_s) for white in stage.data)


def _sd(stage: Stage, name: str) -> float:
    """Standard deviation of a coefficient's logarithm in a campaign."""
    at = [s.name for s in stage.fit.layout.shared].index(f"log {name}")
    return float(np.sqrt(max(stage.fit.covariance[at, at], 0.0)))


def _warmer(kelvin: float) -> str:
    return f"{abs(kelvin):.1f} K {'hotter' if kelvin > 0 else 'cooler'}"
