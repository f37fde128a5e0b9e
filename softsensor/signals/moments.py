"""When the press moved in a run, by one detector (`daq.press.events`): as wires show it, and as readings show it.

Two answers, because two things are asked. A fit, a simulation and the live service want the press's own moments:
a wire's where there is one (`moments_of`). A diagnosis asks whether panel channels are late against that wire, so
its solver's fine steps and its bins must lie where the readings show the event (`moments_seen`); how far the wire
lies off then is an unknown of each run. Measured on the reference campaigns (2026-11-22): with `moments_of` a
diagnosis finds an upper platen off by 2.1 K instead of 3.4 K and calls it ambiguous; with a diagnosis's prior of a
wire (0.06 s) a fit of late sensors ends at h_pp_c 384 instead of 432 W/m²K, for it has no lag to put them down to.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from daq.press.events import find_moments
from daq.press.press_file import Press
from daq.press.wires import SILENT_S, closed_of, without_wires
from daq.records import EventSource, InputError, Moments, Run
from daq.words import say

# Numbers without another source were set by hand, 2026-11.

NEAR_S = 1.5
"""A wire and the readings that far apart do not show one event: then the wire counts. [s]"""
SAME_INSERTION_S = 5.0
"""The same for the insertion, which no wire shows. [s]"""
Switch = tuple[tuple[float, float], tuple[float, float]]
"""Closing and opening by a limit switch: when it was first seen, and how long before it was not. [s]"""
_NEVER = (math.nan, 0.0)


def moments_of(run: Run, press: Press) -> Moments:
    """Return a run's moments: a wire's where there is one. Raises InputError where nothing shows the press."""
    if not press.has_states:
        return Moments(inserted_s=float(run.time_s[0]))
    moments = find_moments(run, press)
    if moments.source is EventSource.UNKNOWN:
        raise InputError(say("run-press-state-unknown", run=run.source or run.name))
    return moments


def moments_seen(run: Run, press: Press) -> Moments:
    """Return the moments as the temperatures show them, the limit switch's where they do not.

    Where both show it, the middle of the two: a switch is known to a scan only, and channels with a clock of
    their own show an event late; the solver's fine steps should hold the event either way.
    """
    if not press.has_states:
        return Moments(inserted_s=float(run.time_s[0]))
    by_faces, wired = find_moments(without_wires(run, press), press), find_moments(run, press)
    if not wired.source.is_wire:
        return by_faces
    closed, opened = switch_of(run, press) or (_NEVER, _NEVER)
    same = abs(by_faces.inserted_s - wired.inserted_s) < SAME_INSERTION_S and by_faces.inserted_s < wired.closed_s
    opened_s = _between(by_faces.opened_s, opened, wired.opened_s)
    early = by_faces.removed_s < opened_s  # seen while the press eased off
    again = by_faces.closed_again or wired.closed_again  # on the same panel: the wire knows
    removed_s = wired.removed_s if early or again else by_faces.removed_s
    return replace(
        by_faces,
        closed_s=_between(by_faces.closed_s, closed, wired.closed_s),
        opened_s=opened_s,
        inserted_s=by_faces.inserted_s if same else wired.inserted_s,
        removed_s=max(removed_s, opened_s),
        closed_again=wired.closed_again,
    )


def _between(by_faces: float, switched: tuple[float, float], wired: float) -> float:
    """Return the middle of a moment seen and one switched, where they show one event; else the wire's."""
    first, gap = switched
    middle = first - gap / 2
    if abs(by_faces - middle) < NEAR_S:
        return (by_faces + middle) / 2
    return middle if math.isfinite(middle) and gap <= SILENT_S else wired


def switch_of(run: Run, press: Press) -> Switch | None:
    """Return when a wire was first seen closed and then open, and the scan gaps before. [s]"""
    wire = closed_of(run, press)
    if wire is None:
        return None
    known = np.isfinite(wire[0])
    times, state = run.time_s[known], wire[0][known] > 0.5
    if not state.any():
        return None
    first = int(np.argmax(state))
    closed = (float(times[first]), float(times[first] - times[first - 1])) if first > 0 else _NEVER
    last = first + int(np.argmin(state[first:]))
    opened = _NEVER if state[first:].all() else (float(times[last]), float(times[last] - times[last - 1]))
    return closed, opened
