"""A plan in words: what is open, and the pressings for it."""

from __future__ import annotations

import math
from collections.abc import Iterator

from daq.words import Message, say
from softsensor.diagnosis.decision import Verdict
from softsensor.effects.vocabulary import called
from softsensor.fitting.experiment_advice import MANY
from softsensor.planning.advise import ProgrammeAdvice
from softsensor.planning.made_up import COEFFICIENTS, EFFECTS, KINETICS, PLATENS, SORPTION
from softsensor.planning.open_points import NOTHING, OpenPoint, PointKind, Prospect
from softsensor.planning.plan import PlannedPressing, PointAdvice, PressingPlan

SAVINGS = 3
"""Sources of doubt that are shown, those that would save most."""


def plan_messages(found: PressingPlan) -> Iterator[Message]:
    """Say each open point with its pressings, one line each."""
    yield from standing_messages(found)
    for advice in found.points:
        yield point_message(advice.point)
        yield from pressing_messages(advice)


def standing_messages(found: PressingPlan) -> Iterator[Message]:
    """Say what keeps a plan from being one, or that it is not needed."""
    if found.verdict == Verdict.NOT_DESCRIBED:
        yield say("plan-not-described")
    elif not found.points:
        yield say("plan-nothing-open")


def point_message(point: OpenPoint) -> Message:
    """Say what is open."""
    if point.kind is PointKind.COEFFICIENT:
        now, wanted = math.exp(point.half_now or 0.0), math.exp(point.wanted)
        return say("plan-open-coefficient", name=point.name, factor=now, wanted=wanted)
    if point.kind is PointKind.CORE_BAND:
        return say("plan-open-core", kelvin=point.half_now or 0.0, wanted=point.wanted)
    causes = tuple(called(name) for name in point.names if name != NOTHING)
    return say("plan-open-suspected", causes=causes) if point.suspected else say("plan-open-causes", causes=causes)


def pressing_messages(advice: PointAdvice) -> Iterator[Message]:
    """Say the best pressing, the same with a thermocouple in the core, and what repeating brings."""
    kind = advice.point.kind
    yield best_message(advice)
    if advice.with_core is not None:
        prospect = prospect_message(advice.with_core.prospect, kind)
        own = settings_messages(advice.with_core) or (say("plan-set-as-usual"),)
        yield say("plan-with-core", settings=own, prospect=prospect)
    if advice.best.changed:
        yield say("plan-repeated", prospect=prospect_message(advice.repeated.prospect, kind))


def best_message(advice: PointAdvice) -> Message:
    """Say the best pressing alone."""
    prospect = prospect_message(advice.best.prospect, advice.point.kind)
    if not advice.best.changed:
        return say("plan-best-is-usual", prospect=prospect)
    return say("plan-best", settings=settings_messages(advice.best), prospect=prospect)


def settings_messages(pressing: PlannedPressing) -> tuple[Message, ...]:
    """Say what differs from the usual settings."""
    return tuple(say(f"plan-set-{name}", value=pressing.settings[name]) for name in pressing.changed)


def prospect_message(prospect: Prospect, kind: PointKind) -> Message:
    """Say what pressings of a kind would bring."""
    runs = say("plan-runs-too-many", many=MANY) if prospect.runs is None else say("plan-runs", runs=prospect.runs)
    if prospect.chance is not None:
        percent = round(100.0 * prospect.chance)
        return say("plan-settles", percent=percent, runs=runs) if percent < 100 else say("plan-settles-surely")
    half = prospect.half_after or 0.0
    if kind is PointKind.COEFFICIENT:
        return say("plan-narrows-factor", factor=math.exp(half), runs=runs)
    return say("plan-narrows-kelvin", kelvin=half, runs=runs)


def advice_title(found: ProgrammeAdvice) -> Message:
    """Say the answer in one line."""
    shown = found.nearest
    if found.best is None:
        limit = say(f"advise-limit-{shown.opening.blocking}")
        percent = 100.0 * shown.opening.risk
        return say("advise-none", platen=shown.programme.platen_C, limit=limit, percent=percent)
    percent = 100.0 * found.wish.limits.probability
    seconds = _settable(shown.opening.in_s)
    return say("advise-best", seconds=seconds, platen=shown.programme.platen_C, percent=percent)


def advice_messages(found: ProgrammeAdvice) -> Iterator[Message]:
    """Say the panel, the program to take, what it costs, and what to measure to press shorter."""
    thickness, material = (found.panel.get(f"panel.{key}", "?") for key in ("thickness_mm", "material"))
    yield say("advise-panel", material=material, thickness=thickness)
    yield advice_title(found)
    best = found.best
    if best is not None:
        if best.programme.pressure_N_cm2 is not None:
            yield say("advise-pressure", pressure=best.programme.pressure_N_cm2)
        likely = best.opening.likely_in_s
        yield say("advise-margin", likely=likely, until=best.opening.until_s, seconds=best.opening.in_s)
        energy = say("advise-energy", energy=best.energy_kWh, panels=best.panels_per_h)
        if best.price is not None:
            energy = say("advise-energy-cost", energy=energy, cents=100.0 * best.price * best.energy_kWh)
        yield energy
    for saving in found.savings[:SAVINGS]:
        seconds = _settable(saving.press_time_s)
        if best is None or seconds < _settable(best.opening.in_s):
            yield say("advise-measure", source=source_message(saving.source), seconds=seconds)
    yield say("advise-assumed")


def _settable(seconds: float) -> float:
    """Return a press time as it is shown, in tenths of a second: rounded up, for a shorter one would not do."""
    return math.ceil(10.0 * seconds - 1e-6) / 10.0


def source_message(source: str) -> Message:
    """Say a source of doubt; a constant goes by its key."""
    own = (COEFFICIENTS, EFFECTS, PLATENS, KINETICS, SORPTION)
    return say(f"advise-source-{source}") if source in own else say("plain-text", text=source)
