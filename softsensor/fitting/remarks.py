"""What to read about a run's record before trusting its coefficients: faults, gaps, contradictions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from daq.press.moments import BEFORE_S
from daq.press.press_file import InitialKind
from daq.records import Moments
from daq.tables import at
from daq.words import Message, say, spoken
from softsensor.fitting.unknowns import gaps_at_moments
from softsensor.heat.case import Case
from softsensor.heat.run_checks import load_remarks
from softsensor.signals.places import Signals

# Numbers without another source were set by hand, 2026-11.

APART_K = 5.0
"""The panel's start temperature is known to some tenths; this far from the readings it is another panel's. [K]"""
WARMED_K = 10.0
"""Where the first row is the insertion, the cooler face may have warmed by as much already. [K]"""
LEAD_S = 5.0
"""Readings this short before the insertion are the panel's: before that, people handle its sensors. [s]"""

COLD_S, COLD_SHARE = 3.0, 0.03
"""A face laid on a hot plate warms in so many seconds by a sixth of what the plate is hotter than the room; by
less than this share it has not been laid there."""


def remarks(case: Case, signals: Signals, moments: Moments) -> list[Message]:
    """Say what is wrong with the record: channels, gaps where the press moved, start temperature, loads.

    Parameters
    ----------
    moments
        As detected, before a fit refines them.
    """
    gaps = gaps_at_moments(case.run.time_s, moments, signals.period_s)
    record = [f.message for f in signals.findings] + [g.message for g in gaps.values()]
    if moments.closed_again:
        record.append(say("fit-closed-again", at=moments.removed_s))
    loads = [spoken(remark) for remark in load_remarks(case.press, case.run)]
    return record + start_remarks(case, signals, moments) + loads


def start_remarks(case: Case, signals: Signals, moments: Moments) -> list[Message]:
    """Say that the header's start temperature is not what the panel's channels read at the beginning."""
    if case.panel is None or case.press.initial.kind is not InitialKind.STEADY:
        return []
    faces = [p for p in signals.places if p.label.partition("@")[0].partition(".")[0] in case.press.panel_layers]
    t, start = signals.time_s, case.panel.initial_temperature
    inserted = moments.inserted_s if np.isfinite(moments.inserted_s) else float(t[0])
    lead = (t >= inserted - LEAD_S) & (t < inserted - BEFORE_S - 0.5 * signals.period_s)
    levels = [p.mean[lead & np.isfinite(p.mean)] for p in faces]
    read = [float(np.median(values)) for values in levels if len(values)]
    if read:
        level, upper, code = float(np.mean(read)), APART_K, "fit-start-before-insertion"
    else:
        first = [p.mean[(t <= t[0] + signals.period_s) & np.isfinite(p.mean)] for p in faces]
        level = min((float(values[0]) for values in first if len(values)), default=start)
        upper, code = WARMED_K, "fit-start-in-first-row"
    if start - APART_K <= level <= start + upper:
        return []
    return [say(code, header=start, read=level)]


def lost_insertion(case: Case, signals: Signals) -> Message | None:
    """Say that insertion and closing fall into one gap, so that nothing shows how long the panel lay open.

    A detector that finds no insertion takes the first row. It is not there where the panel's lower face, which
    lies on the hot plate from the insertion on, stays cold until the gap.
    """
    t, moments = signals.time_s, case.moments
    gaps = gaps_at_moments(t, moments, signals.period_s)
    gap = gaps.get("closed_s")
    if gap is None or not case.press.panel_layers:
        return None
    lost = say("fit-misfit-lost-insertion", begin=gap.start, end=gap.end)
    if "inserted_s" in gaps:
        return lost if gaps["inserted_s"].start == gap.start else None
    lower = next((p for p in signals.places if p.label == f"{case.press.panel_layers[0]}.bottom"), None)
    if lower is None or moments.inserted_s > t[0] or gap.start - t[0] < COLD_S:
        return None
    before = lower.mean[(t <= gap.start) & np.isfinite(lower.mean)]
    hotter = float(np.max(case.outside[0])) - case.run.ambient_temperature
    return lost if len(before) > 1 and np.ptp(before) < COLD_SHARE * hotter else None


def remarks_together(remarked: Mapping[str, Sequence[Message]]) -> Iterator[Message]:
    """Yield what is remarked on runs, by name: of what several have in common, one run's for all of them."""
    alike: dict[tuple[str, ...], list[tuple[str, Message]]] = {}
    for run, found in remarked.items():
        for remark in found:
            about = (str(remark.arguments[key]) for key in ("name", "column") if key in remark.arguments)
            alike.setdefault((remark.code, *about), []).append((run, remark))
    for same in alike.values():
        (first, remark), count = same[0], len({name for name, _ in same})
        if count == 1:
            yield from (at(name, one) for name, one in same)
        else:
            yield say("terminal-fit-remark-of", count=count, total=len(remarked), run=first, remark=remark)
