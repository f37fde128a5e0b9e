"""What sensors, logger, platens and the material's scatter are taken to be: one place for every stack.

Fit, diagnosis and live sensor read the same numbers here; where one of them means something else, the name says
what. Standard deviations unless stated otherwise. "By hand" is a judgement of the month given, not a measurement.
Ramps of the press's motion stand in `softsensor.heat.timing`, sizes and chances of effects with each effect.
"""

from __future__ import annotations

import math

from daq.press.moments import CLOSING_RAMPS_S
from softsensor.effects.parameters import uniform_sd

# Thermocouples and logger

CHANNEL_K, CHANNEL_GAIN = 0.3, 0.0015
"""Offset and gain of a panel channel, differing from channel to channel and run to run. [K, -]

Thermocouples of one reel on one logger, not calibrated one by one: a fifth of IEC 60584-1's class 1 limit (1.5 K).
The virtual press draws its channels with the same two numbers (`daq.simulated.campaign_sensors`)."""
PLATEN_K = 0.25
"""Offset of a platen channel from run to run: sensor and its place in the platen. By hand, 2026-11. [K]

Fits take this number alone, of one run as of many. What all runs share (`PLATEN_CLASS_K`) counts as the other
constants of the press do (`fitting.problem.carried_among`): coefficients are what they are beside these platens,
and are used beside them. Against true ones ``h_p_c`` then holds less: with platens off by `PLATEN_TOTAL_K` and
panels known, 18 of 24 truths lay in its intervals, the other contacts' 100 of 102. Freed by the total it held
24, twice as wide, but platens also took up what a hidden cause does: a contact that builds up slowly was met to
3.8 K (below 2.9 before; seed 7), and a slope over twelve runs was no longer sure (seed 31; virtual press, 1 Hz,
seeds 60 to 67, 2026-11-25). The live band is about the true core, whatever the platens read, and bears the
total."""
PLATEN_CLASS_K = 0.75
"""Offset of a platen channel that all runs share: class 1 of IEC 60584-1 allows 1.5 K, here two deviations. [K]

A campaign looks for it as the effect ``platen_offset``; the live sensor bears it on top of `PLATEN_K`."""
BURIED_K = 0.4
"""Offset of a thermocouple buried in a panel: taped ones on rigs are off by 0.1 to 0.75 K of their own, here the
middle. (the project's facts, decision.md) [K]"""
PLATEN_TOTAL_K = math.hypot(PLATEN_K, PLATEN_CLASS_K)
"""Both together: all a platen channel may be off. The live sensor's number, whose band must hold in a run. [K]"""
LOGGER_STEP_K = 0.1
"""To which loggers and headers round. (facts, loggers.md) [K]"""
CHANNEL_WHITE_K = 0.07
"""White noise of one reading of a panel channel: a logger's step of 0.1 K (0.03) and its own 0.05 to 0.1. [K]"""
FACE_SLOW_LIMITS_K, FACE_SLOW_S = (0.1, 0.2), 30.0
"""Error that all channels of a face share, and how fast it is forgotten. [K, s]"""
FACE_SLOW_K = sum(FACE_SLOW_LIMITS_K) / 2.0
"""Its middle. The live sensor takes it as it is; for the fit it stands until it estimates its own, about it as a
prior. [K]"""
SECOND_SLOW_K = FACE_SLOW_LIMITS_K[1]
"""The same for a fit's second search, before it estimates the slow noise: the upper end. [K]

Only where a hidden cause leaves kelvins over does it matter, which there decides between two minima: with
`FACE_SLOW_K` two lagging runs of the reference answers no longer converged (2026-11-22)."""
MEAN_SLOW_K, MEAN_FAST_K, MEAN_FAST_S, MEAN_WHITE_K = 0.12, 0.06, 6.0, 0.03
"""The diagnosis' noise of a face's mean before its runs have shown it: slow (over `FACE_SLOW_S`), fast, and white
per row. [K, K, s, K]

By hand, 2026-11. A fit and the live sensor start from `FACE_SLOW_K`; why the diagnosis starts lower is not
recorded. It scales all three together, to what a campaign leaves."""
ROUNDING_K2 = 3e-4
"""Variance that no number of channels averages out: a rounding of 0.06 K (width/√12)². The live sensor alone adds
it to `CHANNEL_WHITE_K`; a fit estimates its white noise from the readings, rounding within. [K²]

By hand, 2026-11: `LOGGER_STEP_K` would make it 8e-4; why it is less is not recorded."""
CHANNEL_FAST_S, CHANNEL_FAST_LIMITS_S = 10.0, (3.0, 40.0)
"""How fast a channel forgets its own faster noise: where a run's readings do not show it, and the limits within
which they do. By hand. [s]"""

# Timing

MOMENT_S, MOMENT_ROWS = 0.1, 0.4
"""A moment found in the temperatures, for fit and diagnosis: at least, and per row. [s, rows] By hand.

Anywhere between two rows would be 0.29 of them; what triggers logger and press alike puts all runs at one end."""
LIVE_MOMENT_S = 0.15
"""The same for the live sensor where scans are dense: about `moment_sd` at 10 Hz, and not made wider for slower
ones, whose gaps it treats on their own. By hand, 2026-11. [s]"""
INSERTED_S = 0.4
"""An insertion found in the temperatures, for the diagnosis; a fit takes `moment_sd`. By hand, 2026-11. [s]"""
SWITCH_S = 0.06
"""How far a limit switch may lie off the middle of the ramp, beyond the scan it is known to. [s]

It trips somewhere in a ramp of 0.2 to 1 s near its end; by hand, 2026-11."""
RAMPS_S, RAMP_LIMITS_S = (0.2, 1.0), (float(CLOSING_RAMPS_S[0]), float(CLOSING_RAMPS_S[-1]))
"""How long closing takes (contract, section 2), and limits beyond, as a moment is looked for. [s]"""
RAMP_S, RAMP_SD_S = sum(RAMPS_S) / 2.0, uniform_sd(RAMPS_S[1] - RAMPS_S[0])
"""Its mean and deviation, all lengths alike. [s]"""
BEFORE_SWITCH_S, RAMP_GONE_S = 1.0, 1.5
"""From before a closing or opening to after it what a fit leaves shows no noise: the model's ramps are not the
press's. By hand, 2026-11; twice as long after it, h_p_o of sample run 7 moves by 0.8 standard deviations. [s]"""
LAG_GONE_S = 3.0
"""After it channels of one face differ by how late they are: three time constants of a slow one's second (facts,
physics.md, section 7). [s]"""
SCAN_LATE_S, SCAN_LATE_ROWS, SCAN_APART_ROWS = 0.02, 0.07, 0.12
"""How late panel channels are read: at least, and per row all of them, and one face after the other. [s, rows]

A scan takes up to half the time to the next, so its middle comes 0 to a quarter of a row late: 0.07 is that
range's standard deviation. A delay common to all channels shows only against the platens."""
SCAN_SKEW_S = 0.06
"""Of an insertion at the first row: the length of a scan. [s]"""
OPENING_RAMP_SD_S = 0.15
"""Of how long opening takes, about the usual length (`softsensor.heat.timing`): the same share as of closing. [s]

Only the diagnosis frees it: ten scans a second show it to 0.014 s, and held at the usual length a slow opening
passed for late thermocouples (virtual press, 12 runs with nothing hidden, seed 942000, 2026-11-23)."""

# Panels and pressings

START_K = 0.3
"""The panel's start temperature in the header against the true one: a handheld sensor, an uneven panel. [K]
By hand."""
START_TOTAL_K = math.hypot(START_K, PLATEN_CLASS_K)
"""With what the sensor that gave it may be off in all runs, which is of a platen channel's class. Where no face is
read, nothing else shows the start. The live sensor's number, as `PLATEN_TOTAL_K` is. [K]"""
GUESS_LOG = 0.7
"""Of the logarithm of a coefficient of which only the press file's guess is known: a factor of two. By hand."""
SPREAD_LOG = 0.15
"""Of the logarithm of a coefficient from pressing to pressing, before runs have shown it: 12 to 30 % were seen."""
SPREAD_RUNS = 2.0
"""How many runs that counts for beside those that show it, in a fit, which only sees the runs it has. By hand."""
LIVE_SPREAD_RUNS = 4.0
"""The same in the live sensor, whose band must hold in the next run. By hand."""
FREE_SPREAD_LOG = 0.4
"""The spread in the diagnosis' first fit, wider than what was seen so that it is free. By hand, 2026-11."""
SEEN_SPREAD_LOG = 0.12
"""The same at least in a diagnosis, whatever its runs show: the least of what was seen (`SPREAD_LOG`).

With `LEAST_SPREAD_LOG` in its place the four moist discs left to char are "not described" instead of moist in a
set of three (2026-11-27)."""
LEAST_SPREAD_LOG = 0.05
"""The same at least, whatever a few runs show: smaller scatter is luck. By hand."""


def scan_sd(period_s: float) -> float:
    """Return how much later one face may be read than another, with a row every `period_s`. [s]

    Examples
    --------
    >>> round(scan_sd(0.1), 3), round(scan_sd(1.0), 3)
    (0.02, 0.12)
    """
    return max(SCAN_LATE_S, SCAN_APART_ROWS * period_s)


def moment_sd(period_s: float) -> float:
    """Return how well a moment found in the temperatures is known, with a row every `period_s`. [s]

    Examples
    --------
    >>> round(moment_sd(0.1), 3), round(moment_sd(1.0), 3), round(moment_sd(10.0), 3)
    (0.14, 0.5, 4.1)
    """
    return MOMENT_S + MOMENT_ROWS * period_s
