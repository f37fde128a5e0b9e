"""The faces of a long table at once, compiled: as `daq.press.faces.Face` has them scan by scan."""

from __future__ import annotations

import math

import numpy as np

from daq.compiled import compiled
from daq.press.faces import HIGH_C, LOW_C, RATTLE_K, RATTLE_RATIO, RATTLE_S, STEP_FADES_S


@compiled()
def hold(times, values, least_s, least_scans):  # type: ignore[no-untyped-def]
    """Return values with gaps bridged by the last one for at least so many seconds and scans (rows, channels)."""
    held = values.copy()
    at = np.full(values.shape[1], -math.inf)
    last = np.full(values.shape[1], math.nan)
    step = math.inf
    for i in range(len(times)):
        before, step = step, math.inf if i == 0 else times[i] - times[i - 1]
        since = times[i] - max(least_s, least_scans * min(step, before))
        for c in range(values.shape[1]):
            if values[i, c] == values[i, c]:
                at[c], last[c] = times[i], values[i, c]
            elif at[c] >= since:
                held[i, c] = last[c]
    return held


@compiled()
def levels(times, values):  # type: ignore[no-untyped-def]
    """Return a face's temperature at each row from its sensors (rows, sensors); see `daq.press.faces.Face`."""
    sensors = values.shape[1]
    out = np.full(len(times), math.nan)
    last, steps, rattles = np.full(sensors, math.nan), np.zeros(sensors), np.zeros(sensors)
    before, ranked = np.full(sensors, math.nan), np.empty(sensors)
    members = np.zeros(sensors, np.bool_)
    shift, level = 0.0, math.nan
    for i in range(len(times)):
        elapsed = 0.0 if i == 0 else times[i] - times[i - 1]
        row = values[i].copy()
        quiet(row, min(1.0, elapsed / RATTLE_S), last, steps, rattles, ranked)
        common = 0
        for c in range(sensors):
            common += row[c] == row[c] and before[c] == before[c]
        present, same = 0, True
        for c in range(sensors):
            member = row[c] == row[c] and (common == 0 or before[c] == before[c])
            same &= member == members[c]
            present += member
            members[c] = member
        if present == 0:
            before[:] = math.nan
            level = math.nan
            continue
        shift *= math.exp(-elapsed / STEP_FADES_S)
        if common == 0:
            shift = 0.0
        elif not same:
            shift = level - middle_of(before, members, ranked)
        level = out[i] = middle_of(row, members, ranked) + shift
        before[:] = row
    return out


@compiled()
def middles(values):  # type: ignore[no-untyped-def]
    """Return the median of each row's values, that of the row before where it has none (rows)."""
    out, ranked = np.full(len(values), math.nan), np.empty(values.shape[1])
    for i in range(len(values)):
        known = values[i] == values[i]
        if known.any():
            out[i] = middle_of(values[i], known, ranked)
        elif i:
            out[i] = out[i - 1]
    return out


@compiled(inner=True)
def quiet(row, share, last, steps, rattles, ranked):  # type: ignore[no-untyped-def]
    """Leave out of a scan what lies outside of all sense, and sensors that rattle far more than the others."""
    known = 0
    for c in range(len(row)):
        if not (LOW_C < row[c] < HIGH_C):
            row[c] = math.nan
            continue
        step = row[c] - last[c] if last[c] == last[c] else 0.0
        rattles[c] = (1.0 - share) * rattles[c] + share * abs(step - steps[c])
        steps[c], last[c] = step, row[c]
        known += 1
    if known < 3:
        return
    usable = row == row
    limit = RATTLE_K + RATTLE_RATIO * middle_of(rattles, usable, ranked)
    for c in range(len(row)):
        if usable[c] and rattles[c] > limit:
            row[c] = math.nan


@compiled(inner=True)
def middle_of(values, which, ranked):  # type: ignore[no-untyped-def]
    """Return the median of those values, of which there is one at least."""
    count = 0
    for c in range(len(values)):
        if which[c]:
            j = count
            while j > 0 and ranked[j - 1] > values[c]:
                ranked[j] = ranked[j - 1]
                j -= 1
            ranked[j] = values[c]
            count += 1
    half = count // 2
    return ranked[half] if count % 2 else (ranked[half - 1] + ranked[half]) / 2
