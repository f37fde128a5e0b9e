"""What a diagnosis says: its verdict, what a cause is worth and what it means for the core, as messages.

Each function returns whole sentences, or one clause, as codes with arguments; command line, report and page put
them into words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.press.header import panel_of
from daq.records import Array
from daq.words import Argument, Message, say
from softsensor.diagnosis.decision import EXCESS, FEW_RUNS, Remains, Verdict, pattern_left
from softsensor.diagnosis.extension_unknowns import logarithm_of
from softsensor.diagnosis.finding import Diagnosis, Finding
from softsensor.diagnosis.gains import HARDLY
from softsensor.diagnosis.laws.choice import Law
from softsensor.diagnosis.settling import SettledModel
from softsensor.diagnosis.where import temperatures
from softsensor.effects import find_effect
from softsensor.effects.effect import LawOf
from softsensor.effects.vocabulary import called, coefficient_words, place_words

LEFT_OUT_EXCESS = 2.0
"""Times the noise from which what causes leave of runs left out is called more than noise. That of the runs as
fitted has `EXCESS`; here what a run shares with no other counts besides. Set by hand, 2026-11."""
MOVES, MOVES_SD = 0.05, 2.0
"""A coefficient moves by this logarithm (5 %) and so many standard deviations at least. By hand, 2026-11."""
SLOPE_S = 5.0
"""Over so long before opening a core's rate is taken. [s] By hand."""
LEAST_RATE = 0.02
"""A core that warms more slowly gains nothing by a longer pressing. By hand, 2026-11. [K/s]"""
LARGER_K, WORTH_SECONDS_K = 0.1, 0.2
"""At the core: a difference in the course of a run beyond that at opening, and one worth seconds. By hand. [K]"""
SURE_P = 1e-4
"""Smaller p-values are not written out; flips reach 2.4e-4 (1 of 4096), only channels faulty in many runs less."""


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


def core_cost(less: SettledModel, more: SettledModel) -> CoreCost:
    """Compare the cores of two models at opening, or at the end of runs that do not show it."""
    kelvins, seconds, largest = [], [], []
    for a, b, white in zip(less.fit.runs, more.fit.runs, more.data, strict=True):
        d = white.digest
        at = d.moments.opened_s if np.isfinite(d.moments.opened_s) else float(d.time[-1])
        before, after = (float(np.interp(at, d.time, s.core)) for s in (a, b))
        rate = (after - float(np.interp(at - SLOPE_S, d.time, b.core))) / SLOPE_S
        kelvins.append(after - before)
        difference = b.core - a.core
        largest.append(float(difference[np.argmax(np.abs(difference))]))
        if rate > LEAST_RATE:
            seconds.append((before - after) / rate)
    sd = float(np.std(kelvins, ddof=1)) if len(kelvins) > 1 else 0.0
    longer = float(np.median(seconds)) if seconds else float("nan")
    return CoreCost(float(np.mean(kelvins)), sd, longer, float(np.mean(largest)))


def verdict_messages(found: Diagnosis) -> tuple[Message, ...]:
    """Say the verdict in a few sentences, and what is suspected."""
    suspected = tuple(called(f.name) for f in found.suspected)
    return (*_verdict_alone(found), *([say("verdict-suspected", causes=suspected)] if suspected else []))


def _verdict_alone(found: Diagnosis) -> tuple[Message, ...]:
    runs = len(found.stages[0].data)
    residual = {"rmse": found.base.rmse_K, "noise": found.noise_floor_K}
    if found.verdict is Verdict.TOO_FEW_RUNS:
        off = found.left.times_noise > EXCESS
        return (say("verdict-few-runs-off", runs=runs, **residual) if off else say("verdict-few-runs", runs=runs),)
    if found.verdict is Verdict.NOT_DESCRIBED:
        return (say("verdict-not-described", **residual),)
    if found.verdict is Verdict.NO_EFFECT:
        return (say("verdict-plain-model-explains", runs=runs, **residual),)
    if found.verdict is not Verdict.UNKNOWN_EFFECT:
        return _cause_messages(found)
    if pattern_left(found.left, runs):
        who = "some" if found.left.off else "all"
        if not found.where:
            return (say("verdict-left", who=who),)
        return (say("verdict-left-at", who=who, stretch=stretch_message(found.where[0])),)
    return (say(_without_a_pattern(found.left), runs=runs, core=found.base.core_rmse_K or 0.0, **residual),)


def _without_a_pattern(left: Remains) -> str:
    """Return what says why something is unknown though the runs share no pattern."""
    if not left.panels_alike:
        return "verdict-panels-differ"
    if left.times_noise > EXCESS or left.off:
        return "verdict-differs-from-run-to-run"
    if not left.panels_as_given:
        return "verdict-panels-not-as-given"
    return "verdict-something-beyond-chance" if left.cores_agree else "verdict-cores-off"


def _cause_messages(found: Diagnosis) -> tuple[Message, ...]:
    faults = [f for f in found.findings if f.of_channels]
    causes = [f for f in found.findings if f not in faults]
    messages = [say("verdict-faulty-channels", columns=f.parameters["columns"].value) for f in faults]
    messages += [find_effect(f.name).meaning for f in causes if len(f.set) == 1]
    messages += [say("verdict-alike", causes=tuple(map(called, f.set))) for f in causes if len(f.set) > 1]
    runs = len(found.stages[0].data)
    if causes:
        return (*messages, *_fall(found, len(causes)))
    if runs < FEW_RUNS:
        return (*messages, say("verdict-few-runs-for-others", runs=runs))
    return (*messages, say("verdict-plain-model-explains-the-rest", runs=runs, rmse=found.base.rmse_K))


def _fall(found: Diagnosis, causes: int) -> tuple[Message, ...]:
    before, after = found.base.heldout_rmse_K, found.extended.heldout_rmse_K
    if before - after < HARDLY * before:
        return (say("gain-hardly", causes=causes, before=before, after=after),)
    falls = say("gain-residual-falls", causes=causes, before=before, after=after)
    if after > LEFT_OUT_EXCESS * found.noise_floor_K:
        return falls, say("gain-more-is-missing", noise=found.noise_floor_K)
    return (falls,)


def law_messages(found: Diagnosis) -> tuple[Message, ...]:
    """Say what is missing as a free function, or that none is; nothing where nobody looked for one."""
    law = found.law
    if law is None:
        return () if found.law_seconds is None else (say("law-none"),)
    x, value, low, high = law.curve.T
    first, last = int(np.argmin(value)), int(np.argmax(value))
    law_found = say(
        "law-found",
        kind=say(f"law-kind-{law.kind}"),
        variable=say(f"law-variable-{law.variable}"),
        least=float(value[first]),
        least_low=float(low[first]),
        least_high=float(high[first]),
        at_least=float(x[first]),
        most=float(value[last]),
        most_low=float(low[last]),
        most_high=float(high[last]),
        at_most=float(x[last]),
        unit="" if law.unit == "-" else f" {law.unit.replace('m3', 'm³')}",
        gain=law.gain.value_K,
        before=found.extended.heldout_rmse_K,
    )
    others = tuple(say(f"law-kind-{kind}") for kind in law.set[1:])
    alike = (say("law-alike", others=others),) if others else ()
    known = (say("law-resembles", cause=called(law.resembles)),) if law.resembles else ()
    kelvin = core_cost(found.final, law.stage).kelvin
    changes = (_law_changes(x, value),) if law.unit == "-" else _heat_gone(law)
    return (law_found, *changes, say("law-core", at=_moment(_opens(law.stage)), **_shift(kelvin)), *alike, *known)


def _law_changes(x: Array, value: Array) -> Message:
    """Say how a factor changes from its one extreme to the other, as its variable grows."""
    first, last = sorted((int(np.argmin(value)), int(np.argmax(value))))
    percent = 100.0 * (float(value[last] / value[first]) - 1.0)
    change = "falls" if percent < 0.0 else "rises"
    return say("law-changes", begin=float(x[first]), end=float(x[last]), percent=abs(percent), change=change)


def _heat_gone(law: Law) -> tuple[Message, ...]:
    """Say how much heat surely goes, or comes, and between which temperatures; nothing of other kinds."""
    if law.kind is not LawOf.HEAT:
        return ()
    x, _, low, high = law.curve.T
    peak = int(np.argmax(np.maximum(low, -high)))
    sure = (low > 0.0) if low[peak] > 0.0 else (high < 0.0)
    if not sure[peak]:
        return ()
    unsure = np.flatnonzero(~sure)
    begin = int(np.max(unsure[unsure < peak], initial=-1)) + 1
    end = int(np.min(unsure[unsure > peak], initial=len(x)))
    density = float(np.mean([panel_of(d.digest.run).density for d in law.stage.data]))
    within = law.curve[begin:end]
    amount, *ends = (float(np.trapezoid(y, within[:, 0])) / density for y in within.T[1:])
    least, most = sorted(map(abs, ends))
    change = "goes" if amount > 0.0 else "comes"
    heat: dict[str, Argument] = {"amount": abs(amount), "least": least, "most": most, "change": change}
    return (say("law-heat", begin=float(x[begin]), end=float(x[end - 1]), **heat),)


def core_messages(found: Diagnosis) -> tuple[Message, ...]:
    """Say what the verdict means for the core, and how far core thermocouples are from it."""
    before, after = found.base.core_rmse_K, found.extended.core_rmse_K
    if not found.final.fit.layout.model.press.panel_layers:
        return (say("core-no-panel"),)
    if len(found.stages) < 2:
        known = say("core-not-proven") if before is None else say("core-off", kelvin=before)
        return (known,) if found.law is not None else (say("core-unchanged"), known)
    cost = core_cost(found.stages[0], found.final)
    opens = _opens(found.final)
    messages = [say("core-shift", at=_moment(opens), **_shift(cost.kelvin), sd=cost.kelvin_sd)]
    if abs(cost.largest) > abs(cost.kelvin) + LARGER_K:
        messages.append(say("core-largest-shift", **_shift(cost.largest)))
    if opens and np.isfinite(cost.seconds) and abs(cost.kelvin) > WORTH_SECONDS_K:
        longer = "longer" if cost.seconds > 0 else "shorter"
        messages.append(say("core-press-time", seconds=abs(cost.seconds), change=longer))
    if before is not None and after is not None:
        messages.append(say("core-thermocouples", before=before, after=after))
    return tuple(messages)


def where_message(found: Diagnosis) -> tuple[Message, ...]:
    """Say where and when the plain model is most kelvins off, and at which temperatures."""
    stretches = [stretch_message(row) for row in found.where[:3]]
    return tuple(say("where-further" if i else "where-most", stretch=s) for i, s in enumerate(stretches))


def stretch_message(row: dict[str, Any]) -> Message:
    """Say where, when and by how much a model is off (a row of `Diagnosis.where`)."""
    off: dict[str, Argument] = {
        "kelvin": abs(row["residual_K"]),
        "side": "above" if row["residual_K"] > 0 else "below",
        "place": place_words(row["signal"]),
        "phase": Message.from_json(row["phase_said"]),
        "temperatures": temperatures(row),
    }
    if row["to_s"] is None:
        return say("where-stretch-to-the-end", begin=row["from_s"], **off)
    return say("where-stretch", begin=row["from_s"], end=row["to_s"], **off)


def chance(p_value: float) -> Message:
    """Say a p-value."""
    return say("p-value-below", p=SURE_P) if p_value < SURE_P else say("p-value", p=p_value)


def sureness(finding: Finding, runs: int) -> Message:
    """Say a p-value, and why a cause is named where so few runs cannot show a small one."""
    if runs >= FEW_RUNS:
        return chance(finding.p_value)
    return say("p-value-few-runs", chance=chance(finding.p_value), runs=runs, least=0.5 ** (runs - 1))


def worth(found: Diagnosis, finding: Finding) -> Message:
    """Say what a cause is worth: kelvins saved on runs left out, or why it is named though these hardly fall."""
    if finding.of_channels:
        return say("worth-faulty-channel")
    before, gain = found.base.heldout_rmse_K, finding.gain.value_K
    if gain >= HARDLY * before:
        return say("worth-saves", gain=gain)
    at = found.final.effects.index(finding.name)
    less, more = found.stages[at : at + 2]
    better, runs = finding.votes
    hardly = {"gain": round(gain, 2) + 0.0, "before": before, "better": better, "runs": runs}
    moved = _moved(less, more)
    if not more.fit.layout.model.press.panel_layers:
        return say("worth-hardly-without-panel", moved=moved, **hardly)
    core = say("worth-core", at=_moment(_opens(more)), **_shift(core_cost(less, more).kelvin))
    return say("worth-hardly", moved=moved, core=core, **hardly)


def _moved(less: SettledModel, more: SettledModel) -> Message:
    """Say which coefficient a cause moves most."""
    press = more.fit.layout.model.press
    moved = []
    for name in press.free_coefficients:
        step = more.fit.values[logarithm_of(name)] - less.fit.values[logarithm_of(name)]
        if abs(step) > max(MOVES, MOVES_SD * max(_sd(s, name) for s in (less, more))):
            moved.append((abs(step), step, name))
    if not moved:
        return say("worth-moves-nothing")
    _, step, name = max(moved)
    change = {"change": "raises" if step > 0 else "lowers", "percent": 100 * abs(float(np.expm1(step)))}
    return say("worth-moves", coefficient=name, bodies=coefficient_words(press, name), **change)


def _shift(kelvin: float) -> dict[str, Argument]:
    return {"kelvin": abs(kelvin), "change": "hotter" if kelvin > 0 else "cooler"}


def _moment(opens: bool) -> str:
    return "opening" if opens else "end"


def _opens(stage: SettledModel) -> bool:
    """Whether any of the runs shows the press opening."""
    return any(np.isfinite(white.digest.moments.opened_s) for white in stage.data)


def _sd(stage: SettledModel, name: str) -> float:
    """Standard deviation of a coefficient's logarithm in a campaign."""
    at = stage.fit.layout.names.index(logarithm_of(name))
    return float(np.sqrt(max(stage.fit.covariance[at, at], 0.0)))
